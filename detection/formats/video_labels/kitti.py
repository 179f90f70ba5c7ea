"""Reader of KITTI's label and detection files.

Each row describes one object, in columns separated by spaces. A tracking file covers a sequence, an object file one
image:
    tracking: frame id TYPE truncated occluded alpha x1 y1 x2 y2 h w l X Y Z rotation_y [score]
    object:            TYPE truncated occluded alpha x1 y1 x2 y2 h w l X Y Z rotation_y [score]
x1 .. y2 are pixels from 0; h w l are the size and X Y Z the bottom centre of the 3-D box in metres, in the frame of the
rectified reference camera (camera 0). Detection files have -1 or -1000 for unknown values.
(Geiger et al., "Are we ready for autonomous driving?", CVPR 2012, and the development kit's readme.)
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.limits import MAX_COORDINATE_PX, MAX_FRAME, MAX_ID
from track_range.detection.formats.tables.table_checks import check_names, frame_in_name
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.files.input_files import MAX_TABLE_BYTES, quoted, read_text
from track_range.foundation.files.numeric_text import numbers

_TRACKING_COLUMNS, _OBJECT_COLUMNS = 17, 15  # without the score
_MAX_TYPE = 64  # characters
UNKNOWN_M = -999.0  # coordinates up to this value (-1000) are unknown
# not in types: white space, and the comma, which KITTI's files do not have
_SEPARATOR = re.compile(r"[\s,]")
_MAX_VALUE = 1e6  # largest absolute value in metres, radians, or of a score; -1000 = unknown
# smallest and largest value of each column without the type, and the expected value for messages
_LIMITS = (
    (0, MAX_FRAME, f"an integer from 0 to {MAX_FRAME} as the frame number"),
    (-MAX_ID, MAX_ID, "an integer as the track id"),
    (-_MAX_VALUE, _MAX_VALUE, f"finite numbers up to {_MAX_VALUE:,.0f}"),
    (-100, 100, "an integer as the occlusion"),
    (-_MAX_VALUE, _MAX_VALUE, f"finite numbers up to {_MAX_VALUE:,.0f}"),
    *[(-MAX_COORDINATE_PX, MAX_COORDINATE_PX, f"pixels up to {MAX_COORDINATE_PX:g} as the box")]
    * 4,
    *[(-_MAX_VALUE, _MAX_VALUE, f"finite numbers up to {_MAX_VALUE:,.0f}")] * 8,
)
_LOW, _HIGH = (np.array(limits, np.float64) for limits in list(zip(*_LIMITS, strict=True))[:2])
_INTEGERS = [0, 1, 3]  # columns: frame, track id, occlusion


@dataclass(frozen=True, slots=True)
class KittiLabels:
    """The N rows of a KITTI file, in the file's order."""

    frame: IntArray  # (N,) int64 frame number from 0
    track_id: IntArray  # (N,) int64 identity; -1 = DontCare or a detection
    kitti_type: npt.NDArray[np.str_]  # (N,) str type, such as Car, Van, DontCare
    # (N,) fraction outside the image, or level 0, 1, 2 in tracking files; -1 = unknown
    truncated: FloatArray
    # (N,) 0 = fully visible, 1 = partly occluded, 2 = largely occluded, 3 or -1 = unknown
    occluded: IntArray
    xyxy_px: FloatArray  # (N, 4) box
    size_hwl_m: FloatArray  # (N, 3) height, width, length; <= 0 if unknown
    location_m: FloatArray  # (N, 3) bottom centre in the reference camera's frame
    rotation_y_rad: FloatArray  # (N,) yaw about the camera's y axis
    score: FloatArray  # (N,) confidence; NaN if the file has none

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, index: BoolArray | IntArray) -> KittiLabels:
        """The rows that a mask (N,) or an array of indices selects."""
        return KittiLabels(*(getattr(self, field.name)[index] for field in fields(self)))

    @property
    def has_3d_box(self) -> BoolArray:
        """(N,) mask of the rows that have a 3-D box; 0, 0, 0 and -1, -1, -1 stand for no place."""
        is_known = (self.location_m > UNKNOWN_M).all(axis=1) & (self.size_hwl_m > 0).all(axis=1)
        return np.asarray(is_known & ~np.isin(self.location_m, (0.0, -1.0)).all(axis=1))


KITTI_TYPE_OF: Mapping[str, str] = {
    "person": "Pedestrian",
    "bicycle": "Cyclist",
    "car": "Car",
    "truck": "Truck",
}
"""KITTI's type of each road class that KITTI labels."""


def kitti_line(
    frame: int,
    track_id: int,
    kitti_type: str,
    xyxy_px: Sequence[float],
    location_m: Sequence[float],
    score: float,
) -> str:
    """Row of a tracking result, with its newline: no size (-1), truncation, occlusion (-1) and
    angles (-10).

    `frame` counts from 0; `location_m` is the bottom centre in the camera's frame. An unknown
    coordinate (NaN) is written as -1000; an unknown score (NaN) leaves the column out.
    """
    edges = " ".join(f"{edge:.2f}" for edge in xyxy_px)
    location = " ".join("-1000" if math.isnan(value) else f"{value:.3f}" for value in location_m)
    last = "" if math.isnan(score) else f" {score:.4f}"
    return f"{frame} {track_id} {kitti_type} -1 -1 -10 {edges} -1 -1 -1 {location} -10{last}\n"


