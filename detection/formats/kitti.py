"""KITTI's label and detection files as parallel arrays.

One row per object, separated by blanks. Tracking files hold a whole sequence, object files one image each:
    tracking: frame id TYPE truncated occluded alpha x1 y1 x2 y2 h w l X Y Z rotation_y [score]
    object:            TYPE truncated occluded alpha x1 y1 x2 y2 h w l X Y Z rotation_y [score]
x1 .. y2 are 0-based pixels; h w l the size and X Y Z the bottom centre of the 3-D box in metres, in the frame of the
rectified reference camera (camera 0). A detection file says -1 or -1000 for what it does not know.
(Geiger et al., "Are we ready for autonomous driving?", CVPR 2012, and the development kit's readme.)
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.errors import UserError

_TRACKING_COLUMNS = 17
_OBJECT_COLUMNS = 15


class LabelFileError(UserError):
    """A label or detection file that cannot be read; the message names file, line and what was wanted."""


@dataclass(frozen=True, slots=True)
class KittiLabels:
    """Rows of a KITTI file in file order.

    Attributes:
        frame: (N,) int64 frame number, from 0.
        track_id: (N,) int64 as in the file; -1 = DontCare or a detection.
        kitti_type: (N,) str, such as Car, Van, DontCare.
        truncated: (N,) share outside the image (object files) or 0, 1, 2 (tracking files); -1 = unknown.
        occluded: (N,) 0 = fully visible, 1 = partly, 2 = largely hidden, 3 = unknown; -1 = unknown.
        xyxy_px: (N, 4) box.
        size_hwl_m: (N, 3) height, width, length; <= 0 where unknown.
        location_m: (N, 3) bottom centre in the reference camera's frame.
        rotation_y_rad: (N,) yaw about the camera's y axis.
        score: (N,) as in the file; NaN where it has none.
    """

    frame: IntArray
    track_id: IntArray
    kitti_type: npt.NDArray[np.str_]
    truncated: FloatArray
    occluded: IntArray
    xyxy_px: FloatArray
    size_hwl_m: FloatArray
    location_m: FloatArray
    rotation_y_rad: FloatArray
    score: FloatArray

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, keep: BoolArray | IntArray) -> KittiLabels:
        """The rows that a mask or an index array names."""
        return KittiLabels(*(getattr(self, field.name)[keep] for field in fields(self)))

    @property
    def has_3d_box(self) -> BoolArray:
        """(N,) which rows have a 3-D box."""
        return np.asarray((self.size_hwl_m > 0).all(axis=1) & (self.location_m > -999).all(axis=1))


def read_kitti(path: Path) -> KittiLabels:
    """Read a tracking file, or a folder of object files (000000.txt, 000001.txt, ...: the number is the frame).

    Raises:
        LabelFileError: nothing there, or a row that is no KITTI row.
    """
    if path.is_dir():
        return _read_folder(path)
    rows = [row for row in _rows(path) if row[1]]
    if not rows:
        raise LabelFileError(f"{path}: the file is empty; KITTI labels wanted.")
    return _labels([_numbered(path, line, words, n_found=len(words)) for line, words in rows])


def _read_folder(folder: Path) -> KittiLabels:
    files = sorted(file for file in folder.glob("*.txt") if file.stem.isdigit())
    if not files:
        raise LabelFileError(f"{folder}: no label files such as 000000.txt in this folder.")
    return _labels([row for file in files for row in _object_rows(file, frame=file.stem)])


def read_kitti_image(path: Path) -> KittiLabels:
    """Read the object labels of one image, which may be none; they get the frame number 0.

    Raises:
        LabelFileError: unreadable, or a row that is no KITTI object row.
    """
    return _labels(_object_rows(path, frame="0"))


def _object_rows(path: Path, *, frame: str) -> list[tuple[str, list[float]]]:
    rows = [row for row in _rows(path) if row[1]]
    return [_numbered(path, line, [frame, "-1", *words], n_found=len(words)) for line, words in rows]


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise LabelFileError(f"{path}: cannot be read ({error.strerror or error}).") from error
    except UnicodeDecodeError as error:
        raise LabelFileError(f"{path}: not a text file; KITTI labels wanted.") from error
    return [(number, line.split()) for number, line in enumerate(text.splitlines(), 1)]


def _numbered(path: Path, line: int, words: list[str], *, n_found: int) -> tuple[str, list[float]]:
    """Type and the other columns as numbers, score NaN where there is none."""
    if len(words) not in (_TRACKING_COLUMNS, _TRACKING_COLUMNS + 1):
        raise LabelFileError(
            f"{path}, line {line}: {_TRACKING_COLUMNS} columns (18 with a score) of KITTI's tracking format wanted, "
            f"or {_OBJECT_COLUMNS} (16) of object labels, one file per image in a folder; found {n_found}."
        )
    try:
        numbers = [float(word) for word in (*words[:2], *words[3:])]
    except ValueError as error:
        raise LabelFileError(f"{path}, line {line}: a number wanted ({error}).") from error
    if not np.isfinite(numbers).all() or numbers[0] < 0:
        raise LabelFileError(f"{path}, line {line}: finite numbers and a frame from 0 wanted.")
    return words[2], numbers if len(numbers) == _TRACKING_COLUMNS else [*numbers, np.nan]


def _labels(rows: list[tuple[str, list[float]]]) -> KittiLabels:
    table = np.array([numbers for _, numbers in rows], np.float64).reshape(-1, _TRACKING_COLUMNS)
    return KittiLabels(
        frame=table[:, 0].astype(np.int64),
        track_id=table[:, 1].astype(np.int64),
        kitti_type=np.array([kitti_type for kitti_type, _ in rows], np.str_),
        truncated=table[:, 2],
        occluded=table[:, 3].astype(np.int64),
        xyxy_px=table[:, 5:9],
        size_hwl_m=table[:, 9:12],
        location_m=table[:, 12:15],
        rotation_y_rad=table[:, 15],
        score=table[:, 16],
    )
