"""BoxErrors: systematic errors of the sizes of a detector's boxes, by road class.

    log(size of the box / size of the object in the image) ~ N(mean, sigma) over the objects of a class

How tight boxes are depends on the labels that a detector was trained with, on its input size and on the object. The
error of an object hardly changes while it is in view, so that it does not average out over its frames.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from track_range.detection.classes import COCO_CLASSES, ROAD_CLASSES
from track_range.foundation.files.input_files import quoted

_MAX_MEAN, _MAX_SIGMA = 0.5, 1.0  # of valid values


class BoxError(NamedTuple):
    """Systematic error of the boxes of one class."""

    log_height: float  # mean of the log of the ratio of the heights; negative = boxes are too low
    log_height_sigma: float  # its standard deviation over objects and drives
    log_width: float
    log_width_sigma: float


BoxErrors = Mapping[str, BoxError]  # by road class; classes that it lacks have the errors of an unknown detector

UNKNOWN_DETECTOR: BoxErrors = dict.fromkeys(ROAD_CLASSES, BoxError(0.0, 0.05, 0.0, 0.05))
"""Errors of an unknown detector: the means of detectors differ by 0.03, those of the drives of a detector by 0.04."""

NO_ERRORS: BoxErrors = dict.fromkeys(ROAD_CLASSES, BoxError(0.0, 0.0, 0.0, 0.0))
"""Exact boxes, such as labels that are projections of 3-D boxes."""

COCO_BOX_ERRORS: Mapping[str, BoxErrors] = {
    "YOLOv5": {"car": BoxError(-0.035, 0.045, 0.0, 0.045)},
    "YOLOX": {"car": BoxError(0.02, 0.045, 0.0, 0.045)},
    "NanoDet": {"car": BoxError(0.0, 0.045, 0.0, 0.045)},
    "PicoDet": {"car": BoxError(-0.02, 0.045, 0.01, 0.045)},
}
"""By family, of small networks trained with COCO (YOLOv5n, YOLOX-nano, NanoDet-m, PicoDet-s) on 5 road drives; see
docs/detectors.md."""


def usual_box_errors(family: str, names: Sequence[str]) -> BoxErrors | None:
    """Errors of networks of a family with COCO's class names; None = not measured."""
    return COCO_BOX_ERRORS.get(family) if tuple(names) == COCO_CLASSES else None


def box_errors_of(value: Any) -> BoxErrors:
    """Errors from a mapping of road classes to the four numbers of `BoxError`, as in MODEL.yaml; else ValueError."""
    expected = "expected [log_height, log_height_sigma, log_width, log_width_sigma] by road class"
    if not isinstance(value, Mapping):
        raise ValueError(f"{expected}, got {quoted(value)}")
    errors = {}
    for name, numbers in value.items():
        if name not in ROAD_CLASSES:
            raise ValueError(f"{expected}, got the class {quoted(name)}")
        try:
            error = BoxError(*map(float, numbers))
        except (TypeError, ValueError) as problem:
            raise ValueError(f"{expected}, got {quoted(numbers)} for {name}") from problem
        is_mean_valid = max(abs(error.log_height), abs(error.log_width)) <= _MAX_MEAN  # False for NaN
        if not (is_mean_valid and all(0 <= s <= _MAX_SIGMA for s in (error.log_height_sigma, error.log_width_sigma))):
            raise ValueError(
                f"{expected}, means from -{_MAX_MEAN:g} to {_MAX_MEAN:g} and sigmas from 0 to {_MAX_SIGMA:g}, "
                f"got {quoted(list(error))} for {name}"
            )
        errors[name] = error
    return errors
