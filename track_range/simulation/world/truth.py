"""Exact labels of a scene, from its geometry alone: 2-D boxes, 3-D boxes and how much of each road user is hidden.

A 2-D box is KITTI's: the bounding box of the projected 3-D box, clipped to the image (to pixel centres 0 .. size - 1).
What is hidden is counted on a grid of rays through the box: a ray that meets the object's 3-D box sees it unless it
meets another one nearer, or, where the rendered depth is at hand, unless anything at all was drawn nearer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from track_range.detection.formats.kitti import KittiLabels
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.evaluation.box_surface import surface_distance_m
from track_range.simulation.world.road_shape import turned_about_y
from track_range.simulation.world.scene import Scene
from track_range.stereo.geometry.camera import PinholeCamera

FARTHEST_M = 100.0
DONT_CARE_BELOW_PX = 10.0
"""Lower boxes become DontCare regions."""

NEAR_M = 0.1
"""3-D boxes that reach behind the camera are cut off here before they are projected."""

PARTLY_SEEN, LARGELY_SEEN = 0.5, 0.85
"""Visible share from which KITTI's `occluded` is 1 and 0; 2 below."""

UNCUT, HALF_CUT = 0.02, 0.5
"""Share of the box outside the image above which KITTI's tracking `truncated` is 1 and 2."""

N_RAYS = 12
"""Per side of the grid through a box."""

DEPTH_SLACK_M, DEPTH_SLACK = 0.3, 0.03
"""What was drawn hides a 3-D box only if it is nearer than the box by more: metres, and a share of the depth."""

_EDGES = np.array([(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)])


@dataclass(frozen=True, slots=True)
class SeenObjects:
    """What a frame shows, nearest object first.

    Attributes:
        row: (N,) in the scene's road users.
        labels: (N,) KITTI's rows.
        visible_share: (N,) of each object's own part of the image: neither outside nor hidden.
    """

    row: IntArray
    labels: KittiLabels
    visible_share: FloatArray


def label_scene(scene: Scene, times_s: Sequence[float], *, camera: PinholeCamera) -> KittiLabels:
    """The labels of every frame, nearest object first; what is hidden, behind, outside or beyond 100 m is left out."""
    return joined([seen_at(scene, at_s, frame=frame, camera=camera).labels for frame, at_s in enumerate(times_s)])


def joined(frames: Sequence[KittiLabels]) -> KittiLabels:
    """The labels of several frames as one."""
    columns = [
        np.concatenate([getattr(labels, name) for labels in frames]) for name in KittiLabels.__dataclass_fields__
    ]
    return KittiLabels(*columns)


def box_corners_m(location_m: FloatArray, *, size_hwl_m: FloatArray, rotation_y_rad: FloatArray) -> FloatArray:
    """(N, 8, 3) corners of 3-D boxes: four on the road, then the four above them in the same order."""
    return corners_m(location_m, size_hwl_m, turned_about_y(rotation_y_rad))


def corners_m(location_m: FloatArray, size_hwl_m: FloatArray, turns: FloatArray) -> FloatArray:
    """(N, 8, 3) the same for boxes that are turned (N, 3, 3) anyhow."""
    height, width, length = size_hwl_m.T[:, :, None]
    x = length / 2 * np.array([1, 1, -1, -1, 1, 1, -1, -1])
    y = -height * np.array([0, 0, 0, 0, 1, 1, 1, 1])
    z = width / 2 * np.array([1, -1, -1, 1, 1, -1, -1, 1])
    return np.asarray(np.stack([x, y, z], axis=2) @ turns.transpose(0, 2, 1) + location_m[:, None, :])


def projected_boxes_px(boxes_m: FloatArray, camera: PinholeCamera) -> FloatArray:
    """(N, 4) bounding boxes of 3-D boxes (N, 8, 3), not clipped to the image; NaN where all of one is behind."""
    start, end = boxes_m[:, _EDGES[:, 0]], boxes_m[:, _EDGES[:, 1]]
    rise = end[:, :, 2] - start[:, :, 2]
    share = np.clip((NEAR_M - start[:, :, 2]) / np.where(rise == 0, 1.0, rise), 0, 1)
    cut = start + share[:, :, None] * (end - start)  # where an edge crosses the near plane; else one of its ends
    points = np.concatenate([boxes_m, cut], axis=1)
    seen = points[:, :, 2] >= NEAR_M - 1e-9
    xy_px = camera.project(points.reshape(-1, 3)).reshape(*points.shape[:2], 2)
    low = np.where(seen[:, :, None], xy_px, np.inf).min(axis=1)
    high = np.where(seen[:, :, None], xy_px, -np.inf).max(axis=1)
    boxes = np.concatenate([low, high], axis=1)
    return np.where(np.isfinite(boxes), boxes, np.nan)


def visible_shares(
    xyxy_px: FloatArray,
    location_m: FloatArray,
    *,
    size_hwl_m: FloatArray,
    rotation_y_rad: FloatArray,
    camera: PinholeCamera,
) -> FloatArray:
    """(N,) share of each object's own rays, in its box in the image, that no other object's 3-D box stops before."""
    n = len(xyxy_px)
    rays = camera.rays(_grid_px(xyxy_px))
    n_rays = len(rays)
    met_m = surface_distance_m(
        np.tile(rays, (n, 1)),
        np.repeat(location_m, n_rays, axis=0),
        size_hwl_m=np.repeat(size_hwl_m, n_rays, axis=0),
        rotation_y_rad=np.repeat(rotation_y_rad, n_rays),
    ).reshape(n, n, N_RAYS**2)  # object that is met, object whose box the ray belongs to, ray
    first_m = np.where(np.isnan(met_m), np.inf, met_m).min(axis=0, initial=np.inf)
    own_m = met_m[np.arange(n), np.arange(n)]
    n_own = np.isfinite(own_m).sum(axis=1)
    n_seen = (own_m <= first_m).sum(axis=1)
    return np.asarray(n_seen / np.maximum(n_own, 1), np.float64)


