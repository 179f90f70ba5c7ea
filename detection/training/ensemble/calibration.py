"""Probability that a fused box is an object of a class, from the scores of the detectors (logistic
regression).

    p_c = sigma(a_c + sum over detectors d of w_cd logit(s_dc)),    w_cd >= 0,    s_dc limited to [0.01, 0.99]

The coefficients maximise the likelihood of the matches y in {0, 1} of fused boxes with labels, in
the images in which class c is completely labelled, with a small ridge penalty:

    minimise over a, w: sum over boxes of (log(1 + exp(z)) - y z) + lambda (a^2 + |w|^2),    z = a + w logit(s)

which is Platt scaling with one slope per detector (Platt, "Probabilistic outputs for support vector
machines", 1999). The weight of a detector that does not know the class is 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, logit

from track_range.detection.boxes import iou
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.evaluation.score_calibration import Reliability
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.detection.training.ensemble.fusion import FusedBoxes
from track_range.detection.training.ensemble.views import MIN_SCORE
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray

# matches to fit a class; others have the mean coefficients of those that are fitted
MIN_POSITIVES = 20
N_BINS = 5  # of probability, in which the calibration is verified
# scores with finite log-odds; a detector without a box has the lowest one
_LOWEST, _HIGHEST = 0.01, 0.99
# lambda of the ridge penalty: the fit has a solution also where scores separate the matches
_RIDGE = 1e-3
_FIRST_WEIGHT = 0.4

_MATCH_IOU = 0.5  # of a fused box with the label of the same object


@dataclass(frozen=True, slots=True)
class Samples:
    """Fused boxes of one class, in images in which the class is completely labelled."""

    score: FloatArray  # (M, D) score of each detector
    is_match: BoolArray  # (M,) whether there is a label


@dataclass(frozen=True, slots=True)
class EnsembleCalibration:
    """Coefficients of the logistic regression by class."""

    intercept: FloatArray  # (8,) a_c
    weight: FloatArray  # (8, D) w_cd
    n_positives: IntArray  # (8,) matches from which a class was fitted; 0 = mean of the others

    def probability(self, score: FloatArray) -> FloatArray:
        """(K, 8) probability by class of boxes with the scores (K, D, 8); 0 for classes that were
        not detected.
        """
        x = logit(np.clip(score, _LOWEST, _HIGHEST))
        z = self.intercept + np.einsum("kdc,cd->kc", x, self.weight)
        return np.where(_is_detected(score), expit(z), 0.0)


def samples(
    images: Sequence[tuple[FusedBoxes, ImageTruth]], *, n_detectors: int, is_labelled: BoolArray
) -> list[Samples]:
    """The samples of each road class, from fused boxes and labels of each image as fractions of its
    size.

    `is_labelled` (8,) are the classes that the labels have; other classes have no samples.
    """
    listed = []
    for class_id in range(len(ROAD_CLASSES)):
        parts = [(np.zeros((0, n_detectors)), np.zeros(0, np.bool_))]
        for fused, truth in images:
            if truth.is_complete[class_id] and is_labelled[class_id]:
                used = _is_detected(fused.score)[:, class_id]
                parts.append(
                    (fused.score[used, :, class_id], matches(fused, truth, class_id)[used])
                )
        listed.append(Samples(*(np.concatenate(column) for column in zip(*parts, strict=True))))
    return listed


def matches(fused: FusedBoxes, truth: ImageTruth, class_id: int) -> BoolArray:
    """(K,) whether a fused box matches a label of a class.

    In order of decreasing best score, a box matches the label with which its IoU is largest, if
    that is at least 0.5 and no better box matches this label. A box whose label is taken does not
    match another one, as it does in `evaluation.matching` (COCO): of two boxes of one object, the
    worse one should be a negative sample, even in a crowd.
    """
    is_match = np.zeros(len(fused.xyxy), np.bool_)
    labels = truth.xyxy_px[(truth.class_id == class_id) & ~truth.is_ignored]
    if not len(labels) or not len(is_match):
        return is_match
    overlap = iou(fused.xyxy, labels)
    nearest = overlap.argmax(axis=1)
    order = np.argsort(-fused.score[:, :, class_id].max(axis=1), kind="stable")
    candidates = order[overlap[order, nearest[order]] >= _MATCH_IOU]
    _, best = np.unique(nearest[candidates], return_index=True)  # the first of each label
    is_match[candidates[best]] = True
    return is_match


def fit_calibration(by_class: Sequence[Samples], is_known: BoolArray) -> EnsembleCalibration | None:
    """Coefficients fitted to the samples of each road class; None if no class has enough matches.

    A class with fewer than `MIN_POSITIVES` matches has the mean coefficients of the other classes;
    the weights of detectors that do not know the class are distributed over the other detectors.
    `is_known` (D, 8) are the classes that each detector knows.
    """
    n_positives = np.array([np.count_nonzero(boxes.is_match) for boxes in by_class])
    is_fitted = (n_positives >= MIN_POSITIVES) & is_known.any(axis=0)
    if not is_fitted.any():
        return None
    intercept, weight = np.zeros(len(by_class)), np.zeros((len(by_class), len(is_known)))
    for class_id, boxes in enumerate(by_class):
        if is_fitted[class_id]:
            intercept[class_id], weight[class_id] = _logistic_regression(
                boxes, is_known[:, class_id]
            )
    mean_weight = weight[is_fitted].mean(axis=0)
    known_weight = np.where(is_known, mean_weight[:, None], 0.0)
    total = known_weight.sum(axis=0)
    shared = known_weight * np.divide(
        mean_weight.sum(), total, out=np.zeros_like(total), where=total > 0
    )
    weight[~is_fitted] = shared.T[~is_fitted]
    intercept[~is_fitted] = intercept[is_fitted].mean()
    return EnsembleCalibration(intercept, weight, np.where(is_fitted, n_positives, 0))


def reliability(calibration: EnsembleCalibration, boxes: Samples, class_id: int) -> Reliability:
    """Probabilities and matches of one class in `N_BINS` bins, from samples that were not used in
    the fit.
    """
    score = np.zeros((len(boxes.score), boxes.score.shape[1], len(ROAD_CLASSES)))
    score[:, :, class_id] = boxes.score
    p = calibration.probability(score)[:, class_id]
    return Reliability.of(p, boxes.is_match, n_bins=N_BINS)


def _is_detected(score: FloatArray) -> BoolArray:
    """(K, 8) whether a detector's score (K, D, 8) of a class exceeds the lowest score."""
    return np.asarray(score.max(axis=1, initial=0.0) > MIN_SCORE)


def _logistic_regression(boxes: Samples, is_known: BoolArray) -> tuple[float, FloatArray]:
    x = logit(np.clip(boxes.score, _LOWEST, _HIGHEST))
    design, y = np.column_stack([x, np.ones(len(x))]), boxes.is_match.astype(np.float64)

    def loss(w: FloatArray) -> tuple[float, FloatArray]:
        z = design @ w
        value = float((np.logaddexp(0.0, z) - y * z).sum() + _RIDGE * w @ w)
        return value, design.T @ (expit(z) - y) + 2.0 * _RIDGE * w

    first = np.append(np.where(is_known, _FIRST_WEIGHT, 0.0), 0.0)
    bounds = [(0.0, None if known else 0.0) for known in is_known] + [(None, None)]
    w = minimize(loss, first, jac=True, method="L-BFGS-B", bounds=bounds).x
    return float(w[-1]), np.asarray(w[:-1])
