"""YOLO label files: one NAME.txt per image, each line one object, in shares of the image.

A line is `class cx cy w h`, or with a sixth column, a score; `class x1 y1 x2 y2 x3 y3 ...` is an outline, of which the
box around it is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from track_range.detection.boxes import xyxy_from_cxcywh
from track_range.detection.classes import ROAD_CLASSES, map_to_road_classes
from track_range.detection.formats.kitti import LabelFileError
from track_range.detection.models.metadata import names_of
from track_range.foundation.arrays import FloatArray, IntArray

_NAME_FILES = ("classes.txt", "data.yaml", "data.yml")
_MAX_CLASS = 100_000
_TOLERANCE = 2e-3
"""How far a box may lie outside its image, as a share, without a word: labels are rounded."""


@dataclass(frozen=True, slots=True)
class YoloLabels:
    """The road users of one label file.

    Attributes:
        xyxy: (M, 4) left, top, right, bottom as shares of the image, inside it.
        class_id: (M,) road class.
        score: (M,) the sixth column; 1 where there is none.
        notes: a sentence for each box that was cut at the image's edge or left out.
    """

    xyxy: FloatArray
    class_id: IntArray
    score: FloatArray
    notes: tuple[str, ...]


class YoloLabelReader:
    """Reads label files of one list of classes."""

    def __init__(self, names: Sequence[str] | None, folder: Path | None = None) -> None:
        """Know what the numbers mean.

        Args:
            names: class names; None = from classes.txt or data.yaml in `folder` or above it, else the 8 road classes.
            folder: of the label files.

        Raises:
            LabelFileError: the file of names there has none.
        """
        known = tuple(names) if names is not None else names_beside(folder) if folder is not None else ()
        self._road: IntArray = map_to_road_classes(known or ROAD_CLASSES)

    def read(self, file: Path) -> YoloLabels:
        """The labels of one image.

        Raises:
            LabelFileError: not readable, a line that is none, or a class number without a name.
        """
        rows, line = _rows(file)
        number = rows[:, 0].astype(np.int64)
        if len(wrong := np.flatnonzero((number < 0) | (number >= len(self._road)))):
            raise LabelFileError(
                f"{file}, line {line[wrong[0]]}: class {number[wrong[0]]}, but only {len(self._road)} class names are "
                "known; give --label-names, or names in data.yaml."
            )
        whole = xyxy_from_cxcywh(rows[:, 1:5])
        boxes = np.clip(whole, 0.0, 1.0)
        is_cut = np.abs(boxes - whole).max(axis=1, initial=0.0) > _TOLERANCE
        is_there = (boxes[:, 2] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 1])
        cut, gone = "reaches out of the image: cut at its edge", "is empty, or not in the image: left out"
        notes = [
            f"{file}, line {line[i]}: the box {cut if is_there[i] else gone}."
            for i in np.flatnonzero(is_cut | ~is_there)
        ]
        keep = is_there & (self._road[number] >= 0)
        return YoloLabels(boxes[keep], self._road[number[keep]], rows[keep, 5], tuple(notes))


def names_beside(folder: Path) -> tuple[str, ...]:
    """Class names of classes.txt or data.yaml in a folder of labels or the one above; empty = there are none.

    Raises:
        LabelFileError: there is such a file, but without names.
    """
    for file in (place / name for place in (folder, folder.parent) for name in _NAME_FILES):
        if not file.is_file():
            continue
        try:
            text = file.read_text(encoding="utf-8-sig")
            if file.suffix == ".txt":
                return tuple(line.strip() for line in text.splitlines() if line.strip())
            return names_of(yaml.safe_load(text)["names"])
        except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
            raise LabelFileError(f"{file}: no list of class names in it ({type(error).__name__}).") from error
    return ()


def _rows(file: Path) -> tuple[FloatArray, IntArray]:
    """(N, 6) class, centre, size and score of a file, and (N,) the number of each line."""
    try:
        text = file.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise LabelFileError(f"{file}: not readable as text ({error}).") from error
    rows, lines = [], []
    for number, line in enumerate(text, start=1):
        if words := line.split():
            row = _row(words)
            if not np.isfinite(row).all() or min(row[3:5]) < 0 or row[0] % 1 or abs(row[0]) > _MAX_CLASS:
                raise LabelFileError(
                    f"{file}, line {number}: 'class cx cy w h' wanted, a whole number and shares of the image, not "
                    f"'{line.strip()[:40]}'."
                )
            rows.append(row)
            lines.append(number)
    return np.array(rows, np.float64).reshape(-1, 6), np.array(lines, np.int64)


def _row(words: Sequence[str]) -> list[float]:
    """Class, centre, size and score of one line; NaN for what cannot be read."""
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) in (5, 6):
        return numbers if len(numbers) == 6 else [*numbers, 1.0]
    if len(numbers) < 7 or len(numbers) % 2 == 0:
        return [np.nan] * 6
    points = np.array(numbers[1:]).reshape(-1, 2)
    first, last = points.min(axis=0), points.max(axis=0)
    return [numbers[0], *((first + last) / 2).tolist(), *(last - first).tolist(), 1.0]
