"""Truth: ground truth of a drive (boxes, identities, distances) from KITTI tracking labels or other
label files.

The distance is the z at which the ray through the label's box centre first meets the object, in the
left camera's frame. A CSV file (`video_labels/csv_labels.py`) contains it, with the closing speed.
KITTI's labels have 3-D boxes in the frame of the rig's reference camera, which are shifted into the
frame of the left camera, and 2-D boxes, which together determine the camera (`label_camera`), since
what is true must not depend on the calibration of a run; people and riders do not fill their boxes.
COCO, CVAT and YOLO labels are used as they are; they may have distances, as attributes.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from track_range.detection.boxes import are_valid_boxes
from track_range.detection.classes import KITTI_IGNORED, map_to_road_classes
from track_range.detection.formats.label_formats import label_format_of, read_labels
from track_range.detection.formats.tables.box_table import VideoFacts
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.table_checks import (
    other_classes_note,
    other_labels_note,
)
from track_range.detection.formats.video_labels.csv_labels import is_label_csv, read_csv_labels
from track_range.detection.formats.video_labels.kitti import KittiLabels, read_kitti
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.files.input_files import first_line
from track_range.ranging.truth.label_camera import camera_of_labels
from track_range.ranging.truth.reference_distance import surface_distance_m
from track_range.ranging.truth.target_table import TargetTable, is_target_table, read_targets
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.rig_formats.reading import left_from_reference_m, load_camera

# largest KITTI occlusion level (partly occluded) that is scored for distance: others are guesses
MAX_OCCLUDED = 1
# of objects scored for distance; corresponds to KITTI's "partly occluded"
MIN_VISIBLE_FRACTION = 0.5
# distance from the image border within which a label counts as cut; labels are clipped to the image
_CUT_PX = 1.0
# visible fraction to be scored for detection; KITTI's "largely occluded"
_MIN_DETECTABLE_FRACTION = 0.2

_SCORED = (
    "tracks matched to labels one to one at IoU 0.5; coverage: measured track-frames divided by "
    "track-frames with truth"
)

KITTI_PROTOCOL = (
    "z at which the ray through a label's box centre first meets its 3-D box "
    f"(labels at 5-100 m, not truncated, occluded <= {MAX_OCCLUDED}; {_SCORED})"
)
CSV_PROTOCOL = (  # ground truth that errors are measured against, as printed and stored with them
    "distance and closing speed in the rows of the CSV file (rows at 5-100 m, not truncated by the "
    f"image border, visible_share >= {MIN_VISIBLE_FRACTION:g}; {_SCORED})"
)
LABELS_PROTOCOL = (  # ground truth of COCO, CVAT and YOLO labels
    "distance of the labels, if they have one (labels at 5-100 m, not truncated by the image "
    f"border; {_SCORED})"
)
TARGETS_PROTOCOL = (  # ground truth of targets without boxes
    "distance of the targets, matched to whole tracks by distance, offset to the side and speed "
    "(at 5-100 m; coverage: measured track-frames divided by matched track-frames)"
)
_CAMERA_OF_RUN = (
    "{name}: too few labels show their camera, so that the true distances follow from the camera of "
    "the run; give --truth-calib."
)
_COLUMNS = ("frame", "track_id", "kitti_type", "class_id", "xyxy_px", "distance_m", "closing_mps")


@dataclass(frozen=True, slots=True)
class Truth:
    """Labelled objects, one row per object and frame."""

    frame: IntArray  # (N,) frame number from 0
    track_id: IntArray  # (N,) identity of the object; -1 = DontCare
    kitti_type: npt.NDArray[np.str_]  # (N,) type of the label, as in the file
    class_id: IntArray  # (N,) road class; -1 = ignored in detection and tracking scores
    xyxy_px: FloatArray  # (N, 4) box
    # (N,) distance of the visible surface; NaN = unknown, or not scored (truncated, occluded)
    distance_m: FloatArray
    # (N,) closing speed, the decrease of the distance per second; NaN = unknown
    closing_mps: FloatArray
    protocol: str = KITTI_PROTOCOL  # description of the ground truth for users
    notes: tuple[str, ...] = ()  # notes for the user about the file
    has_low_labels: bool = False  # whether labels and tracks below 25 px count
    kitti: KittiLabels | None = None  # all labels of a file of KITTI, for its benchmark's rules
    # targets without boxes, which rows of a run are matched to; then there are no labels
    targets: TargetTable | None = None
    # (N, 3) bottom centres of the 3-D boxes of KITTI's labels in the left camera's frame
    location_m: FloatArray | None = None
    right_m: FloatArray | None = None  # (N,) offset of matched targets to the right; NaN = unknown

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, rows: BoolArray | IntArray) -> Truth:
        """The rows selected by a mask or an index array."""
        return replace(self, **{name: getattr(self, name)[rows] for name in _COLUMNS})


@dataclass(frozen=True, slots=True)
class TruthChoices:
    """What a user gave about the ground truth besides its file; None = not given."""

    calib: Path | None = None  # of the camera of KITTI's labels
    poses: Path | None = None  # of targets in a map
    ahead_m: float = 0.0  # position of the sensor of targets ahead of the camera
    offset_s: float | None = None  # time of the video minus that of the targets


def read_truth(
    path: Path,
    camera: PinholeCamera,
    left_from_reference_m: FloatArray,
    given: TruthChoices | None = None,
) -> Truth:
    """Ground truth for the left `camera` (undistorted) from a file of labels in any format, a folder
    of YOLO labels, or a table of targets without boxes.

    `left_from_reference_m` (3,) is the shift from the frame of KITTI's reference camera to the left
    camera's frame. The distances of KITTI's labels are those of the given camera, else of the one
    that the labels determine, and only else of `camera`. Raises RigError: the given calibration
    cannot be used. Raises LabelFileError if the file cannot be read, or has no identities, or no
    distances (KITTI: no 3-D boxes), which are optional for COCO, CVAT and YOLO.
    """
    given = given or TruthChoices()
    if not os.path.isdir(path) and is_target_table(_first_cells(path)):
        return _of_targets(path, given)
    if os.path.isdir(path) or label_format_of(path, "ground truth").is_general:
        return _of_table(path, camera)
    return (
        _of_csv(path, camera)
        if is_label_csv(path)
        else _of_kitti(path, _Views((camera, left_from_reference_m), given.calib))
    )


def _first_cells(path: Path) -> list[str]:
    first = first_line(path, LabelFileError, "ground truth")
    return re.split("[,;\t]", first)


def _of_targets(path: Path, given: TruthChoices) -> Truth:
    """Ground truth without labels, whose targets are matched to the rows of a run."""
    targets = read_targets(path, poses=given.poses, ahead_m=given.ahead_m, offset_s=given.offset_s)
    none, nothing, text = np.zeros(0, np.int64), np.zeros(0), np.zeros(0, np.str_)
    return Truth(
        frame=none,
        track_id=none,
        kitti_type=text,
        class_id=none,
        xyxy_px=np.zeros((0, 4)),
        distance_m=nothing,
        closing_mps=nothing,
        protocol=TARGETS_PROTOCOL,
        targets=targets,
    )


class _Views(NamedTuple):
    """Cameras of labels, each with the shift (3,) from the frame of the 3-D boxes."""

    run_view: tuple[PinholeCamera, FloatArray]
    calib: Path | None  # of the labels; None = not given

    def of_labels(
        self, labels: KittiLabels, path: Path
    ) -> tuple[PinholeCamera, FloatArray, tuple[str, ...]]:
        """The camera that the true distances belong to, its shift, and notes."""
        if self.calib is not None:
            camera, _ = load_camera(self.calib, size_px=self.run_view[0].size_px)
            return camera, left_from_reference_m(self.calib, is_grey=False), ()
        if (known := camera_of_labels(labels, self.run_view[0].size_px)) is not None:
            return *known, ()
        return *self.run_view, (_CAMERA_OF_RUN.format(name=path.name),)


def _of_table(path: Path, camera: PinholeCamera) -> Truth:
    size_px = (camera.width_px, camera.height_px)
    table = read_labels(path, VideoFacts(size_px=size_px), expected="ground truth")
    if (table.track_id[~table.is_region] < 0).any():
        raise LabelFileError(
            f"{path}: expected labels with track ids as ground truth, found boxes "
            "without track ids."
        )
    distance_m = np.where(
        _is_cut(table.xyxy_px, camera) | (table.distance_m <= 0), np.nan, table.distance_m
    )
    if np.isfinite(distance_m).any():
        origin = (
            f"{path.name}: the true distances are read from the labels; in an export of a run, "
            "these are the measured distances, not ground truth."
        )
    else:
        origin = f"{path.name}: the labels have no distances, so only the tracks are evaluated."
    return Truth(
        frame=table.frame,
        track_id=table.track_id,
        kitti_type=table.class_name,
        class_id=table.class_id,
        xyxy_px=table.xyxy_px,
        distance_m=distance_m,
        closing_mps=np.full(len(table), np.nan),
        protocol=LABELS_PROTOCOL,
        notes=(*table.notes, *other_labels_note(table, path), origin),
        has_low_labels=True,
    )


def _is_cut(xyxy_px: FloatArray, camera: PinholeCamera) -> BoolArray:
    """(N,) whether boxes end at the border of the image."""
    last_px = np.array([camera.width_px, camera.height_px]) - 1
    is_cut = (xyxy_px[:, :2] <= _CUT_PX).any(axis=1) | (xyxy_px[:, 2:] >= last_px - _CUT_PX).any(
        axis=1
    )
    return np.asarray(is_cut)


def _of_csv(path: Path, camera: PinholeCamera) -> Truth:
    labels = read_csv_labels(path)
    if len(labels.frame) and not np.isfinite(labels.distance_m).any():
        raise LabelFileError(f"{path}: expected a distance_m in at least one row, found none.")
    scored = ~_is_cut(labels.xyxy_px, camera) & (labels.visible_share >= MIN_VISIBLE_FRACTION)
    is_other = (labels.class_id < 0) & (labels.track_id >= 0)
    return Truth(
        frame=labels.frame,
        track_id=labels.track_id,
        kitti_type=labels.class_name,
        class_id=np.where(labels.visible_share < _MIN_DETECTABLE_FRACTION, -1, labels.class_id),
        xyxy_px=labels.xyxy_px,
        distance_m=np.where(scored, labels.distance_m, np.nan),
        closing_mps=labels.closing_mps,
        protocol=CSV_PROTOCOL,
        notes=other_classes_note(path, labels.class_name[is_other]),
    )


def _of_kitti(path: Path, views: _Views) -> Truth:
    labels = read_kitti(path)
    if not labels.has_3d_box.any():
        raise LabelFileError(
            f"{path}: expected KITTI tracking labels with 3-D boxes, found no label with a 3-D box."
        )
    is_object = ~np.isin(labels.kitti_type, KITTI_IGNORED)
    if (labels.track_id[is_object] < 0).any():
        raise LabelFileError(
            f"{path}: expected KITTI tracking labels with track ids, got the id "
            "-1 of object labels."
        )
    identities = np.stack([labels.frame[is_object], labels.track_id[is_object]])
    pairs, counts = np.unique(identities, axis=1, return_counts=True)
    for frame, track_id in pairs[:, counts > 1].T[:1].tolist():
        raise LabelFileError(
            f"{path}: expected each track id at most once per frame, got id {track_id} twice in "
            f"frame {frame}."
        )
    for row in np.flatnonzero(is_object & ~are_valid_boxes(labels.xyxy_px))[:1].tolist():
        raise LabelFileError(
            f"{path}: expected boxes with x1 < x2 and y1 < y2, got {labels.xyxy_px[row].tolist()} "
            f"in frame {labels.frame[row]}."
        )
    scored = (
        labels.has_3d_box
        & (labels.truncated == 0)
        & (labels.occluded >= 0)
        & (labels.occluded <= MAX_OCCLUDED)
    )
    camera, shift_m, notes = views.of_labels(labels, path)
    distance_m = np.where(scored, surface_of_labels_m(labels, camera, shift_m), np.nan)
    road = map_to_road_classes([str(name) for name in labels.kitti_type])
    return Truth(
        frame=labels.frame,
        track_id=labels.track_id,
        kitti_type=labels.kitti_type,
        class_id=np.where(np.isin(labels.kitti_type, KITTI_IGNORED), -1, road),
        xyxy_px=labels.xyxy_px,
        distance_m=distance_m,
        closing_mps=np.full(len(labels), np.nan),
        notes=notes,
        kitti=labels,
        location_m=labels.location_m + shift_m,
    )


def surface_of_labels_m(
    labels: KittiLabels, camera: PinholeCamera, left_from_reference_m: FloatArray
) -> FloatArray:
    """(N,) z at which the ray through each label's box centre meets its 3-D box; NaN = it misses
    the box.
    """
    return surface_distance_m(
        camera.rays((labels.xyxy_px[:, :2] + labels.xyxy_px[:, 2:]) / 2),
        labels.location_m + left_from_reference_m,
        size_hwl_m=labels.size_hwl_m,
        rotation_y_rad=labels.rotation_y_rad,
    )
