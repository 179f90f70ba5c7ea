"""Exact labels of a scene from its geometry: 2-D boxes, 3-D boxes and occlusion of each road user.

A 2-D box is the bounding box of the part of the projected 3-D box that is inside the image (pixel
centres 0 to size - 1): of a car beside the camera, it ends where the car leaves the image.
Occlusion is measured with a grid of rays through the box: a ray that meets the object's 3-D box
sees it unless another object's 3-D box, or, if the rendered depth is given, any drawn surface is
nearer.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.truth.reference_distance import surface_distance_m
from track_range.simulation.world.scene import Scene
from track_range.stereo.geometry.camera import PinholeCamera

FARTHEST_M = 100.0  # distance up to which objects are labelled
DONT_CARE_BELOW_PX = 10.0  # height of a box, px, below which it becomes a DontCare region
NEAR_M = 0.1  # depth of the near plane at which 3-D boxes are clipped before projection
# smallest fractions for KITTI's `occluded` = 1 and 0; below, it is 2
PARTLY_VISIBLE, LARGELY_VISIBLE = 0.5, 0.85
# smallest fractions outside the image, of the projected box, for `truncated` = 1 and 2
UNCUT, HALF_CUT = 0.02, 0.5
N_RAYS = 12  # number of rays per side of the grid through a box
# in m + fraction of the depth, by which a surface hides a 3-D box
DEPTH_SLACK_M, DEPTH_SLACK = 0.3, 0.03
_EDGES = np.array(
    [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
)


@dataclass(frozen=True, slots=True)
class VisibleObjects:
    """The visible objects of a frame, nearest first."""

    row: IntArray  # (N,) rows of the scene's road users
    labels: KittiLabels  # (N,) KITTI labels
    # (N,) fraction of each object's projection that is inside the image and not hidden
    visible_share: FloatArray


def label_scene(scene: Scene, times_s: Sequence[float], *, camera: PinholeCamera) -> KittiLabels:
    """The labels of all frames, nearest object first; without objects that are hidden, out of view
    or beyond 100 m.
    """
    frames = [
        visible_objects(scene, time_s, frame=frame, camera=camera).labels
        for frame, time_s in enumerate(times_s)
    ]
    return joined(frames)


def joined(frames: Sequence[KittiLabels]) -> KittiLabels:
    """The labels of several frames, concatenated."""
    names = KittiLabels.__dataclass_fields__
    return KittiLabels(
        *(np.concatenate([getattr(labels, name) for labels in frames]) for name in names)
    )


def corners_m(location_m: FloatArray, size_hwl_m: FloatArray, rotations: FloatArray) -> FloatArray:
    """(N, 8, 3) corners of 3-D boxes with rotations (N, 3, 3): four on the road, then the four
    above them.
    """
    height, width, length = size_hwl_m.T[:, :, None]
    x = length / 2 * np.array([1, 1, -1, -1, 1, 1, -1, -1])
    y = -height * np.array([0, 0, 0, 0, 1, 1, 1, 1])
    z = width / 2 * np.array([1, -1, -1, 1, 1, -1, -1, 1])
    return np.asarray(
        np.stack([x, y, z], axis=2) @ rotations.transpose(0, 2, 1) + location_m[:, None, :]
    )


def boxes_in_image(boxes_m: FloatArray, camera: PinholeCamera) -> tuple[FloatArray, FloatArray]:
    """(N, 4) bounding boxes in pixels of the parts inside the image of 3-D boxes with corners (N,
    8, 3); NaN = no part.

    Also (N,) the fraction of the bounding box of the whole projection that is outside; NaN behind
    the camera.

    The projection S of a 3-D box is convex. Its part in the image therefore has the rows of its
    part between the left and the right border, as far as they are rows of the image. The rows of
    that part are bounded by the points of S between the two borders, and by the crossings of
    segments of S with the borders. The same holds for the columns.
    """
    xy_px, is_in_front = _projected_points(boxes_m, camera)
    boxes = np.concatenate(_extremes(np.where(is_in_front[:, :, None], xy_px, np.nan)), axis=1)
    limit_px = np.array([camera.width_px - 1, camera.height_px - 1] * 2, np.float64)
    outside_fraction = 1 - _areas(np.clip(boxes, 0, limit_px)) / _areas(boxes)
    return _clipped_to_image(boxes, xy_px, is_in_front, limit_px[:2]), outside_fraction


def _clipped_to_image(
    boxes: FloatArray, xy_px: FloatArray, is_in_front: BoolArray, edge: FloatArray
) -> FloatArray:
    """See `boxes_in_image`; `boxes` (N, 4) are not clipped, `edge` (2,) is the largest x and y in
    the image.
    """
    cut = np.flatnonzero(((boxes[:, :2] < 0) | (boxes[:, 2:] > edge)).any(axis=1))
    if not len(cut):
        return boxes
    boxes, points, exists = boxes.copy(), xy_px[cut], is_in_front[cut]
    for axis in (0, 1):
        inner, others = points[:, :, 1 - axis], points[:, :, axis]
        values = [np.where(exists & (inner >= 0) & (inner <= edge[1 - axis]), others, np.nan)]
        rise = inner[:, None, :] - inner[:, :, None]
        is_segment = exists[:, None, :] & exists[:, :, None] & (rise != 0)
        for border in (0.0, edge[1 - axis]):
            fraction = (border - inner[:, :, None]) / np.where(is_segment, rise, 1.0)
            crossing = others[:, :, None] + fraction * (others[:, None, :] - others[:, :, None])
            crosses = is_segment & (fraction >= 0) & (fraction <= 1)
            values.append(np.where(crosses, crossing, np.nan).reshape(len(cut), -1))
        low, high = _extremes(np.concatenate(values, axis=1))
        is_inside = (high >= 0) & (low <= edge[axis])  # false for NaN
        boxes[cut, axis] = np.where(is_inside, np.clip(low, 0, edge[axis]), np.nan)
        boxes[cut, axis + 2] = np.where(is_inside, np.clip(high, 0, edge[axis]), np.nan)
    return boxes


def _projected_points(boxes_m: FloatArray, camera: PinholeCamera) -> tuple[FloatArray, BoolArray]:
    """(N, 20, 2) pixels of the corners of 3-D boxes (N, 8, 3) and of their edges' intersections
    with the near plane.

    Also (N, 20) which of them are in front of the camera.
    """
    start, end = boxes_m[:, _EDGES[:, 0]], boxes_m[:, _EDGES[:, 1]]
    rise = end[:, :, 2] - start[:, :, 2]
    fraction = np.clip((NEAR_M - start[:, :, 2]) / np.where(rise == 0, 1.0, rise), 0, 1)
    # where an edge meets the near plane, else one of its ends
    cut = start + fraction[:, :, None] * (end - start)
    points = np.concatenate([boxes_m, cut], axis=1)
    is_in_front = points[:, :, 2] >= NEAR_M - 1e-9
    xy_px = camera.project(points.reshape(-1, 3)).reshape(*points.shape[:2], 2)
    return xy_px, np.asarray(is_in_front)


def _extremes(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Smallest and largest values along axis 1, without NaN; NaN if all values are NaN."""
    return np.fmin.reduce(values, axis=1), np.fmax.reduce(values, axis=1)


