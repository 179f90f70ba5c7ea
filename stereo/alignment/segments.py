"""Disparity errors from segments of a drive, and their uncertainty by a jackknife over image strips and time.

The noise of single points is the smallest part of the uncertainty: errors of a facade, a bush, the road's slope or a
wrong lens model are common to many points. So the normal equations are stored per strip of the image and part of the
time, and sigma is that of the delete-a-group jackknife (`foundation.robust_statistics`) over strips and over parts,
instead of what the number of points suggests.
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
"""Vertical strips of the image."""

_N_ALL = N_ERRORS + N_STRIPS
_N_PARTS = 12
"""Parts of a segment by time; with fewer, leaving one out would leave frames without points to hold their pose."""

_MIN_PATH_M = 2.0
"""Shortest path; on a shorter one the noise of the poses is a good part of the points' apparent motion."""

_STILL_WEIGHT = 0.25
"""Mean Cauchy weight from which a point counts as static (about 0.6 for static points, 0.02 for moving objects)."""

_MIN_STILL = 0.5
"""Smallest share of static points."""

_MAX_ERROR_PX = 15.0
"""Largest plausible offset or bow; beyond, motion and disparities contradict each other."""

_PRIOR_PX = 5.0
"""Prior standard deviation of offset and bow."""

_STRIP_PRIOR_PX = 1.0
"""Prior standard deviation of a strip's own offset."""

_MAX_STRIP_SIGMA_PX = 0.3
"""Largest standard deviation of a strip's own offset that counts in the spread."""

_MIN_STRIPS = 3
"""Fewest strips for a spread."""


class Cell(NamedTuple):
    """A strip of the image and a part of the time; points belong where they are on average."""

    strip: int
    part: int


@dataclass(frozen=True, slots=True)
class Segment:
    """Equations for the disparity error from some seconds of a drive.

    Attributes:
        n_frames: number of frames used.
        error_px: (2,) offset and bow that the equations are linearize at.
        cells: equations for offset, bow, and an additional offset of each strip, by strip and part of the time.
    """

    n_frames: int
    error_px: FloatArray
    cells: dict[Cell, Equations]

    def information(self, left_out: Collection[Cell] = ()) -> tuple[FloatArray, FloatArray]:
        """I (E, E) and I e (E,): information on the errors e, and its product with them, without some cells."""
        used = [equations for cell, equations in self.cells.items() if cell not in left_out]
        if not used:
            return np.zeros((_N_ALL, _N_ALL)), np.zeros(_N_ALL)
        s, b = np.sum([cell.s for cell in used], axis=0), np.sum([cell.b for cell in used], axis=0)
        information, step = Equations(s, b, used[0].n_pose_unknowns).of_errors()
        return information, step + information[:, :N_ERRORS] @ self.error_px


class CombinedEstimate(NamedTuple):
    """The disparity error estimated from several segments.

    Attributes:
        error_px: (2,) offset and bow; bow 0 where it was not estimated.
        sigma_px: (2,) their standard deviations.
        spread_px: root mean square of the strips' own offsets, beyond offset and bow; NaN where too few are determined.
    """

    error_px: FloatArray
    sigma_px: FloatArray
    spread_px: float


def segment_of(observed: Observations, rig: StereoRig) -> Segment | str:
    """The segment of some observations, or why they cannot be used; `rig` is the rectified one."""
    start_points = initial_bundle(observed, rig)
    if start_points is None:
        return "too few points that stay in view"
    observed, start = start_points
    observed, fit, share_still = _static_points(observed, start, rig)
    if not np.isfinite(fit.bundle.error_px).all() or np.abs(fit.bundle.error_px).max() > _MAX_ERROR_PX:
        return "the points' motion and their disparities do not fit each other"
    if fit.bundle.path_m < _MIN_PATH_M:
        return "the vehicle hardly moves, or only turns"
    if share_still < _MIN_STILL:
        return "too little of the scene stands still"
    return Segment(int(observed.frame.max()) + 1, fit.bundle.error_px, _cells(observed, fit, rig))


