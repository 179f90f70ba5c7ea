"""The `ObjectDetector` protocol: what every detector of road users implements."""

from __future__ import annotations

from typing import Any, Protocol

from track_range.detection.detections import Detections
from track_range.foundation.arrays import Image
from track_range.foundation.errors import UserError


class DetectorError(UserError):
    """An object that does not implement `ObjectDetector`; the message names its class."""


class ObjectDetector(Protocol):
    """Detector of road users in images; use one instance per video stream, in one thread."""

    def detect(self, image: Image) -> Detections:
        """The road users in `image`, (H, W, 3) uint8 BGR, with boxes in pixels of that image."""
        ...


def checked_detections(detector: ObjectDetector, result: Any) -> Detections:
    """`result`, the return value of `detector.detect`, after a check of its type.

    Raises:
        DetectorError: `result` is not a `Detections`.
    """
    if not isinstance(result, Detections):
        name = f"{type(detector).__module__}:{type(detector).__qualname__}"
        raise DetectorError(f"{name}: expected detect() to return Detections, got {type(result).__name__}.")
    return result
