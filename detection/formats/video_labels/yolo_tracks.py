"""Folders of YOLO labels of the frames of one video, as `BoxTable`; their rows are described in
`yolo_labels`.

    DIR/labels/NAME_000000.txt   `class cx cy w h [score] [id]`, fractions of the image size, corner convention
    DIR/images/NAME_000000.jpg   the frame, optional
    DIR/data.yaml                names of the classes, and `video` with width, height, frames and fps

The last number in a file name is the frame, from 0. Written labels have five columns, which
training programs expect; frames without boxes have empty files. When reading, the files may also be
in DIR itself, and rows may have the score and the identity that Ultralytics' `save_txt` appends:
six columns with a score, or with an identity if no row has seven, and seven with both. Ultralytics
numbers the frames of a video from 1, without zeros in front (NAME_1.txt).
(https://docs.ultralytics.com/datasets/detect)
"""

import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from track_range.detection.boxes import HALF_PIXEL_PX, xyxy_from_cxcywh
from track_range.detection.classes import COCO_CLASSES
from track_range.detection.formats.tables import table_checks
from track_range.detection.formats.tables.box_table import (
    BoxTable,
    VideoFacts,
    Written,
    frames_listed,
    image_name,
)
from track_range.detection.formats.tables.class_names import names_for_folder
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.label_format import LabelFormat
from track_range.detection.formats.tables.limits import MAX_FRAME, MAX_ID, MAX_SIDE_PX
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.files.images import IMAGE_SUFFIXES, header_size_px
from track_range.foundation.files.input_files import (
    MAX_TABLE_BYTES,
    first_line,
    open_regular,
    quoted,
    read_text,
    readable,
)
from track_range.foundation.files.numeric_text import numbers
from track_range.foundation.files.structured_text import read_yaml, yaml_text
from track_range.foundation.schemas.validation import PositiveNumber, validated

DATA_YAML = "data.yaml"
# first line of a data.yaml that may be replaced with its folder
WRITTEN_MARK = "# Written by track-range export."

_INTEGER = re.compile(r"\d+")
_N_BOX, _N_COLUMNS = 5, 7  # columns of a box, and of a box with score and identity
_N_COMMON = 4  # names that COCO's list and the road classes have in common: person to motorcycle
_MAX_FRACTION = 2.0  # of a plausible box, which may extend beyond the image

_NOT_LABELS = frozenset({"classes.txt", "train.txt", "val.txt", "test.txt", "readme.txt"})


def is_yolo_folder(path: Path) -> bool:
    """Whether a folder has YOLO labels: a folder labels, a data.yaml, or files of at least five
    numbers per line.
    """
    if os.path.isdir(path / "labels") or os.path.isfile(path / DATA_YAML):
        return True
    for file in _label_files(path)[0]:
        try:
            cells = first_line(file, LabelFileError, "YOLO labels").split()
        except LabelFileError:
            return False
        if cells:
            is_number = np.isfinite(numbers(cells))
            return (
                bool(is_number.all())
                and len(cells) >= _N_BOX
                and _INTEGER.fullmatch(cells[0]) is not None
            )
    return False


def read_yolo_folder(path: Path, video: VideoFacts) -> BoxTable:
    """The boxes of a folder of label files; the image size is taken from `video`, data.yaml or the
    images.

    LabelFileError: the folder cannot be read, has no label files, or two for one frame; a row is
    invalid, has a polygon, or a class number without a name; or the image size is unknown.
    """
    files, folder = _label_files(path)
    if not files:
        raise LabelFileError(
            f"{path}: expected YOLO labels such as labels/NAME_000000.txt, found none."
        )
    frame_of, notes = _frames(path, files, video)
    first_frame = min(frame_of.values())
    stated = video.names or names_for_folder(folder)
    names = stated or COCO_CLASSES
    if not stated:
        notes.insert(
            0,
            f"{path.name}: there is no data.yaml or classes.txt with class names, so class numbers "
            "are read as 0 person, 1 bicycle, 2 car, 3 motorcycle; --names gives others.",
        )
    facts = _facts(path, folder, video)
    if facts.size_px is None:
        raise LabelFileError(
            f"{path}: expected the image size, which YOLO labels do not contain, found none; put "
            f"the images in {path.name}/images, or give the video."
        )
    frame, rows, lines = [], [], []
    for file in files:
        text = read_text(file, LabelFileError, "YOLO labels", max_bytes=MAX_TABLE_BYTES)
        for number, line in enumerate(text.split("\n"), start=1):
            if cells := line.split():
                where = f"{file}, line {number}"
                frame.append(frame_of[file])
                rows.append(_row(where, cells, len(names)))
                lines.append((where, cells))
    table = np.array(rows, np.float64).reshape(-1, _N_COLUMNS)
    if not stated and (number := int(table[:, 0].max(initial=0))) >= _N_COMMON:
        raise LabelFileError(
            f"{path}: expected the class names in data.yaml or classes.txt, found none, and the "
            f"number {number} is {COCO_CLASSES[number]} in COCO's list but not in others; choose "
            "with --names coco or --names a,b,c."
        )
    score, track_id = _score_and_identity(table, lines)
    is_valid = (table[:, 3:5] > 0).all(axis=1)
    size_px = np.array([*facts.size_px, *facts.size_px])
    result = BoxTable.of(
        np.array(frame, np.int64)[is_valid],
        track_id[is_valid],
        [names[int(number)] for number in table[is_valid, 0].tolist()],
        xyxy_from_cxcywh(table[is_valid, 1:5]) * size_px - HALF_PIXEL_PX,
        score=score[is_valid],
        video=replace(facts, first_frame=first_frame),
        notes=(
            *notes,
            *table_checks.ignored_note(path, int((~is_valid).sum()), "without width or height"),
        ),
    )
    table_checks.check_identities(result, path)
    return result


