"""Positions of all road users at many times at once, as `RoadUser.on_road_m` and `heading_rad` give them for one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.simulation.world.motion import SpeedChanges
from track_range.simulation.world.scene import STEP_S, RoadUser, Scene


@dataclass(frozen=True, slots=True)
class Trajectories:
    """Positions of N road users at T times, (N, T) each."""

    across_m: FloatArray  # distance to the right of the ego lane's centre
    z_m: FloatArray  # z of the world
    heading_rad: FloatArray  # heading relative to the road's direction, as KITTI's rotation_y

    def row(self, number: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Across, z and heading of one road user, (T,) each."""
        return self.across_m[number], self.z_m[number], self.heading_rad[number]


def trajectories(users: Sequence[RoadUser], times_s: FloatArray) -> Trajectories:
    """The positions of road users at the given times (T,)."""
    if not users:
        empty = np.zeros((0, len(times_s)))
        return Trajectories(empty, empty, empty)
    rows = [_row(user, times_s) for user in users]
    return Trajectories(*(np.stack(column) for column in zip(*rows, strict=True)))


def ego_z_m(scene: Scene, times_s: FloatArray) -> FloatArray:
    """(T,) z of the camera."""
    return distances_m(scene.ego_speed_changes or ((0.0, scene.ego_speed_mps),), times_s)


def distances_m(changes: SpeedChanges, times_s: FloatArray) -> FloatArray:
    """(T,) distance travelled from time 0; `motion.travelled_m` for many times."""
    at_s, mps = np.array(changes, np.float64).T
    total_m = np.concatenate([[0.0], np.cumsum((mps[1:] + mps[:-1]) / 2 * np.diff(at_s))])

    def since_first_m(t_s: FloatArray) -> FloatArray:
        last = np.clip(np.searchsorted(at_s, t_s, side="right") - 1, 0, len(at_s) - 1)
        return np.asarray(total_m[last] + (mps[last] + np.interp(t_s, at_s, mps)) / 2 * (t_s - at_s[last]))

    return since_first_m(np.asarray(times_s, np.float64)) - since_first_m(np.zeros(1))


def _row(user: RoadUser, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    across_m, z_m = _on_road_m(user, times_s)
    if user.lane_change is None:
        return across_m, z_m, np.full(len(times_s), user.rotation_y_rad)
    before, after = (_on_road_m(user, times_s + step_s) for step_s in (-STEP_S, STEP_S))
    across, ahead = after[0] - before[0], after[1] - before[1]
    return across_m, z_m, np.where(ahead == 0, user.rotation_y_rad, np.arctan2(-ahead, across))


def _on_road_m(user: RoadUser, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    distance_m = distances_m(user.speed_changes or ((0.0, user.speed_mps),), times_s)
    moved_m = user.lane_change.moved_m(times_s) if user.lane_change else 0.0
    x_m, z_m = user.start_xz_m
    return x_m + distance_m * np.cos(user.rotation_y_rad) + moved_m, z_m - distance_m * np.sin(user.rotation_y_rad)
