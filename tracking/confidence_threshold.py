"""ScoreThreshold: from which score on a detector's boxes are worth a track, learnt from whether they persist.

A score of 0.5 means a car in 85 of 100 boxes of one detector and a person in 18 of 100 of another's. What is there is
found again in the next frame; false alarms come and go. So the share of boxes that some box of the next frame overlaps,
by score, tells how much a score is worth, without any truth (measured on RRC's KITTI boxes, MOT15 and MOT17-05):

    score                   0.3-0.4  0.4-0.5  0.5-0.6  0.6-0.7  0.7-0.8  0.8-0.9  best half
    RRC cars      true         63 %     82 %     87 %     79 %     94 %     80 %   (100 %)
                  persist      73       83       87       82       90       87       97
    RRC persons   true          8       12       18       30       61       90
                  persist      47       54       64       73       83       93       93
    MOT15         true                           27       28       39       46     (84-96)
                  persist                        53       66       76       85       98

The threshold is where the share reaches a fraction of that of the better half of all boxes: 0.3 for the cars, 0.7 for
the persons, 0.8 for MOT15. Until boxes have been counted a prior holds, which gives the settings' own threshold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.detection.boxes import iou
from track_range.detection.classes import SAME_OBJECT_GROUP
from track_range.detection.detections import Detections
from track_range.foundation.arrays import FloatArray, IntArray

_N_BINS = 10
_MIDDLE = (np.arange(_N_BINS) + 0.5) / _N_BINS
_MAX_ASKED = 64
"""Boxes of a frame that are looked for in the next one; of more, every k-th."""

_MIN_BEST = 0.4
"""Persistence of the better half of boxes below which it tells nothing of scores."""

_N_EAGER, _LAZY_STEP = 1000, 4
"""After so many frames only every fourth is asked: it has little to add."""

_N_GROUPS = int(SAME_OBJECT_GROUP.max()) + 1


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreThresholdSettings:
    """How the threshold is learnt; scores and shares are in [0, 1].

    Attributes:
        first: before anything is known.
        min_share: of the persistence of the better half of boxes, which a score must reach; 0 = nothing is learnt.
        lowest, highest: limits.
        prior_boxes: what the prior weighs, per tenth of scores.
        min_iou: of two boxes of successive frames that are one object.
    """

    first: float = 0.4
    min_share: float = 0.85
    lowest: float = 0.3
    highest: float = 0.9
    prior_boxes: float = 10.0
    min_iou: float = 0.3


class ScoreThreshold:
    """The thresholds of one stream, one for each group of classes that detectors take for each other."""

    def __init__(self, settings: ScoreThresholdSettings) -> None:
        self._settings = settings
        self._asked, self._persisted = np.zeros((2, _N_GROUPS * _N_BINS))
        self._before: Detections | None = None
        self._by_group = np.full(_N_GROUPS, settings.first)
        self._n_learnt, self._n_frames = 0.0, 0
        slope = 1 - settings.min_share
        # a line through 1 at score 1 that meets min_share at `first`
        self._prior = 1 - slope * (1 - _MIDDLE) / max(1 - settings.first, 1e-6)

    def of(self, class_id: IntArray) -> FloatArray:
        """(N,) the threshold for boxes of these classes."""
        return np.asarray(self._by_group[SAME_OBJECT_GROUP[class_id]])

    def learn(self, found: Detections) -> None:
        """Take in one frame's boxes, weak ones too."""
        if self._settings.min_share <= 0:
            return
        if not len(found):
            return  # a frame that nobody looked at says nothing; one that is truly empty says little
        mine = Detections.of(
            found.xyxy_px.copy(), found.score.copy(), found.class_id.copy()
        )  # the caller may reuse his
        before, self._before = self._before, mine
        self._n_frames += 1
        if self._n_frames > _N_EAGER and self._n_frames % _LAZY_STEP:
            return
        if before is None or not len(before):
            return
        if len(before) > _MAX_ASKED:
            before = before.select(np.arange(0, len(before), -(-len(before) // _MAX_ASKED)))
        seen_again = iou(before.xyxy_px, found.xyxy_px).max(axis=1, initial=0.0) >= self._settings.min_iou
        tenth = np.minimum((before.score * _N_BINS).astype(np.int64), _N_BINS - 1)
        key = SAME_OBJECT_GROUP[before.class_id] * _N_BINS + tenth
        self._asked += np.bincount(key, minlength=len(self._asked))
        self._persisted += np.bincount(key[seen_again], minlength=len(self._asked))
        n = float(self._asked.sum())
        if n >= 1.05 * self._n_learnt:  # what has hardly grown would say the same again
            self._n_learnt = n
            self._renew()

    def _renew(self) -> None:
        for group, asked in enumerate(self._asked.reshape(_N_GROUPS, _N_BINS)):
            if asked.any():
                self._by_group[group] = self._threshold(asked, self._persisted.reshape(_N_GROUPS, _N_BINS)[group])

    def _threshold(self, asked: FloatArray, persisted: FloatArray) -> float:
        """Where persistence reaches its share, between the middles of two tenths."""
        keep = self._settings
        from_top = np.cumsum(asked[::-1])
        top = _N_BINS - 1 - int(np.searchsorted(from_top, from_top[-1] / 2))
        n = keep.prior_boxes
        best = (persisted[top:].sum() + n * 0.97) / (asked[top:].sum() + n)
        if best < _MIN_BEST:
            return keep.first  # frames are too far apart for anything to overlap
        share = (persisted + n * self._prior * best) / (asked + n) / best
        short = np.flatnonzero(share < keep.min_share)
        k = int(short[-1]) if len(short) else -1
        if k < 0:
            return keep.lowest
        if k == _N_BINS - 1:
            return keep.highest
        between = (keep.min_share - share[k]) / (share[k + 1] - share[k])
        return float(np.clip(_MIDDLE[k] + between / _N_BINS, keep.lowest, keep.highest))