def _row(where: str, cells: list[str], n_names: int) -> list[float]:
    """Class, centre, size and up to two more columns of one line, NaN if there are none."""
    if len(cells) > _N_COLUMNS:
        raise LabelFileError(
            f"{where}: expected a box 'class cx cy w h', found {len(cells)} columns, as in the row "
            "of a polygon."
        )
    values = numbers(cells)
    box = values[1:5]
    is_box = (
        len(cells) >= _N_BOX
        and all(abs(value) <= _MAX_FRACTION for value in box)
        and min(box[2:]) >= 0
    )
    if not is_box or values[0] % 1 or not all(abs(value) <= MAX_ID for value in values):
        raise LabelFileError(
            f"{where}: expected 'class cx cy w h', an integer and fractions of the image size, "
            f"found {quoted(' '.join(cells))}."
        )
    if not 0 <= values[0] < n_names:
        raise LabelFileError(
            f"{where}: expected a class number from 0 to {n_names - 1}, found {quoted(cells[0])}; "
            "check the names in data.yaml or classes.txt."
        )
    return values + [np.nan] * (_N_COLUMNS - len(cells))


def _score_and_identity(
    table: FloatArray, lines: Sequence[tuple[str, list[str]]]
) -> tuple[FloatArray, IntArray]:
    """(N,) score, NaN if there is none, and (N,) identity, -1 if there is none, of rows (N, 7).

    A sixth column is a score beside rows of seven; else it is an identity if it has integers
    throughout, which scores are not. LabelFileError: rows of seven columns do not end with an
    identity, as for a triangle.
    """
    n_columns = np.array([len(cells) for _, cells in lines], np.int64)
    is_full = n_columns == _N_COLUMNS
    is_longer = is_full if is_full.any() else n_columns > _N_BOX
    is_integer = all(
        _INTEGER.fullmatch(cells[-1])
        for (_, cells), may_be_identity in zip(lines, is_longer, strict=True)
        if may_be_identity
    )
    for row in np.flatnonzero(is_full & (not is_integer))[:1]:
        raise LabelFileError(
            f"{lines[row][0]}: expected a row 'class cx cy w h score id', found seven columns, as "
            "in the row of a polygon, while other rows do not end with an identity."
        )
    last = table[np.arange(len(table)), n_columns - 1]
    has_ids = is_integer and bool((is_longer & ((last > 1) | is_full)).any())
    track_id = np.where(is_longer & has_ids, last, -1).astype(np.int64)
    has_score = n_columns - (is_longer & has_ids) > _N_BOX
    return np.where(has_score, table[:, _N_BOX], np.nan), track_id


def _label_files(path: Path) -> tuple[list[Path], Path]:
    """Label files of a folder, sorted by name, and the folder with the files; no files if it cannot
    be read.
    """
    folder = path / "labels" if os.path.isdir(path / "labels") else path
    pattern = "**/*.txt" if folder != path else "*.txt"
    with readable(path, LabelFileError):
        files = sorted(
            file for file in folder.glob(pattern) if file.is_file() and file.name not in _NOT_LABELS
        )
    return files, folder


def _frames(
    path: Path, files: Sequence[Path], video: VideoFacts
) -> tuple[dict[Path, int], list[str]]:
    """Frame number from 0 by file, and notes on the numbers in the names."""
    file_of: dict[int, Path] = {}
    for file in files:
        frame = table_checks.frame_in_name(table_checks.image_stem(file.name))
        if frame is None:
            raise LabelFileError(
                f"{file}: expected a frame number at the end of the name, such as NAME_000000.txt."
            )
        if (other := file_of.setdefault(frame, file)) != file:
            raise LabelFileError(
                f"{path}: expected one file for each frame of one video, found "
                f"{quoted(str(other.relative_to(path)))} and {quoted(str(file.relative_to(path)))} "
                f"for frame {frame}."
            )
    names = [table_checks.image_stem(file.name) for file in files]
    table_checks.check_names(names, path)
    numbers = np.array(list(file_of), np.int64)
    first = 0
    if not video.first_frame:  # the user states how the numbers are meant
        first = table_checks.first_frame_number(
            numbers, int(table_checks.is_unpadded(names)), video.n_frames
        )
    notes = list(table_checks.first_frame_note(path, int(numbers.min()), len(files)))
    if first:
        notes = [
            f"{path.name}: the numbers in the file names are taken to start at 1, as Ultralytics "
            f"writes them for a video; the first number is {numbers.min()}."
        ]
    return {file: frame - first for frame, file in file_of.items()}, notes


