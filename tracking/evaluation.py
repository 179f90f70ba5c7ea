"""How good identities are: HOTA, CLEAR (MOTA, MOTP, switches) and identity metrics (IDF1), of one or many sequences.

A result box and a truth box can match when their class is the same; HOTA counts at every IoU from 0.05 to 0.95, the
others at 0.5 (`tracking.hota`, `tracking.clear`; both give TrackEval's figures).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from track_range.detection.boxes import iou, share_inside
from track_range.foundation.arrays import BoolArray
from track_range.tracking.association import min_cost_matching
from track_range.tracking.clear import MIN_IOU, ClearCounts, count_clear
from track_range.tracking.hota import HotaCounts, count_hota
from track_range.tracking.similarity import Similarity
from track_range.tracking.tracked_boxes import IgnoreRegions, TrackedBoxes

_MIN_SHARE_IGNORED = 0.5


@dataclass(frozen=True, slots=True)
class TrackingScores:
    """Scores of one sequence, or of several together: ratios in per cent, the rest counts.

    Ratios are NaN where there is nothing to divide by.

    Attributes:
        hota: with deta its detection, assa its association and loca its localisation part.
        mota: can be negative.
        motp: mean IoU of the matches.
        idf1: with idp its precision and idr its recall.
        idsw: identity switches.
        fp: result boxes that match nothing.
        fn: truth boxes that nothing matches.
        frag: times that a truth track is lost and found again.
        mt, pt, ml: truth tracks matched in more than 80 %, in 20 to 80 %, in less than 20 % of their frames.
        n: truth boxes.
    """

    hota: float
    deta: float
    assa: float
    loca: float
    mota: float
    motp: float
    idf1: float
    idp: float
    idr: float
    idsw: int
    fp: int
    fn: int
    frag: int
    mt: int
    pt: int
    ml: int
    n: int


@dataclass(frozen=True, slots=True)
class TrackingCounts:
    """The counts behind the scores; those of several sequences add up."""

    hota: HotaCounts
    clear: ClearCounts

    @classmethod
    def of(cls, truth: TrackedBoxes, results: TrackedBoxes) -> TrackingCounts:
        """Of one sequence, after the benchmark's rules; ids need not agree between the two."""
        return cls.of_similarity(Similarity.of(truth, results))

    @classmethod
    def of_similarity(cls, similarity: Similarity) -> TrackingCounts:
        """The same, from the IoU of all boxes."""
        return cls(count_hota(similarity), count_clear(similarity))

    @classmethod
    def sum_of(cls, counts: Sequence[TrackingCounts]) -> TrackingCounts:
        """Of all sequences together; at least one."""
        hota, clear = counts[0].hota, counts[0].clear
        for each in counts[1:]:
            hota, clear = hota + each.hota, clear + each.clear
        return cls(hota, clear)

    def scores(self) -> TrackingScores:
        """The figures."""
        parts = {name: getattr(self.hota, name) for name in ("hota", "deta", "assa", "loca")}
        names = ("mota", "motp", "idf1", "idp", "idr", "idsw", "fp", "fn", "frag", "mt", "pt", "ml")
        return TrackingScores(**parts, **{name: getattr(self.clear, name) for name in names}, n=self.clear.n_truth)


def evaluate_tracks(
    truth: TrackedBoxes, results: TrackedBoxes, *, ignore: IgnoreRegions | None = None
) -> TrackingScores:
    """Score the tracks of one sequence; ids need not agree between the two.

    A result box that matches no truth is dropped first when at least half of its area lies in one region of `ignore`
    (which an IoU of 0.5 with that region implies).
    """
    if ignore is not None and len(ignore.frame):
        results = results.select(~_ignored(truth, results, ignore))
    return TrackingCounts.of(truth, results).scores()


def _ignored(truth: TrackedBoxes, results: TrackedBoxes, ignore: IgnoreRegions) -> BoolArray:
    """(M,) which result boxes lie in a region and match no truth, in the assignment of most IoU."""
    is_ignored: BoolArray = np.zeros(len(results), np.bool_)
    for frame in np.unique(ignore.frame):
        rows = np.flatnonzero(results.frame == frame)
        of_truth, of_results = truth.select(truth.frame == frame), results.select(rows)
        overlap = iou(of_truth.xyxy_px, of_results.xyxy_px)
        may = (of_truth.class_id[:, None] == of_results.class_id[None, :]) & (overlap >= MIN_IOU)
        _, matched = min_cost_matching(np.where(may, 1.0 - overlap, np.inf), max_cost=1.0)
        share = share_inside(of_results.xyxy_px, ignore.xyxy_px[ignore.frame == frame]).max(axis=1, initial=0.0)
        inside = share >= _MIN_SHARE_IGNORED
        inside[matched] = False
        is_ignored[rows] = inside
    return is_ignored
