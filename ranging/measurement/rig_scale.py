"""RigScale: what a drive shows of the scale of a pair, or of the road with an assumed height of the
camera, and of the disparities of a pair, to correct lengths.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from track_range.ranging.measurement.ranges import Ranges
from track_range.stereo.odometry.ego_motion import EgoMotion

_MIN_RATIO = 0.05  # smallest ratio of the true and the measured disparity of a distance


@dataclass(frozen=True, slots=True)
class DisparityOffset:
    """An error of all disparities of a pair that distances by size show, not the alignment."""

    px: float  # true minus measured disparity
    sigma_px: float
    known_px: float  # standard deviation of this error in the sigmas of the distances
    focal_baseline_px_m: float  # of the rig: distance times disparity
    # inverse disparity in 1/px, that of the objects of known size, at which the scale is known best
    centre: float = 0.0

    def corrected(self, ranges: Ranges) -> Ranges:
        """Distances without the offset, with its own standard deviation."""
        inverse_px = ranges.distance_m / self.focal_baseline_px_m
        ratio = 1.0 + self.px * inverse_px
        ratio = np.where(ratio > _MIN_RATIO, ratio, np.nan)
        own = (ranges.sigma_m / ranges.distance_m) ** 2 - (self.known_px * inverse_px) ** 2
        distance_m = ranges.distance_m / ratio
        common = self.sigma_px * (inverse_px / ratio - self.centre)
        sigma_m = distance_m * np.hypot(np.sqrt(np.maximum(own, 0.0)) / ratio, common)
        return ranges.with_distances(distance_m, sigma_m, ranges.sigma_systematic_m)


@dataclass(frozen=True, slots=True)
class RigScale:
    """The factor by which all lengths that a pair measures are too large, the error of the product
    of focal length and baseline, and the offset of its disparities; `RigScale()` is that of a
    calibration. The same of lengths by the motion of the road, with the error of the height.
    """

    log_factor: float = 0.0
    sigma: float = 0.0  # its standard deviation; infinite = the scale is not known yet
    offset: DisparityOffset | None = None  # None = the alignment knows it

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
        if self.offset is not None:
            ranges = self.offset.corrected(ranges)
        return ranges.scaled(self.factor)

    def measured(self, ranges: Ranges) -> Ranges:
        """True distances as the pair would measure them, with the error of its scale."""
        if self == CALIBRATED:
            return ranges
        distance_m = ranges.distance_m / self.factor
        sigma = np.hypot(ranges.sigma_m / ranges.distance_m, self.sigma)
        if self.offset is not None:
            k = self.offset.focal_baseline_px_m
            disparity_px = k / distance_m - self.offset.px
            disparity_px = np.where(disparity_px > 0, disparity_px, np.nan)
            distance_m = k / disparity_px
            sigma = np.hypot(sigma, self.offset.sigma_px / disparity_px)
        return ranges.with_distances(distance_m, sigma * distance_m, ranges.sigma_systematic_m)

    def corrected_motion(self, motion: EgoMotion) -> EgoMotion:
        """A motion that the pair, or the road, measured with the true scale, with its error;
        without a speed if the scale is not known.
        """
        if self.factor == 1.0 and not self.sigma:
            return motion
        true, right_mps = motion.scaled(self.factor), motion.right_mps * self.factor
        right_sigma_mps = motion.right_sigma_mps * self.factor
        return replace(
            true,
            speed_sigma_mps=math.hypot(true.speed_sigma_mps, self.sigma * true.speed_mps),
            right_mps=right_mps,
            right_sigma_mps=math.hypot(right_sigma_mps, self.sigma * right_mps),
            scale=self.factor,
        )


CALIBRATED = RigScale()
UNKNOWN_SCALE = RigScale(sigma=math.inf)
