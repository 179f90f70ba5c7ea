"""SizeCurves: distance from the size of a box by a log-linear curve per class, with sizes divided by the focal length.

    log d = intercept + per_log_height log(h / fy) + per_log_width log(w / fx) + per_bearing |tan bearing|

For a flat object of known size the slopes are -1 and 0, and exp(intercept) is its height in metres. Unlike the
polynomial of the box diagonal (Zhang et al., eq. 4-7), the curve is positive and monotonic also outside the fitted
range. Boxes truncated at a side are ranged by a second set of coefficients without the width. Sigma has a relative
part (residuals on left-out sequences) and a part from the noise of the box in px.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from track_range.foundation.arrays import FloatArray
from track_range.foundation.schemas.validation import Integer, Number
from track_range.ranging.size_models import size_model

KIND = "log-linear"  # value of "kind" in curve files of this model

_Intercept = Annotated[Number, Field(ge=-20, le=20)]
# coefficients in a file; exp(20) m is far beyond any distance
_Slope = Annotated[Number, Field(ge=-10, le=10)]


@dataclass(frozen=True, slots=True, kw_only=True)
class SizeCurve:
    """The curve of one class."""

    intercept: _Intercept  # log distance in m for sizes of 1
    per_log_height: _Slope  # slope in log(h / fy), negative
    per_log_width: _Slope  # slope in log(w / fx), <= 0; 0 = the width is not used
    per_bearing: _Slope  # slope in |tan bearing|
    # standard deviation of the relative error on exact boxes of left-out sequences
    sigma_relative: size_model.Sigma
    n: Integer  # number of fitted boxes; 0 = from a standard size
    source: str  # origin of the coefficients

    @property
    def coefficients(self) -> tuple[float, ...]:
        """The four coefficients in the order of the equation."""
        return self.intercept, self.per_log_height, self.per_log_width, self.per_bearing


class LogLinearFile(BaseModel):
    """Content of a curve file with log-linear curves, by size class."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)
    whole: dict[size_model.SizeClass, SizeCurve]
    height_only: dict[size_model.SizeClass, SizeCurve]


class SizeCurves:
    """Size model with a log-linear curve per class."""

    def __init__(
        self, whole: Mapping[str, SizeCurve], height_only: Mapping[str, SizeCurve]
    ) -> None:
        """Create a model from curves by size class, for whole boxes and for boxes truncated at a
        side.

        Boxes of other classes are not ranged (NaN).
        """
        self.whole = dict(whole)
        self.height_only = dict(height_only)
        self._tables = np.stack([_table(self.height_only), _table(self.whole)])

    def measure(
        self, boxes: size_model.BoxExtents, drive: size_model.DriveState | None = None
    ) -> size_model.SizeRanges:
        """Distances of the boxes, each ranged separately."""
        table = self._tables[boxes.uses_width.astype(np.int64), boxes.size_class]
        log_size = np.log(boxes.wh_over_f)
        slopes = table[:, 1:4]
        terms = np.stack([log_size[:, 1], log_size[:, 0], np.abs(boxes.bearing)], axis=1)
        distance_m = np.exp(table[:, 0] + (slopes * terms).sum(axis=1))
        of_width_height = slopes[:, 1::-1] ** 2
        noise = (of_width_height * boxes.noise_variance).sum(axis=1)
        systematic = table[:, 4] ** 2 + (of_width_height * boxes.systematic_sigma**2).sum(axis=1)
        systematic_m = distance_m * np.sqrt(systematic)
        return size_model.SizeRanges(
            distance_m, np.hypot(systematic_m, distance_m * np.sqrt(noise)), systematic_m
        )

    def document(self) -> dict[str, Any]:
        """Content of a curve file with this model."""
        equation = (
            "log d_m = intercept + per_log_height log(h/fy) + per_log_width log(w/fx) + "
            "per_bearing |x/z|"
        )
        sections = {
            "whole": {name: asdict(curve) for name, curve in self.whole.items()},
            "height_only": {name: asdict(curve) for name, curve in self.height_only.items()},
        }
        return {"kind": KIND, "equation": equation, **sections}


def log_linear_in(content: LogLinearFile) -> SizeCurves:
    """The model in the content of a curve file; ValueError if a distance increases with the
    size.
    """
    for section in (content.whole, content.height_only):
        for name, curve in section.items():
            if not (curve.per_log_height < 0 and curve.per_log_width <= 0):
                raise ValueError(
                    f"{name}: expected per_log_height < 0 and per_log_width <= 0, found "
                    f"{curve.per_log_height:g} and {curve.per_log_width:g}"
                )
    return SizeCurves(content.whole, content.height_only)


def _table(curves: Mapping[str, SizeCurve]) -> FloatArray:
    """(number of classes, 5) the four coefficients and sigma_relative; NaN = the class has no
    curve.
    """
    table = np.full((len(size_model.SIZE_CLASSES), 5), np.nan)
    # for files without vans, which detectors call cars
    defaults = {"van": curves["car"]} if "car" in curves else {}
    for name, curve in {**defaults, **curves}.items():
        table[size_model.SIZE_CLASSES.index(name)] = (*curve.coefficients, curve.sigma_relative)
    return table
