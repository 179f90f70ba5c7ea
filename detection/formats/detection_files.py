"""Boxes of somebody's own detector, read from a file.

KITTI, MOTChallenge's det.txt, plain `frame,x1,y1,x2,y2,score` (RRC's), or our own tracks.csv: told from the content. A
feat.npy beside a MOTChallenge file, the same rows with a descriptor after each (nwojke/deep_sort's), is read with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from track_range.detection.boxes import are_valid_boxes
from track_range.detection.classes import ROAD_CLASSES, map_to_road_classes
from track_range.detection.detections import Descriptors, Detections
from track_range.detection.formats.kitti import LabelFileError, read_kitti
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.csv_tables import read_csv_table

_MOT_COLUMNS = range(7, 11)
_PLAIN_COLUMNS = 6
_FEATURES_NAME = "feat.npy"

MAX_FRAME = 1_000_000
"""Largest frame number accepted, counted from 0: nine hours at 30 Hz."""

_FAR_PX = 1e7
"""Edges further out are no image's."""

DetectionForm = Literal["mot", "kitti", "rrc", "tracks"]
"""MOTChallenge's rows, KITTI's, plain ones as RRC published them, or our own tracks.csv."""


@dataclass(frozen=True, slots=True)
class RecordedDetections:
    """Detections of a whole video, by frame.

    Attributes:
        frame: (N,) frame number from 0, ascending.
        detections: (N) boxes in the same order.
        form: of the file.
        notes: sentences for the user: what was recognised, what was dropped.
    """

    frame: IntArray
    detections: Detections
    form: DetectionForm
    notes: tuple[str, ...]

    @property
    def is_rectified(self) -> bool:
        """Whether the boxes are in rectified pixels, as our own tracks are, not in the video's own."""
        return self.form == "tracks"

    @property
    def names_classes(self) -> bool:
        """Whether the rows say what each box is."""
        return self.form in ("kitti", "tracks")

    def at(self, frame_index: int) -> Detections:
        """The detections of one frame; none where the file has none."""
        first, last = np.searchsorted(self.frame, [frame_index, frame_index + 1])
        return self.detections.select(np.arange(first, last))


def read_detections(path: Path, *, unnamed_class_id: int = 0, form: DetectionForm | None = None) -> RecordedDetections:
    """Read a file, or a folder of KITTI object files.

    Args:
        path: the file or folder.
        unnamed_class_id: class of every box where the format names none (MOT and plain boxes).
        form: what it must be; None = what it is.

    Raises:
        LabelFileError: it cannot be read, or is none of the formats, or not the one wanted.
    """
    file_format = _format_of(path)
    kind, frame, boxes = _FORMATS[file_format](path, unnamed_class_id)
    found = _form_of(file_format, kind)
    if form not in (None, found):
        raise LabelFileError(f"{path}: read as {kind}, that is the format {found}, not {form}.")
    score, score_note = _as_probability(boxes.score)
    near = (np.abs(np.nan_to_num(boxes.xyxy_px, nan=np.inf)) < _FAR_PX).all(axis=1)
    sound = are_valid_boxes(boxes.xyxy_px) & near & np.isfinite(score) & (boxes.class_id >= 0) & (frame >= 0)
    if np.any(frame > MAX_FRAME):
        raise LabelFileError(f"{path}: frame {frame.max()}: numbers up to {MAX_FRAME} wanted.")
    order = np.flatnonzero(sound)[np.argsort(frame[sound], kind="stable")]
    notes = [f"{path.name} read as {kind}: {len(order)} boxes."]
    if len(order) < len(frame):
        notes.append(f"{len(frame) - len(order)} rows of {path.name} are no box of a road class and were left out.")
    detections = Detections(boxes.xyxy_px, score, boxes.class_id, boxes.descriptor)
    return RecordedDetections(frame[order], detections.select(order), found, notes=(*notes, *score_note))


def _format_of(path: Path) -> str:
    if path.is_dir():
        return "kitti"
    try:
        with path.open(encoding="utf-8-sig") as file:
            first = next((line for line in file if line.strip()), "")
    except OSError as error:
        raise LabelFileError(f"{path}: cannot be read ({error.strerror or error}).") from error
    except UnicodeDecodeError as error:
        raise LabelFileError(f"{path}: not a text file; detections wanted.") from error
    if not first:
        raise LabelFileError(f"{path}: the file is empty; detections wanted.")
    if "," not in first:
        return "kitti"
    return "tracks" if first.startswith("frame,") else "comma"


def _form_of(file_format: str, kind: str) -> DetectionForm:
    if file_format != "comma":
        return "kitti" if file_format == "kitti" else "tracks"
    return "mot" if kind.startswith("MOT") else "rrc"


def _read_kitti(path: Path, _: int) -> tuple[str, IntArray, Detections]:
    labels = read_kitti(path)
    score = np.where(np.isfinite(labels.score), labels.score, 1.0)
    class_id = map_to_road_classes([str(name) for name in labels.kitti_type])
    return "KITTI rows", labels.frame, Detections.of(labels.xyxy_px, score, class_id)


