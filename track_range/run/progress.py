"""Progress bars of commands."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


@contextmanager
def frame_progress(console: Console, n_frames: int | None) -> Iterator[Callable[..., None]]:
    """Progress bar with frames, rate and remaining time (on a terminal).

    Yields a callable that advances it; its argument is a text to show beside it.
    """
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[fps]:.1f} fps"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[status]}"),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task("frames", total=n_frames, fps=0.0, status="")
        start_s = time.perf_counter()

        def advance(status: str = "") -> None:
            n = int(progress.tasks[0].completed) + 1
            progress.update(
                task, completed=n, fps=n / max(time.perf_counter() - start_s, 1e-9), status=status
            )

        yield advance


@contextmanager
def step_progress(console: Console, text: str) -> Iterator[Callable[[int, int | None], None]]:
    """Progress bar that disappears at the end; yields a callable that takes the finished and total
    steps.
    """
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(
        *columns, console=console, disable=not console.is_terminal, transient=True
    ) as progress:
        task = progress.add_task(text, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)
