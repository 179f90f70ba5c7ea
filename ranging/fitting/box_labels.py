"""Boxes with known distances from label files (COCO, CVAT, a CSV of labels), for fitting size models.

The distance is the attribute `distance_m` of a box. It is measured by a person, a lidar or a radar; in an export of a
run it is the run's own, which teaches a size model nothing new. Boxes that touch the border of the image, predicted
boxes and boxes without a distance are left out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.box_table import BoxTable
from track_range.detection.formats.errors import LabelFileError
from track_range.detection.formats.label_formats import read_labels
from track_range.detection.formats.table_checks import other_labels_note
from track_range.ranging.fitting.labelled_boxes import FRAME_STEP_S, BoxSet

_BORDER_PX = 1.0  # distance from the image border within which a box counts as cut


def read_box_labels(path: Path, *, focal_px: float | None) -> tuple[BoxSet, tuple[str, ...]]:
    """Boxes with distances from a label file, and notes for the user.

    Args:
        path: the file.
        focal_px: focal length of the camera.

    Raises:
        LabelFileError: the file cannot be read, no box has a distance, or the focal length is missing.
    """
    table = read_labels(path, expected="labels with distances")
    if focal_px is None:
        raise LabelFileError(f"{path}: expected a focal length, which labels do not have; give --focal-px.")
    rows = _usable(table)
    if not len(rows):
        raise LabelFileError(f"{path}: expected boxes inside the image with the attribute distance_m, found none.")
    extent_px = np.ceil(rows.xyxy_px[:, 2:].max(axis=0)).astype(np.int64) + 1
    width, height = table.video.size_px or (int(extent_px[0]), int(extent_px[1]))
    cx, cy = (width - 1) / 2, (height - 1) / 2
    n = len(rows)
    notes = (
        *table.notes,
        *other_labels_note(table, path),
        f"{path.name}: {n} of {len(table)} boxes are used; the principal point is taken to be the image centre.",
    )
    unknown = np.full(n, np.nan)
    boxes = BoxSet(
        sequence_names=(path.stem,),
        sequence=np.zeros(n, np.int64),
        frame=rows.frame,
        time_s=np.asarray(rows.frame * (FRAME_STEP_S if rows.video.fps is None else 1 / rows.video.fps), np.float64),
        track_id=np.where(rows.track_id < 0, rows.track_id.max() + 1 + np.arange(n), rows.track_id),
        kitti_type=rows.class_name,
        class_name=np.array([_class_name(*row) for row in zip(rows.class_name, rows.class_id, strict=True)], np.str_),
        xyxy_px=rows.xyxy_px,
        fxycxy_px=np.tile([focal_px, focal_px, cx, cy], (n, 1)),
        size_px=np.tile(np.array([width, height], np.int64), (n, 1)),
        distance_m=rows.distance_m,
        alpha_rad=unknown,
        x_m=unknown,
        size_hwl_m=np.full((n, 3), np.nan),
        rotation_y_rad=unknown,
        occluded=np.zeros(n, np.int64),
    )
    return boxes, notes


def _usable(table: BoxTable) -> BoxTable:
    """The observed boxes of road classes with a distance that do not touch the border of the image."""
    is_usable = (table.distance_m > 0) & table.observed & (table.class_id >= 0)
    if table.video.size_px is not None:
        last_px = np.array(table.video.size_px) - 1 - _BORDER_PX
        is_usable &= (table.xyxy_px[:, :2] > _BORDER_PX).all(axis=1) & (table.xyxy_px[:, 2:] < last_px).all(axis=1)
    return table.select(is_usable)


def _class_name(name: str, class_id: int) -> str:
    """Class in the results: vans are separate from cars."""
    return "van" if name == "van" else ROAD_CLASSES[class_id]
