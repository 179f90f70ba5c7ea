"""What a drive tells about its cameras: the unknowns, and what is known of each before the drive.

An unknown is the logarithm of the factor by which the assumed value is too large. To add one, add a
member of `Unknown` and its prior in `camera_priors`; evidence then names it. Every depth network
has one, too (`NetworkFactor`), with the prior of its evidence.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, NamedTuple

from track_range.ranging.size_models.region import Region
from track_range.ranging.size_models.shared_sizes import common_sigma
from track_range.stereo.geometry.focal_curve import FocalCurve

Kind = Literal["given", "usual", "unknown"]
"""given: by a file or an option, and doubted if the drive excludes it; usual: of most cameras, with
heavy tails; unknown: estimated from the drive."""


class Unknown(StrEnum):
    """A value that may be wrong; the value of a member is its name in messages and files."""

    BASELINE = "baseline"
    SIZES = "sizes"  # of all road users of the drive: distances by size
    HEIGHT = "camera height"  # of the camera over the expected height: positive = it is higher
    FOCAL = "focal length"
    SPEED = "speed"  # the given one
    FRAME_RATE = "frame rate"  # the times of the images: all speeds by images
    OFFSET = "disparity offset"  # true minus measured disparity in px, not a logarithm


class NetworkFactor(str):
    """The factor by which the distances of the depth network of this name are too large."""

    __slots__ = ()


AnyUnknown = Unknown | NetworkFactor


class PriorPart(NamedTuple):
    """A normal distribution of an unknown, as a part of its prior."""

    log_weight: float
    mean: float
    sigma: float


Sum = Mapping[AnyUnknown, float]
"""A sum of unknowns: the coefficient of each; absent = 0."""

OF_FOCAL: Sum = {Unknown.FOCAL: 1.0}
OF_BASELINE: Sum = {Unknown.BASELINE: 1.0}
OF_PAIR: Sum = {Unknown.BASELINE: 1.0, Unknown.FOCAL: 1.0}
"""What the baseline by itself, and all lengths that a pair measures, are too large by."""


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of a value before the drive."""

    sigma: float  # standard deviation of its logarithm
    kind: Kind = "given"
    value: float = 1.0  # the assumed value, in m or px; 1 = a factor
    # of the focal length by a drive, which is no normal distribution; None = it is
    curve: FocalCurve | None = None

    @property
    def part(self) -> PriorPart:
        """The normal distribution; beside a curve, one that says nothing."""
        return PriorPart(0.0, 0.0, self.sigma if self.curve is None else FREE_SIGMA)


CameraPriors = Mapping[AnyUnknown, Prior]
"""Priors by unknown; what the cameras do not have is absent."""

FREE_SIGMA = 3.0  # of the logarithm of a value that is not known at all
USUAL_HEIGHT_M, _HEIGHT_SIGMA = 1.45, 0.22  # of cameras behind a windscreen
KNOWN_FOCAL = 0.05  # largest sigma of a focal length that was not itself estimated from shapes
# of a value that is unusual in its kind, and the probability of that
_UNUSUAL_SIGMA, _P_UNUSUAL = 0.7, 0.12
# of boards' calibrations, of a given focal length, of a given height, and of the scale of receivers
_RIG_SIGMA, _FOCAL_SIGMA, GIVEN_SIGMA, _SPEED_SIGMA = 0.005, 0.004, 0.03, 0.015
_CLOCK_SIGMA = 0.001  # of the clocks of cameras

# standard deviations of wrong given values and the probability of each: measured badly, and wrong
# by any factor; boards have squares of all sizes
_WRONG: tuple[tuple[float, float], ...] = (0.25, 0.015), (1.5, 0.005)
_WRONG_BASELINE = (0.25, 0.03), (1.5, 0.02)
_WRONG_HEIGHT = (0.12, 0.04), (1.5, 0.005)  # often guessed, or that of another vehicle
_WRONG_OFFSET = ((4.0, 0.05),)  # px: a camera that was hit, or videos cropped after the calibration
# wrong clocks are rare: they are those of conversions
_WRONG_CLOCK = ((0.3, 0.003),)
# of one mistake of `MISTAKES`, and of one of the clock
_P_KNOWN, _P_KNOWN_CLOCK, _KNOWN_SIGMA = 0.004, 0.0015, 0.02

