"""Calibration of detection scores: does a box with a score of 0.7 match an object in 70 % of the
cases?

The detections D of a detector, after its non-maximum suppression and down to a lowest score, are
grouped into M bins B_1 ... B_M of equal width by their score:

    conf(m) = mean score in B_m        prec(m) = fraction of B_m that matches a label at IoU >= 0.5
    ECE = sum over m of |B_m| / |D| |prec(m) - conf(m)|        MCE = max over m of |prec(m) - conf(m)|

This is the expected calibration error of Guo et al., "On Calibration of Modern Neural Networks"
(ICML 2017), with the precision of detections in place of the accuracy of a classifier: the D-ECE of
Küppers et al., "Multivariate Confidence Calibration for Object Detection" (CVPR Workshops 2020),
for bins of the score alone. A plot of prec over conf is the reliability diagram. Objects without a
detection do not count: calibration is no measure of recall.

The ECE of few detections is above zero even if their scores are calibrated, by chance. With score
s_i the probability of a match, prec(m) - conf(m) has the variance v_m = sum over B_m of s_i (1 -
s_i) / |B_m|^2 and, if it is normal, the mean magnitude sqrt(2 v_m / pi); the weighted sum of these
is the expected ECE of a calibrated detector.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.evaluation.average_precision import json_number
from track_range.detection.evaluation.matching import ClassMatches, match_class
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray

N_BINS = 10
# of the detections: the many boxes below it, which no tracker uses, would dominate the ECE
MIN_SCORE = 0.05
MIN_IOU = 0.5


@dataclass(frozen=True, slots=True)
class Reliability:
    """Scores and precision of detections by bins of the score; the bins divide [0, 1] into equal
    parts.
    """

    n: IntArray  # (M,) number of detections
    n_true: IntArray  # (M,) number of those that match a label
    mean_score: FloatArray  # (M,) mean score; NaN in empty bins
    # (M,) of the number of matches if the scores are their probabilities: sum of s (1 - s)
    variance: FloatArray

    @classmethod
    def of(cls, score: FloatArray, is_true: BoolArray, *, n_bins: int = N_BINS) -> Reliability:
        """Reliability of detections with scores (K,) in [0, 1], some of which, in the mask (K,),
        match a label.
        """
        if n_bins < 1:
            raise ValueError(f"n_bins: expected at least 1, got {n_bins}")
        # a score of 1 is in the last bin
        index = np.minimum((score * n_bins).astype(np.int64), n_bins - 1)
        n = np.bincount(index, minlength=n_bins)
        with np.errstate(invalid="ignore"):
            mean_score = np.bincount(index, weights=score, minlength=n_bins) / n
        return cls(
            n,
            np.bincount(index[is_true], minlength=n_bins),
            mean_score,
            np.asarray(
                np.bincount(index, weights=score * (1.0 - score), minlength=n_bins), np.float64
            ),
        )

    @property
    def edges(self) -> FloatArray:
        """(M + 1,) limits of the bins."""
        return np.linspace(0.0, 1.0, len(self.n) + 1)

    @property
    def precision(self) -> FloatArray:
        """(M,) fraction of the detections that match a label; NaN in empty bins."""
        with np.errstate(invalid="ignore"):
            return np.asarray(self.n_true / self.n)

    @property
    def ece(self) -> float:
        """Expected calibration error, 0 to 1; NaN without detections."""
        return self._weighted_mean(np.abs(self.precision - self.mean_score))

    @property
    def mce(self) -> float:
        """Maximum calibration error over the bins, 0 to 1; NaN without detections. Bins of few
        detections dominate.
        """
        gaps = np.abs(self.precision - self.mean_score)[self.n > 0]
        return float(gaps.max()) if len(gaps) else float("nan")

    @property
    def ece_if_calibrated(self) -> float:
        """ECE expected by chance for the same number of calibrated scores; NaN without
        detections.
        """
        with np.errstate(invalid="ignore"):
            return self._weighted_mean(np.sqrt(2.0 / np.pi * self.variance) / self.n)

    @property
    def overconfidence(self) -> float:
        """Mean score minus precision over all detections, -1 to 1; NaN without detections."""
        return self._weighted_mean(self.mean_score - self.precision)

    def _weighted_mean(self, by_bin: FloatArray) -> float:
        used = self.n > 0
        return float(np.average(by_bin[used], weights=self.n[used])) if used.any() else float("nan")

    def as_dict(self) -> dict[str, Any]:
        """The errors and the bins, for JSON; None instead of NaN."""
        columns = (
            self.edges[:-1],
            self.edges[1:],
            self.n,
            self.n_true,
            self.mean_score,
            self.precision,
        )
        keys = ("from", "to", "n", "n_true", "mean_score", "precision")
        bins = zip(*(map(json_number, column.tolist()) for column in columns), strict=True)
        return {
            "n": int(self.n.sum()),
            "mean_score": json_number(self._weighted_mean(self.mean_score)),
            "precision": json_number(self._weighted_mean(self.precision)),
            "overconfidence": json_number(self.overconfidence),
            "ece": json_number(self.ece),
            "ece_if_calibrated": json_number(self.ece_if_calibrated),
            "mce": json_number(self.mce),
            "bins": [dict(zip(keys, values, strict=True)) for values in bins],
        }


@dataclass(frozen=True, slots=True)
class ScoreCalibration:
    """Reliability of one detector's scores."""

    min_score: float  # lowest score of the detections
    overall: Reliability  # reliability of the detections of all these classes together
    by_class: Mapping[int, Reliability]  # by road class id, of the known classes that are labelled

    def as_dict(self) -> dict[str, Any]:
        """Errors and bins of all classes together ("all") and by class name, for JSON."""
        return {
            "min_score": self.min_score,
            "min_iou": MIN_IOU,
            "all": self.overall.as_dict(),
            "classes": {
                ROAD_CLASSES[i]: reliability.as_dict() for i, reliability in self.by_class.items()
            },
        }


