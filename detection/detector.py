"""The seam between pixels and boxes: whatever finds road users in one image."""

from __future__ import annotations

from typing import Protocol

from track_range.detection.detections import Detections
from track_range.foundation.arrays import Image


class Detector(Protocol):
    """Finds road users in an image; one instance serves one stream of frames from one thread."""

    def detect(self, image: Image) -> Detections:
        """The road users in `image`, (H, W, 3) uint8 BGR, in that image's pixels."""
        ...