def kitti_type_of(class_name: str) -> str:
    """KITTI's type of a class, or its name without spaces (Bus, Traffic_light), which KITTI's
    evaluation skips.
    """
    return (
        KITTI_TYPE_OF.get(class_name)
        or _SEPARATOR.sub("_", class_name).capitalize()[:_MAX_TYPE]
        or "Misc"
    )


def read_kitti(path: Path) -> KittiLabels:
    """The rows of a tracking file, or of a folder of object files (000000.txt, ...; the number is
    the frame).

    LabelFileError: the file or folder cannot be read, is empty, or has a row of the wrong length or
    an implausible number.
    """
    if os.path.isdir(path):  # unlike Path.is_dir, False for a name that is too long
        numbered = {file: frame_in_name(file.stem) for file in sorted(path.glob("*.txt"))}
        # files that are named after their number only, or after video, camera and number
        files = [file for file in numbered if file.stem.isdecimal()]
        files = files or [file for file, frame in numbered.items() if frame is not None]
        if not files:
            raise LabelFileError(f"{path}: expected label files such as 000000.txt, found none.")
        check_names((file.stem for file in files), path)
        return _labels([row for file in files for row in _rows(file, str(numbered[file]), "-1")])
    if not (rows := _rows(path)):
        raise LabelFileError(f"{path}: expected KITTI labels, got an empty file.")
    return _labels(rows)


def read_kitti_image(path: Path) -> KittiLabels:
    """The object labels of one image, with frame number 0; the file may be empty. Errors: see
    `read_kitti`.
    """
    return _labels(_rows(path, "0", "-1"))


class _Row(NamedTuple):
    """A row in the layout of tracking labels, and the number of columns in the file."""

    path: Path
    line: int
    cells: list[str]
    n_columns: int


def _rows(path: Path, *first: str) -> list[_Row]:
    """The non-blank lines of a file, preceded by the cells that object labels lack: frame and
    identity.
    """
    text = read_text(path, LabelFileError, "KITTI labels", max_bytes=MAX_TABLE_BYTES)
    cells_of = ((number, line.split()) for number, line in enumerate(text.split("\n"), 1))
    return [
        _Row(path, number, _completed(cells, first), len(cells))
        for number, cells in cells_of
        if cells
    ]


def _completed(cells: list[str], first: Sequence[str]) -> list[str]:
    """The cells behind the first; DeepStream's trackers write the identity after the type."""
    has_identity = first and len(cells) == _OBJECT_COLUMNS + 2 and cells[1].isdecimal()
    return [first[0], cells[1], cells[0], *cells[2:]] if has_identity else [*first, *cells]


def _labels(rows: list[_Row]) -> KittiLabels:
    """The columns of the rows; LabelFileError for a row of a wrong length, or an implausible
    number.
    """
    texts: list[str] = []
    for path, line, cells, n_columns in rows:
        if len(cells) not in (_TRACKING_COLUMNS, _TRACKING_COLUMNS + 1):
            raise LabelFileError(
                f"{path}, line {line}: expected {_TRACKING_COLUMNS} columns (18 with a score) of "
                f"KITTI tracking labels, or {_OBJECT_COLUMNS} (16) of object labels in a folder "
                f"with one file per image; got {n_columns}."
            )
        if len(cells[2]) > _MAX_TYPE:
            raise LabelFileError(
                f"{path}, line {line}: expected a type such as Car, got {quoted(cells[2])}."
            )
        score = ["nan"] if len(cells) == _TRACKING_COLUMNS else []
        texts += [*cells[:2], *cells[3:], *score]
    table = np.array(_numbers(texts), np.float64).reshape(-1, _TRACKING_COLUMNS)
    is_valid = (table >= _LOW) & (table <= _HIGH)
    is_valid[:, _INTEGERS] &= np.rint(table[:, _INTEGERS]) == table[:, _INTEGERS]
    is_valid[:, -1] |= np.array([len(row.cells) == _TRACKING_COLUMNS for row in rows], np.bool_)
    for index, column in np.argwhere(~is_valid)[:1].tolist():
        row, text = rows[index], texts[index * _TRACKING_COLUMNS + column]
        raise LabelFileError(
            f"{row.path}, line {row.line}: expected {_LIMITS[column][2]}, got {quoted(text)}."
        )
    return KittiLabels(
        frame=table[:, 0].astype(np.int64),
        track_id=table[:, 1].astype(np.int64),
        kitti_type=np.array([row.cells[2] for row in rows], np.str_),
        truncated=table[:, 2],
        occluded=table[:, 3].astype(np.int64),
        xyxy_px=table[:, 5:9],
        size_hwl_m=table[:, 9:12],
        location_m=table[:, 12:15],
        rotation_y_rad=table[:, 15],
        score=table[:, 16],
    )


def _numbers(texts: list[str]) -> list[float]:
    """`numbers` of the texts; checking all texts together takes a third of the time if all are
    valid.
    """
    joined = "".join(texts)
    if joined.isascii() and "_" not in joined:
        with suppress(ValueError):
            return list(map(float, texts))
    return numbers(texts)
