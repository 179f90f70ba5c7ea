"""The focal length of the scenes of a drive: selection of static points, profile likelihood.

The cost of the scenes is minimised over everything but the focal length at some focal lengths:

    l(f) = -1/2 min over poses, points, k1, k2, cx, cy of the cost at f

At a wrong focal length static points look like moving ones: points are selected with a wide limit,
then with a narrower one at the focal length found.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.stereo.self_calibration.common_errors import LensCovariance, lens_covariance
from track_range.stereo.self_calibration.corner_tracks import KeyPoints
from track_range.stereo.self_calibration.radial_lens import (
    CX,
    CY,
    K1,
    K2,
    LOG_FOCAL,
    N_PARAMETERS,
    READOUT,
    RadialLens,
)
from track_range.stereo.self_calibration.scene_bundle import (
    LensPrior,
    Observed,
    SceneBundle,
    SceneFit,
    fit_scenes,
)

MIN_OBSERVATIONS = 4  # minimum number of observations of a point
MIN_POINTS = 60  # minimum number of points of a scene
# rounds of the selection: scale of the Cauchy loss, and largest residual of a static point, sigmas
_ROUNDS = ((2.0, 6.0), (3.0, 4.5))
_LAST_SIGMAS = 4.0
# distances in log f from the best one at which the cost is computed, until it is so much higher
_DISTANCES, _ENOUGH_COST = (0.03, 0.06, 0.12, 0.24, 0.48, 0.96), 150.0
_START_NOISE_PX, _START_STEPS = (0.5, 0.25), (8, 4)  # of the two fits of a scene at its start
_MAX_NOISE_PX = 0.9  # of a usable scene at the start
# largest noise of a scene, relative to the median scene: others have a wrong motion
_MAX_NOISE_RATIO = 1.6
_MIN_STATIC_FRACTION = 0.4  # of the points of a scene
_MIN_LIMIT_NOISE_PX = 0.12  # smallest noise that limits residuals
# decreases of the cost at which rounds of the selection, and the last fits, end
_ROUND_GAIN, _LAST_GAIN = 2.0, 0.3
_PROFILE_STEPS = 5  # of the fits beside the last one, which start in the valley of the cost
# prior sigma of k1, and of the principal point as a fraction of the image width
_K1_SIGMA, _CENTRE_SIGMA = 0.008, 0.004
# mean and standard deviation of the readout: 0 to 30 ms, usual of cameras of cars and phones
_READOUT_S = 0.015, 0.01
FOCAL_RANGE = (0.3, 3.5)  # of the focal length, in image widths
# prior sigma of k1 and k2 of a distorted lens, and the decrease of the cost, relative to it, that
# shows one; without distortion it is below 0.001 (simulated drives, seeds 700 to 711), and k1 alone,
# a bad model of a wide lens, shows a trace of it
_DISTORTED_SIGMA, _DISTORTED_GAIN, _TRACE_GAIN = 0.3, 0.01, 0.002
# of the logarithm of the focal length: wide, it only keeps the equations solvable
_LOG_FOCAL_SIGMA = 10.0


def observed_points(keyframes: Sequence[KeyPoints], height_px: int) -> Observed | None:
    """The points of some keyframes that enough of them show; None with too few."""
    numbers = [key_points.number for key_points in keyframes]
    number = np.concatenate(numbers)
    frame = np.repeat(np.arange(len(numbers)), [len(one) for one in numbers])
    _, point, count = np.unique(number, return_inverse=True, return_counts=True)
    is_used = count >= MIN_OBSERVATIONS
    if is_used.sum() < MIN_POINTS:
        return None
    xy_px = np.concatenate([key_points.xy_px for key_points in keyframes])
    used = Observed(frame, point, xy_px, np.zeros_like(xy_px)).only_points(is_used)
    time_s = np.array([key_points.time_s for key_points in keyframes])[used.frame]
    after_middle = used.xy_px[:, 1:] / (height_px - 1) - 0.5
    row_flow = after_middle * _velocities(used.point, time_s, used.xy_px)
    observed = used._replace(row_flow=row_flow)
    has_all_frames = len(np.unique(observed.frame)) == len(numbers)
    return observed if has_all_frames else None


def _velocities(point: IntArray, time_s: FloatArray, xy_px: FloatArray) -> FloatArray:
    """(N, 2) velocities, px/s, by a parabola through three views of a point; each has as many."""
    order = np.lexsort((time_s, point))
    is_other = np.diff(point[order]) != 0
    is_first, is_last = np.r_[True, is_other], np.r_[is_other, True]
    middle = np.arange(len(order)) + is_first - is_last
    time_s = time_s[order]
    step_s = np.where(is_other, np.inf, np.diff(time_s))[:, None]
    slopes = np.diff(xy_px[order], axis=0) / step_s
    span_s = time_s[middle + 1] - time_s[middle - 1]
    bend = (slopes[middle] - slopes[middle - 1]) / span_s[:, None]
    after_s = 2 * time_s - time_s[middle] - time_s[middle - 1]
    velocity = np.zeros_like(xy_px)
    velocity[order] = slopes[middle - 1] + bend * after_s[:, None]
    return velocity


def started_scene(
    observed: Observed, lens: RadialLens, span_s: tuple[float, float]
) -> SceneBundle | None:
    """The scene of some observations at an assumed lens; None if no motion fits its points.

    All points stay, since at a wrong focal length many static ones do not fit.
    """
    fixed = LensPrior(lens.parameters, np.zeros(N_PARAMETERS))
    scene = SceneBundle.at_start(observed, lens, _START_NOISE_PX[0], span_s)
    try:
        for noise_px, max_steps in zip(_START_NOISE_PX, _START_STEPS, strict=True):
            noisy = replace(scene, noise_px=noise_px)
            fit = fit_scenes([noisy], lens, fixed, cauchy_sigmas=2.0, max_steps=max_steps)
            scene = fit.scenes[0]
    except np.linalg.LinAlgError:
        return None
    scene = scene.with_noise(lens)
    return scene if scene.noise_px < _MAX_NOISE_PX else None


class FocalProfile(NamedTuple):
    """The best fit, and -2 log likelihood at some logarithms of the focal length."""

    fit: SceneFit
    covariance: LensCovariance  # of the lens
    log_focal: FloatArray  # (G,) ascending
    cost: FloatArray  # (G,) above that of the best one


def focal_profile(
    scenes: Sequence[SceneBundle], lens: RadialLens, width_px: int
) -> FocalProfile | None:
    """The profile of scenes that were started with `lens`; None if their points contradict one
    another.
    """
    prior = _lens_prior(width_px)
    for number, (cauchy_sigmas, limit) in enumerate(_ROUNDS):
        fit = fit_scenes(scenes, lens, prior, cauchy_sigmas=cauchy_sigmas, min_gain=_ROUND_GAIN)
        if number == 0:
            fit, prior = _best_lens(fit, prior)
        scenes, lens = _selected(fit, limit), fit.lens
        if not scenes:
            return None
    best = fit_scenes(scenes, lens, prior, cauchy_sigmas=_LAST_SIGMAS, min_gain=_LAST_GAIN)
    covariance = lens_covariance(best.scenes, best.lens, prior, _LAST_SIGMAS)
    below, above = (_fits_beside(best, side, prior) for side in (-1, 1))
    fits = [*reversed(below), best, *above]
    log_focal = np.array([fit.lens.parameters[LOG_FOCAL] for fit in fits])
    cost = np.array([fit.cost for fit in fits])
    return FocalProfile(best, covariance, log_focal, cost - cost.min())


def _best_lens(ideal: SceneFit, prior: LensPrior) -> tuple[SceneFit, LensPrior]:
    """The fit of an almost ideal lens, or of a distorted or wide one where it is much better, and
    its prior.

    Most lenses are almost ideal or were undistorted, and then a free distortion would only move the
    focal length.
    """
    best, bent, cauchy_sigmas = (ideal, prior), ideal, _ROUNDS[0][0]
    free = prior
    for terms in ([K1], [K1, K2]):
        sigma = prior.sigma.copy()
        sigma[terms] = _DISTORTED_SIGMA
        free = prior._replace(sigma=sigma)
        bent = fit_scenes(
            bent.scenes, bent.lens, free, cauchy_sigmas=cauchy_sigmas, min_gain=_ROUND_GAIN
        )
        if bent.cost > (1.0 - _TRACE_GAIN) * ideal.cost:
            return ideal, prior
        if bent.cost < (1.0 - _DISTORTED_GAIN) * best[0].cost:
            best = bent, free
    wide = replace(ideal.lens, family="equidistant")
    angular = fit_scenes(
        ideal.scenes, wide, free, cauchy_sigmas=cauchy_sigmas, min_gain=_ROUND_GAIN
    )
    enough = 1.0 - _DISTORTED_GAIN if best[0] is ideal else 1.0
    return (angular, free) if angular.cost < enough * best[0].cost else best


def _lens_prior(width_px: int) -> LensPrior:
    mean, sigma = np.zeros(N_PARAMETERS), np.zeros(N_PARAMETERS)
    mean[LOG_FOCAL], sigma[LOG_FOCAL] = np.log(width_px), _LOG_FOCAL_SIGMA
    sigma[K1] = _K1_SIGMA
    mean[READOUT], sigma[READOUT] = _READOUT_S
    sigma[[CX, CY]] = _CENTRE_SIGMA * width_px
    low, high = np.log(np.array(FOCAL_RANGE) * width_px).tolist()
    return LensPrior(mean, sigma, (low, high))


def _fits_beside(best: SceneFit, side: int, prior: LensPrior) -> list[SceneFit]:
    """Fits at smaller (`side` -1) or larger (1) focal lengths, until the cost is much higher."""
    fits, near = list[SceneFit](), best
    for distance in _DISTANCES:
        log_focal = float(best.lens.parameters[LOG_FOCAL]) + side * distance
        low, high = prior.log_focal_range
        if not low <= log_focal <= high or near.cost > best.cost + _ENOUGH_COST:
            break
        near = _at_focal(near, log_focal, prior)
        fits.append(near)
    return fits


def _at_focal(near: SceneFit, log_focal: float, prior: LensPrior) -> SceneFit:
    """The fit at a fixed focal length, from that at another one."""
    step = np.zeros(N_PARAMETERS)
    step[LOG_FOCAL] = log_focal - near.lens.parameters[LOG_FOCAL]
    scenes = [scene.stretched(float(step[LOG_FOCAL])) for scene in near.scenes]
    is_fixed = np.arange(N_PARAMETERS) == LOG_FOCAL
    fixed = LensPrior(prior.mean, np.where(is_fixed, 0.0, prior.sigma))
    return fit_scenes(
        scenes,
        near.lens.moved(step),
        fixed,
        cauchy_sigmas=_LAST_SIGMAS,
        max_steps=_PROFILE_STEPS,
        min_gain=_LAST_GAIN,
    )


def _selected(fit: SceneFit, limit: float) -> list[SceneBundle]:
    """The scenes whose motion was found, with the points whose residuals are below the limit in
    sigmas.
    """
    scenes = [scene.with_noise(fit.lens) for scene in fit.scenes]
    usual_px = float(np.median([scene.noise_px for scene in scenes]))
    selected = []
    for scene in scenes:
        max_error_px = limit * max(scene.noise_px, _MIN_LIMIT_NOISE_PX)
        is_static = scene.largest_error_px(fit.lens) < max_error_px
        has_motion = scene.noise_px < _MAX_NOISE_RATIO * usual_px
        if has_motion and is_static.sum() >= MIN_POINTS and is_static.mean() > _MIN_STATIC_FRACTION:
            selected.append(scene.only_points(is_static).with_noise(fit.lens))
    return selected
