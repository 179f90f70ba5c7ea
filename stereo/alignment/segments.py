"""Disparity errors from segments of a drive, and their uncertainty by a jackknife over image strips and time.

The noise of single points is the smallest part of the uncertainty: errors from a facade, vegetation, the slope of the
road or a wrong distortion model are common to many points. So the normal equations are stored per strip of the image
and part of the time, and sigma comes from the delete-a-group jackknife (`foundation.robust_statistics`) over strips and
over parts, which is larger than the number of points suggests.
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
    Observations,
    equations_of,
    fit_bundle,
    linearize,
)
from track_range.stereo.alignment.initial_poses import MIN_POINTS, initial_bundle, only_points
from track_range.stereo.geometry.rig import StereoRig

N_STRIPS = 8
"""Number of vertical strips of the image."""

_N_ALL = N_ERRORS + N_STRIPS
"""Number of errors in the equations: offset, curvature and an additional offset of each strip."""

_N_PARTS = 12
"""Number of parts of a segment by time; with fewer, leaving one out would leave frames without points."""

_MIN_PATH_M = 2.0
"""Shortest path of a segment; on shorter ones, the noise of the poses is not small compared to the parallax."""

_STATIC_WEIGHT = 0.25
"""Minimum mean Cauchy weight of a static point (about 0.6 for static points, 0.02 for moving objects)."""

_MIN_STATIC_SHARE = 0.5
"""Minimum fraction of static points."""

_MAX_ERROR_PX = 15.0
"""Largest plausible offset or curvature; beyond it, motion and disparities are inconsistent."""

_PRIOR_PX = 5.0
"""Prior standard deviation of offset and curvature."""

_STRIP_PRIOR_PX = 1.0
"""Prior standard deviation of the additional offset of a strip."""

_MAX_STRIP_SIGMA_PX = 0.3
"""Largest standard deviation of a strip's offset that counts in the spread."""

_MIN_STRIPS = 3
"""Minimum number of strips for a spread."""


class Cell(NamedTuple):
    """A strip of the image and a part of the time; points are assigned by their mean position."""

    strip: int
    part: int


@dataclass(frozen=True, slots=True)
class Segment:
    """Equations for the disparity error from a few seconds of a drive.

    Attributes:
        n_frames: number of frames used.
        error_px: (2,) offset and curvature at which the equations are linearized.
        cells: equations for offset, curvature, and an additional offset of each strip, by strip and part of the time.
    """

    n_frames: int
    error_px: FloatArray
    cells: dict[Cell, Equations]

    def information(self, left_out: Collection[Cell] = ()) -> tuple[FloatArray, FloatArray]:
        """Information I (E, E) on the errors e, and I e (E,), without the cells in `left_out`."""
        used = [equations for cell, equations in self.cells.items() if cell not in left_out]
        if not used:
            return np.zeros((_N_ALL, _N_ALL)), np.zeros(_N_ALL)
        s, b = np.sum([cell.s for cell in used], axis=0), np.sum([cell.b for cell in used], axis=0)
        information, step = Equations(s, b, used[0].n_pose_unknowns).of_errors()
        return information, step + information[:, :N_ERRORS] @ self.error_px


class CombinedEstimate(NamedTuple):
    """The disparity error estimated from several segments.

    Attributes:
        error_px: (2,) offset and curvature; curvature 0 if not estimated.
        sigma_px: (2,) their standard deviations.
        spread_px: root mean square of the additional offsets of the strips; NaN if too few are determined.
    """

    error_px: FloatArray
    sigma_px: FloatArray
    spread_px: float


def segment_of(observed: Observations, rig: StereoRig) -> Segment | str:
    """The segment of some observations, or the reason why they are unusable; `rig` is rectified."""
    initial = initial_bundle(observed, rig)
    if initial is None:
        return "too few points were tracked"
    observed, start = initial
    observed, fit, static_share = _static_points(observed, start, rig)
    if not np.isfinite(fit.bundle.error_px).all() or np.abs(fit.bundle.error_px).max() > _MAX_ERROR_PX:
        return "motion and disparities of the points are inconsistent"
    if fit.bundle.path_m < _MIN_PATH_M:
        return "the vehicle hardly moves, or only turns"
    if static_share < _MIN_STATIC_SHARE:
        return "too many moving objects in the scene"
    return Segment(int(observed.frame.max()) + 1, fit.bundle.error_px, _cells(observed, fit, rig))


