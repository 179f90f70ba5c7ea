"""Sets of labelled images: the protocols that training uses, and a set that caches images in
memory.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.detection.formats.image_labels.labelled_images import (
    ImageFileError,
    LabelledImage,
    read_image,
)
from track_range.detection.training.data.augmentation import LabelledPixels
from track_range.foundation.arrays import FloatArray, Image, IntArray

_MEMORY_FRACTION = 0.5  # of the free memory, for cached images
_UNKNOWN_MEMORY_BYTES = 2 << 30  # size of the cache if the free memory is unknown
_N_READERS = 4  # threads that read images


class LabelledSet(Protocol):
    """Labelled images by index."""

    def __len__(self) -> int: ...

    def load(self, index: int) -> LabelledPixels:
        """Image and labels with an index."""


class ValidationSet(Protocol):
    """Images with their ground truth."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[tuple[Image, ImageTruth]]: ...


@dataclass(frozen=True, slots=True)
class TrainingSets:
    """Data of a training run."""

    train: LabelledSet
    validation: ValidationSet
    road_class_id: IntArray  # (C,) road class of each of the network's classes
    name: str = ""  # identifier of the data, to recognise it when a run is resumed


class CachedImages:
    """Labelled images, cached in memory while there is room; other images are read from disk each
    time.

    `unreadable`: one message for each image that could not be read and was left out.
    """

    def __init__(
        self,
        items: Sequence[LabelledImage],
        road_class_id: IntArray,
        *,
        max_side_px: int | None = None,
        max_bytes: int | None = None,
        progress: Callable[[int, int], None] = lambda done, total: None,
    ) -> None:
        """Read every image once; ImageFileError if none can be read.

        `road_class_id` (C,) is the road class of each of the network's classes. Images are
        downscaled to the longer side `max_side_px`; None = no limit. `max_bytes` is the size of the
        cache; None = half of the free memory. `progress` is called after each image with the number
        of images read and their total.
        """
        self._road_class_id, self._max_side_px = road_class_id, max_side_px
        self._index_of = np.full(len(ROAD_CLASSES), -1)
        self._index_of[road_class_id] = np.arange(len(road_class_id))
        self._items: list[LabelledImage] = []
        self._cache: list[Image | None] = []
        self._scale: list[float] = []
        self.unreadable: list[str] = []
        room = _free_bytes() if max_bytes is None else max_bytes
        with ThreadPoolExecutor(_N_READERS) as readers:
            for done, (item, read) in enumerate(
                zip(items, readers.map(self._read, items), strict=True), start=1
            ):
                progress(done, len(items))
                if isinstance(read, str):
                    self.unreadable.append(read)
                    continue
                image, scale = read
                fits = image.nbytes <= room
                room -= image.nbytes if fits else 0
                self._items.append(item)
                self._cache.append(image if fits else None)
                self._scale.append(scale)
        if not self._items:
            raise ImageFileError(
                f"none of the {len(items)} images can be read; the first: {self.unreadable[0]}"
            )

    def __len__(self) -> int:
        return len(self._items)

    @property
    def n_cached(self) -> int:
        """Number of images in memory."""
        return sum(image is not None for image in self._cache)

    def load(self, index: int) -> LabelledPixels:
        """Image and labels with the network's classes; ImageFileError if it cannot be read
        again.
        """
        item = self._items[index]
        image = self._image(index)
        truth = item.truth_in(image) if item.is_normalised else item.truth
        known = truth.is_ignored | (self._index_of[truth.class_id] >= 0)
        return LabelledPixels(
            image,
            (truth.xyxy_px[known] + 0.5) * (1.0 if item.is_normalised else self._scale[index]),
            np.maximum(self._index_of[truth.class_id[known]], 0),
            truth.is_ignored[known],
            truth.confidence[known],
            np.broadcast_to(
                truth.is_complete[self._road_class_id], (2, 2, len(self._road_class_id))
            ),
        )

    def box_sizes_px(self, longer_side_px: int) -> FloatArray:
        """(N, 2) width and height of all boxes that are not ignored, with each image scaled to
        `longer_side_px`.
        """
        sizes = [np.zeros((0, 2))]
        for index in range(len(self)):
            item = self.load(index)
            boxes = item.xyxy[~item.is_ignored]
            sizes.append((boxes[:, 2:] - boxes[:, :2]) * longer_side_px / max(item.image.shape[:2]))
        return np.concatenate(sizes)

    def __iter__(self) -> Iterator[tuple[Image, ImageTruth]]:
        """Images and labels; only for sets without `max_side_px`."""
        for index, item in enumerate(self._items):
            image = self._image(index)
            yield image, item.truth_in(image)

    def _image(self, index: int) -> Image:
        image = self._cache[index]
        return self._scaled(read_image(self._items[index].path))[0] if image is None else image

    def _scaled(self, image: Image) -> tuple[Image, float]:
        """The image, downscaled to the largest side if necessary, and its scale."""
        scale = (
            1.0 if self._max_side_px is None else min(self._max_side_px / max(image.shape[:2]), 1.0)
        )
        if scale == 1.0:
            return image, scale
        height, width = (max(round(side * scale), 1) for side in image.shape[:2])
        return np.asarray(
            cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8
        ), scale

    def _read(self, item: LabelledImage) -> tuple[Image, float] | str:
        try:
            return self._scaled(read_image(item.path))
        except ImageFileError as error:
            return str(error)


def _free_bytes() -> int:
    """Size of the cache, from the free memory of Linux and the limit of the container."""
    known = []
    with suppress(OSError, ValueError, IndexError):
        line = next(
            line
            for line in Path("/proc/meminfo").read_text().splitlines()
            if line.startswith("MemAvailable")
        )
        known.append(1024 * int(line.split()[1]))
    with suppress(OSError, ValueError):  # "max" = no limit
        limit, used = (
            int(Path(f"/sys/fs/cgroup/memory.{name}").read_text()) for name in ("max", "current")
        )
        known.append(max(limit - used, 0))
    return int(min(known) * _MEMORY_FRACTION) if known else _UNKNOWN_MEMORY_BYTES
