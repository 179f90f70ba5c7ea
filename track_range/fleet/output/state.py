"""fleet.json: state of the run of a fleet, rewritten every few seconds; status of a fleet as
text.
"""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from pydantic import TypeAdapter

from track_range.fleet.errors import FleetError
from track_range.fleet.output.data_set import publish, read_clips
from track_range.fleet.storage.location import Location
from track_range.foundation.files.folder_lock import locked_folder
from track_range.foundation.files.input_files import counted, shortened
from track_range.foundation.files.structured_text import parse_json
from track_range.foundation.processes import is_running

STATE_FILE = "fleet.json"

HEARTBEAT_S = 5.0  # time between two writings of the state
STALE_S = 60.0  # age of a state above which its run has ended without saying so
# the same on this machine, where a missing process shows it, unless its number is reused
_STALE_HERE_S = 600.0
_MAX_FAILED = 10  # largest number of failed clips that are named

State = Literal["running", "finished", "stopped", "failed"]


@dataclass(slots=True, kw_only=True)
class FleetState:
    """State of the run of a fleet, whose driver is the process `pid` on `host` and changes it as
    the run goes on.
    """

    state: State  # "stopped" by the user, or "failed" for a `reason` that is not a clip
    reason: str = ""
    host: str = field(default_factory=socket.gethostname)
    pid: int = field(default_factory=os.getpid)
    started_s: float = field(default_factory=time.time)  # Unix time
    heartbeat_s: float = field(default_factory=time.time)  # time of this state, Unix time
    total: int = 0  # number of clips
    skipped: int = 0  # complete at the start, or found to be unchanged by a worker
    done: int = 0  # completed in this run
    failed: int = 0  # in this run, or before and not repeated
    video_s: float = 0.0  # duration of the clips completed in this run
    settings_hash: str = ""  # of the settings that all clips have in common
    options: Mapping[str, Any] = field(default_factory=dict)
    workers: Sequence[Mapping[str, Any]] = ()

    def write(self, out: Location) -> None:
        """Write fleet.json; raises the errors of `publish`."""
        content = {"track_range_fleet": 1, **asdict(self), "video_s": round(self.video_s, 3)}
        publish(
            out,
            out.child(STATE_FILE),
            json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False).encode(),
        )

    @property
    def is_alive(self) -> bool:
        """Whether the driver is at work, as far as this machine can determine."""
        age_s = time.time() - self.heartbeat_s
        is_here = self.host == socket.gethostname()
        is_recent = age_s < _STALE_HERE_S and is_running(self.pid) if is_here else age_s < STALE_S
        return self.state == "running" and is_recent

    @property
    def clips_per_hour(self) -> float | None:
        """Rate of the run; None if it completed no clip."""
        elapsed_s = self.heartbeat_s - self.started_s
        return 3600 * self.done / elapsed_s if self.done and elapsed_s > 0 else None

    def text(self) -> str:
        """One line: number of clips that are done and of all clips, failures, rate, time left."""
        parts = [f"{self.skipped + self.done} of {self.total} clips done"]
        if self.failed:
            parts.append(f"{self.failed} failed")
        if (per_hour := self.clips_per_hour) is not None:
            n_left = self.total - self.skipped - self.done - self.failed
            left = [f"{duration_text(3600 * n_left / per_hour)} left"] if n_left else []
            parts += [f"{per_hour:.0f} clips/h", *left]
        return ", ".join(parts)

    def sentence(self) -> str:
        """Sentence on a run that has ended."""
        failed = f", {self.failed} failed" if self.failed else ""
        rate = "" if self.clips_per_hour is None else f" ({self.clips_per_hour:.0f} clips per hour)"
        text = (
            f"{self.skipped + self.done} of {self.total} clips done{failed}: {self.done} in this "
            "run, which took "
        )
        text += duration_text(self.heartbeat_s - self.started_s) + rate
        return f"{text}, and {self.skipped} in earlier runs." if self.skipped else f"{text}."


