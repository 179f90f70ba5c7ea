"""Cross-validation of fitted methods over sequences: each fold is measured by a method that was
fitted to the other sequences.
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from track_range.foundation.arrays import BoolArray
from track_range.ranging.size_models.plain_curves import CurveFitter
from track_range.ranging.truth.errors import MethodColumn
from track_range.ranging.truth.labelled_boxes import BoxSet

N_FOLDS = 7  # folds of the cross-validation: 3 of KITTI's 21 sequences each
MIN_PLAIN_SAMPLES = 20  # smallest number of boxes of a class to which a plain curve is fitted

Predictor = Callable[[BoxSet], MethodColumn]  # function that measures boxes
Fitter = Callable[[BoxSet], Predictor]  # function that fits a predictor to boxes
# fits a method to training boxes, measures boxes
Scheme = Callable[[BoxSet, BoxSet, Fitter], MethodColumn]


def folds(boxes: BoxSet, n_folds: int = N_FOLDS) -> Iterator[BoolArray]:
    """Masks (N,) of the boxes of each fold: every `n_folds`-th sequence, or single sequences if
    there are fewer.
    """
    for fold in range(min(n_folds, len(boxes.sequence_names))):
        left_out = boxes.sequence % n_folds == fold
        if left_out.any():
            yield left_out


def cross_validated(boxes: BoxSet, train: BoxSet, fit: Fitter) -> MethodColumn:
    """Distances and sigmas of `boxes`, with each fold measured by a method fitted to the other
    sequences of `train`.

    `train` has boxes of the same sequences, for example without noise; a single sequence is fitted
    to itself.
    """
    parts = []
    for test in folds(boxes):
        others = train.select(~np.isin(train.sequence, np.unique(boxes.sequence[test])))
        parts.append((test, fit(others if len(others) else train)(boxes.select(test))))
    return _combined(parts, len(boxes))


def within_drives(boxes: BoxSet, train: BoxSet, fit: Fitter) -> MethodColumn:
    """Distances and sigmas of `boxes`, with each sequence measured by a method fitted to the same
    sequence of `train`.

    This is the protocol of Zhang et al. It shows how well a curve can fit, and not the error on
    other drives.
    """
    parts = []
    for number in np.unique(boxes.sequence):
        test = boxes.sequence == number
        parts.append((test, fit(train.select(train.sequence == number))(boxes.select(test))))
    return _combined(parts, len(boxes))


def held_out(boxes: BoxSet, train: BoxSet, fit: Fitter) -> MethodColumn:
    """Distances and sigmas of `boxes` by a method fitted to `train`, which has no image in common
    with `boxes`.
    """
    return fit(train)(boxes)


def _combined(parts: Sequence[tuple[BoolArray, MethodColumn]], n: int) -> MethodColumn:
    """Column of n rows from the columns of parts of the rows; NaN for unknown sigmas."""
    distance_m, sigma_m, systematic_m = np.full((3, n), np.nan)
    for rows, part in parts:
        distance_m[rows], sigma_m[rows] = part.distance_m, part.sigma_m
        systematic_m[rows] = np.nan if part.sigma_systematic_m is None else part.sigma_systematic_m
    return MethodColumn(
        distance_m, sigma_m, systematic_m if np.isfinite(systematic_m).any() else None
    )


def plain_fitter(fit_curve: CurveFitter) -> Fitter:
    """Fitter of one plain curve per class, without sigma; classes with too few training boxes are
    not measured.
    """

    def fit(train: BoxSet) -> Predictor:
        fitted = {}
        for name in np.unique(train.class_name):
            samples = train.select(train.class_name == name)
            if len(samples) >= MIN_PLAIN_SAMPLES:
                fitted[name] = fit_curve(samples.wh_over_f, samples.bearing, samples.distance_m)

        def predict(boxes: BoxSet) -> MethodColumn:
            distance_m = np.full(len(boxes), np.nan)
            for name, curve in fitted.items():
                rows = boxes.class_name == name
                distance_m[rows] = curve(boxes.wh_over_f[rows], boxes.bearing[rows])
            return MethodColumn(distance_m, np.full(len(boxes), np.nan))

        return predict

    return fit
