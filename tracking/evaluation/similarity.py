"""Similarity: the IoU of truth and result boxes in each frame of a sequence.

All metrics are computed from it, so that they count the same boxes; identities are numbered from 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from track_range.detection.boxes import iou
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.tracking.evaluation.tracked_boxes import TrackedBoxes


@dataclass(frozen=True, slots=True)
class Similarity:
    """IoU of the boxes of one sequence."""

    truth_count: IntArray  # (T,) number of frames with each truth identity
    result_count: IntArray  # (R,) number of frames with each result identity
    # for each frame with a box, truth identities (n,), result identities (m,) and their IoU (n, m)
    by_frame: tuple[tuple[IntArray, IntArray, FloatArray], ...]

    @classmethod
    def of(cls, truth: TrackedBoxes, results: TrackedBoxes) -> Similarity:
        """The similarity of one sequence's boxes, after the benchmark's rules; the IoU of different classes is 0."""
        truth, results = _sorted(truth), _sorted(results)
        truth_id, truth_count = _numbered(truth.track_id)
        result_id, result_count = _numbered(results.track_id)
        frames = np.union1d(truth.frame, results.frame)
        starts = [np.searchsorted(boxes.frame, frames) for boxes in (truth, results)]
        ends = [np.searchsorted(boxes.frame, frames, side="right") for boxes in (truth, results)]
        by_frame = tuple(
            (truth_id[a:b], result_id[c:d], _iou(truth.select(slice(a, b)), results.select(slice(c, d))))
            for a, b, c, d in zip(starts[0], ends[0], starts[1], ends[1], strict=True)
        )
        return cls(truth_count, result_count, by_frame)

    @property
    def n_truth(self) -> int:
        """Number of truth boxes."""
        return int(self.truth_count.sum())

    @property
    def n_results(self) -> int:
        """Number of result boxes."""
        return int(self.result_count.sum())

    def frames(self) -> Iterator[tuple[IntArray, IntArray, FloatArray]]:
        """Truth identities, result identities and their IoU, frame by frame."""
        return iter(self.by_frame)


def _iou(truth: TrackedBoxes, results: TrackedBoxes) -> FloatArray:
    """(n, m) IoU, 0 for boxes of different classes."""
    return np.where(truth.class_id[:, None] == results.class_id[None, :], iou(truth.xyxy_px, results.xyxy_px), 0.0)


def _sorted(boxes: TrackedBoxes) -> TrackedBoxes:
    return boxes.select(np.argsort(boxes.frame, kind="stable"))


def _numbered(track_id: IntArray) -> tuple[IntArray, IntArray]:
    """Identities renumbered from 0, and the number of boxes of each."""
    _, number, count = np.unique(track_id, return_inverse=True, return_counts=True)
    return np.asarray(number, np.int64).reshape(-1), np.asarray(count, np.int64)
