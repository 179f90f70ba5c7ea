"""A drive with labels as stereo pairs with a truth: what `simulate` and the demo write, or real videos laid out alike.

    left.mp4  right.mp4  rig.yaml (or calib.txt)  truth.csv (or truth.txt, label.txt: KITTI tracking labels)

Objects are the labels that `ranging.truth` scores (not truncated, at most partly hidden, of a road class), their true
disparity f B / distance, the distance that of the visible surface on the ray through the box's middle: what truth.csv
says; else that of the label's 3-D box.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from track_range.foundation.arrays import BoolArray
from track_range.ranging.evaluation.errors import BANDS_M
from track_range.ranging.evaluation.truth import Truth, read_truth
from track_range.stereo.evaluation.kitti_2015 import PairFileError, StereoPair
from track_range.stereo.geometry.rectification import Rectifier
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.reading import find_rig, left_from_reference_m, load_rig
from track_range.video.pairing import StereoVideo
from track_range.video.reader import VideoReader

LEFT, RIGHT = "left.mp4", "right.mp4"
LABELS = ("truth.csv", "truth.txt", "label.txt")
"""The best first."""


def is_drive(folder: Path) -> bool:
    """Whether a folder has one of a drive's two videos."""
    return (folder / LEFT).is_file() or (folder / RIGHT).is_file()


def read_drive(folder: Path, *, rig: Path | None = None, row_offset_px: float = 0.0) -> Iterator[StereoPair]:
    """The pairs of a drive in order of time, named by frame; those without an object that counts too.

    Args:
        folder: of the drive.
        rig: a rig file; None = the one in the folder.
        row_offset_px: y_right - y_left, taken out of the right images.

    Raises:
        VideoError: a video is missing or cannot be used.
        RigError: the rig is missing or cannot be used.
        LabelFileError, PairFileError: labels cannot be read, or there are none.
    """
    left = VideoReader(folder / LEFT)
    right = VideoReader(folder / RIGHT, origin_s=left.first_time_s)
    size_px = min(left.width_px, right.width_px), min(left.height_px, right.height_px)
    file = rig or find_rig(folder / LEFT)
    if file is None:
        raise RigError(f"{folder}: no rig.yaml or calib.txt in it; give the cameras with --rig FILE.")
    cameras, notes = load_rig(file, size_px=size_px, is_grey=left.is_grey)
    rectifier = Rectifier(cameras, row_offset_px=row_offset_px)
    truth = read_truth(_labels(folder), rectifier.rig.left, left_from_reference_m(file, is_grey=left.is_grey))
    truth = truth.select(_counts(truth))
    focal_baseline_m = rectifier.rig.left.fx_px * rectifier.rig.baseline_m
    with closing(iter(StereoVideo(left, right))) as pairs:
        for left_frame, right_frame in pairs:
            here = truth.select(truth.frame == left_frame.index)
            images = (frame.image[: size_px[1], : size_px[0]] for frame in (left_frame, right_frame))
            yield StereoPair(
                f"{left_frame.index:06d}",
                *rectifier.rectify(*images),
                here.xyxy_px,
                focal_baseline_m / here.distance_m,
                rectifier.rig,
                notes,
                track_id=here.track_id,
            )


def _counts(truth: Truth) -> BoolArray:
    return (truth.class_id >= 0) & (truth.distance_m >= BANDS_M[0]) & (truth.distance_m <= BANDS_M[-1])


def _labels(folder: Path) -> Path:
    found = next((folder / name for name in LABELS if (folder / name).is_file()), None)
    if found is None:
        raise PairFileError(f"{folder}: no {' or '.join(LABELS)} in it: its objects are not known.")
    return found
