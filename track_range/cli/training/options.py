"""Options of `track-range train` and `track-range anchors`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from track_range.foundation.options import Options, option

_WHAT, _HOW, _PAPER = "What to learn", "How to train", "The paper's improvements"

_Data = Annotated[
    Path,
    option(
        "Data set in YOLO's format: path, train, val, names; or KITTI's labels with `format: kitti`. Optional keys "
        "`manifest` and `labels_pseudo` for images whose labels are not complete.",
        metavar="data.yaml",
        panel=_WHAT,
    ),
]
_Size = Annotated[
    int,
    option(
        "Side of training images in pixels, a multiple of 32.",
        flag="--size",
        metavar="PX",
        panel=_HOW,
        ge=64,
        le=2048,
    ),
]
_Seed = Annotated[int, option("Random seed.", panel=_HOW, ge=0, le=2**63 - 1)]


class AnchorOptions(Options):
    """Options of `track-range anchors`."""

    data: _Data
    size_px: _Size = 416
    clusters: Annotated[int, option("Number of anchors; YOLOv4-tiny has 6, YOLOv5 9.", ge=2, le=32)] = 9
    seed: _Seed = 0


class TrainOptions(Options):
    """Options of `track-range train`."""

    data: _Data
    model: Annotated[Literal["yolov5n", "yolov5s", "yolov4-tiny"], option("Network to train.", panel=_WHAT)] = "yolov5n"
    size_px: _Size = 416
    n_epochs: Annotated[int, option("Number of epochs.", flag="--epochs", panel=_HOW, ge=1)] = 100
    batch_size: Annotated[int, option("Images per step.", flag="--batch", panel=_HOW, ge=1, le=1024)] = 16
    out: Annotated[Path, option("Run folder: checkpoints, results.csv, curves.png, the model.", metavar="DIR")] = Path(
        "track-range-training"
    )
    resume: Annotated[
        bool,
        option("Continuation of the run in --out, which was stopped or killed; give its other options again."),
    ] = False
    device: Annotated[
        str, option("Device to train on; auto = a GPU if there is one.", metavar="auto|cpu|cuda", panel=_HOW)
    ] = "auto"
    attention: Annotated[Literal["none", "cbam"], option("Attention in the blocks of the backbone.", panel=_PAPER)] = (
        "none"
    )
    box_loss: Annotated[Literal["ciou", "eiou"], option("Loss of boxes.", panel=_PAPER)] = "ciou"
    anchors: Annotated[
        Literal["default", "kmeans++"],
        option("Anchors: the network's own, or fitted to the boxes of the data.", panel=_PAPER),
    ] = "default"
    teacher: Annotated[
        str | None,
        option(
            "Teacher network, a YOLOv5n or s (its ONNX export), whose outputs are learnt beside the labels.",
            metavar="FILE|NAME",
            panel=_WHAT,
        ),
    ] = None
    weights: Annotated[
        Path | None,
        option("Initial weights from another run; anchors stay this run's own.", metavar="best.pt", panel=_WHAT),
    ] = None
    optimiser: Annotated[Literal["adamw", "sgd"], option("Optimiser.", panel=_HOW)] = "adamw"
    learning_rate: Annotated[
        float | None,
        option("Learning rate (default: 0.002 for adamw, 0.01 for sgd).", panel=_HOW, ge=1e-6, le=1.0),
    ] = None
    gain: Annotated[
        tuple[float, float],
        option("Smallest and largest scale of training images, relative to --size.", metavar="MIN MAX", panel=_HOW),
    ] = (0.5, 1.5)
    mosaic: Annotated[
        float,
        option("Share of training images composed of four.", metavar="SHARE", panel=_HOW, ge=0.0, le=1.0),
    ] = 0.9
    precision: Annotated[
        Literal["auto", "float32", "bfloat16", "float16"],
        option("Arithmetic; auto = the fastest of the device.", panel=_HOW),
    ] = "auto"
    validate_every: Annotated[int, option("Number of epochs between validations.", metavar="N", panel=_HOW, ge=1)] = 1
    n_threads: Annotated[int, option("CPU threads; 0 = one per core.", flag="--threads", panel=_HOW, ge=0, le=256)] = 0
    seed: _Seed = 0
    licence: Annotated[str, option("Licence of the weights, written into the model.", metavar="TEXT", panel=_WHAT)] = ""
