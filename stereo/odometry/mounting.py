"""How a camera is mounted: Vibration, how much its images jump from frame to frame, and
TravelDirection, how far the direction of travel is to the side of its principal point.

A camera on a vehicle turns smoothly: rotations from frame to frame are alike. An image that jumps
by j in one frame jumps back in the next one: its rotations w_t = j_t - j_t-1 have the covariance
-sigma_j^2 with those of the next frame.

A vehicle on a straight road drives along its axis, in which the camera looks, too. If the images
expand from a column beside the principal point, the camera is turned, or the principal point is
wrong; straight roads cannot tell which.
"""

import math

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.camera import PinholeCamera

# angle, rad, from which it is noted; a smooth turn has less than 0
_MIN_RAD = 1e-3
_GAIN, _MIN_FRAMES = 0.05, 15  # weight of one frame in the mean, and frames from which it is used
# largest rotation between frames relative to the vibration so far, and smallest limit, rad: more is
# a cut or a wrong fit
_LARGEST, _LARGEST_RAD = 5.0, 0.02
_MAX_YAW_RAD_S = 0.03  # largest yaw rate of a straight road
_MIN_S = 1.5  # shortest time on straight roads
_MIN_SIDE_RAD = 0.05  # angle from which it is noted: cameras are mounted within about 2 degrees


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
            f"The images vibrate from {self.since_s:.1f} s on: they jump by "
            f"{focal_px * self.largest_rad:.1f} px from frame to frame (1 sigma). Speeds are less "
            "accurate, and their sigmas contain it; mount the cameras more firmly.",
        )


class TravelDirection:
    """Mean of one stream over straight roads; the state belongs to the instance."""

    def __init__(self, camera: PinholeCamera) -> None:
        self._focal_px = camera.fx_px
        self._straight_s = 0.0
        self.side_rad = math.nan  # positive = to the right; NaN = unknown

    def add(self, dt_s: float, side_rad: float, yaw_rad_s: float) -> None:
        """Use the direction of travel in a frame that comes `dt_s` after the last one; NaN =
        unknown.
        """
        if not (math.isfinite(side_rad) and abs(yaw_rad_s) < _MAX_YAW_RAD_S):
            return
        self._straight_s += dt_s
        before_rad = 0.0 if math.isnan(self.side_rad) else self.side_rad
        self.side_rad = before_rad + dt_s / self._straight_s * (side_rad - before_rad)

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        # False for NaN
        if self._straight_s < _MIN_S or not abs(self.side_rad) >= _MIN_SIDE_RAD:
            return ()
        side, other = ("right", "left") if self.side_rad > 0 else ("left", "right")
        offset_px = self._focal_px * abs(self.side_rad)
        return (
            f"On straight roads, the camera moves {math.degrees(abs(self.side_rad)):.1f} degrees "
            f"to the {side} of its axis: it is turned to the {other}, or its principal point is "
            f"{offset_px:.0f} px too far to the {other}; lateral positions have this error. Check "
            "the principal point of the calibration.",
        )
