"""Reader of files with recorded detections.

The format is recognised from the content: KITTI, MOTChallenge's det.txt, plain `frame,x1,y1,x2,y2,score` (RRC),
track-range's tracks.csv, or one of `label_formats` (COCO, CVAT, YOLO, tracks.parquet). A feat.npy next to a
MOTChallenge file has the same rows with an embedding appended to each (the format of nwojke/deep_sort).
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from track_range.detection.boxes import are_valid_boxes
from track_range.detection.classes import ROAD_CLASSES, map_to_road_classes
from track_range.detection.detections import Descriptors, Detections
from track_range.detection.formats.box_table import VideoFacts
from track_range.detection.formats.errors import LabelFileError
from track_range.detection.formats.label_formats import is_blank, label_format_of
from track_range.detection.formats.limits import MAX_FRAME, are_plausible_boxes
from track_range.detection.formats.table_checks import other_labels_note
from track_range.detection.formats.video_labels.kitti import read_kitti
from track_range.detection.formats.video_labels.mot import xyxy_from_mot
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.files.array_files import read_array
from track_range.foundation.files.csv_tables import read_csv_table
from track_range.foundation.files.input_files import MAX_TABLE_BYTES, first_line, quoted, read_text
from track_range.foundation.files.numeric_text import are_integers, number

_MAX_FEATURE = 1e15  # of an embedding: sums of squares do not overflow in float32
_MAX_SCORE = 1e6  # scores are probabilities, or margins of a few units
DetectionFormat = Literal["mot", "kitti", "rrc", "tracks", "labels"]  # rrc: plain rows; tracks: a tracks.csv


class _Rows(NamedTuple):
    """All N rows of a file, also those without a valid frame number, box, score or road class."""

    form: DetectionFormat
    description: str
    frame: IntArray
    xyxy_px: FloatArray
    score: FloatArray
    class_id: IntArray
    descriptor: Descriptors | None = None
    notes: tuple[str, ...] = ()
    is_rectified: bool = False


@dataclass(frozen=True, slots=True)
class RecordedDetections:
    """The N detections of a video."""

    frame: IntArray  # (N,) frame number from 0, ascending
    detections: Detections  # the N boxes in the same order
    form: DetectionFormat  # format of the file
    notes: tuple[str, ...]  # notes for the user on the recognised format and on dropped rows
    is_rectified: bool = False  # whether the boxes are in rectified pixels, not in pixels of the original video

    @property
    def has_classes(self) -> bool:
        """Whether the file has a class for each box."""
        return self.form in ("kitti", "tracks", "labels")

    def at(self, frame_index: int) -> Detections:
        """The detections of one frame."""
        first, last = np.searchsorted(self.frame, [frame_index, frame_index + 1])
        return self.detections.select(np.arange(first, last))


def read_detections(
    path: Path,
    *,
    default_class_id: int = 0,
    form: DetectionFormat | None = None,
    size_px: tuple[int, int] | None = None,
) -> RecordedDetections:
    """The detections in a file, or in a folder of KITTI object files or YOLO labels; an empty file has no boxes.

    `default_class_id` is the class of boxes in formats without classes (MOTChallenge and plain rows), `form` the
    expected format (None = any), `size_px` (width, height) of the images, which YOLO labels need. Raises LabelFileError
    if the file cannot be read, or its format is unknown or not `form`.
    """
    if is_blank(path, "detections") and not _text(path).strip():
        notes = [f"Read {path.name} as an empty file: 0 boxes.", f"{path.name} is empty: there are no boxes."]
        return RecordedDetections(np.zeros(0, np.int64), Detections.empty(), form or "rrc", notes=tuple(notes))
    rows = _rows(path, default_class_id, size_px)
    if form not in (None, rows.form):
        raise LabelFileError(f"{path}: expected the format {form}, got {rows.form} ({rows.description}).")
    score, score_note = _as_probability(np.where(np.abs(rows.score) <= _MAX_SCORE, rows.score, np.nan))
    is_plausible = are_valid_boxes(rows.xyxy_px) & are_plausible_boxes(rows.xyxy_px)
    is_valid = is_plausible & np.isfinite(score) & (rows.class_id >= 0) & (rows.frame >= 0)
    if np.any(rows.frame > MAX_FRAME):
        raise LabelFileError(f"{path}: expected frame numbers up to {MAX_FRAME}, got {rows.frame.max()}.")
    order = np.flatnonzero(is_valid)[np.argsort(rows.frame[is_valid], kind="stable")]
    notes = [f"Read {path.name} as {rows.description}: {len(order)} boxes."]
    if len(order) < len(rows.frame):
        n_dropped = len(rows.frame) - len(order)
        notes.append(f"{path.name}: ignored {n_dropped} rows that are not a valid box of a road class.")
    detections = Detections.of(rows.xyxy_px[order], score[order], rows.class_id[order])
    if rows.descriptor is not None:
        detections = replace(detections, descriptor=rows.descriptor[order])
    notes += [*rows.notes, *score_note]
    return RecordedDetections(rows.frame[order], detections, rows.form, tuple(notes), rows.is_rectified)


def _rows(path: Path, default_class_id: int, size_px: tuple[int, int] | None) -> _Rows:
    label_format = label_format_of(path, "detections")
    if label_format.is_general:
        table = label_format.read(path, VideoFacts(size_px=size_px))
        table = table.select(table.observed)  # as of tracks.csv
        score = np.where(np.isnan(table.score), 1.0, table.score)
        notes = (*table.notes, *other_labels_note(table, path))
        columns = (table.frame, table.xyxy_px, score, table.class_id)
        return _Rows("labels", label_format.title, *columns, None, notes, table.video.is_rectified)
    is_folder = os.path.isdir(path)  # unlike Path.is_dir, False for a name that is too long
    first = "" if is_folder else first_line(path, LabelFileError, "detections")
    if "," not in first:
        labels = read_kitti(path)
        score = np.where(np.isfinite(labels.score), labels.score, 1.0)
        class_id = map_to_road_classes([str(name) for name in labels.kitti_type])
        return _Rows("kitti", "KITTI rows", labels.frame, labels.xyxy_px, score, class_id)
    return _tracks_csv_rows(path) if first.startswith("frame,") else _comma_rows(path, default_class_id)


def _tracks_csv_rows(path: Path) -> _Rows:
    expected = ("frame", "x1_px", "y1_px", "x2_px", "y2_px", "score", "observed")
    table = read_csv_table(path, LabelFileError, f"columns {', '.join(expected)}, class")
    table.require((*expected, "class"))
    cells = np.stack([table.finite(name) for name in expected], axis=1)
    is_frame = (np.abs(cells[:, 0]) <= MAX_FRAME) & (np.rint(cells[:, 0]) == cells[:, 0])
    table.check("frame", cells[:, 0], is_frame, f"an integer from 0 to {MAX_FRAME}")
    class_id = map_to_road_classes(table.texts("class"))
    observed = cells[:, 6] == 1
    cells, class_id = cells[observed], class_id[observed]
    columns = (cells[:, 0].astype(np.int64), cells[:, 1:5], cells[:, 5], class_id)
    return _Rows("tracks", "the observed rows of a tracks.csv", *columns, is_rectified=True)


def _comma_rows(path: Path, default_class_id: int) -> _Rows:
    """Rows of numbers with commas between them and frame numbers in the first column; `#` starts a comment."""
    lines = _text(path).split("\n")
    if not any(line.partition("#")[0].strip() for line in lines):
        raise LabelFileError(f"{path}: expected detections, got only comments.")
    try:
        table = np.loadtxt(lines, delimiter=",", ndmin=2)
    except ValueError as error:
        raise _fault(path, lines) from error
    if not are_integers(table[:, 0], -MAX_FRAME - 1, MAX_FRAME + 1):  # MOTChallenge counts from 1
        raise LabelFileError(f"{path}: expected integers up to {MAX_FRAME} as frame numbers.")
    frame, class_id = table[:, 0].astype(np.int64), np.full(len(table), default_class_id, np.int64)
    name, n_columns = ROAD_CLASSES[default_class_id], table.shape[1]
    if n_columns == 6:
        description = f"rows frame,x1,y1,x2,y2,score of class {name}"
        return _Rows("rrc", description, frame, table[:, 1:5], table[:, 5], class_id)
    if not 7 <= n_columns <= 10:
        raise LabelFileError(
            f"{path}: expected 7 to 10 columns frame,id,x,y,w,h,score,... (MOTChallenge) or 6 columns "
            f"frame,x1,y1,x2,y2,score, got {n_columns}."
        )
    score = np.where(table[:, 6] == -1, 1.0, table[:, 6])  # -1 = no score in MOTChallenge
    descriptor = _descriptors(path, table)
    with_embeddings = "" if descriptor is None else f" with embeddings of {descriptor.shape[1]} numbers"
    description = f"MOTChallenge rows of class {name}{with_embeddings}"
    return _Rows("mot", description, frame - 1, xyxy_from_mot(table[:, 2:6]), score, class_id, descriptor)


def _text(path: Path) -> str:
    return read_text(path, LabelFileError, "detections", max_bytes=MAX_TABLE_BYTES)


def _fault(path: Path, lines: list[str]) -> LabelFileError:
    """An error about the first line that is not as many numbers as the first one has."""
    n_cells = 0
    for line, text in enumerate(lines, start=1):
        cells = text.partition("#")[0].split(",")
        if not any(map(str.strip, cells)):
            continue
        n_cells = n_cells or len(cells)
        invalid = next((cell for cell in cells if math.isnan(number(cell)) and "nan" not in cell.lower()), None)
        given = f"{len(cells)} cells" if invalid is None else quoted(invalid.strip())
        if invalid is not None or len(cells) != n_cells:
            return LabelFileError(f"{path}, line {line}: expected {n_cells} numbers between commas, got {given}.")
    return LabelFileError(f"{path}: expected rows of comma-separated numbers, all of the same length.")


def _descriptors(path: Path, table: FloatArray) -> Descriptors | None:
    """(N, D) float32 embeddings from the feat.npy in the folder of `path`; None if there is no such file."""
    features_path = path.with_name("feat.npy")
    if not os.path.lexists(features_path):
        return None
    features = np.asarray(read_array(features_path, LabelFileError, f"embeddings of {path.name}"), np.float64)
    n_columns = table.shape[1]
    if features.ndim != 2 or features.shape[0] != len(table) or features.shape[1] <= n_columns:
        raise LabelFileError(
            f"{features_path}: expected {len(table)} rows as in {path.name}, each with {n_columns} numbers and an "
            f"embedding, got shape {features.shape}."
        )
    if not np.allclose(features[:, :6], table[:, :6], atol=0.01) or not (np.abs(features) <= _MAX_FEATURE).all():
        raise LabelFileError(
            f"{features_path}: expected finite numbers up to {_MAX_FEATURE:g} and the same boxes as in {path.name}."
        )
    return features[:, n_columns:].astype(np.float32)


def _as_probability(score: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    """Scores in [0, 1], and a note if the sigmoid was applied because some were outside of this range."""
    known = score[np.isfinite(score)]
    if not len(known) or (known.min() >= 0 and known.max() <= 1):
        return score, ()
    probability = np.where(np.isfinite(score), 1.0 / (1.0 + np.exp(-np.clip(score, -50, 50))), np.nan)
    span = f"{known.min():.2f} to {known.max():.2f}"
    return probability, (f"Scores from {span} were converted to probabilities with the sigmoid (0 becomes 0.5).",)
