"""How good identities are: CLEAR (MOTA, MOTP, switches) and identity metrics (IDF1), counted by motmetrics.

    MOTA = 1 - (FP + FN + switches) / truth boxes        Bernardin and Stiefelhagen, 2008
    IDF1 = 2 IDTP / (truth boxes + result boxes)         Ristani et al., 2016

A result box and a truth box can match when their IoU is at least 0.5 and their class the same. The IoU matrices are our
own: motmetrics 1.4's `distances` fails on NumPy 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import motmetrics
import numpy as np

from detection.boxes import iou, share_inside
from detection.detections import BoolArray, FloatArray, IntArray, check_shape
from tracking.association import assigned

_MIN_IOU = 0.5
_MIN_SHARE_IGNORED = 0.5
_METRICS = (
    *("mota", "motp", "idf1", "idp", "idr", "num_switches", "num_false_positives", "num_misses", "num_fragmentations"),
    *("mostly_tracked", "mostly_lost", "num_objects"),
)


@dataclass(frozen=True, slots=True)
class TrackedBoxes:
    """Boxes with identities in many frames, truth or result; rows in any order.

    Attributes:
        frame: (N,) int64.
        track_id: (N,) int64, at most once per frame.
        xyxy_px: (N, 4) float64.
        class_id: (N,) int64.
    """

    frame: IntArray
    track_id: IntArray
    xyxy_px: FloatArray
    class_id: IntArray

    def __post_init__(self) -> None:
        n = len(self.frame)
        check_shape("frame", self.frame, (n,))
        check_shape("track_id", self.track_id, (n,))
        check_shape("xyxy_px", self.xyxy_px, (n, 4))
        check_shape("class_id", self.class_id, (n,))
        if len(np.unique(np.stack([self.frame, self.track_id]), axis=1).T) < n:
            raise ValueError("track_id: twice in one frame")

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, keep: BoolArray | IntArray) -> TrackedBoxes:
        """The rows that a mask or an index array names, in its order."""
        return TrackedBoxes(self.frame[keep], self.track_id[keep], self.xyxy_px[keep], self.class_id[keep])


@dataclass(frozen=True, slots=True)
class IgnoreRegions:
    """Where results are neither right nor wrong: KITTI's DontCare areas, vans beside cars, and so on.

    Attributes:
        frame: (M,) int64.
        xyxy_px: (M, 4) float64.
    """

    frame: IntArray
    xyxy_px: FloatArray

    def __post_init__(self) -> None:
        check_shape("frame", self.frame, (len(self.frame),))
        check_shape("xyxy_px", self.xyxy_px, (len(self.frame), 4))

    @classmethod
    def none(cls) -> IgnoreRegions:
        """Everything counts."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 4)))


@dataclass(frozen=True, slots=True)
class TrackingScores:
    """Scores of one sequence: ratios in per cent, the rest counts; NaN where there is nothing to divide by.

    Attributes:
        mota: per cent, can be negative.
        motp: mean IoU of the matches, per cent.
        idf1: per cent, with idp its precision and idr its recall.
        idsw: identity switches.
        fp: result boxes that match nothing.
        fn: truth boxes that nothing matches.
        frag: times that a truth track is lost and found again.
        mt: truth tracks matched in at least 80 % of their frames (mostly tracked).
        ml: truth tracks matched in less than 20 % of their frames (mostly lost).
        n: truth boxes.
    """

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
    ml: int
    n: int


def evaluate_tracks(
    truth: TrackedBoxes, results: TrackedBoxes, *, ignore: IgnoreRegions | None = None
) -> TrackingScores:
    """Score the tracks of one sequence; ids need not agree between the two.

    A result box that matches no truth is dropped first when at least half of its area lies in one region of `ignore`
    (which an IoU of 0.5 with that region implies). Give several sequences as one by frames and ids that do not meet.
    """
    regions = ignore or IgnoreRegions.none()
    accumulator = motmetrics.MOTAccumulator()
    for frame in np.union1d(truth.frame, results.frame):
        wanted, got = truth.select(truth.frame == frame), results.select(results.frame == frame)
        distance = _distance(wanted, got)
        kept = ~_ignored(distance, got.xyxy_px, regions.xyxy_px[regions.frame == frame])
        accumulator.update(wanted.track_id, got.track_id[kept], distance[:, kept], frameid=int(frame))
    return _scores(accumulator)


def _distance(truth: TrackedBoxes, results: TrackedBoxes) -> FloatArray:
    """(N, M) 1 - IoU; NaN where the two must not match."""
    overlap = iou(truth.xyxy_px, results.xyxy_px)
    same = truth.class_id[:, None] == results.class_id[None, :]
    return np.where(same & (overlap >= _MIN_IOU), 1.0 - overlap, np.nan)


def _ignored(distance: FloatArray, xyxy_px: FloatArray, regions_xyxy_px: FloatArray) -> BoolArray:
    """(M,) which result boxes lie in a region and match no truth, in the assignment of least distance."""
    _, matched = assigned(np.where(np.isnan(distance), np.inf, distance), max_cost=1.0)
    ignored = np.asarray(share_inside(xyxy_px, regions_xyxy_px).max(axis=1, initial=0.0) >= _MIN_SHARE_IGNORED)
    ignored[matched] = False
    return ignored


def _scores(accumulator: motmetrics.MOTAccumulator) -> TrackingScores:
    row = motmetrics.metrics.create().compute(accumulator, metrics=list(_METRICS)).iloc[0]
    return TrackingScores(
        mota=_per_cent(row["mota"]),
        motp=_per_cent(1.0 - row["motp"]),  # motmetrics' is a mean distance
        idf1=_per_cent(row["idf1"]),
        idp=_per_cent(row["idp"]),
        idr=_per_cent(row["idr"]),
        idsw=int(row["num_switches"]),
        fp=int(row["num_false_positives"]),
        fn=int(row["num_misses"]),
        frag=int(row["num_fragmentations"]),
        mt=int(row["mostly_tracked"]),
        ml=int(row["mostly_lost"]),
        n=int(row["num_objects"]),
    )


def _per_cent(ratio: float) -> float:
    """NaN for a ratio to nothing, which motmetrics gives as NaN or minus infinity."""
    return 100.0 * float(ratio) if np.isfinite(ratio) else float("nan")
