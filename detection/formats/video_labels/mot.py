"""MOTChallenge's text files, and the reading of files in similar layouts (`number_layouts`).

    in MOTChallenge's files   first frame 1, centre of the first pixel 1, 1            x = x1 + 1     w = x2 - x1
    track-range               first frame 0, centre of the first pixel 0, 0 (OpenCV)   x1 = x - 1     x2 = x1 + w

Written files count from 1, whatever the input counted from; boxes have 2 decimals, so an edge that is read back is
accurate to 0.01 px.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from track_range.detection import classes
from track_range.detection.formats.tables.limits import MAX_COORDINATE_PX, MAX_FRAME, MAX_ID
from track_range.detection.formats.tables.table_checks import first_frame_number
from track_range.detection.formats.video_labels.number_layouts import NumberLayout, layout_of
from track_range.detection.formats.video_labels.number_rows import (
    NumberRows,
    are_whole,
    read_number_rows,
)
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, check_shape
from track_range.foundation.errors import UserError
from track_range.foundation.files.input_files import quoted, read_text, shortened
from track_range.foundation.files.numeric_text import number

_FIRST_PIXEL = _FIRST_FRAME = 1  # in written files
_MAX_CLASS = 100_000
# files with names beside rows, and the number of the first: in exports of CVAT and Datumaro, and of
# a user
_NAMES_FILES = {"labels.txt": 1, "classes.txt": 0}

MOT_CLASSES: Mapping[int, str] = dict(enumerate(classes.MOT_CLASSES))
MOT = NumberLayout("MOTChallenge rows", "fixywhsc.", (7, 8, 9, 10))


class MotFormatError(UserError, ValueError):
    """A file that is not in MOTChallenge's format; the message names the file and, where known, the
    line.
    """


@dataclass(frozen=True, slots=True)
class MotRows:
    """The rows of one file, in its order; N = 0 for an empty file."""

    frame: IntArray  # (N,) int64, counted from 0
    track_id: IntArray  # (N,) int64; -1 in files of detections
    xyxy_px: FloatArray  # (N, 4) float64, pixels counted from 0
    # (N,) float64; in ground truth 1 = evaluated, 0 = not evaluated; -1 = unknown
    score: FloatArray
    # (N,) int64, number of the class, MOTChallenge's (1 = pedestrian) unless `names` are others;
    # -1 = no class
    mot_class: IntArray
    names: Mapping[int, str] = field(default_factory=lambda: MOT_CLASSES)
    form: str = MOT.form  # "rrc" for rows of corners
    title: str = MOT.title
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_shape("xyxy_px", self.xyxy_px, (len(self), 4))
        for name in ("frame", "track_id", "score", "mot_class"):
            check_shape(name, getattr(self, name), (len(self),))

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def class_name(self) -> list[str]:
        """(N,) name of the class; "" where there is none."""
        names = {-1: "", **self.names}
        return [names.get(number, f"class {number}") for number in self.mot_class.tolist()]

    @property
    def is_region(self) -> BoolArray:
        """(N,) mask of the labels that are not evaluated."""
        is_named = np.array([name != "" for name in self.class_name], np.bool_)
        return np.asarray(is_named & (self.score == 0) & np.isin(self.score, (0, 1)).all())


def mot_rows(
    rows: NumberRows,
    *,
    n_frames: int | None = None,
    form: str | None = None,
    names: tuple[str, ...] = (),
) -> MotRows:
    """Frames, boxes and classes of the rows; raises the error of `rows` for invalid frame numbers,
    ids or classes.

    Boxes and scores are not checked. `n_frames`: number of images of the video; `form`: "mot" or
    "rrc"; None = any; `names`: those of the class numbers, if the user gives them.
    """
    layout = layout_of(rows, form, names)
    if layout is None:
        rows.check(
            (rows.n_columns >= min(MOT.n_columns)) & (rows.n_columns <= max(MOT.n_columns)),
            lambda cells: f"expected 7 to 10 numbers of MOTChallenge, got {len(cells)}",
        )
        layout = MOT
    frame, track_id, class_number = _checked_integers(rows, layout)
    notes = []
    first = first_frame_number(frame, layout.first, n_frames)
    if first != layout.first:
        notes.append(
            f"{rows.path.name}: frame numbers start at {first} and are read as they are; this "
            f"format usually starts at {layout.first}."
        )
    score = layout.column(rows, "s", -1)
    in_file = None if names else _names_in_file(rows)
    score = layout.scores(score) if in_file is None else score
    stated = ("--names", dict(enumerate(names))) if names else in_file
    if stated is not None and (class_number >= 0).any():
        notes.append(f"{rows.path.name}: class names are read from {stated[0]}.")
        names_of = stated[1]
    else:
        names_of = layout.names or MOT_CLASSES
        if layout.is_guessed:
            notes.append(
                f"{rows.path.name}: nothing names its class numbers, so it is read as "
                f"{layout.title}; --names gives others: {', '.join(classes.CLASS_LISTS)}, a,b,c or "
                "a file."
            )
    return MotRows(
        frame - first,
        track_id,
        _boxes(rows, layout),
        score,
        class_number,
        names=names_of,
        form=layout.form,
        title=layout.title,
        notes=tuple(notes),
    )


def _checked_integers(
    rows: NumberRows, layout: NumberLayout
) -> tuple[IntArray, IntArray, IntArray]:
    """(N,) frame numbers, identities and class numbers of the rows of one camera."""
    frame, track_id = layout.column(rows, "f", 0), layout.column(rows, "i", -1)
    has_class = rows.n_columns == len(layout.columns)
    class_number = np.where(has_class, np.maximum(layout.column(rows, "c", -1), -1), -1)
    rows.check(
        are_whole(frame, 0, MAX_FRAME + 1) & are_whole(track_id, -MAX_ID, MAX_ID),
        lambda cells: (
            f"expected integers from 0 to {MAX_FRAME + 1} as frame numbers and an integer id, found "
            f"{shortened(','.join(cells[:3]))}"
        ),
    )
    rows.check(
        are_whole(class_number, -1, _MAX_CLASS),
        lambda cells: f"expected an integer as the class, found {shortened(','.join(cells))}",
    )
    if len(np.unique(layout.column(rows, "k", 0))) > 1:
        raise rows.error(
            f"{rows.path}: expected the rows of one camera of AI City, found several cameras; "
            "split the file."
        )
    return frame.astype(np.int64), track_id.astype(np.int64), class_number.astype(np.int64)


def _boxes(rows: NumberRows, layout: NumberLayout) -> FloatArray:
    """(N, 4) boxes in pixels counted from 0."""
    left, top = (layout.column(rows, letter, 0) - layout.first for letter in "xy")
    if "w" in layout.columns:
        right, bottom = left + layout.column(rows, "w", 0), top + layout.column(rows, "h", 0)
    else:
        right, bottom = (layout.column(rows, letter, 0) - layout.first for letter in "rb")
    return np.stack([left, top, right, bottom], axis=1)


def _names_in_file(rows: NumberRows) -> tuple[str, Mapping[int, str]] | None:
    """The file beside the rows with the names of the class numbers, and the names; None if there is
    no such file.
    """
    for name, first in _NAMES_FILES.items():
        if (file := rows.path.with_name(name)).is_file():
            text = read_text(file, rows.error, "the names of the classes, one per line")
            return name, dict(enumerate((line.strip() for line in text.splitlines()), start=first))
    return None


def mot_lines(frame: int, track_id: IntArray, xyxy_px: FloatArray, score: FloatArray) -> list[str]:
    """One line per track of a frame, with its newline: frame + 1,id,x,y,w,h,score,-1,-1,-1.

    `frame` counts from 0. Predicted boxes are written like observed ones: the format cannot
    distinguish them.
    """
    x1, y1, x2, y2 = xyxy_px.T
    rows = np.stack([x1 + _FIRST_PIXEL, y1 + _FIRST_PIXEL, x2 - x1, y2 - y1, score], axis=1)
    return [
        f"{frame + _FIRST_FRAME},{number},{x:.2f},{y:.2f},{w:.2f},{h:.2f},{s:.4f},-1,-1,-1\n"
        for number, (x, y, w, h, s) in zip(track_id.tolist(), rows.tolist(), strict=True)
    ]


def read_mot(path: Path, n_frames: int | None = None, *, names: tuple[str, ...] = ()) -> MotRows:
    """The rows of a gt.txt, det.txt or result file; blank lines are skipped. `n_frames`: number of
    images of the video; `names`: those of the class numbers, if the user gives them.

    MotFormatError: no such file; or a line that is not 7 to 10 finite numbers with an integer
    frame, an integer id, a plausible box and w, h >= 0; or an id from 0 that occurs twice in a
    frame.
    """
    table = read_number_rows(path, MotFormatError, "rows of MOTChallenge")
    table.check(
        (np.isfinite(table.values) | ~table.has_number).all(axis=1),
        lambda cells: (
            "expected finite numbers, found "
            + quoted(next(cell for cell in cells if not math.isfinite(number(cell))))
        ),
    )
    rows = mot_rows(table, n_frames=n_frames, names=names)
    size_px = rows.xyxy_px[:, 2:] - rows.xyxy_px[:, :2]
    table.check(
        (size_px >= 0).all(axis=1),
        lambda cells: f"expected width and height >= 0, found {shortened(','.join(cells))}",
    )
    table.check(
        (np.abs(np.concatenate([rows.xyxy_px, size_px], axis=1)) <= MAX_COORDINATE_PX + 1).all(
            axis=1
        ),
        lambda cells: (
            f"expected a box of at most {MAX_COORDINATE_PX:g} pixels, found {shortened(','.join(cells))}"
        ),
    )
    pairs = np.stack([rows.frame, rows.track_id], axis=1)
    _, first = np.unique(pairs, axis=0, return_index=True)
    is_unique = np.isin(np.arange(len(rows)), first) | (rows.track_id < 0)
    for row in np.flatnonzero(~is_unique)[:1].tolist():
        raise MotFormatError(
            f"{path}, line {table.lines[row]}: expected each id at most once per frame, found a duplicate of id "
            f"{rows.track_id[row]} in frame {table.cells[row][0]}."
        )
    return rows
