"""Stereo pairs with objects of known distance or disparity, to which the alignment of a rig is
fitted.

    DIR          KITTI 2015's layout, or a labelled drive, as written by `simulate` or the demo: left.mp4, right.mp4
                 (or folders left/, right/ of images), rig.yaml (or calib.txt), truth.csv (or
                 truth.txt, label.txt: KITTI tracking labels)
    LABELS       KITTI tracking labels of two videos, or a CSV file as for `--truth`
    FILE.csv     frame,x1,y1,x2,y2 and distance_m or disparity_px (and id, -1 = unknown) of two videos; frames count
                 from 0

A distance belongs to the visible surface on the ray through the box centre, along the left camera's
optical axis: from truth.csv, else from the label's 3-D box. Of a drive, objects are the labels that
`ranging.truth.truth` evaluates (not truncated, at most partly occluded, of a road class). The
true disparity is f B / distance.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from track_range.detection.boxes import are_valid_boxes
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.limits import (
    MAX_COORDINATE_PX,
    MAX_FRAME,
    MAX_ID,
    are_plausible_boxes,
)
from track_range.detection.formats.video_labels.csv_labels import has_label_columns
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.errors import UsageError
from track_range.foundation.files.csv_tables import CsvTable, read_csv_table
from track_range.ranging.truth.errors import BANDS_M
from track_range.ranging.truth.truth import Truth, read_truth
from track_range.recording.recording import Recording, open_recording
from track_range.recording.video.layouts import LayoutOption
from track_range.stereo.evaluation.kitti_2015 import (
    PairFileError,
    StereoPair,
    is_kitti_2015,
    read_pairs,
)
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.rig import RigError, StereoRig

LEFT, RIGHT = "left.mp4", "right.mp4"  # else folders of images without .mp4
# names of label files; the first one that exists is used
LABELS = ("truth.csv", "truth.txt", "label.txt")
_BOX = ("x1", "y1", "x2", "y2")
_KNOWN = ("distance_m", "disparity_px")
# accepted range of each kind of value
_PLAUSIBLE = {"distance_m": (0.1, 10_000.0), "disparity_px": (0.01, 10_000.0)}


def is_drive(folder: Path) -> bool:
    """Whether a folder has one of a drive's two videos, or folders of images."""
    return any(_side(folder, name).exists() for name in (LEFT, RIGHT))


def _side(folder: Path, name: str) -> Path:
    """The images of one camera: a folder if there is one and no video."""
    video, images = folder / name, folder / Path(name).stem
    return images if images.is_dir() and not video.is_file() else video


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
    """The pairs of a recording in order of time, named by frame, with their known objects, perhaps
    none.
    """
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


def read_drive(
    folder: Path,
    *,
    rig: Path | None = None,
    row_offset_px: float = 0.0,
    truth: Sequence[Path] = (),
) -> Iterator[StereoPair]:
    """The pairs of a drive in order of time, named by frame; pairs without evaluated objects are
    included.

    `rig` is a rig file, None = the one in the folder; `row_offset_px`, y_right - y_left, is
    corrected in the right images; `truth` are files of objects, () = that in the folder. Raises
    VideoError, RigError, LabelFileError or PairFileError if videos, rig or labels cannot be used.
    """
    rows = Alignment(row_offset_px=row_offset_px)
    recording, rectified = open_pair(_side(folder, LEFT), _side(folder, RIGHT), rig, align=rows)
    with closing(recording):
        usual = next((folder / name for name in LABELS if (folder / name).is_file()), None)
        files = tuple(truth) or (() if usual is None else (usual,))
        if not files:
            raise PairFileError(
                f"{folder}: expected labels in {', '.join(LABELS[:-1])} or "
                f"{LABELS[-1]}, found none."
            )
        shift_m = recording.calibration.left_from_reference_m
        labels = [read_truth(file, rectified.left, shift_m) for file in files]
        yield from known_pairs(recording, rectified, _joined(labels, rectified))


def _joined(labels: Sequence[Truth], rig: StereoRig) -> KnownObjects:
    """The scored objects of several files, whose identities are made different."""
    parts, first_id = list[KnownObjects](), 0
    for truth in labels:
        in_range = (truth.distance_m >= BANDS_M[0]) & (truth.distance_m <= BANDS_M[-1])
        part = KnownObjects.of(truth.select((truth.class_id >= 0) & in_range), rig)
        parts.append(
            replace(part, track_id=truth.track_id[in_range & (truth.class_id >= 0)] + first_id)
        )
        first_id += int(truth.track_id.max(initial=0)) + 1
    names = [one.name for one in fields(KnownObjects)]
    return KnownObjects(
        **{name: np.concatenate([getattr(p, name) for p in parts]) for name in names}
    )


