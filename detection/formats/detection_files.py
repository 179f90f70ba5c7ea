"""Reader of files with recorded detections.

The format is recognised from the content: KITTI, rows of numbers (`video_labels.mot`:
MOTChallenge's det.txt, plain `frame,x1,y1,x2,y2,score` (RRC) and others), track-range's tracks.csv,
or one of `label_formats`. A feat.npy next to a MOTChallenge file has the same rows, each with an
appended embedding (the format of nwojke/deep_sort).
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from track_range.detection.boxes import are_valid_boxes
from track_range.detection.classes import ROAD_CLASSES, map_to_road_classes
from track_range.detection.detections import Descriptors, Detections
from track_range.detection.detector import without_confused
from track_range.detection.formats.label_formats import is_blank, label_format_of
from track_range.detection.formats.tables.box_table import NO_FACTS, VideoFacts
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.limits import MAX_FRAME, are_plausible_boxes
from track_range.detection.formats.tables.table_checks import (
    first_frame_number,
    names_with_counts,
)
from track_range.detection.formats.video_labels.mot import mot_rows
from track_range.detection.formats.video_labels.number_rows import read_number_rows
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.files.array_files import read_array
from track_range.foundation.files.input_files import MAX_TABLE_BYTES, read_text

_MAX_FEATURE = 1e15  # of an embedding: sums of squares do not overflow in float32
_MAX_SCORE = 1e6  # scores are probabilities, or margins of a few units
# largest of scores that are read as per cent; margins hardly reach 10
_MIN_PER_CENT, _MAX_PER_CENT = 10, 100
_MAX_INVALID = 0.5  # fraction of invalid rows above which a file has another format
# rrc: plain rows; tracks: a tracks.csv
DetectionFormat = Literal["mot", "kitti", "rrc", "tracks", "labels"]
_FORM_OF: Mapping[str, DetectionFormat] = {"kitti": "kitti", "tracks": "tracks"}
_DESCRIPTION_OF = {"kitti": "KITTI rows", "tracks": "the observed rows of a tracks.csv"}


class _Rows(NamedTuple):
    """All N rows of a file, including rows without a valid frame number, box, score or road
    class.
    """

    form: DetectionFormat
    description: str
    frame: IntArray
    xyxy_px: FloatArray
    score: FloatArray
    class_id: IntArray
    class_name: npt.NDArray[np.str_]
    descriptor: Descriptors | None = None
    notes: tuple[str, ...] = ()
    is_rectified: bool = False
    has_classes: bool = True


@dataclass(frozen=True, slots=True)
class RecordedDetections:
    """The N detections of a video."""

    frame: IntArray  # (N,) frame number from 0, ascending
    detections: Detections  # the N boxes in the same order
    form: DetectionFormat  # format of the file
    notes: tuple[str, ...]  # notes for the user on the recognised format and on dropped rows
    # whether the boxes are in rectified pixels, not in pixels of the original video
    is_rectified: bool = False
    has_classes: bool = False  # whether the file has a class for each box

    def at(self, frame_index: int) -> Detections:
        """The detections of one frame, with one class for each object."""
        first, last = np.searchsorted(self.frame, [frame_index, frame_index + 1])
        return without_confused(self.detections.select(np.arange(first, last)))


def read_detections(
    path: Path,
    *,
    default_class_id: int = 0,
    form: DetectionFormat | None = None,
    video: VideoFacts = NO_FACTS,
) -> RecordedDetections:
    """The detections in a file, or in a folder with a file for each image; an empty file has no
    boxes.

    `default_class_id` is the class of boxes in formats without classes (MOTChallenge and plain
    rows), `form` the expected format (None = any), and `video` has the known number of images and
    their size, which YOLO labels need. Raises LabelFileError if the file cannot be read, its format
    is unknown or not `form`, or most rows are invalid.
    """
    if is_blank(path, "detections") and not _text(path).strip():
        notes = [f"Read {path.name}: 0 boxes.", f"{path.name} is empty: there are no boxes."]
        return RecordedDetections(
            np.zeros(0, np.int64), Detections.empty(), form or "rrc", notes=tuple(notes)
        )
    rows = _rows(path, default_class_id, video, form)
    if form not in (None, rows.form):
        raise LabelFileError(
            f"{path}: expected the format {form}, got {rows.form} ({rows.description})."
        )
    score, score_note = _as_probability(
        np.where(np.abs(rows.score) <= _MAX_SCORE, rows.score, np.nan)
    )
    is_valid = (
        are_valid_boxes(rows.xyxy_px) & are_plausible_boxes(rows.xyxy_px) & np.isfinite(score)
    )
    is_valid &= rows.frame >= 0
    is_road = rows.class_id >= 0
    if (n_invalid := np.count_nonzero(~is_valid)) > _MAX_INVALID * len(is_valid):
        raise LabelFileError(
            f"{path}: expected valid boxes in rows read as {rows.description}, found {n_invalid} "
            f"of {len(is_valid)} rows invalid; check the columns and their order."
        )
    if np.any(rows.frame > MAX_FRAME):
        raise LabelFileError(
            f"{path}: expected frame numbers up to {MAX_FRAME}, got {rows.frame.max()}."
        )
    order = np.flatnonzero(is_valid & is_road)
    order = order[np.argsort(rows.frame[order], kind="stable")]
    notes = [f"Read {path.name} as {rows.description}: {len(order)} boxes."]
    if len(order) < len(rows.frame):
        n_dropped, others = (
            len(rows.frame) - len(order),
            names_with_counts(rows.class_name[~is_road]),
        )
        suffix = f"; other classes: {others}" if others else ""
        notes.append(
            f"{path.name}: ignored {n_dropped} rows that are not a valid box of a road "
            f"class{suffix}."
        )
    detections = Detections.of(rows.xyxy_px[order], score[order], rows.class_id[order])
    if rows.descriptor is not None:
        detections = replace(detections, descriptor=rows.descriptor[order])
    frame = rows.frame[order]
    if rows.form in ("kitti", "labels") and first_frame_number(frame, 0, video.n_frames) == 1:
        frame = frame - 1
        notes.append(
            f"{path.name}: the last frame number is {video.n_frames}, the number of images, so "
            "frame numbers start at 1."
        )
    notes += [*rows.notes, *score_note]
    return RecordedDetections(
        frame, detections, rows.form, tuple(notes), rows.is_rectified, rows.has_classes
    )


def _rows(
    path: Path, default_class_id: int, video: VideoFacts, form: DetectionFormat | None
) -> _Rows:
    label_format = label_format_of(path, "detections")
    if label_format.name == "mot":
        return _number_rows(path, default_class_id, video, form)
    table = label_format.read(path, video)
    table = table.select(table.observed)  # as of tracks.csv
    return _Rows(
        _FORM_OF.get(label_format.name, "labels"),
        _DESCRIPTION_OF.get(label_format.name, label_format.title),
        frame=table.frame,
        xyxy_px=table.xyxy_px,
        score=np.where(np.isnan(table.score), 1.0, table.score),
        class_id=table.class_id,
        class_name=np.where(table.is_region, "", table.class_name),
        notes=table.notes,
        is_rectified=table.video.is_rectified,
    )


def _number_rows(
    path: Path, default_class_id: int, video: VideoFacts, form: DetectionFormat | None
) -> _Rows:
    """Rows of numbers; rows without a class get the default class."""
    table = read_number_rows(path, LabelFileError, "detections")
    if not table.lines:
        raise LabelFileError(f"{path}: expected detections, got only comments.")
    rows = mot_rows(table, n_frames=video.n_frames, form=form, names=video.names)
    names = rows.class_name
    is_named = np.array([name != "" for name in names], np.bool_)
    class_id = np.where(is_named & ~rows.is_region, map_to_road_classes(names), -1)
    class_id[~is_named] = default_class_id
    descriptor = _descriptors(path, table.values, int(table.n_columns[0]))
    default = "" if is_named.any() else f" of class {ROAD_CLASSES[default_class_id]}"
    with_embeddings = (
        "" if descriptor is None else f" with embeddings of {descriptor.shape[1]} numbers"
    )
    score = np.where(rows.score == -1, 1.0, rows.score)  # -1 = no score in MOTChallenge
    form_found: DetectionFormat = "rrc" if rows.form == "rrc" else "mot"
    description = f"{rows.title}{default}{with_embeddings}"
    return _Rows(
        form_found,
        description,
        frame=rows.frame,
        xyxy_px=rows.xyxy_px,
        score=score,
        class_id=class_id,
        class_name=np.array(names, np.str_),
        descriptor=descriptor,
        notes=rows.notes,
        has_classes=bool(is_named.any()),
    )


def _text(path: Path) -> str:
    return read_text(path, LabelFileError, "detections", max_bytes=MAX_TABLE_BYTES)


def _descriptors(path: Path, table: FloatArray, n_columns: int) -> Descriptors | None:
    """(N, D) float32 embeddings from the feat.npy in the folder of `path`; None if there is no such
    file.
    """
    features_path = path.with_name("feat.npy")
    if not os.path.lexists(features_path):
        return None
    features = np.asarray(
        read_array(features_path, LabelFileError, f"embeddings of {path.name}"), np.float64
    )
    if features.ndim != 2 or features.shape[0] != len(table) or features.shape[1] <= n_columns:
        raise LabelFileError(
            f"{features_path}: expected {len(table)} rows as in {path.name}, each with {n_columns} "
            f"numbers and an embedding, got shape {features.shape}."
        )
    if (
        not np.allclose(features[:, :6], table[:, :6], atol=0.01)
        or not (np.abs(features) <= _MAX_FEATURE).all()
    ):
        raise LabelFileError(
            f"{features_path}: expected finite numbers up to {_MAX_FEATURE:g} and the same boxes "
            f"as in {path.name}."
        )
    return features[:, n_columns:].astype(np.float32)


def _as_probability(score: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    """Scores in [0, 1], and a note if they were converted from per cent or with the sigmoid."""
    known = score[np.isfinite(score)]
    if not len(known) or (known.min() >= 0 and known.max() <= 1):
        return score, ()
    span = f"{known.min():.2f} to {known.max():.2f}"
    if known.min() >= 0 and _MIN_PER_CENT < known.max() <= _MAX_PER_CENT:
        return score / 100, (f"Scores from {span} were read as per cent.",)
    probability = np.where(
        np.isfinite(score), 1.0 / (1.0 + np.exp(-np.clip(score, -50, 50))), np.nan
    )
    return probability, (
        f"Scores from {span} were converted to probabilities with the sigmoid (0 becomes 0.5).",
    )
