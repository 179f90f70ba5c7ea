"""`track-range models list | pull | import`: where detectors come from."""

from __future__ import annotations

from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from track_range.commands.ready_model import ready_model
from track_range.detection.darknet.importer import import_darknet
from track_range.detection.models.lookup import model_rows, models_folder
from track_range.run.detector_options import class_names


def list_models(console: Console) -> None:
    """Print the catalogue, and what is packaged or cached besides."""
    table = Table(box=box.SIMPLE_HEAD, title="Detectors", title_justify="left", padding=0)
    for heading in ("name", "input", "size", "licence", "from", "state"):
        table.add_column(heading, overflow="fold", no_wrap=heading in ("name", "size", "state"))
    for row in model_rows():
        cells = (row.name, row.input, row.size, row.licence, row.source, row.state)
        table.add_row(*(Text(cell) for cell in cells))
    console.print(table)
    console.print(f"Fetched models are kept in {models_folder()}", highlight=False, soft_wrap=True)


def pull_model(name: str, console: Console) -> Path:
    """Fetch one model, unless it is here already; the ONNX file.

    Raises:
        ModelError: no such model.
        DownloadError: it cannot be fetched.
    """
    path = ready_model(name, console)
    console.print(f"{path} is ready: --detector {name}", highlight=False, soft_wrap=True)
    return path


def import_model(cfg: Path, weights: Path, out: Path, *, names: str, console: Console) -> None:
    """Write the ONNX file of a Darknet network and say what it is.

    Raises:
        ModelError: cfg and weights cannot be read, or do not belong together.
        ConfigError: no readable names.
    """
    imported = import_darknet(cfg, weights, out, names=class_names(names) or ())
    height, width = imported.input_hw
    console.print(
        f"{out}: {imported.family}, {width}x{height}, {imported.n_layers} layers, "
        f"{imported.n_parameters / 1e6:.1f} million parameters",
        highlight=False,
        soft_wrap=True,
    )
    for note in imported.notes:
        console.print(f"- {note}", style="dim", highlight=False, markup=False)
