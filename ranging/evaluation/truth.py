"""What is known to be true of a drive: boxes, identities and distances from KITTI tracking labels, or from a CSV.

The distance is the z at which the ray through the label's box centre first meets the object, in the left camera's
frame. A CSV (`detection/formats/csv_labels.py`) says it as it is, and how fast the object comes nearer. KITTI's labels
have 3-D boxes, which riders and people do not fill, in the frame of the rig's reference camera; they are shifted into
the left one first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from track_range.detection.classes import KITTI_IGNORED, map_to_road_classes
from track_range.detection.formats.csv_labels import is_label_csv, read_csv_labels
from track_range.detection.formats.kitti import KittiLabels, LabelFileError, read_kitti
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.evaluation.box_surface import surface_distance_m
from track_range.stereo.geometry.camera import PinholeCamera

MAX_OCCLUDED = 1
"""Labels hidden more than partly are not scored for distance: their boxes are guesses."""

MIN_VISIBLE_SHARE = 0.5
"""The same where a share is known: KITTI's partly hidden objects are seen by half at least."""

_CUT_PX = 1.0
"""Boxes this near to the border are taken as cut by it; labels are clipped to the image."""

_HIDDEN_SHARE = 0.2
"""What is visible by less nobody can be asked to find: KITTI's "largely occluded" ends there."""

_SCORED = "tracks matched to labels one to one at IoU 0.5; coverage: measured track-frames over those with truth"

KITTI_PROTOCOL = (
    "z at which the ray through a label's box centre first meets its 3-D box "
    f"(labels at 5-100 m, not truncated, occluded <= {MAX_OCCLUDED}; {_SCORED})"
)
CSV_PROTOCOL = (
    "distance and closing speed in the rows of the CSV file "
    f"(rows at 5-100 m, not cut by the image border, visible_share >= {MIN_VISIBLE_SHARE:g}; {_SCORED})"
)
"""Ground truth that errors are measured against, as printed and stored with them."""

_COLUMNS = ("frame", "track_id", "kitti_type", "class_id", "xyxy_px", "distance_m", "closing_mps")


@dataclass(frozen=True, slots=True)
class Truth:
    """Labelled objects, one row per object and frame.

    Attributes:
        frame: (N,) frame number from 0.
        track_id: (N,) the label's identity; -1 = DontCare.
        kitti_type: (N,) the label's own word.
        class_id: (N,) road class; -1 = to be ignored in detection and tracking scores.
        xyxy_px: (N, 4) box.
        distance_m: (N,) to the visible surface; NaN = not known, or not to be scored (truncated, hidden).
        closing_mps: (N,) how fast that shrinks; NaN = not known.
        protocol: what errors are measured against, in words.
    """

    frame: IntArray
    track_id: IntArray
    kitti_type: npt.NDArray[np.str_]
    class_id: IntArray
    xyxy_px: FloatArray
    distance_m: FloatArray
    closing_mps: FloatArray
    protocol: str = KITTI_PROTOCOL

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, keep: BoolArray | IntArray) -> Truth:
        """The rows that a mask or an index array names."""
        return replace(self, **{name: getattr(self, name)[keep] for name in _COLUMNS})


def read_truth(path: Path, camera: PinholeCamera, left_from_reference_m: FloatArray) -> Truth:
    """Read KITTI tracking labels, or a CSV, which its first line tells, as the truth for the left `camera`.

    Raises:
        LabelFileError: the file cannot be read, tells no distances (KITTI: has no 3-D boxes), or no identities.
    """
    return _of_csv(path, camera) if is_label_csv(path) else _of_kitti(path, camera, left_from_reference_m)


def _of_csv(path: Path, camera: PinholeCamera) -> Truth:
    labels = read_csv_labels(path)
    if len(labels.frame) and not np.isfinite(labels.distance_m).any():
        raise LabelFileError(f"{path}: expected a distance_m in at least one row, found none.")
    last_px = np.array([camera.width_px, camera.height_px]) - 1
    box_px = labels.xyxy_px
    is_cut = (box_px[:, :2] <= _CUT_PX).any(axis=1) | (box_px[:, 2:] >= last_px - _CUT_PX).any(axis=1)
    scored = ~is_cut & (labels.visible_share >= MIN_VISIBLE_SHARE)
    return Truth(
        frame=labels.frame,
        track_id=labels.track_id,
        kitti_type=labels.class_name,
        class_id=np.where(labels.visible_share < _HIDDEN_SHARE, -1, labels.class_id),
        xyxy_px=box_px,
        distance_m=np.where(scored, labels.distance_m, np.nan),
        closing_mps=labels.closing_mps,
        protocol=CSV_PROTOCOL,
    )


def _of_kitti(path: Path, camera: PinholeCamera, left_from_reference_m: FloatArray) -> Truth:
    labels = read_kitti(path)
    if not labels.has_3d_box.any():
        raise LabelFileError(f"{path}: expected KITTI tracking labels with 3-D boxes, found no label with a 3-D box.")
    _check_identities(labels, path)
    scored = labels.has_3d_box & (labels.truncated == 0) & (labels.occluded >= 0) & (labels.occluded <= MAX_OCCLUDED)
    distance_m = np.where(scored, surface_of_labels_m(labels, camera, left_from_reference_m), np.nan)
    road = map_to_road_classes([str(name) for name in labels.kitti_type])
    return Truth(
        frame=labels.frame,
        track_id=labels.track_id,
        kitti_type=labels.kitti_type,
        class_id=np.where(np.isin(labels.kitti_type, KITTI_IGNORED), -1, road),
        xyxy_px=labels.xyxy_px,
        distance_m=distance_m,
        closing_mps=np.full(len(labels), np.nan),
    )


def _check_identities(labels: KittiLabels, path: Path) -> None:
    """Refuse object labels, which name no one, and an identity that is in two places at once."""
    named = ~np.isin(labels.kitti_type, KITTI_IGNORED)
    if (labels.track_id[named] < 0).any():
        raise LabelFileError(f"{path}: expected KITTI tracking labels with track ids, got the id -1 of object labels.")
    pairs, counts = np.unique(np.stack([labels.frame[named], labels.track_id[named]]), axis=1, return_counts=True)
    if (counts > 1).any():
        frame, track_id = pairs[:, counts > 1][:, 0]
        raise LabelFileError(
            f"{path}: expected each track id at most once per frame, got id {track_id} twice in frame {frame}."
        )


def surface_of_labels_m(labels: KittiLabels, camera: PinholeCamera, left_from_reference_m: FloatArray) -> FloatArray:
    """(N,) z at which the ray through each label's box centre meets its 3-D box; NaN where it misses."""
    return surface_distance_m(
        camera.rays((labels.xyxy_px[:, :2] + labels.xyxy_px[:, 2:]) / 2),
        labels.location_m + left_from_reference_m,
        size_hwl_m=labels.size_hwl_m,
        rotation_y_rad=labels.rotation_y_rad,
    )
