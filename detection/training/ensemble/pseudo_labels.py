"""Pseudo-labels of one image: the fused boxes that supplement its labels, with their probabilities.

A class that is not completely labelled in the image gets the boxes of at least a minimum probability. A completely
labelled class gets boxes of high probability that overlap no label, which training ignores: they are probably objects
without a label, or objects of a kind that the data set does not count.

Detections of a detector that is not at hand can be combined with the ensemble, as another opinion of equal weight on
the classes that are not completely labelled. With its score s, or s = 0.12 where it has no box,

    q = sigma((logit(p) + logit(s)) / 2), and at least 0.6 s where it has a box;    0.75 s where the ensemble has none
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logit

from track_range.detection.boxes import iou
from track_range.detection.classes import ROAD_CLASSES, map_to_road_classes
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.detection.formats.image_labels.yolo_labels import YoloLabels
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, check_shape

MIN_IGNORED_PROBABILITY = 0.6
"""Minimum probability of a box of a completely labelled class."""

_SAME_OBJECT_IOU = 0.5  # IoU above which a box is that of a label, or that of the other detector

_MISSING_SCORE = 0.12
"""Score of the other detector where it has no box, about half of the lowest score that is usually stored, 0.25."""

_LOWEST, _HIGHEST = 0.02, 0.98  # limits of the probabilities that are combined, so that log-odds are finite
_LEAST_FRACTION = 0.6  # fraction of the other detector's score that its boxes have at least

_ALONE_FRACTION = 0.75
"""Fraction of the other detector's score that its boxes have where the ensemble, which knows the class, has none."""


@dataclass(frozen=True, slots=True)
class PseudoLabels:
    """The K pseudo-labels of one image."""

    xyxy: FloatArray  # (K, 4) left, top, right, bottom as fractions of the image size
    class_id: IntArray  # (K,) road class
    probability: FloatArray  # (K,) probability that there is such an object
    is_ignored: BoolArray  # (K,) the class is completely labelled, so that training ignores the box

    def __post_init__(self) -> None:
        n = len(self.class_id)
        check_shape("xyxy", self.xyxy, (n, 4))
        for name in ("probability", "is_ignored"):
            check_shape(name, getattr(self, name), (n,))

    def as_text(self, names: Sequence[str]) -> str:
        """Lines `class cx cy w h probability` with the class numbers of `names`, without classes that have no name."""
        road = map_to_road_classes(names).tolist()
        centre, size = (self.xyxy[:, :2] + self.xyxy[:, 2:]) / 2, self.xyxy[:, 2:] - self.xyxy[:, :2]
        return "".join(
            f"{road.index(class_id)} {x:.6f} {y:.6f} {w:.6f} {h:.6f} {p:.3f}\n"
            for class_id, (x, y), (w, h), p in zip(
                self.class_id.tolist(), centre.tolist(), size.tolist(), self.probability.tolist(), strict=True
            )
            if class_id in road
        )


def pseudo_labels(
    xyxy: FloatArray,
    probability: FloatArray,
    truth: ImageTruth,
    *,
    is_known: BoolArray,
    other: YoloLabels | None = None,
    min_probability: float = 0.1,
) -> PseudoLabels:
    """The pseudo-labels of one image; none of them overlaps a label by an IoU of more than 0.5.

    Args:
        xyxy: (K, 4) fused boxes, as fractions of the image size.
        probability: (K, 8) their probabilities by class.
        truth: labels of the image, as fractions of its size, and which classes are completely labelled.
        is_known: (8,) classes that a detector of the ensemble knows; its boxes of others are not used.
        other: detections of a detector that is not at hand, on the same image.
        min_probability: that of pseudo-labels of classes that are not completely labelled.
    """
    is_open = is_known & ~truth.is_complete
    q = probability
    if other is not None:
        q = np.where(is_open, _combined(xyxy, probability, other), probability)
    minimum = np.where(truth.is_complete, MIN_IGNORED_PROBABILITY, min_probability)
    box, class_id = np.nonzero((q >= minimum) & (q > 0) & is_known)
    boxes, classes, p = xyxy[box], class_id, q[box, class_id]
    if other is not None:
        alone = ~truth.is_complete[other.class_id]
        alone &= ~(is_open[other.class_id] & (iou(xyxy, other.xyxy) > _SAME_OBJECT_IOU).any(axis=0))
        p_alone = other.score * np.where(is_known, _ALONE_FRACTION, 1.0)[other.class_id]
        alone &= p_alone >= min_probability
        boxes = np.concatenate([boxes, other.xyxy[alone]])
        classes = np.concatenate([classes, other.class_id[alone]])
        p = np.concatenate([p, p_alone[alone]])
    boxes = np.clip(boxes, 0.0, 1.0)
    is_new = iou(boxes, truth.xyxy_px).max(axis=1, initial=0.0) <= _SAME_OBJECT_IOU
    return PseudoLabels(boxes[is_new], classes[is_new], p[is_new], truth.is_complete[classes[is_new]])


def _combined(xyxy: FloatArray, probability: FloatArray, other: YoloLabels) -> FloatArray:
    """(K, 8) mean log-odds of the fused boxes' probabilities and another detector's; 0 where neither has the class."""
    other_score = np.zeros((len(xyxy), len(ROAD_CLASSES)))
    box, detection = np.nonzero(iou(xyxy, other.xyxy) > _SAME_OBJECT_IOU)
    np.maximum.at(other_score, (box, other.class_id[detection]), other.score[detection])
    is_seen = other_score > 0
    s = np.where(is_seen, np.minimum(other_score, _HIGHEST), _MISSING_SCORE)
    p = np.clip(probability, _LOWEST, _HIGHEST)
    q = expit((logit(p) + logit(s)) / 2)
    q = np.where(is_seen, np.maximum(q, _LEAST_FRACTION * s), q)
    return np.where(is_seen | (probability > 0), q, 0.0)