def _drawn_shares(
    xyxy_px: FloatArray,
    boxes: tuple[FloatArray, FloatArray, FloatArray],
    camera: PinholeCamera,
    inverse_depth: FloatArray,
) -> FloatArray:
    """(N,) as `visible_shares`, against everything that was drawn; `boxes` are locations, sizes and yaws."""
    location, size, yaw = (np.repeat(part, N_RAYS**2, axis=0) for part in boxes)
    at_px = _grid_px(xyxy_px)
    own_m = surface_distance_m(camera.rays(at_px), location, size_hwl_m=size, rotation_y_rad=yaw)
    samples = inverse_depth.shape[0] / camera.height_px
    edge = np.array(inverse_depth.shape[::-1]) - 1
    column, row = np.clip(np.rint((at_px + 0.5) * samples - 0.5), 0, edge).astype(int).T
    nearest_m = np.maximum(own_m * (1 - DEPTH_SLACK) - DEPTH_SLACK_M, NEAR_M)
    is_seen = inverse_depth[row, column] * nearest_m <= 1  # false for NaN
    n_own = np.isfinite(own_m).reshape(-1, N_RAYS**2).sum(axis=1)
    return np.asarray(is_seen.reshape(-1, N_RAYS**2).sum(axis=1) / np.maximum(n_own, 1), np.float64)


def _grid_px(xyxy_px: FloatArray) -> FloatArray:
    """(N * N_RAYS^2, 2) pixels spread evenly over each box."""
    steps = (np.arange(N_RAYS) + 0.5) / N_RAYS
    x_px = xyxy_px[:, :1] + (xyxy_px[:, 2:3] - xyxy_px[:, :1]) * np.tile(steps, N_RAYS)
    y_px = xyxy_px[:, 1:2] + (xyxy_px[:, 3:] - xyxy_px[:, 1:2]) * np.repeat(steps, N_RAYS)
    return np.stack([x_px.ravel(), y_px.ravel()], axis=1)


def seen_at(
    scene: Scene, time_s: float, *, frame: int, camera: PinholeCamera, inverse_depth: FloatArray | None = None
) -> SeenObjects:
    """What the left camera sees at that time.

    Args:
        scene: who is there.
        time_s: when.
        frame: the number that the labels get.
        camera: the left one.
        inverse_depth: (k H, k W) 1/m of what was drawn, k samples per pixel and axis; None = only road users hide
            each other.
    """
    location, size, yaw = scene.location_m(time_s), scene.size_hwl_m(), scene.rotation_y_rad(time_s)
    unclipped = projected_boxes_px(corners_m(location, size, scene.turns(time_s)), camera)
    edge = np.array([camera.width_px - 1, camera.height_px - 1] * 2, np.float64)
    inside = np.clip(unclipped, 0, edge)
    nearest_first = np.argsort(location[:, 2], kind="stable")
    in_view = (_areas(inside) > 0) & (location[:, 2] < FARTHEST_M)  # false for NaN
    rows = nearest_first[in_view[nearest_first]]
    location, size, yaw, unclipped, inside = (part[rows] for part in (location, size, yaw, unclipped, inside))
    if inverse_depth is None:
        shares = visible_shares(inside, location, size_hwl_m=size, rotation_y_rad=yaw, camera=camera)
    else:
        shares = _drawn_shares(inside, (location, size, yaw), camera, inverse_depth)
    outside = 1 - _areas(inside) / _areas(unclipped)
    labels = KittiLabels(
        frame=np.full(len(rows), frame, np.int64),
        track_id=np.array([scene.road_users[row].track_id for row in rows], np.int64),
        kitti_type=np.array([scene.road_users[row].kitti_type for row in rows], np.str_),
        truncated=np.digitize(outside, [UNCUT, HALF_CUT]).astype(np.float64),
        occluded=np.where(shares >= LARGELY_SEEN, 0, np.where(shares >= PARTLY_SEEN, 1, 2)).astype(np.int64),
        xyxy_px=inside,
        size_hwl_m=size,
        location_m=location,
        rotation_y_rad=yaw,
        score=np.full(len(rows), np.nan),
    )
    kept = np.flatnonzero(shares > 0)
    is_small = (inside[:, 3] - inside[:, 1] < DONT_CARE_BELOW_PX)[kept]
    seen_share = (shares * (1 - outside))[kept]
    return SeenObjects(rows[kept].astype(np.int64), _without_care(labels.select(kept), is_small), seen_share)


def _without_care(labels: KittiLabels, is_small: BoolArray) -> KittiLabels:
    """The labels with the marked ones turned into DontCare regions, as KITTI writes them."""
    return KittiLabels(
        frame=labels.frame,
        track_id=np.where(is_small, -1, labels.track_id),
        kitti_type=np.where(is_small, "DontCare", labels.kitti_type),
        truncated=np.where(is_small, -1.0, labels.truncated),
        occluded=np.where(is_small, -1, labels.occluded),
        xyxy_px=labels.xyxy_px,
        size_hwl_m=np.where(is_small[:, None], -1000.0, labels.size_hwl_m),
        location_m=np.where(is_small[:, None], -1000.0, labels.location_m),
        rotation_y_rad=np.where(is_small, -10.0, labels.rotation_y_rad),
        score=labels.score,
    )


def _areas(xyxy_px: FloatArray) -> FloatArray:
    return np.asarray((xyxy_px[:, 2] - xyxy_px[:, 0]) * (xyxy_px[:, 3] - xyxy_px[:, 1]))
