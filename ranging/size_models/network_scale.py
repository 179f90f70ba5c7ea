r"""NetworkScale: what the distances of a depth network are worth in a drive, and their correction.

    log z = log d + n + g(log d) + c_k + e_i + v_it

z is the network's distance of object i, of class k, in frame t, and d the true one. n is the factor
of the drive, a value of the cameras' posterior (`Unknown`), and g how the factor changes with the
distance. c_k belongs to the class, e_i to the track, v_it to the frame. A network that is right has
g = 0; one that says nothing of distances has g' = -1, and one that saturates has it at the far end.

g is a linear interpolation between `_KNOTS`, by one of several hypotheses (`_SHAPES`): constant,
bent, falling with the distance from a limit on, or any. They are weighed by their marginal
likelihoods, so that there is no threshold between a network that is right and one that says
nothing. The distance of an object is the posterior median of log d, with a flat prior up to 80 m,
given z: where the network does not change with the distance, all distances are possible, and sigma
is as wide.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.special import logsumexp, ndtr

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.schemas.validation import Number, PositiveNumber
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.size_models.network_cells import NO_CELLS, NetworkCells
from track_range.ranging.size_models.shared_sizes import CLASS_SIGMA
from track_range.ranging.size_models.size_model import SIZE_CLASSES

_KNOTS = np.log([2.0, 4.0, 7.0, 12.0, 20.0, 33.0, 55.0, 90.0, 150.0])
_N_CLASSES = len(SIZE_CLASSES)
_CLASS_SIGMA = 0.06  # of the factors of classes, of any network
_Sigma = Annotated[Number, Field(gt=0, le=3)]
_LOG_M = np.linspace(math.log(1.0), math.log(300.0), 180)  # (G,) grid of the distance
# (G,) log density of the distance before a measurement: road users farther than 80 m are rare
_LOG_PRIOR = -0.5 * (np.maximum(_LOG_M - math.log(80.0), 0.0) / 0.5) ** 2


class _Shape(NamedTuple):
    """A hypothesis about g: its probability before a drive, the sigma of its slope, and of its
    changes over a distance log d of 1.
    """

    probability: float
    slope_sigma: float
    change_sigma: float
    saturates_m: float = math.inf  # distance above which the network gives this one
    factor_sigma: float = 0.0  # least sigma of n: a constant has nothing to do with distances


_SHAPES = (
    _Shape(0.6, 0.03, 0.02),  # a network that is right
    _Shape(0.2, 0.15, 0.1),  # one that compresses distances
    *(_Shape(0.02, 0.03, 0.06, limit_m) for limit_m in (20.0, 27.0, 36.0, 48.0, 64.0)),
    _Shape(0.1, 0.5, 0.5, factor_sigma=1.0),  # one that may say nothing
)
FREE_SIGMA = 3.0  # of n, whose prior is that of the cameras' posterior
_TAIL_SIGMA = 0.22  # that unusual networks add to that of n before a drive
# probability and sigma of the factors of unusual networks; sigma of what all references share
_P_UNUSUAL, _UNUSUAL_SIGMA, _REFERENCE_SIGMA = 0.12, 0.7, 0.1
_N_ROUNDS, _CAUCHY_SIGMA = 4, 2.0  # of reweighting; scale of the weights in sigmas
# weights of the sigmas before a drive, in tracks and in frames
_N_TRACKS_BEFORE, _N_FRAMES_BEFORE = 4.0, 10.0
_LEAST_SIGMA = 0.02  # of a track, and of a frame
_LEVELS = ndtr([-2.0, -1.0, 0.0, 1.0, 2.0])
_LEAST_SPAN = 0.5  # of log d over which a slope is stated
_FLAT = 0.6  # fall of g at which a network says little of distances
_USELESS = 0.75  # sigma of log d above which an object is not measured


class NetworkErrors(BaseModel):
    """What is known of a network's errors before a drive, as sigmas of logarithms: of any network,
    or measured for one by `track-range fit --depth-model`, which writes it as `errors` to
    MODEL.yaml.

    The factor of a drive is that of networks which were not trained on its camera. Errors of at
    most 25 % have 86 % of the pixels of UniDepth on nuScenes and 98.6 % on KITTI, 28 % and 96 % of
    ZoeDepth. With the noise of each on KITTI (0.09, 0.11), that is a factor of exp(0.13) and
    exp(0.29) on nuScenes: a root mean square of 0.22.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, hide_input_in_errors=True)

    factor: PositiveNumber = 1.0  # of the drives: measured over true distance
    drive_sigma: _Sigma = 0.22
    class_factors: Mapping[str, PositiveNumber] = {}  # of size classes, beside that of the drive
    class_sigma: _Sigma = _CLASS_SIGMA
    track_sigma: _Sigma = 0.1
    noise_sigma: _Sigma = 0.05
    slope: Number = 1.0  # of log z over log d
    source: str = ""  # the labels that show it

    @property
    def log_factor(self) -> float:
        """Logarithm of the factor of the drives."""
        return math.log(self.factor)

    @property
    def class_log_factors(self) -> FloatArray:
        """(C,) logarithms of the factors of `SIZE_CLASSES`."""
        return np.log([self.class_factors.get(name, 1.0) for name in SIZE_CLASSES])

    @property
    def class_variances(self) -> FloatArray:
        """(C,) variances of the factors of `SIZE_CLASSES`; those of others than the measured
        classes are as of any network.
        """
        is_measured = np.array([name in self.class_factors for name in SIZE_CLASSES])
        usual = 0.0 if not self.class_factors else _CLASS_SIGMA**2
        return self.class_sigma**2 + np.where(is_measured, 0.0, usual)

    @property
    def drive_sigma_before(self) -> float:
        """Sigma of the factor of a drive before its evidence, with the heavy tails of the prior."""
        return math.hypot(self.drive_sigma, _TAIL_SIGMA)