def read_state(out: Location) -> FleetState | None:
    """The state in fleet.json; None if it cannot be read."""
    location = out.child(STATE_FILE)
    if not location.exists():
        return None
    try:
        content: Any = parse_json(
            location.read_bytes().decode(), location, FleetError, "the state of a fleet"
        )
        is_state = isinstance(content, dict) and content.pop("track_range_fleet", None) == 1
        return TypeAdapter(FleetState).validate_python(content) if is_state else None
    except (FleetError, ValueError, TypeError):
        return None


@contextmanager
def locked_output(out: Location) -> Iterator[None]:
    """Lock of the output of a fleet: one driver at a time.

    A local folder is locked by the operating system, an object store by the heartbeat in
    fleet.json. Raises FolderLockError or FleetError if another driver is at work, and StorageError.
    """
    if not out.is_local:
        state = read_state(out)
        if (
            state is not None
            and state.is_alive
            and (state.host, state.pid) != (socket.gethostname(), os.getpid())
        ):
            raise FleetError(
                f"{out}: another fleet run (process {state.pid} on {state.host}) is writing here; "
                "wait for its end, or choose another --out."
            )
        yield
        return
    try:
        out.path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FleetError(
            f"{out.path}: the folder cannot be created ({error.strerror}); choose another --out."
        ) from error
    with locked_folder(out.path):
        yield


def status_lines(out: Location) -> Iterator[str]:
    """Lines of text about a fleet; raises the errors of `read_clips`, and FleetError if there is no
    fleet.
    """
    state, table = read_state(out), read_clips(out)
    if state is None and not table.num_rows:
        raise FleetError(
            f"{out}: expected the results of `track-range fleet run`, found neither "
            "fleet.json nor clips."
        )
    rows = table.select(["clip", "status", "error", "seconds"]).to_pylist()
    failed = [(row["clip"], row["error"] or "") for row in rows if row["status"] == "failed"]
    n_done = sum(row["status"] == "done" for row in rows)
    video_s = sum(row["seconds"] or 0.0 for row in rows)
    total = max(state.total if state is not None else 0, n_done + len(failed))
    yield state_text(state)
    yield f"{n_done} of {counted(total, 'clip')} done, {duration_text(video_s)} of video"
    if state is not None and state.is_alive:
        if (per_hour := state.clips_per_hour) is not None:
            left_s = 3600 * (total - n_done - len(failed)) / per_hour
            yield f"{per_hour:.0f} clips/h, {duration_text(left_s)} left"
        for worker in state.workers:
            clip = (
                f" {shortened(str(worker['clip']))}, {worker['frames']} frames"
                if worker["clip"]
                else ""
            )
            yield (
                f"  worker {worker['number']} on {shortened(str(worker['host']))}: "
                f"{worker['phase']}{clip}"
            )
    if failed:
        yield f"{len(failed)} failed:"
        yield from (f"  {shortened(name)}: {error}" for name, error in failed[:_MAX_FAILED])
    if len(failed) > _MAX_FAILED:
        yield f"  and {len(failed) - _MAX_FAILED} more, see clips.parquet"


def state_text(state: FleetState | None) -> str:
    """Sentence on the last run."""
    if state is None:
        return "fleet.json is missing or damaged; the state of the last run is unknown."
    driver = f"process {state.pid} on {shortened(state.host)}"
    if state.is_alive:
        return f"running ({driver}), for {duration_text(time.time() - state.started_s)}"
    age = duration_text(time.time() - state.heartbeat_s)
    if state.state == "running":
        return (
            f"stopped unexpectedly {age} ago, before all clips were done ({driver}); repeat the "
            "command to continue"
        )
    reason = f": {state.reason}" if state.reason and state.state == "failed" else ""
    return f"{state.state} {age} ago{reason}"


def duration_text(seconds: float) -> str:
    """A duration as "0.6 s", "45 s", "94 s", "12 min" or "3 h 20 min"."""
    if 0 < seconds < 1:
        return f"{max(seconds, 0.1):.1f} s"
    if seconds < 180:
        return f"{max(seconds, 0):.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
