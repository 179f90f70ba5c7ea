"""Boxes with known distances from a CSV file or from label files (COCO, CVAT, CSV), for fitting
size models.

    class,x1,y1,x2,y2,distance_m,fx[,fy,cx,cy,track,sequence]

A CSV file without a header has the columns in this order. Distances are used as given, to any part
of the object. Defaults: fy = fx; cx = the middle of the boxes' horizontal extent; a track per box;
a single sequence.

In label files the distance is the attribute `distance_m` of a box. It is measured by a person, a
lidar or a radar; in an export of a run it is the run's own, which teaches a size model nothing new.
Boxes that touch the border of the image, predicted boxes and boxes without a distance are left out.
"""

from pathlib import Path

import numpy as np

from track_range.detection.boxes import are_valid_boxes
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.label_formats import read_labels
from track_range.detection.formats.tables.box_table import BoxTable
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.limits import MAX_COORDINATE_PX, MAX_DISTANCE_M
from track_range.detection.formats.tables.table_checks import other_labels_note
from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.csv_tables import CsvTable, read_csv_table
from track_range.foundation.files.input_files import quoted
from track_range.ranging.truth.frame_times import ASSUMED_STEP_S
from track_range.ranging.truth.label_classes import size_class_of
from track_range.ranging.truth.labelled_boxes import BoxSet

COLUMNS = (
    "class",
    "x1",
    "y1",
    "x2",
    "y2",
    "distance_m",
    "fx",
    "fy",
    "cx",
    "cy",
    "track",
    "sequence",
)
"""Columns in the order of a file without a header."""

_REQUIRED = COLUMNS[:6]
_BORDER_PX = 1.0  # distance from the image border within which a labelled box counts as cut
_MAX_TEXT = 200  # largest number of characters of the name of a track or sequence

_NUMBERS = COLUMNS[1:10]
_POSITIVE = ("distance_m", "fx", "fy")


def read_box_csv(path: Path, *, focal_px: float | None = None) -> tuple[BoxSet, tuple[str, ...]]:
    """Boxes from a CSV file, and notes for the user; `focal_px` is used if the file has no column
    fx.

    Raises LabelFileError: the file cannot be read, a column, number or focal length is missing, a
    class is unknown, or a box has x1 >= x2 or y1 >= y2.
    """
    table = read_csv_table(
        path, LabelFileError, f"columns {','.join(COLUMNS[:7])}", default_header=COLUMNS
    )
    table.require(_REQUIRED)
    table.refuse_duplicates(COLUMNS)
    if "fx" not in table and focal_px is None:
        raise LabelFileError(
            f"{path}: expected a focal length; add a column fx (in px) or give --focal-px, either "
            "from the camera's calibration or as image width / (2 tan(field of view / 2))."
        )
    if not len(table):
        raise LabelFileError(f"{path}: expected at least one row below the header, got none.")
    _check_texts(table)
    numbers = _checked_numbers(table)
    xyxy_px = np.stack([numbers[name] for name in ("x1", "y1", "x2", "y2")], axis=1)
    invalid = np.flatnonzero(~are_valid_boxes(xyxy_px)).tolist()
    if invalid:
        raise table.fault(invalid[0], "expected a box with x1 < x2 and y1 < y2.")
    class_names = _class_names(table)
    n = len(table)
    fx = numbers["fx"] if "fx" in numbers else np.full(n, focal_px)
    fy, cy = numbers.get("fy", fx), numbers.get("cy", 0 * fx)
    middle = np.full(n, (xyxy_px[:, 0].min() + xyxy_px[:, 2].max()) / 2)
    names, number = np.unique(table.texts("sequence"), return_inverse=True)
    track = table.texts("track")
    track_id = np.arange(n)
    if track[0]:
        track_id = np.unique(track, return_inverse=True)[1].astype(np.int64).reshape(n)
    notes = []
    if "cx" not in numbers:
        notes.append(
            f"{path.name} has no column cx; assuming cx = {middle[0]:g} px, midway between the "
            "outermost box edges."
        )
    if len(names) == 1:
        notes.append(
            f"{path.name} contains only one sequence; the curves cannot be validated on "
            "other drives."
        )
    boxes = BoxSet.without_3d_boxes(
        sequence_names=tuple(str(name) for name in names),
        sequence=number.astype(np.int64).reshape(n),
        frame=np.arange(n),
        time_s=np.arange(n, dtype=np.float64),
        track_id=track_id,
        kitti_type=np.array(table.texts("class"), np.str_),
        class_name=np.array(class_names, np.str_),
        xyxy_px=xyxy_px,
        fxycxy_px=np.stack([fx, fy, numbers.get("cx", middle), cy], axis=1),
        size_px=np.tile(np.ceil(xyxy_px[:, 2:].max(axis=0)).astype(np.int64) + 1, (n, 1)),
        distance_m=numbers["distance_m"],
    )
    return boxes, tuple(notes)


