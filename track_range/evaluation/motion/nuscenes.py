"""Labelled motion of nuScenes: COCO files of mono3d labels, of six cameras at 2 Hz.

An annotation has the 2-D box of its projected 3-D box (looser than a drawn one), the centre,
length, height, width and yaw of the 3-D box in the frame of the camera, and its velocity over
ground along the camera's x and z axis. An object has the same size in all images, which is its
identity. V is the speed of the camera along its axis, w its yaw rate:

    closing speed = V - v_z - w x
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.evaluation.motion.labelled_motion import LabelledMotion, track_slopes
from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import MAX_TABLE_BYTES, read_text
from track_range.foundation.files.structured_text import parse_json
from track_range.ranging.truth.label_classes import not_counted_notes, size_class_of
from track_range.ranging.truth.labelled_boxes import BoxSet
from track_range.ranging.truth.reference_distance import surface_distance_m

_BORDER_PX = 2.0  # distance from the image border within which a box counts as cut
_HALF_SPAN_S, _MIN_SIDE_S = 0.6, 0.35  # of slopes: one label, half a second before and after


@dataclass(frozen=True, slots=True)
class Mono3dLabels:
    """N labelled boxes that end inside the image; each camera is a sequence."""

    boxes: BoxSet
    velocity_mps: FloatArray  # (N, 2) over ground, along x and z of the camera; NaN = unknown
    pose: FloatArray  # (N, 3, 4) from the camera to the world, m
    camera_height_m: FloatArray  # (N,)


def read_mono3d(path: Path) -> Mono3dLabels:
    """The labels of a file; LabelFileError if it cannot be read."""
    expected = "a COCO file of mono3d labels"
    text = read_text(path, LabelFileError, expected, max_bytes=MAX_TABLE_BYTES)
    # unknown velocities
    content = parse_json(text.replace("NaN", "null"), path, LabelFileError, expected)
    try:
        return _labels(content)
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise LabelFileError(
            f"{path}: expected mono3d labels of nuScenes with bbox_cam3d and velo_cam3d, found "
            f"other data ({error!r})."
        ) from error


def _labels(content: Any) -> Mono3dLabels:
    names = {category["id"]: category["name"] for category in content["categories"]}
    image_of = {image["id"]: image for image in content["images"]}
    every = content["annotations"]
    types = [names[row["category_id"]] for row in every]
    class_of = {name: size_class_of(name) for name in set(types)}
    is_counted = np.array([class_of[name] != "" for name in types])
    rows = [row for row, name in zip(every, types, strict=True) if class_of[name]]
    images = [image_of[row["image_id"]] for row in rows]
    K = np.array([image["cam_intrinsic"] for image in images], np.float64)
    cameras, sequence = np.unique(
        [image["file_name"].split("/")[-2] for image in images], return_inverse=True
    )
    time_s = (
        np.array([int(Path(image["file_name"]).stem.split("__")[-1]) for image in images]) / 1e6
    )
    x_m, y_m, z_m, length_m, height_m, width_m, yaw_rad = np.array(
        [row["bbox_cam3d"] for row in rows]
    ).T
    size_hwl_m = np.stack([height_m, width_m, length_m], axis=1)
    left, top, width, height = np.array([row["bbox"] for row in rows]).T
    rays = np.stack([left + width / 2, top + height / 2, np.ones(len(rows))], axis=1)
    location_m = np.stack([x_m, y_m + height_m / 2, z_m], axis=1)  # the labels have the centre
    distance_m = surface_distance_m(
        np.linalg.solve(K, rays[:, :, None])[:, :, 0],
        location_m,
        size_hwl_m=size_hwl_m,
        rotation_y_rad=yaw_rad,
    )
    ego, camera = _poses(images, "ego2global"), _poses(images, "cam2ego")
    pose = (ego @ camera)[:, :3]
    size_px = np.array([(image["width"], image["height"]) for image in images])
    boxes = BoxSet(
        sequence_names=tuple(cameras.tolist()),
        sequence=sequence,
        frame=np.unique(time_s, return_inverse=True)[1],
        time_s=time_s - time_s.min(),
        track_id=np.unique(size_hwl_m.round(3), axis=0, return_inverse=True)[1].reshape(-1),
        kitti_type=np.array([names[row["category_id"]] for row in rows]),
        class_name=np.array([class_of[names[row["category_id"]]] for row in rows]),
        xyxy_px=np.stack([left, top, left + width, top + height], axis=1),
        fxycxy_px=K[:, [0, 1, 0, 1], [0, 1, 2, 2]],
        size_px=size_px,
        distance_m=distance_m,
        alpha_rad=yaw_rad - np.arctan2(x_m, z_m),
        x_m=x_m,
        size_hwl_m=size_hwl_m,
        rotation_y_rad=yaw_rad,
        occluded=np.zeros(len(rows), np.int64),
        location_m=location_m,
        notes=not_counted_notes(types, is_counted, ""),
    )
    is_whole = (
        (left > _BORDER_PX)
        & (left + width < size_px[:, 0] - 1 - _BORDER_PX)
        & np.isfinite(distance_m)
    )
    chosen = np.flatnonzero(is_whole)[np.lexsort((boxes.frame[is_whole], sequence[is_whole]))]
    velocity_mps = np.array([row["velo_cam3d"] for row in rows], np.float64)
    return Mono3dLabels(
        boxes.select(chosen), velocity_mps[chosen], pose[chosen], camera[chosen, 2, 3]
    )


def _poses(images: list[Any], name: str) -> FloatArray:
    """(N, 4, 4) transforms from the keys `name`_rotation and `name`_translation."""
    pose = np.tile(np.eye(4), (len(images), 1, 1))
    quaternions = np.array([image[f"{name}_rotation"] for image in images])
    pose[:, :3, :3] = Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
    pose[:, :3, 3] = [image[f"{name}_translation"] for image in images]
    return pose


def nuscenes_motion(path: Path, *, noise_px: float = 0.0, seed: int = 0) -> LabelledMotion:
    """Boxes of mono3d labels with their true motion; LabelFileError if the file cannot be read."""
    labels = read_mono3d(path)
    boxes, axis = labels.boxes, labels.pose[:, :, 2]
    _, first, image = np.unique(
        [boxes.sequence, boxes.frame], axis=1, return_index=True, return_inverse=True
    )
    heading_rad = np.arctan2(axis[:, 1], axis[:, 0])  # to the left
    values = np.column_stack([labels.pose[:, :, 3], np.cos(heading_rad), np.sin(heading_rad)])[
        first
    ]
    key, time_s = boxes.sequence[None, first], boxes.time_s[first]
    slopes = track_slopes(key, time_s, values, half_span_s=_HALF_SPAN_S, min_side_s=_MIN_SIDE_S)[
        image.reshape(-1)
    ]
    ego_mps = (slopes[:, :3] * axis).sum(axis=1)
    right_mps = (slopes[:, :3] * labels.pose[:, :, 0]).sum(axis=1)
    yaw_rad_s = np.sin(heading_rad) * slopes[:, 3] - np.cos(heading_rad) * slopes[:, 4]
    own_mps = labels.velocity_mps
    return LabelledMotion(
        boxes=boxes.with_noise(noise_px, seed=seed) if noise_px > 0 else boxes,
        closing_mps=ego_mps - own_mps[:, 1] - yaw_rad_s * boxes.x_m,
        speed_mps=np.where(np.isfinite(ego_mps), np.hypot(*own_mps.T), np.nan),
        heading_rad=np.arctan2(-own_mps[:, 0], own_mps[:, 1]),
        ego_mps=ego_mps,
        right_mps=right_mps,
        yaw_rad_s=yaw_rad_s,
        duration_s=np.full(len(boxes.sequence_names), np.ptp(boxes.time_s)),
        protocol="velocities of the labels, and the poses of the camera over half a second before "
        "and after",
    )
