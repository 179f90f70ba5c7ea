"""Ground plane common to the objects of one frame: horizon and camera height from their sizes and
bottom edges.

    y_i = y0 + H x_i + r_i                  y_i: bottom edge, y0: horizon, as tangents below the camera's axis
    x_i = 1 / z_i                           z_i: distance of the contact point by size, H: camera height
    var r_i = (roll b_i)^2 + (kerb x_i)^2 + (bend / (2 x_i))^2
                                            b_i: tangent of the bearing, bend: curvature of the profile

z_i has a relative error of about 8 %. On KITTI, contact points within 4 m of the camera's axis are
0.1 m above or below the plane, points at 8-14 m 0.36 m, and at 14-25 m 0.6 m: cross slopes, roll
and side roads, which act as an angle times the bearing. A road whose slope changes leaves the plane
by bend z^2 / 2: 0.1 m at 30 m, 0.5 m at 80 m. Far objects, whose contact points matter
little, determine the horizon for near objects. y0 and H are estimated for each object from the
other objects only, so that they are independent of its size: objects of the frame, and objects that
were seen earlier in the drive (`DriveState`), between which the pitch has changed.
"""

from dataclasses import dataclass
from typing import Annotated, NamedTuple, TypeVar

import numpy as np
from pydantic import Field

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.foundation.schemas.validation import Number
from track_range.ranging.size_models.size_model import DriveState, GroundTerms, Sigma

_N_ITERATIONS = 3  # iterations of reweighted least squares
# scale of the robust weights 1 / (1 + (residual / scale)^2) (Cauchy), in standard deviations
_CAUCHY_SIGMA = 2.0

_Real = TypeVar("_Real", float, FloatArray)


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundPrior:
    """Prior of the ground plane; the names of the attributes are keys of curve files.

    The last four are larger than the measured values, since neighbouring objects have correlated
    heights.
    """

    # mean of the camera height H above the road
    camera_height_m: Annotated[Number, Field(ge=0.05, le=100)] = 1.5
    camera_height_sigma_m: Sigma = 0.3  # standard deviation of H
    # mean of the horizon y0, a tangent below the camera's axis
    horizon: Annotated[Number, Field(ge=-10, le=10)] = 0.0
    # scale of y0, with long tails (Student's t with 2 degrees of freedom)
    horizon_sigma: Sigma = 0.04
    # standard deviation of y0 over the time of a drive, by pitch and slope
    pitch_sigma: Sigma = 0.015
    # standard deviation of the cross slope relative to the camera, tangent
    roll_sigma: Sigma = 0.05
    # standard deviations of the height of contact points above the plane ahead, for most objects
    # and for the fraction `rough_share`
    kerb_m: tuple[Sigma, Sigma] = (0.15, 0.5)
    # fraction of objects with the second standard deviation
    rough_share: Annotated[Number, Field(ge=0, lt=1)] = 0.18
    # standard deviation of the curvature of the road's profile, 1/m: that of contact points in
    # KITTI's labels is about 1e-4; design rules allow 1.4e-3 on crests of streets for 50 km/h
    # (AASHTO, A Policy on Geometric Design of Highways and Streets)
    bend_per_m: Sigma = 1.5e-4

    def rough_variance(self, inverse_depth: FloatArray, bearing: FloatArray) -> FloatArray:
        """Variance of bottom edges by cross slope and by the bend of the road."""
        by_bend = 0.5 * self.bend_per_m / inverse_depth
        return np.asarray((self.roll_sigma * bearing) ** 2 + by_bend * by_bend)


class GroundContacts(NamedTuple):
    """Contact points of the objects of a frame, (N,) each."""

    bottom: FloatArray  # tangent y of the bottom edge below the camera's axis
    bearing: FloatArray  # tangent b of the bearing
    inverse_depth: FloatArray  # x = 1 / z of the nearest point on the ground, by size, in 1/m
    sigma: FloatArray  # relative standard deviation of `inverse_depth`
    edge_sigma: FloatArray  # standard deviation of `bottom`
    is_on_ground: BoolArray  # whether the object is on the ground and its bottom edge is visible


class GroundFromOthers(NamedTuple):
    """Ground plane at each object, estimated from the other objects, (N,) each."""

    horizon: FloatArray  # tangent y0 of the horizon below the camera's axis
    height_m: FloatArray  # height H of the camera above the road
    variance: FloatArray  # variance of the bottom edge y0 + H x predicted for the object
    # True if no other object is or was on the ground, so that the estimate is the prior
    is_prior_only: BoolArray
    terms: GroundTerms  # measurements of the ground plane by the objects, for `DriveState`


