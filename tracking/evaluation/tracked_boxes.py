"""TrackedBoxes: boxes with identities in many frames, truth or result; IgnoreRegions: where results are ignored."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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

    def select(self, rows: BoolArray | IntArray | slice) -> TrackedBoxes:
        """The rows that a mask, an index array or a slice selects, in its order."""
        return TrackedBoxes(self.frame[rows], self.track_id[rows], self.xyxy_px[rows], self.class_id[rows])


@dataclass(frozen=True, slots=True)
class IgnoreRegions:
    """Regions in which unmatched results are ignored: KITTI's DontCare areas, vans when evaluating cars, and so on."""

    frame: IntArray  # (M,) int64 frame numbers from 0
    xyxy_px: FloatArray  # (M, 4) float64 boxes

    def __post_init__(self) -> None:
        check_shape("frame", self.frame, (len(self.frame),))
        check_shape("xyxy_px", self.xyxy_px, (len(self.frame), 4))

    @classmethod
    def none(cls) -> IgnoreRegions:
        """No regions."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 4)))
