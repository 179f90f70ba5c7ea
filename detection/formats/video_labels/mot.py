"""Text files with rows of numbers: MOTChallenge's, and similar layouts.

    in MOTChallenge's files   first frame 1, centre of the first pixel 1, 1            x = x1 + 1     w = x2 - x1
    track-range               first frame 0, centre of the first pixel 0, 0 (OpenCV)   x1 = x - 1     x2 = x1 + w

`_LAYOUTS` has all layouts; `_layout_of` chooses one by the numbers of the whole file. Columns are
separated by commas, semicolons, spaces or tabs; `#` starts a comment. Written files count from 1,
whatever the input counted from; boxes have 2 decimals, so an edge that is read back is accurate to
0.01 px.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from track_range.detection.boxes import are_valid_boxes
from track_range.detection.classes import COCO_CLASSES
from track_range.detection.formats.tables.limits import MAX_COORDINATE_PX, MAX_FRAME, MAX_ID
from track_range.detection.formats.tables.table_checks import first_frame_number
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, check_shape
from track_range.foundation.errors import UserError
from track_range.foundation.files.input_files import MAX_TABLE_BYTES, quoted, read_text, shortened
from track_range.foundation.files.numeric_text import are_integers, number, numbers

_FIRST_PIXEL = _FIRST_FRAME = 1  # in written files
_MAX_CLASS = 100_000
_MAX_COLUMNS = 15
_MOST_CAMERAS = 1_000  # of a file of AI City; more numbers in the first column are frames
_MIN_VALID = 0.95  # smallest fraction of valid boxes of a layout of 6 columns

# fmt: off
MOT_CLASSES: Mapping[int, str] = {
    0: "", 1: "pedestrian", 2: "person on vehicle", 3: "car", 4: "bicycle", 5: "motorbike", 6: "non motorized vehicle",
    7: "static person", 8: "distractor", 9: "occluder", 10: "occluder on the ground", 11: "occluder full",
    12: "reflection", 13: "crowd",
}
"""Names of MOT16's and MOT20's class numbers (Milan et al., "MOT16", 2016, table 3); 0 = the file
has no classes."""

VISDRONE_CLASSES = dict(enumerate((
    "ignored region", "pedestrian", "people", "bicycle", "car", "van", "truck", "tricycle", "awning-tricycle", "bus",
    "motor", "others",
)))  # Zhu et al., "Detection and tracking meet drones challenge", PAMI 2021, and the readme of its toolkit
# fmt: on


class _Layout(NamedTuple):
    """Meaning of the columns: f frame, i identity, x y left and top, w h size, r b right and
    bottom, s score, c class.

    v is the visibility; columns with a dot are not used. `first` is the number of the first frame,
    and of the centre of the first pixel.
    """

    title: str
    columns: str
    first: int = 1
    names: Mapping[int, str] = MOT_CLASSES


_LAYOUTS = {
    "mot": _Layout("MOTChallenge rows", "fixywhscv."),  # the class only in rows of 9 columns
    "mot without scores": _Layout("MOTChallenge rows without scores", "fixywh"),
    "corners": _Layout("rows frame,x1,y1,x2,y2,score", "fxyrbs", 0),
    "visdrone": _Layout("VisDrone rows", "fixywhsc..", names=VISDRONE_CLASSES),
    "boxmot": _Layout(
        "BoxMOT rows with COCO's classes", "fixywhsc.", names=dict(enumerate(COCO_CLASSES))
    ),
    "aicity": _Layout("AI City rows camera id frame x y w h", ".ifxywh"),
    "ab3dmot": _Layout("AB3DMOT rows", "fcxyrbs", 0, {1: "pedestrian", 2: "car", 3: "cyclist"}),
}


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
    # (N,) int64, number of the class, MOTChallenge's (1 = pedestrian) unless `names` are others
    mot_class: IntArray
    visibility: FloatArray  # (N,) float64 in [0, 1], NaN where the file has none
    names: Mapping[int, str] = field(default_factory=lambda: MOT_CLASSES)
    form: str = "mot"  # "rrc" for rows of corners
    title: str = "MOTChallenge rows"
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_shape("xyxy_px", self.xyxy_px, (len(self), 4))
        for name in ("frame", "track_id", "score", "mot_class", "visibility"):
            check_shape(name, getattr(self, name), (len(self),))

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def class_name(self) -> list[str]:
        """(N,) name of the class; "" where there is none."""
        return [self.names.get(number, f"class {number}") for number in self.mot_class.tolist()]

    @property
    def is_region(self) -> BoolArray:
        """(N,) mask of the labels that are not evaluated."""
        is_named = np.array([name != "" for name in self.class_name], np.bool_)
        return np.asarray(is_named & (self.score == 0) & np.isin(self.score, (0, 1)).all())


class NumberRows(NamedTuple):
    """The N rows of a file of numbers."""

    path: Path
    error: type[Exception]
    values: FloatArray  # (N, 15), NaN where there is no number
    n_columns: IntArray  # (N,)
    cells: list[list[str]]
    lines: list[int]

    def check(self, is_valid: npt.ArrayLike, message: Callable[[list[str]], str]) -> None:
        """Raise `error` for the first row that is not valid, with a message about its cells."""
        for row in np.flatnonzero(np.logical_not(is_valid))[:1].tolist():
            raise self.error(f"{self.path}, line {self.lines[row]}: {message(self.cells[row])}.")


def _cells(line: str) -> list[str]:
    separator = next((mark for mark in ";," if mark in line), None)
    return [cell.strip() for cell in line.strip().rstrip(",;").split(separator)]


def is_number_row(line: str) -> bool:
    """Whether a line is a row of numbers in one of the layouts or a comment; False for KITTI's rows
    with a type.
    """
    cells = _cells(line.partition("#")[0])
    is_number = not any(map(math.isnan, numbers(cells)))
    return line.startswith("#") or (
        is_number and ("," in line or ";" in line or 6 <= len(cells) <= 10)
    )


def read_number_rows(path: Path, error: type[Exception], expected: str) -> NumberRows:
    """The rows of a file; raises `error` if it cannot be read, has more than 15 columns, or a cell
    is not a number.
    """
    text = read_text(path, error, expected, max_bytes=MAX_TABLE_BYTES)
    lines = ((i, line.partition("#")[0]) for i, line in enumerate(text.split("\n"), start=1))
    numbered = [(i, _cells(line)) for i, line in lines if line.strip()]
    n_columns = np.array([len(cells) for _, cells in numbered], np.int64)
    values = np.full((len(numbered), _MAX_COLUMNS), np.nan)
    rows = NumberRows(
        path, error, values, n_columns, [cells for _, cells in numbered], [i for i, _ in numbered]
    )
    rows.check(
        n_columns <= _MAX_COLUMNS, lambda cells: f"expected 6 to 10 numbers, got {len(cells)}"
    )
    is_cell = np.arange(_MAX_COLUMNS) < n_columns[:, None]
    values[is_cell] = numbers(cell for cells in rows.cells for cell in cells)
    for row, column in np.argwhere(np.isnan(values) & is_cell).tolist():
        if rows.cells[row][column].lower() != "nan":
            cell = quoted(rows.cells[row][column])
            raise error(
                f"{path}, line {rows.lines[row]}: expected only numbers between commas or spaces, got {cell}."
            )
    return rows


def _layout_of(rows: NumberRows, form: str | None) -> str:
    """Name of the layout that fits the numbers of all rows; `form`: the user's choice for 6
    columns, or None.
    """
    values, counts = rows.values, np.unique(rows.n_columns)
    n_columns = int(counts[0]) if len(counts) == 1 else 0
    if n_columns == _MAX_COLUMNS:
        return "ab3dmot"
    if n_columns == 6:
        return _layout_of_six(rows, form)
    if n_columns in (7, 9) and _is_ai_city(values):
        return "aicity"
    group, flags = values[:, 7], values[:, 8:10]
    if n_columns == 10 and are_integers(group, 0, 11) and group.any():
        return "visdrone" if are_integers(flags, -1, 2) else "mot"
    return (
        "boxmot"
        if n_columns == 9 and are_integers(group, 0, 79) and (flags[:, 0] == -1).all()
        else "mot"
    )


def _layout_of_six(rows: NumberRows, form: str | None) -> str:
    """frame,x1,y1,x2,y2,score or frame,id,x,y,w,h, whichever makes almost all rows valid boxes."""
    values = rows.values
    are_corners = float(np.mean(are_valid_boxes(values[:, 1:5]))) >= _MIN_VALID
    is_size = (
        (values[:, 4] > 1) & (values[:, 5] > 1) & _are_whole(values[:, 1], -1, MAX_ID)
    )  # scores above 1 are per cent or margins
    are_sizes = float(np.mean(is_size)) >= _MIN_VALID
    if are_corners == are_sizes and form is not None:
        are_corners = form == "rrc"
    elif are_corners == are_sizes:
        problem = "both" if are_corners else "neither"
        raise rows.error(
            f"{rows.path}: expected 6 columns frame,x1,y1,x2,y2,score or frame,id,x,y,w,h, found rows that are valid "
            f"boxes in {problem}; add the score as a seventh column to rows with an id, or write scores as fractions."
        )
    return "corners" if are_corners else "mot without scores"


def _is_ai_city(values: FloatArray) -> bool:
    """Whether the first three columns identify each row as camera, identity and frame, unlike MOT's
    columns.
    """
    keys = values[:, :3]
    if not are_integers(keys, 0, MAX_ID) or not (values[:, 5:7] > 1).all():
        return False
    is_repeated = len(np.unique(keys[:, :2], axis=0)) < len(keys)
    return (
        is_repeated
        and len(np.unique(keys, axis=0)) == len(keys)
        and len(np.unique(keys[:, 0])) <= _MOST_CAMERAS
    )


def _are_whole(values: FloatArray, low: float, high: float) -> BoolArray:
    return np.asarray((values >= low) & (values <= high) & (np.rint(values) == values))


def mot_rows(rows: NumberRows, *, n_frames: int | None = None, form: str | None = None) -> MotRows:
    """Frames, boxes and classes of the rows; raises the error of `rows` for invalid frame numbers,
    ids or classes.

    Boxes and scores are not checked. `n_frames`: number of images of the video; `form`: "mot" or
    "rrc"; None = any.
    """
    path, n = rows.path, len(rows.lines)
    name = _layout_of(rows, form) if n else "mot"
    layout = _LAYOUTS[name]
    rows.check(
        ((rows.n_columns >= 7) & (rows.n_columns <= 10)) | (name != "mot"),
        lambda cells: f"expected 7 to 10 numbers of MOTChallenge, got {len(cells)}",
    )

    def column(letter: str, missing: float) -> FloatArray:
        index = layout.columns.find(letter)
        return rows.values[:, index] if index >= 0 else np.full(n, missing)

    frame, track_id, class_number = column("f", 0), column("i", -1), column("c", 0)
    if name == "mot":
        class_number = np.where(rows.n_columns == 9, class_number, 0)
    rows.check(
        _are_whole(frame, 0, MAX_FRAME + 1) & _are_whole(track_id, -MAX_ID, MAX_ID),
        lambda cells: (
            f"expected integers from 0 to {MAX_FRAME + 1} as frame numbers and an integer id, found "
            f"{shortened(','.join(cells[:3]))}"
        ),
    )
    rows.check(
        _are_whole(class_number, -_MAX_CLASS, _MAX_CLASS),
        lambda cells: f"expected an integer as the class, found {shortened(','.join(cells))}",
    )
    if name == "aicity" and len(np.unique(rows.values[:, 0])) > 1:
        raise rows.error(
            f"{path}: expected the rows of one camera of AI City, found several cameras; split the file."
        )
    first = first_frame_number(frame, layout.first, n_frames)
    notes = []
    if first != layout.first:
        notes.append(
            f"{path.name}: frame numbers start at {first} and are read as they are; this format usually "
            f"starts at {layout.first}."
        )
    names, labels = layout.names, path.with_name("labels.txt")
    # as in exports of CVAT and Datumaro
    if name in ("mot", "boxmot") and class_number.any() and labels.is_file():
        text = read_text(labels, rows.error, "the names of the classes, one per line")
        names = dict(enumerate((line.strip() for line in text.splitlines()), start=1))
        name = "labels.txt"
        notes.append(f"{path.name}: class names are read from labels.txt.")
    x, y, score = column("x", 0) - layout.first, column("y", 0) - layout.first, column("s", -1)
    ends = (
        [x + column("w", 0), y + column("h", 0)]
        if "w" in layout.columns
        else [column("r", 0), column("b", 0)]
    )
    if name == "boxmot" and np.isin(score, (0, 1)).all():  # written without decimals
        score = np.full(n, -1.0)
    return MotRows(
        frame=frame.astype(np.int64) - first,
        track_id=track_id.astype(np.int64),
        xyxy_px=np.stack([x, y, *ends], axis=1),
        score=score,
        mot_class=class_number.astype(np.int64),
        visibility=np.where(rows.n_columns == 9, column("v", np.nan), np.nan),
        names=names,
        form="rrc" if name == "corners" else "mot",
        title=layout.title,
        notes=tuple(notes),
    )


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


def read_mot(path: Path, n_frames: int | None = None) -> MotRows:
    """The rows of a gt.txt, det.txt or result file; blank lines are skipped. `n_frames`: number of
    images of the video.

    MotFormatError: no such file; or a line that is not 7 to 10 finite numbers with an integer
    frame, an integer id, a plausible box and w, h >= 0; or an id from 0 that occurs twice in a
    frame.
    """
    table = read_number_rows(path, MotFormatError, "rows of MOTChallenge")
    is_cell = np.arange(_MAX_COLUMNS) < table.n_columns[:, None]
    table.check(
        (np.isfinite(table.values) | ~is_cell).all(axis=1),
        lambda cells: (
            "expected finite numbers, found "
            + quoted(next(cell for cell in cells if not math.isfinite(number(cell))))
        ),
    )
    rows = mot_rows(table, n_frames=n_frames)
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
