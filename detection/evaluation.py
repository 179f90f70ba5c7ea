"""Average precision of detectors, as COCO counts it (pycocotools' COCOeval, all areas, at most 100 boxes per image).

    precision(r) = the best precision at any recall >= r     AP = mean of precision(r) for r = 0, 0.01, ..., 1
    AP50: IoU >= 0.5                                          AP50-95: mean over IoU >= 0.50, 0.55, ..., 0.95

In each image and class, detections take their truth greedily by score: the unclaimed label of the largest IoU, an
ignored one only where no other is left. Who takes an ignored one is neither right nor wrong.
(Lin et al., "Microsoft COCO", ECCV 2014; cocodataset.org/#detection-eval.)
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from track_range.detection.boxes import iou, share_inside
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.formats.image_truth import ANY_CLASS, ImageTruth
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray

IOU_THRESHOLDS: FloatArray = np.linspace(0.5, 0.95, 10)
RECALL_POINTS: FloatArray = np.linspace(0.0, 1.0, 101)
MAX_DETECTIONS = 100
"""Per image and class."""

PRECISIONS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
"""At which recall is told, so that detectors can be compared at equal precision."""

MIN_BOXES = 50
"""Classes with fewer labels are reported, but not averaged: their figures are chance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassScores:
    """One class's figures, shares 0..1; NaN where there is no label, or nothing was found to be precise about.

    Attributes:
        n_images: images in which the class is completely labelled; the others do not count.
        n_boxes: labels to be found in them.
        ap50, ap50_95: average precision.
        precision, recall: of the detections at or above the working score, IoU >= 0.5.
        recall_at: recall at each of `PRECISIONS`: the largest at any score whose precision is that or more.
        best_score: the score at which F1, the harmonic mean of the two, would be largest.
        is_known: the detector has a name for this class.
        is_averaged: it is in the means.
    """

    n_images: int
    n_boxes: int
    ap50: float
    ap50_95: float
    precision: float
    recall: float
    recall_at: tuple[float, ...]
    best_score: float
    is_known: bool
    is_averaged: bool


@dataclass(frozen=True, slots=True)
class DetectionScores:
    """Figures of one detector by road class, and their plain means over the averaged classes."""

    by_class: Mapping[int, ClassScores]

    def mean(self, figure: str, class_id: Iterable[int] | None = None) -> float:
        """Mean of one figure over the averaged classes (of those given); NaN where there is none."""
        wanted = self.by_class if class_id is None else class_id
        values = [getattr(self.by_class[i], figure) for i in wanted if self.by_class[i].is_averaged]
        return float(np.mean(values)) if values else float("nan")

    def as_dict(self) -> dict[str, Any]:
        """For JSON: the means, what they are over, and every class by its name; None for NaN."""
        means = {key: _number(self.mean(key)) for key in ("ap50", "ap50_95", "precision", "recall")}
        classes = {
            ROAD_CLASSES[i]: {name: _number(getattr(each, name)) for name in ClassScores.__dataclass_fields__}
            | {"recall_at": dict(zip(map(str, PRECISIONS), map(_number, each.recall_at), strict=True))}
            for i, each in self.by_class.items()
        }
        averaged = [ROAD_CLASSES[i] for i, each in self.by_class.items() if each.is_averaged]
        return {**means, "averaged_classes": averaged, "classes": classes}


def _number(value: float) -> float | None:
    return None if isinstance(value, float) and np.isnan(value) else value


def evaluate_detections(
    found: Sequence[Detections],
    truth: Sequence[ImageTruth],
    *,
    working_score: FloatArray,
    known_class_id: IntArray,
    min_boxes: int = MIN_BOXES,
    min_height_px: float = 0.0,
) -> DetectionScores:
    """Figures of one detector, image by image in the same order.

    Args:
        found: everything of even the smallest score: what is missing there, is missing in the curve.
        truth: the labels of the same images.
        working_score: (8,) score by road class from which a detection would be used; for precision and recall.
        known_class_id: road classes that the detector has a name for; the others are not averaged.
        min_boxes: classes with fewer labels are not averaged.
        min_height_px: lower labels are ignored, and lower detections that meet none do not count (KITTI's rule).

    Raises:
        ValueError: not as many images in one as in the other.
    """
    if len(found) != len(truth):
        raise ValueError(f"found: {len(truth)} images wanted, as in truth, {len(found)} got")
    by_class = {}
    for class_id in range(len(ROAD_CLASSES)):
        pairs = [(f, t) for f, t in zip(found, truth, strict=True) if t.is_complete[class_id]]
        outcome = _Outcome.joined([_outcome(f, t, class_id, min_height_px) for f, t in pairs])
        if outcome.n_boxes or (class_id in known_class_id and len(outcome.score)):
            is_known = bool(class_id in known_class_id)
            by_class[class_id] = ClassScores(
                n_images=len(pairs),
                n_boxes=outcome.n_boxes,
                is_known=is_known,
                is_averaged=is_known and outcome.n_boxes >= min_boxes,
                **_figures(outcome, float(working_score[class_id])),
            )
    return DetectionScores(by_class)


