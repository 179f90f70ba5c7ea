"""Reader of YOLO label files: one NAME.txt per image, one object per line, in fractions of the
image size.

A line is `class cx cy w h` with an optional score, or a polygon `class x1 y1 x2 y2 x3 y3 ...`,
which is replaced by its bounding box.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from track_range.detection.boxes import xyxy_from_cxcywh
from track_range.detection.classes import ROAD_CLASSES, map_to_road_classes
from track_range.detection.formats.tables.class_names import names_for_folder
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.files.input_files import MAX_TABLE_BYTES, quoted, read_text
from track_range.foundation.files.numeric_text import numbers

_MAX_VALUE = 100_000  # of a class number, fraction or score
_TOLERANCE = 2e-3  # of the image size: boxes this far outside are clipped without a note (rounding)


@dataclass(frozen=True, slots=True)
class YoloLabels:
    """The road users of one label file."""

    # (M, 4) left, top, right, bottom as fractions of the image size, clipped to the image
    xyxy: FloatArray
    class_id: IntArray  # (M,) road class
    score: FloatArray  # (M,) the sixth column; 1 if there is none
    notes: tuple[str, ...]  # a note for the user on each box that was clipped or ignored


class YoloLabelReader:
    """Reader of label files with one list of class names; None = the names for `folder`, else the 8
    road classes.
    """

    def __init__(self, names: Sequence[str] | None, folder: Path | None = None) -> None:
        known = (
            tuple(names)
            if names is not None
            else names_for_folder(folder)
            if folder is not None
            else ()
        )
        self._road: IntArray = map_to_road_classes(known or ROAD_CLASSES)

    def read(self, file: Path) -> YoloLabels:
        """The labels of one image; LabelFileError if a line is invalid, or a class number has no
        name.
        """
        rows, line = _rows(file)
        number = rows[:, 0].astype(np.int64)
        if len(unknown := np.flatnonzero((number < 0) | (number >= len(self._road)))):
            raise LabelFileError(
                f"{file}, line {line[unknown[0]]}: expected a class number from 0 to "
                f"{len(self._road) - 1}, got {number[unknown[0]]}; specify the class names with "
                "--label-names or in data.yaml."
            )
        original = xyxy_from_cxcywh(rows[:, 1:5])
        boxes = np.clip(original, 0.0, 1.0)
        is_clipped = np.abs(boxes - original).max(axis=1, initial=0.0) > _TOLERANCE
        is_valid = (boxes[:, 2] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 1])
        clipped, ignored = (
            "clipped a box that extends beyond the image",
            "ignored a box that is empty or outside",
        )
        notes = [
            f"{file}, line {line[i]}: {clipped if is_valid[i] else ignored}."
            for i in np.flatnonzero(is_clipped | ~is_valid)
        ]
        is_road = is_valid & (self._road[number] >= 0)
        return YoloLabels(
            boxes[is_road], self._road[number[is_road]], rows[is_road, 5], tuple(notes)
        )


def _rows(file: Path) -> tuple[FloatArray, IntArray]:
    """(N, 6) class, centre, size and score of the objects in a file, and (N,) their line numbers
    from 1.
    """
    text = read_text(file, LabelFileError, "YOLO labels", max_bytes=MAX_TABLE_BYTES)
    rows, lines = [], []
    for number, line in enumerate(text.split("\n"), start=1):
        if not (cells := line.split()):
            continue
        row = numbers(cells)
        if len(row) >= 7 and len(row) % 2 and (np.abs(row) <= _MAX_VALUE).all():  # a polygon
            points = np.array(row[1:]).reshape(-1, 2)
            first, last = points.min(axis=0), points.max(axis=0)
            row = [row[0], *((first + last) / 2).tolist(), *(last - first).tolist()]
        row = row if len(row) == 6 else [*row, 1.0]
        if (
            len(row) != 6
            or not (np.abs(row) <= _MAX_VALUE).all()
            or min(row[3:5]) < 0
            or row[0] % 1
        ):
            raise LabelFileError(
                f"{file}, line {number}: expected 'class cx cy w h', an integer and fractions of "
                f"the image size, got {quoted(line.strip())}."
            )
        rows.append(row)
        lines.append(number)
    return np.array(rows, np.float64).reshape(-1, 6), np.array(lines, np.int64)
