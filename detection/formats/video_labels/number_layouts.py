"""The layouts of rows of numbers that look like MOTChallenge's: a row of `LAYOUTS` for each.

The numbers of the whole file show which layout it has; a file in none of them has MOTChallenge's
own (`mot`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from track_range.detection.boxes import are_valid_boxes
from track_range.detection.classes import COCO_CLASSES
from track_range.detection.formats.tables.limits import MAX_ID
from track_range.detection.formats.video_labels.number_rows import NumberRows, are_whole
from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.numeric_text import are_integers

_MOST_CAMERAS = 1_000  # of a file of AI City; more numbers in the first column are frames
_MIN_VALID = 0.95  # smallest fraction of valid boxes of a layout of 6 columns
_N_SHORT = 6  # columns that fit two layouts, neither of which is more usual

VISDRONE_CLASSES = (
    *("ignored region", "pedestrian", "people", "bicycle", "car", "van", "truck", "tricycle"),
    *("awning-tricycle", "bus", "motor", "others"),
)  # Zhu et al., "Detection and tracking meet drones challenge", PAMI 2021, and its toolkit's readme
_AB3DMOT_CLASSES = {1: "pedestrian", 2: "car", 3: "cyclist"}


def _always(values: FloatArray) -> bool:
    return True


def _as_written(score: FloatArray) -> FloatArray:
    return score


@dataclass(frozen=True, slots=True)
class NumberLayout:
    """Meaning of the columns of rows of numbers.

    Each column has a letter: f frame, i identity, x y left and top, w h size, r b right and bottom,
    s score, c class, k camera; a dot is a column that is not used. The class is only in rows with
    all columns. `fits` tells from the numbers (N, 15) of all rows, which have one of `n_columns`,
    whether they may have this layout.
    """

    title: str  # for messages
    columns: str
    n_columns: tuple[int, ...]
    fits: Callable[[FloatArray], bool] = _always
    first: int = 1  # number of the first frame, and of the centre of the first pixel
    names: Mapping[int, str] | None = None  # by class number; None = MOTChallenge's
    has_names_file: bool = False  # whether labels.txt beside the file may have other names
    # (N,) scores, -1 = unknown, of those that are written with the names of the layout
    scores: Callable[[FloatArray], FloatArray] = _as_written
    form: str = "mot"  # of `DetectionFormat`

    def column(self, rows: NumberRows, letter: str, missing: float) -> FloatArray:
        """(N,) numbers of a column; `missing` if the layout has no such column."""
        index = self.columns.find(letter)
        return rows.values[:, index] if index >= 0 else np.full(len(rows.lines), missing)


def _have_corners(values: FloatArray) -> bool:
    return float(np.mean(are_valid_boxes(values[:, 1:5]))) >= _MIN_VALID


def _have_sizes(values: FloatArray) -> bool:
    # scores above 1 are per cent or margins
    is_size = (values[:, 4] > 1) & (values[:, 5] > 1) & are_whole(values[:, 1], -1, MAX_ID)
    return float(np.mean(is_size)) >= _MIN_VALID


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


def _is_boxmot(values: FloatArray) -> bool:
    return are_integers(values[:, 7], 0, 79) and bool((values[:, 8] == -1).all())


def _is_visdrone(values: FloatArray) -> bool:
    """Whether the last columns are a class, of which MOT's files of ten columns have none, and two
    flags.
    """
    classes, flags = values[:, 7], values[:, 8:10]
    return are_integers(classes, 0, 11) and bool(classes.any()) and are_integers(flags, -1, 2)


def _without_rounded(score: FloatArray) -> FloatArray:
    """Scores that are written without decimals, so that each is 0 or 1, are unknown."""
    return np.full(len(score), -1.0) if np.isin(score, (0, 1)).all() else score


CORNERS = NumberLayout(
    "rows frame,x1,y1,x2,y2,score", "fxyrbs", (_N_SHORT,), _have_corners, first=0, form="rrc"
)
SIZES = NumberLayout("MOTChallenge rows without scores", "fixywh", (_N_SHORT,), _have_sizes)
LAYOUTS = (
    CORNERS,
    SIZES,
    NumberLayout("AI City rows camera id frame x y w h", "kifxywh", (7, 9), _is_ai_city),
    NumberLayout(
        "BoxMOT rows with COCO's classes",
        "fixywhsc.",
        (9,),
        _is_boxmot,
        names=dict(enumerate(COCO_CLASSES)),
        has_names_file=True,
        scores=_without_rounded,
    ),
    NumberLayout(
        "VisDrone rows",
        "fixywhsc..",
        (10,),
        _is_visdrone,
        names=dict(enumerate(VISDRONE_CLASSES)),
    ),
    NumberLayout(
        "AB3DMOT rows",
        "fcxyrbs........",
        (15,),
        first=0,
        names=_AB3DMOT_CLASSES,
    ),
)
"""The layouts that are not MOTChallenge's, in the order in which they are tried."""


def layout_of(rows: NumberRows, form: str | None) -> NumberLayout | None:
    """The layout that fits the numbers of all rows; None = MOTChallenge's.

    `form` is the user's choice for 6 columns, or None. Raises the error of `rows` if 6 columns fit
    both layouts or neither, and there is no choice.
    """
    counts = np.unique(rows.n_columns).tolist()
    if len(counts) != 1:
        return None
    (n_columns,) = counts
    fitting = [
        layout for layout in LAYOUTS if n_columns in layout.n_columns and layout.fits(rows.values)
    ]
    if n_columns != _N_SHORT or len(fitting) == 1:
        return fitting[0] if fitting else None
    if form is None:
        raise rows.error(
            f"{rows.path}: expected 6 columns frame,x1,y1,x2,y2,score or frame,id,x,y,w,h, found "
            f"rows that are valid boxes in {'both' if fitting else 'neither'}; add the score as a "
            "seventh column to rows with an id, or write scores as fractions."
        )
    return CORNERS if form == CORNERS.form else SIZES