@dataclass(frozen=True, slots=True)
class NetworkDistances:
    """Distances of a frame's tracks as a network measured them, and what is known of its errors."""

    ranges: Ranges
    errors: NetworkErrors
    class_id: IntArray


class _Curves(NamedTuple):
    """g and the factors of classes by each shape (S,); the first value is n at `centre`."""

    weight: FloatArray  # (S,)
    mean: FloatArray  # (S, P)
    covariance: FloatArray  # (S, P, P)


@dataclass(frozen=True, eq=False)
class NetworkScale:
    """The errors of a network in a drive; `NetworkScale()` is that of a network before it."""

    errors: NetworkErrors = field(default_factory=NetworkErrors)
    # of the drive at `centre`: mean and sigma of n; the sigma is that of the prior with heavy tails
    log_factor: float = 0.0
    sigma: float = 0.31
    track_sigma: float = 0.1
    noise_sigma: float = 0.05
    centre: float = math.log(20.0)  # log d at which n is estimated
    n_tracks: int = 0
    of_reference: LogFactor = field(default_factory=lambda: LogFactor(0.0, FREE_SIGMA))
    span: tuple[float, float] = (math.log(10.0), math.log(40.0))  # of log d of the references
    curves: _Curves | None = None  # None = before a drive

    @cached_property
    def _at_grid(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Log weights (S,) of the shapes, means of log z (S, G), and their variances, at the
        grid.
        """
        curves = self.curves or _solved(NO_CELLS, self.errors, np.zeros(0), class_variance=0.0)
        rows = _rows(_LOG_M) - _rows(np.array([self.centre]))
        mean = _LOG_M + self.log_factor + curves.mean @ rows.T
        variance = np.einsum("gp,spq,gq->sg", rows, curves.covariance, rows)
        return np.log(curves.weight), mean, variance

    @cached_property
    def class_factors(self) -> tuple[FloatArray, FloatArray]:
        """(C,) mean and variance of the factor of each class."""
        if self.curves is None:
            prior = self.errors.class_log_factors
            return prior, self.errors.class_variances
        w, classes = self.curves.weight, slice(-_N_CLASSES, None)
        mean = w @ self.curves.mean[:, classes]
        return mean, w @ np.einsum("spp->sp", self.curves.covariance)[:, classes]

    @property
    def slope(self) -> LogFactor:
        """Change of log z per change of log d between near and far references: 1 = right, 0 = the
        network says nothing.
        """
        if self.curves is None:
            return LogFactor(1.0, math.sqrt(sum(s.probability * s.slope_sigma**2 for s in _SHAPES)))
        low, high = self.span
        widen = max(_LEAST_SPAN - (high - low), 0.0) / 2
        low, high = low - widen, high + widen
        row = (_rows(np.array([high])) - _rows(np.array([low])))[0] / (high - low)
        values = self.curves.mean @ row
        mean = float(self.curves.weight @ values)
        variance = np.einsum("p,spq,q->s", row, self.curves.covariance, row) + (values - mean) ** 2
        return LogFactor(1.0 + mean, math.sqrt(float(self.curves.weight @ variance)))

    @property
    def reach_m(self) -> float:
        """Distance, within those of the references, from which on the network's distances hardly
        change; infinite = there is none.
        """
        if self.curves is None:
            return math.inf
        slopes = np.diff(self.curves.weight @ self.curves.mean[:, : len(_KNOTS)]) / np.diff(_KNOTS)
        is_flat = (slopes < -_FLAT) & (_KNOTS[:-1] < self.span[1])
        is_steep = (slopes >= -_FLAT) & (_KNOTS[:-1] < self.span[1])
        first = int(np.flatnonzero(is_steep).max(initial=-1)) + 1
        return float(np.exp(_KNOTS[first])) if is_flat[first:].any() else math.inf

    def corrected(self, raw: Ranges, class_id: IntArray) -> Ranges:
        """The network's distances of N tracks of classes (N,) as this drive corrects them."""
        rows = (np.isfinite(raw.distance_m) & (raw.distance_m > 0)).nonzero()[0]
        distance_m, sigma_m, systematic_m = np.full((3, len(raw)), np.nan)
        if len(rows):
            log_weight, mean, variance = self._at_grid
            class_log_factors, class_variance = self.class_factors
            own = raw.sigma_m[rows] / raw.distance_m[rows]
            noise = np.maximum(np.nan_to_num(own) ** 2, self.noise_sigma**2)
            k = class_id[rows]
            lasting = self.sigma**2 + self.track_sigma**2 + class_variance[k]
            y = np.log(raw.distance_m[rows]) - class_log_factors[k]
            total = variance[None] + (noise + lasting)[:, None, None]  # (R, S, G)
            chi2 = (y[:, None, None] - mean[None]) ** 2 / total
            log_p = logsumexp(log_weight[:, None] - 0.5 * (chi2 + np.log(total)), axis=1)
            log_p += _LOG_PRIOR
            p = np.exp(log_p - log_p.max(axis=1, keepdims=True))
            log_m, sigma = _median_and_sigma(p)
            sigma[sigma > _USELESS] = np.nan
            distance_m[rows] = np.where(np.isfinite(sigma), np.exp(log_m), np.nan)
            sigma_m[rows] = sigma * distance_m[rows]
            systematic_m[rows] = sigma_m[rows] * np.sqrt(lasting / (lasting + noise))
        return raw.with_distances(distance_m, sigma_m, systematic_m)


def _median_and_sigma(p: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N,) median of log d by densities (N, G) at the grid, and the sigma of which 1 and 2 hold as
    much as those of a normal distribution.
    """
    below = np.cumsum(p, axis=1)
    below = (below - 0.5 * p) / below[:, -1:]
    quantiles = np.array([np.interp(_LEVELS, row, _LOG_M) for row in below])
    low2, low1, median, high1, high2 = quantiles.T
    return median, np.maximum(high1 - low1, (high2 - low2) / 2) / 2


class LogFactor(NamedTuple):
    """Mean and standard deviation of a logarithm."""

    mean: float
    sigma: float


def network_scale(cells: NetworkCells, errors: NetworkErrors, *, by_size: bool) -> NetworkScale:
    """The errors that the references of a drive show, with a free factor of the drive
    (`of_reference`), relative to that of the references.

    `by_size` references have an error of each class of their own.
    """
    if not len(cells.ratio):
        return NetworkScale(errors, errors.log_factor)
    noise2 = _noise_variance(cells, errors)
    _, track_index, counts = np.unique(cells.track_id, return_inverse=True, return_counts=True)
    known = cells.variance + noise2 / cells.n_frames
    track2, log_m = errors.track_sigma**2, cells.log_m
    own_variance = CLASS_SIGMA**2 if by_size else 0.0
    n_per_track = counts[track_index]
    variance = known + track2 * n_per_track
    A, robust = _design(cells), np.ones(len(log_m))
    for _ in range(_N_ROUNDS):
        curves = _solved(cells, errors, variance / robust, class_variance=own_variance)
        # from the most general shape: far objects of a network that saturates are no outliers
        of_shapes = (cells.ratio[:, None] - A @ curves.mean.T) ** 2
        robust = 1.0 / (1.0 + of_shapes[:, -1] / variance / _CAUCHY_SIGMA**2)
        residual2 = of_shapes @ curves.weight
        share = robust / n_per_track
        before = _N_TRACKS_BEFORE * errors.track_sigma**2
        track2 = before + (share * (residual2 - known)).sum()
        track2 = max(track2 / (_N_TRACKS_BEFORE + share.sum()), _LEAST_SIGMA**2)
        variance = known + track2 * n_per_track
    information = robust / variance
    centre = float(information @ log_m / information.sum())
    row = _rows(np.array([centre]))[0]
    values = curves.mean @ row
    mean = float(curves.weight @ values)
    spread = np.einsum("p,spq,q->s", row, curves.covariance, row) + (values - mean) ** 2
    of_reference = LogFactor(mean, math.sqrt(float(curves.weight @ spread)))
    low, high = np.quantile(log_m, [0.1, 0.9])
    # of the factors of classes, the part that is the network's own
    curves = _with_own_classes(curves, errors, own_variance)
    return NetworkScale(
        errors,
        log_factor=mean,
        sigma=of_reference.sigma,
        track_sigma=math.sqrt(track2),
        noise_sigma=math.sqrt(noise2),
        centre=centre,
        n_tracks=len(counts),
        of_reference=of_reference,
        span=(float(low), float(high)),
        curves=curves,
    )


def _noise_variance(cells: NetworkCells, errors: NetworkErrors) -> float:
    """Variance of the errors of a frame: the median of the cells, of which some have frames of an
    object in front.
    """
    n_more = np.maximum(cells.n_frames - 1.0, 0.0)
    order = np.argsort(cells.squares / np.maximum(n_more, 1.0))
    n_below = np.cumsum(n_more[order])
    if not n_below[-1]:
        return errors.noise_sigma**2
    middle = order[np.searchsorted(n_below, n_below[-1] / 2)]
    n_middle = n_more[middle]
    # the median of chi2 is less than its mean (Wilson and Hilferty)
    variance = cells.squares[middle] / n_middle / (1.0 - 2.0 / (9.0 * n_middle)) ** 3
    variance = max(variance - float(np.median(cells.noise_variance)), 0.0)
    before = _N_FRAMES_BEFORE * errors.noise_sigma**2
    noise2 = (before + n_below[-1] * variance) / (_N_FRAMES_BEFORE + n_below[-1])
    return max(float(noise2), _LEAST_SIGMA**2)


def _rows(log_m: FloatArray) -> FloatArray:
    """(N, P) coefficients of the parameters n + g at log distances: of the values at the knots, and
    of the classes, which are 0.
    """
    k = np.clip(np.searchsorted(_KNOTS, log_m) - 1, 0, len(_KNOTS) - 2)
    part = np.clip((log_m - _KNOTS[k]) / (_KNOTS[k + 1] - _KNOTS[k]), 0.0, 1.0)
    rows = np.zeros((len(log_m), len(_KNOTS) + _N_CLASSES))
    at = np.arange(len(log_m))
    rows[at, k], rows[at, k + 1] = 1.0 - part, part
    return rows


def _design(cells: NetworkCells) -> FloatArray:
    rows = _rows(cells.log_m)
    rows[np.arange(len(rows)), len(_KNOTS) + cells.class_id] = 1.0
    return rows


def _solved(
    cells: NetworkCells, errors: NetworkErrors, variance: FloatArray, *, class_variance: float
) -> _Curves:
    """The parameters by each shape, from cells with these variances (K,)."""
    A, n_knots = _design(cells), len(_KNOTS)
    from_centre = _KNOTS - _KNOTS[n_knots // 2]
    # the covariance of a random walk that starts in the middle
    same_side = np.sign(from_centre)[:, None] * np.sign(from_centre) > 0
    reach = np.minimum(np.abs(from_centre)[:, None], np.abs(from_centre)) * same_side
    usual = np.concatenate([(errors.slope - 1.0) * from_centre, errors.class_log_factors])
    log_p, means, covariances = [], [], []
    W = A.T / variance
    for shape in _SHAPES:
        mean0 = usual.copy()
        mean0[:n_knots] -= np.maximum(_KNOTS - math.log(shape.saturates_m), 0.0)
        prior = np.zeros((len(mean0), len(mean0)))
        prior[n_knots:, n_knots:] = np.diag(errors.class_variances + class_variance)
        prior[:n_knots, :n_knots] = (
            FREE_SIGMA**2
            + shape.slope_sigma**2 * np.outer(from_centre, from_centre)
            + shape.change_sigma**2 * reach
        )
        precision = np.linalg.inv(prior)
        covariance = np.linalg.inv(precision + W @ A)
        mean = mean0 + covariance @ (W @ (cells.ratio - A @ mean0))
        residual, moved = cells.ratio - A @ mean, mean - mean0
        chi2 = (residual**2 / variance).sum() + moved @ precision @ moved
        log_volume = np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(prior)[1]
        log_p.append(math.log(shape.probability) + 0.5 * (log_volume - chi2))
        if len(cells.ratio):
            middle = n_knots // 2
            log_p[-1] += _log_likelihood(
                errors, shape, mean[middle] - errors.log_factor, covariance[middle, middle]
            )
        means.append(mean)
        covariances.append(covariance)
    weight = np.exp(np.array(log_p) - max(log_p))
    return _Curves(weight / weight.sum(), np.array(means), np.array(covariances))


def _log_likelihood(errors: NetworkErrors, shape: _Shape, error: float, variance: float) -> float:
    """Log density of an estimated factor (log over the usual one, with its variance) by a shape.

    So the shape of a network that says nothing explains a factor far from 1 even before road users
    at several distances show it.
    """
    usual = max(errors.drive_sigma, shape.factor_sigma)
    sigmas2 = np.square([usual, max(usual, _UNUSUAL_SIGMA)]) + variance + _REFERENCE_SIGMA**2
    log_p = -0.5 * (error**2 / sigmas2 + np.log(sigmas2))
    return float(logsumexp(log_p, b=[1.0 - _P_UNUSUAL, _P_UNUSUAL]))


def _with_own_classes(curves: _Curves, errors: NetworkErrors, class_variance: float) -> _Curves:
    """The curves with the factors of classes that are the network's, not the references'."""
    own = errors.class_variances / (errors.class_variances + class_variance)
    part = np.ones(curves.mean.shape[1])
    part[-_N_CLASSES:] = own
    mean0 = np.zeros(len(part))
    mean0[-_N_CLASSES:] = errors.class_log_factors
    rest = np.zeros(len(part))
    rest[-_N_CLASSES:] = (1.0 - own) * errors.class_variances
    covariance = curves.covariance * np.outer(part, part) + np.diag(rest)
    return curves._replace(mean=mean0 + part * (curves.mean - mean0), covariance=covariance)