def _static_points(observed: Observations, start: Bundle, rig: StereoRig) -> tuple[Observations, Fit, float]:
    """Observations and fit of static points only, and their share: moving ones bias it even with small weights."""
    fit = fit_bundle(observed, start, rig)
    n_points = len(start.points)
    weight = np.bincount(observed.point, fit.weight, n_points) / np.bincount(observed.point, minlength=n_points)
    is_still = weight > _STILL_WEIGHT
    if is_still.all() or is_still.sum() < MIN_POINTS:
        return observed, fit, float(is_still.mean())
    kept = only_points(observed, is_still)
    start = replace(fit.bundle, points=fit.bundle.points[is_still])
    return kept, fit_bundle(kept, start, rig), float(is_still.mean())


def combine(segments: Sequence[Segment], *, has_bow: bool) -> CombinedEstimate:
    """The least-squares error of one or more segments together.

    sigma^2 = jackknife variance over the strips (of all segments) + jackknife variance over the parts of the time.
    """
    estimated = np.arange(N_ERRORS if has_bow else 1)
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
    """Equations per cell; a point belongs to the cell of its mean column and mean frame, parts hold equally many."""
    n_points, n_frames = int(observed.point.max()) + 1, int(observed.frame.max()) + 1
    n_observations = np.bincount(observed.point, minlength=n_points)
    mean_x_px = np.bincount(observed.point, observed.xyx_px[:, 0], n_points) / n_observations
    mean_frame = np.bincount(observed.point, observed.frame, n_points) / n_observations
    edges = np.quantile(mean_frame, np.arange(1, _N_PARTS) / _N_PARTS)
    point_cell = _strip(mean_x_px, rig) * _N_PARTS + np.searchsorted(edges, mean_frame)

    own_offset = np.eye(N_STRIPS)[_strip(observed.xyx_px[:, 0], rig)]
    linear = linearize(observed, fit.bundle, rig, extra=own_offset)
    weight = fit.weight / fit.noise_px**2
    cells = {}
    for number in np.unique(point_cell).tolist():
        keep = (point_cell == number)[observed.point]
        _, point = np.unique(observed.point[keep], return_inverse=True)
        in_cell = Observations(observed.frame[keep], point, observed.xyx_px[keep])
        rows = Linear(*(part[keep] for part in linear))
        cells[Cell(*divmod(number, _N_PARTS))] = equations_of(in_cell, rows, weight[keep], n_frames=n_frames)
    return cells


def _strip(x_px: FloatArray, rig: StereoRig) -> IntArray:
    return np.clip((x_px * N_STRIPS / rig.left.width_px).astype(np.int64), 0, N_STRIPS - 1)


def _solve(parts: Sequence[tuple[FloatArray, FloatArray]], estimated: IntArray) -> FloatArray:
    """The estimated errors, the others 0, from the sums of I and I e of the segments."""
    information, rhs = _summed(parts)
    prior = np.eye(len(estimated)) / _PRIOR_PX**2
    return np.asarray(np.linalg.solve(information[np.ix_(estimated, estimated)] + prior, rhs[estimated]))


def _summed(parts: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    return np.sum([part[0] for part in parts], axis=0), np.sum([part[1] for part in parts], axis=0)


def _spread_px(parts: Sequence[tuple[FloatArray, FloatArray]]) -> float:
    information, rhs = _summed(parts)
    prior = np.diag([_PRIOR_PX**-2] * N_ERRORS + [_STRIP_PRIOR_PX**-2] * N_STRIPS)
    own_offset_px = np.linalg.solve(information + prior, rhs)[N_ERRORS:]
    is_determined = np.diag(information)[N_ERRORS:] > _MAX_STRIP_SIGMA_PX**-2
    if is_determined.sum() < _MIN_STRIPS:
        return float("nan")
    return float(np.sqrt((own_offset_px[is_determined] ** 2).mean()))


def _padded(errors: FloatArray) -> FloatArray:
    return np.concatenate([errors, np.zeros(N_ERRORS - len(errors))])
