"""The label formats: how each is recognised from its content, read as a `BoxTable`, and written.

A format is one row of `LABEL_FORMATS`. Files are recognised by their first bytes or line, never by their names.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from track_range.detection.formats.box_table import NO_FACTS, BoxTable, VideoFacts, Written
from track_range.detection.formats.errors import LabelFileError
from track_range.detection.formats.video_labels.coco import read_coco, write_coco
from track_range.detection.formats.video_labels.csv_labels import has_label_columns
from track_range.detection.formats.video_labels.cvat import read_cvat, write_cvat
from track_range.detection.formats.video_labels.text_tables import (
    read_csv_table_of_labels,
    read_kitti_table,
    read_mot_table,
    read_parquet_table,
    read_tracks_table,
    write_kitti_table,
    write_mot_table,
)
from track_range.detection.formats.video_labels.yolo_tracks import is_yolo_folder, read_yolo_folder, write_yolo
from track_range.foundation.files.input_files import first_line, open_regular, readable

_PARQUET_MARK = b"PAR1"
"""First bytes of a Parquet file."""

_FIRST_CHARACTERS = {"{": "coco", "[": "coco", "<": "cvat"}
"""Format by the first character of a file: JSON or XML."""


@dataclass(frozen=True, slots=True)
class LabelFormat:
    """One format of label files.

    Attributes:
        name: name on the command line.
        title: name for messages.
        read: returns the boxes of a file or folder; facts about the video fill in what the file does not state.
        write: writes a table to a path; None = not written.
        has_classes: whether a box has a class.
        is_general: whether detections and ground truth are read with `read`, without rules of a benchmark.
        is_folder: whether it is written as a folder with one file per frame.
        precision_px: largest difference of an edge that is written and read again; None = depends on the image size.
    """

    name: str
    title: str
    read: Callable[[Path, VideoFacts], BoxTable]
    write: Callable[[BoxTable, Path], Written] | None = None
    has_classes: bool = True
    is_general: bool = False
    is_folder: bool = False
    precision_px: float | None = None


LABEL_FORMATS = {
    label_format.name: label_format
    for label_format in (
        LabelFormat("mot", "MOTChallenge", read_mot_table, write_mot_table, has_classes=False, precision_px=0.01),
        LabelFormat("kitti", "KITTI", read_kitti_table, write_kitti_table, precision_px=0.005),
        LabelFormat("coco", "COCO", read_coco, write_coco, is_general=True, precision_px=0.0005),
        LabelFormat("cvat", "CVAT for video 1.1", read_cvat, write_cvat, is_general=True, precision_px=0.0005),
        LabelFormat("yolo", "YOLO", read_yolo_folder, write_yolo, is_general=True, is_folder=True),
        LabelFormat("csv", "a CSV of labels", read_csv_table_of_labels),
        LabelFormat("tracks", "a tracks.csv", read_tracks_table),
        LabelFormat("parquet", "a tracks.parquet", read_parquet_table, is_general=True),
    )
}
"""All formats by name."""


def label_format_of(path: Path, expected: str = "labels") -> LabelFormat:
    """The format of a file or folder, recognised from its content.

    Args:
        path: the file or folder.
        expected: noun phrase for the content, for messages.

    Raises:
        LabelFileError: it cannot be read, or is empty.
    """
    return LABEL_FORMATS[_format_name(path, expected)]


def read_labels(path: Path, video: VideoFacts = NO_FACTS, *, expected: str = "labels") -> BoxTable:
    """The boxes of a file or folder in any format.

    Args:
        path: the file or folder.
        video: facts about the video, which the file may lack, such as the image size for YOLO.
        expected: noun phrase for the content, for messages.

    Raises:
        LabelFileError: the file cannot be read, or is invalid.
    """
    return label_format_of(path, expected).read(path, video)


def is_blank(path: Path, expected: str) -> bool:
    """Whether a file has no text in its first 64 kB; False for folders and Parquet files.

    Raises:
        LabelFileError: the file cannot be read.
    """
    if os.path.isdir(path) or _starts_as_parquet(path, expected):
        return False
    return not first_line(path, LabelFileError, expected)


def _format_name(path: Path, expected: str) -> str:
    if os.path.isdir(path):  # unlike Path.is_dir, False for a name that is too long
        return "yolo" if is_yolo_folder(path) else "kitti"
    if _starts_as_parquet(path, expected):
        return "parquet"
    first = first_line(path, LabelFileError, expected).strip()
    if not first:
        raise LabelFileError(f"{path}: expected {expected}, got an empty file.")
    if first[0] in _FIRST_CHARACTERS:
        return _FIRST_CHARACTERS[first[0]]
    if "," not in first:
        return "kitti"
    if has_label_columns(path):
        return "csv"
    return "tracks" if first.startswith("frame,time_s,") else "mot"


def _starts_as_parquet(path: Path, expected: str) -> bool:
    with open_regular(path, LabelFileError, expected) as file, readable(path, LabelFileError):
        return file.read(len(_PARQUET_MARK)) == _PARQUET_MARK
