"""Plain curves from the size of a box to metres: the paper's, and the simple ones that any other must beat.

    polynomial   d = c0 + c1 s + ... + ck s^k    s = diagonal (Zhang et al., eq. 4-7) or height of the box
    inverse      1 / d = a + b h                 the pinhole law with an offset
    log-linear   log d = a + b log h + c log w + e |tan bearing|

Sizes are divided by the focal length. Polynomials are least squares in metres, as in the paper; the inverse is least
squares in (a + b h) d - 1 (the relative error), log-linear in log d. A polynomial rises again, or turns negative,
outside the sizes it was fitted on; `safe_table` makes of such a curve one that falls everywhere and is never negative.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.polynomial import Polynomial

from track_range.foundation.arrays import FloatArray

Measure = Callable[[FloatArray], FloatArray]
"""(N, 2) width and height over the focal length -> (N,) the one size that a curve is a function of."""

_TABLE_SIZE = 64


class FittedCurve(Protocol):
    """A curve with its coefficients."""

    def predict(self, wh_over_f: FloatArray, bearing: FloatArray) -> FloatArray:
        """(N,) distance_m of boxes of (N, 2) width and height over the focal length at (N,) tan bearing."""
        ...


class PlainCurve(Protocol):
    """A kind of curve."""

    def fit(self, wh_over_f: FloatArray, bearing: FloatArray, distance_m: FloatArray) -> FittedCurve:
        """The curve of this kind through (N, 2) sizes over the focal length, (N,) tan bearing, (N,) distance_m."""
        ...


def height(wh_over_f: FloatArray) -> FloatArray:
    """(N,) height of boxes."""
    return wh_over_f[:, 1]


def diagonal(wh_over_f: FloatArray) -> FloatArray:
    """(N,) diagonal of boxes."""
    return np.asarray(np.hypot(wh_over_f[:, 0], wh_over_f[:, 1]))


MEASURES: Mapping[str, Measure] = {"height": height, "diagonal": diagonal}


@dataclass(frozen=True, slots=True)
class FittedFunction:
    """A function of one size, as it was fitted: anything may happen outside the fitted sizes."""

    measure: Measure
    function: Callable[[FloatArray], FloatArray]

    def predict(self, wh_over_f: FloatArray, bearing: FloatArray) -> FloatArray:
        """(N,) distance_m; the bearing is not used."""
        return np.asarray(self.function(self.measure(wh_over_f)))


@dataclass(frozen=True, slots=True)
class FittedTable:
    """A function of one size that falls everywhere: a line between (log_size, log_distance), d = const / s outside."""

    measure: Measure
    log_size: FloatArray
    log_distance: FloatArray

    def predict(self, wh_over_f: FloatArray, bearing: FloatArray) -> FloatArray:
        """(N,) distance_m, positive; the bearing is not used."""
        wanted = np.log(self.measure(wh_over_f))
        inside = np.clip(wanted, self.log_size[0], self.log_size[-1])
        return np.asarray(np.exp(np.interp(inside, self.log_size, self.log_distance) - (wanted - inside)))


@dataclass(frozen=True, slots=True)
class FittedLogLinear:
    """log d = coefficients . (1, log h, log w, |tan bearing|)."""

    coefficients: FloatArray

    def predict(self, wh_over_f: FloatArray, bearing: FloatArray) -> FloatArray:
        """(N,) distance_m, positive."""
        return np.asarray(np.exp(_log_linear_design(wh_over_f, bearing) @ self.coefficients))


@dataclass(frozen=True, slots=True)
class PolynomialCurve:
    """d = polynomial of `degree` in a size."""

    measure: Measure
    degree: int

    def fit(self, wh_over_f: FloatArray, bearing: FloatArray, distance_m: FloatArray) -> FittedFunction:
        """Least squares in metres."""
        fitted = Polynomial.fit(self.measure(wh_over_f), distance_m, self.degree)
        return FittedFunction(self.measure, fitted)


@dataclass(frozen=True, slots=True)
class InverseCurve:
    """1 / d = a + b s."""

    measure: Measure

    def fit(self, wh_over_f: FloatArray, bearing: FloatArray, distance_m: FloatArray) -> FittedFunction:
        """Least squares in (a + b s) d - 1."""
        size = self.measure(wh_over_f)
        design = np.stack([np.ones_like(size), size], axis=1) * distance_m[:, None]
        a, b = np.linalg.lstsq(design, np.ones_like(size), rcond=None)[0]
        return FittedFunction(self.measure, lambda s: 1.0 / (a + b * s))


@dataclass(frozen=True, slots=True)
class LogLinearCurve:
    """log d linear in log h, log w and |tan bearing|."""

    def fit(self, wh_over_f: FloatArray, bearing: FloatArray, distance_m: FloatArray) -> FittedLogLinear:
        """Least squares in log d."""
        design = _log_linear_design(wh_over_f, bearing)
        return FittedLogLinear(np.asarray(np.linalg.lstsq(design, np.log(distance_m), rcond=None)[0], np.float64))


@dataclass(frozen=True, slots=True)
class SafeCurve:
    """A curve of one size, made to fall everywhere."""

    raw: PolynomialCurve | InverseCurve

    def fit(self, wh_over_f: FloatArray, bearing: FloatArray, distance_m: FloatArray) -> FittedTable:
        """The raw curve within the fitted sizes, where it falls; flat where it would rise; d = const / s outside."""
        fitted = self.raw.fit(wh_over_f, bearing, distance_m)
        return safe_table(fitted, self.raw.measure(wh_over_f), distance_m)


def safe_table(fitted: FittedFunction, size: FloatArray, distance_m: FloatArray) -> FittedTable:
    """A table of the curve over the fitted sizes, that falls and stays within half and twice the fitted distances.

    The few boxes at either end decide nothing: the table spans the middle 99 % of the sizes.
    """
    low, high = np.log(np.quantile(size, [0.005, 0.995]))
    log_size = np.linspace(low, high, _TABLE_SIZE)
    raw_m = fitted.function(np.exp(log_size))
    raw_m = np.where(np.isfinite(raw_m), raw_m, np.inf)
    falling_m = np.minimum.accumulate(np.clip(raw_m, distance_m.min() / 2, distance_m.max() * 2))
    return FittedTable(fitted.measure, log_size, np.log(falling_m))


def _log_linear_design(wh_over_f: FloatArray, bearing: FloatArray) -> FloatArray:
    log_w, log_h = np.log(wh_over_f).T
    return np.stack([np.ones_like(log_h), log_h, log_w, np.abs(bearing)], axis=1)


_ONE_SIZE: Mapping[str, PolynomialCurve | InverseCurve] = {
    **{f"diagonal-{degree}": PolynomialCurve(diagonal, degree) for degree in (3, 4, 5)},
    **{f"height-{degree}": PolynomialCurve(height, degree) for degree in (3, 4, 5)},
    "inverse-height": InverseCurve(height),
}

PLAIN_CURVES: Mapping[str, PlainCurve] = {**_ONE_SIZE, "log-linear": LogLinearCurve()}
"""Raw curves by name, for comparison."""

SAFE_CURVES: Mapping[str, SafeCurve] = {name: SafeCurve(raw) for name, raw in _ONE_SIZE.items()}
"""The same, monotone and positive everywhere (log-linear is so by itself)."""
