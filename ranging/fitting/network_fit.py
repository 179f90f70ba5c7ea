"""Fit of a depth network's errors to labelled sequences with images: the factor of a drive, of a
class, of a track, and the noise of a frame (`NetworkErrors`).

Each sequence is a drive, whose errors are estimated as in a run, with the labels as references. The
factors of sequences have the mean and the spread of the drives. Each sequence is also measured with
the errors that the others show, without any correction by its own labels.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.ranging.size_models.network_cells import CellAverages
from track_range.ranging.size_models.network_scale import (
    NetworkErrors,
    NetworkScale,
    network_scale,
)
from track_range.ranging.size_models.size_model import SIZE_CLASSES
from track_range.ranging.truth.errors import MethodColumn
from track_range.ranging.truth.labelled_boxes import BoxSet

_LABEL_SIGMA = 0.02  # relative, of labelled distances

_MIN_BOXES, _MIN_TRACKS = 20, 3  # of a sequence that counts
# weight of what is known of any network, in drives and in classes
_N_BEFORE = 1.0
# of the prior that a fit starts from: classes and tracks of a network that nothing is known of
_VAGUE = NetworkErrors(class_sigma=0.15)


@dataclass(frozen=True, slots=True)
class FittedSequence:
    """What one sequence shows, and how well the others predict it."""

    name: str
    n_boxes: int
    scale: NetworkScale
    # of its boxes with the errors that the other sequences show: median relative error after the
    # correction of their mean factor, and fractions of the errors within 1 and 2 sigma; NaN = none
    left_out_error: float
    within: tuple[float, float]


@dataclass(frozen=True, slots=True)
class FittedNetwork:
    """The errors of a network, by all sequences and by each of them."""

    errors: NetworkErrors
    sequences: tuple[FittedSequence, ...]


def fit_network(boxes: BoxSet, measured: MethodColumn, *, source: str = "") -> FittedNetwork | None:
    """The errors of the network's distances of labelled boxes (N,); None = too few are measured."""
    class_id = np.array([SIZE_CLASSES.index(str(name)) for name in boxes.class_name], np.int64)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.log(measured.distance_m / boxes.distance_m)
    drives: list[tuple[int, NetworkScale]] = []
    for number in range(len(boxes.sequence_names)):
        rows = np.flatnonzero((boxes.sequence == number) & np.isfinite(ratio))
        if len(rows) < _MIN_BOXES or len(np.unique(boxes.track_id[rows])) < _MIN_TRACKS:
            continue
        cells = CellAverages()
        for frame in np.unique(boxes.frame[rows]):
            at = rows[boxes.frame[rows] == frame]
            log_m, variance = np.log(boxes.distance_m[at]), np.full(len(at), _LABEL_SIGMA**2)
            values = np.array([log_m, ratio[at], variance, 0.0 * log_m])
            cells.add(values, boxes.track_id[at], class_id[at])
        drives.append((number, network_scale(cells.cells, _VAGUE, by_size=False)))
    if not drives:
        return None
    sequences = []
    for k, (number, scale) in enumerate(drives):
        rows = np.flatnonzero((boxes.sequence == number) & np.isfinite(ratio))
        others = [other for j, (_, other) in enumerate(drives) if j != k]
        error, within = np.nan, (np.nan, np.nan)
        if others:
            error, within = _predicted(_errors(others), ratio[rows], class_id[rows])
        name = boxes.sequence_names[number]
        sequences.append(FittedSequence(name, len(rows), scale, error, within))
    errors = _errors([scale for _, scale in drives], source)
    return FittedNetwork(errors, tuple(sequences))


def factor_sigma(scale: NetworkScale) -> float:
    """Standard deviation of the factor of a sequence by its number of tracks, without that of the
    classes, which sequences share.
    """
    return scale.track_sigma / math.sqrt(scale.n_tracks)


def _errors(drives: Sequence[NetworkScale], source: str = "") -> NetworkErrors:
    """The mean and the spread of the drives; what few of them do not show is as of any network."""
    usual, n = NetworkErrors(), len(drives)
    factor = np.array([scale.of_reference.mean for scale in drives])
    own = np.array([factor_sigma(scale) for scale in drives]) ** 2
    mean = float(factor.mean())
    spread2 = _with_prior(
        ((factor - mean) ** 2).sum() - (1 - 1 / n) * own.sum(), n - 1, usual.drive_sigma
    )
    # a further drive deviates from the mean of these, which is not that of all
    drive2 = spread2 * (1 + 1 / n)
    classes = [scale.class_factors for scale in drives]
    means = np.array([factors[0] for factors in classes])  # (D, C)
    variances = np.array([factors[1] for factors in classes])
    information = (1 / variances).sum(axis=0)
    by_class = (means / variances).sum(axis=0) / information
    is_seen = variances.min(axis=0) < 0.9 * _VAGUE.class_sigma**2
    deviation2 = ((means - by_class) ** 2 - variances)[variances < 0.9 * _VAGUE.class_sigma**2]
    class2 = _with_prior(deviation2.sum(), len(deviation2), usual.class_sigma)
    weight = np.array([scale.n_tracks for scale in drives], np.float64)
    slopes = np.array([scale.slope for scale in drives])
    slope_weight = slopes[:, 1] ** -2
    return NetworkErrors(
        factor=_rounded(np.exp(mean)),
        drive_sigma=_rounded(np.sqrt(drive2)),
        class_factors={
            name: _rounded(np.exp(by_class[k])) for k, name in enumerate(SIZE_CLASSES) if is_seen[k]
        },
        class_sigma=_rounded(np.sqrt(class2)),
        track_sigma=_rms([scale.track_sigma for scale in drives], weight),
        noise_sigma=_rms([scale.noise_sigma for scale in drives], weight),
        slope=_rounded(slope_weight @ slopes[:, 0] / slope_weight.sum()),
        source=source,
    )


def _with_prior(squares: float, n: int, sigma: float) -> float:
    """Variance by a sum of n squared deviations, and what is known of any network."""
    variance = (_N_BEFORE * sigma**2 + max(squares, 0.0)) / (_N_BEFORE + n)
    return float(max(variance, 0.01**2))


def _rms(sigmas: Sequence[float], weight: FloatArray) -> float:
    return _rounded(np.sqrt(weight @ np.square(sigmas) / weight.sum()))


def _rounded(value: float) -> float:
    return round(float(value), 4)


def _predicted(
    errors: NetworkErrors, ratio: FloatArray, class_id: IntArray
) -> tuple[float, tuple[float, float]]:
    """Median error of a sequence, and shares within 1 and 2 sigma, by the errors of others."""
    left = ratio - errors.log_factor - errors.class_log_factors[class_id]
    sigma = np.sqrt(
        errors.drive_sigma**2
        + errors.class_sigma**2
        + errors.track_sigma**2
        + errors.noise_sigma**2
    )
    within = tuple(float((np.abs(left) < k * sigma).mean()) for k in (1.0, 2.0))
    return float(np.median(np.abs(left))), (within[0], within[1])
