"""A user's own boxes with known distances, from a CSV file: class,x1,y1,x2,y2,distance_m,fx[,fy,cx,cy,track,sequence].

Without a header the columns are taken in that order. Distances are the user's own truth, whatever they were measured
to. What is missing: fy is fx; cx is the middle of what the boxes span; without tracks every box is an object of its
own, without sequences all are one.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from track_range.detection.boxes import are_sound
from track_range.detection.classes import ROAD_CLASS_OF
from track_range.detection.formats.kitti import LabelFileError
from track_range.foundation.arrays import FloatArray
from track_range.ranging.fitting.labelled_boxes import BoxSet

COLUMNS = ("class", "x1", "y1", "x2", "y2", "distance_m", "fx", "fy", "cx", "cy", "track", "sequence")
_NEEDED = COLUMNS[:6]
_NUMBERS = (*COLUMNS[1:10],)


def read_box_csv(path: Path, *, focal_px: float | None = None) -> tuple[BoxSet, tuple[str, ...]]:
    """Boxes and notes for the user; `focal_px` serves where there is no column fx.

    Raises:
        LabelFileError: not readable, a column or number missing, a class unknown, a box turned inside out, no focal
            length.
    """
    header, rows = _rows(path)
    missing = [name for name in _NEEDED if name not in header]
    if missing:
        raise LabelFileError(f"{path}: no column {', '.join(missing)}; {','.join(COLUMNS[:7])} wanted.")
    if "fx" not in header and focal_px is None:
        raise LabelFileError(
            f"{path}: no focal length: add a column fx (in pixels), or give --focal-px. A camera's is in its "
            "calibration file, or width / (2 tan(field of view / 2))."
        )
    if not rows:
        raise LabelFileError(f"{path}: the file has no rows below its header.")
    numbers = {name: _numbers(path, header, rows, name) for name in _NUMBERS if name in header}
    fx = numbers.get("fx", np.full(len(rows), focal_px or np.nan))
    _check(path, numbers, fx)
    xyxy_px = np.stack([numbers[name] for name in ("x1", "y1", "x2", "y2")], axis=1)
    bad = np.flatnonzero(~are_sound(xyxy_px))
    if len(bad):
        raise LabelFileError(f"{path}, row {bad[0] + 1}: a box with x1 < x2 and y1 < y2 wanted.")
    return _box_set(path, header, rows, (numbers, fx, xyxy_px))


def _rows(path: Path) -> tuple[list[str], list[list[str]]]:
    """Names of the columns, and the rows below them."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = [[word.strip() for word in row] for row in csv.reader(file) if any(word.strip() for word in row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise LabelFileError(f"{path}: cannot be read as CSV ({type(error).__name__}).") from error
    if not rows:
        raise LabelFileError(f"{path}: the file is empty; {','.join(COLUMNS[:7])} wanted.")
    if "class" in (word.lower() for word in rows[0]):
        return [word.lower() for word in rows[0]], rows[1:]
    return list(COLUMNS[: len(rows[0])]), rows


def _numbers(path: Path, header: Sequence[str], rows: Sequence[Sequence[str]], name: str) -> FloatArray:
    column = header.index(name)
    values = np.empty(len(rows))
    for number, row in enumerate(rows):
        try:
            values[number] = float(row[column])
        except (IndexError, ValueError):
            raise LabelFileError(f"{path}, row {number + 1}: a number wanted for {name}.") from None
    return values


def _check(path: Path, numbers: dict[str, FloatArray], fx: FloatArray) -> None:
    for name, values in (*numbers.items(), ("fx", fx)):
        lowest = 0.0 if name in ("distance_m", "fx", "fy") else -np.inf
        bad = np.flatnonzero(~(np.isfinite(values) & (values > lowest)))
        if len(bad):
            what = "positive number" if lowest == 0.0 else "finite number"
            raise LabelFileError(f"{path}, row {bad[0] + 1}: a {what} wanted for {name}, not {values[bad[0]]:g}.")


def _box_set(
    path: Path,
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    found: tuple[dict[str, FloatArray], FloatArray, FloatArray],
) -> tuple[BoxSet, tuple[str, ...]]:
    numbers, fx, xyxy_px = found
    n = len(rows)
    middle = np.full(n, (xyxy_px[:, 0].min() + xyxy_px[:, 2].max()) / 2)
    words = [row[header.index("class")] for row in rows]
    sequence = _named(header, rows, "sequence")
    names, number = np.unique(sequence, return_inverse=True)
    track = _named(header, rows, "track")
    notes = [] if "cx" in numbers else [f"{path.name} has no column cx: the image's middle taken at x = {middle[0]:g}."]
    if len(names) == 1:
        notes.append(f"{path.name} is one sequence: nothing tells how curves do on other drives.")
    boxes = BoxSet(
        sequence_names=tuple(str(name) for name in names),
        sequence=number.astype(np.int64).reshape(n),
        frame=np.arange(n),
        time_s=np.arange(n, dtype=np.float64),
        track_id=np.unique(track, return_inverse=True)[1].astype(np.int64).reshape(n) if track[0] else np.arange(n),
        kitti_type=np.array(words, np.str_),
        class_name=np.array([_class(path, word) for word in words], np.str_),
        xyxy_px=xyxy_px,
        fxycxy_px=np.stack([fx, numbers.get("fy", fx), numbers.get("cx", middle), numbers.get("cy", 0 * fx)], axis=1),
        size_px=np.tile(np.ceil(xyxy_px[:, 2:].max(axis=0)).astype(np.int64) + 1, (n, 1)),
        distance_m=numbers["distance_m"],
        alpha_rad=np.full(n, np.nan),
        x_m=np.full(n, np.nan),
        size_hwl_m=np.full((n, 3), np.nan),
        rotation_y_rad=np.full(n, np.nan),
        occluded=np.zeros(n, np.int64),
    )
    return boxes, tuple(notes)


def _named(header: Sequence[str], rows: Sequence[Sequence[str]], name: str) -> list[str]:
    column = header.index(name) if name in header else None
    return [row[column] if column is not None and column < len(row) else "" for row in rows]


def _class(path: Path, word: str) -> str:
    name = "van" if word.lower() == "van" else ROAD_CLASS_OF.get(word.lower())
    if name is None:
        raise LabelFileError(f"{path}: class '{word}' is unknown; of {', '.join(sorted(ROAD_CLASS_OF))}.")
    return name
