"""TravelDirection: how far the direction of travel is to the side of the principal point.

A vehicle on a straight road drives along its axis, in which the camera looks, too. If the images
expand from a column beside the principal point, the camera is turned, or the principal point is
wrong; straight roads cannot tell which. With a mounting, the same holds for the direction of travel
that it states. A direction that changes is not that of a mounting: the car swerves, or the
recording is cut to another camera.
"""

import math

from track_range.foundation.errors import Note
from track_range.stereo.geometry.camera import PinholeCamera

_MAX_YAW_RAD_S = 0.03  # largest yaw rate of a straight road
_MIN_S = 1.5  # shortest time on straight roads
_MIN_SIDE_RAD = 0.05  # angle from which it is noted: cameras are mounted within about 2 degrees


class TravelDirection:
    """Mean of one stream over straight roads; the state belongs to the instance."""

    def __init__(self, camera: PinholeCamera, *, has_mounting: bool = False) -> None:
        """With `has_mounting`, directions are relative to the one that a mounting states."""
        self._focal_px, self._has_mounting = camera.fx_px, has_mounting
        self._straight_s = 0.0
        self.side_rad = math.nan  # positive = to the right; NaN = unknown
        self._variance = 0.0  # of the direction over time

    def add(self, dt_s: float, side_rad: float, yaw_rad_s: float) -> None:
        """Use the direction of travel in a frame that comes `dt_s` after the last one; NaN =
        unknown.
        """
        if not (math.isfinite(side_rad) and abs(yaw_rad_s) < _MAX_YAW_RAD_S):
            return
        self._straight_s += dt_s
        before_rad = 0.0 if math.isnan(self.side_rad) else self.side_rad
        share, change_rad = dt_s / self._straight_s, side_rad - before_rad
        self.side_rad = before_rad + share * change_rad
        self._variance = (1 - share) * (self._variance + share * change_rad**2)

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        # False for NaN
        is_aside = abs(self.side_rad) >= _MIN_SIDE_RAD and self._variance <= self.side_rad**2
        if self._straight_s < _MIN_S or not is_aside:
            return ()
        side, other = ("right", "left") if self.side_rad > 0 else ("left", "right")
        side_deg, offset_px = math.degrees(abs(self.side_rad)), self._focal_px * abs(self.side_rad)
        if self._has_mounting:
            return (
                Note(
                    f"On straight roads, the camera moves {side_deg:.1f} degrees to the {side} of the "
                    f"direction of travel by its mounting: it is turned further to the {other} than the "
                    "mounting states, or its principal point is wrong. Check the mounting (--mount, or "
                    "in the rig file).",
                    "mounting-contradicted",
                    "warning",
                    "calibration",
                ),
            )
        return (
            Note(
                f"On straight roads, the camera moves {side_deg:.1f} degrees to the {side} of its axis: "
                f"it is turned to the {other}, or its principal point is {offset_px:.0f} px too far to "
                f"the {other}; lateral positions have this error. Check the principal point of the "
                "calibration.",
                "principal-point-contradicted",
                "warning",
                "calibration",
            ),
        )
