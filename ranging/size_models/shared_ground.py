"""The road that the objects of one frame share: horizon and camera height, told by the others' sizes and bottom edges.

    bottom_i = horizon + height / z_i        bottom and horizon as tangents below the camera's axis

z_i by size is unsure by some 8 %, and things stand a hand higher or lower than the road (kerbs, camber, hills: measured
on KITTI as 0.14 m, a fifth of them 0.5 m). Far objects hardly care for either: they hold the horizon, and near ones
profit. What an object is told is without its own say, so that it is news to it. One frame alone is looked at; a
horizon tracked over time can be given as the prior.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray

_ROUNDS = 3  # of reweighting
_TAIL = 2.0  # in sigma: where an object begins to count less
_Real = TypeVar("_Real", float, FloatArray)


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundPrior:
    """What is known of the road before a frame is looked at.

    Attributes:
        camera_height_m: above the road,
        camera_height_sigma_m: and how sure that is.
        horizon: tangent below the camera's axis,
        horizon_sigma: and its scale: roads differ by more (Student's t with 2 degrees of freedom).
        kerb_m: standard deviations of how much higher or lower things stand, for the smooth and the rough part: twice
            what is measured, since neighbours stand on the same slope and are no independent witnesses,
        rough_share: and the share of the rough part.
    """

    camera_height_m: float = 1.5
    camera_height_sigma_m: float = 0.3
    horizon: float = 0.0
    horizon_sigma: float = 0.04
    kerb_m: tuple[float, float] = (0.3, 1.0)
    rough_share: float = 0.18

    def faults(self) -> str:
        """What is wrong with the numbers; empty = nothing."""
        if min(self.camera_height_m, self.camera_height_sigma_m, self.horizon_sigma, *self.kerb_m) <= 0:
            return "heights and standard deviations of the ground must be positive"
        if not (0 <= self.rough_share < 1 and np.isfinite(self.horizon)):
            return "rough_share must be between 0 and 1, the horizon must be finite"
        return ""


@dataclass(frozen=True, slots=True)
class Stand:
    """Where objects seem to stand, (N,) each.

    Attributes:
        bottom: tangent of the bottom edge below the camera's axis.
        nearness: 1 / z of the nearest point on the ground, by size.
        sigma: relative standard deviation of that.
        edge_sigma: of `bottom`.
        tells: False = no ground is seen below it.
    """

    bottom: FloatArray
    nearness: FloatArray
    sigma: FloatArray
    edge_sigma: FloatArray
    tells: BoolArray


@dataclass(frozen=True, slots=True)
class SeenGround:
    """What the others tell an object of the road below it, (N,) each.

    Attributes:
        horizon: tangent below the camera's axis.
        height_m: of the camera above the road.
        variance: of the bottom edge that follows from both, at the object's distance.
        is_alone: nobody else tells anything: all that is known is the prior.
    """

    horizon: FloatArray
    height_m: FloatArray
    variance: FloatArray
    is_alone: BoolArray


def seen_by_others(stand: Stand, prior: GroundPrior) -> SeenGround:
    """Robust least squares over all objects of a frame, each told what the others say."""
    x, y = stand.nearness, stand.bottom
    basis = np.array([np.ones_like(x), x, x * x, y, x * y])  # what information about (horizon, height) is made of
    by_size = prior.camera_height_m * x * stand.sigma
    variance = (prior.kerb_m[0] * x) ** 2 + stand.edge_sigma**2 + by_size**2
    sure = stand.tells / variance
    horizon, height, shared = prior.horizon, prior.camera_height_m, np.asarray(prior.horizon_sigma**2)
    for _ in range(_ROUNDS):
        away = y - horizon - height * x
        weight = sure / (1.0 + away * away / (_TAIL**2 * (variance + shared)))
        known = [a + b for a, b in zip(_prior_information(prior, horizon), (basis @ weight).tolist(), strict=True)]
        horizon, height, a, b, c = solve_ground(*known)
        shared = a + x * (2 * b + x * c)
    by_others: FloatArray = np.array(known)[:, None] - basis * weight
    horizons, heights, *covariance = solve_ground(*by_others)
    variances = covariance[0] + x * (2 * covariance[1] + x * covariance[2])
    is_alone = stand.tells == np.count_nonzero(stand.tells)  # of one that tells itself, of none all
    return SeenGround(horizons, heights, variances, is_alone)


def _prior_information(prior: GroundPrior, horizon: float) -> tuple[float, ...]:
    """5 numbers: a horizon far from the expected one widens the prior, as Student's t does."""
    wide = (2.0 + ((horizon - prior.horizon) / prior.horizon_sigma) ** 2) / 3.0
    about, of_height = 1.0 / (prior.horizon_sigma**2 * wide), prior.camera_height_sigma_m**-2
    return about, 0.0, of_height, about * prior.horizon, of_height * prior.camera_height_m


def solve_ground(a: _Real, b: _Real, c: _Real, u: _Real, v: _Real) -> tuple[_Real, _Real, _Real, _Real, _Real]:
    """Horizon and camera height from normal equations, and their covariance: horizon, mixed, height.

    [a b] [horizon]   [u]
    [b c] [height ] = [v]
    """
    scale = 1.0 / (a * c - b * b)
    return (c * u - b * v) * scale, (a * v - b * u) * scale, c * scale, -b * scale, a * scale
