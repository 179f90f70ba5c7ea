"""The `ObjectDetector` protocol: what every detector of road users implements."""

from __future__ import annotations

from typing import Any, Protocol

from track_range.detection.detections import Detections
from track_range.foundation.arrays import Image
from track_range.foundation.errors import UserError


class DetectorError(UserError):
    """A detector that returns no valid `Detections`; the message names its class and the frame."""


class ObjectDetector(Protocol):
    """Detector of road users in images; use one instance per video stream, in one thread."""

    def detect(self, image: Image) -> Detections:
        """The road users in `image`, (H, W, 3) uint8 BGR, with boxes in pixels of that image."""


def checked_detections(detector: ObjectDetector, image: Image, frame_index: int) -> Detections:
    """The detections of a detector of another package in the image of a frame.

    Raises:
        DetectorError: it does not return `Detections`, or raises a ValueError, as `Detections` does for invalid values.
    """
    where = f"{type(detector).__module__}:{type(detector).__qualname__}, frame {frame_index}"
    try:
        result: Any = detector.detect(image)
    except ValueError as error:
        raise DetectorError(f"{where}: {str(error).rstrip('.')}.") from error
    if not isinstance(result, Detections):
        raise DetectorError(f"{where}: expected detect() to return Detections, got {type(result).__name__}.")
    return result
