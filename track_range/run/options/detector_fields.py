"""Options of the detector that several commands have: types of their fields."""

from __future__ import annotations

from typing import Annotated, Literal

from track_range.foundation.options import option

Device = Literal["auto", "cpu", "cuda", "tensorrt"]

LETTERBOX_HELP = (
    "Placement and padding grey of images in the network input: centred-114, centred-128, top-left-114, stretch"
)

NamesField = Annotated[
    str | None,
    option(
        "Class names of the network in its order: a,b,c or a file with one name per line (default: the names in the "
        "model file, else COCO's or VOC's).",
        is_file=True,
    ),
]
AnchorsField = Annotated[
    str | None,
    option(
        "Anchors of a network with raw YOLO heads, one group per output (default: those in the model file, else "
        "YOLOv4-tiny's).",
        metavar="'W,H ... / W,H ...'",
    ),
]
LetterboxField = Annotated[
    str | None, option(f"{LETTERBOX_HELP} (default: that of the network family).", metavar="NAME")
]
SizeField = Annotated[
    int | None,
    option(
        "Longer side of the network input in pixels, for a network of variable input size (default: that in the model "
        "file, else 640).",
        flag="--size",
        metavar="PX",
        ge=32,
        le=4096,
    ),
]
ThreadsField = Annotated[
    int, option("Number of CPU threads for the network; 0 = one per core.", metavar="N", ge=0, le=256)
]
DeviceField = Annotated[Device, option("Device that runs the network; auto = a GPU if there is one, else the CPU.")]
