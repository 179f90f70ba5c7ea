"""Progress of a fleet: a table on a terminal, else a line every 30 s."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from track_range.fleet.output.status import duration_text
from track_range.foundation.files.input_files import printable, shortened

if TYPE_CHECKING:
    from track_range.fleet.engine.counts import Counts
    from track_range.fleet.engine.pool import Slot

_LINE_S = 30.0
"""Time between two lines, s."""

_MAX_WORKERS = 32
"""Largest number of workers in the table."""

_MAX_NAME = 40
"""Longest name of a clip in the table."""


class FleetProgress:
    """Shows the progress; see `shown_progress`."""

    def __init__(self, console: Console, counts: Counts, live: Live | None) -> None:
        self._console, self._counts, self._live = console, counts, live
        self._next_s = time.monotonic() + _LINE_S

    def __call__(self, slots: Sequence[Slot]) -> None:
        """Show the counts and the workers."""
        if self._live is not None:
            self._live.update(self._table(slots))
        elif time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + _LINE_S
            self._console.print(progress_text(self._counts), highlight=False, markup=False, soft_wrap=True)

    def _table(self, slots: Sequence[Slot]) -> Table:
        table = Table(title=progress_text(self._counts), title_justify="left", box=None, padding=(0, 1))
        for heading in ("worker", "node", "clip", "phase", "frames", "MB"):
            table.add_column(heading, justify="right" if heading in ("frames", "MB") else "left")
        for slot in slots[:_MAX_WORKERS]:
            values = worker_state(slot)
            texts = (str(values["number"]), values["host"], shortened(values["clip"], _MAX_NAME), values["phase"])
            table.add_row(*map(Text, (*texts, str(values["frames"]), str(values["memory_mb"]))))
        if len(slots) > _MAX_WORKERS:
            table.add_row("...", f"{len(slots) - _MAX_WORKERS} more")
        return table


@contextmanager
def shown_progress(console: Console, counts: Counts) -> Iterator[FleetProgress]:
    """Context in which the progress is shown on the console."""
    if not console.is_terminal:
        yield FleetProgress(console, counts, None)
        return
    with Live(console=console, refresh_per_second=2, transient=True) as live:
        yield FleetProgress(console, counts, live)


def worker_state(slot: Slot) -> dict[str, Any]:
    """State of a worker as plain values, for fleet.json and the table."""
    state, info = slot.state, slot.info
    task = "" if slot.task is None else slot.task.clip.name
    is_current = state is not None and state.clip == task and bool(task)
    phase = "starting" if info is None else "idle" if not task else "waiting" if not is_current else state.phase  # type: ignore[union-attr]
    return {
        "number": slot.number,
        "host": "" if info is None else printable(info.host),
        "pid": None if info is None else info.pid,
        "clip": task,
        "phase": phase,
        "frames": state.frames if is_current and state is not None else 0,
        "memory_mb": 0 if state is None else round(state.memory_bytes / 1e6),
        "clips": slot.n_clips,
    }


def progress_text(counts: Counts) -> str:
    """One line: clips done of all, rate, time left, failures."""
    finished = counts.skipped + counts.done
    parts = [f"{finished} of {counts.total} clips done"]
    if counts.failed:
        parts.append(f"{counts.failed} failed")
    if (rate := counts.clips_per_hour) is not None:
        parts += [f"{rate:.0f} clips/h", f"{duration_text(3600 * counts.left / rate)} left"]
    return ", ".join(parts)
