"""Plain curves from the size of a box to its distance: polynomials (Zhang et al.) and simple baselines.

    polynomial   d = c0 + c1 s + ... + ck s^k    s = diagonal (Zhang et al., eq. 4-7) or height of the box
    inverse      1 / d = a + b s                 pinhole model with an offset
    log-linear   log d = a + b log h + c log w + e |tan bearing|

Sizes s, w, h are divided by the focal length. Polynomials are fitted by least squares in d, as by Zhang et al., the
inverse in (a + b s) d - 1 (the relative error), the log-linear curve in log d. A polynomial may increase or become
negative outside the fitted sizes; `safe_table` makes it monotonically decreasing and positive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.polynomial import Polynomial

from track_range.foundation.arrays import FloatArray

Measure = Callable[[FloatArray], FloatArray]
"""Function from (N, 2) width and height divided by the focal length to (N,) box measure s, the argument of a curve."""

_TABLE_SIZE = 64  # number of nodes of a `safe_table`


class FittedCurve(Protocol):
    """A curve with fitted coefficients."""

    def predict(self, wh_over_f: FloatArray, bearing: FloatArray) -> FloatArray:
        """(N,) distance in m, from (N, 2) width and height divided by the focal length and (N,) tan bearing."""
        ...


class PlainCurve(Protocol):
    """A type of curve that can be fitted."""

    def fit(self, wh_over_f: FloatArray, bearing: FloatArray, distance_m: FloatArray) -> FittedCurve:
        """The curve fitted to (N, 2) sizes divided by the focal length, (N,) tan bearing and (N,) distance in m."""
        ...


def height(wh_over_f: FloatArray) -> FloatArray:
    """(N,) height of boxes, divided by the focal length."""
    return wh_over_f[:, 1]


def diagonal(wh_over_f: FloatArray) -> FloatArray:
    """(N,) diagonal of boxes, divided by the focal length."""
    return np.asarray(np.hypot(wh_over_f[:, 0], wh_over_f[:, 1]))


MEASURES: Mapping[str, Measure] = {"height": height, "diagonal": diagonal}  # box measures by their name in curve files


@dataclass(frozen=True, slots=True)
class FittedFunction:
    """A fitted function of one box measure; values outside the fitted sizes may be negative or increasing."""

    measure: Measure
    function: Callable[[FloatArray], FloatArray]

    def predict(self, wh_over_f: FloatArray, bearing: FloatArray) -> FloatArray:
        """(N,) distance in m; the bearing is not used."""
        return np.asarray(self.function(self.measure(wh_over_f)))


@dataclass(frozen=True, slots=True)
class FittedTable:
    """A monotonic function of one box measure: linear between (log_size, log_distance), d = const / s outside."""

    measure: Measure
    log_size: FloatArray
    log_distance: FloatArray

    def predict(self, wh_over_f: FloatArray, bearing: FloatArray) -> FloatArray:
        """(N,) distance in m, positive; the bearing is not used."""
        log_s = np.log(self.measure(wh_over_f))
        inside = np.clip(log_s, self.log_size[0], self.log_size[-1])
        return np.asarray(np.exp(np.interp(inside, self.log_size, self.log_distance) - (log_s - inside)))


@dataclass(frozen=True, slots=True)
class FittedLogLinear:
    """A fitted log-linear curve: log d = coefficients . (1, log h, log w, |tan bearing|)."""

    coefficients: FloatArray

    def predict(self, wh_over_f: FloatArray, bearing: FloatArray) -> FloatArray:
        """(N,) distance in m, positive."""
        return np.asarray(np.exp(_log_linear_design(wh_over_f, bearing) @ self.coefficients))


@dataclass(frozen=True, slots=True)
class PolynomialCurve:
    """Polynomial of `degree` in a box measure: d = c0 + c1 s + ... + ck s^k."""

    measure: Measure
    degree: int

    def fit(self, wh_over_f: FloatArray, bearing: FloatArray, distance_m: FloatArray) -> FittedFunction:
        """The polynomial fitted by least squares in d."""
        fitted = Polynomial.fit(self.measure(wh_over_f), distance_m, self.degree)
        return FittedFunction(self.measure, fitted)


@dataclass(frozen=True, slots=True)
class InverseCurve:
    """Inverse curve of a box measure: 1 / d = a + b s."""

    measure: Measure

    def fit(self, wh_over_f: FloatArray, bearing: FloatArray, distance_m: FloatArray) -> FittedFunction:
        """The curve fitted by least squares in (a + b s) d - 1, the relative error."""
        s = self.measure(wh_over_f)
        design = np.stack([np.ones_like(s), s], axis=1) * distance_m[:, None]
        a, b = np.linalg.lstsq(design, np.ones_like(s), rcond=None)[0]
        return FittedFunction(self.measure, lambda s: 1.0 / (a + b * s))


@dataclass(frozen=True, slots=True)
class LogLinearCurve:
    """Log-linear curve: log d is linear in log h, log w and |tan bearing|."""

    def fit(self, wh_over_f: FloatArray, bearing: FloatArray, distance_m: FloatArray) -> FittedLogLinear:
        """The curve fitted by least squares in log d."""
        design = _log_linear_design(wh_over_f, bearing)
        return FittedLogLinear(np.asarray(np.linalg.lstsq(design, np.log(distance_m), rcond=None)[0], np.float64))


@dataclass(frozen=True, slots=True)
class SafeCurve:
    """A curve of one box measure, made monotonically decreasing by `safe_table`."""

    raw: PolynomialCurve | InverseCurve

    def fit(self, wh_over_f: FloatArray, bearing: FloatArray, distance_m: FloatArray) -> FittedTable:
        """The raw curve within the fitted sizes, constant where it would increase; d = const / s outside."""
        fitted = self.raw.fit(wh_over_f, bearing, distance_m)
        return safe_table(fitted, self.raw.measure(wh_over_f), distance_m)


def safe_table(fitted: FittedFunction, size: FloatArray, distance_m: FloatArray) -> FittedTable:
    """A monotonic table of the curve, limited to between half the smallest and twice the largest fitted distance.

    The table spans the central 99 % of the sizes, so that it does not depend on single boxes at either end.
    """
    low, high = np.log(np.quantile(size, [0.005, 0.995]))
    log_size = np.linspace(low, high, _TABLE_SIZE)
    raw_m = fitted.function(np.exp(log_size))
    raw_m = np.where(np.isfinite(raw_m), raw_m, np.inf)
    decreasing_m = np.minimum.accumulate(np.clip(raw_m, distance_m.min() / 2, distance_m.max() * 2))
    return FittedTable(fitted.measure, log_size, np.log(decreasing_m))


def _log_linear_design(wh_over_f: FloatArray, bearing: FloatArray) -> FloatArray:
    """(N, 4) design matrix of the log-linear curve."""
    log_w, log_h = np.log(wh_over_f).T
    return np.stack([np.ones_like(log_h), log_h, log_w, np.abs(bearing)], axis=1)


_OF_ONE_MEASURE: Mapping[str, PolynomialCurve | InverseCurve] = {
    **{f"diagonal-{degree}": PolynomialCurve(diagonal, degree) for degree in (3, 4, 5)},
    **{f"height-{degree}": PolynomialCurve(height, degree) for degree in (3, 4, 5)},
    "inverse-height": InverseCurve(height),
}

PLAIN_CURVES: Mapping[str, PlainCurve] = {**_OF_ONE_MEASURE, "log-linear": LogLinearCurve()}
"""Raw curves by name, for comparison."""

SAFE_CURVES: Mapping[str, SafeCurve] = {name: SafeCurve(raw) for name, raw in _OF_ONE_MEASURE.items()}
"""Monotonic and positive versions of the raw curves of one measure, by name."""