def evaluate_calibration(
    detections: Sequence[Detections],
    truth: Sequence[ImageTruth],
    *,
    known_class_id: IntArray,
    min_score: float = MIN_SCORE,
    n_bins: int = N_BINS,
    min_height_px: float = 0.0,
) -> ScoreCalibration:
    """Calibration of the scores of one detector on labelled images.

    Detections are matched as for the average precision; detections matched with labels to ignore
    are left out.

    Example:
        >>> import numpy as np, track_range as tr
        >>> cars = tr.Detections.of([[0, 0, 50, 40], [100, 0, 150, 40]], [0.75, 0.25], [2, 2])
        >>> truth = tr.evaluate.ImageTruth.of([[0, 0, 50, 40]], [2])
        >>> calibration = tr.evaluate.score_calibration([cars], [truth], known_class_id=np.arange(8))
        >>> calibration.overall.ece  # a box of 0.75 that is right, one of 0.25 that is wrong
        0.25

    Args:
        detections: the detections of each image.
        truth: the labels of each image, in the same order.
        known_class_id: road classes that the detector has a name for.
        min_score: detections below this score are left out.
        n_bins: number of bins of the score between 0 and 1.
        min_height_px: smaller labels are ignored, and so are smaller unmatched detections.

    Raises ValueError: `detections` and `truth` differ in length, or `n_bins` is less than 1.
    """
    matches = {
        class_id: match_class(detections, truth, class_id, min_height_px=min_height_px)[0]
        for class_id in range(len(ROAD_CLASSES))
        if class_id in known_class_id
    }
    matches = {class_id: by_class for class_id, by_class in matches.items() if by_class.n_boxes}
    return ScoreCalibration(
        min_score,
        _reliability(ClassMatches.concatenate(list(matches.values())), min_score, n_bins),
        {
            class_id: _reliability(by_class, min_score, n_bins)
            for class_id, by_class in matches.items()
        },
    )


def _reliability(matches: ClassMatches, min_score: float, n_bins: int) -> Reliability:
    """Reliability of the counted detections; the first IoU threshold is `MIN_IOU`."""
    is_counted = ~matches.is_void[0] & (matches.score >= min_score)
    return Reliability.of(matches.score[is_counted], matches.is_hit[0, is_counted], n_bins=n_bins)