@dataclass(frozen=True, slots=True)
class _Outcome:
    """Detections of one class in some images, best first in each, and what became of them at every IoU threshold.

    Attributes:
        score: (K,).
        is_hit: (10, K) took a label that counts.
        is_void: (10, K) took an ignored one.
        n_boxes: labels that count.
    """

    score: FloatArray
    is_hit: BoolArray
    is_void: BoolArray
    n_boxes: int

    @classmethod
    def joined(cls, parts: Sequence[_Outcome]) -> _Outcome:
        """All images' as one, best first."""
        if not parts:
            nothing = np.zeros((len(IOU_THRESHOLDS), 0), np.bool_)
            return cls(np.zeros(0), nothing, nothing, 0)
        score = np.concatenate([part.score for part in parts])
        order = np.argsort(-score, kind="stable")
        hits = np.concatenate([part.is_hit for part in parts], axis=1)[:, order]
        voids = np.concatenate([part.is_void for part in parts], axis=1)[:, order]
        return cls(score[order], hits, voids, sum(part.n_boxes for part in parts))


def _outcome(found: Detections, truth: ImageTruth, class_id: int, min_height_px: float) -> _Outcome:
    """One image and one class."""
    mine = np.flatnonzero(found.class_id == class_id)
    mine = mine[np.argsort(-found.score[mine], kind="stable")][:MAX_DETECTIONS]
    theirs = np.flatnonzero((truth.class_id == class_id) | (truth.class_id == ANY_CLASS))
    ignored, region = truth.is_ignored[theirs], truth.is_region[theirs]
    boxes, labels = found.xyxy_px[mine], truth.xyxy_px[theirs]
    ignored = ignored | (_height_px(labels) < min_height_px)
    overlap = np.where(region, share_inside(boxes, labels), iou(boxes, labels))
    is_hit = np.zeros((len(IOU_THRESHOLDS), len(mine)), np.bool_)
    is_void = np.zeros_like(is_hit)
    if len(theirs):
        _match(overlap, ignored=ignored, region=region, is_hit=is_hit, is_void=is_void)
    is_void |= ~is_hit & (_height_px(boxes) < min_height_px)
    return _Outcome(found.score[mine], is_hit, is_void, int(np.count_nonzero(~ignored)))


def _height_px(xyxy_px: FloatArray) -> FloatArray:
    return xyxy_px[:, 3] - xyxy_px[:, 1]


def _match(
    overlap: FloatArray, *, ignored: BoolArray, region: BoolArray, is_hit: BoolArray, is_void: BoolArray
) -> None:
    """Fill `is_hit` and `is_void` (10, K) from the overlaps (K, M) of detections, best first, with labels.

    Of equal overlaps the last label is taken, as pycocotools does.
    """
    enough = overlap[:, None, :] >= np.minimum(IOU_THRESHOLDS, 1 - 1e-10)[:, None]
    is_free = np.ones((len(IOU_THRESHOLDS), overlap.shape[1]), np.bool_)
    every = np.arange(len(IOU_THRESHOLDS))
    last = overlap.shape[1] - 1
    for i in np.flatnonzero(enough.any(axis=(1, 2))):
        may_take = enough[i] & is_free
        counts = may_take & ~ignored
        hit = counts.any(axis=1)
        choice = np.where(hit[:, None], counts, may_take)
        taken = last - np.where(choice, overlap[i], -1.0)[:, ::-1].argmax(axis=1)
        took = choice.any(axis=1)
        is_hit[:, i] = hit
        is_void[:, i] = took & ~hit
        is_free[every[took], taken[took]] = region[taken[took]]


def _figures(outcome: _Outcome, working_score: float) -> dict[str, Any]:
    hits = np.cumsum(outcome.is_hit, axis=1, dtype=np.float64)
    false_alarms = np.cumsum(~outcome.is_hit & ~outcome.is_void, axis=1, dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        precision, recall = hits / (hits + false_alarms), hits / outcome.n_boxes
        f1 = 2 * hits[0] / (hits[0] + false_alarms[0] + outcome.n_boxes)
    average = [_average_precision(p, r) if outcome.n_boxes else np.nan for p, r in zip(precision, recall, strict=True)]
    n_used = int(np.count_nonzero(outcome.score >= working_score))
    is_any = n_used > 0
    reached = [recall[0][precision[0] >= least] for least in PRECISIONS]
    return {
        "recall_at": tuple(float(r.max(initial=0.0)) if outcome.n_boxes else np.nan for r in reached),
        "ap50": float(average[0]),
        "ap50_95": float(np.mean(average)),
        "precision": float(precision[0, n_used - 1]) if is_any else np.nan,
        "recall": (float(recall[0, n_used - 1]) if is_any else 0.0) if outcome.n_boxes else np.nan,
        "best_score": float(outcome.score[f1.argmax()]) if len(f1) and outcome.n_boxes else np.nan,
    }


def _average_precision(precision: FloatArray, recall: FloatArray) -> float:
    """Mean over the recall points of the best precision from there on; (K,) each, by falling score."""
    best_from = np.maximum.accumulate(np.nan_to_num(precision)[::-1])[::-1]
    place = np.searchsorted(recall, RECALL_POINTS, side="left")
    return float(np.append(best_from, 0.0)[np.minimum(place, len(best_from))].mean())