def visible_fractions(
    xyxy_px: FloatArray,
    location_m: FloatArray,
    *,
    size_hwl_m: FloatArray,
    rotation_y_rad: FloatArray,
    camera: PinholeCamera,
    inverse_depth: FloatArray | None = None,
) -> FloatArray:
    """(N,) fraction of the rays through an object's box and 3-D box that nothing nearer blocks.

    `inverse_depth` (k H, k W) is 1/z of the drawn surfaces, with k samples per pixel and axis;
    without it, only the 3-D boxes of other objects block rays.
    """
    n, n_rays, steps = len(xyxy_px), N_RAYS**2, (np.arange(N_RAYS) + 0.5) / N_RAYS
    x_px = xyxy_px[:, :1] + (xyxy_px[:, 2:3] - xyxy_px[:, :1]) * np.tile(steps, N_RAYS)
    y_px = xyxy_px[:, 1:2] + (xyxy_px[:, 3:] - xyxy_px[:, 1:2]) * np.repeat(steps, N_RAYS)
    grid_px = np.stack([x_px.ravel(), y_px.ravel()], axis=1)
    n_repeats = n * n_rays if inverse_depth is None else n_rays
    distance_m = surface_distance_m(
        np.tile(camera.rays(grid_px), (n if inverse_depth is None else 1, 1)),
        np.repeat(location_m, n_repeats, axis=0),
        size_hwl_m=np.repeat(size_hwl_m, n_repeats, axis=0),
        rotation_y_rad=np.repeat(rotation_y_rad, n_repeats),
    )
    if inverse_depth is None:
        # axes: object met by the ray, object of the box, ray
        by_object_m = distance_m.reshape(n, n, n_rays)
        own_m = by_object_m[np.arange(n), np.arange(n)]
        is_visible = own_m <= np.where(np.isnan(by_object_m), np.inf, by_object_m).min(
            axis=0, initial=np.inf
        )
    else:
        own_m = distance_m.reshape(n, n_rays)
        samples, edge = (
            inverse_depth.shape[0] / camera.height_px,
            np.array(inverse_depth.shape[::-1]) - 1,
        )
        column, row = (
            np.clip(np.rint((grid_px + 0.5) * samples - 0.5), 0, edge)
            .astype(int)
            .T.reshape(2, n, n_rays)
        )
        nearest_m = np.maximum(own_m * (1 - DEPTH_SLACK) - DEPTH_SLACK_M, NEAR_M)
        is_visible = inverse_depth[row, column] * nearest_m <= 1  # false for NaN
    return np.asarray(
        is_visible.sum(axis=1) / np.maximum(np.isfinite(own_m).sum(axis=1), 1), np.float64
    )


