"""BoxErrors: systematic errors of the sizes of a detector's boxes, by road class.

    log(size of the box / size of the object in the image) ~ N(mean, sigma) over the objects of a class

How tight boxes are depends on the labels that a detector was trained with, on its input size and on the object. The
error of an object hardly changes while it is in view, so that it does not average out over its frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from track_range.detection.classes import ROAD_CLASSES


class BoxError(NamedTuple):
    """Systematic error of the boxes of one class."""

    log_height: float  # mean of the log of the ratio of the heights; negative = boxes are too low
    log_height_sigma: float  # its standard deviation over objects and drives
    log_width: float
    log_width_sigma: float


BoxErrors = Mapping[str, BoxError]  # by road class; classes that it lacks have the errors of an unknown detector

UNKNOWN_DETECTOR: BoxErrors = dict.fromkeys(ROAD_CLASSES, BoxError(0.0, 0.05, 0.0, 0.05))
"""Errors of a detector of which nothing is known."""

NO_ERRORS: BoxErrors = dict.fromkeys(ROAD_CLASSES, BoxError(0.0, 0.0, 0.0, 0.0))
"""Exact boxes, such as labels that are projections of 3-D boxes."""
