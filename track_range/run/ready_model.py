"""The ONNX file that a word on the command line means, fetched with a bar where it is not here yet."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

from track_range.detection.models.download import pull
from track_range.detection.models.lookup import find_model, models_folder


def ready_model(word: str | Path, console: Console) -> Path:
    """A file, a packaged, a cached or a catalogue model, in that order; the licence is told before a download.

    Raises:
        ModelError: nothing has that name.
        DownloadError: it cannot be fetched.
    """
    found = find_model(word)
    if found.origin != "catalogue" or found.entry is None:
        return found.path
    console.print(found.entry.notice, highlight=False, markup=False, soft_wrap=True)
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task(found.entry.name, total=None)
        return pull(
            found.entry,
            models_folder(),
            lambda done_bytes, total_bytes: progress.update(task, completed=done_bytes, total=total_bytes),
        )
