"""Local file of a detector given by name or path, downloaded with a progress bar if necessary."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)

from track_range.detection.catalogue.download import pull
from track_range.detection.catalogue.lookup import find_model, models_folder


def ready_model(name_or_path: str | Path, console: Console) -> Path:
    """ONNX file of a model: an existing file, else a packaged, cached or catalogue model, in that
    order.

    A model of the catalogue is downloaded to the cache folder, with its licence notice and progress
    on the console. ModelError: there is no such model; DownloadError: it cannot be downloaded.
    """
    model = find_model(name_or_path)
    if model.origin != "catalogue" or model.entry is None:
        return model.path
    console.print(model.entry.notice, highlight=False, markup=False, soft_wrap=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
    )
    with Progress(
        *columns, TimeRemainingColumn(), console=console, disable=not console.is_terminal
    ) as progress:
        task = progress.add_task(model.entry.name, total=None)
        return pull(
            model.entry,
            models_folder(),
            lambda done_bytes, total_bytes: progress.update(
                task, completed=done_bytes, total=total_bytes
            ),
        )
