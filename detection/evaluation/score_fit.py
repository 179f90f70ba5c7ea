"""Fit of the scores of a detector to labelled images, so that they are probabilities (Platt scaling by class).

    p = sigma(a_c logit(s) + b_c),    a_c = exp(alpha + alpha_c) > 0,    b_c = beta + beta_c

for a detection of class c with score s. The coefficients maximise the likelihood of the matches of the detections with
labels, with penalties that pull the common coefficients towards the identity and each class towards the common
coefficients:

    minimise   sum over detections of (log(1 + exp(z)) - t z) + 2 (alpha^2 + sum over c of (4 alpha_c^2 + beta_c^2))
    z = a_c logit(s) + b_c
    t = (n+ + 1) / (n+ + 2) for matches, 1 / (n- + 2) for others; n+ and n- are their numbers in the class

The targets t replace 1 and 0, as in Platt's paper: otherwise, scores that separate the samples would become 0 and 1.
Classes with fewer than `MIN_POSITIVES` matches have the coefficients exp(alpha) and beta, fitted without the detections
of these classes, unless all classes have too few. (Platt, "Probabilistic outputs for support vector machines", 1999;
for detectors: Küppers et al., "Multivariate Confidence Calibration for Object Detection", 2020.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, logit

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.evaluation.matching import match_class
from track_range.detection.evaluation.score_calibration import MIN_SCORE, Reliability
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray

# of the detections to be fitted: lower ones, far below any threshold, would dominate the fit
LOWEST_SCORE = 0.02
BACKGROUND_SCORE = 1e-4  # a score of background, of which an image has thousands of boxes
MIN_POSITIVES = 40  # minimum number of matches for which a class has its own coefficients
_SHARED_PENALTY, _SLOPE_PENALTY, _OFFSET_PENALTY = 2.0, 8.0, 2.0  # of alpha, alpha_c and beta_c
_N_BLOCKS = 10  # of successive images in the cross-validation
_LIMIT = 1e-4  # distance of a score from 0 and 1, so that its logit is finite


@dataclass(frozen=True, slots=True)
class ScoreSamples:
    """Detections of all classes in images in which their class is completely labelled."""

    class_id: IntArray  # (K,) road class
    score: FloatArray  # (K,) score
    is_match: BoolArray  # (K,) whether the detection matches a label at an IoU of 0.5 or more

    @classmethod
    def of(
        cls, detections: Sequence[Detections], truth: Sequence[ImageTruth], known_class_id: IntArray
    ) -> ScoreSamples:
        """The samples of detections (one item per image) and labels, matched as for the average
        precision.
        """
        parts = [(np.zeros(0, np.int64), np.zeros(0), np.zeros(0, np.bool_))]
        for class_id in range(len(ROAD_CLASSES)):
            matches = match_class(detections, truth, class_id)[0]
            if class_id in known_class_id and matches.n_boxes:
                used = ~matches.is_void[0] & (matches.score >= LOWEST_SCORE)
                score = matches.score[used]
                parts.append((np.full(len(score), class_id), score, matches.is_hit[0, used]))
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))


@dataclass(frozen=True, slots=True)
class ScoreFit:
    """Coefficients by road class."""

    slope: FloatArray  # (8,) a_c
    offset: FloatArray  # (8,) b_c
    shared: tuple[float, float]  # a and b that classes without their own coefficients share
    n_positives: IntArray  # (8,) number of matches of each class in the fit

    def probability(self, score: FloatArray, class_id: IntArray) -> FloatArray:
        """(K,) probability of detections with scores (K,) of classes (K,)."""
        return np.asarray(expit(self.slope[class_id] * _logit(score) + self.offset[class_id]))

    def as_dict(self) -> Mapping[str, Mapping[str, float]]:
        """Slope, offset and number of matches by class name, for JSON."""
        columns = self.slope.tolist(), self.offset.tolist(), self.n_positives.tolist()
        keys = ("slope", "offset", "n_positives")
        rows = zip(ROAD_CLASSES, zip(*columns, strict=True), strict=True)
        return {name: dict(zip(keys, row, strict=True)) for name, row in rows}


def fit_scores(samples: ScoreSamples) -> ScoreFit | None:
    """The coefficients for samples; None if fewer than `MIN_POSITIVES` samples, or all samples, are
    matches.
    """
    n_classes = len(ROAD_CLASSES)
    n_positives = np.bincount(samples.class_id[samples.is_match], minlength=n_classes)
    if n_positives.sum() < MIN_POSITIVES or samples.is_match.all():
        return None
    has_own = n_positives >= MIN_POSITIVES
    used = has_own[samples.class_id] | ~has_own.any()
    class_id = samples.class_id[used]
    x = _logit(samples.score[used])
    is_match = samples.is_match[used]
    n_true, n_false = (
        np.bincount(class_id[mask], minlength=n_classes)[class_id] for mask in (is_match, ~is_match)
    )
    target = np.where(is_match, (n_true + 1) / (n_true + 2), 1 / (n_false + 2))
    penalty = np.concatenate(
        [[_SHARED_PENALTY, 0.0], np.repeat([_SLOPE_PENALTY, _OFFSET_PENALTY], n_classes)]
    )

    def coefficients(w: FloatArray) -> tuple[FloatArray, FloatArray]:
        own = w[2:].reshape(2, n_classes) * has_own
        return np.exp(w[0] + own[0]), w[1] + own[1]

    def loss(w: FloatArray) -> tuple[float, FloatArray]:
        slope, offset = coefficients(w)
        z = slope[class_id] * x + offset[class_id]
        residual = expit(z) - target
        by_class = np.stack(
            [
                np.bincount(class_id, residual * part, n_classes)
                for part in (slope[class_id] * x, np.ones_like(x))
            ]
        )
        gradient = np.concatenate([by_class.sum(axis=1), (by_class * has_own).ravel()])
        value = float((np.logaddexp(0.0, z) - target * z).sum() + (penalty * w**2).sum())
        return value, gradient + 2 * penalty * w

    w = minimize(loss, np.zeros(2 + 2 * n_classes), jac=True, method="L-BFGS-B").x
    slope, offset = coefficients(w)
    return ScoreFit(slope, offset, (float(np.exp(w[0])), float(w[1])), n_positives)


def cross_validated(
    detections: Sequence[Detections], truth: Sequence[ImageTruth], known_class_id: IntArray
) -> Reliability | None:
    """Reliability of scores that were fitted to the other half of the images; None if a half is too
    small to fit.

    The halves consist of alternate blocks of successive images, so that few images have neighbours
    in the other half.
    """
    half = np.arange(len(truth)) * _N_BLOCKS // max(len(truth), 1) % 2
    rows = [np.flatnonzero(half == i).tolist() for i in range(2)]
    halves = [
        ScoreSamples.of([detections[k] for k in own], [truth[k] for k in own], known_class_id)
        for own in rows
    ]
    scores = []
    for own, other in (halves, halves[::-1]):
        if (fit := fit_scores(other)) is None:
            return None
        scores.append(fit.probability(own.score, own.class_id))
    return reliability(np.concatenate(scores), np.concatenate([own.is_match for own in halves]))


def reliability(score: FloatArray, is_match: BoolArray) -> Reliability:
    """Reliability of the detections with a score of at least `score_calibration.MIN_SCORE`."""
    used = score >= MIN_SCORE
    return Reliability.of(score[used], is_match[used])


def _logit(score: FloatArray) -> FloatArray:
    return np.asarray(logit(np.clip(score, _LIMIT, 1.0 - _LIMIT)))
