"""Plain curves from the size of a box to its distance: polynomials (Zhang et al.) and simple baselines.

    polynomial   d = c0 + c1 s + ... + ck s^k    s = diagonal (Zhang et al., eq. 4-7) or height of the box
    inverse      1 / d = a + b s                 pinhole model with an offset
    log-linear   log d = a + b log h + c log w + e |tan bearing|

Sizes s, w, h are divided by the focal length. Polynomials are fitted by least squares in d, as by Zhang et al., the
inverse in (a + b s) d - 1 (the relative error), the log-linear curve in log d. A polynomial may increase or become
negative outside the fitted sizes; `SAFE_CURVES` make it
monotonically decreasing and positive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.polynomial import Polynomial

from track_range.foundation.arrays import FloatArray

Measure = Callable[[FloatArray], FloatArray]
"""Function from (N, 2) width and height divided by the focal length to (N,) box measure s, the argument of a curve."""

Curve = Callable[[FloatArray, FloatArray], FloatArray]
"""Fitted curve: (N,) distance in m, from (N, 2) width and height divided by the focal length and (N,) tan bearing."""

CurveFitter = Callable[[FloatArray, FloatArray, FloatArray], Curve]
"""Function that fits a curve to (N, 2) sizes divided by the focal length, (N,) tan bearing and (N,) distance in m."""

_TABLE_SIZE = 64  # number of nodes of a table


def height(wh_over_f: FloatArray) -> FloatArray:
    """(N,) height of boxes, divided by the focal length."""
    return wh_over_f[:, 1]


def diagonal(wh_over_f: FloatArray) -> FloatArray:
    """(N,) diagonal of boxes, divided by the focal length."""
    return np.asarray(np.hypot(wh_over_f[:, 0], wh_over_f[:, 1]))


MEASURES: Mapping[str, Measure] = {"height": height, "diagonal": diagonal}  # by their name in curve files


@dataclass(frozen=True, slots=True)
class FittedTable:
    """A monotonic curve of one box measure: linear between (log_size, log_distance), d = const / s outside."""

    measure: Measure
    log_size: FloatArray
    log_distance: FloatArray

    def __call__(self, wh_over_f: FloatArray, bearing: FloatArray) -> FloatArray:
        """(N,) distance in m, positive; the bearing is not used."""
        log_s = np.log(self.measure(wh_over_f))
        inside = np.clip(log_s, self.log_size[0], self.log_size[-1])
        return np.asarray(np.exp(np.interp(inside, self.log_size, self.log_distance) - (log_s - inside)))


def _fit_inverse(s: FloatArray, distance_m: FloatArray) -> Callable[[FloatArray], FloatArray]:
    design = np.stack([np.ones_like(s), s], axis=1) * distance_m[:, None]
    a, b = np.linalg.lstsq(design, np.ones_like(s), rcond=None)[0]
    return lambda s: 1.0 / (a + b * s)


def _fit_log_linear(wh_over_f: FloatArray, bearing: FloatArray, distance_m: FloatArray) -> Curve:
    def design(wh_over_f: FloatArray, bearing: FloatArray) -> FloatArray:
        log_w, log_h = np.log(wh_over_f).T
        return np.stack([np.ones_like(log_h), log_h, log_w, np.abs(bearing)], axis=1)

    coefficients = np.linalg.lstsq(design(wh_over_f, bearing), np.log(distance_m), rcond=None)[0]
    return lambda wh_over_f, bearing: np.asarray(np.exp(design(wh_over_f, bearing) @ coefficients))


@dataclass(frozen=True, slots=True)
class _RawFitter:
    """Fits a function of one box measure; outside the fitted sizes, distances may be negative or increasing."""

    measure: Measure
    fit: Callable[[FloatArray, FloatArray], Callable[[FloatArray], FloatArray]]

    def __call__(self, wh_over_f: FloatArray, bearing: FloatArray, distance_m: FloatArray) -> Curve:
        function = self.fit(self.measure(wh_over_f), distance_m)
        return lambda wh_over_f, bearing: np.asarray(function(self.measure(wh_over_f)))

    def safe(self, wh_over_f: FloatArray, bearing: FloatArray, distance_m: FloatArray) -> FittedTable:
        """The curve within the fitted sizes, constant where it would increase; d = const / s outside.

        Distances are between half the smallest and twice the largest fitted one. The table spans the central 99 % of
        the sizes, so that it does not depend on single boxes at either end.
        """
        size = self.measure(wh_over_f)
        low, high = np.log(np.quantile(size, [0.005, 0.995]))
        log_size = np.linspace(low, high, _TABLE_SIZE)
        raw_m = self.fit(size, distance_m)(np.exp(log_size))
        raw_m = np.where(np.isfinite(raw_m), raw_m, np.inf)
        decreasing_m = np.minimum.accumulate(np.clip(raw_m, distance_m.min() / 2, distance_m.max() * 2))
        return FittedTable(self.measure, log_size, np.log(decreasing_m))


_OF_ONE_MEASURE: Mapping[str, _RawFitter] = {
    **{f"diagonal-{degree}": _RawFitter(diagonal, partial(Polynomial.fit, deg=degree)) for degree in (3, 4, 5)},
    **{f"height-{degree}": _RawFitter(height, partial(Polynomial.fit, deg=degree)) for degree in (3, 4, 5)},
    "inverse-height": _RawFitter(height, _fit_inverse),
}

PLAIN_CURVES: Mapping[str, CurveFitter] = {**_OF_ONE_MEASURE, "log-linear": _fit_log_linear}  # raw

SAFE_CURVES: Mapping[str, Callable[[FloatArray, FloatArray, FloatArray], FittedTable]] = {
    name: fitter.safe for name, fitter in _OF_ONE_MEASURE.items()
}
"""Fitters of the monotonic and positive versions of the raw curves of one measure, by name."""
