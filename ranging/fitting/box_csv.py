"""Boxes with known distances from a CSV file, for fitting size models.

    class,x1,y1,x2,y2,distance_m,fx[,fy,cx,cy,track,sequence]

A file without a header has the columns in this order. Distances are used as given, to any part of the object.
Defaults: fy = fx; cx = the middle of the boxes' horizontal extent; a track per box; a single sequence.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from track_range.detection.boxes import are_valid_boxes
from track_range.detection.classes import ROAD_CLASS_OF, ROAD_CLASSES
from track_range.detection.formats.errors import LabelFileError
from track_range.detection.formats.limits import MAX_COORDINATE_PX, MAX_DISTANCE_M
from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.csv_tables import CsvTable, read_csv_table
from track_range.foundation.files.input_files import quoted
from track_range.ranging.fitting.labelled_boxes import BoxSet

COLUMNS = ("class", "x1", "y1", "x2", "y2", "distance_m", "fx", "fy", "cx", "cy", "track", "sequence")
"""Columns in the order of a file without a header."""

_REQUIRED = COLUMNS[:6]
_NUMERIC = (*COLUMNS[1:10],)
_MAX_TEXT = 200  # largest number of characters of the name of a track or sequence

_POSITIVE = ("distance_m", "fx", "fy")


def read_box_csv(path: Path, *, focal_px: float | None = None) -> tuple[BoxSet, tuple[str, ...]]:
    """Boxes from a CSV file, and notes for the user.

    Args:
        path: the CSV file.
        focal_px: focal length if the file has no column fx.

    Raises:
        LabelFileError: the file cannot be read, a column, number or focal length is missing, a class is unknown, or a
            box has x1 >= x2 or y1 >= y2.
    """
    table = read_csv_table(path, LabelFileError, f"columns {','.join(COLUMNS[:7])}", default_header=COLUMNS)
    table.require(_REQUIRED)
    table.refuse_duplicates(COLUMNS)
    if "fx" not in table and focal_px is None:
        raise LabelFileError(
            f"{path}: expected a focal length; add a column fx (in px) or give --focal-px, either from the camera's "
            "calibration or as image width / (2 tan(field of view / 2))."
        )
    if not len(table):
        raise LabelFileError(f"{path}: expected at least one row below the header, got none.")
    for name in ("track", "sequence"):
        for row in [row for row, text in enumerate(table.texts(name)) if len(text) > _MAX_TEXT][:1]:
            raise table.fault(row, f"expected at most {_MAX_TEXT} characters for {name}.")
    numbers = {name: _numbers(table, name) for name in _NUMERIC if name in table}
    xyxy_px = np.stack([numbers[name] for name in ("x1", "y1", "x2", "y2")], axis=1)
    for row in np.flatnonzero(~are_valid_boxes(xyxy_px)).tolist():
        raise table.fault(row, "expected a box with x1 < x2 and y1 < y2.")
    return _box_set(table, numbers, xyxy_px, focal_px)


def _numbers(table: CsvTable, name: str) -> FloatArray:
    values = table.numbers(name)
    low, high = (0.0, MAX_DISTANCE_M) if name == "distance_m" else (-MAX_COORDINATE_PX, MAX_COORDINATE_PX)
    is_valid = (values >= low) & (values <= high)
    if name in _POSITIVE:
        is_valid &= values > 0
    kind = "a positive number" if name in _POSITIVE else "a finite number"
    table.check(name, values, is_valid, f"{kind} up to {high:,.0f}")
    return values


def _box_set(
    table: CsvTable, numbers: dict[str, FloatArray], xyxy_px: FloatArray, focal_px: float | None
) -> tuple[BoxSet, tuple[str, ...]]:
    n = len(table)
    fx = numbers["fx"] if "fx" in numbers else np.full(n, focal_px)
    middle = np.full(n, (xyxy_px[:, 0].min() + xyxy_px[:, 2].max()) / 2)
    class_texts = table.texts("class")
    names, number = np.unique(table.texts("sequence"), return_inverse=True)
    track = table.texts("track")
    name = table.path.name
    notes = (
        []
        if "cx" in numbers
        else [f"{name} has no column cx; assuming cx = {middle[0]:g} px, midway between the outermost box edges."]
    )
    if len(names) == 1:
        notes.append(f"{name} contains only one sequence; the curves cannot be validated on other drives.")
    boxes = BoxSet(
        sequence_names=tuple(str(name) for name in names),
        sequence=number.astype(np.int64).reshape(n),
        frame=np.arange(n),
        time_s=np.arange(n, dtype=np.float64),
        track_id=np.unique(track, return_inverse=True)[1].astype(np.int64).reshape(n) if track[0] else np.arange(n),
        kitti_type=np.array(class_texts, np.str_),
        class_name=np.array([_class_name(table, row, text) for row, text in enumerate(class_texts)], np.str_),
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


def _class_name(table: CsvTable, row: int, text: str) -> str:
    name = "van" if text.lower() == "van" else ROAD_CLASS_OF.get(text.lower())
    if name is None:
        raise table.fault(row, f"expected a class such as {', '.join(ROAD_CLASSES)}, van, got {quoted(text)}.")
    return name
