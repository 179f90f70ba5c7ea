"""Plain curves from the size of a box to its distance: polynomials (Zhang et al.) and simple
baselines.

    polynomial   d = c0 + c1 s + ... + ck s^k    s = diagonal (Zhang et al., eq. 4-7) or height of the box
    inverse      1 / d = a + b s                 pinhole model with an offset
    log-linear   log d = a + b log h + c log w + e |tan bearing|

Sizes s, w, h are divided by the focal length. Polynomials are fitted by least squares in d, as
Zhang et al. did, the inverse in (a + b s) d - 1 (the relative error), the log-linear curve in log
d. A polynomial may increase or become negative outside the fitted sizes; `SAFE_CURVES` make it
monotonically decreasing and positive.

TableSizes: size model with monotonic tables of plain curves, such as Zhang's polynomial of the box
diagonal.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
from numpy.polynomial import Polynomial
from pydantic import BaseModel, ConfigDict, Field

from track_range.foundation.arrays import FloatArray
from track_range.foundation.schemas.validation import Integer, Number
from track_range.ranging.size_models import size_model

# (N, 2) width and height / f -> (N,) box measure s, a curve's argument
Measure = Callable[[FloatArray], FloatArray]
# (N, 2) sizes / f, (N,) tan bearing -> (N,) distance, m
Curve = Callable[[FloatArray, FloatArray], FloatArray]
# (N, 2) sizes / f, tan bearing, distance -> curve
CurveFitter = Callable[[FloatArray, FloatArray, FloatArray], Curve]
_TABLE_SIZE = 64  # number of nodes of a table


def height(wh_over_f: FloatArray) -> FloatArray:
    """(N,) height of boxes, divided by the focal length."""
    return wh_over_f[:, 1]


def diagonal(wh_over_f: FloatArray) -> FloatArray:
    """(N,) diagonal of boxes, divided by the focal length."""
    return np.asarray(np.hypot(wh_over_f[:, 0], wh_over_f[:, 1]))


# by their name in curve files
MEASURES: Mapping[str, Measure] = {"height": height, "diagonal": diagonal}


@dataclass(frozen=True, slots=True)
class FittedTable:
    """A monotonic curve of one box measure: linear between (log_size, log_distance), d = const / s
    outside.
    """

    measure: Measure
    log_size: FloatArray
    log_distance: FloatArray

    def __call__(self, wh_over_f: FloatArray, bearing: FloatArray) -> FloatArray:
        """(N,) distance in m, positive; the bearing is not used."""
        log_s = np.log(self.measure(wh_over_f))
        inside = np.clip(log_s, self.log_size[0], self.log_size[-1])
        return np.asarray(
            np.exp(np.interp(inside, self.log_size, self.log_distance) - (log_s - inside))
        )


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
    """Fits a function of one box measure; outside the fitted sizes, distances may be negative or
    increasing.
    """

    measure: Measure
    fit: Callable[[FloatArray, FloatArray], Callable[[FloatArray], FloatArray]]

    def __call__(self, wh_over_f: FloatArray, bearing: FloatArray, distance_m: FloatArray) -> Curve:
        function = self.fit(self.measure(wh_over_f), distance_m)
        return lambda wh_over_f, bearing: np.asarray(function(self.measure(wh_over_f)))

    def safe(
        self, wh_over_f: FloatArray, bearing: FloatArray, distance_m: FloatArray
    ) -> FittedTable:
        """The curve within the fitted sizes, constant where it would increase; d = const / s
        outside.

        Distances are between half the smallest and twice the largest fitted distance. The table
        spans the central 99 % of the sizes, so that it does not depend on single boxes at either
        end.
        """
        size = self.measure(wh_over_f)
        low, high = np.log(np.quantile(size, [0.005, 0.995]))
        log_size = np.linspace(low, high, _TABLE_SIZE)
        raw_m = self.fit(size, distance_m)(np.exp(log_size))
        raw_m = np.where(np.isfinite(raw_m), raw_m, np.inf)
        decreasing_m = np.minimum.accumulate(
            np.clip(raw_m, distance_m.min() / 2, distance_m.max() * 2)
        )
        return FittedTable(self.measure, log_size, np.log(decreasing_m))


_OF_ONE_MEASURE: Mapping[str, _RawFitter] = {
    **{
        f"diagonal-{degree}": _RawFitter(diagonal, partial(Polynomial.fit, deg=degree))
        for degree in (3, 4, 5)
    },
    **{
        f"height-{degree}": _RawFitter(height, partial(Polynomial.fit, deg=degree))
        for degree in (3, 4, 5)
    },
    "inverse-height": _RawFitter(height, _fit_inverse),
}

# raw curves
PLAIN_CURVES: Mapping[str, CurveFitter] = {**_OF_ONE_MEASURE, "log-linear": _fit_log_linear}


def within_range(fit_curve: CurveFitter) -> CurveFitter:
    """Fitter of the same curve without distances (NaN) that are less than half of the smallest or
    more than twice the largest fitted one: a polynomial of cars at 40 m has billions of metres for
    boxes of cars at 10 m.
    """

    def fit(wh_over_f: FloatArray, bearing: FloatArray, distance_m: FloatArray) -> Curve:
        curve = fit_curve(wh_over_f, bearing, distance_m)
        return lambda wh_over_f, bearing: _within_range(curve(wh_over_f, bearing), distance_m)

    return fit


def _within_range(curve_m: FloatArray, fitted_m: FloatArray) -> FloatArray:
    is_within = (fitted_m.min() / 2 <= curve_m) & (curve_m <= 2 * fitted_m.max())
    return np.where(is_within, curve_m, np.nan)


SAFE_CURVES: Mapping[str, Callable[[FloatArray, FloatArray, FloatArray], FittedTable]] = {
    name: fitter.safe for name, fitter in _OF_ONE_MEASURE.items()
}
"""Fitters of the monotonic and positive versions of the raw curves of one measure, by name."""


KIND = "table"  # value of "kind" in curve files of this model
# smallest difference of successive nodes in log size; the slopes of smaller ones overflow
_MIN_STEP = 1e-9
_STEP = 0.02  # step in log size, to either side, of the numerical slope of a curve


@dataclass(frozen=True, slots=True, kw_only=True)
class TableCurve:
    """The curve of one class."""

    table: FittedTable  # log distance as a function of the log size
    sigma_relative: float  # standard deviation of the relative error on left-out sequences
    n: int  # number of fitted boxes
    source: str  # origin of the curve


_Nodes = Annotated[
    list[Annotated[Number, Field(ge=-20, le=20)]], Field(min_length=2, max_length=10_000)
]
"""Logarithms of the nodes of a table, within +-10 for box sizes and distances."""


class _ClassTable(BaseModel):
    log_size: _Nodes
    log_distance: _Nodes
    sigma_relative: size_model.Sigma
    n: Integer
    source: str


class TableFile(BaseModel):
    """Content of a curve file with tables, by size class."""

    model_config = ConfigDict(extra="ignore", frozen=True)
    measure: Literal["height", "diagonal"]
    classes: dict[size_model.SizeClass, _ClassTable]


class TableSizes:
    """Size model with a table per class, all of the same box measure."""

    def __init__(self, measure: str, curves: Mapping[str, TableCurve]) -> None:
        """Create a model from curves by size class, all of the box measure `measure` (a key of
        `MEASURES`).

        Boxes of other classes are not ranged (NaN).
        """
        self.box_measure = measure
        self.curves = dict(curves)

    def measure(
        self, boxes: size_model.BoxExtents, drive: size_model.DriveState | None = None
    ) -> size_model.SizeRanges:
        """Distances of the boxes, each ranged separately; NaN if a side is cut and the curves need
        the width.
        """
        distance_m, sigma_m, systematic_m = np.full((3, len(boxes)), np.nan)
        usable = boxes.uses_width | (self.box_measure == "height")
        for name, curve in self.curves.items():
            rows = np.flatnonzero(
                (boxes.size_class == size_model.SIZE_CLASSES.index(name)) & usable
            )
            class_boxes = boxes.select(rows)
            distance_m[rows] = curve.table(class_boxes.wh_over_f, class_boxes.bearing)
            # (N, 2) slopes of log distance in log width and log height.
            wh, bearing = class_boxes.wh_over_f, class_boxes.bearing
            differences = [
                np.log(curve.table(wh * np.exp(step), bearing))
                - np.log(curve.table(wh * np.exp(-step), bearing))
                for step in _STEP * np.identity(2)
            ]
            slopes = np.stack(differences, axis=1) / (2 * _STEP)
            noise = (slopes**2 * class_boxes.noise_variance).sum(axis=1)
            systematic = curve.sigma_relative**2 + (
                slopes**2 * class_boxes.systematic_sigma**2
            ).sum(axis=1)
            systematic_m[rows] = distance_m[rows] * np.sqrt(systematic)
            sigma_m[rows] = np.hypot(systematic_m[rows], distance_m[rows] * np.sqrt(noise))
        return size_model.SizeRanges(distance_m, sigma_m, systematic_m)

    def document(self) -> dict[str, Any]:
        """Content of a curve file with this model."""
        classes = {
            name: {
                "log_size": curve.table.log_size.round(5).tolist(),
                "log_distance": curve.table.log_distance.round(5).tolist(),
                "sigma_relative": round(curve.sigma_relative, 4),
                "n": curve.n,
                "source": curve.source,
            }
            for name, curve in self.curves.items()
        }
        return {"kind": KIND, "measure": self.box_measure, "classes": classes}


def tables_in(content: TableFile) -> TableSizes:
    """The model in the content of a curve file; ValueError if a table increases or its lists differ
    in length.
    """
    curves = {}
    for name, numbers in content.classes.items():
        log_size, log_distance = np.array(numbers.log_size), np.array(numbers.log_distance)
        is_table = log_size.shape == log_distance.shape
        if not (
            is_table
            and (np.diff(log_size) >= _MIN_STEP).all()
            and (np.diff(log_distance) <= 0).all()
        ):
            raise ValueError(f"{name}: log_size must increase and log_distance must not")
        table = FittedTable(MEASURES[content.measure], log_size, log_distance)
        curves[name] = TableCurve(
            table=table, sigma_relative=numbers.sigma_relative, n=numbers.n, source=numbers.source
        )
    return TableSizes(content.measure, curves)
