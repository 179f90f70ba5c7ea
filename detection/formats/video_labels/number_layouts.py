"""The layouts of rows of numbers that look like MOTChallenge's: a row of `LAYOUTS` for each.

The numbers of the whole file show which layout it has; a file in none of them has MOTChallenge's
own (`mot`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from track_range.detection.boxes import are_valid_boxes
from track_range.detection.classes import COCO_CLASSES, MOT_CLASSES, VISDRONE_CLASSES
from track_range.detection.formats.tables.limits import MAX_ID
from track_range.detection.formats.video_labels.number_rows import NumberRows, are_whole
from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.numeric_text import are_integers

_MOST_CAMERAS = 1_000  # of a file of AI City; more numbers in the first column are frames
_MIN_VALID = 0.95  # smallest fraction of valid boxes of a layout of 6 columns
_N_SHORT = 6  # columns that fit two layouts, neither of which is more usual

_LAST_COCO = len(COCO_CLASSES) - 1
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
    # (N,) scores, -1 = unknown, of those that are written without a file of names
    scores: Callable[[FloatArray], FloatArray] = _as_written
    form: str = "mot"  # of `DetectionFormat`
    is_guessed: bool = False  # whether nothing in a file shows that its classes have these names

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


def _has_classes_last(values: FloatArray) -> bool:
    """Whether the class is followed by nothing, or by columns that are not used, or is none of
    MOTChallenge's.
    """
    classes, others = values[:, 7], values[:, 8:10]
    is_unused = bool((np.isnan(others) | (others == -1)).all())
    return are_integers(classes, 0, _LAST_COCO) and (is_unused or classes.max() >= len(MOT_CLASSES))


def _has_classes_first(values: FloatArray) -> bool:
    """Whether the last of 8 columns are fractions, as scores after the class are."""
    last = values[:, 7]
    is_fraction = (last > 0) & (last < 1)
    return are_integers(values[:, 6], 0, _LAST_COCO) and bool(is_fraction.all())


def _has_scores_last(values: FloatArray) -> bool:
    """Whether the last of 9 columns are scores, as in BoxMOT's evaluation: those of detectors
    differ and are neither 0 nor 1, as the visible fractions of MOTChallenge are for most objects.
    """
    last = values[:, 8]
    is_score = (last > 0) & (last < 1)
    has_classes = are_integers(values[:, 7], 0, _LAST_COCO) and bool((values[:, 6] == 1).all())
    return has_classes and bool(is_score.all()) and len(np.unique(last)) > 1


def _has_indices_last(values: FloatArray) -> bool:
    """Whether fractions, a class from 1, and the number of a detection end the 9 columns, as in
    rows of BoxMOT since version 13: visible fractions are at most 1.
    """
    score, classes, last = values[:, 6], values[:, 7], values[:, 8]
    return (
        are_integers(classes, 1, len(COCO_CLASSES))
        and are_integers(last, -1, MAX_ID)
        and bool(last.max() > 1)
        and not np.isin(score, (0, 1)).all()
    )


def _has_classes_for_scores(values: FloatArray) -> bool:
    """Whether the last of 7 columns are classes, one of person to motorcycle among them: whole
    scores are per cent, which are not so low.
    """
    last = values[:, 6]
    return are_integers(last, 0, _LAST_COCO) and last.min() <= 3 and last.max() > 1


def _is_visdrone(values: FloatArray) -> bool:
    """Whether the last columns are a class, of which MOT's files of ten columns have none, and two
    flags.
    """
    classes, flags = values[:, 7], values[:, 8:10]
    return are_integers(classes, 0, 11) and bool(classes.any()) and are_integers(flags, -1, 2)


def _is_visdrone_result(values: FloatArray) -> bool:
    """Whether the flags are unused, and the class not that of ignored regions."""
    return _is_visdrone(values) and bool((values[:, 7] > 0).all() & (values[:, 8:10] == -1).all())


def _without_rounded(score: FloatArray) -> FloatArray:
    """Scores that are written without decimals, so that each is 0 or 1, are unknown."""
    return np.full(len(score), -1.0) if np.isin(score, (0, 1)).all() else score


def _coco_rows(columns: str, fits: Callable[[FloatArray], bool]) -> NumberLayout:
    """Rows of a tracker such as BoxMOT with a class, whose list they do not state."""
    return NumberLayout(
        "rows of a tracker with COCO's classes from 0 person, 2 car",
        columns,
        (len(columns),),
        fits,
        names=dict(enumerate(COCO_CLASSES)),
        scores=_without_rounded,
        is_guessed=True,
    )


_VISDRONE = NumberLayout(
    "VisDrone rows",
    "fixywhsc..",
    (10,),
    _is_visdrone,
    names=dict(enumerate(VISDRONE_CLASSES)),
)
CORNERS = NumberLayout(
    "rows frame,x1,y1,x2,y2,score", "fxyrbs", (_N_SHORT,), _have_corners, first=0, form="rrc"
)
SIZES = NumberLayout("MOTChallenge rows without scores", "fixywh", (_N_SHORT,), _have_sizes)
LAYOUTS = (
    CORNERS,
    SIZES,
    NumberLayout("AI City rows camera id frame x y w h", "kifxywh", (7, 9), _is_ai_city),
    _coco_rows("fixywhc", _has_classes_for_scores),
    _coco_rows("fixywh.cs", _has_scores_last),
    replace(
        _coco_rows("fixywhsc.", _has_indices_last),
        title="rows of BoxMOT with COCO's classes from 1 person, 3 car",
        names=dict(enumerate(COCO_CLASSES, start=1)),
    ),
    _coco_rows("fixywhsc.", _has_classes_last),
    _coco_rows("fixywhsc", _has_classes_last),
    _coco_rows("fixywhcs", _has_classes_first),
    replace(_VISDRONE, fits=_is_visdrone_result, is_guessed=True),
    _coco_rows("fixywhsc..", _has_classes_last),
    _VISDRONE,
    NumberLayout(
        "AB3DMOT rows",
        "fcxyrbs........",
        (15,),
        first=0,
        names=_AB3DMOT_CLASSES,
    ),
)
"""The layouts that are not MOTChallenge's, in the order in which they are tried."""


