"""ConfidenceThreshold: the track-activation threshold of a detector, estimated online from the
persistence of boxes.

At a score of 0.5, 85 of 100 boxes are cars with one detector, and 18 of 100 are persons with
another. Objects are detected again in the next frame; false alarms are not. So the persistence of
boxes, the fraction that overlaps a box of the next frame, shows how reliable a score is, without
ground truth (on RRC's KITTI boxes, MOT15 and MOT17-05):

    score                   0.3-0.4  0.4-0.5  0.5-0.6  0.6-0.7  0.7-0.8  0.8-0.9  best half
    RRC cars      true         63 %     82 %     87 %     79 %     94 %     80 %   (100 %)
                  persist      73       83       87       82       90       87       97
    RRC persons   true          8       12       18       30       61       90
                  persist      47       54       64       73       83       93       93
    MOT15         true                           27       28       39       46     (84-96)
                  persist                        53       66       76       85       98

The threshold is the score at which the persistence reaches a fraction of the persistence of the
better half of all boxes: 0.3 for the cars, 0.7 for the persons, 0.8 for MOT15. A prior holds it at
the initial threshold until boxes have been counted.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from track_range.detection.boxes import iou_of_edges
from track_range.detection.classes import SAME_OBJECT_GROUP
from track_range.detection.detections import Detections
from track_range.foundation.arrays import FloatArray, IntArray

_N_BINS = 10  # number of bins of scores, each a tenth wide
_MIDDLE = [(k + 0.5) / _N_BINS for k in range(_N_BINS)]  # scores in the middle of the bins
# boxes of a frame that are compared with the next frame; of more boxes, every k-th
_MAX_COMPARED = 64
# number of pairs of boxes after which the frames so far are compared, even if no new estimate is
# due
_MAX_PAIRS = 4096
# persistence of the better half of boxes below which frames are too far apart for a comparison
_MIN_BEST = 0.4
# prior of the persistence of the better half of boxes: about that of the detectors above
_PRIOR_BEST = 0.97
_N_EVERY_FRAME, _SAMPLING_STEP = 1000, 4  # later, every fourth frame is compared: others add little
_N_GROUPS = int(SAME_OBJECT_GROUP.max()) + 1  # number of groups of classes that detectors confuse


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfidenceThresholdSettings:
    """Settings of the estimation of the threshold; scores and fractions are in [0, 1]."""

    first: float = 0.4  # initial threshold, before any box is counted
    # persistence to reach / that of the better half of boxes; 0 = a fixed threshold
    min_fraction: float = 0.85
    # lowest, highest: limits of the threshold
    lowest: float = 0.3
    highest: float = 0.9
    prior_boxes: float = 10.0  # weight of the prior, in boxes per bin of scores
    min_iou: float = 0.3  # minimum IoU of two boxes of one object in successive frames


class _Boxes(NamedTuple):
    """The boxes (N, 4) of a frame, with scores and classes (N,); copies, since the caller may reuse
    the arrays.
    """

    xyxy_px: FloatArray
    score: FloatArray
    class_id: IntArray


class ConfidenceThreshold:
    """The thresholds of one stream, one for each group of classes that detectors confuse.

    A new estimate needs 5 % more boxes; until then, frames are collected; they are then compared in
    one step.
    """

    def __init__(self, settings: ConfidenceThresholdSettings) -> None:
        self._settings = settings
        self._n_compared, self._n_persisted = np.zeros((2, _N_GROUPS * _N_BINS))
        self._before: _Boxes | None = None
        self._waiting: list[tuple[_Boxes, _Boxes]] = []  # successive frames to be compared
        self._n_waiting_pairs = 0
        self._by_group = np.full(_N_GROUPS, settings.first)
        self._n_boxes, self._n_at_estimate, self._n_frames = 0, 0, 0
        slope = 1 - settings.min_fraction
        # Linear in the score, 1 at score 1 and min_fraction at `first`.
        self._prior = [
            1 - slope * (1 - middle) / max(1 - settings.first, 1e-6) for middle in _MIDDLE
        ]

    def of(self, class_id: IntArray) -> FloatArray:
        """(N,) threshold for boxes of the classes (N,)."""
        return np.asarray(self._by_group[SAME_OBJECT_GROUP[class_id]])

    def update(self, detections: Detections, moved_xyxy_px: FloatArray | None = None) -> None:
        """Count the boxes of one frame, including boxes of low confidence.

        `moved_xyxy_px` (N, 4) are the boxes of the last frame with boxes, moved as their tracks
        predict, since near objects move by more than their width; None = not moved.
        """
        if self._settings.min_fraction <= 0 or not len(detections):
            # no information if the detector skipped the frame, and hardly any if it is empty
            return
        before, self._before = self._before, None
        self._n_frames += 1
        is_compared = _is_compared(self._n_frames)
        if not is_compared and not _is_compared(self._n_frames + 1):
            return
        now = _Boxes(detections.xyxy_px.copy(), detections.score.copy(), detections.class_id.copy())
        self._before = now
        if before is None or not is_compared:
            return
        if moved_xyxy_px is not None:
            before = before._replace(xyxy_px=moved_xyxy_px)
        step = -(-len(before.score) // _MAX_COMPARED)
        if step > 1:
            before = _Boxes(before.xyxy_px[::step], before.score[::step], before.class_id[::step])
        self._waiting.append((before, now))
        self._n_boxes += len(before.score)
        self._n_waiting_pairs += len(before.score) * len(now.score)
        # a few more boxes would hardly change the estimate
        is_due = self._n_boxes >= 1.05 * self._n_at_estimate
        if is_due or self._n_waiting_pairs >= _MAX_PAIRS:
            self._count()
        if is_due:
            self._n_at_estimate = self._n_boxes
            n_compared, n_persisted = (
                n.reshape(_N_GROUPS, _N_BINS) for n in (self._n_compared, self._n_persisted)
            )
            for group in np.flatnonzero(n_compared.any(axis=1)):
                self._by_group[group] = self._threshold(
                    n_compared[group].tolist(), n_persisted[group].tolist()
                )

    def _count(self) -> None:
        """Count the boxes of the waiting frames, and the boxes that persist, which overlap a box of
        the next frame.
        """
        before, now = zip(*self._waiting, strict=True)
        self._waiting, self._n_waiting_pairs = [], 0
        boxes, score, class_id = zip(*before, strict=True)
        next_boxes, _, _ = zip(*now, strict=True)
        before_px, now_px = _padded(boxes), _padded(next_boxes)
        overlap = iou_of_edges(before_px[:, :, :, None], now_px[:, :, None])
        persists = (overlap.max(axis=2) >= self._settings.min_iou)[np.isfinite(before_px[0])]
        score_bin = np.minimum((np.concatenate(score) * _N_BINS).astype(np.int64), _N_BINS - 1)
        key = SAME_OBJECT_GROUP[np.concatenate(class_id)] * _N_BINS + score_bin
        self._n_compared += np.bincount(key, minlength=len(self._n_compared))
        self._n_persisted += np.bincount(key[persists], minlength=len(self._n_compared))

    def _threshold(self, n_compared: Sequence[float], n_persisted: Sequence[float]) -> float:
        """Score at which the persistence reaches its fraction, interpolated between the middles of
        two bins.

        The arguments are the numbers of boxes per bin of scores, and of boxes that overlap a box of
        the next frame.
        """
        settings, n_prior = self._settings, self._settings.prior_boxes
        n_best, n_best_persisted, n_half = 0.0, 0.0, sum(n_compared) / 2
        # to the bin of the median
        for n, n_p in zip(reversed(n_compared), reversed(n_persisted), strict=True):
            n_best, n_best_persisted = n_best + n, n_best_persisted + n_p
            if n_best >= n_half:
                break
        best = (n_best_persisted + n_prior * _PRIOR_BEST) / (n_best + n_prior)
        if best < _MIN_BEST:
            return settings.first
        persistence_above = math.inf
        # from the highest scores down to the first bin with too little persistence
        for k in reversed(range(_N_BINS)):
            persistence = (
                (n_persisted[k] + n_prior * self._prior[k] * best)
                / (n_compared[k] + n_prior)
                / best
            )
            if persistence < settings.min_fraction:
                if k == _N_BINS - 1:
                    return settings.highest
                fraction = (settings.min_fraction - persistence) / (persistence_above - persistence)
                return min(max(_MIDDLE[k] + fraction / _N_BINS, settings.lowest), settings.highest)
            persistence_above = persistence
        return settings.lowest


def _is_compared(frame: int) -> bool:
    """Whether the boxes of the frame with this number are compared with the boxes of the frame
    before.
    """
    return frame <= _N_EVERY_FRAME or frame % _SAMPLING_STEP == 0


def _padded(boxes_px: Sequence[FloatArray]) -> FloatArray:
    """(4, K, N) edges of the boxes (n, 4) of K frames, padded with NaN in frames with fewer than N
    boxes.
    """
    padded = np.full((4, len(boxes_px), max(map(len, boxes_px))), np.nan)
    for k, boxes in enumerate(boxes_px):
        padded[:, k, : len(boxes)] = boxes.T
    return padded
