"""What a stretch of a drive says about the disparity error, kept apart by where and when, and what several say.

The noise of single points is the least of what is uncertain: a facade, a bush, the road's slant or a wrong model of the
lens err together. So the normal equations are kept for each strip of the image and each part of the time, and
uncertainty is the scatter of the estimate when one strip, or one part, is left out (the jackknife over groups;
Efron, "The jackknife, the bootstrap and other resampling plans", 1982), not what the number of points promises.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.robust_statistics import jackknife_sigma
from track_range.stereo.alignment.bundle_adjustment import (
    N_ERRORS,
    Bundle,
    Equations,
    Fit,
    Linear,
    Sightings,
    equations_of,
    fit_bundle,
    linearised,
)
from track_range.stereo.alignment.initial_poses import MIN_POINTS, only_points, start_bundle
from track_range.stereo.geometry.rig import StereoRig

N_STRIPS = 8
_N_ALL = N_ERRORS + N_STRIPS
_N_PARTS = 12
"""Parts of a stretch by time; leaving one of few out would leave frames without points, whose poses then run away."""

_MIN_PATH_M = 2.0
"""Over a shorter way the noise of the poses is a good part of what points seem to move."""

_STILL_WEIGHT = 0.25
"""Mean weight from which a point belongs to what stands still (about 0.6 there, 0.02 for what moves by itself)."""

_MIN_STILL = 0.5
"""Share of the points that must stand still."""

_MAX_ERROR_PX = 15.0

_PRIOR_PX = 5.0
_STRIP_PRIOR_PX = 1.0
_MAX_STRIP_SIGMA_PX = 0.3
_MIN_STRIPS = 3


class Cell(NamedTuple):
    """A strip of the image and a part of the time; points belong where they are on average."""

    strip: int
    part: int


@dataclass(frozen=True, slots=True)
class Stretch:
    """What some seconds of a drive say.

    Attributes:
        n_frames: that were used.
        error_px: (2,) offset and bow that the equations are linearised at.
        cells: equations of the errors: offset, bow, and an offset of each strip of its own.
    """

    n_frames: int
    error_px: FloatArray
    cells: dict[Cell, Equations]

    def information(self, left_out: Collection[Cell] = ()) -> tuple[FloatArray, FloatArray]:
        """(E, E) information on the errors and (E,) its product with them, of all cells but some."""
        used = [equations for cell, equations in self.cells.items() if cell not in left_out]
        if not used:
            return np.zeros((_N_ALL, _N_ALL)), np.zeros(_N_ALL)
        matrix, rhs = np.sum([each.matrix for each in used], axis=0), np.sum([each.rhs for each in used], axis=0)
        information, towards = Equations(matrix, rhs, used[0].n_pose_unknowns).of_errors()
        return information, towards + information[:, :N_ERRORS] @ self.error_px


class Together(NamedTuple):
    """The estimate of several stretches.

    Attributes:
        error_px: (2,) offset and bow; the bow 0 where it was not asked for.
        sigma_px: (2,) their standard deviations.
        spread_px: root mean square of what strips of the image want beyond offset and bow; NaN where too few tell.
    """

    error_px: FloatArray
    sigma_px: FloatArray
    spread_px: float


def stretch_of(seen: Sightings, rig: StereoRig) -> Stretch | str:
    """What the sightings of a stretch say, or why they say nothing; `rig` is the rectified one."""
    begun = start_bundle(seen, rig)
    if begun is None:
        return "too few points that stay in view"
    seen, start = begun
    seen, fit, share_still = _of_what_stands_still(seen, start, rig)
    if not np.isfinite(fit.bundle.error_px).all() or np.abs(fit.bundle.error_px).max() > _MAX_ERROR_PX:
        return "the points' motion and their disparities do not fit each other"
    if fit.bundle.path_m < _MIN_PATH_M:
        return "the vehicle hardly moves, or only turns"
    if share_still < _MIN_STILL:
        return "too little of the scene stands still"
    return Stretch(int(seen.frame.max()) + 1, fit.bundle.error_px, _cells(seen, fit, rig))


def _of_what_stands_still(seen: Sightings, start: Bundle, rig: StereoRig) -> tuple[Sightings, Fit, float]:
    """The fit without the points that do not belong, which pull even with little weight, and the share of the rest."""
    fit = fit_bundle(seen, start, rig)
    n_points = len(start.points)
    weight = np.bincount(seen.point, fit.weight, n_points) / np.bincount(seen.point, minlength=n_points)
    is_still = weight > _STILL_WEIGHT
    if is_still.all() or is_still.sum() < MIN_POINTS:
        return seen, fit, float(is_still.mean())
    kept = only_points(seen, is_still)
    start = replace(fit.bundle, points=fit.bundle.points[is_still])
    return kept, fit_bundle(kept, start, rig), float(is_still.mean())


def together(stretches: Sequence[Stretch], *, has_bow: bool) -> Together:
    """The error that the stretches agree on best; at least one stretch."""
    asked = np.arange(N_ERRORS if has_bow else 1)
    whole = [stretch.information() for stretch in stretches]
    strips = {cell.strip for stretch in stretches for cell in stretch.cells}
    by_strip, by_time = [], []
    for strip in strips:
        out = [Cell(strip, part) for part in range(_N_PARTS)]
        by_strip.append(_solved([stretch.information(out) for stretch in stretches], asked))
    for number, stretch in enumerate(stretches):
        for part in range(_N_PARTS):
            out = [Cell(strip, part) for strip in strips]
            others = whole[:number] + whole[number + 1 :]
            by_time.append(_solved([*others, stretch.information(out)], asked))
    sigma_px = np.hypot(jackknife_sigma(np.array(by_strip)), jackknife_sigma(np.array(by_time)))
    return Together(_padded(_solved(whole, asked)), _padded(sigma_px), _spread_px(whole))


def _cells(seen: Sightings, fit: Fit, rig: StereoRig) -> dict[Cell, Equations]:
    n_points, n_frames = int(seen.point.max()) + 1, int(seen.frame.max()) + 1
    strip = _strip(seen.xyx_px[:, 0], rig)
    linear = linearised(seen, fit.bundle, rig, extra=np.eye(N_STRIPS)[strip])
    n_sightings = np.bincount(seen.point, minlength=n_points)
    point_strip = _strip(np.bincount(seen.point, seen.xyx_px[:, 0], n_points) / n_sightings, rig)
    mean_frame = np.bincount(seen.point, seen.frame, n_points) / n_sightings
    edges = np.quantile(mean_frame, np.arange(1, _N_PARTS) / _N_PARTS)
    point_cell = point_strip * _N_PARTS + np.searchsorted(edges, mean_frame)
    weight = fit.weight / fit.noise_px**2
    cells = {}
    for number in np.unique(point_cell).tolist():
        keep = (point_cell == number)[seen.point]
        _, point = np.unique(seen.point[keep], return_inverse=True)
        here = Sightings(seen.frame[keep], point, seen.xyx_px[keep])
        rows = Linear(*(part[keep] for part in linear))
        cells[Cell(*divmod(number, _N_PARTS))] = equations_of(here, rows, weight[keep], n_frames=n_frames)
    return cells


def _strip(x_px: FloatArray, rig: StereoRig) -> IntArray:
    return np.clip((x_px * N_STRIPS / rig.left.width_px).astype(np.int64), 0, N_STRIPS - 1)


def _solved(parts: Sequence[tuple[FloatArray, FloatArray]], asked: IntArray) -> FloatArray:
    """The asked errors, the others held at 0, from the stretches' information."""
    information, towards = _summed(parts)
    prior = np.eye(len(asked)) / _PRIOR_PX**2
    return np.asarray(np.linalg.solve(information[np.ix_(asked, asked)] + prior, towards[asked]))


def _summed(parts: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    return np.sum([part[0] for part in parts], axis=0), np.sum([part[1] for part in parts], axis=0)


def _spread_px(parts: Sequence[tuple[FloatArray, FloatArray]]) -> float:
    information, towards = _summed(parts)
    prior = np.diag([_PRIOR_PX**-2] * N_ERRORS + [_STRIP_PRIOR_PX**-2] * N_STRIPS)
    wanted_px = np.linalg.solve(information + prior, towards)[N_ERRORS:]
    told = np.diag(information)[N_ERRORS:] > _MAX_STRIP_SIGMA_PX**-2
    return float(np.sqrt((wanted_px[told] ** 2).mean())) if told.sum() >= _MIN_STRIPS else float("nan")


def _padded(errors: FloatArray) -> FloatArray:
    return np.concatenate([errors, np.zeros(N_ERRORS - len(errors))])