def _static_points(observed: Observations, start: Bundle, rig: StereoRig) -> tuple[Observations, Fit, float]:
    """Observations and fit of static points, and their fraction; moving points bias the fit even with small weights."""
    fit = fit_bundle(observed, start, rig)
    n_points = len(start.points)
    weight = np.bincount(observed.point, fit.weight, n_points) / np.bincount(observed.point, minlength=n_points)
    is_static = weight > _STATIC_WEIGHT
    if is_static.all() or is_static.sum() < MIN_POINTS:
        return observed, fit, float(is_static.mean())
    static = only_points(observed, is_static)
    start = replace(fit.bundle, points=fit.bundle.points[is_static])
    return static, fit_bundle(static, start, rig), float(is_static.mean())


def combine(segments: Sequence[Segment], *, has_curvature: bool) -> CombinedEstimate:
    """The least-squares disparity error of one or more segments.

    sigma^2 = jackknife variance over the strips (of all segments) + jackknife variance over the parts of the time.
    """
    estimated = np.arange(N_ERRORS if has_curvature else 1)
    all_parts = range(_N_PARTS)
    strips = {cell.strip for segment in segments for cell in segment.cells}
    whole = [segment.information() for segment in segments]
    without_strip = [
        _solve([segment.information([Cell(strip, part) for part in all_parts]) for segment in segments], estimated)
        for strip in strips
    ]
    without_part = [
        _solve([*others, segment.information([Cell(strip, part) for strip in strips])], estimated)
        for segment, others in ((segment, whole[:i] + whole[i + 1 :]) for i, segment in enumerate(segments))
        for part in all_parts
    ]
    sigma_px = np.hypot(jackknife_sigma(np.array(without_strip)), jackknife_sigma(np.array(without_part)))
    return CombinedEstimate(_padded(_solve(whole, estimated)), _padded(sigma_px), _spread_px(whole))


def _cells(observed: Observations, fit: Fit, rig: StereoRig) -> dict[Cell, Equations]:
    """Equations by cell; a point belongs to the cell of its mean column and mean frame; parts have equal numbers."""
    n_points, n_frames = int(observed.point.max()) + 1, int(observed.frame.max()) + 1
    n_observations = np.bincount(observed.point, minlength=n_points)
    mean_x_px = np.bincount(observed.point, observed.xyx_px[:, 0], n_points) / n_observations
    mean_frame = np.bincount(observed.point, observed.frame, n_points) / n_observations
    edges = np.quantile(mean_frame, np.arange(1, _N_PARTS) / _N_PARTS)
    point_cell = _strip(mean_x_px, rig) * _N_PARTS + np.searchsorted(edges, mean_frame)

    strip_columns = np.eye(N_STRIPS)[_strip(observed.xyx_px[:, 0], rig)]
    linear = linearize(observed, fit.bundle, rig, extra=strip_columns)
    weight = fit.weight / fit.noise_px**2
    cells = {}
    for number in np.unique(point_cell).tolist():
        rows = (point_cell == number)[observed.point]
        _, point = np.unique(observed.point[rows], return_inverse=True)
        in_cell = Observations(observed.frame[rows], point, observed.xyx_px[rows])
        cell_linear = Linear(*(part[rows] for part in linear))
        cells[Cell(*divmod(number, _N_PARTS))] = equations_of(in_cell, cell_linear, weight[rows], n_frames=n_frames)
    return cells


def _strip(x_px: FloatArray, rig: StereoRig) -> IntArray:
    return np.clip((x_px * N_STRIPS / rig.left.width_px).astype(np.int64), 0, N_STRIPS - 1)


def _solve(parts: Sequence[tuple[FloatArray, FloatArray]], estimated: IntArray) -> FloatArray:
    """The estimated errors, with the others 0, from I and I e of the segments."""
    information, rhs = _summed(parts)
    prior = np.eye(len(estimated)) / _PRIOR_PX**2
    return np.asarray(np.linalg.solve(information[np.ix_(estimated, estimated)] + prior, rhs[estimated]))


def _summed(parts: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    return np.sum([part[0] for part in parts], axis=0), np.sum([part[1] for part in parts], axis=0)


def _spread_px(parts: Sequence[tuple[FloatArray, FloatArray]]) -> float:
    information, rhs = _summed(parts)
    prior = np.diag([_PRIOR_PX**-2] * N_ERRORS + [_STRIP_PRIOR_PX**-2] * N_STRIPS)
    strip_offset_px = np.linalg.solve(information + prior, rhs)[N_ERRORS:]
    is_determined = np.diag(information)[N_ERRORS:] > _MAX_STRIP_SIGMA_PX**-2
    if is_determined.sum() < _MIN_STRIPS:
        return float("nan")
    return float(np.sqrt((strip_offset_px[is_determined] ** 2).mean()))


def _padded(errors: FloatArray) -> FloatArray:
    return np.concatenate([errors, np.zeros(N_ERRORS - len(errors))])
