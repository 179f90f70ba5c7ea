"""What is known to be true of a drive: boxes, identities and distances from KITTI tracking labels.

The distance is the z at which the ray through the label's box centre first meets the 3-D box, in the left camera's
frame; labels are in the frame of the rig's reference camera and are shifted into the left one first.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import numpy.typing as npt

from detection.classes import KITTI_IGNORED, road_class_of_each
from detection.detections import BoolArray, FloatArray, IntArray
from detection.kitti_format import KittiLabels, LabelFileError, read_kitti
from ranging.box_surface import surface_distance_m
from stereo.camera import PinholeCamera

MAX_OCCLUDED = 1
"""Labels hidden more than partly are not scored for distance: their boxes are guesses."""


@dataclass(frozen=True, slots=True)
class Truth:
    """Labelled objects, one row per object and frame.

    Attributes:
        frame: (N,) frame number from 0.
        track_id: (N,) the label's identity; -1 = DontCare.
        kitti_type: (N,) the label's own word.
        class_id: (N,) road class; -1 = to be ignored in detection and tracking scores.
        xyxy_px: (N, 4) box.
        distance_m: (N,) to the visible surface; NaN = no 3-D box, or not to be scored (truncated, hidden).
    """

    frame: IntArray
    track_id: IntArray
    kitti_type: npt.NDArray[np.str_]
    class_id: IntArray
    xyxy_px: FloatArray
    distance_m: FloatArray

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, keep: BoolArray | IntArray) -> Truth:
        """The rows that a mask or an index array names."""
        return Truth(*(getattr(self, field.name)[keep] for field in fields(self)))


def read_truth(path: Path, camera: PinholeCamera, left_from_reference_m: FloatArray) -> Truth:
    """Read KITTI tracking labels as the truth for the left `camera`.

    Raises:
        LabelFileError: the file cannot be read, has no 3-D boxes, or no identities.
    """
    labels = read_kitti(path)
    if not labels.has_3d_box.any():
        raise LabelFileError(f"{path}: no label has a 3-D box, so it tells no distances; KITTI tracking labels wanted.")
    _check_identities(labels, path)
    scored = labels.has_3d_box & (labels.truncated == 0) & (labels.occluded >= 0) & (labels.occluded <= MAX_OCCLUDED)
    distance_m = np.where(scored, surface_of_labels_m(labels, camera, left_from_reference_m), np.nan)
    road = road_class_of_each([str(name) for name in labels.kitti_type])
    return Truth(
        frame=labels.frame,
        track_id=labels.track_id,
        kitti_type=labels.kitti_type,
        class_id=np.where(np.isin(labels.kitti_type, KITTI_IGNORED), -1, road),
        xyxy_px=labels.xyxy_px,
        distance_m=distance_m,
    )


def _check_identities(labels: KittiLabels, path: Path) -> None:
    """Refuse object labels, which name no one, and an identity that is in two places at once."""
    named = ~np.isin(labels.kitti_type, KITTI_IGNORED)
    if (labels.track_id[named] < 0).any():
        raise LabelFileError(f"{path}: its labels have no identities (id -1); KITTI tracking labels wanted.")
    pairs, counts = np.unique(np.stack([labels.frame[named], labels.track_id[named]]), axis=1, return_counts=True)
    if (counts > 1).any():
        frame, track_id = pairs[:, counts > 1][:, 0]
        raise LabelFileError(
            f"{path}: id {track_id} stands twice in frame {frame}; an object can be in one place only."
        )


def surface_of_labels_m(labels: KittiLabels, camera: PinholeCamera, left_from_reference_m: FloatArray) -> FloatArray:
    """(N,) z at which the ray through each label's box centre meets its 3-D box; NaN where it misses."""
    return surface_distance_m(
        camera.rays((labels.xyxy_px[:, :2] + labels.xyxy_px[:, 2:]) / 2),
        labels.location_m + left_from_reference_m,
        size_hwl_m=labels.size_hwl_m,
        rotation_y_rad=labels.rotation_y_rad,
    )
