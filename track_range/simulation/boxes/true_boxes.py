"""TrueBoxes: the exact boxes, distances and occlusion of all road users in all frames of a drive, without rendering.

Occlusion is approximated: the fraction of a box that the boxes of nearer road users cover, as if these did not overlap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.ranging.evaluation.box_surface import surface_distance_m
from track_range.simulation.world.road_shape import slope_rotation, yaw_rotation
from track_range.simulation.world.scene import Scene
from track_range.simulation.world.trajectories import trajectories
from track_range.simulation.world.truth import corners_m, projected_boxes_px
from track_range.stereo.geometry.camera import PinholeCamera

FARTHEST_M = 90.0
"""Distance up to which road users have boxes, m; the detector finds next to none beyond."""

NEAREST_M = 1.0
"""Smallest distance of the centre of a road user, m."""

SMALLEST_PX = 6.0
"""Smallest height of a box, px; the detector finds next to none below."""


@dataclass(frozen=True, slots=True)
class TrueBoxes:
    """M boxes of a drive, in the order of their frames.

    Attributes:
        frame: (M,) number of the frame.
        user: (M,) row of the scene's road users.
        xyxy_px: (M, 4) box in the left image, clipped to it.
        distance_m: (M,) z at which the ray through the box centre meets the 3-D box.
        hidden_share: (M,) fraction of the box that is covered by nearer boxes.
        outside_share: (M,) fraction of the box outside the image.
    """

    frame: IntArray
    user: IntArray
    xyxy_px: FloatArray
    distance_m: FloatArray
    hidden_share: FloatArray
    outside_share: FloatArray

    @property
    def height_px(self) -> FloatArray:
        """(M,) heights."""
        return np.asarray(self.xyxy_px[:, 3] - self.xyxy_px[:, 1])


def true_boxes(scene: Scene, times_s: FloatArray, camera: PinholeCamera) -> TrueBoxes:
    """The boxes of a scene at the given times (T,)."""
    paths = trajectories(scene.road_users, times_s)
    poses = [scene.pose(time_s) for time_s in times_s.tolist()]
    camera_from_world = np.stack([pose.camera_from_world for pose in poses])
    position_m = np.stack([pose.position_m for pose in poses])
    ego_yaw_rad = np.array([pose.yaw_rad for pose in poses])
    raised_m = np.array([user.raised_m for user in scene.road_users])[:, None]
    world = np.stack(
        [scene.road.x_m(paths.z_m) + paths.across_m, scene.road.y_m(paths.z_m) - raised_m, paths.z_m], axis=2
    )
    location = np.einsum("tij,ntj->nti", camera_from_world, world - position_m)
    x, z = location[:, :, 0], location[:, :, 2]
    reach = camera.width_px / camera.fx_px
    user, frame = np.nonzero((z > NEAREST_M) & (z < FARTHEST_M) & (np.abs(x) < reach * z + 8.0))
    order = np.lexsort((location[user, frame, 2], frame))  # nearest first in each frame
    user, frame = user[order], frame[order]
    at_m, size_m = location[user, frame], scene.size_hwl_m()[user]
    z_m, heading_rad = paths.z_m[user, frame], paths.heading_rad[user, frame]
    yaw_rad = heading_rad + scene.road.yaw_rad(z_m)
    rotations = camera_from_world[frame] @ slope_rotation(scene.road.climb_rad(z_m)) @ yaw_rotation(yaw_rad)
    boxes = projected_boxes_px(corners_m(at_m, size_m, rotations), camera)
    edge = np.array([camera.width_px - 1, camera.height_px - 1] * 2, np.float64)
    inside = np.clip(boxes, 0, edge)
    is_visible = (_areas(inside) > 0) & (inside[:, 3] - inside[:, 1] >= SMALLEST_PX)  # false for NaN
    rows = np.flatnonzero(is_visible)
    frame, user, inside, boxes = frame[rows], user[rows], inside[rows], boxes[rows]
    centre_px = (inside[:, :2] + inside[:, 2:]) / 2
    distance_m = surface_distance_m(
        camera.rays(centre_px),
        at_m[rows],
        size_hwl_m=size_m[rows],
        rotation_y_rad=yaw_rad[rows] - ego_yaw_rad[frame],
    )
    distance_m = np.where(np.isnan(distance_m), at_m[rows, 2], distance_m)
    hidden = _hidden_shares(frame, inside, len(times_s))
    return TrueBoxes(
        frame.astype(np.int64), user.astype(np.int64), inside, distance_m, hidden, 1 - _areas(inside) / _areas(boxes)
    )


def _hidden_shares(frame: IntArray, boxes: FloatArray, n_frames: int) -> FloatArray:
    """(M,) fractions of boxes that nearer ones cover; boxes are sorted by frame, nearest first."""
    hidden = np.zeros(len(frame))
    ends = np.searchsorted(frame, np.arange(n_frames + 1))
    for start, end in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        part = boxes[start:end]
        low = np.maximum(part[:, None, :2], part[None, :, :2])
        high = np.minimum(part[:, None, 2:], part[None, :, 2:])
        common = np.prod(np.clip(high - low, 0, None), axis=2)
        hidden[start:end] = np.tril(common, -1).sum(axis=1) / _areas(part)
    return np.clip(hidden, 0, 1)


def _areas(xyxy_px: FloatArray) -> FloatArray:
    return np.asarray((xyxy_px[:, 2] - xyxy_px[:, 0]) * (xyxy_px[:, 3] - xyxy_px[:, 1]))
