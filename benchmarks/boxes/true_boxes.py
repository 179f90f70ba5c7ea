"""TrueBoxes: the exact boxes, distances and occlusion of all road users in all frames of a drive,
without rendering.

Occlusion is approximated: the fraction of a box that the boxes of nearer road users cover, as if
these did not overlap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.ranging.truth.reference_distance import surface_distance_m
from track_range.simulation.world.road_shape import slope_rotation, yaw_rotation
from track_range.simulation.world.scene import STEP_S, Scene
from track_range.simulation.world.truth import boxes_in_image, corners_m
from track_range.stereo.geometry.camera import PinholeCamera

FARTHEST_M = 160.0  # distance up to which road users have boxes, m; the detector finds none beyond
NEAREST_M = 1.0  # smallest distance of the centre of a road user, m
SMALLEST_PX = 3.5  # smallest height of a box, px; the detector finds none below


@dataclass(frozen=True, slots=True)
class CameraPoses:
    """Rotations (T, 3, 3), positions (T, 3) in world axes of the left camera, and directions (T,)
    of the road there.
    """

    camera_from_world: FloatArray
    position_m: FloatArray
    yaw_rad: FloatArray

    @classmethod
    def of(cls, scene: Scene, times_s: FloatArray) -> CameraPoses:
        poses = [scene.pose(time_s) for time_s in times_s.tolist()]
        return cls(
            np.stack([pose.camera_from_world for pose in poses]),
            np.stack([pose.position_m for pose in poses]),
            np.array([pose.yaw_rad for pose in poses]),
        )

    def image_shifts_px(self, camera: PinholeCamera) -> FloatArray:
        """(T, 2) shift of far objects since the frame before, by yaw and pitch; 0 in the first
        frame.
        """
        before = np.concatenate([self.camera_from_world[:1], self.camera_from_world[:-1]])
        # where the last optical axis is now
        axis = np.einsum("tij,tkj->tik", self.camera_from_world, before)[:, :, 2]
        return np.asarray(axis[:, :2] / axis[:, 2:] * [camera.fx_px, camera.fy_px])


@dataclass(frozen=True, slots=True)
class TrueBoxes:
    """M boxes of a drive, in the order of their frames."""

    frame: IntArray  # (M,) number of the frame
    user: IntArray  # (M,) row of the scene's road users
    xyxy_px: FloatArray  # (M, 4) box of the part in the left image
    distance_m: FloatArray  # (M,) z at which the ray through the box centre meets the 3-D box
    hidden_fraction: FloatArray  # (M,) fraction of the box that is covered by nearer boxes
    overlap_fraction: FloatArray  # (M,) largest fraction of the box inside one other box
    # (M,) distance of the nearer box that covers the largest part; NaN = none
    occluder_m: FloatArray
    # (M,) fraction outside the image of the bounding box of the whole road user
    outside_fraction: FloatArray

    @property
    def height_px(self) -> FloatArray:
        return np.asarray(self.xyxy_px[:, 3] - self.xyxy_px[:, 1])


def true_boxes(
    scene: Scene, times_s: FloatArray, camera: PinholeCamera, *, poses: CameraPoses | None = None
) -> TrueBoxes:
    """The boxes of a scene at the given times (T,); `poses`: of the camera at these times, None =
    computed here.
    """
    poses = poses or CameraPoses.of(scene, times_s)
    camera_from_world, ego_yaw_rad = poses.camera_from_world, poses.yaw_rad
    along_m, location = _locations(scene, times_s, poses)
    headings = np.stack(
        [np.broadcast_to(user.heading_rad(times_s), len(times_s)) for user in scene.road_users]
    )
    x, z = location[:, :, 0], location[:, :, 2]
    reach = camera.width_px / camera.fx_px
    user, frame = np.nonzero((z > NEAREST_M) & (z < FARTHEST_M) & (np.abs(x) < reach * z + 8.0))
    order = np.lexsort((location[user, frame, 2], frame))  # nearest first in each frame
    user, frame = user[order], frame[order]
    at_m, size_m = location[user, frame], scene.size_hwl_m()[user]
    z_m, heading_rad = along_m[user, frame], headings[user, frame]
    yaw_rad = heading_rad + scene.road.yaw_rad(z_m)
    rotations = (
        camera_from_world[frame] @ slope_rotation(scene.road.climb_rad(z_m)) @ yaw_rotation(yaw_rad)
    )
    inside, outside = boxes_in_image(corners_m(at_m, size_m, rotations), camera)
    # false for NaN
    is_visible = (_areas(inside) > 0) & (inside[:, 3] - inside[:, 1] >= SMALLEST_PX)
    rows = np.flatnonzero(is_visible)
    frame, user, inside = frame[rows], user[rows], inside[rows]
    centre_px = (inside[:, :2] + inside[:, 2:]) / 2
    distance_m = surface_distance_m(
        camera.rays(centre_px),
        at_m[rows],
        size_hwl_m=size_m[rows],
        rotation_y_rad=yaw_rad[rows] - ego_yaw_rad[frame],
    )
    distance_m = np.where(np.isnan(distance_m), at_m[rows, 2], distance_m)
    hidden, overlap, occluder = _covered_fractions(frame, inside, len(times_s))
    occluder_m = np.where(occluder >= 0, distance_m[occluder], np.nan)
    return TrueBoxes(frame, user, inside, distance_m, hidden, overlap, occluder_m, outside[rows])


def _locations(
    scene: Scene, times_s: FloatArray, poses: CameraPoses
) -> tuple[FloatArray, FloatArray]:
    """(N, T) z of N road users along the road, and (N, T, 3) their lower centres in the camera's
    frame.
    """
    across_m, z_m = np.swapaxes([user.on_road_m(times_s) for user in scene.road_users], 0, 1)
    raised_m = np.array([user.raised_m for user in scene.road_users])[:, None]
    world = np.stack([scene.road.x_m(z_m, across_m), scene.road.y_m(z_m) - raised_m, z_m], axis=2)
    return z_m, np.einsum("tij,ntj->nti", poses.camera_from_world, world - poses.position_m)


def closing_rates_mps(scene: Scene, times_s: FloatArray) -> FloatArray:
    """(N, T) closing speeds of all road users along the camera's axis, by central differences over
    2 `STEP_S`.
    """
    before, after = (
        _locations(scene, moments_s, CameraPoses.of(scene, moments_s))[1][:, :, 2]
        for moments_s in (times_s - STEP_S, times_s + STEP_S)
    )
    return np.asarray((before - after) / (2 * STEP_S))


def _covered_fractions(
    frame: IntArray, boxes: FloatArray, n_frames: int
) -> tuple[FloatArray, FloatArray, IntArray]:
    """(M,) fractions of boxes that nearer ones cover, the largest that one other box covers, and
    the main occluder.

    The occluder is the row of the nearer box that covers the largest part; -1 = none.

    Boxes are sorted by frame, nearest first.
    """
    hidden, overlap, occluder = np.zeros(len(frame)), np.zeros(len(frame)), np.full(len(frame), -1)
    ends = np.searchsorted(frame, np.arange(n_frames + 1))
    for start, end in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        part = boxes[start:end]
        low = np.maximum(part[:, None, :2], part[None, :, :2])
        high = np.minimum(part[:, None, 2:], part[None, :, 2:])
        common = np.prod(np.clip(high - low, 0, None), axis=2)
        areas = _areas(part)
        nearer = np.tril(common, -1)
        hidden[start:end] = nearer.sum(axis=1) / areas
        if end > start:
            occluder[start:end] = np.where(
                nearer.max(axis=1) > 0, start + nearer.argmax(axis=1), -1
            )
        np.fill_diagonal(common, 0)
        overlap[start:end] = common.max(axis=1, initial=0.0) / areas
    return np.clip(hidden, 0, 1), overlap, occluder


def _areas(xyxy_px: FloatArray) -> FloatArray:
    return np.asarray((xyxy_px[:, 2] - xyxy_px[:, 0]) * (xyxy_px[:, 3] - xyxy_px[:, 1]))