def _check_texts(table: CsvTable) -> None:
    """Raise LabelFileError for a name of a track or sequence that is too long."""
    for name in ("track", "sequence"):
        for row, text in enumerate(table.texts(name)):
            if len(text) > _MAX_TEXT:
                raise table.fault(row, f"expected at most {_MAX_TEXT} characters for {name}.")


def _checked_numbers(table: CsvTable) -> dict[str, FloatArray]:
    """The columns of numbers that the table has, by name; LabelFileError for impossible numbers."""
    numbers: dict[str, FloatArray] = {}
    for name in _NUMBERS:
        if name not in table:
            continue
        values = numbers[name] = table.numbers(name)
        low, high = -MAX_COORDINATE_PX, MAX_COORDINATE_PX
        if name == "distance_m":
            low, high = 0.0, MAX_DISTANCE_M
        is_valid = (values >= low) & (values <= high)
        expected = "finite"
        if name in _POSITIVE:
            is_valid &= values > 0
            expected = "positive"
        table.check(name, is_valid, f"a {expected} number up to {high:,.0f}")
    return numbers


def _class_names(table: CsvTable) -> list[str]:
    """The class of each row, also van; LabelFileError for others."""
    names = []
    for row, text in enumerate(table.texts("class")):
        name = size_class_of(text)
        if not name:
            raise table.fault(
                row, f"expected a class such as {', '.join(ROAD_CLASSES)}, van, got {quoted(text)}."
            )
        names.append(name)
    return names


def read_box_labels(path: Path, *, focal_px: float | None) -> tuple[BoxSet, tuple[str, ...]]:
    """Boxes with distances from a label file, and notes for the user.

    Raises LabelFileError: the file cannot be read, no box has a distance, or the focal length is
    missing.
    """
    table = read_labels(path, expected="labels with distances")
    if focal_px is None:
        raise LabelFileError(
            f"{path}: expected a focal length, which labels do not have; give --focal-px."
        )
    rows = _usable(table)
    if not len(rows):
        raise LabelFileError(
            f"{path}: expected boxes inside the image with the attribute distance_m, found none."
        )
    extent_px = np.ceil(rows.xyxy_px[:, 2:].max(axis=0)).astype(np.int64) + 1
    width, height = table.video.size_px or (int(extent_px[0]), int(extent_px[1]))
    cx, cy = (width - 1) / 2, (height - 1) / 2
    n = len(rows)
    notes = (
        *table.notes,
        *other_labels_note(table, path),
        f"{path.name}: {n} of {len(table)} boxes are used; the principal point is taken to be the "
        "image centre.",
    )
    boxes = BoxSet.without_3d_boxes(
        sequence_names=(path.stem,),
        sequence=np.zeros(n, np.int64),
        frame=rows.frame,
        time_s=np.asarray(
            rows.frame * (ASSUMED_STEP_S if rows.video.fps is None else 1 / rows.video.fps),
            np.float64,
        ),
        track_id=np.where(rows.track_id < 0, rows.track_id.max() + 1 + np.arange(n), rows.track_id),
        kitti_type=rows.class_name,
        # vans are separate from cars
        class_name=np.where(rows.class_name == "van", "van", np.array(ROAD_CLASSES)[rows.class_id]),
        xyxy_px=rows.xyxy_px,
        fxycxy_px=np.tile([focal_px, focal_px, cx, cy], (n, 1)),
        size_px=np.tile(np.array([width, height], np.int64), (n, 1)),
        distance_m=rows.distance_m,
    )
    return boxes, notes


def _usable(table: BoxTable) -> BoxTable:
    """The observed boxes of road classes with a distance that do not touch the border of the
    image.
    """
    is_usable = (table.distance_m > 0) & table.observed & (table.class_id >= 0)
    if table.video.size_px is not None:
        last_px = np.array(table.video.size_px) - 1 - _BORDER_PX
        is_usable &= (table.xyxy_px[:, :2] > _BORDER_PX).all(axis=1) & (
            table.xyxy_px[:, 2:] < last_px
        ).all(axis=1)
    return table.select(is_usable)
