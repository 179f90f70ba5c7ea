"""Progress of a fleet: a table on a terminal, else a line every 30 s."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from track_range.fleet.output.state import FleetState
from track_range.foundation.files.input_files import printable, shortened

if TYPE_CHECKING:
    from track_range.fleet.engine.driver import Slot

_LINE_S = 30.0  # time between two lines, s
_MAX_WORKERS = 32  # largest number of workers in the table
_MAX_NAME = 40  # longest name of a clip in the table


@contextmanager
def shown_progress(
    console: Console, fleet: FleetState
) -> Iterator[Callable[[Sequence[Slot]], None]]:
    """Context with a function that shows the state and the workers on the console."""
    if console.is_terminal:
        with Live(console=console, refresh_per_second=2, transient=True) as live:
            yield lambda slots: live.update(_table(fleet, slots))
        return
    next_s = time.monotonic() + _LINE_S

    def print_line(_slots: Sequence[Slot]) -> None:
        nonlocal next_s
        if time.monotonic() >= next_s:
            next_s = time.monotonic() + _LINE_S
            console.print(fleet.text(), highlight=False, markup=False, soft_wrap=True)

    yield print_line


def _table(fleet: FleetState, slots: Sequence[Slot]) -> Table:
    table = Table(title=fleet.text(), title_justify="left", box=None, padding=(0, 1))
    for heading in ("worker", "node", "clip", "phase", "frames", "MB"):
        table.add_column(heading, justify="right" if heading in ("frames", "MB") else "left")
    for slot in slots[:_MAX_WORKERS]:
        values = worker_state(slot)
        texts = (
            str(values["number"]),
            values["host"],
            shortened(values["clip"], _MAX_NAME),
            values["phase"],
        )
        table.add_row(*map(Text, (*texts, str(values["frames"]), str(values["memory_mb"]))))
    if len(slots) > _MAX_WORKERS:
        table.add_row("...", f"{len(slots) - _MAX_WORKERS} more")
    return table


def worker_state(slot: Slot) -> dict[str, Any]:
    """State of a worker as plain values, for fleet.json and the table."""
    state = slot.state
    phase = "idle" if slot.task is None else "starting" if state is None else state.progress.phase
    return {
        "number": slot.number,
        "host": "" if state is None else printable(state.host),
        "pid": None if state is None else state.pid,
        "clip": "" if slot.task is None else slot.task.clip.name,
        "phase": phase,
        "frames": 0 if state is None else state.progress.frames,
        "memory_mb": 0 if state is None else round(state.memory_bytes / 1e6),
        "clips": slot.n_clips,
    }
