"""Average precision of detectors by COCO's protocol (pycocotools' COCOeval, all areas, 100 boxes
per image and class).

    p_interp(r) = max over r' >= r of p(r')      AP = mean of p_interp(r) over r = 0, 0.01, ..., 1
    AP50: AP at IoU >= 0.5                        AP50-95: mean AP over IoU >= 0.50, 0.55, ..., 0.95

Matching: `detection.evaluation.matching`.
(Lin et al., "Microsoft COCO", ECCV 2014; cocodataset.org/#detection-eval.)
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.evaluation.matching import ClassMatches, match_class
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.foundation.arrays import FloatArray, IntArray

RECALL_POINTS: FloatArray = np.linspace(0.0, 1.0, 101)  # as in COCO
# at which recalls are reported, so that detectors can be compared
PRECISIONS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
MIN_BOXES = 50  # of a class in the means; metrics from fewer labels vary too much


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassScores:
    """Scores of one class, as fractions 0..1; NaN without labels, precision also NaN without
    detections.
    """

    # number of images in which all objects of the class are labelled; other images are not
    # evaluated
    n_images: int
    n_boxes: int  # number of labels in these images, without labels to ignore
    ap50: float  # average precision
    ap50_95: float
    # of the detections at or above the confidence threshold, at IoU >= 0.5; so is the recall
    precision: float
    recall: float
    # (6,) for each of `PRECISIONS`, the largest recall with at least that precision
    recall_at: tuple[float, ...]
    # score threshold that maximises F1 = 2 precision recall / (precision + recall) at IoU >= 0.5
    best_score: float
    is_known: bool  # the detector has a name for this class
    is_averaged: bool  # the class is included in the means


@dataclass(frozen=True, slots=True)
class DetectionScores:
    """Scores of one detector by road class id, and their unweighted means over the averaged
    classes.
    """

    by_class: Mapping[int, ClassScores]

    def mean(self, figure: str, class_id: Iterable[int] | None = None) -> float:
        """Mean of a figure of `ClassScores` over the averaged classes (in `class_id`); NaN if there
        are none.
        """
        class_ids = self.by_class if class_id is None else class_id
        values = [
            getattr(self.by_class[i], figure) for i in class_ids if self.by_class[i].is_averaged
        ]
        return float(np.mean(values)) if values else float("nan")

    def as_dict(self) -> dict[str, Any]:
        """The means, the names of the averaged classes and all scores by class name, for JSON; None
        instead of NaN.
        """
        means = {
            key: json_number(self.mean(key)) for key in ("ap50", "ap50_95", "precision", "recall")
        }
        classes = {
            ROAD_CLASSES[i]: {
                name: json_number(getattr(scores, name))
                for name in ClassScores.__dataclass_fields__
            }
            | {
                "recall_at": dict(
                    zip(map(str, PRECISIONS), map(json_number, scores.recall_at), strict=True)
                )
            }
            for i, scores in self.by_class.items()
        }
        averaged = [ROAD_CLASSES[i] for i, scores in self.by_class.items() if scores.is_averaged]
        return {**means, "averaged_classes": averaged, "classes": classes}


def json_number(value: float) -> float | None:
    """A number for JSON: None instead of NaN."""
    return None if isinstance(value, float) and np.isnan(value) else value


def evaluate_detections(
    detections: Sequence[Detections],
    truth: Sequence[ImageTruth],
    *,
    working_score: FloatArray,
    known_class_id: IntArray,
    min_boxes: int = MIN_BOXES,
    min_height_px: float = 0.0,
) -> DetectionScores:
    """Scores of one detector on labelled images, from the detections of each image, down to very
    low scores.

    Precision and recall are at the thresholds `working_score` (8,) by road class. Classes without a
    name of the detector (`known_class_id`) or with fewer labels than `min_boxes` are excluded from
    the mean. Labels below `min_height_px` are ignored, and so are unmatched detections (KITTI's
    rule). Raises ValueError if `detections` and `truth` differ in length.
    """
    by_class = {}
    for class_id in range(len(ROAD_CLASSES)):
        (matches,) = match_class(detections, truth, class_id, min_height_px=min_height_px)
        if matches.n_boxes or (class_id in known_class_id and len(matches.score)):
            is_known = bool(class_id in known_class_id)
            by_class[class_id] = ClassScores(
                n_images=sum(bool(labels.is_complete[class_id]) for labels in truth),
                n_boxes=matches.n_boxes,
                is_known=is_known,
                is_averaged=is_known and matches.n_boxes >= min_boxes,
                **accuracy(matches, float(working_score[class_id])),
            )
    return DetectionScores(by_class)


def accuracy(matches: ClassMatches, working_score: float) -> dict[str, Any]:
    """The attributes of `ClassScores` that follow from the matches."""
    hits = np.cumsum(matches.is_hit, axis=1, dtype=np.float64)
    false_positives = np.cumsum(~matches.is_hit & ~matches.is_void, axis=1, dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        precision, recall = hits / (hits + false_positives), hits / matches.n_boxes
        f1 = 2 * hits[0] / (hits[0] + false_positives[0] + matches.n_boxes)
    average = [
        _average_precision(p, r) if matches.n_boxes else np.nan
        for p, r in zip(precision, recall, strict=True)
    ]
    n_used = int(np.count_nonzero(matches.score >= working_score))
    used_precision, used_recall = np.nan, 0.0
    if n_used:
        used_precision, used_recall = float(precision[0, n_used - 1]), float(recall[0, n_used - 1])
    reached = [recall[0][precision[0] >= least] for least in PRECISIONS]
    return {
        "recall_at": tuple(
            float(r.max(initial=0.0)) if matches.n_boxes else np.nan for r in reached
        ),
        "ap50": float(average[0]),
        "ap50_95": float(np.mean(average)),
        "precision": used_precision,
        "recall": used_recall if matches.n_boxes else np.nan,
        "best_score": float(matches.score[f1.argmax()]) if len(f1) and matches.n_boxes else np.nan,
    }


def _average_precision(precision: FloatArray, recall: FloatArray) -> float:
    p_interp = np.maximum.accumulate(np.nan_to_num(precision)[::-1])[::-1]
    index = np.searchsorted(recall, RECALL_POINTS, side="left")
    return float(np.append(p_interp, 0.0)[np.minimum(index, len(p_interp))].mean())
