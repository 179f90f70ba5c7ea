"""Distance from the size of a box: one log-linear curve per class, on sizes divided by the focal length.

    log d = intercept + per_log_height log(h / fy) + per_log_width log(w / fx) + per_bearing |tan bearing|

For a flat object of known size the slopes are -1 and 0 and exp(intercept) is its height in metres. Unlike the
polynomial of the box's diagonal (Zhang et al., the paper's eq. 4-7) it cannot turn negative or rise again outside the
fitted range. A second set of coefficients without the width serves boxes whose side is cut off.
Sigma: a relative part (other drives, other makes: leave-one-sequence-out residuals) plus the box's own noise in pixels.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from detection.classes import ROAD_CLASSES
from detection.detections import FloatArray, IntArray

CURVE_VERSION = 1


class CurveError(Exception):
    """A curve file that cannot be used, or labels that no curve can be fitted on; the message says why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SizeCurve:
    """The curve of one class.

    Attributes:
        intercept: log metres.
        per_log_height: slope in log(h / fy), negative.
        per_log_width: slope in log(w / fx), <= 0; 0 = the width is not used.
        per_bearing: slope in |tan bearing|.
        sigma_relative: standard deviation of the relative error on exact boxes of drives not fitted on.
        n: boxes fitted on; 0 = from a standard size.
        source: from what the coefficients come.
    """

    intercept: float
    per_log_height: float
    per_log_width: float
    per_bearing: float
    sigma_relative: float
    n: int
    source: str

    @property
    def coefficients(self) -> tuple[float, ...]:
        """The four in the equation's order."""
        return self.intercept, self.per_log_height, self.per_log_width, self.per_bearing


class SizeCurves:
    """The curves of all classes as arrays, so that a frame's boxes are ranged at once."""

    def __init__(self, whole: Mapping[str, SizeCurve], height_only: Mapping[str, SizeCurve]) -> None:
        """Curves by road class, for whole boxes and for boxes with a side cut off; a class without one gives NaN."""
        self.whole = dict(whole)
        self.height_only = dict(height_only)
        self._tables = np.stack([_table(self.height_only), _table(self.whole)])

    def distance(
        self, wh_over_f: FloatArray, bearing: FloatArray, *, class_id: IntArray, use_width: Any, noise_over_f: float
    ) -> tuple[FloatArray, FloatArray]:
        """(N,) distance_m and (N,) sigma_m of boxes.

        Args:
            wh_over_f: (N, 2) width / fx and height / fy, positive.
            bearing: (N,) tangent of the angle from the camera's axis in x.
            class_id: (N,) road class.
            use_width: (N,) bool, False = the width is cut off.
            noise_over_f: standard deviation of one box edge, divided by the focal length.
        """
        table = self._tables[np.asarray(use_width, np.int64), class_id]
        log_size = np.log(wh_over_f)
        slopes = table[:, 1:4]
        terms = np.stack([log_size[:, 1], log_size[:, 0], np.abs(bearing)], axis=1)
        distance_m = np.exp(table[:, 0] + (slopes * terms).sum(axis=1))
        edge_noise = np.sqrt(2.0) * noise_over_f / wh_over_f  # a size is the difference of two edges
        variance = table[:, 4] ** 2 + (slopes[:, 0] * edge_noise[:, 1]) ** 2 + (slopes[:, 1] * edge_noise[:, 0]) ** 2
        return distance_m, distance_m * np.sqrt(variance)

    def save(self, path: Path) -> None:
        """Write the curves as JSON, whole or not at all.

        Raises:
            CurveError: the file cannot be written.
        """
        document = {
            "track_range_size_curves": CURVE_VERSION,
            "equation": "log d_m = intercept + per_log_height log(h/fy) + per_log_width log(w/fx) + per_bearing |x/z|",
            "whole": {name: asdict(curve) for name, curve in self.whole.items()},
            "height_only": {name: asdict(curve) for name, curve in self.height_only.items()},
        }
        partial = path.with_name(path.name + ".part")
        try:
            partial.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
            partial.replace(path)
        except OSError as error:
            raise CurveError(f"{path}: cannot be written ({error.strerror or error}).") from error


def _table(curves: Mapping[str, SizeCurve]) -> FloatArray:
    """(number of classes, 5): the four coefficients and sigma_relative; NaN where a class has no curve."""
    table = np.full((len(ROAD_CLASSES), 5), np.nan)
    for name, curve in curves.items():
        table[ROAD_CLASSES.index(name)] = (*curve.coefficients, curve.sigma_relative)
    return table


def load_curves(path: Path | None = None) -> SizeCurves:
    """Curves from a JSON file; None = the packaged ones.

    Raises:
        CurveError: no such file, not our format or version, an unknown class, a curve that rises with size.
    """
    packaged = resources.files("ranging").joinpath("curves/log_linear.json")
    name = str(path or packaged)
    try:
        document = json.loads((path or packaged).read_text(encoding="utf-8"))
        version = document["track_range_size_curves"]
        if version != CURVE_VERSION:
            raise CurveError(
                f"{name}: version {version} of a curve file; this track-range reads version {CURVE_VERSION}."
            )
        whole, height_only = (_curves_in(document[key]) for key in ("whole", "height_only"))
    except OSError as error:
        raise CurveError(f"{name}: cannot be read ({error.strerror or error}).") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise CurveError(f"{name}: not a curve file of track-range ({error!r}).") from error
    return SizeCurves(whole, height_only)


def _curves_in(section: Mapping[str, Mapping[str, Any]]) -> dict[str, SizeCurve]:
    curves = {name: SizeCurve(**fields) for name, fields in section.items()}
    for name, curve in curves.items():
        if name not in ROAD_CLASSES:
            raise ValueError(f"{name} is no road class")
        if not (curve.per_log_height < 0 and curve.per_log_width <= 0 and curve.sigma_relative > 0):
            raise ValueError(f"{name}: distance must fall with size, and sigma_relative be positive")
    return curves
