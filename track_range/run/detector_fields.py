"""Options of a detector that several commands have, for `Annotated[TYPE, names_option(...)]`."""

from __future__ import annotations

from typing import Any, Literal

from track_range.foundation.options import option

Device = Literal["auto", "cpu", "cuda", "tensorrt"]

LETTERBOX_HELP = (
    "Placement and padding of images in the network's input: centred-114, centred-128, top-left-114, stretch"
)


def names_option(**shown: Any) -> Any:
    """Class names of the detector: `str | None`."""
    return option("Class names of the network: a,b,c or a file with one per line.", **shown)


def anchors_option(**shown: Any) -> Any:
    """Anchors of a detector with raw heads: `str | None`."""
    return option(
        "Anchors of raw YOLO heads, a group per output (default: the model's own, or YOLOv4-tiny's).",
        metavar="'W,H ... / W,H ...'",
        **shown,
    )


def letterbox_option(**shown: Any) -> Any:
    """How images lie in the network's input: `str | None`."""
    return option(f"{LETTERBOX_HELP} (default: that of the network's family).", metavar="WORD", **shown)


def size_option(**shown: Any) -> Any:
    """Longer side of the network's input: `int | None`."""
    return option(
        "Longer side of the network's input, if free (default: the model's own, else 640).",
        flag="--size",
        metavar="PX",
        ge=32,
        le=4096,
        **shown,
    )


def threads_option(**shown: Any) -> Any:
    """CPU threads: `int`."""
    return option("CPU threads of the network; 0 = one per core.", metavar="N", ge=0, le=256, **shown)


def device_option(**shown: Any) -> Any:
    """Where a network runs: `Device`."""
    return option("Device that runs the network; auto = a GPU if there is one.", **shown)
