"""`track-range models list`, `pull` and `import`."""

from pathlib import Path
from typing import Annotated

from track_range.cli.shared.console import console, print_grid
from track_range.cli.shared.parameters import command
from track_range.detection.catalogue.darknet.importer import import_darknet
from track_range.detection.catalogue.lookup import model_rows, models_folder
from track_range.foundation.schemas.options import Options, option
from track_range.run.options.opened import class_names
from track_range.run.ready_model import ready_model
from track_range.views.tables import Cell, Grid


class ListOptions(Options):
    """No options, for `track-range models list`."""


class PullOptions(Options):
    """Options of `track-range models pull`."""

    name: Annotated[
        str,
        option(
            "Name of the detector in `track-range models list`.", metavar="NAME", is_argument=True
        ),
    ]


class ImportOptions(Options):
    """Options of `track-range models import`."""

    cfg: Annotated[
        Path,
        option(
            "Description of the network in Darknet's format.", metavar="FILE.cfg", is_argument=True
        ),
    ]
    weights: Annotated[
        Path, option("Weights in Darknet's format.", metavar="FILE.weights", is_argument=True)
    ]
    names: Annotated[
        str, option("Class names: a,b,c or a file with one name per line, such as coco.names.")
    ]
    out: Annotated[Path, option("ONNX file to write.")]


def _list(_options: ListOptions) -> None:
    columns = ("name", "input", "size", "licence", "state", "from")
    rows = ((*texts, state, source) for *texts, source, state in model_rows())
    print_grid(console, Grid("Detectors", columns, tuple(tuple(map(Cell, row)) for row in rows)))
    console.print(
        f"Downloaded models are stored in {models_folder()}", highlight=False, soft_wrap=True
    )


def _pull(options: PullOptions) -> None:
    path = ready_model(options.name, console)
    console.print(
        f"{path}: use this model with --detector {options.name}", highlight=False, soft_wrap=True
    )


def _import(options: ImportOptions) -> None:
    imported = import_darknet(
        options.cfg, options.weights, options.out, names=class_names(options.names) or ()
    )
    height, width = imported.input_hw
    console.print(
        f"{options.out}: {imported.family}, {width}x{height}, {imported.n_layers} layers, "
        f"{imported.n_parameters / 1e6:.1f} million parameters",
        highlight=False,
        soft_wrap=True,
    )
    for note in imported.notes:
        console.print(f"- {note}", style="dim", highlight=False, markup=False)


list_app = command(ListOptions, _list)
pull_app = command(PullOptions, _pull)
import_app = command(ImportOptions, _import)
