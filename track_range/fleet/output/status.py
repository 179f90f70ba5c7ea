"""Status of a fleet as text, from its output alone: during a run, after it, and after a driver that was killed."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from track_range.fleet.errors import FleetError
from track_range.fleet.output.data_set import read_clips
from track_range.fleet.output.state import FleetState, read_state
from track_range.fleet.storage.location import Location
from track_range.foundation.files.input_files import counted, shortened

if TYPE_CHECKING:
    import pyarrow as pa

_MAX_FAILED = 10
"""Largest number of failed clips that are named."""


@dataclass(frozen=True, slots=True)
class FleetStatus:
    """Status of a fleet.

    Attributes:
        state: state of the last run; None = there is no fleet.json.
        n_done: clips with a complete result.
        failed: names and errors of the failed clips.
        video_s: duration of the complete clips, s.
    """

    state: FleetState | None
    n_done: int
    failed: Sequence[tuple[str, str]]
    video_s: float

    def lines(self) -> Iterator[str]:
        """Lines of text for the terminal."""
        state = self.state
        total = max(state.total if state is not None else 0, self.n_done + len(self.failed))
        yield f"{state_text(state)}"
        yield f"{self.n_done} of {counted(total, 'clip')} done, {self.video_s / 3600:.2f} h of video"
        if state is not None and state.is_alive:
            yield from _rate(state, total - self.n_done - len(self.failed))
            yield from (_worker_text(worker) for worker in state.workers)
        if self.failed:
            yield f"{len(self.failed)} failed:"
            yield from (f"  {shortened(name)}: {error}" for name, error in self.failed[:_MAX_FAILED])
        if len(self.failed) > _MAX_FAILED:
            yield f"  and {len(self.failed) - _MAX_FAILED} more, see clips.parquet"


def fleet_status(out: Location) -> FleetStatus:
    """Status of the fleet in a folder or an object store.

    Raises:
        FleetError: there is no fleet, or clips.parquet is damaged.
        StorageError: the storage cannot be read.
    """
    state, table = read_state(out), read_clips(out)
    if state is None and not table.num_rows:
        raise FleetError(f"{out}: expected the results of `track-range fleet run`, found neither fleet.json nor clips.")
    return FleetStatus(state, _n_done(table), _failed(table), _video_s(table))


def state_text(state: FleetState | None) -> str:
    """Sentence on the last run."""
    if state is None:
        return "fleet.json is missing or damaged; the state of the last run is unknown."
    driver = f"process {state.pid} on {shortened(state.host)}"
    if state.is_alive:
        return f"running ({driver}), for {duration_text(time.time() - state.started_s)}"
    if state.state == "running":
        age = duration_text(time.time() - state.heartbeat_s)
        return f"ended without notice ({driver}, {age} ago); the same command continues"
    reason = f": {state.reason}" if state.reason and state.state == "failed" else ""
    return f"{state.state} {duration_text(time.time() - state.heartbeat_s)} ago{reason}"


def _rate(state: FleetState, n_left: int) -> Iterator[str]:
    elapsed_s = state.heartbeat_s - state.started_s
    if state.done and elapsed_s > 0:
        per_hour = 3600 * state.done / elapsed_s
        yield f"{per_hour:.0f} clips/h, {duration_text(3600 * n_left / per_hour)} left"


def _worker_text(worker: Any) -> str:
    clip = f" {shortened(str(worker['clip']))}, {worker['frames']} frames" if worker["clip"] else ""
    return f"  worker {worker['number']} on {shortened(str(worker['host']))}: {worker['phase']}{clip}"


def duration_text(seconds: float) -> str:
    """A duration as "45 s", "12 min" or "3 h 20 min"."""
    if seconds < 90:
        return f"{max(seconds, 0):.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"


def _n_done(table: pa.Table) -> int:
    return sum(status == "done" for status in table["status"].to_pylist())


def _failed(table: pa.Table) -> list[tuple[str, str]]:
    rows = table.select(["clip", "status", "error"]).to_pylist()
    return [(row["clip"], row["error"] or "") for row in rows if row["status"] == "failed"]


def _video_s(table: pa.Table) -> float:
    return float(sum(seconds or 0.0 for seconds in table["seconds"].to_pylist()))
