"""Stereo pairs with true disparities, read from a labelled drive: a folder as written by `simulate` or the demo.

    left.mp4  right.mp4  rig.yaml (or calib.txt)  truth.csv (or truth.txt, label.txt: KITTI tracking labels)

Objects are the labels that `ranging.evaluation.truth` evaluates (not truncated, at most partly occluded, of a road
class); their true disparity is f B / distance. The distance is that of the visible surface on the ray through the box
centre, from truth.csv, else from the label's 3-D box.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import FloatArray, IntArray
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


@dataclass(frozen=True, slots=True)
class KnownObjects:
    """Objects of a drive, one row per object and frame."""

    frame: IntArray  # (N,) frame number
    track_id: IntArray | None  # (N,) id; None = unknown
    xyxy_px: FloatArray  # (N, 4) box
    true_px: FloatArray  # (N,) true disparity
    class_id: IntArray | None = None  # (N,) road class; None = unknown

    @classmethod
    def of(cls, truth: Truth, rig: StereoRig) -> KnownObjects:
        """The objects of labels with their distances."""
        true_px = rig.left.fx_px * rig.baseline_m / truth.distance_m
        return cls(truth.frame, truth.track_id, truth.xyxy_px, true_px, truth.class_id)


def known_pairs(recording: Recording, rig: StereoRig, known: KnownObjects) -> Iterator[StereoPair]:
    """The pairs of a recording in order of time, named by frame, with their known objects, perhaps none."""
    for frame in recording.frames:
        if frame.right is None:
            continue
        rows = known.frame == frame.index
        class_id = [] if known.class_id is None else known.class_id[rows].tolist()
        yield StereoPair(
            f"{frame.index:06d}",
            frame.left,
            frame.right,
            known.xyxy_px[rows],
            known.true_px[rows],
            rig,
            recording.calibration.file_notes,
            track_id=np.zeros(0, np.int64) if known.track_id is None else known.track_id[rows],
            class_names=tuple(ROAD_CLASSES[number] for number in class_id),
        )


def read_drive(folder: Path, *, rig: Path | None = None, row_offset_px: float = 0.0) -> Iterator[StereoPair]:
    """The pairs of a drive in order of time, named by frame; pairs without evaluated objects are included.

    `rig` is a rig file, None = the one in the folder; `row_offset_px`, y_right - y_left, is corrected in the right
    images. Raises VideoError, RigError, LabelFileError or PairFileError if videos, rig or labels cannot be used.
    """
    rows = Alignment(row_offset_px=row_offset_px)
    recording, rectified = open_pair(folder / LEFT, folder / RIGHT, rig, align=rows)
    with closing(recording):
        labels = next((folder / name for name in LABELS if (folder / name).is_file()), None)
        if labels is None:
            raise PairFileError(f"{folder}: expected labels in {', '.join(LABELS[:-1])} or {LABELS[-1]}, found none.")
        truth = read_truth(labels, rectified.left, recording.calibration.left_from_reference_m)
        is_in_range = (truth.distance_m >= BANDS_M[0]) & (truth.distance_m <= BANDS_M[-1])
        known = KnownObjects.of(truth.select((truth.class_id >= 0) & is_in_range), rectified)
        yield from known_pairs(recording, rectified, known)


def open_pair(
    left: Path, right: Path, rig: Path | None, *, align: str | Alignment = "off", has_checks: bool = False
) -> tuple[Recording, StereoRig]:
    """Open a calibrated pair; returns the recording and its rectified rig.

    `rig` is a rig file, None = the one next to the left video; for the others see `open_recording`. Raises VideoError
    if a video cannot be used, and RigError without a usable rig, or, with checks, if left and right are swapped.
    """
    recording = open_recording(left, right, rig=rig, align=align, has_checks=has_checks)
    if recording.rig is None:
        recording.close()
        raise RigError(f"{left}: no rig.yaml or calib.txt next to it; give the calibration file with --rig FILE.")
    return recording, recording.rig
