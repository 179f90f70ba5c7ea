"""Options of a run for its boxes and their identities: detector, recorded detections, and
tracker.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

from pydantic import field_validator, model_validator

from track_range.detection.formats.titles import READ_TITLES
from track_range.detection.models.devices import Device
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import quoted
from track_range.foundation.schemas.options import Options, contradiction, option

_shared_option = partial(option, is_shared=True)
_SMALLEST_PX, _LARGEST_PX = 32, 4096  # of the sides of a network's input

# Fields that several commands have.

# of a mask image for --ignore; other values are polygons
MASK_SUFFIXES = (".png", ".bmp", ".jpg", ".jpeg")

LETTERBOX_HELP = (
    "Placement and padding grey of images in the network input: centred-114, centred-128, "
    "top-left-114, stretch"
)

_NAMES_HELP = "coco, coco-ids, voc, mot, visdrone, a,b,c or a file with one name per line"
NamesField = Annotated[
    str | None,
    option(
        "Class names of the network, or of the numbers in recorded boxes, in their order: "
        f"{_NAMES_HELP} (default: the names in the file, else COCO's or VOC's).",
        is_file=True,
    ),
]
NumberNamesField = Annotated[
    str | None,
    option(
        "Class names where labels have numbers only, from 0: "
        f"{_NAMES_HELP} (default: those in or beside the file, else as a note says).",
        flag="--names",
        is_file=True,
    ),
]
AnchorsField = Annotated[
    str | None,
    option(
        "Anchors of a network with raw YOLO heads, one group per output (default: as in the model "
        "file, else YOLOv4-tiny's).",
        metavar="'W,H ... / W,H ...'",
    ),
]
LetterboxField = Annotated[
    str | None,
    option(f"{LETTERBOX_HELP} (default: as usual for the network family).", metavar="NAME"),
]
LayoutField = Annotated[
    str | None,
    option(
        "Name of the layout of the network's outputs, such as yolov8; see docs/how-to/detectors.md "
        "(default: recognised from the shapes and values of the outputs).",
        metavar="NAME",
    ),
]
SizeField = Annotated[
    int | None,
    option(
        "Longer side of the network input in pixels, for a network of variable input size "
        "(default: as in the model file, else 640).",
        flag="--size",
        metavar="PX",
        ge=32,
        le=4096,
    ),
]
ThreadsField = Annotated[
    int,
    option(
        "Number of CPU threads for the network; 0 = one per core that the process may use.",
        metavar="N",
        ge=0,
        le=256,
    ),
]
DeviceField = Annotated[
    Device,
    option(
        "Device that runs the networks; auto = an NVIDIA GPU if onnxruntime can use one, else "
        "the CPU."
    ),
]
TrackerField = Annotated[
    str,
    option(
        "Tracker: road (appearance near the prediction, then overlap), deepsort (appearance in a wide "
        "gate first), sort (without appearance), or a class of an installed package or (only on the "
        "command line) of a module in the current folder.",
        metavar="NAME|MODULE:CLASS",
        is_shared=True,
    ),
]
ReidField = Annotated[
    Path | None,
    option(
        "Re-identification network (ONNX) that describes the appearance of objects (default: a "
        "built-in colour descriptor).",
        is_shared=True,
    ),
]

TrackerScoreField = Annotated[
    float | None,
    option(
        "Smallest confidence of the detections that the tracker gets, for trackers of other "
        "packages that expect confident ones (default: as the tracker is registered, else all "
        "detections, from --min-score on).",
        metavar="SCORE",
        is_shared=True,
        ge=0,
        le=1,
    ),
]


def input_size(option: int | str | None) -> int | tuple[int, int] | None:
    """Longer side, or width and height, of a network's input in pixels from `PX` or `WxH`;
    UsageError if the option is neither.
    """
    from track_range.foundation.files.numeric_text import number  # imports NumPy

    if option is None:
        return None
    sides = [number(side) for side in str(option).split("x")]
    is_range = all(_SMALLEST_PX <= side <= _LARGEST_PX and side.is_integer() for side in sides)
    if not is_range or len(sides) > 2 or (len(sides) == 2 and any(side % 32 for side in sides)):
        raise UsageError(
            f"--size: expected a longer side from {_SMALLEST_PX} to {_LARGEST_PX} px, width and height "
            f"in multiples of 32, such as 960x544, or (in runs) auto, got {quoted(str(option))}."
        )
    return int(sides[0]) if len(sides) == 1 else (int(sides[0]), int(sides[1]))


def check_tracker(name: str, reid: Path | None) -> None:
    """UsageError if there is no such tracker, or if it does not compare appearance with a
    re-identification network.
    """
    from track_range.tracking.registry import TrackerError, find_tracker

    try:
        tracker = find_tracker(name)
    except TrackerError as error:
        raise UsageError(f"--tracker: {error}") from error
    if reid is not None and not tracker.uses_reid:
        raise UsageError(
            f"--reid: --tracker {name} does not compare appearance; omit --reid or use --tracker road."
        )


class DetectionOptions(Options):
    """The boxes of a run."""

    panel: ClassVar = "Detection"
    stage: ClassVar = "detections"

    detector: Annotated[
        str | None,
        _shared_option(
            "YOLO network: an ONNX file, or a name from `track-range models list` (default: road, "
            "which is packaged).",
            metavar="FILE|NAME",
            is_file=True,
        ),
    ] = None
    classes: Annotated[
        tuple[str, ...],
        _shared_option(
            "Road classes to track: person, bicycle, car, motorcycle, bus, truck, traffic light, "
            "traffic sign (default: all).",
            metavar="A,B,...",
        ),
    ] = ()
    min_score: Annotated[
        str | None,
        _shared_option(
            "Minimum detection confidence from 0 to 1, also by class: 0.1,car=0.3 (default: 0.1).",
            metavar="S[,CLASS=S...]",
        ),
    ] = None
    detections: Annotated[
        Path | None,
        option(
            f"Recorded boxes instead of a detector, in a file or folder of {READ_TITLES}.",
            is_per_clip=True,
            instead="recorded detections belong to a clip; give them in the column detections of a "
            "manifest",
        ),
    ] = None
    ignore: Annotated[
        str | None,
        option(
            "Regions of the image whose boxes are dropped, such as the bonnet and overlay text: "
            "polygons in pixels of the video, or a mask image of its size, white in the regions; a "
            "box is dropped if most of it is inside.",
            metavar="'x,y x,y x,y / ...'|MASK.png",
            is_file=True,
            stage="tracks",  # the detector finds them first
        ),
    ] = None
    names: NamesField = None
    anchors: AnchorsField = None
    letterbox: LetterboxField = None
    layout: LayoutField = None
    size_px: Annotated[
        str | None,
        option(
            "Longer side of the network input in pixels, or its width and height in multiples of "
            "32, for a network of variable input size; auto = as in the model file, with a far "
            "pass where it pays (default: as in the model file, else 640).",
            flag="--size",
            metavar="PX|WIDTHxHEIGHT",
            words=("auto",),
        ),
    ] = None
    far_pass: Annotated[
        int | None,
        option(
            "Second pass of the detector in the band around the horizon, for far road users, in "
            "every n-th frame; 0 = none (default: none; with --size auto, at most ten per second, "
            "if the band has at least twice the resolution of the network's input).",
            metavar="N",
            ge=0,
            le=1000,
        ),
    ] = None
    threads: ThreadsField = 0
    device: DeviceField = "auto"

    @property
    def far_pass_every(self) -> int | None:
        """Frames from a far pass to the next one; 0 = none, None = as it pays."""
        is_auto = self.size_px == "auto"
        return None if is_auto and self.far_pass is None else self.far_pass or 0

    @field_validator("size_px")
    @classmethod
    def _known_size(cls, value: str | None) -> str | None:
        try:
            input_size(None if value == "auto" else value)
        except UsageError as error:
            raise contradiction(str(error), ("size_px",)) from error
        return value

    @model_validator(mode="before")
    @classmethod
    def _packaged_detector(cls, values: Any) -> Any:
        if (
            isinstance(values, dict)
            and values.get("detector") is None
            and values.get("detections") is None
        ):
            from track_range.detection.catalogue.lookup import DEFAULT_MODEL  # imports onnxruntime

            return {**values, "detector": DEFAULT_MODEL}
        return values


class TrackingOptions(Options):
    """The tracker that gives boxes identities."""

    panel: ClassVar = "Tracking"
    stage: ClassVar = "tracks"

    tracker: TrackerField = "road"
    reid: ReidField = None
    tracker_min_score: TrackerScoreField = None

    @model_validator(mode="after")
    def _known_tracker(self) -> Self:
        try:
            check_tracker(self.tracker, self.reid)
        except UsageError as error:
            raise contradiction(str(error), ("tracker", "reid")) from error
        return self