def _no_pixels_in(values: FloatArray) -> str:
    """What rows are that have no boxes in pixels behind frame and identity; "" if they may have."""
    if (np.abs(values[:, 2:6]) < 1).all():
        return "only fractions of the image size"
    # left, top, width, height, score, class, truncation, occlusion
    is_image = np.isnan(values[:, 8]).all() and all(
        are_integers(values[:, column], 0, highest)
        for column, highest in ((4, 1), (5, 11), (6, 1), (7, 2))
    )
    return "VisDrone's labels of one image" if is_image else ""


def layout_of(
    rows: NumberRows, form: str | None, names: tuple[str, ...] = ()
) -> NumberLayout | None:
    """The layout that fits the numbers of all rows; None = MOTChallenge's.

    `form` is the user's choice for 6 columns, or None, and `names` that of the classes. Raises the
    error of `rows` if 6 columns fit both layouts or neither, or classes two lists, and there is no
    choice.
    """
    counts = np.unique(rows.n_columns).tolist()
    if len(counts) != 1:
        return None
    (n_columns,) = counts
    if content := _no_pixels_in(rows.values):
        raise rows.error(
            f"{rows.path}: expected rows frame,id,x,y,w,h,score in pixels, found {content}; "
            "convert the file."
        )
    fitting = [
        layout for layout in LAYOUTS if n_columns in layout.n_columns and layout.fits(rows.values)
    ]
    if names == MOT_CLASSES:
        fitting = [layout for layout in fitting if not layout.is_guessed]
    lists = list(dict.fromkeys(layout.title for layout in fitting if layout.is_guessed))
    if len(lists) > 1 and not names:
        raise rows.error(
            f"{rows.path}: expected classes of a known list, found numbers of "
            f"{' or '.join(lists)}; choose with --names visdrone or --names coco, or write the "
            "names into classes.txt beside the file."
        )
    if n_columns != _N_SHORT or len(fitting) == 1:
        return fitting[0] if fitting else None
    if form is None:
        raise rows.error(
            f"{rows.path}: expected 6 columns frame,x1,y1,x2,y2,score or frame,id,x,y,w,h, found "
            f"rows that are valid boxes in {'both' if fitting else 'neither'}; add the score as a "
            "seventh column to rows with an id, or write scores as fractions."
        )
    return CORNERS if form == CORNERS.form else SIZES