def ground_from_others(
    contacts: GroundContacts, prior: GroundPrior, drive: DriveState | None = None
) -> GroundFromOthers:
    """Ground plane for each object of a frame, by robust least squares over the other objects.

    `drive` is the state from the objects seen before; None = only this frame is known.
    """
    drive = drive or DriveState()
    x, y, is_on_ground = contacts.inverse_depth, contacts.bottom, contacts.is_on_ground
    # terms of the normal equations for (y0, H)
    basis = np.array([np.ones_like(x), x, x * x, y, x * y])
    of_kerb, of_size = prior.kerb_m[0] * x, prior.camera_height_m * x * contacts.sigma
    rough = of_kerb * of_kerb + prior.rough_variance(x, contacts.bearing)
    other = contacts.edge_sigma * contacts.edge_sigma + of_size * of_size
    R = drive.roughness * rough + other
    information = is_on_ground / R
    y0, H, plane_variance = prior.horizon, prior.camera_height_m, np.asarray(prior.horizon_sigma**2)
    for _ in range(_N_ITERATIONS):
        residual = y - (y0 + H * x)
        spread = _CAUCHY_SIGMA**2 * (R + plane_variance)
        robust = spread / (spread + residual * residual)
        weight = information * robust
        of_frame = (basis @ weight).tolist()
        before = _prior_information(prior, y0, drive)
        terms = [a + b for a, b in zip(before, of_frame, strict=True)]
        y0, H, y0_variance, covariance, H_variance = solve_ground(*terms)
        plane_variance = y0_variance + x * (2 * covariance + x * H_variance)
    horizon, height_m, *P = solve_ground(*(np.array(terms)[:, None] - basis * weight))
    variance = P[0] + x * (2 * P[1] + x * P[2])
    # True for the only object on the ground; for all objects if there is none.
    has_no_other = is_on_ground == np.count_nonzero(is_on_ground)
    residual = y - (y0 + H * x)
    pitch_variance = drive.roughness * prior.pitch_sigma**2
    measured = GroundTerms(
        normal=basis * (is_on_ground * robust / (R + pitch_variance)),
        residual2=residual * residual,
        rough=rough,
        other=other + plane_variance,
        is_on_ground=is_on_ground,
    )
    is_prior_only = has_no_other & (drive.information[0] <= 0.0)
    return GroundFromOthers(horizon, height_m, variance, is_prior_only, measured)


def _prior_information(prior: GroundPrior, y0: float, drive: DriveState) -> tuple[float, ...]:
    """Terms (a, b, c, u, v) of `solve_ground` before the frame: of the prior and the earlier
    objects of the drive.

    The prior's variance of y0 is the variance of Student's t at `y0`. The pitch changes after the
    earlier objects.
    """
    scale = (2.0 + ((y0 - prior.horizon) / prior.horizon_sigma) ** 2) / 3.0
    of_y0, of_H = 1.0 / (prior.horizon_sigma**2 * scale), prior.camera_height_sigma_m**-2
    terms = (of_y0, 0.0, of_H, of_y0 * prior.horizon, of_H * prior.camera_height_m)
    if drive.information[0] <= 0.0:
        return terms
    known = [a + b for a, b in zip(terms, drive.information.tolist(), strict=True)]
    mean_y0, mean_H, y0_variance, covariance, H_variance = solve_ground(*known)
    y0_variance += drive.roughness * prior.pitch_sigma**2
    scale = 1.0 / (y0_variance * H_variance - covariance**2)
    a, b, c = H_variance * scale, -covariance * scale, y0_variance * scale
    return a, b, c, a * mean_y0 + b * mean_H, b * mean_y0 + c * mean_H


def solve_ground(
    a: _Real, b: _Real, c: _Real, u: _Real, v: _Real
) -> tuple[_Real, _Real, _Real, _Real, _Real]:
    """Horizon y0 and camera height H from their normal equations, with var y0, cov(y0, H), var H.

    [a b] [y0]   [u]
    [b c] [H ] = [v]
    """
    scale = 1.0 / (a * c - b * b)
    return (c * u - b * v) * scale, (a * v - b * u) * scale, c * scale, -b * scale, a * scale
