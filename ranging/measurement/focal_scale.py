"""FocalScale: what a drive shows of an assumed focal length, to correct depths and turns.

With the focal length f0 instead of f, everything that the images show is stretched along the axis
of the camera, and nothing else:

    x = (u - cx) z / f        z by size, by the road and by a pair ~ f        yaw ~ 1 / f

so that all stages measure with f0, with one scale, and the results are corrected at the end: a new
estimate changes no state of a filter. What is known from outside the images, such as a given speed,
is stretched in the same way before it meets them.
"""

import math
from dataclasses import dataclass, replace

from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.ego_motion import EgoMotion


@dataclass(frozen=True, slots=True)
class FocalScale:
    """The error of an assumed focal length; `FocalScale()` is that of a given one."""

    log_factor: float = 0.0  # logarithm of the factor by which it is too large

    @property
    def factor(self) -> float:
        """True / assumed focal length, and true / measured depth."""
        return math.exp(-self.log_factor)

    def corrected_motion(self, motion: EgoMotion) -> EgoMotion:
        """A motion along the stretched axis with the true focal length; a given speed is again as
        given, also if it was stretched by an earlier estimate.
        """
        if not self.log_factor and math.isnan(motion.stretch):
            return motion
        factor = self.factor if math.isnan(motion.stretch) else 1.0 / motion.stretch
        return replace(
            motion.scaled(factor), yaw_rad_s=motion.yaw_rad_s / self.factor, stretch=math.nan
        )

    def stretched(self, given: EgoMotion) -> EgoMotion:
        """A given speed as the images show it with the assumed focal length."""
        stretch = 1.0 / self.factor
        return replace(given.scaled(stretch), stretch=stretch)

    def camera(self, assumed: PinholeCamera) -> PinholeCamera:
        """The camera with the true focal length."""
        return assumed.with_focal_length(max(assumed.fx_px, assumed.fy_px) * self.factor)


EXACT = FocalScale()
