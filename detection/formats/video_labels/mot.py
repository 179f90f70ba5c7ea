"""MOTChallenge's text files: frame, id, x, y, w, h, score, then class and visibility, or a position in the world.

    in the files   first frame 1, centre of the first pixel 1, 1            x = x1 + 1     w = x2 - x1
    track-range    first frame 0, centre of the first pixel 0, 0 (OpenCV)   x1 = x - 1     x2 = x1 + w

Written files count from 1, whatever the input counted from. In both, a box is given by its outer edges. Boxes are
written with 2 decimals, so an edge that is read back is accurate to 0.01 px.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from track_range.detection.formats.limits import MAX_COORDINATE_PX, MAX_FRAME, MAX_ID
from track_range.foundation.arrays import FloatArray, IntArray, check_shape
from track_range.foundation.errors import UserError
from track_range.foundation.files.input_files import MAX_TABLE_BYTES, quoted, read_text, shortened
from track_range.foundation.files.numeric_text import numbers

_FIRST_PIXEL = 1  # `xyxy_from_mot` is the inverse
_FIRST_FRAME = 1
_MAX_CLASS = 100_000
_N_TRUTH_COLUMNS = 9  # MOT16 and later: column 8 is the class, 9 the visibility; with 10 columns, 8..10 are metres


class MotFormatError(UserError, ValueError):
    """A file that is not in MOTChallenge's format; the message names the file and, where known, the line."""


@dataclass(frozen=True, slots=True)
class MotRows:
    """The rows of one file, in its order; N = 0 for an empty file."""

    frame: IntArray  # (N,) int64, counted from 0
    track_id: IntArray  # (N,) int64; -1 in files of detections
    xyxy_px: FloatArray  # (N, 4) float64, pixels counted from 0
    score: FloatArray  # (N,) float64; in ground truth 1 = evaluated, 0 = not evaluated
    mot_class: IntArray  # (N,) int64, MOTChallenge's class number (1 = pedestrian), 0 where the file has none
    visibility: FloatArray  # (N,) float64 in [0, 1], NaN where the file has none

    def __post_init__(self) -> None:
        check_shape("xyxy_px", self.xyxy_px, (len(self), 4))
        for name in ("frame", "track_id", "score", "mot_class", "visibility"):
            check_shape(name, getattr(self, name), (len(self),))

    def __len__(self) -> int:
        return len(self.frame)


def mot_lines(frame: int, track_id: IntArray, xyxy_px: FloatArray, score: FloatArray) -> list[str]:
    """One line per track of a frame, with its newline: frame + 1,id,x,y,w,h,score,-1,-1,-1.

    `frame` counts from 0. Predicted boxes are written like observed ones: the format cannot distinguish them.
    """
    x1, y1, x2, y2 = xyxy_px.T
    rows = np.stack([x1 + _FIRST_PIXEL, y1 + _FIRST_PIXEL, x2 - x1, y2 - y1, score], axis=1)
    return [
        f"{frame + _FIRST_FRAME},{number},{x:.2f},{y:.2f},{w:.2f},{h:.2f},{s:.4f},-1,-1,-1\n"
        for number, (x, y, w, h, s) in zip(track_id.tolist(), rows.tolist(), strict=True)
    ]


def xyxy_from_mot(ltwh: FloatArray) -> FloatArray:
    """(N, 4) left, top, right, bottom in pixels from 0, of MOTChallenge boxes (left and top from 1, width, height)."""
    left_top = ltwh[:, :2] - 1.0
    return np.concatenate([left_top, left_top + ltwh[:, 2:]], axis=1)


def read_mot(path: Path) -> MotRows:
    """The rows of a gt.txt, det.txt or result file; blank lines are skipped.

    MotFormatError: no such file; or a line that is not 7 to 10 finite numbers with an integer frame >= 1, an integer
    id, a plausible box and w, h >= 0; or an id from 0 that occurs twice in a frame.
    """
    text = read_text(path, MotFormatError, "rows of MOTChallenge", max_bytes=MAX_TABLE_BYTES)
    numbered = [(i, line) for i, line in enumerate(text.split("\n"), start=1) if line.strip()]
    rows = [_row(line, f"{path}, line {i}") for i, line in numbered]
    table = np.array(rows, np.float64).reshape(-1, 9)
    seen: set[tuple[float, float]] = set()
    for (i, _), row in zip(numbered, rows, strict=True):
        if row[1] >= 0 and (row[0], row[1]) in seen:
            raise MotFormatError(
                f"{path}, line {i}: expected each id at most once per frame, found a duplicate of id {row[1]:.0f} in "
                f"frame {row[0]:.0f}."
            )
        seen.add((row[0], row[1]))
    return MotRows(
        frame=table[:, 0].astype(np.int64) - _FIRST_FRAME,
        track_id=table[:, 1].astype(np.int64),
        xyxy_px=xyxy_from_mot(table[:, 2:6]),
        score=table[:, 6],
        mot_class=table[:, 7].astype(np.int64),
        visibility=table[:, 8],
    )


def _row(line: str, where: str) -> list[float]:
    """frame, id, x, y, w, h, score, class, visibility of one line."""
    cells = [cell.strip() for cell in line.strip().rstrip(",").split(",")]
    if not 7 <= len(cells) <= 10:
        raise MotFormatError(f"{where}: expected 7 to 10 numbers between commas, found {len(cells)}.")
    row = numbers(cells)
    if not all(map(math.isfinite, row)):
        cell = next(cell for cell, value in zip(cells, row, strict=True) if not math.isfinite(value))
        raise MotFormatError(f"{where}: expected finite numbers, found {quoted(cell)}.")
    if not _FIRST_FRAME <= row[0] <= MAX_FRAME + _FIRST_FRAME or row[0] % 1 or row[1] % 1 or abs(row[1]) > MAX_ID:
        raise MotFormatError(
            f"{where}: expected an integer frame number from {_FIRST_FRAME} to {MAX_FRAME + _FIRST_FRAME} and an "
            f"integer id, found {quoted(cells[0])} and {quoted(cells[1])}; MOTChallenge's files count frames from 1."
        )
    if min(row[4:6]) < 0:
        raise MotFormatError(
            f"{where}: expected width and height >= 0, found {quoted(cells[4])} and {quoted(cells[5])}."
        )
    if max(map(abs, row[2:6])) > MAX_COORDINATE_PX:
        raise MotFormatError(
            f"{where}: expected a box of at most {MAX_COORDINATE_PX:g} pixels, found {shortened(','.join(cells[2:6]))}."
        )
    if len(row) != _N_TRUTH_COLUMNS:
        return [*row[:7], 0.0, np.nan]
    if row[7] % 1 or abs(row[7]) > _MAX_CLASS:
        raise MotFormatError(f"{where}: expected an integer as the class in column 8, found {quoted(cells[7])}.")
    return row