MISTAKES: Mapping[Unknown, tuple[tuple[float, str], ...]] = {
    Unknown.BASELINE: (
        (2.54, "centimetres read as inches"),
        (1 / 2.54, "inches read as centimetres"),
        (3.281, "feet read as metres"),
        (0.3048, "metres read as feet"),
        (10.0, "millimetres read as centimetres"),
        (0.1, "centimetres read as millimetres"),
    ),
    Unknown.FOCAL: (
        (0.5, "the matrix of images of half the size"),
        (2.0, "the matrix of images of twice the size"),
    ),
    Unknown.SPEED: (
        (3.6, "km/h read as m/s"),
        (1 / 3.6, "m/s read as km/h"),
        (1.609, "km/h read as miles per hour"),
        (1 / 1.609, "miles per hour read as km/h"),
        (1.944, "knots read as m/s"),
        (1 / 1.852, "knots read as km/h"),
    ),
    Unknown.FRAME_RATE: (
        (2.0, "every second image left out"),
        (0.5, "every image stored twice"),
        (1.2, "25 frames/s stored as 30"),
        (1 / 1.2, "30 frames/s stored as 25"),
        (1.25, "24 frames/s stored as 30"),
        (1 / 1.25, "30 frames/s stored as 24"),
    ),
}
"""Known mistakes, and the factor that each makes a value too large by."""


def camera_priors(
    focal_px: float,
    *,
    focal_sigma: float = 0.0,
    baseline_m: float | None = None,
    baseline_sigma: float = 0.0,
    scale_sigma: float = 0.0,
    height_m: float | None = None,
    region: Region = "unknown",
) -> CameraPriors:
    """The priors of one camera, or of the pair with the baseline.

    `focal_sigma` is relative, 0 = calibrated; `baseline_sigma` is that of an assumed baseline, 0 =
    calibrated, with the error `scale_sigma` of lengths. `height_m` is a given height above the
    road, None = a usual one.
    """
    height = Prior(_HEIGHT_SIGMA, "usual", USUAL_HEIGHT_M)
    if height_m is not None:
        height = Prior(GIVEN_SIGMA, "given", height_m)
    focal_kind: Kind = "given" if focal_sigma <= KNOWN_FOCAL else "unknown"
    priors: dict[AnyUnknown, Prior] = {
        Unknown.SIZES: Prior(common_sigma(region), "unknown"),
        Unknown.HEIGHT: height,
        Unknown.FOCAL: Prior(math.hypot(_FOCAL_SIGMA, focal_sigma), focal_kind, focal_px),
        Unknown.SPEED: Prior(_SPEED_SIGMA),
        Unknown.FRAME_RATE: Prior(_CLOCK_SIGMA),
    }
    if baseline_m is not None and baseline_sigma:
        priors[Unknown.BASELINE] = Prior(baseline_sigma, "unknown", baseline_m)
    elif baseline_m is not None:
        sigma = math.hypot(_RIG_SIGMA, scale_sigma)
        priors[Unknown.BASELINE] = Prior(sigma, "given", baseline_m)
    return priors


def mistakes(unknown: Unknown) -> list[PriorPart]:
    """The prior of a given value that is wrong."""
    wrong = {
        Unknown.BASELINE: _WRONG_BASELINE,
        Unknown.HEIGHT: _WRONG_HEIGHT,
        Unknown.OFFSET: _WRONG_OFFSET,
        Unknown.FRAME_RATE: _WRONG_CLOCK,
    }.get(unknown, _WRONG)
    p_known = _P_KNOWN_CLOCK if unknown is Unknown.FRAME_RATE else _P_KNOWN
    parts = [PriorPart(math.log(p), 0.0, sigma) for sigma, p in wrong]
    known = [math.log(factor) for factor, _ in MISTAKES.get(unknown, ())]
    return [*parts, *(PriorPart(math.log(p_known), mean, _KNOWN_SIGMA) for mean in known)]


def unusual() -> PriorPart:
    """The prior of a value that is not known, and not a usual one."""
    return PriorPart(math.log(_P_UNUSUAL), 0.0, _UNUSUAL_SIGMA)
