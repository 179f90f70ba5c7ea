"""The label formats: a file is recognised from its content, never by its name.

Other packages add formats with entry points of the group `track_range.label_formats`.
"""

import os
from pathlib import Path

from track_range.detection.formats.tables.box_table import NO_FACTS, BoxTable, VideoFacts
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.label_format import PARQUET_MARK, LabelFormat, LabelStart
from track_range.foundation.files.input_files import first_line, open_regular, readable
from track_range.foundation.registry import Registry

LABEL_FORMATS = Registry(
    "track_range.label_formats",
    {
        "mot": "track_range.detection.formats.video_labels.text_tables:MOT",
        "kitti": "track_range.detection.formats.video_labels.text_tables:KITTI",
        "tracks": "track_range.detection.formats.video_labels.text_tables:TRACKS",
        "csv": "track_range.detection.formats.video_labels.text_tables:CSV",
        "coco": "track_range.detection.formats.video_labels.coco:COCO",
        "cvat": "track_range.detection.formats.video_labels.cvat:CVAT",
        "yolo": "track_range.detection.formats.video_labels.yolo_tracks:YOLO",
        "parquet": "track_range.detection.formats.video_labels.text_tables:PARQUET",
        "openlabel": "track_range.detection.formats.tool_labels.openlabel:OPENLABEL",
        "tools": "track_range.detection.formats.tool_labels.reader:FORMATS",
    },
    LabelFormat,
    error=LabelFileError,
)


def label_format_of(path: Path, expected: str = "labels") -> LabelFormat:
    """The format of a file or folder, recognised from its content; LabelFileError if it cannot be
    read, or is empty.
    """
    first = ""
    is_folder = os.path.isdir(path)  # unlike Path.is_dir, False for a name that is too long
    if not is_folder:
        is_parquet = _starts_as_parquet(path, expected)
        first = PARQUET_MARK if is_parquet else first_line(path, LabelFileError, expected).strip()
        if not first:
            raise LabelFileError(f"{path}: expected {expected}, got an empty file.")
    start = LabelStart(path, first, is_folder)
    answers = LABEL_FORMATS.answers(lambda form: form.recognises(start))
    return next(form for form, is_recognised in answers if is_recognised)


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
        return file.read(len(PARQUET_MARK)) == PARQUET_MARK.encode()
