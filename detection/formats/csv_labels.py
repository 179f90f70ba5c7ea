"""Labels of a user's own as CSV: who is where in which frame, how far, and how fast it comes nearer.

    frame,id,class,x1,y1,x2,y2,distance_m[,visible_share,closing_mps]

A first line names the columns, in any order; others (time_s, lane, ...) are passed over. It is what the simulation's
truth.csv has, and where the readings of a lidar or radar can be written down.

    frame           from 0, of the left video
    id              whole number from 0, one per object
    class           a road class or a usual name of one (van, pedestrian, ...); dontcare = a region where nothing counts
    x1 y1 x2 y2     0-based rectified pixels
    distance_m      z of the visible surface at the box's middle, left camera's frame
    visible_share   0..1 of the object that is neither hidden nor outside the image
    closing_mps     how fast the object comes nearer

The last three may be empty or nan where they are not known; objects are all visible then.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from track_range.detection.boxes import are_sound
from track_range.detection.classes import ROAD_CLASS_OF, ROAD_CLASSES, road_class_of_each
from track_range.detection.formats.detection_files import MAX_FRAME
from track_range.detection.formats.kitti import LabelFileError
from track_range.foundation.arrays import FloatArray, IntArray

NEEDED = ("frame", "id", "class", "x1", "y1", "x2", "y2", "distance_m")
OPTIONAL = ("visible_share", "closing_mps")

DONT_CARE = "dontcare"

_BOX = ("x1", "y1", "x2", "y2")
_MAX_ID = 2**53 - 1
"""Larger whole numbers are not told apart."""

_FAR_PX, _FAR_M, _FAST_MPS = 1e7, 1e5, 1e3

_PLAUSIBLE = {
    "frame": (0.0, MAX_FRAME, "a whole number from 0"),
    "id": (0.0, _MAX_ID, "a whole number from 0"),
    **dict.fromkeys(_BOX, (-_FAR_PX, _FAR_PX, "a number of pixels")),
    "distance_m": (0.0, _FAR_M, "a positive number, or an empty cell where it is not known,"),
    "visible_share": (0.0, 1.0, "0 .. 1, or an empty cell,"),
    "closing_mps": (-_FAST_MPS, _FAST_MPS, "a speed in m/s, or an empty cell where it is not known,"),
}
"""Least and greatest value of each column, and what is wanted there."""

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


@dataclass(frozen=True, slots=True)
class _Table:
    """The rows under a header: their cells, and the line of the file that each is on."""

    path: Path
    header: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]

    def fault(self, row: int, words: str) -> LabelFileError:
        return LabelFileError(f"{self.path}, line {self.lines[row]}: {words}")


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
        LabelFileError: unreadable, empty, without a needed column; a cell that is not what it should be, a box turned
            inside out, an unknown class, an identity twice in a frame.
    """
    table = _read_table(path)
    words = _words(table)
    is_region = words == DONT_CARE
    numbers = {name: _numbers(table, name, is_region) for name in (*NEEDED, *OPTIONAL) if name != "class"}
    boxes = np.stack([numbers[name] for name in _BOX], axis=1)
    for row in np.flatnonzero(~are_sound(boxes)).tolist():
        raise table.fault(row, "a box with x1 < x2 and y1 < y2 wanted.")
    labels = CsvLabels(
        frame=numbers["frame"].astype(np.int64),
        track_id=np.where(is_region, -1, numbers["id"]).astype(np.int64),
        word=words,
        class_id=road_class_of_each([str(word) for word in words]),
        xyxy_px=boxes,
        distance_m=np.where(is_region, np.nan, numbers["distance_m"]),
        visible_share=np.where(np.isnan(numbers["visible_share"]), 1.0, numbers["visible_share"]),
        closing_mps=np.where(is_region, np.nan, numbers["closing_mps"]),
    )
    _check_once(table, labels)
    return labels


def _read_table(path: Path) -> _Table:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            found = [
                (reader.line_num, [cell.strip() for cell in row]) for row in reader if any(cell.strip() for cell in row)
            ]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise LabelFileError(f"{path}: cannot be read as CSV ({type(error).__name__}).") from error
    if not found:
        raise LabelFileError(f"{path}: the file is empty; {_wanted()}")
    table = _Table(
        path, tuple(cell.lower() for cell in found[0][1]), [row for _, row in found[1:]], [n for n, _ in found[1:]]
    )
    _check_header(table)
    for number, row in enumerate(table.rows):
        if len(row) != len(table.header):
            raise table.fault(number, f"{len(table.header)} cells, as in the header, wanted; found {len(row)}.")
    return table


def _wanted() -> str:
    return f"a first line with the columns {','.join(NEEDED)} wanted (and, if known, {','.join(OPTIONAL)})."


def _check_header(table: _Table) -> None:
    header = table.header
    missing = [name for name in NEEDED if name not in header]
    if len(missing) == len(NEEDED) or len(header) == 1:
        raise LabelFileError(f"{table.path}: no header with commas between names: {_wanted()}")
    if missing:
        raise LabelFileError(f"{table.path}: no column {', '.join(missing)}; {_wanted()}")
    for name in (*NEEDED, *OPTIONAL):
        if header.count(name) > 1:
            raise LabelFileError(f"{table.path}: two columns are called {name}.")


def _words(table: _Table) -> npt.NDArray[np.str_]:
    """(N,) classes in lower case."""
    column = table.header.index("class")
    words = [row[column].lower() for row in table.rows]
    for row, word in enumerate(words):
        if word not in ROAD_CLASS_OF and word != DONT_CARE:
            known = ", ".join(ROAD_CLASSES)
            raise table.fault(row, f"class '{word}' is unknown; it must be {known}, or {DONT_CARE} for a region.")
    return np.array(words, np.str_)


def _numbers(table: _Table, name: str, is_region: npt.NDArray[np.bool_]) -> FloatArray:
    """(N,) numbers of a column; NaN where a cell may be empty and is, or there is no such column."""
    if name not in table.header:
        return np.full(len(table.rows), np.nan)
    column = table.header.index(name)
    may_be_empty = np.full(len(table.rows), name in _MAY_BE_EMPTY) | (is_region & (name == "id"))
    values = np.array([_number(row[column]) for row in table.rows])
    empty = may_be_empty & np.array([row[column].lower() in _UNKNOWN for row in table.rows], np.bool_)
    low, high, wanted = _PLAUSIBLE[name]
    is_sound = (values >= low) & (values <= high)
    if name == "distance_m":
        is_sound &= values > 0
    if name in _WHOLE:
        is_sound &= np.rint(values) == values
    ignored = is_region & (name not in ("frame", *_BOX))
    for row in np.flatnonzero(~(is_sound | empty | ignored)).tolist():
        raise table.fault(row, f"{wanted} wanted for {name}, not '{table.rows[row][column]}'.")
    return values


def _number(cell: str) -> float:
    try:
        return np.nan if "_" in cell else float(cell)
    except ValueError:
        return np.nan


def _check_once(table: _Table, labels: CsvLabels) -> None:
    """Refuse an identity that is in two places at once."""
    seen: set[tuple[int, int]] = set()
    for row, key in enumerate(zip(labels.frame.tolist(), labels.track_id.tolist(), strict=True)):
        if key in seen and key[1] >= 0:
            raise table.fault(row, f"id {key[1]} stands twice in frame {key[0]}; an object can be in one place only.")
        seen.add(key)
