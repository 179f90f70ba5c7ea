"""ConfidenceThreshold: the track-activation threshold of a detector, estimated online from the persistence of boxes.

At a score of 0.5, 85 of 100 boxes are cars with one detector, and 18 of 100 are persons with another. Objects are
detected again in the next frame; false alarms are not. So the persistence of boxes, the fraction that overlaps a box of
the next frame, shows how reliable a score is, without ground truth (on RRC's KITTI boxes, MOT15 and MOT17-05):

    score                   0.3-0.4  0.4-0.5  0.5-0.6  0.6-0.7  0.7-0.8  0.8-0.9  best half
    RRC cars      true         63 %     82 %     87 %     79 %     94 %     80 %   (100 %)
                  persist      73       83       87       82       90       87       97
    RRC persons   true          8       12       18       30       61       90
                  persist      47       54       64       73       83       93       93
    MOT15         true                           27       28       39       46     (84-96)
                  persist                        53       66       76       85       98

The threshold is the score at which the persistence reaches a fraction of that of the better half of all boxes: 0.3 for
the cars, 0.7 for the persons, 0.8 for MOT15. A prior holds it at the initial threshold until boxes have been counted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.detection.boxes import iou
from track_range.detection.classes import SAME_OBJECT_GROUP
from track_range.detection.detections import Detections
from track_range.foundation.arrays import FloatArray, IntArray

_N_BINS = 10
"""Number of bins of scores, each a tenth wide."""

_MIDDLE = (np.arange(_N_BINS) + 0.5) / _N_BINS
"""Scores in the middle of the bins."""

_MAX_COMPARED = 64
"""Maximum number of boxes of a frame that are compared with the next frame; of more boxes, every k-th is compared."""

_MIN_BEST = 0.4
"""Persistence of the better half of boxes below which frames are too far apart for a comparison."""

_PRIOR_BEST = 0.97
"""Prior of the persistence of the better half of boxes: about that of the detectors above."""

_N_EVERY_FRAME, _SAMPLING_STEP = 1000, 4
"""After the first 1000 frames, only every fourth is compared: the others add little information."""

_N_GROUPS = int(SAME_OBJECT_GROUP.max()) + 1
"""Number of groups of classes that detectors confuse."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfidenceThresholdSettings:
    """Settings of the estimation of the threshold; scores and fractions are in [0, 1].

    Attributes:
        first: initial threshold, before any box is counted.
        min_share: persistence that a score must reach, as a fraction of that of the better half of boxes; 0 = a fixed
            threshold.
        lowest, highest: limits of the threshold.
        prior_boxes: weight of the prior, in boxes per bin of scores.
        min_iou: minimum IoU of two boxes of one object in successive frames.
    """

    first: float = 0.4
    min_share: float = 0.85
    lowest: float = 0.3
    highest: float = 0.9
    prior_boxes: float = 10.0
    min_iou: float = 0.3


class ConfidenceThreshold:
    """The thresholds of one stream, one for each group of classes that detectors confuse."""

    def __init__(self, settings: ConfidenceThresholdSettings) -> None:
        self._settings = settings
        self._n_compared, self._n_persisted = np.zeros((2, _N_GROUPS * _N_BINS))
        self._before: Detections | None = None
        self._by_group = np.full(_N_GROUPS, settings.first)
        self._n_at_estimate, self._n_frames = 0.0, 0
        slope = 1 - settings.min_share
        # Linear in the score, 1 at score 1 and min_share at `first`.
        self._prior = 1 - slope * (1 - _MIDDLE) / max(1 - settings.first, 1e-6)

    def of(self, class_id: IntArray) -> FloatArray:
        """(N,) threshold for boxes of the classes (N,)."""
        return np.asarray(self._by_group[SAME_OBJECT_GROUP[class_id]])

    def update(self, detections: Detections) -> None:
        """Count the boxes of one frame, including low-confidence ones."""
        if self._settings.min_share <= 0:
            return
        if not len(detections):
            return  # no information if the detector skipped the frame, and hardly any if it is empty
        copy = Detections.of(detections.xyxy_px.copy(), detections.score.copy(), detections.class_id.copy())
        before, self._before = self._before, copy  # a copy, since the caller may reuse the arrays
        self._n_frames += 1
        if self._n_frames > _N_EVERY_FRAME and self._n_frames % _SAMPLING_STEP:
            return
        if before is None or not len(before):
            return
        if len(before) > _MAX_COMPARED:
            before = before.select(np.arange(0, len(before), -(-len(before) // _MAX_COMPARED)))
        persists = iou(before.xyxy_px, detections.xyxy_px).max(axis=1, initial=0.0) >= self._settings.min_iou
        score_bin = np.minimum((before.score * _N_BINS).astype(np.int64), _N_BINS - 1)
        key = SAME_OBJECT_GROUP[before.class_id] * _N_BINS + score_bin
        self._n_compared += np.bincount(key, minlength=len(self._n_compared))
        self._n_persisted += np.bincount(key[persists], minlength=len(self._n_compared))
        n = float(self._n_compared.sum())
        if n >= 1.05 * self._n_at_estimate:  # a few more boxes would hardly change the estimate
            self._n_at_estimate = n
            self._estimate()

    def _estimate(self) -> None:
        by_group = (counts.reshape(_N_GROUPS, _N_BINS) for counts in (self._n_compared, self._n_persisted))
        for group, (n_compared, n_persisted) in enumerate(zip(*by_group, strict=True)):
            if n_compared.any():
                self._by_group[group] = self._threshold(n_compared, n_persisted)

    def _threshold(self, n_compared: FloatArray, n_persisted: FloatArray) -> float:
        """Score at which the persistence reaches its fraction, interpolated between the middles of two bins.

        Args:
            n_compared: (10,) number of boxes per bin of scores.
            n_persisted: (10,) number of those that overlap a box of the next frame.
        """
        settings, n_prior = self._settings, self._settings.prior_boxes
        n_from_top = np.cumsum(n_compared[::-1])
        top = _N_BINS - 1 - int(np.searchsorted(n_from_top, n_from_top[-1] / 2))  # first bin of the better half
        best = (n_persisted[top:].sum() + n_prior * _PRIOR_BEST) / (n_compared[top:].sum() + n_prior)
        if best < _MIN_BEST:
            return settings.first
        share = (n_persisted + n_prior * self._prior * best) / (n_compared + n_prior) / best
        too_small = np.flatnonzero(share < settings.min_share)
        k = int(too_small[-1]) if len(too_small) else -1
        if k < 0:
            return settings.lowest
        if k == _N_BINS - 1:
            return settings.highest
        fraction = (settings.min_share - share[k]) / (share[k + 1] - share[k])
        return float(np.clip(_MIDDLE[k] + fraction / _N_BINS, settings.lowest, settings.highest))
