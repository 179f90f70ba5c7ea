"""The seam between pixels and boxes: whatever finds road users in one image."""

from __future__ import annotations

from typing import Any, Protocol

from track_range.detection.detections import Detections
from track_range.foundation.arrays import Image
from track_range.foundation.errors import UserError


class DetectorError(UserError):
    """An object that is no detector; the message names its class."""


class Detector(Protocol):
    """Finds road users in an image; one instance serves one stream of frames from one thread."""

    def detect(self, image: Image) -> Detections:
        """The road users in `image`, (H, W, 3) uint8 BGR, in that image's pixels."""
        ...


def checked_detections(detector: Detector, found: Any) -> Detections:
    """What a detector's `detect` has returned.

    Raises:
        DetectorError: it is no `Detections`.
    """
    if not isinstance(found, Detections):
        name = f"{type(detector).__module__}:{type(detector).__qualname__}"
        raise DetectorError(f"{name}: expected Detections from the detector's detect, got {type(found).__name__}.")
    return found
