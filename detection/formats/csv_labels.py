"""Ground truth as CSV: the box, distance and closing speed of every object in every frame.

    frame,id,class,x1,y1,x2,y2,distance_m[,visible_share,closing_mps]

A first line names the columns, in any order; other columns (time_s, lane, ...) are ignored. The simulation's truth.csv
has this format, and measurements of a lidar or radar can be written in it.

    frame           from 0, of the left video
    id              whole number from 0, one per object
    class           a road class or a usual name of one (van, pedestrian, ...); dontcare = a region where nothing counts
    x1 y1 x2 y2     0-based rectified pixels
    distance_m      z of the visible surface at the box's middle, left camera's frame
    visible_share   0..1 of the object that is neither hidden nor outside the image
    closing_mps     how fast the object comes nearer

The last three may be empty or nan where they are not known; an unknown visible share is 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from track_range.detection.boxes import are_valid_boxes
from track_range.detection.classes import ROAD_CLASS_OF, ROAD_CLASSES, map_to_road_classes
from track_range.detection.formats.detection_files import MAX_FRAME
from track_range.detection.formats.kitti import LabelFileError
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.csv_tables import CsvTable, read_csv_table

NEEDED = ("frame", "id", "class", "x1", "y1", "x2", "y2", "distance_m")
OPTIONAL = ("visible_share", "closing_mps")

DONT_CARE = "dontcare"

_BOX = ("x1", "y1", "x2", "y2")
_MAX_ID = 2**53 - 1
"""Largest whole number that a float64 holds exactly."""

_FAR_PX, _FAR_M, _FAST_MPS = 1e7, 1e5, 1e3

_PLAUSIBLE = {
    "frame": (0.0, MAX_FRAME, "a whole number from 0"),
    "id": (0.0, _MAX_ID, "a whole number from 0"),
    **dict.fromkeys(_BOX, (-_FAR_PX, _FAR_PX, "a number of pixels")),
    "distance_m": (0.0, _FAR_M, "a positive number, or an empty cell where it is not known"),
    "visible_share": (0.0, 1.0, "0 .. 1, or an empty cell"),
    "closing_mps": (-_FAST_MPS, _FAST_MPS, "a speed in m/s, or an empty cell where it is not known"),
}
"""Smallest and largest value of each column, and what is expected there."""

_MAY_BE_EMPTY = ("distance_m", *OPTIONAL)
_UNKNOWN = ("", "nan")
_WHOLE = ("frame", "id")


@dataclass(frozen=True, slots=True)
class CsvLabels:
    """Rows of a file of labels, in its order.

    Attributes:
        frame: (N,) frame number from 0.
        track_id: (N,) identity; -1 = a region where nothing counts.
        word: (N,) the row's own word for the class, in lower case.
        class_id: (N,) road class; -1 = a region where nothing counts.
        xyxy_px: (N, 4) box.
        distance_m: (N,) NaN = not known.
        visible_share: (N,) 0..1; 1 where the file does not say.
        closing_mps: (N,) NaN = not known.
    """

    frame: IntArray
    track_id: IntArray
    word: npt.NDArray[np.str_]
    class_id: IntArray
    xyxy_px: FloatArray
    distance_m: FloatArray
    visible_share: FloatArray
    closing_mps: FloatArray


def is_label_csv(path: Path) -> bool:
    """Whether a file is meant as CSV: its first line has commas or names `distance_m`, or it is an empty .csv."""
    first = _first_line(path)
    return first is not None and (
        "," in first or "distance_m" in first.lower() or (not first and path.suffix.lower() == ".csv")
    )


def is_whole_label_csv(path: Path) -> bool:
    """Whether a file's first line names all the columns that labels need."""
    names = (_first_line(path) or "").strip().lower().split(",")
    return set(NEEDED) <= {name.strip() for name in names}


def _first_line(path: Path) -> str | None:
    """The first line that is not blank; "" = none, None = unreadable."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            return next((line for line in file if line.strip()), "")
    except (OSError, UnicodeDecodeError):
        return None


def read_csv_labels(path: Path) -> CsvLabels:
    """Read a file of labels.

    Raises:
        LabelFileError: unreadable, empty, without a required column; a cell out of range, a box with x1 >= x2 or
            y1 >= y2, an unknown class, an identity twice in a frame.
    """
    table = _read_table(path)
    words = _class_names(table)
    is_region = words == DONT_CARE
    numbers = {name: _numbers(table, name, is_region) for name in (*NEEDED, *OPTIONAL) if name != "class"}
    boxes = np.stack([numbers[name] for name in _BOX], axis=1)
    for row in np.flatnonzero(~are_valid_boxes(boxes)).tolist():
        raise table.fault(row, "expected a box with x1 < x2 and y1 < y2.")
    labels = CsvLabels(
        frame=numbers["frame"].astype(np.int64),
        track_id=np.where(is_region, -1, numbers["id"]).astype(np.int64),
        word=words,
        class_id=map_to_road_classes([str(word) for word in words]),
        xyxy_px=boxes,
        distance_m=np.where(is_region, np.nan, numbers["distance_m"]),
        visible_share=np.where(np.isnan(numbers["visible_share"]), 1.0, numbers["visible_share"]),
        closing_mps=np.where(is_region, np.nan, numbers["closing_mps"]),
    )
    _check_unique(table, labels)
    return labels


def _read_table(path: Path) -> CsvTable:
    expected = f"a first line with the columns {','.join(NEEDED)} (and, if known, {','.join(OPTIONAL)})"
    table = read_csv_table(path, LabelFileError, expected, exact=True)
    if len(table.header) == 1 or not set(NEEDED) & set(table.header):
        raise LabelFileError(f"{path}: no header with commas between names; expected {expected}.")
    table.require(NEEDED)
    table.refuse_duplicates(OPTIONAL)
    return table


def _class_names(table: CsvTable) -> npt.NDArray[np.str_]:
    """(N,) classes in lower case."""
    words = [word.lower() for word in table.texts("class")]
    for row, word in enumerate(words):
        if word not in ROAD_CLASS_OF and word != DONT_CARE:
            known = ", ".join(ROAD_CLASSES)
            raise table.fault(row, f"class '{word}' is unknown; it must be {known}, or {DONT_CARE} for a region.")
    return np.array(words, np.str_)


def _numbers(table: CsvTable, name: str, is_region: npt.NDArray[np.bool_]) -> FloatArray:
    """(N,) numbers of a column; NaN where a cell may be empty and is, or there is no such column."""
    values = table.numbers(name)
    low, high, expected = _PLAUSIBLE[name]
    is_valid = (values >= low) & (values <= high)
    if name == "distance_m":
        is_valid &= values > 0
    if name in _WHOLE:
        is_valid &= np.rint(values) == values
    if name in _MAY_BE_EMPTY:
        is_valid |= np.array([cell.lower() in _UNKNOWN for cell in table.texts(name)], np.bool_)
    if name not in ("frame", *_BOX):
        is_valid |= is_region
    table.check(name, values, is_valid, expected)
    return values


def _check_unique(table: CsvTable, labels: CsvLabels) -> None:
    """Refuse an identity that is in two places at once."""
    seen: set[tuple[int, int]] = set()
    for row, key in enumerate(zip(labels.frame.tolist(), labels.track_id.tolist(), strict=True)):
        if key in seen and key[1] >= 0:
            raise table.fault(row, f"id {key[1]} twice in frame {key[0]}; an object can be in one place only.")
        seen.add(key)
