"""What a drive tells about its cameras: the unknowns, and what is known of each before the drive.

An unknown is the logarithm of the factor by which the assumed value is too large. To add one, add a
member of `Unknown` and its prior in `camera_priors`; evidence then names it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from track_range.ranging.size_models.region import Region

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


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of a value before the drive."""

    sigma: float  # standard deviation of its logarithm
    kind: Kind = "given"
    value: float = 1.0  # the assumed value, in m or px; 1 = a factor


CameraPriors = Mapping[Unknown, Prior]
"""Priors by unknown; what the cameras do not have is absent."""

USUAL_HEIGHT_M, _HEIGHT_SIGMA = 1.45, 0.22  # of cameras behind a windscreen
# of calibrations, of a given height, and of the scale of receivers
_RIG_SIGMA, _FOCAL_SIGMA, _GIVEN_SIGMA, _SPEED_SIGMA = 0.025, 0.02, 0.03, 0.015
_SIZES_SIGMA = 0.07, 0.085  # if the region is known, and if it is not


def camera_priors(
    focal_px: float,
    *,
    focal_sigma: float = 0.0,
    baseline_m: float | None = None,
    baseline_sigma: float = 0.0,
    height_m: float | None = None,
    region: Region = "unknown",
) -> CameraPriors:
    """The priors of one camera, or of the pair with the baseline.

    `focal_sigma` and `baseline_sigma` are relative, 0 = calibrated; `height_m` is a given height
    above the road, None = a usual one.
    """
    height = Prior(_HEIGHT_SIGMA, "usual", USUAL_HEIGHT_M)
    if height_m is not None:
        height = Prior(_GIVEN_SIGMA, "given", height_m)
    priors = {
        Unknown.SIZES: Prior(_SIZES_SIGMA[region == "unknown"]),
        Unknown.HEIGHT: height,
        Unknown.FOCAL: Prior(math.hypot(_FOCAL_SIGMA, focal_sigma), "given", focal_px),
        Unknown.SPEED: Prior(_SPEED_SIGMA),
    }
    if baseline_m is not None and baseline_sigma:
        priors[Unknown.BASELINE] = Prior(baseline_sigma, "unknown", baseline_m)
    elif baseline_m is not None:
        priors[Unknown.BASELINE] = Prior(_RIG_SIGMA, "given", baseline_m)
    return priors
