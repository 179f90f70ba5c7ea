"""Stereo pairs with true disparities, read from a labelled drive: a folder as written by `simulate` or the demo.

    left.mp4  right.mp4  rig.yaml (or calib.txt)  truth.csv (or truth.txt, label.txt: KITTI tracking labels)

Objects are the labels that `ranging.evaluation.truth` evaluates (not truncated, at most partly occluded, of a road
class); their true disparity is f B / distance. The distance is that of the visible surface on the ray through the box
centre, from truth.csv, else from the label's 3-D box.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, IntArray
from track_range.ranging.evaluation.errors import BANDS_M
from track_range.ranging.evaluation.truth import Truth, read_truth
from track_range.recording.recording import Recording, open_recording
from track_range.stereo.alignment.model import Alignment
from track_range.stereo.evaluation.kitti_2015 import PairFileError, StereoPair
from track_range.stereo.geometry.rig import RigError, StereoRig

LEFT, RIGHT = "left.mp4", "right.mp4"
LABELS = ("truth.csv", "truth.txt", "label.txt")  # names of label files; the first one that exists is used


def is_drive(folder: Path) -> bool:
    """Whether a folder has one of a drive's two videos."""
    return (folder / LEFT).is_file() or (folder / RIGHT).is_file()


def read_drive(folder: Path, *, rig: Path | None = None, row_offset_px: float = 0.0) -> Iterator[StereoPair]:
    """The pairs of a drive in order of time, named by frame; pairs without evaluated objects are included.

    Args:
        folder: the drive.
        rig: a rig file; None = the one in the folder.
        row_offset_px: y_right - y_left, corrected in the right images.

    Raises:
        VideoError: a video is missing or cannot be used.
        RigError: the rig is missing or cannot be used.
        LabelFileError, PairFileError: labels cannot be read, or there are none.
    """
    rows = Alignment(row_offset_px=row_offset_px)
    recording, rectified = open_pair(folder / LEFT, folder / RIGHT, rig, align=rows)
    with closing(recording):
        truth = read_truth(_labels(folder), rectified.left, recording.calibration.left_from_reference_m)
        truth = truth.select(_is_evaluated(truth))
        for frame in recording.frames:
            if frame.right is None:
                continue
            objects = truth.select(truth.frame == frame.index)
            yield StereoPair(
                f"{frame.index:06d}",
                frame.left,
                frame.right,
                objects.xyxy_px,
                rectified.left.fx_px * rectified.baseline_m / objects.distance_m,
                rectified,
                recording.calibration.file_notes,
                track_id=objects.track_id,
                class_names=road_class_names(objects.class_id),
            )


def road_class_names(class_id: IntArray) -> tuple[str, ...]:
    """The names of the road classes (N,)."""
    return tuple(ROAD_CLASSES[number] for number in class_id.tolist())


def open_pair(
    left: Path, right: Path, rig: Path | None, *, align: str | Alignment = "off", has_checks: bool = False
) -> tuple[Recording, StereoRig]:
    """Open a calibrated pair; returns the recording and its rectified rig.

    Args:
        left: the left video.
        right: the right video.
        rig: a rig file; None = the one next to the left video.
        align: see `open_recording`.
        has_checks: see `open_recording`.

    Raises:
        VideoError: a video cannot be used.
        RigError: there is no rig, it cannot be used, or, with checks, left and right are swapped.
    """
    recording = open_recording(left, right, rig=rig, align=align, has_checks=has_checks)
    if recording.rig is None:
        recording.close()
        raise RigError(f"{left}: no rig.yaml or calib.txt next to it; give the calibration file with --rig FILE.")
    return recording, recording.rig


def _is_evaluated(truth: Truth) -> BoolArray:
    """(N,) objects of a road class in the evaluated range of distances."""
    return (truth.class_id >= 0) & (truth.distance_m >= BANDS_M[0]) & (truth.distance_m <= BANDS_M[-1])


def _labels(folder: Path) -> Path:
    labels = next((folder / name for name in LABELS if (folder / name).is_file()), None)
    if labels is None:
        raise PairFileError(f"{folder}: expected labels in {', '.join(LABELS[:-1])} or {LABELS[-1]}, found none.")
    return labels
