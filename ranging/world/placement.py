r"""Placement: where the tracks of a frame are and how they move, relative to the camera and in the
axes of the vehicle, with covariances.

The point of a track is the filtered distance z along the ray r = (r_x, r_y, 1) through the middle of
its box, and its relative velocity is the change of this point per second in the axes of the camera:

    p = z r           P = sigma_z^2 r r^T + z^2 diag(s_x^2, s_y^2, 0)         s: of the ray, by box and camera
    p' = (u - U - w z, 0, z')       u: lateral speed over ground; U, w: speed to the right, yaw rate of the camera

The error of the distance dominates P, so that x and y are correlated with z. A mounting (R, t) gives
the vehicle's axes; the errors of its three angles, one sigma each, turn what is far away:

    p_v = R p + t     P_v = R P R^T + sigma^2 (|p|^2 I - q q^T)               q = R p

and the same for velocities without t, since the camera does not move in its vehicle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.track_state import TrackState
from track_range.ranging.filtering.lateral_motion import LateralMotion
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.world.object_motion import RATE_FACTOR
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.odometry.ego_motion import EgoMotion

# of the speed along the camera's y axis, which no filter has: a slope of 3 % at 10 m/s
_VERTICAL_MPS = 0.3
_MAX_GAP_S = 10.0  # after which a track that comes back is a new one


@dataclass(frozen=True, slots=True)
class PointStates:
    """Positions of N tracks, and their velocities relative to the camera, in one set of axes; NaN =
    unknown.
    """

    position_m: FloatArray  # (N, 3)
    covariance_m2: FloatArray  # (N, 3, 3) of the positions
    velocity_mps: FloatArray  # (N, 3) change of the positions per second
    velocity_covariance_m2ps2: FloatArray  # (N, 3, 3)

    def turned(self, mounting: Mounting | None) -> PointStates:
        """The same of camera axes in the axes of the vehicle; NaN without a mounting."""
        if mounting is None:
            points = np.full_like(self.position_m, np.nan)
            matrices = np.full_like(self.covariance_m2, np.nan)
            return PointStates(points, matrices, points, matrices)
        R = mounting.vehicle_from_camera
        sigma_rad = math.radians(mounting.sigma_deg)
        from_camera_m, velocity_mps = self.position_m @ R.T, self.velocity_mps @ R.T
        return PointStates(
            from_camera_m + mounting.place_m,
            R @ self.covariance_m2 @ R.T + of_turn(from_camera_m, sigma_rad),
            velocity_mps,
            R @ self.velocity_covariance_m2ps2 @ R.T + of_turn(velocity_mps, sigma_rad),
        )


@dataclass(frozen=True, slots=True)
class Placement:
    """Points and lateral motion of the N tracks of a frame, from their filtered distances; NaN =
    unknown.
    """

    xyz_m: FloatArray  # (N, 3) in the camera's axes, at the filtered distance
    xy_sigma_m: FloatArray  # (N, 2) standard deviations of x and y
    lateral_mps: FloatArray  # (N,) change of x per second, positive = to the right
    lateral_sigma_mps: FloatArray  # (N,)
    age_s: FloatArray  # (N,) since the first frame of the track
    unobserved_s: FloatArray  # (N,) since its last detection; 0 = in this frame
    vehicle_m: FloatArray  # (N, 3) the same points in the axes of the vehicle
    mounting: Mounting | None = None  # of the view; None = unknown

    @classmethod
    def unknown(cls, n: int) -> Placement:
        """The placement of n tracks whose distances are unknown."""
        nan = np.full(n, np.nan)
        points = np.full((n, 3), np.nan)
        return cls(points, points[:, :2], nan, nan, nan, nan, points)

    def in_camera(self, sigma_m: FloatArray, rate: tuple[FloatArray, FloatArray]) -> PointStates:
        """States in the axes of the camera: right, down, forward; `sigma_m` (N,) is that of the
        filtered distances, `rate` their change per second (N,) and its standard deviation.
        """
        rate_mps, rate_sigma_mps = rate
        n = len(sigma_m)
        velocity_mps = np.stack([self.lateral_mps, 0.0 * rate_mps, rate_mps], axis=1)
        rays = self.xyz_m / self.xyz_m[:, 2:]
        # an error of the rate is one of the lateral speed, in proportion to the bearing
        covariance = np.zeros((n, 3, 3))
        bearing = rays[:, 0]
        along = rate_sigma_mps**2
        covariance[:, 2, 2] = along
        covariance[:, 0, 0] = self.lateral_sigma_mps**2 + bearing**2 * along
        covariance[:, 0, 2] = covariance[:, 2, 0] = bearing * along
        covariance[:, 1, 1] = _VERTICAL_MPS**2
        return PointStates(
            self.xyz_m,
            point_covariance(self.xyz_m, self.xy_sigma_m, sigma_m),
            velocity_mps,
            covariance,
        )


def point_covariance(xyz_m: FloatArray, xy_sigma_m: FloatArray, sigma_m: FloatArray) -> FloatArray:
    """(N, 3, 3) covariances of points (N, 3) on rays, from the standard deviations of x and y (N, 2)
    and of z (N,).
    """
    along = xyz_m / xyz_m[:, 2:] * sigma_m[:, None]
    covariance = along[:, :, None] * along[:, None, :]
    covariance[:, [0, 1], [0, 1]] += np.maximum(xy_sigma_m**2 - along[:, :2] ** 2, 0.0)
    return np.asarray(covariance)


def of_turn(vectors: FloatArray, sigma_rad: float) -> FloatArray:
    """(N, 3, 3) covariances of vectors (N, 3) by errors of three angles."""
    outer = vectors[:, :, None] * vectors[:, None, :]
    squared = (vectors * vectors).sum(axis=1)[:, None, None]
    return np.asarray(sigma_rad**2 * (squared * np.eye(3) - outer))


class Placements:
    """Places the tracks of a drive frame by frame; it remembers since when each is known."""

    def __init__(self, mounting: Mounting | None = None) -> None:
        """`mounting` is that of the view; None = unknown, and so are the vehicle's axes."""
        self._mounting = mounting
        self._tracks = TrackState(np.full(2, np.nan))  # first frame and last detection

    def update(
        self,
        track_id: IntArray,
        observed: BoolArray,
        time_s: float,
        *,
        rays: FloatArray,
        direction_sigma: FloatArray,
        filtered: Ranges,
        lateral: LateralMotion,
        ego: EgoMotion,
    ) -> Placement:
        """The placement of N tracks at `time_s`: rays (N, 3) with z = 1 through their boxes, the
        standard deviations (N, 2) of their directions, and the `filtered` distances.
        """
        distance_m, sigma_m = filtered.distance_m, filtered.sigma_m
        own_mps = 0.0 if math.isnan(ego.right_mps) else ego.right_mps
        turn_rad_s = 0.0 if math.isnan(ego.yaw_rad_s) else ego.yaw_rad_s
        lateral_mps = lateral.state.v - own_mps - turn_rad_s * distance_m
        filter_sigma_mps = math.sqrt(RATE_FACTOR) * np.sqrt(lateral.state.P_vv)
        # an error of the distance is one of the scale of the speed across the axis
        scale_sigma_mps = sigma_m / distance_m * lateral_mps
        first_s, last_s = self._tracks.get(track_id)
        first_s = np.where(np.isnan(first_s), time_s, first_s)
        last_s = np.where(observed | np.isnan(last_s), time_s, last_s)
        is_recent = time_s - self._tracks.known[1] <= _MAX_GAP_S
        self._tracks.put(track_id, np.array([first_s, last_s]), keep_known=is_recent)
        xyz_m = rays * distance_m[:, None]
        placement = Placement(
            xyz_m=xyz_m,
            xy_sigma_m=np.hypot(
                rays[:, :2] * sigma_m[:, None], direction_sigma * distance_m[:, None]
            ),
            lateral_mps=lateral_mps,
            lateral_sigma_mps=np.hypot(filter_sigma_mps, scale_sigma_mps),
            age_s=time_s - first_s,
            unobserved_s=time_s - last_s,
            vehicle_m=np.full_like(xyz_m, np.nan),
            mounting=self._mounting,
        )
        if self._mounting is None:
            return placement
        return replace(placement, vehicle_m=self._mounting.in_vehicle(xyz_m))
