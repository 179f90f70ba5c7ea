"""The seam between boxes and identities."""

from __future__ import annotations

from typing import Protocol

from track_range.detection.detections import Detections
from track_range.foundation.arrays import Image
from track_range.tracking.tracks import Tracks


class Tracker(Protocol):
    """Gives the boxes of successive frames identities; all state belongs to the instance."""

    def update(self, detections: Detections, time_s: float, image: Image | None) -> Tracks:
        """The confirmed tracks at `time_s`, which must grow from call to call; `image` is (H, W, 3) BGR or None.

        Raises:
            ValueError: time does not go forward.
        """
        ...
