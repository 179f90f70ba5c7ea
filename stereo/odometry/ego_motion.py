"""EgoMotion: speed and yaw rate of the camera in one frame; Odometry: measures them from the images."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.frames import Frame


@dataclass(frozen=True, slots=True)
class EgoMotion:
    """Motion of the left camera since the previous frame."""

    speed_mps: float = math.nan  # speed along the optical axis, negative = backwards; NaN = not measured
    speed_sigma_mps: float = math.nan  # its standard deviation; NaN = not measured
    yaw_rad_s: float = math.nan  # rate of the heading, positive = to the right; NaN = not measured
    is_still: bool = False  # whether the camera is at rest; False if unknown


class Odometry(Protocol):
    """Measures the motion of the camera from the frames of one stream, in order."""

    @property
    def source(self) -> str:
        """Name of the method, for notes: "stereo odometry"."""
        ...

    def update(self, frame: Frame, xyxy_px: FloatArray) -> EgoMotion:
        """Motion since the previous frame; unknown for the first one.

        Args:
            frame: the images.
            xyxy_px: (N, 4) boxes of road users in the left image, which are not static.
        """
        ...
