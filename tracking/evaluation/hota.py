"""HOTA: one score for detection, association and localisation, and its three parts.

    for each IoU threshold a:  DetA = TP / (TP + FN + FP)
        A(c) = TPA / (TPA + FNA + FPA) for the pair of identities of a match c, over the whole sequence
        AssA = mean of A over the matches     LocA = mean IoU of the matches     HOTA = sqrt(DetA AssA)
    the scores are means over a = 0.05, 0.10, ..., 0.95

In each frame, the matching prefers identities that overlap most over the whole sequence, then a larger IoU. (Luiten et
al., "HOTA: A Higher Order Metric for Evaluating Multi-Object Tracking", IJCV 2021. Details follow its reference
implementation, TrackEval.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from track_range.foundation.arrays import FloatArray
from track_range.tracking.evaluation.tracked_boxes import Similarity

ALPHAS: FloatArray = np.linspace(0.05, 0.95, 19)  # IoU thresholds a
_EPSILON = float(np.finfo(np.float64).eps)  # tolerance of comparisons, as in TrackEval


@dataclass(frozen=True, slots=True)
class HotaCounts:
    """Counts of HOTA per IoU threshold; counts of several sequences can be added."""

    tp: FloatArray  # (19,) matches; fn and fp: unmatched truth and result boxes
    fn: FloatArray
    fp: FloatArray
    iou_sum: FloatArray  # (19,) sum of the IoU of the matches
    association_sum: FloatArray  # (19,) sum of A(c) over the matches

    def __add__(self, other: HotaCounts) -> HotaCounts:
        return HotaCounts(*(getattr(self, name) + getattr(other, name) for name in self.__slots__))

    @property
    def deta(self) -> float:
        """DetA in per cent."""
        return 100 * float(self._deta.mean())

    @property
    def assa(self) -> float:
        """AssA in per cent."""
        return 100 * float(self._assa.mean())

    @property
    def loca(self) -> float:
        """LocA in per cent; 100 without matches, as in TrackEval."""
        return 100 * float((np.maximum(1e-10, self.iou_sum) / np.maximum(1e-10, self.tp)).mean())

    @property
    def hota(self) -> float:
        """HOTA in per cent."""
        return 100 * float(np.sqrt(self._deta * self._assa).mean())

    @property
    def _deta(self) -> FloatArray:
        return np.asarray(self.tp / np.maximum(1.0, self.tp + self.fn + self.fp))

    @property
    def _assa(self) -> FloatArray:
        return np.asarray(self.association_sum / np.maximum(1.0, self.tp))


def count_hota(similarity: Similarity) -> HotaCounts:
    """The counts of one sequence."""
    alignment = _alignment(similarity)
    pairs = [np.zeros((0, 3))]
    for truth_ids, result_ids, iou in similarity.by_frame:
        if len(truth_ids) and len(result_ids):
            rows, columns = linear_sum_assignment(
                alignment[np.ix_(truth_ids, result_ids)] * iou, maximize=True
            )
            pairs.append(
                np.column_stack([truth_ids[rows], result_ids[columns], iou[rows, columns]])
            )
    matches = np.concatenate(pairs)
    sums = [_sums(similarity, matches[matches[:, 2] >= alpha - _EPSILON]) for alpha in ALPHAS]
    tp, iou_sum, association_sum = np.array(sums).T
    return HotaCounts(
        tp, similarity.n_truth - tp, similarity.n_results - tp, iou_sum, association_sum
    )


def _alignment(similarity: Similarity) -> FloatArray:
    """(T, R) alignment of truth and result identities over the whole sequence: a soft Jaccard index
    of their boxes.
    """
    shared = np.zeros((len(similarity.truth_count), len(similarity.result_count)))
    for truth_ids, result_ids, iou in similarity.by_frame:
        union = iou.sum(axis=0)[None, :] + iou.sum(axis=1)[:, None] - iou
        shared[np.ix_(truth_ids, result_ids)] += np.divide(
            iou, union, out=np.zeros_like(iou), where=union > _EPSILON
        )
    n_union = similarity.truth_count[:, None] + similarity.result_count[None, :] - shared
    return np.asarray(shared / n_union)


def _sums(similarity: Similarity, matches: FloatArray) -> tuple[float, float, float]:
    """Number of matches, sum of their IoU and sum of their A(c), from matches (K, 3): two
    identities and the IoU.
    """
    if not len(matches):
        return 0.0, 0.0, 0.0
    n_results = len(similarity.result_count)
    identity = matches[:, :2].astype(np.int64)
    pair, tpa = np.unique(identity[:, 0] * n_results + identity[:, 1], return_counts=True)
    n_union = (
        similarity.truth_count[pair // n_results] + similarity.result_count[pair % n_results] - tpa
    )
    return (
        float(len(matches)),
        float(matches[:, 2].sum()),
        float((tpa * tpa / np.maximum(1, n_union)).sum()),
    )
