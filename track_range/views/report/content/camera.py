"""Picture of the posterior of an estimated camera beside its evidence: a curve for each source over
the focal length, and that of all together.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

import numpy as np

from track_range.foundation.arrays import FloatArray

_WIDTH, _HEIGHT = 760, 250  # of the picture, in its own units
_LEFT, _RIGHT, _TOP, _BOTTOM = 16, 744, 12, 214  # borders of the curves
_SHOWN = 0.05  # density relative to its largest value from which on a curve is inside the picture
_N_TICKS = 8


class Tick(TypedDict):
    """One number at the axis of the focal length."""

    x: float
    text: str


class Curve(TypedDict):
    """The density of one source, or of all."""

    points: str  # of a polyline
    name: str
    figures: str  # focal length and standard deviation, in words


class CameraPicture(TypedDict):
    """Everything that the template draws."""

    width: int
    height: int
    bottom: int
    curves: list[Curve]  # of the sources
    all: Curve
    ticks: list[Tick]
    remedy: str  # what would help most; "" = nothing


def camera_picture(summary: Mapping[str, Any]) -> CameraPicture | None:
    """The picture of `camera_estimate` in a summary; None if there is no estimate."""
    estimate = summary.get("camera_estimate")
    if not estimate:
        return None
    focal_px = np.asarray(estimate["curve_px"], np.float64)
    sources = estimate["sources"]
    densities = [np.asarray(part["density"], np.float64) for part in (*sources, estimate)]
    if len(focal_px) < 2 or any(len(density) != len(focal_px) for density in densities):
        return None  # of a damaged file
    low, high = _shown_range(focal_px, densities)
    x = _LEFT + (_RIGHT - _LEFT) * np.log(focal_px / low) / math.log(high / low)
    named = [(part["source"], part["focal_px"], part["sigma"]) for part in sources]
    named.append(("all sources together", estimate["focal_px"], estimate["focal_sigma"]))
    *curves, joint = [
        Curve(points=_points(x, density), name=name, figures=_figures(px, sigma))
        for density, (name, px, sigma) in zip(densities, named, strict=True)
    ]
    remedy = estimate.get("remedy") or {}
    helpful = (
        f"Most would help {remedy['evidence']}, with which the focal length would be known within "
        f"{100 * remedy['focal_sigma']:.1f} %."
        if remedy
        else ""
    )
    return CameraPicture(
        width=_WIDTH,
        height=_HEIGHT,
        bottom=_BOTTOM,
        curves=curves,
        all=joint,
        ticks=_ticks(low, high),
        remedy=helpful,
    )


def _shown_range(focal_px: FloatArray, densities: Sequence[FloatArray]) -> tuple[float, float]:
    """Smallest and largest focal length in the picture."""
    is_shown = np.any([density > _SHOWN for density in densities[:-1]], axis=0)
    inside = focal_px[is_shown | (densities[-1] > _SHOWN)]
    return 0.97 * float(inside.min()), 1.03 * float(inside.max())


def _points(x: FloatArray, density: FloatArray) -> str:
    is_inside = (x >= _LEFT) & (x <= _RIGHT)
    y = _BOTTOM - (_BOTTOM - _TOP) * density / density.max()
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x[is_inside], y[is_inside], strict=True))


def _figures(focal_px: float, sigma: float) -> str:
    return f"{focal_px:,.0f} ± {sigma * focal_px:,.0f} px"


def _ticks(low: float, high: float) -> list[Tick]:
    """Round focal lengths along the logarithmic axis."""
    step = (high - low) / _N_TICKS
    unit = 10.0 ** math.floor(math.log10(step))
    step = next(factor * unit for factor in (1, 2, 5, 10) if factor * unit >= step)
    values = np.arange(math.ceil(low / step), math.floor(high / step) + 1) * step
    scale = (_RIGHT - _LEFT) / math.log(high / low)
    return [Tick(x=round(_LEFT + scale * math.log(v / low), 1), text=f"{v:,.0f}") for v in values]
