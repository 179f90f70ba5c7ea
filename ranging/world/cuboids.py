r"""Cuboids: length, width, height, heading and centre of the tracks of a frame, with standard
deviations.

A cuboid stands upright on the road. Its yaw is the direction of its front, counterclockwise seen
from above, from the optical axis: 0 = it drives as the camera looks, 90 = to the left. Where front
and back cannot be told apart, the yaw may be turned by 180 degrees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.placement import of_turn
from track_range.stereo.geometry.mounting import Mounting

# rows: x forward, y left, z up of a camera that looks along x, in its axes (right, down, forward)
_LEVEL_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_PAIRS = ([0, 0, 1], [1, 2, 2])  # of axes: xy, xz, yz


@dataclass(frozen=True, slots=True)
class CuboidPlaces:
    """Centres and directions of N cuboids in one set of axes; NaN = unknown."""

    centre_m: FloatArray  # (N, 3)
    covariance_m2: FloatArray  # (N, 3, 3) of the centres
    # (N,) counterclockwise about the axis that points up, from the axis that points forward
    yaw_deg: FloatArray


@dataclass(frozen=True, slots=True)
class Cuboids:
    """Upright cuboids of the N tracks of a frame; NaN = unknown.

    Attributes:
        lwh_m: (N, 3) length, width and height.
        lwh_sigma_m: (N, 3) their standard deviations.
        yaw_deg: (N,) direction of the front from the optical axis, counterclockwise, -180 to 180.
        yaw_sigma_deg: (N,) its standard deviation, modulo 180 where the front is not known.
        front_known: (N,) whether front and back are told apart.
        centre_m: (N, 3) in the camera's axes (right, down, forward).
        centre_sigma_m: (N, 3) standard deviations of the centre.
        centre_correlation: (N, 3) correlations of its x and y, x and z, and y and z.
        vehicle_m: (N, 3) the same centre in the axes of the vehicle (forward, left, up).
        world_m: (N, 3) the same centre in the frame `map`; z is above the road, NaN if the height
            of the camera is unknown.
    """

    lwh_m: FloatArray
    lwh_sigma_m: FloatArray
    yaw_deg: FloatArray
    yaw_sigma_deg: FloatArray
    front_known: BoolArray
    centre_m: FloatArray
    centre_sigma_m: FloatArray
    centre_correlation: FloatArray
    vehicle_m: FloatArray
    world_m: FloatArray

    @classmethod
    def unknown(cls, n: int) -> Cuboids:
        """The cuboids of n tracks of which nothing is known."""
        nan, nan3 = np.full(n, np.nan), np.full((n, 3), np.nan)
        return cls(nan3, nan3, nan, nan, np.zeros(n, np.bool_), nan3, nan3, nan3, nan3, nan3)

    @classmethod
    def of(cls, *, centre_m: FloatArray, covariance_m2: FloatArray, **columns: Any) -> Cuboids:
        """The cuboids with these (N, 3, 3) covariances of the centres, in the camera's axes
        only.
        """
        sigma_m = np.sqrt(np.diagonal(covariance_m2, axis1=1, axis2=2))
        first, second = _PAIRS
        correlation = covariance_m2[:, first, second] / (sigma_m[:, first] * sigma_m[:, second])
        return cls(
            **columns,
            centre_m=centre_m,
            centre_sigma_m=sigma_m,
            centre_correlation=correlation,
            vehicle_m=np.full_like(centre_m, np.nan),
            world_m=np.full_like(centre_m, np.nan),
        )

    def select(self, rows: IntArray) -> Cuboids:
        """The cuboids with these indices."""
        return Cuboids(*(getattr(self, name)[rows] for name in self.__slots__))

    def in_rows(self, rows: IntArray, n: int) -> Cuboids:
        """These cuboids as the rows of n, of which the others are unknown."""
        place, unknown = np.full(n, len(rows)), Cuboids.unknown(1)
        place[rows] = np.arange(len(rows))
        both = ((getattr(self, name), getattr(unknown, name)) for name in self.__slots__)
        return Cuboids(*(np.concatenate(columns)[place] for columns in both))

    @property
    def covariance_m2(self) -> FloatArray:
        """(N, 3, 3) covariances of the centres in the camera's axes."""
        R = np.tile(np.eye(3), (len(self.yaw_deg), 1, 1))
        first, second = _PAIRS
        R[:, first, second] = R[:, second, first] = self.centre_correlation
        return np.asarray(R * self.centre_sigma_m[:, :, None] * self.centre_sigma_m[:, None, :])

    @property
    def in_camera(self) -> CuboidPlaces:
        """In the camera's axes: right, down, forward; yaws are from the axis forward."""
        return CuboidPlaces(self.centre_m, self.covariance_m2, self.yaw_deg)

    def in_vehicle(self, mounting: Mounting | None) -> CuboidPlaces:
        """In the axes of the vehicle: forward, left, up; NaN without a mounting."""
        if mounting is None:
            return Cuboids.unknown(len(self.yaw_deg)).in_camera
        R, sigma_rad = mounting.vehicle_from_camera, math.radians(mounting.sigma_deg)
        covariance = R @ self.covariance_m2 @ R.T + of_turn(self.centre_m @ R.T, sigma_rad)
        return CuboidPlaces(
            mounting.in_vehicle(self.centre_m),
            covariance,
            wrapped_deg(self.yaw_deg + mounting.yaw_deg),
        )

    def in_world(self, pose: EgoPose, mounting: Mounting | None = None) -> CuboidPlaces:
        """In the frame `map`, relative to which the camera has a `pose`, whose errors are part of
        the covariance.
        """
        heading_deg = math.degrees(pose.heading_rad)
        level = _LEVEL_FROM_CAMERA
        if mounting is not None:  # pitch and roll remain
            level = _turn(-math.radians(mounting.yaw_deg)) @ mounting.vehicle_from_camera
        R = _turn(0.0 if math.isnan(pose.heading_rad) else pose.heading_rad) @ level
        along_m = self.centre_m @ R.T
        covariance = R @ self.covariance_m2 @ R.T
        J = np.zeros((len(along_m), 2, 3))  # d (x, y) / d (x, y, heading) of the pose
        J[:, 0, 0] = J[:, 1, 1] = 1.0
        J[:, 0, 2], J[:, 1, 2] = -along_m[:, 1], along_m[:, 0]
        covariance[:, :2, :2] += J @ pose.covariance @ J.transpose(0, 2, 1)
        height_m = math.nan if mounting is None or mounting.z_m is None else mounting.z_m
        centre_m = along_m + np.array([pose.x_m, pose.y_m, height_m])
        return CuboidPlaces(centre_m, covariance, wrapped_deg(self.yaw_deg + heading_deg))


def _turn(angle_rad: float) -> FloatArray:
    """(3, 3) rotation about z."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def wrapped_deg(deg: FloatArray, period_deg: float = 360.0) -> FloatArray:
    """Angles modulo a period, from minus half of it to half of it."""
    return np.asarray((deg + period_deg / 2) % period_deg - period_deg / 2)