def visible_objects(
    scene: Scene,
    time_s: float,
    *,
    frame: int,
    camera: PinholeCamera,
    inverse_depth: FloatArray | None = None,
) -> VisibleObjects:
    """The objects that the left camera sees, labelled for a frame number; `inverse_depth`: see
    `visible_fractions`.
    """
    location, size, yaw = scene.location_m(time_s), scene.size_hwl_m(), scene.rotation_y_rad(time_s)
    inside, outside = boxes_in_image(corners_m(location, size, scene.rotations(time_s)), camera)
    nearest_first = np.argsort(location[:, 2], kind="stable")
    in_view = (_areas(inside) > 0) & (location[:, 2] < FARTHEST_M)  # false for NaN
    rows = nearest_first[in_view[nearest_first]]
    location, size, yaw, inside, outside = (
        part[rows] for part in (location, size, yaw, inside, outside)
    )
    fractions = visible_fractions(
        inside,
        location,
        size_hwl_m=size,
        rotation_y_rad=yaw,
        camera=camera,
        inverse_depth=inverse_depth,
    )
    occluded = np.where(
        fractions >= LARGELY_VISIBLE, 0, np.where(fractions >= PARTLY_VISIBLE, 1, 2)
    )
    labels = KittiLabels(
        frame=np.full(len(rows), frame, np.int64),
        track_id=np.array([scene.road_users[row].track_id for row in rows], np.int64),
        kitti_type=np.array([scene.road_users[row].kitti_type for row in rows], np.str_),
        truncated=np.digitize(outside, [UNCUT, HALF_CUT]).astype(np.float64),
        occluded=occluded.astype(np.int64),
        xyxy_px=inside,
        size_hwl_m=size,
        location_m=location,
        rotation_y_rad=yaw,
        score=np.full(len(rows), np.nan),
    )
    visible = np.flatnonzero(fractions > 0)
    is_small = (inside[:, 3] - inside[:, 1] < DONT_CARE_BELOW_PX)[visible]
    labels = _with_dont_care(labels.select(visible), is_small)
    return VisibleObjects(
        rows[visible].astype(np.int64), labels, (fractions * (1 - outside))[visible]
    )


def _with_dont_care(labels: KittiLabels, is_small: BoolArray) -> KittiLabels:
    return replace(
        labels,
        track_id=np.where(is_small, -1, labels.track_id),
        kitti_type=np.where(is_small, "DontCare", labels.kitti_type),
        truncated=np.where(is_small, -1.0, labels.truncated),
        occluded=np.where(is_small, -1, labels.occluded),
        size_hwl_m=np.where(is_small[:, None], -1000.0, labels.size_hwl_m),
        location_m=np.where(is_small[:, None], -1000.0, labels.location_m),
        rotation_y_rad=np.where(is_small, -10.0, labels.rotation_y_rad),
    )


def _areas(xyxy_px: FloatArray) -> FloatArray:
    return np.asarray((xyxy_px[:, 2] - xyxy_px[:, 0]) * (xyxy_px[:, 3] - xyxy_px[:, 1]))