def _read_comma(path: Path, unnamed_class_id: int) -> tuple[str, IntArray, Detections]:
    try:
        table = np.loadtxt(path, delimiter=",", ndmin=2, encoding="utf-8-sig")
    except ValueError as error:
        raise LabelFileError(f"{path}: rows of numbers separated by commas, all of one length, wanted.") from error
    number = table[:, 0]
    if not np.all((np.abs(number) <= MAX_FRAME + 1) & (np.rint(number) == number)):  # NaN fails too; MOT counts from 1
        raise LabelFileError(f"{path}: frames must be whole numbers up to {MAX_FRAME}.")
    class_id = np.full(len(table), unnamed_class_id)
    name = ROAD_CLASSES[unnamed_class_id]
    if table.shape[1] == _PLAIN_COLUMNS:
        boxes = Detections.of(table[:, 1:5], table[:, 5], class_id)
        return f"rows frame,x1,y1,x2,y2,score of class {name}", table[:, 0].astype(np.int64), boxes
    if table.shape[1] not in _MOT_COLUMNS:
        raise LabelFileError(
            f"{path}: {table.shape[1]} columns; MOTChallenge's frame,id,x,y,w,h,score,... (7 to 10), "
            "or frame,x1,y1,x2,y2,score (6) wanted."
        )
    score = np.where(table[:, 6] == -1, 1.0, table[:, 6])  # -1 is MOTChallenge's "no score"
    boxes = Detections(xyxy_from_mot(table[:, 2:6]), score, class_id.astype(np.int64), _descriptors(path, table))
    with_looks = f" with descriptors of {boxes.descriptor.shape[1]} numbers" if boxes.descriptor.shape[1] else ""
    return f"MOTChallenge rows of class {name}{with_looks}", table[:, 0].astype(np.int64) - 1, boxes


def _descriptors(path: Path, table: FloatArray) -> Descriptors:
    """(N, D) float32 from the feat.npy beside, of any length; D = 0 where there is none.

    Raises:
        LabelFileError: it is there, but its rows are not those of the file.
    """
    beside = path.with_name(_FEATURES_NAME)
    if not beside.is_file():
        return np.zeros((len(table), 0), np.float32)
    try:
        features = np.asarray(np.load(beside, allow_pickle=False), np.float64)
    except (OSError, ValueError, EOFError) as error:
        raise LabelFileError(f"{beside}: not an array of numbers ({type(error).__name__}).") from error
    n_columns = table.shape[1]
    if features.ndim != 2 or features.shape[0] != len(table) or features.shape[1] <= n_columns:
        raise LabelFileError(
            f"{beside}: {len(table)} rows of {n_columns} numbers and a descriptor wanted, as in {path.name}; "
            f"{features.shape} got."
        )
    if not np.allclose(features[:, :6], table[:, :6], atol=0.01) or not np.isfinite(features).all():
        raise LabelFileError(f"{beside}: its rows are not those of {path.name}, or are no numbers.")
    return features[:, n_columns:].astype(np.float32)


def xyxy_from_mot(ltwh: FloatArray) -> FloatArray:
    """(N, 4) MOTChallenge boxes (left and top counted from 1, width, height) -> our pixels, counted from 0."""
    left_top = ltwh[:, :2] - 1.0
    return np.concatenate([left_top, left_top + ltwh[:, 2:]], axis=1)


def _read_tracks_csv(path: Path, _: int) -> tuple[str, IntArray, Detections]:
    expected = ("frame", "x1_px", "y1_px", "x2_px", "y2_px", "score", "observed")
    table = read_csv_table(path, LabelFileError, f"columns {', '.join(expected)}, class")
    table.require((*expected, "class"))
    cells = np.stack([table.finite(name) for name in expected], axis=1)
    class_id = map_to_road_classes(table.texts("class"))
    observed = cells[:, 6] == 1
    return (
        "the observed rows of a tracks.csv",
        cells[observed, 0].astype(np.int64),
        Detections.of(cells[observed, 1:5], cells[observed, 5], class_id[observed]),
    )


_FORMATS = {"kitti": _read_kitti, "comma": _read_comma, "tracks": _read_tracks_csv}


def _as_probability(score: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    """Scores in [0, 1]; raw detector margins, which know no bounds, go through a logistic, and a note says so."""
    known = score[np.isfinite(score)]
    if not len(known) or (known.min() >= 0 and known.max() <= 1):
        return score, ()
    squashed = np.where(np.isfinite(score), 1.0 / (1.0 + np.exp(-np.clip(score, -50, 50))), np.nan)
    span = f"{known.min():.2f} .. {known.max():.2f}"
    return squashed, (f"Scores of {span} are no probabilities: taken through a logistic (0 becomes 0.5).",)
