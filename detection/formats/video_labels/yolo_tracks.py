"""Folders of YOLO labels of the frames of one video, as `BoxTable`; their rows are described in `yolo_labels`.

    DIR/labels/NAME_000000.txt   `class cx cy w h [score] [id]`, fractions of the image size, corner convention
    DIR/images/NAME_000000.jpg   the frame, optional
    DIR/data.yaml                names of the classes, and `video` with width, height, frames and fps

The last number in a file name is the frame, from 0. Written labels have five columns, which training programs expect;
frames without boxes have empty files. When reading, the files may also be in DIR itself, and rows may have the score
and the identity that Ultralytics' `save_txt` appends: six or seven columns, the last one with integers throughout.
Ultralytics numbers the frames of a video from 1. (https://docs.ultralytics.com/datasets/detect)
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from track_range.detection.boxes import xyxy_from_cxcywh
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.box_table import HALF_PIXEL_PX, BoxTable, VideoFacts, Written, frames_listed
from track_range.detection.formats.errors import LabelFileError
from track_range.detection.formats.image_labels.yolo_labels import names_for_folder
from track_range.detection.formats.limits import MAX_FRAME, MAX_ID
from track_range.detection.formats.table_checks import (
    check_identities,
    check_names,
    first_frame_note,
    frame_in_name,
    ignored_note,
    omitted_regions_note,
)
from track_range.detection.formats.video_labels.coco import image_name
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.files.atomic_files import describe
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
from track_range.foundation.validation import PositiveNumber, validated

DATA_YAML = "data.yaml"

WRITTEN_MARK = "# Written by track-range export."
"""First line of a data.yaml that may be replaced with its folder."""

_DECIMALS = 8
"""Decimals of fractions: 1e-5 px in an image of 1000 px."""

_INTEGER = re.compile(r"\d+")
_N_BOX, _N_COLUMNS = 5, 7
"""Numbers of columns of a box, and of a box with score and identity."""

_MAX_FRACTION = 2.0
"""Largest absolute fraction of a plausible box, which may extend beyond the image."""

_NOT_LABELS = frozenset({"classes.txt", "train.txt", "val.txt", "test.txt", "readme.txt"})


def is_yolo_folder(path: Path) -> bool:
    """Whether a folder has YOLO labels: a folder labels, a data.yaml, or files of at least five numbers per line."""
    if os.path.isdir(path / "labels") or os.path.isfile(path / DATA_YAML):
        return True
    for file in _label_files(path)[0]:
        try:
            cells = first_line(file, LabelFileError, "YOLO labels").split()
        except LabelFileError:
            return False
        if cells:
            is_number = np.isfinite(numbers(cells))
            return bool(is_number.all()) and len(cells) >= _N_BOX and _INTEGER.fullmatch(cells[0]) is not None
    return False


def read_yolo_folder(path: Path, video: VideoFacts) -> BoxTable:
    """The boxes of a folder of label files; the image size is that of `video`, of data.yaml, or of the images.

    Raises:
        LabelFileError: the folder cannot be read, has no label files, or two for one frame; a row is invalid, has a
            polygon, or a class number without a name; or the image size is unknown.
    """
    files, folder = _label_files(path)
    if not files:
        raise LabelFileError(f"{path}: expected YOLO labels such as labels/NAME_000000.txt, found none.")
    frame_of = _frames(path, files)
    frames = sorted(frame_of.values())
    stated_names = names_for_folder(folder)
    names = stated_names or ROAD_CLASSES
    facts = replace(_with_facts(path, folder, video), first_frame=frames[0])
    if facts.size_px is None:
        raise LabelFileError(
            f"{path}: expected the size of the images, which YOLO labels do not have, found none; put the images in "
            f"{path.name}/images, or give the video."
        )
    rows = [row for file in files for row in _rows(file, frame_of[file], len(names))]
    table = np.array([row.values for row in rows], np.float64).reshape(-1, _N_COLUMNS + 1)
    score, track_id = _score_and_identity(rows)
    width, height = facts.size_px
    is_valid = np.asarray((table[:, 4:6] > 0).all(axis=1))
    table, score, track_id = table[is_valid], score[is_valid], track_id[is_valid]
    result = BoxTable.of(
        table[:, 0],
        track_id,
        [names[int(number)] for number in table[:, 1].tolist()],
        xyxy_from_cxcywh(table[:, 2:6]) * np.array([width, height, width, height]) - HALF_PIXEL_PX,
        score=score,
        video=facts,
        notes=(
            *(() if stated_names else (_no_names_note(path),)),
            *first_frame_note(path, frames[0], len(frames)),
            *ignored_note(path, len(is_valid) - len(table), "without width or height"),
        ),
    )
    check_identities(result, path)
    return result


def _no_names_note(path: Path) -> str:
    return (
        f"{path.name}: there is no data.yaml or classes.txt with class names, so the numbers are taken to be 0 "
        f"{ROAD_CLASSES[0]}, 1 {ROAD_CLASSES[1]} to {len(ROAD_CLASSES) - 1} {ROAD_CLASSES[-1]}; the numbers of COCO "
        "differ from 4 on."
    )


@dataclass(frozen=True, slots=True)
class _Row:
    """One line.

    Attributes:
        values: frame, class, centre x, centre y, width, height, and up to two more columns, NaN if there are none.
        n_columns: number of columns in the file.
        ends_with_integer: whether the last column is an integer, without a decimal point.
        where: file and line, for messages.
    """

    values: list[float]
    n_columns: int
    ends_with_integer: bool
    where: str


def _rows(file: Path, frame: int, n_names: int) -> list[_Row]:
    text = read_text(file, LabelFileError, "YOLO labels", max_bytes=MAX_TABLE_BYTES)
    lines = ((number, line.split()) for number, line in enumerate(text.split("\n"), start=1))
    return [_row(f"{file}, line {number}", frame, cells, n_names) for number, cells in lines if cells]


def _row(where: str, frame: int, cells: list[str], n_names: int) -> _Row:
    if len(cells) > _N_COLUMNS:
        raise LabelFileError(f"{where}: expected a box 'class cx cy w h', found {len(cells)} columns, as of a polygon.")
    values = numbers(cells)
    box = values[1:5]
    is_box = len(cells) >= _N_BOX and all(abs(value) <= _MAX_FRACTION for value in box) and min(box[2:]) >= 0
    if not is_box or values[0] % 1 or not all(abs(value) <= MAX_ID for value in values):
        raise LabelFileError(
            f"{where}: expected 'class cx cy w h', an integer and fractions of the image size, found "
            f"{quoted(' '.join(cells[:_N_COLUMNS]))}."
        )
    if not 0 <= values[0] < n_names:
        raise LabelFileError(
            f"{where}: expected a class number from 0 to {n_names - 1}, found {quoted(cells[0])}; check the names in "
            "data.yaml or classes.txt."
        )
    missing = [np.nan] * (_N_COLUMNS - len(cells))
    return _Row([float(frame), *values, *missing], len(cells), _INTEGER.fullmatch(cells[-1]) is not None, where)


def _score_and_identity(rows: Sequence[_Row]) -> tuple[FloatArray, IntArray]:
    """(N,) score, NaN if there is none, and (N,) identity, -1 if there is none.

    Identities are in the last column if it has integers throughout, which scores are not.

    Raises:
        LabelFileError: rows of seven columns do not end with an identity, as those of a triangle.
    """
    longer = [row for row in rows if row.n_columns > _N_BOX]
    is_integer = all(row.ends_with_integer for row in longer)
    for row in longer:
        if row.n_columns == _N_COLUMNS and not is_integer:
            raise LabelFileError(
                f"{row.where}: expected a row 'class cx cy w h score id', found seven columns, as of a polygon; other "
                "rows do not end with an identity."
            )
    has_ids = is_integer and any(row.values[row.n_columns] > 1 or row.n_columns == _N_COLUMNS for row in longer)
    score, track_id = np.full(len(rows), np.nan), np.full(len(rows), -1, np.int64)
    for index, row in enumerate(rows):
        n_scores = row.n_columns - _N_BOX - has_ids
        if has_ids and row.n_columns > _N_BOX:
            track_id[index] = int(row.values[row.n_columns])
        if n_scores == 1:
            score[index] = row.values[_N_BOX + 1]
    return score, track_id


def _label_files(path: Path) -> tuple[list[Path], Path]:
    """Label files of a folder, sorted by name, and the folder that has them; none if it cannot be read."""
    folder = path / "labels" if os.path.isdir(path / "labels") else path
    pattern = "**/*.txt" if folder != path else "*.txt"
    try:
        files = sorted(file for file in folder.glob(pattern) if file.is_file() and file.name not in _NOT_LABELS)
    except OSError as error:
        raise LabelFileError(f"{path}: the folder cannot be read ({describe(error)}).") from error
    return files, folder


def _frames(path: Path, files: Sequence[Path]) -> dict[Path, int]:
    """Frame number by label file.

    Raises:
        LabelFileError: a name has no number, two files have the same one, or the names are of several videos.
    """
    frame_of: dict[Path, int] = {}
    file_of: dict[int, Path] = {}
    for file in files:
        frame = frame_in_name(file.stem)
        if frame is None:
            raise LabelFileError(f"{file}: expected a frame number at the end of the name, such as NAME_000000.txt.")
        if (other := file_of.setdefault(frame, file)) != file:
            raise LabelFileError(
                f"{path}: expected one file for each frame of one video, found {quoted(str(other.relative_to(path)))} "
                f"and {quoted(str(file.relative_to(path)))} for frame {frame}."
            )
        frame_of[file] = frame
    check_names((file.stem for file in files), path)
    return frame_of


class _VideoSection(BaseModel):
    """Section `video` of data.yaml."""

    model_config = ConfigDict(extra="ignore", frozen=True)
    name: str = ""
    width: int | None = Field(None, ge=1, le=65_535)
    height: int | None = Field(None, ge=1, le=65_535)
    frames: int | None = Field(None, ge=1, le=MAX_FRAME)
    fps: PositiveNumber | None = None
    pixels: str = "original"


def _with_facts(path: Path, folder: Path, video: VideoFacts) -> VideoFacts:
    """Facts about the video, completed by data.yaml and by the images."""
    file = next((parent / DATA_YAML for parent in (path, path.parent) if os.path.isfile(parent / DATA_YAML)), None)
    content = {} if file is None else read_yaml(file, LabelFileError, "a data.yaml")
    section = content.get("video") if isinstance(content, dict) else None
    stated = validated(_VideoSection, section or {}, f"{file}, video", LabelFileError)
    size_px = None if stated.width is None or stated.height is None else (stated.width, stated.height)
    return replace(
        video,
        name=video.name or stated.name,
        n_frames=video.n_frames or stated.frames,
        size_px=video.size_px or size_px or _image_size_px(path, folder),
        fps=video.fps or stated.fps,
        is_rectified=video.is_rectified or stated.pixels == "rectified",
    )


def _image_size_px(path: Path, labels: Path) -> tuple[int, int] | None:
    """(width, height) of the first image next to the labels; None if there is none."""
    for folder in (path / "images", labels.parent / "images", labels):
        images = (file for file in folder.rglob("*") if file.suffix.lower() in IMAGE_SUFFIXES)
        first = min(images, default=None)
        if first is not None:
            with open_regular(first, LabelFileError, "an image") as file, readable(first, LabelFileError):
                return header_size_px(file)
    return None


def write_yolo(table: BoxTable, path: Path) -> Written:
    """Write a table as folder `path` with labels and data.yaml.

    Boxes are clipped to the image. Identities, scores, distances and regions are not written.

    Raises:
        LabelFileError: the image size is unknown.
        OSError: a file cannot be written.
    """
    if table.video.size_px is None:
        raise LabelFileError(
            f"{path}: expected a known image size, which YOLO labels need; give the video with --video."
        )
    size = np.array([*table.video.size_px] * 2, np.float64)
    edges = np.clip(table.xyxy_px + HALF_PIXEL_PX, 0.0, size) / size
    is_visible = (edges[:, 2:] > edges[:, :2]).all(axis=1)
    rows = np.flatnonzero(is_visible & ~table.is_region)
    names = list(dict.fromkeys((*ROAD_CLASSES, *sorted({str(name) or "object" for name in table.class_name[rows]}))))
    (path / "labels").mkdir(parents=True)
    for frame in frames_listed(table):
        first, last = np.searchsorted(table.frame[rows], [frame, frame + 1])
        lines = (_line(table, edges, row, names) for row in rows[first:last].tolist())
        name = Path(image_name(table.video, frame)).with_suffix(".txt")
        (path / "labels" / name).write_text("".join(lines), encoding="utf-8", newline="\n")
    (path / DATA_YAML).write_text(_data_yaml(table.video, names), encoding="utf-8", newline="\n")
    n_outside = int((~is_visible & ~table.is_region).sum())
    notes = (f"Boxes outside the image, which are not written: {n_outside}.",) if n_outside else ()
    return Written(len(rows), (*notes, *omitted_regions_note(table)))


def _line(table: BoxTable, edges: FloatArray, row: int, names: Sequence[str]) -> str:
    left, top, right, bottom = edges[row].tolist()
    fractions = ((left + right) / 2, (top + bottom) / 2, right - left, bottom - top)
    number = names.index(str(table.class_name[row]) or "object")
    return f"{number} {' '.join(f'{fraction:.{_DECIMALS}f}' for fraction in fractions)}\n"


def _data_yaml(video: VideoFacts, names: Sequence[str]) -> str:
    width, height = video.size_px or (None, None)
    facts = {"name": video.name, "width": width, "height": height, "frames": video.n_frames, "fps": video.fps}
    section: dict[str, Any] = {key: value for key, value in facts.items() if value}
    section["pixels"] = "rectified" if video.is_rectified else "original"
    document = {"train": "images", "val": "images", "names": list(names), "video": section}
    return f"{WRITTEN_MARK}\n{yaml_text(document)}"
