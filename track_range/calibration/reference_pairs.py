"""Stereo pairs with objects of known distance or disparity, to which the alignment of a rig is fitted.

    DIR          KITTI 2015's layout, or a drive: left.mp4, right.mp4, rig.yaml and truth.csv (KITTI: label.txt)
    LABELS       KITTI tracking labels of two videos, or a CSV file as for `--truth`
    FILE.csv     frame,x1,y1,x2,y2 and distance_m or disparity_px (and id, -1 = unknown) of two videos; frames count
                 from 0

A distance is that of the visible surface at the box centre, along the left camera's optical axis.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from track_range.calibration.drive_pairs import KnownObjects, is_drive, known_pairs, open_pair, read_drive
from track_range.detection.boxes import are_valid_boxes
from track_range.detection.formats.errors import LabelFileError
from track_range.detection.formats.limits import MAX_COORDINATE_PX, MAX_FRAME, MAX_ID, are_plausible_boxes
from track_range.detection.formats.video_labels.csv_labels import has_label_columns
from track_range.foundation.errors import UsageError
from track_range.foundation.files.csv_tables import CsvTable, read_csv_table
from track_range.ranging.evaluation.truth import read_truth
from track_range.recording.recording import Recording
from track_range.stereo.evaluation.kitti_2015 import StereoPair, is_kitti_2015, read_pairs
from track_range.stereo.geometry.rig import StereoRig

_BOX = ("x1", "y1", "x2", "y2")
_KNOWN = ("distance_m", "disparity_px")
_PLAUSIBLE = {"distance_m": (0.1, 10_000.0), "disparity_px": (0.01, 10_000.0)}  # accepted range of each kind of value


def reference_pairs(reference: Path, *, stereo: tuple[Path, Path] | None, rig: Path | None) -> Iterator[StereoPair]:
    """The pairs with their known objects, read one by one.

    `reference` is a file or folder of one of the kinds above, `stereo` the left and right video for a file, `rig` a rig
    file, None = the one next to the images. Raises UsageError for a file without videos, or a folder with videos, and
    PairFileError, LabelFileError, VideoError or RigError if an input cannot be used.
    """
    if not reference.exists():
        raise LabelFileError(f"{reference}: no such file or folder; check the name.")
    if reference.is_dir():
        if stereo is not None:
            raise UsageError("--reference DIR includes the images; omit --stereo, or give a file.")
        is_labelled_drive = is_drive(reference) and not is_kitti_2015(reference)
        return read_drive(reference, rig=rig) if is_labelled_drive else read_pairs(reference, rig=rig)
    if stereo is None:
        raise UsageError("--reference FILE needs the videos of its objects; give them with --stereo LEFT RIGHT.")
    return _video_pairs(reference, *open_pair(*stereo, rig))


def _video_pairs(reference: Path, recording: Recording, rectified: StereoRig) -> Iterator[StereoPair]:
    """The pairs with known objects, up to the last object."""
    with closing(recording):
        if reference.suffix.lower() == ".csv" and not has_label_columns(reference):
            known = _of_table(reference, rectified)
        else:
            truth = read_truth(reference, rectified.left, recording.calibration.left_from_reference_m)
            truth = truth.select((truth.class_id >= 0) & np.isfinite(truth.distance_m))
            if not len(truth):
                raise LabelFileError(
                    f"{reference}: expected objects of a road class with a known distance, found none."
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
    expected = "a header and rows of frame,x1,y1,x2,y2 and either distance_m or disparity_px (and id, if known)"
    table = read_csv_table(path, LabelFileError, expected)
    given = [name for name in _KNOWN if name in table]
    if len(given) != 1 or not len(table) or not {"frame", *_BOX} <= set(table.header):
        raise LabelFileError(f"{path}: expected {expected}.")
    frame, value = table.finite("frame"), table.finite(given[0])
    box = np.stack([table.finite(name) for name in _BOX], axis=1)
    low, high = _PLAUSIBLE[given[0]]
    table.check(given[0], value, (value >= low) & (value <= high), f"{low:g} .. {high:g}")
    for row in np.flatnonzero(~(are_valid_boxes(box) & are_plausible_boxes(box)))[:1].tolist():
        raise table.fault(row, f"expected a box with x1 < x2, y1 < y2 and edges up to {MAX_COORDINATE_PX:,.0f} px.")
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
    table.check(name, values, is_valid, f"an integer from {low} to {high}")
