"""CLEAR and identity metrics, counted in arrays: MOTA, MOTP, switches, fragmentations, IDF1.

    MOTA = 1 - (FP + FN + switches) / truth boxes        Bernardin and Stiefelhagen, 2008
    IDF1 = 2 IDTP / (truth boxes + result boxes)         Ristani et al., 2016

A result box and a truth box can match when their IoU is at least 0.5. CLEAR keeps a truth box with the identity that
had it last, where it can, and takes the best IoU otherwise; identity metrics join whole tracks. In details as
TrackEval.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from track_range.tracking.similarity import Similarity

MIN_IOU = 0.5
_EPSILON = float(np.finfo(np.float64).eps)
_STAY = 1000.0
"""Larger than any sum of IoUs that could outweigh an identity kept."""


@dataclass(frozen=True, slots=True)
class ClearCounts:
    """Counts of one or several sequences.

    Attributes:
        tp, fn, fp: matches, truth boxes and result boxes without one.
        idsw: identity switches.
        frag: times that a truth track is lost and found again.
        mt, pt, ml: truth tracks matched in more than 80 %, 20 to 80 % and less than 20 % of their frames.
        iou_sum: over the matches.
        idtp, idfn, idfp: boxes of the best one-to-one mapping of whole tracks.
    """

    tp: int
    fn: int
    fp: int
    idsw: int
    frag: int
    mt: int
    pt: int
    ml: int
    iou_sum: float
    idtp: int
    idfn: int
    idfp: int

    def __add__(self, other: ClearCounts) -> ClearCounts:
        return ClearCounts(*(getattr(self, name) + getattr(other, name) for name in self.__slots__))

    @property
    def n_truth(self) -> int:
        """Truth boxes."""
        return self.tp + self.fn

    @property
    def mota(self) -> float:
        """Per cent, can be negative; NaN without truth."""
        return _per_cent(self.tp - self.fp - self.idsw, self.n_truth)

    @property
    def motp(self) -> float:
        """Mean IoU of the matches, per cent."""
        return _per_cent(self.iou_sum, self.tp)

    @property
    def idf1(self) -> float:
        """Per cent."""
        return _per_cent(2 * self.idtp, 2 * self.idtp + self.idfn + self.idfp)

    @property
    def idp(self) -> float:
        """Per cent."""
        return _per_cent(self.idtp, self.idtp + self.idfp)

    @property
    def idr(self) -> float:
        """Per cent."""
        return _per_cent(self.idtp, self.idtp + self.idfn)


def count_clear(similarity: Similarity) -> ClearCounts:
    """The counts of one sequence."""
    n = len(similarity.truth_count)
    last, last_frame = np.full(n, -1), np.full(n, -1)
    n_matched, n_starts = np.zeros(n, np.int64), np.zeros(n, np.int64)
    tp = idsw = 0
    iou_sum = 0.0
    for truth_ids, result_ids, iou in similarity.frames():
        if not len(truth_ids) or not len(result_ids):
            continue  # tracks matched in the frame before count as matched in this one, as in TrackEval
        score = iou + _STAY * (result_ids[None, :] == last_frame[truth_ids][:, None])
        score[iou < MIN_IOU - _EPSILON] = 0.0
        rows, columns = linear_sum_assignment(score, maximize=True)
        keep = score[rows, columns] > _EPSILON
        rows, columns = rows[keep], columns[keep]
        truth, result = truth_ids[rows], result_ids[columns]
        tp += len(truth)
        iou_sum += float(iou[rows, columns].sum())
        idsw += int(np.count_nonzero((last[truth] >= 0) & (last[truth] != result)))
        n_matched[truth] += 1
        n_starts[truth[last_frame[truth] < 0]] += 1
        last[truth] = result
        last_frame[:] = -1
        last_frame[truth] = result
    share = n_matched / np.maximum(similarity.truth_count, 1)
    mt, seen = int(np.count_nonzero(share > 0.8)), int(np.count_nonzero(share >= 0.2))
    idtp = _identity_matches(similarity)
    return ClearCounts(
        tp=tp,
        fn=similarity.n_truth - tp,
        fp=similarity.n_results - tp,
        idsw=idsw,
        frag=int((n_starts[n_starts > 0] - 1).sum()),
        mt=mt,
        pt=seen - mt,
        ml=n - seen,
        iou_sum=iou_sum,
        idtp=idtp,
        idfn=similarity.n_truth - idtp,
        idfp=similarity.n_results - idtp,
    )


def _identity_matches(similarity: Similarity) -> int:
    """Boxes that agree under the best mapping of truth identities to result identities."""
    together = np.zeros((len(similarity.truth_count), len(similarity.result_count)))
    for truth_ids, result_ids, iou in similarity.frames():
        together[np.ix_(truth_ids, result_ids)] += iou >= MIN_IOU
    rows, columns = linear_sum_assignment(together, maximize=True)
    return int(together[rows, columns].sum())


def _per_cent(part: float, whole: float) -> float:
    return 100.0 * part / whole if whole else float("nan")