class _VideoSection(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)
    name: str = ""
    width: int | None = Field(None, ge=1, le=MAX_SIDE_PX)
    height: int | None = Field(None, ge=1, le=MAX_SIDE_PX)
    frames: int | None = Field(None, ge=1, le=MAX_FRAME)
    fps: PositiveNumber | None = None
    pixels: str = "original"


def _facts(path: Path, folder: Path, video: VideoFacts) -> VideoFacts:
    """Facts about the video, completed by data.yaml and by the first image next to the labels."""
    file = next(
        (
            parent / DATA_YAML
            for parent in (path, path.parent)
            if os.path.isfile(parent / DATA_YAML)
        ),
        None,
    )
    content = {} if file is None else read_yaml(file, LabelFileError, "a data.yaml")
    section = content.get("video") if isinstance(content, dict) else None
    stated = validated(_VideoSection, section or {}, f"{file}, video", LabelFileError)
    size_px = (
        None if stated.width is None or stated.height is None else (stated.width, stated.height)
    )
    size_px = video.size_px or size_px or _image_size_px(path, folder)
    is_rectified = stated.pixels == "rectified"
    facts = VideoFacts(
        stated.name, stated.frames, size_px=size_px, fps=stated.fps, is_rectified=is_rectified
    )
    return video.completed_by(facts, path)


def _image_size_px(path: Path, labels: Path) -> tuple[int, int] | None:
    for folder in (path / "images", labels.parent / "images", labels):
        images = (file for file in folder.rglob("*") if file.suffix.lower() in IMAGE_SUFFIXES)
        if (first := min(images, default=None)) is not None:
            with (
                open_regular(first, LabelFileError, "an image") as file,
                readable(first, LabelFileError),
            ):
                return header_size_px(file)
    return None


def write_yolo(table: BoxTable, path: Path) -> Written:
    """Write a table as folder `path` with labels and data.yaml; LabelFileError if the image size is
    unknown.

    Boxes are clipped to the image. Identities, scores, distances and regions are not written.
    """
    video = table.video
    if video.size_px is None:
        raise LabelFileError(
            f"{path}: expected a known image size, which YOLO labels need; give the video with "
            "--video."
        )
    size = np.array([*video.size_px, *video.size_px], np.float64)
    edges = np.clip(table.xyxy_px + HALF_PIXEL_PX, 0.0, size) / size
    is_visible = (edges[:, 2:] > edges[:, :2]).all(axis=1)
    is_written = is_visible & ~table.is_region
    written, edges = table.select(is_written), edges[is_written]
    fractions = np.concatenate(
        [(edges[:, :2] + edges[:, 2:]) / 2, edges[:, 2:] - edges[:, :2]], axis=1
    ).tolist()
    names = written.all_labels
    lines = [
        # 1e-5 px in 1000
        f"{names.index(label)} {' '.join(f'{fraction:.8f}' for fraction in row)}\n"
        for label, row in zip(written.label, fractions, strict=True)
    ]
    (path / "labels").mkdir(parents=True)
    for frame in frames_listed(table):
        first, last = np.searchsorted(written.frame, [frame, frame + 1])
        file = path / "labels" / Path(image_name(video, frame)).with_suffix(".txt")
        file.write_text("".join(lines[first:last]), encoding="utf-8", newline="\n")
    width, height = video.size_px
    facts = {
        "name": video.name,
        "width": width,
        "height": height,
        "frames": video.n_frames,
        "fps": video.fps,
    }
    section: dict[str, Any] = {key: value for key, value in facts.items() if value}
    section["pixels"] = video.pixels
    document = {"train": "images", "val": "images", "names": names, "video": section}
    (path / DATA_YAML).write_text(
        f"{WRITTEN_MARK}\n{yaml_text(document)}", encoding="utf-8", newline="\n"
    )
    n_outside = int((~is_visible & ~table.is_region).sum())
    notes = (f"Boxes outside the image are not written: {n_outside}.",) if n_outside else ()
    return Written(len(written), (*notes, *table_checks.omitted_regions_note(table)))


YOLO = LabelFormat(
    name="yolo",
    title="YOLO",
    recognises=lambda start: start.is_folder and is_yolo_folder(start.path),
    priority=-10,  # any folder of texts with numbers
    read=read_yolo_folder,
    write=write_yolo,
    is_folder=True,
)
