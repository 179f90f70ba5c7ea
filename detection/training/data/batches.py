"""Batches of training images, made in background threads and reproducible for a seed, epoch and
position.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import torch
from torch import Tensor

from track_range.detection.training.data.augmentation import (
    AugmentationSettings,
    LabelledPixels,
    mosaic,
    single,
)
from track_range.detection.training.data.data_set import LabelledSet
from track_range.detection.training.losses.assignment import LabelledObjects
from track_range.detection.training.losses.detection_loss import Batch, Completeness
from track_range.foundation.arrays import IntArray

_N_AHEAD = 3  # batches that are made in advance


class BatchMaker:
    """Generator of training batches, which depend only on the seed, the epoch and the position in
    the epoch.
    """

    def __init__(
        self, images: LabelledSet, *, size_px: int, batch_size: int, seed: int, n_workers: int = 2
    ) -> None:
        self._images, self._size_px, self._batch_size = images, size_px, batch_size
        self._seed, self._n_workers = seed, n_workers

    def __len__(self) -> int:
        """Number of batches per epoch; the last batch may be smaller, and is left out if it has a
        single image.
        """
        whole, rest = divmod(len(self._images), self._batch_size)
        return max(whole + (rest > 1), 1)

    def epoch(self, number: int, settings: AugmentationSettings) -> Iterator[Batch]:
        """The batches of one epoch."""
        order = np.random.default_rng((self._seed, number)).permutation(len(self._images))
        chunks = [order[i : i + self._batch_size] for i in range(0, len(order), self._batch_size)]
        chunks = chunks[: len(self)]  # the statistics of batch norm need more than one image
        with ThreadPoolExecutor(self._n_workers) as makers, ThreadPoolExecutor(1) as gatherer:
            waiting: list[Future[Batch]] = []
            remaining: Iterator[IntArray] = iter(chunks)
            try:
                for chunk in remaining:
                    parts = [
                        makers.submit(self._sample, number, int(index), settings) for index in chunk
                    ]
                    waiting.append(gatherer.submit(self._gathered, parts))
                    if len(waiting) > _N_AHEAD:
                        yield waiting.pop(0).result()
                while waiting:
                    yield waiting.pop(0).result()
            finally:
                for future in waiting:
                    future.cancel()
                makers.shutdown(wait=False, cancel_futures=True)

    def _sample(self, epoch: int, index: int, settings: AugmentationSettings) -> LabelledPixels:
        rng = np.random.default_rng((self._seed, epoch, index))
        if rng.random() >= settings.mosaic:
            return single(self._images.load(index), self._size_px, settings, rng)
        others = rng.integers(0, len(self._images), 3)
        sources = [self._images.load(int(i)) for i in (index, *others)]
        return mosaic([sources[i] for i in rng.permutation(4)], self._size_px, settings, rng)

    def _gathered(self, parts: Sequence[Future[LabelledPixels]]) -> Batch:
        samples = [part.result() for part in parts]
        images = torch.from_numpy(np.stack([sample.image for sample in samples])).permute(
            0, 3, 1, 2
        )
        complete = torch.from_numpy(np.stack([sample.is_complete for sample in samples]))
        meeting = torch.from_numpy(
            np.stack([sample.meeting_xy for sample in samples]).astype(np.float32)
        )
        xyxy, class_index, is_ignored, confidence = (
            np.concatenate([getattr(sample, name) for sample in samples])
            for name in ("xyxy", "class_index", "is_ignored", "confidence")
        )
        cxcywh = np.concatenate(
            [(xyxy[:, :2] + xyxy[:, 2:]) / 2, xyxy[:, 2:] - xyxy[:, :2]], axis=1
        )
        image = np.repeat(np.arange(len(samples)), [len(sample.class_index) for sample in samples])
        columns = (
            image,
            class_index,
            cxcywh.astype(np.float32),
            is_ignored,
            confidence.astype(np.float32),
        )
        return Batch(
            images,
            LabelledObjects(*map(torch.from_numpy, columns)),
            Completeness(complete, meeting),
        )


def scaled(images: Tensor) -> Tensor:
    """(B, 3, H, W) float32 images in 0..1, the input of networks, from uint8 images."""
    return images.float() / 255
