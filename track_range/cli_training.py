"""The commands `train` and `anchors` as the command line shows them; PyTorch only loads when wanted."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from track_range.detection.training.errors import TrainingError

_console = Console()
_WHAT, _HOW, _PAPER = "What to learn", "How to train", "The paper's improvements"

DataOption = Annotated[
    Path,
    typer.Option(
        metavar="data.yaml",
        help="YOLO's: path, train, val, names; or KITTI's labels with `format: kitti`. Also `manifest` and "
        "`labels_pseudo`, for images whose labels are not complete.",
        rich_help_panel=_WHAT,
    ),
]
SizeOption = Annotated[
    int,
    typer.Option(
        metavar="PX", min=64, max=2048, help="Side of training images, a multiple of 32.", rich_help_panel=_HOW
    ),
]
SeedOption = Annotated[
    int, typer.Option(min=0, max=2**63 - 1, help="Another seed is another run.", rich_help_panel=_HOW)
]


def anchors(
    data: DataOption,
    size: SizeOption = 416,
    clusters: Annotated[int, typer.Option(min=2, max=32, help="How many; YOLOv4-tiny has 6, YOLOv5 9.")] = 9,
    seed: SeedOption = 0,
) -> None:
    """Print anchors fitted to a data set's boxes (k-means++), and how well they fit before and after."""
    _check_torch()
    from track_range.commands.training_data import print_anchors

    print_anchors(data, size_px=size, n_anchors=clusters, seed=seed, console=_console)


def train(
    data: DataOption,
    model: Annotated[
        Literal["yolov5n", "yolov5s", "yolov4-tiny"], typer.Option(help="The network.", rich_help_panel=_WHAT)
    ] = "yolov5n",
    size: SizeOption = 416,
    epochs: Annotated[int, typer.Option(min=1, help="Times through the images.", rich_help_panel=_HOW)] = 100,
    batch: Annotated[int, typer.Option(min=1, max=1024, help="Images per step.", rich_help_panel=_HOW)] = 16,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Run folder: checkpoints, results.csv, curves.png, the model.")
    ] = Path("track-range-training"),
    resume: Annotated[
        bool,
        typer.Option(
            "--resume", help="Go on with the run in --out, which was stopped or killed; give its other options again."
        ),
    ] = False,
    device: Annotated[
        str, typer.Option(metavar="auto|cpu|cuda", help="Where; auto = a GPU if there is one.", rich_help_panel=_HOW)
    ] = "auto",
    attention: Annotated[
        Literal["none", "cbam"], typer.Option(help="Attention in the backbone's blocks.", rich_help_panel=_PAPER)
    ] = "none",
    box_loss: Annotated[Literal["ciou", "eiou"], typer.Option(help="Loss of boxes.", rich_help_panel=_PAPER)] = "ciou",
    anchors: Annotated[
        Literal["default", "kmeans++"],
        typer.Option(help="The network's own, or fitted to the data's boxes.", rich_help_panel=_PAPER),
    ] = "default",
    teacher: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|NAME",
            help="A YOLOv5n or s (its ONNX export) whose answers are learnt beside the labels.",
            rich_help_panel=_WHAT,
        ),
    ] = None,
    weights: Annotated[
        Path | None,
        typer.Option(
            metavar="best.pt",
            help="Begin with another run's weights; anchors stay this run's own.",
            rich_help_panel=_WHAT,
        ),
    ] = None,
    optimiser: Annotated[Literal["adamw", "sgd"], typer.Option(help="How it learns.", rich_help_panel=_HOW)] = "adamw",
    learning_rate: Annotated[
        float | None,
        typer.Option(min=1e-6, max=1.0, help="Default: 0.002 for adamw, 0.01 for sgd.", rich_help_panel=_HOW),
    ] = None,
    gain: Annotated[
        tuple[float, float],
        typer.Option(metavar="MIN MAX", help="Images are scaled by, relative to --size.", rich_help_panel=_HOW),
    ] = (0.5, 1.5),
    mosaic: Annotated[
        float,
        typer.Option(min=0.0, max=1.0, metavar="SHARE", help="Training images made of four.", rich_help_panel=_HOW),
    ] = 0.9,
    precision: Annotated[
        Literal["auto", "float32", "bfloat16", "float16"],
        typer.Option(help="Of the arithmetic; auto = what the device is fastest in.", rich_help_panel=_HOW),
    ] = "auto",
    validate_every: Annotated[
        int, typer.Option(min=1, metavar="N", help="Epochs between validations.", rich_help_panel=_HOW)
    ] = 1,
    threads: Annotated[int, typer.Option(min=0, max=256, help="Of the CPU; 0 = all.", rich_help_panel=_HOW)] = 0,
    seed: SeedOption = 0,
    licence: Annotated[
        str, typer.Option(metavar="TEXT", help="Licence of the weights, written into the model.", rich_help_panel=_WHAT)
    ] = "",
) -> None:
    """Train a detector on labelled images, and export it as an ONNX file that --detector takes."""
    _check_torch()
    from track_range.commands.train import TrainOptions
    from track_range.commands.train import train as run

    options = TrainOptions(
        data=data,
        model=model,
        size_px=size,
        n_epochs=epochs,
        batch_size=batch,
        out=out,
        device=device,
        is_resumed=resume,
        has_cbam=attention == "cbam",
        box_loss=box_loss,
        has_own_anchors=anchors == "kmeans++",
        optimiser=optimiser,
        learning_rate=learning_rate,
        precision=None if precision == "auto" else precision,
        gain=gain,
        mosaic=mosaic,
        validate_every=validate_every,
        seed=seed,
        n_threads=threads,
        teacher=teacher,
        weights=weights,
        licence=licence,
    )
    run(options, _console)


def _check_torch() -> None:
    if find_spec("torch") is None:
        raise TrainingError("training wants PyTorch: pip install 'track-range[train]', then once more.")