def open_pair(
    left: Path,
    right: Path,
    rig: Path | None,
    *,
    align: str | Alignment = "off",
    has_checks: bool = False,
    stereo_layout: LayoutOption = "auto",
) -> tuple[Recording, StereoRig]:
    """Open a calibrated pair; returns the recording and its rectified rig.

    `rig` is a rig file, None = the one next to the left video; other arguments: see
    `open_recording`. Raises VideoError if a video cannot be used, and RigError without a usable
    rig, or, with checks, if left and right are swapped.
    """
    recording = open_recording(
        left, right, rig=rig, align=align, has_checks=has_checks, stereo_layout=stereo_layout
    )
    is_calibrated = recording.calibration.kind == "rig"
    if is_calibrated and recording.rig is not None:
        return recording, recording.rig
    finding = recording.finding
    recording.close()
    if is_calibrated and finding is not None:
        raise RigError(f"{left}: {finding.explanation}.")
    raise RigError(
        f"{left}: no rig.yaml or calib.txt next to it; give the calibration file with --rig FILE."
    )


def reference_pairs(
    reference: Path,
    *,
    stereo: tuple[Path, Path] | None,
    rig: Path | None,
    stereo_layout: LayoutOption = "auto",
) -> Iterator[StereoPair]:
    """The pairs with their known objects, read one by one.

    `reference` is a file or folder of one of the kinds above, `stereo` the left and right video for
    a file (equal for one video of both cameras), `rig` a rig file, None = the one next to the
    images. Raises UsageError for a file without videos or a folder with videos; PairFileError,
    LabelFileError, VideoError or RigError for an unusable input.
    """
    if not reference.exists():
        raise LabelFileError(f"{reference}: no such file or folder; check the name.")
    if reference.is_dir():
        if stereo is not None:
            raise UsageError("--reference DIR includes the images; omit --stereo, or give a file.")
        is_labelled_drive = is_drive(reference) and not is_kitti_2015(reference)
        return (
            read_drive(reference, rig=rig) if is_labelled_drive else read_pairs(reference, rig=rig)
        )
    if stereo is None:
        raise UsageError(
            "--reference FILE needs the videos of its objects; give them with --stereo LEFT RIGHT."
        )
    return _video_pairs(reference, *open_pair(*stereo, rig, stereo_layout=stereo_layout))


def _video_pairs(
    reference: Path, recording: Recording, rectified: StereoRig
) -> Iterator[StereoPair]:
    with closing(recording):
        if reference.suffix.lower() == ".csv" and not has_label_columns(reference):
            known = _of_table(reference, rectified)
        else:
            truth = read_truth(
                reference, rectified.left, recording.calibration.left_from_reference_m
            )
            truth = truth.select((truth.class_id >= 0) & np.isfinite(truth.distance_m))
            if not len(truth):
                raise LabelFileError(
                    f"{reference}: expected objects of a road class with a known distance, found "
                    "none."
                )
            known = KnownObjects.of(truth, rectified)
        if known.track_id is not None and (known.track_id < 0).any():
            known = replace(known, track_id=None)
        last = int(known.frame.max())
        for pair in known_pairs(recording, rectified, known):
            if len(pair.true_px):
                yield pair
            if int(pair.name) >= last:
                return


def _of_table(path: Path, rig: StereoRig) -> KnownObjects:
    expected = (
        "a header and rows of frame,x1,y1,x2,y2 and either distance_m or disparity_px (and id, if "
        "known)"
    )
    table = read_csv_table(path, LabelFileError, expected)
    given = [name for name in _KNOWN if name in table]
    if len(given) != 1 or not len(table) or not {"frame", *_BOX} <= set(table.header):
        raise LabelFileError(f"{path}: expected {expected}.")
    frame, value = table.finite("frame"), table.finite(given[0])
    box = np.stack([table.finite(name) for name in _BOX], axis=1)
    low, high = _PLAUSIBLE[given[0]]
    table.check(given[0], (value >= low) & (value <= high), f"{low:g} .. {high:g}")
    for row in np.flatnonzero(~(are_valid_boxes(box) & are_plausible_boxes(box)))[:1].tolist():
        raise table.fault(
            row,
            f"expected a box with x1 < x2, y1 < y2 and edges up to {MAX_COORDINATE_PX:,.0f} px.",
        )
    _check_integers(table, "frame", 0, MAX_FRAME)
    ids = np.full(len(table), -1)
    if "id" in table:
        _check_integers(table, "id", -1, MAX_ID)
        ids = table.numbers("id").astype(np.int64)
    true_px = value if given[0] == "disparity_px" else rig.left.fx_px * rig.baseline_m / value
    return KnownObjects(frame.astype(np.int64), ids, box, true_px)


def _check_integers(table: CsvTable, name: str, low: int, high: int) -> None:
    values = table.numbers(name)
    is_valid = (values >= low) & (values <= high) & (np.rint(values) == values)
    table.check(name, is_valid, f"an integer from {low} to {high}")
