"""CLEAR and identity metrics: MOTA, MOTP, switches, fragmentations, IDF1.

    MOTA = 1 - (FP + FN + switches) / truth boxes        Bernardin and Stiefelhagen, 2008
    IDF1 = 2 IDTP / (truth boxes + result boxes)         Ristani et al., 2016

A result box and a truth box can match if their IoU is at least 0.5. CLEAR continues the matches of
the frame before where possible, and maximises the IoU otherwise; identity metrics map whole tracks
to each other. Details follow TrackEval.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from track_range.tracking.evaluation.tracked_boxes import Similarity

MIN_IOU = 0.5  # minimum IoU of a match
_EPSILON = float(np.finfo(np.float64).eps)  # tolerance of comparisons, as in TrackEval
# for a pair matched in the previous frame; exceeds any sum of IoUs of a frame
_CONTINUITY_BONUS = 1000.0


@dataclass(frozen=True, slots=True)
class ClearCounts:
    """Counts of one or several sequences."""

    tp: int  # matches; fn and fp: unmatched truth and result boxes
    fn: int
    fp: int
    idsw: int  # identity switches
    frag: int  # fragmentations: how often a truth track is lost and matched again
    # truth tracks matched in more than 80 %, 20 to 80 % (pt), less than 20 % (ml) of their frames
    mt: int
    pt: int
    ml: int
    iou_sum: float  # sum of the IoU of the matches
    idtp: int  # idtp, idfn, idfp: tp, fn, fp under the best one-to-one mapping of whole tracks
    idfn: int
    idfp: int

    def __add__(self, other: ClearCounts) -> ClearCounts:
        return ClearCounts(*(getattr(self, name) + getattr(other, name) for name in self.__slots__))

    @property
    def n_truth(self) -> int:
        """Number of truth boxes."""
        return self.tp + self.fn

    @property
    def mota(self) -> float:
        """MOTA in per cent; can be negative; NaN without truth."""
        return _per_cent(self.tp - self.fp - self.idsw, self.n_truth)

    @property
    def motp(self) -> float:
        """Mean IoU of the matches in per cent."""
        return _per_cent(self.iou_sum, self.tp)

    @property
    def idf1(self) -> float:
        """IDF1 in per cent."""
        return _per_cent(2 * self.idtp, 2 * self.idtp + self.idfn + self.idfp)

    @property
    def idp(self) -> float:
        """Identity precision in per cent."""
        return _per_cent(self.idtp, self.idtp + self.idfp)

    @property
    def idr(self) -> float:
        """Identity recall in per cent."""
        return _per_cent(self.idtp, self.idtp + self.idfn)


def count_clear(similarity: Similarity) -> ClearCounts:
    """The counts of one sequence."""
    n = len(similarity.truth_count)
    last, last_frame = np.full(n, -1), np.full(n, -1)
    n_matched, n_starts = np.zeros(n, np.int64), np.zeros(n, np.int64)
    tp = idsw = 0
    iou_sum = 0.0
    for truth_ids, result_ids, iou in similarity.by_frame:
        if not len(truth_ids) or not len(result_ids):
            # tracks matched in the previous frame count as matched in this one, as in TrackEval
            continue
        score = iou + _CONTINUITY_BONUS * (result_ids[None, :] == last_frame[truth_ids][:, None])
        score[iou < MIN_IOU - _EPSILON] = 0.0
        rows, columns = linear_sum_assignment(score, maximize=True)
        is_match = score[rows, columns] > _EPSILON
        rows, columns = rows[is_match], columns[is_match]
        truth, result = truth_ids[rows], result_ids[columns]
        tp += len(truth)
        iou_sum += float(iou[rows, columns].sum())
        idsw += int(np.count_nonzero((last[truth] >= 0) & (last[truth] != result)))
        n_matched[truth] += 1
        n_starts[truth[last_frame[truth] < 0]] += 1
        last[truth] = result
        last_frame[:] = -1
        last_frame[truth] = result
    fraction = n_matched / np.maximum(similarity.truth_count, 1)
    mt, mt_or_pt = int(np.count_nonzero(fraction > 0.8)), int(np.count_nonzero(fraction >= 0.2))
    idtp = _identity_matches(similarity)
    return ClearCounts(
        tp=tp,
        fn=similarity.n_truth - tp,
        fp=similarity.n_results - tp,
        idsw=idsw,
        frag=int((n_starts[n_starts > 0] - 1).sum()),
        mt=mt,
        pt=mt_or_pt - mt,
        ml=n - mt_or_pt,
        iou_sum=iou_sum,
        idtp=idtp,
        idfn=similarity.n_truth - idtp,
        idfp=similarity.n_results - idtp,
    )


def _identity_matches(similarity: Similarity) -> int:
    """IDTP: the number of matched boxes under the best one-to-one mapping of truth to result
    identities.
    """
    n_common = np.zeros((len(similarity.truth_count), len(similarity.result_count)))
    for truth_ids, result_ids, iou in similarity.by_frame:
        n_common[np.ix_(truth_ids, result_ids)] += iou >= MIN_IOU
    rows, columns = linear_sum_assignment(n_common, maximize=True)
    return int(n_common[rows, columns].sum())


def _per_cent(part: float, whole: float) -> float:
    return 100.0 * part / whole if whole else float("nan")
