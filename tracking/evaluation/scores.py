"""Scores of tracks: HOTA, CLEAR (MOTA, MOTP, switches) and identity metrics (IDF1), of one or
several sequences.

A result box and a truth box can match only if their classes are equal. HOTA is evaluated at IoU
thresholds from 0.05 to 0.95, the other metrics at 0.5 (`evaluation.hota` and `evaluation.clear`, which
agree with TrackEval).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from track_range.detection.boxes import fraction_inside, iou
from track_range.foundation.arrays import BoolArray
from track_range.tracking.association import min_cost_matching
from track_range.tracking.evaluation.clear import MIN_IOU, ClearCounts, count_clear
from track_range.tracking.evaluation.hota import HotaCounts, count_hota
from track_range.tracking.evaluation.tracked_boxes import IgnoreRegions, Similarity, TrackedBoxes

# of an unmatched result box inside an ignore region for which it is dropped
_MIN_FRACTION_IGNORED = 0.5


@dataclass(frozen=True, slots=True)
class TrackingScores:
    """Scores of one or more sequences: ratios in per cent (NaN where the denominator is 0), and
    counts.
    """

    hota: float  # higher-order tracking accuracy
    deta: float  # detection accuracy, a part of HOTA
    assa: float  # association accuracy, a part of HOTA
    loca: float  # localisation accuracy, a part of HOTA
    mota: float  # multi-object tracking accuracy; can be negative
    motp: float  # mean IoU of the matches
    idf1: float  # identity F1 score
    idp: float  # identity precision
    idr: float  # identity recall
    idsw: int  # identity switches
    fp: int  # unmatched result boxes
    fn: int  # unmatched truth boxes
    frag: int  # fragmentations: how often a truth track is lost and matched again
    # truth tracks matched in more than 80 %, 20 to 80 % (pt), less than 20 % (ml) of their frames
    mt: int
    pt: int
    ml: int
    n: int  # truth boxes


@dataclass(frozen=True, slots=True)
class TrackingCounts:
    """Counts from which the scores are computed; counts of several sequences can be added."""

    hota: HotaCounts  # counts of HOTA
    clear: ClearCounts  # counts of CLEAR and the identity metrics

    @classmethod
    def of(cls, truth: TrackedBoxes, results: TrackedBoxes) -> TrackingCounts:
        """Counts of one sequence, after the benchmark's rules; ids of truth and results need not
        agree.
        """
        return cls.of_similarity(Similarity.of(truth, results))

    @classmethod
    def of_similarity(cls, similarity: Similarity) -> TrackingCounts:
        """Counts of one sequence, from the IoU of all boxes."""
        return cls(count_hota(similarity), count_clear(similarity))

    @classmethod
    def sum_of(cls, counts: Sequence[TrackingCounts]) -> TrackingCounts:
        """Counts of all sequences combined; at least one."""
        hota, clear = counts[0].hota, counts[0].clear
        for sequence in counts[1:]:
            hota, clear = hota + sequence.hota, clear + sequence.clear
        return cls(hota, clear)

    def scores(self) -> TrackingScores:
        """The scores that follow from the counts."""
        parts = {name: getattr(self.hota, name) for name in ("hota", "deta", "assa", "loca")}
        names = ("mota", "motp", "idf1", "idp", "idr", "idsw", "fp", "fn", "frag", "mt", "pt", "ml")
        return TrackingScores(
            **parts, **{name: getattr(self.clear, name) for name in names}, n=self.clear.n_truth
        )


def evaluate_tracks(
    truth: TrackedBoxes, results: TrackedBoxes, *, ignore: IgnoreRegions | None = None
) -> TrackingScores:
    """Scores of the tracks of one sequence; ids of truth and results need not agree.

    Unmatched result boxes are dropped first where at least half of their area lies in one region of
    `ignore` (which an IoU of 0.5 with that region implies).
    """
    if ignore is not None and len(ignore.frame):
        results = results.select(~_ignored(truth, results, ignore))
    return TrackingCounts.of(truth, results).scores()


def _ignored(truth: TrackedBoxes, results: TrackedBoxes, ignore: IgnoreRegions) -> BoolArray:
    """(M,) whether a result box lies in a region and is unmatched in the assignment with the
    largest total IoU.
    """
    is_ignored: BoolArray = np.zeros(len(results), np.bool_)
    for frame in np.unique(ignore.frame):
        rows = np.flatnonzero(results.frame == frame)
        frame_truth, frame_results = truth.select(truth.frame == frame), results.select(rows)
        overlap = iou(frame_truth.xyxy_px, frame_results.xyxy_px)
        allowed = (frame_truth.class_id[:, None] == frame_results.class_id[None, :]) & (
            overlap >= MIN_IOU
        )
        _, matched = min_cost_matching(np.where(allowed, 1.0 - overlap, np.inf), max_cost=1.0)
        fraction = fraction_inside(
            frame_results.xyxy_px, ignore.xyxy_px[ignore.frame == frame]
        ).max(axis=1, initial=0.0)
        is_inside = fraction >= _MIN_FRACTION_IGNORED
        is_inside[matched] = False
        is_ignored[rows] = is_inside
    return is_ignored
