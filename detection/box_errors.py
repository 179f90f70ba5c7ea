"""BoxErrors: systematic errors of the sizes of a detector's boxes, by road class.

    log(size of the box / size of the object in the image) ~ N(mean, sigma) over the objects of a class

How tight boxes are depends on the labels that a detector was trained with, on its input size and on the object. The
error of an object hardly changes while it is in view, so that it does not average out over its frames.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.files.input_files import quoted


class BoxError(NamedTuple):
    """Systematic error of the boxes of one class."""

    log_height: float  # mean of the log of the ratio of the heights; negative = boxes are too low
    log_height_sigma: float  # its standard deviation over objects and drives
    log_width: float
    log_width_sigma: float


# by road class; classes that it lacks have the errors of an unknown detector
BoxErrors = Mapping[str, BoxError]

UNKNOWN_DETECTOR: BoxErrors = dict.fromkeys(ROAD_CLASSES, BoxError(0.0, 0.05, 0.0, 0.05))
"""Errors of an unknown detector: means differ by 0.03 between detectors, and by 0.04 between drives
with one detector."""

# as of projected 3-D boxes
NO_ERRORS: BoxErrors = dict.fromkeys(ROAD_CLASSES, BoxError(0.0, 0.0, 0.0, 0.0))
COCO_BOX_ERRORS: Mapping[str, BoxErrors] = {
    "YOLOv5": {"car": BoxError(-0.035, 0.045, 0.0, 0.045)},
    "YOLOX": {"car": BoxError(0.02, 0.045, 0.0, 0.045)},
    "NanoDet": {"car": BoxError(0.0, 0.045, 0.0, 0.045)},
    "PicoDet": {"car": BoxError(-0.02, 0.045, 0.01, 0.045)},
}
"""Errors by family, measured with small networks trained with COCO (YOLOv5n, YOLOX-nano, NanoDet-m,
PicoDet-s) on 5 road drives; see docs/how-to/detectors.md."""


_EXPECTED = (
    "expected [log_height, log_height_sigma, log_width, log_width_sigma] by road class, means from "
    "-0.5 to 0.5 and sigmas from 0 to 1"
)


def box_errors_of(value: Any) -> BoxErrors:
    """Errors from a mapping of road classes to the four numbers of `BoxError`, as in MODEL.yaml.
    Raises ValueError.
    """
    try:
        # The index raises a ValueError for other names.
        errors = {
            ROAD_CLASSES[ROAD_CLASSES.index(name)]: BoxError(*map(float, value[name]))
            for name in value
        }
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{_EXPECTED}, got {quoted(value)}") from error
    for name, (height, height_sigma, width, width_sigma) in errors.items():
        is_valid = -0.5 <= height <= 0.5 and -0.5 <= width <= 0.5
        if not (is_valid and 0 <= height_sigma <= 1 and 0 <= width_sigma <= 1):
            raise ValueError(f"{_EXPECTED}, got {quoted(list(errors[name]))} for {name}")
    return errors
