"""TrackedBoxes: boxes with identities in many frames, truth or result; Similarity: their IoU in
each frame.

All metrics are computed from the similarity, so that they count the same boxes; its identities are
numbered from 0. IgnoreRegions are the regions in which results are ignored.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from track_range.detection.boxes import iou
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, check_shape


@dataclass(frozen=True, slots=True)
class TrackedBoxes:
    """Boxes with identities in many frames, truth or result; rows in any order."""

    frame: IntArray  # (N,) int64 frame numbers from 0
    track_id: IntArray  # (N,) int64, each at most once per frame
    xyxy_px: FloatArray  # (N, 4) float64 boxes
    class_id: IntArray  # (N,) int64, index into `detection.classes.ROAD_CLASSES`

    def __post_init__(self) -> None:
        n = len(self.frame)
        check_shape("frame", self.frame, (n,))
        check_shape("track_id", self.track_id, (n,))
        check_shape("xyxy_px", self.xyxy_px, (n, 4))
        check_shape("class_id", self.class_id, (n,))
        if len(np.unique(np.stack([self.frame, self.track_id]), axis=1).T) < n:
            raise ValueError("track_id: expected each id at most once per frame, found duplicates")

    def __len__(self) -> int:
        return len(self.frame)

    @classmethod
    def joined(cls, parts: Sequence[TrackedBoxes]) -> TrackedBoxes:
        """The rows of all parts, one after another."""
        none = np.zeros(0, np.int64)
        empty = cls(none, none, np.zeros((0, 4)), none)
        columns = (
            np.concatenate([getattr(part, one.name) for part in (empty, *parts)])
            for one in fields(cls)
        )
        return cls(*columns)

    def select(self, rows: BoolArray | IntArray | slice) -> TrackedBoxes:
        """The rows that a mask, an index array or a slice selects, in its order."""
        return TrackedBoxes(
            self.frame[rows], self.track_id[rows], self.xyxy_px[rows], self.class_id[rows]
        )


@dataclass(frozen=True, slots=True)
class IgnoreRegions:
    """Regions in which unmatched results are ignored: KITTI's DontCare areas, vans when evaluating
    cars, and so on.
    """

    frame: IntArray  # (M,) int64 frame numbers from 0
    xyxy_px: FloatArray  # (M, 4) float64 boxes

    def __post_init__(self) -> None:
        check_shape("frame", self.frame, (len(self.frame),))
        check_shape("xyxy_px", self.xyxy_px, (len(self.frame), 4))


@dataclass(frozen=True, slots=True)
class Similarity:
    """IoU of the boxes of one sequence."""

    truth_count: IntArray  # (T,) number of frames with each truth identity
    result_count: IntArray  # (R,) number of frames with each result identity
    # for each frame with a box, truth identities (n,), result identities (m,) and their IoU (n, m)
    by_frame: tuple[tuple[IntArray, IntArray, FloatArray], ...]

    @classmethod
    def of(cls, truth: TrackedBoxes, results: TrackedBoxes) -> Similarity:
        """The similarity of one sequence's boxes, after the benchmark's rules; the IoU of different
        classes is 0.
        """
        truth, results = (
            boxes.select(np.argsort(boxes.frame, kind="stable")) for boxes in (truth, results)
        )
        frames = np.union1d(truth.frame, results.frame)
        starts, ends = (
            [np.searchsorted(boxes.frame, frames, side=side) for boxes in (truth, results)]
            for side in ("left", "right")
        )
        _, truth_id, truth_count = np.unique(
            truth.track_id, return_inverse=True, return_counts=True
        )
        _, result_id, result_count = np.unique(
            results.track_id, return_inverse=True, return_counts=True
        )
        by_frame = []
        for a, b, c, d in zip(starts[0], ends[0], starts[1], ends[1], strict=True):
            is_same_class = truth.class_id[a:b, None] == results.class_id[None, c:d]
            overlap = np.where(is_same_class, iou(truth.xyxy_px[a:b], results.xyxy_px[c:d]), 0.0)
            by_frame.append((truth_id[a:b], result_id[c:d], overlap))
        return cls(truth_count, result_count, tuple(by_frame))

    @property
    def n_truth(self) -> int:
        """Number of truth boxes."""
        return int(self.truth_count.sum())

    @property
    def n_results(self) -> int:
        """Number of result boxes."""
        return int(self.result_count.sum())
