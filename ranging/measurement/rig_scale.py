"""RigScale: what a drive shows of the scale of a pair, and lengths corrected by it."""

import math
from dataclasses import dataclass, replace

import numpy as np

from track_range.ranging.measurement.ranges import Ranges
from track_range.stereo.odometry.ego_motion import EgoMotion


@dataclass(frozen=True, slots=True)
class RigScale:
    """The factor by which all lengths that a pair measures are too large: the error of the product
    of focal length and baseline; `RigScale()` is that of a calibration.
    """

    log_factor: float = 0.0
    sigma: float = 0.0  # its standard deviation; infinite = the scale is not known yet

    @property
    def is_known(self) -> bool:
        """Whether lengths are measured at all."""
        return math.isfinite(self.sigma)

    @property
    def factor(self) -> float:
        """True length / measured length; NaN = unknown."""
        return math.exp(-self.log_factor) if self.is_known else math.nan

    def corrected(self, ranges: Ranges) -> Ranges:
        """Distances of the pair with the true scale, without its error, which they share."""
        if self.factor == 1.0:
            return ranges
        systematic_m = ranges.sigma_systematic_m
        return replace(
            ranges,
            distance_m=ranges.distance_m * self.factor,
            sigma_m=ranges.sigma_m * self.factor,
            sigma_systematic_m=None if systematic_m is None else systematic_m * self.factor,
        )

    def measured(self, ranges: Ranges) -> Ranges:
        """True distances as the pair would measure them, with the error of its scale."""
        if self == CALIBRATED:
            return ranges
        measured = replace(
            ranges, distance_m=ranges.distance_m / self.factor, sigma_m=ranges.sigma_m / self.factor
        )
        return measured.widened(self.sigma)

    def corrected_motion(self, motion: EgoMotion) -> EgoMotion:
        """A motion that the pair measured with the true scale, with its error; without a speed if
        the scale is not known.
        """
        if self == CALIBRATED:
            return motion
        speed_mps = motion.speed_mps * self.factor
        sigma_mps = float(np.hypot(motion.speed_sigma_mps * self.factor, self.sigma * speed_mps))
        return replace(motion, speed_mps=speed_mps, speed_sigma_mps=sigma_mps)


CALIBRATED = RigScale()
UNKNOWN_SCALE = RigScale(sigma=math.inf)
