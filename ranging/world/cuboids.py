r"""Cuboids: length, width, height, heading and centre of the tracks of a frame, with standard
deviations.

A cuboid stands upright on the road. Its yaw is the direction of its front, counterclockwise seen
from above, from the optical axis: 0 = it drives as the camera looks, 90 = to the left. Where front
and back cannot be told apart, the yaw may be turned by 180 degrees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.size_models.class_sizes import ClassSizes
from track_range.ranging.size_models.cuboid import box_of_cuboid
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import ObjectMotion
from track_range.ranging.world.placement import Placement, of_turn, point_covariance
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting
from track_range.tracking.tracks import Tracks

# rows: x forward, y left, z up of a camera that looks along x, in its axes (right, down, forward)
_LEVEL_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_PAIRS = ([0, 0, 1], [1, 2, 2])  # of axes: xy, xz, yz
# of the yaw of an object whose motion is unknown: along the drive or parked at an angle
_ANY_YAW_SIGMA_DEG = 30.0
_COURSE_SIGMA_DEG = 10.0  # of the course of an object that moves


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
            _wrapped(self.yaw_deg + mounting.yaw_deg),
        )

    def in_world(self, pose: EgoPose, mounting: Mounting | None = None) -> CuboidPlaces:
        """In the frame `map`, relative to which the camera has a `pose`, whose errors are part of
        the covariance.
        """
        heading_deg = math.degrees(pose.heading_rad)
        turn = Rotation.from_euler("z", 0.0 if math.isnan(heading_deg) else heading_deg, True)
        level = _LEVEL_FROM_CAMERA if mounting is None else _level_of(mounting)
        R = turn.as_matrix() @ level
        along_m = self.centre_m @ R.T
        covariance = R @ self.covariance_m2 @ R.T
        J = np.zeros((len(along_m), 2, 3))  # d (x, y) / d (x, y, heading) of the pose
        J[:, 0, 0] = J[:, 1, 1] = 1.0
        J[:, 0, 2], J[:, 1, 2] = -along_m[:, 1], along_m[:, 0]
        covariance[:, :2, :2] += J @ pose.covariance @ J.transpose(0, 2, 1)
        height_m = math.nan if mounting is None or mounting.z_m is None else mounting.z_m
        centre_m = along_m + np.array([pose.x_m, pose.y_m, height_m])
        return CuboidPlaces(centre_m, covariance, _wrapped(self.yaw_deg + heading_deg))


def _level_of(mounting: Mounting) -> FloatArray:
    """The axes of a camera, in those of the vehicle turned by its yaw: pitch and roll remain."""
    turned = Rotation.from_euler("z", -mounting.yaw_deg, degrees=True).as_matrix()
    return np.asarray(turned @ mounting.vehicle_from_camera)


def _wrapped(deg: FloatArray) -> FloatArray:
    """Angles from -180 to 180 degrees."""
    return np.asarray((deg + 180.0) % 360.0 - 180.0)


class CuboidEstimator:
    """Estimates the cuboids of the tracks of a drive, frame by frame."""

    def __init__(self, mounting: Mounting | None = None, sizes: ClassSizes | None = None) -> None:
        """`mounting` is that of the view, `sizes` those of the classes; None = unknown."""
        self._mounting, self._sizes = mounting, sizes

    def update(
        self,
        tracks: Tracks,
        camera: PinholeCamera,
        placement: Placement,
        distance: Ranges,
        motion: ObjectMotion,
        pose: EgoPose,
    ) -> Cuboids:
        """The cuboids of N tracks, whose `placement` is at the filtered `distance`; `motion` is over
        ground, and `pose` that of the camera.
        """
        if self._sizes is None or not len(tracks):
            return Cuboids.unknown(len(tracks))
        class_id = tracks.class_id
        lwh_m, lwh_sigma_m = self._sizes.lwh_m[class_id], self._sizes.sigma_m[class_id]
        course_deg = _wrapped(motion.heading_deg - math.degrees(pose.heading_rad))
        front_known = np.isfinite(course_deg)
        along_deg = 0.0 if self._mounting is None else -self._mounting.yaw_deg
        yaw_deg = np.where(front_known, course_deg, along_deg)
        yaw_sigma_deg = np.where(front_known, _COURSE_SIGMA_DEG, _ANY_YAW_SIGMA_DEG)
        rays = placement.xyz_m / placement.xyz_m[:, 2:]
        length_m, width_m, height_m = lwh_m.T
        projected = box_of_cuboid(
            np.log([height_m, width_m, length_m]),
            yaw_rad=-np.radians(yaw_deg),
            bearing=rays[:, 0],
            distance_m=distance.distance_m,
            camera_height_m=1.5,
        )
        x_m, z_m = projected.xz_m
        bottom = (tracks.xyxy_px[:, 3] - camera.cy_px) / camera.fy_px
        y_m = bottom / projected.inverse_depths[0] - height_m / 2
        centre_m = np.column_stack([x_m, y_m, z_m])
        covariance_m2 = point_covariance(
            placement.xyz_m, placement.xy_sigma_m, np.hypot(distance.sigma_m, lwh_sigma_m[:, 0] / 2)
        )
        sigma_m = np.sqrt(np.diagonal(covariance_m2, axis1=1, axis2=2))
        first, second = _PAIRS
        correlation = covariance_m2[:, first, second] / (sigma_m[:, first] * sigma_m[:, second])
        cuboids = Cuboids(
            lwh_m=lwh_m,
            lwh_sigma_m=lwh_sigma_m,
            yaw_deg=yaw_deg,
            yaw_sigma_deg=yaw_sigma_deg,
            front_known=front_known,
            centre_m=centre_m,
            centre_sigma_m=sigma_m,
            centre_correlation=correlation,
            vehicle_m=centre_m,
            world_m=centre_m,
        )
        return replace(
            cuboids,
            vehicle_m=cuboids.in_vehicle(self._mounting).centre_m,
            world_m=cuboids.in_world(pose, self._mounting).centre_m,
        )
