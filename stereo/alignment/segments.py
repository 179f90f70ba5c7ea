"""Disparity errors from segments of a drive, and their uncertainty by a jackknife over image strips
and time.

The noise of single points is the smallest part of the uncertainty: errors from a facade,
vegetation, the slope of the road or a wrong distortion model are common to many points. So the
normal equations are stored per strip of the image and part of the time, and sigma comes from the
delete-a-group jackknife (`foundation.robust_statistics`) over strips and over parts, which is
larger than the number of points suggests.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.robust_statistics import jackknife_covariance
from track_range.stereo.alignment.bundle_adjustment import (
    N_ERRORS,
    Bundle,
    BundleFit,
    Observations,
    equations_by_group,
    fit_bundle,
    linearize,
)
from track_range.stereo.alignment.initial_poses import (
    MIN_POINTS,
    InitialBundle,
    initial_bundle,
    only_points,
)
from track_range.stereo.geometry.bundle_equations import Equations
from track_range.stereo.geometry.rig import StereoRig

N_STRIPS = 8  # number of vertical strips of the image
# number of parts of a segment by time; with fewer, leaving one out would leave frames without
# points
_N_PARTS = 12
# shortest path of a segment; on shorter ones the noise of poses is not small compared to parallax
_MIN_PATH_M = 2.0
# minimum mean Cauchy weight of a static point (static: about 0.6, moving: 0.02)
_STATIC_WEIGHT = 0.25
_MIN_STATIC_FRACTION = 0.5  # minimum fraction of static points
# largest plausible offset, curvature or slope; beyond it, motion and disparities are inconsistent
MAX_ERROR_PX = 15.0
# Offset, curvature and slope from which a fit starts if it fails from 0: those of a wrong vergence
# of 0.25 and 0.5 degrees at a focal length of 720 px.
_OTHER_ERRORS_PX = ((-6.0, -4.0, 0.0), (-3.0, -2.0, 0.0), (3.0, 2.0, 0.0), (6.0, 4.0, 0.0))
# largest change of the errors by a fit, above which a second one starts from the fitted errors
_MAX_CHANGE_PX = 1.0
_PRIOR_PX = 5.0  # prior standard deviation of offset, curvature and slope
_STRIP_PRIOR_PX = 1.0  # prior standard deviation of the additional offset of a strip
# largest standard deviation of a strip's offset that counts in the spread
_MAX_STRIP_SIGMA_PX = 0.3
_MIN_STRIPS = 3  # minimum number of strips for a spread


class Information(NamedTuple):
    """Information on the errors e: offset, curvature, slope, and an additional offset of each
    strip.
    """

    matrix: FloatArray  # (E, E) I
    product: FloatArray  # (E,) I e


# errors beyond `MAX_ERROR_PX`
INCONSISTENT = "motion and disparities of the points are inconsistent"


@dataclass(frozen=True, slots=True)
class Segment:
    """Information on the disparity error from a few seconds of a drive.

    Points are assigned to strips of the image and parts of the time by their mean position.
    """

    n_frames: int  # number of frames used
    whole: Information  # information from all points
    without_strip: tuple[Information, ...]  # information without each strip
    without_part: tuple[Information, ...]  # information without each part of the time


class CombinedEstimate(NamedTuple):
    """The disparity error estimated from several segments."""

    error_px: FloatArray  # (3,) offset, curvature and slope; 0 if not estimated
    covariance_px2: FloatArray  # (3, 3) their covariance
    # root mean square of the additional offsets of the strips; NaN if too few are determined
    spread_px: float

    @property
    def sigma_px(self) -> FloatArray:
        """(3,) standard deviations of the errors."""
        return np.asarray(np.sqrt(np.diag(self.covariance_px2)))


def segment_of(observed: Observations, rig: StereoRig) -> Segment | str:
    """The segment of some observations, or the reason why they are unusable; `rig` is rectified."""
    initial = initial_bundle(observed, rig)
    segment = _fitted(observed, initial, rig)
    if isinstance(segment, Segment):
        return segment
    others = [
        initial_bundle(observed, rig, error_px=np.array(error_px)) for error_px in _OTHER_ERRORS_PX
    ]
    best = max(
        (other for other in others if other is not None),
        key=lambda other: other.support,
        default=None,
    )
    if best is None or (initial is not None and best.support <= initial.support):
        return segment
    again = _fitted(observed, best, rig)
    return again if isinstance(again, Segment) else segment


def _fitted(observed: Observations, initial: InitialBundle | None, rig: StereoRig) -> Segment | str:
    """The segment from an initial bundle, or the reason why it is unusable.

    With a wrong initial error, few points follow the initial motion: if the fitted error is larger,
    a second bundle starts from the fitted error.
    """
    if initial is None:
        return "too few points were tracked"
    used, fit, static_fraction = _static_points(initial.observed, initial.bundle, rig)
    change_px = np.abs(fit.bundle.error_px - initial.bundle.error_px).max()
    if _MAX_CHANGE_PX < change_px <= MAX_ERROR_PX:
        second = initial_bundle(observed, rig, error_px=fit.bundle.error_px)
        if second is not None and second.support > initial.support:
            used, fit, static_fraction = _static_points(second.observed, second.bundle, rig)
    if (
        not np.isfinite(fit.bundle.error_px).all()
        or np.abs(fit.bundle.error_px).max() > MAX_ERROR_PX
    ):
        return INCONSISTENT
    if fit.bundle.path_m < _MIN_PATH_M:
        return "the vehicle hardly moves, or only turns"
    if static_fraction < _MIN_STATIC_FRACTION:
        return "too many moving objects in the scene"
    return _segment(used, fit, rig)


def _static_points(
    observed: Observations, start: Bundle, rig: StereoRig
) -> tuple[Observations, BundleFit, float]:
    """Observations and fit of static points, and their fraction; moving points bias the fit even
    with small weights.
    """
    fit = fit_bundle(observed, start, rig)
    n_points = len(start.points)
    weight = np.bincount(observed.point, fit.weight, n_points) / np.bincount(
        observed.point, minlength=n_points
    )
    is_static = weight > _STATIC_WEIGHT
    if is_static.all() or is_static.sum() < MIN_POINTS:
        return observed, fit, float(is_static.mean())
    static = only_points(observed, is_static)
    start = replace(fit.bundle, points=fit.bundle.points[is_static])
    return static, fit_bundle(static, start, rig), float(is_static.mean())


def combine(
    segments: Sequence[Segment],
    estimated: Collection[int] = range(N_ERRORS),
    known_px: FloatArray | None = None,
) -> CombinedEstimate:
    """The least-squares disparity error of one or more segments of one or several drives.

    covariance = jackknife over the strips (of all segments) + jackknife over the parts of the time

    `estimated` are the numbers of the errors that are estimated; others have the values `known_px`
    (3,), None = 0.
    """
    chosen, known_px = (
        np.array(sorted(estimated)),
        np.zeros(N_ERRORS) if known_px is None else known_px,
    )
    whole = [segment.whole for segment in segments]
    without_strip = [
        _solve([segment.without_strip[strip] for segment in segments], chosen, known_px)
        for strip in range(N_STRIPS)
    ]
    without_part = [
        _solve([*whole[:number], information, *whole[number + 1 :]], chosen, known_px)
        for number, segment in enumerate(segments)
        for information in segment.without_part
    ]
    covariance_px2 = jackknife_covariance(np.array(without_strip)) + jackknife_covariance(
        np.array(without_part)
    )
    return CombinedEstimate(_solve(whole, chosen, known_px), covariance_px2, _spread_px(whole))


def _segment(observed: Observations, fit: BundleFit, rig: StereoRig) -> Segment:
    """The information from a fit; parts of the time have equal numbers of points."""
    n_points, n_frames = int(observed.point.max()) + 1, int(observed.frame.max()) + 1
    n_observations = np.bincount(observed.point, minlength=n_points)
    mean_x_px = np.bincount(observed.point, observed.xyx_px[:, 0], n_points) / n_observations
    mean_frame = np.bincount(observed.point, observed.frame, n_points) / n_observations
    edges = np.quantile(mean_frame, np.arange(1, _N_PARTS) / _N_PARTS)
    cell = _strip(mean_x_px, rig) * _N_PARTS + np.searchsorted(edges, mean_frame)

    strip_columns = np.eye(N_STRIPS)[_strip(observed.xyx_px[:, 0], rig)]
    linear = linearize(observed, fit.bundle, rig, extra=strip_columns)
    equations = equations_by_group(
        observed, linear, fit.weight / fit.noise_px**2, n_frames=n_frames, group=cell
    )
    size, n_poses = len(next(iter(equations.values())).b), 6 * (n_frames - 1)
    s, b = np.zeros((N_STRIPS, _N_PARTS, size, size)), np.zeros((N_STRIPS, _N_PARTS, size))
    for number, of_cell in equations.items():
        strip, part = divmod(number, _N_PARTS)
        s[strip, part], b[strip, part] = of_cell.s, of_cell.b

    def information(s: FloatArray, b: FloatArray) -> Information:
        matrix, step, *_ = Equations(s, b, n_poses).of_shared()
        return Information(matrix, step + matrix[:, :N_ERRORS] @ fit.bundle.error_px)

    whole_s, whole_b = s.sum(axis=(0, 1)), b.sum(axis=(0, 1))
    strips = zip(s.sum(axis=1), b.sum(axis=1), strict=True)
    parts = zip(s.sum(axis=0), b.sum(axis=0), strict=True)
    return Segment(
        n_frames,
        information(whole_s, whole_b),
        tuple(information(whole_s - strip_s, whole_b - strip_b) for strip_s, strip_b in strips),
        tuple(information(whole_s - part_s, whole_b - part_b) for part_s, part_b in parts),
    )


def _strip(x_px: FloatArray, rig: StereoRig) -> IntArray:
    return np.clip((x_px * N_STRIPS / rig.left.width_px).astype(np.int64), 0, N_STRIPS - 1)


def _summed(parts: Sequence[Information]) -> tuple[FloatArray, FloatArray]:
    return tuple(np.sum(part, axis=0) for part in zip(*parts, strict=True))


def _solve(parts: Sequence[Information], estimated: IntArray, known_px: FloatArray) -> FloatArray:
    """(3,) errors from I and I e of the segments; errors that are not estimated are taken as
    known.
    """
    information, rhs = _summed(parts)
    errors_px = known_px.copy()
    errors_px[estimated] = 0.0
    rhs = rhs[estimated] - information[estimated, :N_ERRORS] @ errors_px
    prior = np.eye(len(estimated)) / _PRIOR_PX**2
    errors_px[estimated] = np.linalg.solve(information[np.ix_(estimated, estimated)] + prior, rhs)
    return errors_px


def _spread_px(parts: Sequence[Information]) -> float:
    information, rhs = _summed(parts)
    prior = np.diag([_PRIOR_PX**-2] * N_ERRORS + [_STRIP_PRIOR_PX**-2] * N_STRIPS)
    strip_offset_px = np.linalg.solve(information + prior, rhs)[N_ERRORS:]
    is_determined = np.diag(information)[N_ERRORS:] > _MAX_STRIP_SIGMA_PX**-2
    has_spread = is_determined.sum() >= _MIN_STRIPS
    return (
        float(np.sqrt((strip_offset_px[is_determined] ** 2).mean())) if has_spread else float("nan")
    )
