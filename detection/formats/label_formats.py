"""The label formats: how each is recognised from its content, read as a `BoxTable`, and written.

A format is one row of `LABEL_FORMATS`. Files are recognised by their first bytes or line, never by
their names.
"""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from track_range.detection.formats.tables.box_table import NO_FACTS, BoxTable, VideoFacts, Written
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.video_labels import text_tables
from track_range.detection.formats.video_labels.coco import read_coco, write_coco
from track_range.detection.formats.video_labels.csv_labels import has_label_columns
from track_range.detection.formats.video_labels.cvat import read_cvat, write_cvat
from track_range.detection.formats.video_labels.number_rows import is_number_row
from track_range.detection.formats.video_labels.tool_labels import LAYOUTS, read_layout, start_of
from track_range.detection.formats.video_labels.yolo_tracks import (
    is_yolo_folder,
    read_yolo_folder,
    write_yolo,
)
from track_range.foundation.files.input_files import first_line, open_regular, readable

_PARQUET_MARK = "PAR1"  # first bytes of a Parquet file


@dataclass(frozen=True, slots=True)
class LabelFormat:
    """One format of label files, with its name on the command line and its title in messages."""

    name: str
    title: str
    # of a path and its first line ("" = a folder), or first bytes of Parquet
    is_format: Callable[[Path, str], bool]
    # facts about the video fill in what the file does not state
    read: Callable[[Path, VideoFacts], BoxTable]
    # writes a table to a path; None = not written
    write: Callable[[BoxTable, Path], Written] | None = None
    has_classes: bool = True  # whether a box has a class
    # whether detections and ground truth are read with `read`, without rules of a benchmark
    is_general: bool = False
    is_folder: bool = False  # whether it is a folder with one file per frame
    is_of_run: bool = False  # whether it has the rows of a run, and so no ground truth
    # what the first 64 kB match, of a folder those of its first file
    mark: re.Pattern[str] | None = None
    # largest difference of an edge read again; None = depends on the image size
    precision_px: float | None = None


def _starts(*starts: str) -> Callable[[Path, str], bool]:
    return lambda path, first: first.startswith(starts)


def _is_kitti(path: Path, first: str) -> bool:
    return "," not in first and (not first or not is_number_row(first))


# fmt: off
_FORMATS: tuple[LabelFormat, ...] = (
    LabelFormat("mot", "MOTChallenge", _starts(""), text_tables.read_mot_table, text_tables.write_mot_table,
                has_classes=False, precision_px=0.01),
    LabelFormat("kitti", "KITTI", _is_kitti, text_tables.read_kitti_table,
                text_tables.write_kitti_table, precision_px=0.005),
    LabelFormat("tracks", "a tracks.csv", _starts("frame,time_s,"), text_tables.read_tracks_table, is_of_run=True),
    LabelFormat("csv", "a CSV of labels", lambda path, first: "," in first and has_label_columns(path),
                text_tables.read_csv_table_of_labels),
    LabelFormat("coco", "COCO", _starts("{", "["), read_coco, write_coco, is_general=True, precision_px=0.0005),
    LabelFormat("cvat", "CVAT for video 1.1", _starts("<"), read_cvat, write_cvat, is_general=True,
                precision_px=0.0005),
    LabelFormat("yolo", "YOLO", lambda path, first: not first and is_yolo_folder(path), read_yolo_folder, write_yolo,
                is_general=True, is_folder=True),
    LabelFormat("parquet", "a tracks.parquet", _starts(_PARQUET_MARK), text_tables.read_parquet_table, is_general=True,
                is_of_run=True),
)
# fmt: on
_FORMATS += tuple(
    LabelFormat(
        name,
        layout.title,
        lambda path, first: False,
        read_layout(name),
        is_general=True,
        mark=layout.mark,
        is_folder=layout.is_folder,
    )
    for name, layout in LAYOUTS.items()
)
# the last that recognises a file
LABEL_FORMATS = {label_format.name: label_format for label_format in _FORMATS}
_MARKED = [(form.mark, form) for form in _FORMATS if form.mark is not None]


def label_format_of(path: Path, expected: str = "labels") -> LabelFormat:
    """The format of a file or folder, recognised from its content; LabelFileError if it cannot be
    read, or is empty.
    """
    first = ""
    if not os.path.isdir(path):  # unlike Path.is_dir, False for a name that is too long
        is_parquet = _starts_as_parquet(path, expected)
        first = _PARQUET_MARK if is_parquet else first_line(path, LabelFileError, expected).strip()
        if not first:
            raise LabelFileError(f"{path}: expected {expected}, got an empty file.")
    start = "" if first == _PARQUET_MARK else start_of(path)
    is_folder = os.path.isdir(path)
    for mark, form in _MARKED:
        if (form.is_folder or not is_folder) and mark.match(start):
            return form
    return next(form for form in reversed(LABEL_FORMATS.values()) if form.is_format(path, first))


def read_labels(path: Path, video: VideoFacts = NO_FACTS, *, expected: str = "labels") -> BoxTable:
    """The boxes of a file or folder in any format; LabelFileError if it is invalid.

    `video` has facts that the file may lack, such as the image size for YOLO; messages call the
    content `expected`.
    """
    return label_format_of(path, expected).read(path, video)


def is_label_folder(path: Path) -> bool:
    """Whether a folder is one sequence with one label file for each image; False for KITTI's object
    files.
    """
    return os.path.isdir(path) and label_format_of(path).name != "kitti"


def is_blank(path: Path, expected: str) -> bool:
    """Whether a file has no text in its first 64 kB; False for folders and Parquet files."""
    if os.path.isdir(path) or _starts_as_parquet(path, expected):
        return False
    return not first_line(path, LabelFileError, expected)


def _starts_as_parquet(path: Path, expected: str) -> bool:
    with open_regular(path, LabelFileError, expected) as file, readable(path, LabelFileError):
        return file.read(len(_PARQUET_MARK)) == _PARQUET_MARK.encode()
