"""Vibration: how much the images jump from frame to frame.

A camera on a vehicle turns smoothly: rotations from frame to frame are alike. An image that jumps
by j in one frame jumps back in the next one: its rotations w_t = j_t - j_t-1 have the covariance
-sigma_j^2 with those of the next frame.
"""

import math

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import Note

# angle, rad, from which it is noted; a smooth turn has less than 0
_MIN_RAD = 1e-3
_GAIN, _MIN_FRAMES = 0.05, 15  # weight of one frame in the mean, and frames from which it is used
# largest rotation between frames relative to the vibration so far, and smallest limit, rad: more is
# a cut or a wrong fit
_LARGEST, _LARGEST_RAD = 5.0, 0.02


class Vibration:
    """Measures the vibration of one stream; the state belongs to the instance."""

    def __init__(self) -> None:
        self._before: FloatArray | None = None
        self._covariance = np.zeros(2)  # of pitch and yaw, rad^2
        self._n_frames = 0
        self.since_s = math.nan  # when it was first noted; NaN = not yet
        self.largest_rad = 0.0

    def add(self, time_s: float, rotation: FloatArray | None) -> None:
        """Use the rotation vector (3,) since the last frame; None = unknown."""
        before = self._before
        self._before = None if rotation is None else rotation[:2]
        if rotation is None or before is None:
            return
        limit_rad = max(_LARGEST_RAD, _LARGEST * self.sigma_rad)
        product = -np.clip(before, -limit_rad, limit_rad) * np.clip(
            rotation[:2], -limit_rad, limit_rad
        )
        self._n_frames += 1
        gain = max(_GAIN, 1 / self._n_frames)
        self._covariance += gain * (product - self._covariance)
        if self._n_frames >= _MIN_FRAMES and self.sigma_rad > _MIN_RAD:
            self.since_s = time_s if math.isnan(self.since_s) else self.since_s
            self.largest_rad = max(self.largest_rad, self.sigma_rad)

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of the angle of a frame, of the larger of pitch and yaw."""
        return math.sqrt(max(float(self._covariance.max()), 0.0))

    def notes(self, focal_px: float) -> tuple[str, ...]:
        """Messages for the user so far, for a focal length."""
        if math.isnan(self.since_s):
            return ()
        return (
            Note(
                f"The images vibrate from {self.since_s:.1f} s on: they jump by "
                f"{focal_px * self.largest_rad:.1f} px from frame to frame (1 sigma). Speeds are less "
                "accurate, and their sigmas contain it; mount the cameras more firmly.",
                "images-vibrate",
                "warning",
                "left",
            ),
        )
