r"""Fit of the plane of the road to known points, lengths and parallel lines, by Bayesian least squares.

Residuals, each divided by its standard deviation:

    known point (X, Y)            pixel of the point - clicked pixel                 clicks, and metres in px
    known length L                |P(a) - P(b)| - L                                  clicks in m, and 1 % of L
    parallel lines a b, c d       sine of the angle between P(b) - P(a) and P(d) - P(c)    clicks in rad
    priors                        focal length, centre of the image, roll, and pitch or height if they are known

P(u) is the point of the road at pixel u. The covariance is (J'J)^-1 at the solution. Clicked pixels have errors of
`CLICK_PX`, which pass to metres and angles by differences, at the parameters of the previous fit. What the
measurements do not determine keeps the width of its prior, and shows in `RoadPlane.scale_sigma`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import UserError
from track_range.ranging.world.road_plane import (
    LOG_F,
    LOG_H,
    PITCH,
    THETA,
    YAW,
    PlaneResidual,
    PlaneViews,
    RoadPlane,
    X,
    Y,
)
from track_range.stereo.geometry.camera import PinholeCamera

CLICK_PX = 1.5  # standard deviation of a clicked pixel in images 1280 px wide
_CLICK_WIDTH_PX = 1280.0
_LENGTH_SIGMA, _POINT_M = 0.01, 0.03  # of a measured length, and of measured places on the road
# priors: roll of a camera on a pole, pitch, height, and the principal point of a lens
_ROLL_RAD, _PITCH_RAD = math.radians(3.0), (math.radians(30.0), math.radians(25.0))
_HEIGHT_M, _CENTRE = (6.0, 0.8), 0.015
_FREE_M, _FIXED = 1e4, 1e-6
_UNSEEN = 1e4  # difference of what a plane does not show
# starting values
_PITCHES_RAD = np.radians((4.0, 9.0, 16.0, 28.0, 45.0, 70.0))
_FOCAL_FACTORS = (0.7, 1.0, 1.4)
_N_STARTS = 2  # of the grid that are fitted, the best ones
# rounds in which standard deviations follow the fit, steps of a round, and that of derivatives
_N_ROUNDS, _MOST_STEPS, _STEP = 3, 60, 1e-6
# largest relative error of a length along or across the view, in the middle of what was given
LARGEST_SCALE_SIGMA = 0.15
_LARGEST_MISFIT = 3.5  # of a measurement, in standard deviations: then one of them is wrong


class GroundError(UserError):
    """The plane of the road cannot be determined; the message says what is known and missing."""


@dataclass(frozen=True, slots=True)
class PlaneMeasurements:
    """What was measured on the road, pixels of the undistorted images; M = 0 = none."""

    point_px: FloatArray  # (M, 2) pixels of points
    point_m: FloatArray  # (M, 2) their places in metres
    length_px: FloatArray  # (M, 2, 2) pixels of the ends of lengths
    length_m: FloatArray  # (M,)
    parallel_px: FloatArray  # (M, 4, 2) pixels of the ends of two lines, which are parallel
    names: tuple[str, ...]  # of points, lengths and lines, as given

    @property
    def all_px(self) -> FloatArray:
        """(N, 2) all pixels."""
        parts = (self.point_px, self.length_px, self.parallel_px)
        return np.concatenate([part.reshape(-1, 2) for part in parts])


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanePriors:
    """What is known of the camera besides; None = unknown."""

    camera: PinholeCamera  # its focal length is a usual one if its sigma is large
    focal_sigma: float  # relative standard deviation of the focal length
    centre_sigma: float = _CENTRE  # of the principal point, as a fraction of the width
    height_m: tuple[float, float] | None = None  # height and its standard deviation
    pitch_rad: tuple[float, float] | None = None  # pitch and its standard deviation

    def mean_and_sigma(self, *, has_place: bool) -> tuple[FloatArray, FloatArray]:
        """(9,) mean and standard deviation of theta; without points, the frame of the plane is that
        of the camera.
        """
        camera, (pitch, pitch_sigma) = self.camera, self.pitch_rad or _PITCH_RAD
        if self.height_m is None:
            height_m, log_sigma = _HEIGHT_M
        else:
            height_m, log_sigma = self.height_m[0], self.height_m[1] / self.height_m[0]
        centre_px, place = self.centre_sigma * camera.width_px, _FREE_M if has_place else _FIXED
        place_mean = (0.0, 0.0, 0.0)
        mean = [math.log(camera.fx_px), camera.cx_px, camera.cy_px, pitch, 0.0, math.log(height_m)]
        sigma = [self.focal_sigma, centre_px, centre_px, pitch_sigma, _ROLL_RAD, log_sigma]
        return np.array([*mean, *place_mean]), np.array([*sigma, place, place, place])


@dataclass(frozen=True, slots=True)
class _Problem:
    """The residuals of one fit."""

    measured: PlaneMeasurements
    click_px: float
    mean: FloatArray
    sigma: FloatArray

    def modelled(self, theta: FloatArray) -> FloatArray:
        """(2 P + L + A,) measured values minus those of theta (9,): px, m, and sines of angles."""
        return np.asarray(_differences(theta[None], self.measured)[0])

    def sigmas(self, theta: FloatArray) -> FloatArray:
        """Standard deviations of `modelled` at theta."""
        measured, variance = self.measured, 0.0
        now = self.modelled(theta)
        for name in ("point_px", "length_px", "parallel_px"):
            pixels = getattr(measured, name)
            for place in np.ndindex(pixels.shape[1:]):
                moved = pixels.copy()
                moved[(slice(None), *place)] += self.click_px
                variance += (
                    _differences(theta[None], replace(measured, **{name: moved}))[0] - now
                ) ** 2
        for axis in (0, 1):
            moved_m = measured.point_m + _POINT_M * np.eye(2)[axis]
            variance += (
                _differences(theta[None], replace(measured, point_m=moved_m))[0] - now
            ) ** 2
        n_points = measured.point_px.size
        lengths = slice(n_points, n_points + len(measured.length_m))
        own = np.zeros(len(now))
        own[lengths] = _LENGTH_SIGMA * measured.length_m
        return np.asarray(np.sqrt(variance + own**2))

    def solve(self, start: FloatArray, sigmas: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        """Theta, its covariance, and the cost."""
        scale = np.minimum(self.sigma, 1.0)
        steps = np.vstack([np.zeros(len(THETA)), _STEP * np.eye(len(THETA))])

        def residuals(step: FloatArray) -> FloatArray:
            theta = start + scale * step
            return np.concatenate([self.modelled(theta) / sigmas, (theta - self.mean) / self.sigma])

        def jacobian(step: FloatArray) -> FloatArray:
            values = _differences(start + scale * (step + steps), self.measured) / sigmas
            return np.vstack([(values[1:] - values[0]).T / _STEP, np.diag(scale / self.sigma)])

        fit = least_squares(residuals, np.zeros(len(THETA)), jacobian, max_nfev=_MOST_STEPS)
        slopes = jacobian(fit.x)
        covariance = np.linalg.pinv(slopes.T @ slopes, hermitian=True) * np.outer(scale, scale)
        return start + scale * fit.x, covariance, float(fit.cost)

    def misfit(self, theta: FloatArray) -> float:
        """How far a start is from the measurements, robustly."""
        sigmas = np.maximum(self.sigmas(theta), 1e-9)
        return float(np.log1p(np.abs(self.modelled(theta) / sigmas)).sum())

    def starts(self) -> list[FloatArray]:
        """Parameters to start from: a grid of pitches and focal lengths, with the place by the
        points.
        """
        starts = []
        free = self.sigma[LOG_F] > 0.05
        pitches = _PITCHES_RAD if self.sigma[PITCH] > 0.1 else self.mean[[PITCH]]
        for pitch in pitches:
            for factor in _FOCAL_FACTORS if free else (1.0,):
                theta = self.mean.copy()
                theta[LOG_F] += math.log(factor)
                theta[PITCH] = pitch
                starts.append(self._placed(theta))
        return sorted(starts, key=self.misfit)[:_N_STARTS]

    def _placed(self, theta: FloatArray) -> FloatArray:
        """Theta with height, yaw and place by the similarity of its plane to the measured one."""
        measured = self.measured
        view = PlaneViews.of(theta[None])
        if len(measured.point_m) < 2:
            ends_m = view.on_road_m(measured.length_px.reshape(-1, 2))[0].reshape(-1, 2, 2)
            shown_m = np.linalg.norm(ends_m[:, 1] - ends_m[:, 0], axis=1)
            ratio = np.nanmedian(measured.length_m / shown_m) if len(shown_m) else np.nan
            theta[LOG_H] += np.log(ratio) if np.isfinite(ratio) else 0.0
            return theta
        shown, true = view.on_road_m(measured.point_px)[0] @ [1, 1j], measured.point_m @ [1, 1j]
        known = np.isfinite(shown)
        if known.sum() < 2:
            return theta
        from_m, to_m = shown[known].mean(), true[known].mean()
        turn = np.vdot(shown[known] - from_m, true[known] - to_m)
        turn /= np.vdot(shown[known] - from_m, shown[known] - from_m)
        theta[LOG_H] += np.log(np.abs(turn))
        theta[YAW] = np.angle(turn)
        place = to_m - turn * from_m
        theta[X], theta[Y] = place.real, place.imag
        return theta


def _differences(theta: FloatArray, measured: PlaneMeasurements) -> FloatArray:
    """(K, 2 P + L + A) see `_Problem.modelled`, for parameters (K, 9)."""
    view, n = PlaneViews.of(theta), len(theta)
    zero = np.zeros((len(measured.point_m), 1))
    shown_px = view.pixels(np.concatenate([measured.point_m, zero], axis=1))
    ends_m = view.on_road_m(measured.length_px.reshape(-1, 2)).reshape(n, -1, 2, 2)
    lengths_m = np.linalg.norm(ends_m[:, :, 1] - ends_m[:, :, 0], axis=2)
    lines_m = view.on_road_m(measured.parallel_px.reshape(-1, 2)).reshape(n, -1, 2, 2, 2)
    along = lines_m[:, :, :, 1] - lines_m[:, :, :, 0]
    along = along / np.linalg.norm(along, axis=3, keepdims=True)
    sines = along[:, :, 0, 0] * along[:, :, 1, 1] - along[:, :, 0, 1] * along[:, :, 1, 0]
    points = (measured.point_px - shown_px).reshape(n, -1)
    values = np.concatenate([points, measured.length_m - lengths_m, sines], axis=1)
    return np.asarray(np.nan_to_num(values, nan=_UNSEEN))


class _Fit(NamedTuple):
    """The best solution of a problem."""

    cost: float
    theta: FloatArray
    covariance: FloatArray
    sigmas: FloatArray  # of the measurements
    problem: _Problem


def fit_plane(measured: PlaneMeasurements, priors: PlanePriors) -> RoadPlane:
    """The plane of what was measured on the road; GroundError if it contradicts itself, or leaves
    lengths in its middle unknown by more than 15 %.
    """
    has_place = len(measured.point_m) > 1
    click_px = CLICK_PX * max(priors.camera.width_px / _CLICK_WIDTH_PX, 0.5)
    mean, sigma = priors.mean_and_sigma(has_place=has_place)
    fits = []
    for y_sign in (1.0, -1.0) if has_place else (1.0,):
        turned = replace(measured, point_m=measured.point_m * [1.0, y_sign])
        problem = _Problem(turned, click_px, mean, sigma)
        fits += [fit for start in problem.starts() if (fit := _solved(problem, start)) is not None]
    if not fits:
        raise GroundError(
            "expected points of the road below the horizon, found none that any camera could see; "
            "correct the pixels."
        )
    best = min(fits, key=lambda fit: fit.cost)
    residuals = _residuals(measured, best.problem.modelled(best.theta), best.sigmas)
    is_mirrored = not np.array_equal(best.problem.measured.point_m, measured.point_m)
    n = len(measured.point_m), len(measured.length_m), len(measured.parallel_px)
    kinds = zip(n, ("points", "lengths", "pairs of parallel lines"), strict=True)
    source = " and ".join(f"{count} {kind}" for count, kind in kinds if count)
    size_px = priors.camera.size_px
    plane = RoadPlane(best.theta, best.covariance, size_px, source, is_mirrored, residuals)
    _check(plane, measured)
    return plane


def _solved(problem: _Problem, start: FloatArray) -> _Fit | None:
    """The solution from a start, with standard deviations that follow it; None = there is none."""
    theta, fit = start, None
    for _ in range(_N_ROUNDS):
        sigmas = problem.sigmas(theta)
        if not (np.isfinite(sigmas) & (sigmas > 0)).all():
            return fit
        theta, covariance, cost = problem.solve(theta, sigmas)
        fit = _Fit(cost, theta, covariance, sigmas, problem)
    return fit


def _check(plane: RoadPlane, measured: PlaneMeasurements) -> None:
    """GroundError if the measurements contradict one another, or do not determine the plane."""
    worst = max(plane.residuals, key=lambda one: abs(one.value / one.sigma))
    if abs(worst.value) > _LARGEST_MISFIT * worst.sigma:
        raise GroundError(
            f"expected measurements that fit one plane, found {worst.name}: {worst.value:+.2f} "
            f"{worst.unit} from the fit (1 sigma {worst.sigma:.2f}); correct its pixels or metres, "
            "omit what is not on the road, or straighten a wide lens with --rig."
        )
    along, across = plane.scale_sigma(measured.all_px)
    if not max(along, across) < LARGEST_SCALE_SIGMA:
        raise GroundError(
            "expected measurements that determine the plane, but in their middle lengths along the "
            f"view are known to {100 * along:.0f} % and across it to {100 * across:.0f} %; add a "
            "length along the road (--known-length), four points of a rectangle (--known-point), "
            "two parallel lines (--known-parallel), or what is known of the camera (--focal-px, "
            "--camera-height-m, --pitch-deg)."
        )


def _residuals(
    measured: PlaneMeasurements, values: FloatArray, sigmas: FloatArray
) -> tuple[PlaneResidual, ...]:
    """The residuals of the measurements; of points, their distance in px."""
    n_points = len(measured.point_m)
    points = values[: 2 * n_points].reshape(-1, 2)
    rows = list(
        zip(
            np.linalg.norm(points, axis=1),
            sigmas[: 2 * n_points : 2],
            ["px"] * n_points,
            strict=True,
        )
    )
    units = ["m"] * len(measured.length_m) + ["deg"] * len(measured.parallel_px)
    factors = [1.0 if unit == "m" else math.degrees(1.0) for unit in units]
    others: Sequence[float] = values[2 * n_points :].tolist()
    rows += [
        (factor * value, factor * sigma, unit)
        for value, sigma, unit, factor in zip(
            others, sigmas[2 * n_points :], units, factors, strict=True
        )
    ]
    return tuple(
        PlaneResidual(name, float(value), float(sigma), unit)
        for name, (value, sigma, unit) in zip(measured.names, rows, strict=True)
    )
