"""Reader of ground truth as CSV: box, distance and closing speed of every object in every frame.

    frame,id,class,x1,y1,x2,y2,distance_m[,visible_share,closing_mps]

The first line has the names of the columns, in any order; other columns (time_s, lane, ...) are
ignored. The simulation's truth.csv has this format; measurements of a lidar or radar can be
converted to this format.

    frame           frame number from 0, of the left video
    id              integer from 0, one per object
    class           a road class or a synonym (van, pedestrian, ...); other names are objects that are not
                    scored; dontcare = a region that is not evaluated
    x1 y1 x2 y2     rectified pixels, 0-based
    distance_m      z of the visible surface at the centre of the box, in the left camera's frame
    visible_share   visible fraction 0..1 of the object, neither occluded nor outside the image
    closing_mps     closing speed, positive when approaching

The last three may be empty or nan if unknown; an unknown visible fraction is 1.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from track_range.detection.boxes import are_valid_boxes
from track_range.detection.classes import ROAD_CLASSES, map_to_road_classes
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.limits import (
    MAX_COORDINATE_PX,
    MAX_DISTANCE_M,
    MAX_FRAME,
    MAX_ID,
)
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.files.csv_tables import CsvTable, read_csv_table
from track_range.foundation.files.input_files import first_line, quoted

REQUIRED = ("frame", "id", "class", "x1", "y1", "x2", "y2", "distance_m")
OPTIONAL = ("visible_share", "closing_mps")
DONT_CARE = "dontcare"  # class of regions that are not evaluated
_BOX = ("x1", "y1", "x2", "y2")
_MAX_SPEED_MPS = 1e3
_PLAUSIBLE = {  # smallest and largest value of each column, and the expected value for messages
    "frame": (0.0, MAX_FRAME, "an integer from 0"),
    "id": (0.0, MAX_ID, "an integer from 0"),
    **dict.fromkeys(_BOX, (-MAX_COORDINATE_PX, MAX_COORDINATE_PX, "a number of pixels")),
    "distance_m": (0.0, MAX_DISTANCE_M, "a positive number, or an empty cell if unknown"),
    "visible_share": (0.0, 1.0, "a number from 0 to 1, or an empty cell"),
    "closing_mps": (-_MAX_SPEED_MPS, _MAX_SPEED_MPS, "a speed in m/s, or an empty cell if unknown"),
}


@dataclass(frozen=True, slots=True)
class CsvLabels:
    """The N rows of a CSV label file, in the file's order."""

    frame: IntArray  # (N,) frame number from 0
    track_id: IntArray  # (N,) identity; -1 = a region that is not evaluated
    class_name: npt.NDArray[np.str_]  # (N,) class name in the file, in lower case
    class_id: IntArray  # (N,) road class; -1 = not a road class, or a region
    xyxy_px: FloatArray  # (N, 4) box in rectified pixels
    distance_m: FloatArray  # (N,) z in the left camera's frame; NaN = unknown
    visible_share: FloatArray  # (N,) visible fraction 0..1; 1 if unknown
    closing_mps: FloatArray  # (N,) closing speed; NaN = unknown


def is_label_csv(path: Path) -> bool:
    """Whether a file is CSV: its first line contains commas or `distance_m`, or it is an empty .csv
    file.
    """
    first = _first_line(path)
    return first is not None and (
        "," in first
        or "distance_m" in first.lower()
        or (not first and path.suffix.lower() == ".csv")
    )


def has_label_columns(path: Path) -> bool:
    """Whether the first line of a file has all required columns."""
    names = (_first_line(path) or "").strip().lower().split(",")
    return set(REQUIRED) <= {name.strip() for name in names}


def _first_line(path: Path) -> str | None:
    """The first line that is not blank; "" if there is none, None if the file cannot be read."""
    try:
        return first_line(path, LabelFileError, "labels")
    except LabelFileError:
        return None


def read_csv_labels(path: Path) -> CsvLabels:
    """The rows of a CSV label file.

    LabelFileError: the file cannot be read, is empty or lacks a required column; or a value is out
    of range, a box has x1 >= x2 or y1 >= y2, no class is known, or an id occurs twice in a frame.
    """
    expected = (
        f"a first line with the columns {','.join(REQUIRED)} (optional: {','.join(OPTIONAL)})"
    )
    table = read_csv_table(path, LabelFileError, expected, exact=True)
    if len(table.header) == 1 or not set(REQUIRED) & set(table.header):
        raise LabelFileError(f"{path}: expected {expected}, got a file without these columns.")
    table.require(REQUIRED)
    table.refuse_duplicates(OPTIONAL)
    names = [name.lower() for name in table.texts("class")]
    for row, name in enumerate(names):
        if not name:
            raise table.fault(
                row, f"expected a class, or {DONT_CARE} for a region, got {quoted(name)}."
            )
    class_id = map_to_road_classes(names)
    if len(names) and (class_id < 0).all() and set(names) != {DONT_CARE}:
        known = ", ".join(ROAD_CLASSES)
        raise table.fault(
            0,
            f"expected a row with one of the classes {known}; all rows have other classes, such as "
            f"{quoted(names[0])}.",
        )
    is_region = np.array([name == DONT_CARE for name in names], np.bool_)
    numbers = {name: _numbers(table, name, is_region) for name in _PLAUSIBLE}
    boxes = np.stack([numbers[name] for name in _BOX], axis=1)
    for row in np.flatnonzero(~are_valid_boxes(boxes)).tolist():
        raise table.fault(row, "expected a box with x1 < x2 and y1 < y2.")
    frame = numbers["frame"].astype(np.int64)
    track_id = np.where(is_region, -1, numbers["id"]).astype(np.int64)
    seen: set[tuple[int, int]] = set()
    for row, key in enumerate(zip(frame.tolist(), track_id.tolist(), strict=True)):
        if key in seen and key[1] >= 0:
            raise table.fault(
                row, f"expected each id once per frame, got id {key[1]} twice in frame {key[0]}."
            )
        seen.add(key)
    return CsvLabels(
        frame=frame,
        track_id=track_id,
        class_name=np.array(names, np.str_),
        class_id=class_id,
        xyxy_px=boxes,
        distance_m=np.where(is_region, np.nan, numbers["distance_m"]),
        visible_share=np.where(np.isnan(numbers["visible_share"]), 1.0, numbers["visible_share"]),
        closing_mps=np.where(is_region, np.nan, numbers["closing_mps"]),
    )


def _numbers(table: CsvTable, name: str, is_region: npt.NDArray[np.bool_]) -> FloatArray:
    """(N,) checked numbers of a column; NaN for empty cells where allowed, and for a missing
    column.
    """
    values = table.numbers(name)
    low, high, expected = _PLAUSIBLE[name]
    is_valid = (values >= low) & (values <= high)
    if name == "distance_m":
        is_valid &= values > 0
    if name in ("frame", "id"):
        is_valid &= np.rint(values) == values
    if name in ("distance_m", *OPTIONAL):
        is_valid |= np.array([cell.lower() in ("", "nan") for cell in table.texts(name)], np.bool_)
    if name not in ("frame", *_BOX):
        is_valid |= is_region
    table.check(name, is_valid, expected)
    return values
