"""Options of the detector that several commands have, for `Annotated[TYPE, names_option(...)]`."""

from __future__ import annotations

from typing import Any, Literal

from track_range.foundation.options import option

Device = Literal["auto", "cpu", "cuda", "tensorrt"]

LETTERBOX_HELP = (
    "Placement and padding grey of images in the network input: centred-114, centred-128, top-left-114, stretch"
)


def names_option(**shown: Any) -> Any:
    """Class names of the network: `str | None`."""
    return option(
        "Class names of the network in its order: a,b,c or a file with one name per line (default: the names in the "
        "model file, else COCO's or VOC's).",
        **shown,
    )


def anchors_option(**shown: Any) -> Any:
    """Anchors of a detector with raw heads: `str | None`."""
    return option(
        "Anchors of a network with raw YOLO heads, one group per output (default: those in the model file, else "
        "YOLOv4-tiny's).",
        metavar="'W,H ... / W,H ...'",
        **shown,
    )


def letterbox_option(**shown: Any) -> Any:
    """Placement of images in the network input: `str | None`."""
    return option(f"{LETTERBOX_HELP} (default: that of the network family).", metavar="NAME", **shown)


def size_option(**shown: Any) -> Any:
    """Longer side of the network input in pixels: `int | None`."""
    return option(
        "Longer side of the network input in pixels, for a network of variable input size (default: that in the model "
        "file, else 640).",
        flag="--size",
        metavar="PX",
        ge=32,
        le=4096,
        **shown,
    )


def threads_option(**shown: Any) -> Any:
    """Number of CPU threads: `int`."""
    return option("Number of CPU threads for the network; 0 = one per core.", metavar="N", ge=0, le=256, **shown)


def device_option(**shown: Any) -> Any:
    """Device that runs a network: `Device`."""
    return option("Device that runs the network; auto = a GPU if there is one, else the CPU.", **shown)
