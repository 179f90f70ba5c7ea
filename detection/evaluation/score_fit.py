"""Fit of the scores of a detector to labelled images, so that they are probabilities (Platt scaling by class).

    p = sigma(a_c logit(s) + b_c),    a_c = a + a'_c,    b_c = b + b'_c

for a detection of class c with score s. The coefficients maximise the likelihood of the matches y in {0, 1} of the
detections with labels, with a penalty that draws each class to the coefficients that all classes share:

    minimise sum over detections of (log(1 + exp(z)) - y z) + sum over c of (8 a'_c^2 + 2 b'_c^2)
    z = a_c logit(s) + b_c

Classes with fewer than `MIN_POSITIVES` matches have the coefficients a and b, fitted without their detections unless no
class has more. (Platt, "Probabilistic outputs for support vector
machines", 1999; for detectors: Küppers et al., "Multivariate Confidence Calibration for Object Detection", 2020.)
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

LOWEST_SCORE = 0.02
"""Lowest score of the detections to be fitted: lower ones are far below any threshold, and would dominate the fit."""

MIN_POSITIVES = 40
"""Minimum number of matches for which a class has its own coefficients."""

_SLOPE_PENALTY, _OFFSET_PENALTY = 8.0, 2.0
"""Penalties of a class's deviation from the shared slope and offset."""

_LIMIT = 1e-4
"""Smallest distance of a score from 0 and 1, so that its logit is finite."""


@dataclass(frozen=True, slots=True)
class ScoreSamples:
    """Detections of all classes in images in which the class is completely labelled.

    Attributes:
        class_id: (K,) road class.
        score: (K,) score.
        is_match: (K,) whether the detection matches a label at an IoU of 0.5 or more.
    """

    class_id: IntArray
    score: FloatArray
    is_match: BoolArray

    @classmethod
    def of(
        cls, detections: Sequence[Detections], truth: Sequence[ImageTruth], known_class_id: IntArray
    ) -> ScoreSamples:
        """The samples of detections (one item per image) and labels, matched as for the average precision.

        Args:
            detections: the detections of each image.
            truth: the labels of each image, in the same order.
            known_class_id: road classes that the detector has a name for.

        Raises:
            ValueError: `detections` and `truth` differ in length.
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
    """Coefficients by road class.

    Attributes:
        slope: (8,) a_c.
        offset: (8,) b_c.
        n_positives: (8,) number of matches of each class in the fit.
    """

    slope: FloatArray
    offset: FloatArray
    n_positives: IntArray

    def probability(self, score: FloatArray, class_id: IntArray) -> FloatArray:
        """(K,) probability of detections with scores (K,) of classes (K,)."""
        return np.asarray(expit(self.slope[class_id] * _logit(score) + self.offset[class_id]))


def fit_scores(samples: ScoreSamples) -> ScoreFit | None:
    """The coefficients for samples; None if fewer than `MIN_POSITIVES` of them, or all of them, are matches."""
    n_classes = len(ROAD_CLASSES)
    n_positives = np.bincount(samples.class_id[samples.is_match], minlength=n_classes)
    if n_positives.sum() < MIN_POSITIVES or samples.is_match.all():
        return None
    has_own = n_positives >= MIN_POSITIVES
    used = has_own[samples.class_id] | ~has_own.any()
    class_id, x, y = samples.class_id[used], _logit(samples.score[used]), samples.is_match[used].astype(np.float64)

    def coefficients(w: FloatArray) -> tuple[FloatArray, FloatArray]:
        own = w[2:].reshape(2, n_classes) * has_own
        return w[0] + own[0], w[1] + own[1]

    def loss(w: FloatArray) -> tuple[float, FloatArray]:
        slope, offset = coefficients(w)
        z = slope[class_id] * x + offset[class_id]
        own = w[2:].reshape(2, n_classes)
        penalty = np.array([[_SLOPE_PENALTY], [_OFFSET_PENALTY]])
        residual = expit(z) - y
        by_class = np.stack([np.bincount(class_id, residual * values, n_classes) for values in (x, np.ones_like(x))])
        gradient = by_class * has_own + 2 * penalty * own
        value = float((np.logaddexp(0.0, z) - y * z).sum() + (penalty * own**2).sum())
        return value, np.concatenate([by_class.sum(axis=1), gradient.ravel()])

    first = np.concatenate([[1.0, 0.0], np.zeros(2 * n_classes)])
    slope, offset = coefficients(minimize(loss, first, jac=True, method="L-BFGS-B").x)
    return ScoreFit(slope, offset, n_positives)


def cross_validated(
    detections: Sequence[Detections], truth: Sequence[ImageTruth], known_class_id: IntArray
) -> Reliability | None:
    """Reliability of scores that were fitted to the other half of the images; None if a half is too small to fit.

    The halves are the images with even and with odd number, so that neighbours in a sequence are in different halves.
    """
    halves = [ScoreSamples.of(detections[i::2], truth[i::2], known_class_id) for i in range(2)]
    scores, is_match = [], []
    for own, other in (halves, halves[::-1]):
        fit = fit_scores(other)
        if fit is None:
            return None
        scores.append(fit.probability(own.score, own.class_id))
        is_match.append(own.is_match)
    return reliability(np.concatenate(scores), np.concatenate(is_match))


def reliability(score: FloatArray, is_match: BoolArray) -> Reliability:
    """Reliability of the detections with a score of at least `score_calibration.MIN_SCORE`."""
    used = score >= MIN_SCORE
    return Reliability.of(score[used], is_match[used])


def as_dict(fit: ScoreFit) -> Mapping[str, Mapping[str, float]]:
    """Slope, offset and number of matches by class name, for JSON."""
    return {
        name: {"slope": float(fit.slope[i]), "offset": float(fit.offset[i]), "n_positives": int(fit.n_positives[i])}
        for i, name in enumerate(ROAD_CLASSES)
    }


def _logit(score: FloatArray) -> FloatArray:
    return np.asarray(logit(np.clip(score, _LIMIT, 1.0 - _LIMIT)))
