"""The commands about detectors, `models ...` and `evaluate ...`, as the command line shows them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from detection.input_format import LETTERBOXES
from track_range.commands.models import tell_model
from track_range.detector_options import DetectorOptions

models = typer.Typer(no_args_is_help=True, help="Detectors: what a file holds, which can be fetched, and making them.")

_console = Console()

NamesOption = Annotated[str | None, typer.Option(help="The network's class names, a,b,c or a file with one per line.")]
AnchorsOption = Annotated[
    str | None,
    typer.Option(metavar="'W,H ... / W,H ...'", help="Anchors of raw YOLO heads, a group per output."),
]
LetterboxOption = Annotated[
    str | None, typer.Option(metavar="WORD", help=f"How the network wants images: {LETTERBOXES}.")
]


@models.command("info", help="Say what a model file is, what is taken for granted of it, and what it can see.")
def _info(
    model: Annotated[Path, typer.Argument(metavar="FILE|NAME", help="An ONNX file, or a name of `models list`.")],
    names: NamesOption = None,
    anchors: AnchorsOption = None,
    letterbox: LetterboxOption = None,
) -> None:
    tell_model(model, DetectorOptions(names=names, anchors=anchors, letterbox=letterbox), _console)
