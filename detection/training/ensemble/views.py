"""Boxes of the detectors of an ensemble in an image and in its mirror image, stored by image to
resume a run.
"""

import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from track_range.detection.classes import ROAD_CLASSES, fully_known
from track_range.detection.detector import ObjectDetector
from track_range.detection.formats.image_labels.labelled_images import ImageFileError, read_image
from track_range.detection.models.onnx_session import Runtime
from track_range.detection.training.errors import TrainingError
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.foundation.arrays import (
    BoolArray,
    FloatArray,
    FloatArray32,
    Image,
    IntArray,
    check_shape,
)
from track_range.foundation.files.array_files import read_array
from track_range.foundation.files.atomic_files import atomic_path, writable
from track_range.foundation.files.input_files import real_path

N_VIEWS = 2  # the image and its mirror image
MIN_SCORE = 0.02  # lowest score of the boxes; low, since calibration decides what the scores mean
# of non-maximum suppression, and boxes per view; the fusion merges the rest
_MAX_IOU, _MAX_BOXES = 0.6, 200
_MIN_SIDE_PX = 2.0  # of a box in pixels of the image
_N_COLUMNS = 6  # of stored boxes: xyxy, score, class_id


@dataclass(frozen=True, slots=True)
class ViewBoxes:
    """The N boxes of one detector in both views of an image."""

    # (N, 4) left, top, right, bottom as fractions of the size of the image that is not mirrored
    xyxy: FloatArray
    score: FloatArray  # (N,) confidence in [0, 1]
    class_id: IntArray  # (N,) road class

    def __post_init__(self) -> None:
        check_shape("xyxy", self.xyxy, (len(self.score), 4))
        check_shape("score", self.score, (None,))
        check_shape("class_id", self.class_id, (len(self.score),))


def detect_views(detector: ObjectDetector, image: Image) -> ViewBoxes:
    """The boxes of a detector in `image`, (H, W, 3) uint8 BGR, and in its mirror image."""
    height, width = image.shape[:2]
    size_px = np.array([width, height, width, height], np.float64)
    views = [detector.detect(image), detector.detect(np.ascontiguousarray(image[:, ::-1]))]
    xyxy, mirrored = [(boxes.xyxy_px + 0.5) / size_px for boxes in views]
    mirrored[:, [0, 2]] = 1.0 - mirrored[:, [2, 0]]
    both = np.concatenate([xyxy, mirrored])
    is_large = ((both[:, 2:] - both[:, :2]) * size_px[:2] >= _MIN_SIDE_PX).all(axis=1)
    score, class_id = (
        np.concatenate([getattr(boxes, key) for boxes in views]) for key in ("score", "class_id")
    )
    return ViewBoxes(both[is_large], score[is_large], class_id[is_large])


class EnsembleMember:
    """One detector of an ensemble, and the folder of its boxes."""

    def __init__(
        self,
        path: Path,
        stored: Path,
        *,
        size_px: int | None = None,
        runtime: Runtime | None = None,
    ) -> None:
        """Load the network of the ONNX file `path`; `stored` is the folder for the boxes of all
        members.

        `size_px` is the longer side of a network's input of variable size; None = the size in the
        model file, else 640.
        """
        settings = YoloSettings(
            min_score=MIN_SCORE, max_iou=_MAX_IOU, max_boxes=_MAX_BOXES, size_px=size_px
        )
        self._detector = YoloDetector(path, settings, runtime=runtime)
        # (8,) not only a kind of them
        self.is_known: BoolArray = fully_known(self._detector.model.names)
        # boxes of another network or input size belong to another member
        size = "default" if size_px is None else f"{size_px}"
        self._folder = stored / f"{path.stem}-{self._detector.session.sha256()[:12]}-{size}"

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user on the model and on dropped boxes."""
        return self._detector.notes

    def has_boxes(self, image_file: Path) -> bool:
        """Whether the boxes of an image are stored."""
        return self._file(image_file).is_file()

    def store_boxes(self, image_file: Path, image: Image) -> None:
        """Run the detector on both views of an image, and store the boxes; TrainingError if they
        cannot be written.
        """
        boxes = detect_views(self._detector, image)
        rows = np.column_stack([boxes.xyxy, boxes.score, boxes.class_id]).astype(np.float32)
        file = self._file(image_file)
        with writable(file, TrainingError):
            file.parent.mkdir(parents=True, exist_ok=True)
            with atomic_path(file, is_flushed=False) as partial:
                np.save(partial, rows)

    def boxes(self, image_file: Path) -> ViewBoxes:
        """The stored boxes of an image; TrainingError if they were not stored, or the file is
        damaged.
        """
        file = self._file(image_file)
        rows: FloatArray32 = read_array(file, TrainingError, "the boxes of a detector")
        is_valid = rows.ndim == 2 and rows.shape[1] == _N_COLUMNS and np.isfinite(rows).all()
        if not is_valid or not np.isin(rows[:, 5], np.arange(len(ROAD_CLASSES))).all():
            raise TrainingError(
                f"{file}: expected the boxes of a detector, found other numbers; remove this file."
            )
        numbers = rows.astype(np.float64)
        return ViewBoxes(numbers[:, :4], numbers[:, 4], rows[:, 5].astype(np.int64))

    def _file(self, image_file: Path) -> Path:
        """The file of an image's boxes; its name contains the image's size and date, since images
        may be replaced.
        """
        version = ""
        with suppress(OSError):  # else the image cannot be read either
            stat = image_file.stat()
            version = f"{stat.st_size} {stat.st_mtime_ns}"
        identity = f"{real_path(image_file)} {version}"
        return self._folder / f"{image_file.stem}-{zlib.crc32(identity.encode()):08x}.npy"


def store_missing(
    image_files: Sequence[Path],
    members: Sequence[EnsembleMember],
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[Path, str]:
    """Run the detectors on the images whose boxes are not stored; returns the reason for each
    unreadable image.

    `progress` is called after each image with their number and total. ImageFileError: none of the
    images can be read.
    """
    unreadable: dict[Path, str] = {}
    for done, file in enumerate(image_files, start=1):
        missing = [member for member in members if not member.has_boxes(file)]
        if missing:
            try:
                image = read_image(file)
            except ImageFileError as error:
                unreadable[file] = str(error)
            else:
                for member in missing:
                    member.store_boxes(file, image)
        progress(done, len(image_files))
    if len(unreadable) == len(image_files):
        first = next(iter(unreadable.values()), "")
        raise ImageFileError(
            f"none of the {len(image_files)} images can be read; the first: {first}"
        )
    return unreadable
