"""estimated_offset: time by which telemetry lags behind a video, from the motion in its images.

    expansion(t) = k v(t + o) (1 + z(t)) + n     the expansion is the speed over a typical depth, 1/k (1 + z) per metre
    yaw(t)       = q course'(t + o) + n          the yaw rate is the rate of the course; q absorbs the focal length

The typical depth changes along the road: z is a Gauss-Markov process with the standard deviation
sigma_z and the time constant tau, so that slow changes of the expansion have little weight, and
fast changes have much. o is searched on a grid, with the best k and q for each o. Both likelihoods
are multiplied; the mean and standard deviation of the product are the result. The noise n of the
yaw rate is estimated from its residual, with the time over which it is correlated.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.foundation.robust_statistics import MAD_TO_SIGMA, mad_sigma
from track_range.stereo.speed.ego_speed import MAX_GAP_S

# largest one that is searched: receivers lag by up to 1 s, clocks in whole seconds by another one
MAX_OFFSET_S = 3.0
_STEP_S = 0.05
_DEPTH_SIGMA, _DEPTH_TIME_S = 0.3, 2.0
"""sigma_z and tau in s. The spread of v over expansion in simulated drives (city, seed 1, and
queue, seed 2, of 24 s) is 0.2 with this time constant; 0.3 gives standard deviations that cover the
errors there."""

_MIN_LEVEL_HZ = 0.02  # smallest level of the expansion to which sigma_z applies, 1/s
# shortest time between independent samples of the yaw rate: that between fixes
_CORRELATION_S = 1.0
# smallest numbers of images and of samples of the telemetry for an estimate
_MIN_SAMPLES, _MIN_FIXES = 20, 3
# error of an offset, relative to the interval of samples (queue, seed 2, at 1 Hz)
_INTERPOLATION_FRACTION = 0.1
_MIN_CORRELATION = 0.9  # smallest correlation between image motion and telemetry at the best offset
# largest standard deviation of an offset that is applied, s: below the lag that it corrects
_MAX_SIGMA_S = 0.2
_MIN_SPEED_MPS = 2.0  # smallest speed at which a course is known, m/s


@dataclass(frozen=True, slots=True)
class TimeOffset:
    """Time offset between telemetry and video."""

    # time by which the telemetry is late: a motion at t in the video is at t + offset_s in the
    # telemetry
    offset_s: float
    sigma_s: float  # its standard deviation
    correlation: float  # largest correlation of yaw or expansion at this offset
    # whether it may be applied: correlated, precise, and not at the edge of the search
    is_certain: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionSeries:
    """Motion of the images over time, (N,) each; NaN = unknown."""

    time_s: FloatArray  # increasing times
    yaw_rad_s: FloatArray  # yaw rate, positive = to the right
    expansion_hz: FloatArray  # forward speed over a typical depth
    is_still: BoolArray  # whether the camera is at rest


def estimated_offset(
    motion: MotionSeries, time_s: FloatArray, speed_mps: FloatArray, course_rad: FloatArray
) -> TimeOffset | None:
    """Offset of telemetry against the motion of the images; None = too few samples, or samples
    without any change.

    The (M,) times in the video increase; speeds and courses, clockwise from north, are NaN where
    unknown.
    """
    grid_s = np.arange(-MAX_OFFSET_S, MAX_OFFSET_S + _STEP_S / 2, _STEP_S)
    yaw_s, yaw_rad_s = _course_rate(time_s, speed_mps, course_rad)
    known = np.isfinite(speed_mps)
    pairs = (
        _fit(
            motion.time_s,
            motion.expansion_hz,
            time_s[known],
            speed_mps[known],
            grid_s,
            _depth_likelihood,
        ),
        _fit(motion.time_s, motion.yaw_rad_s, yaw_s, yaw_rad_s, grid_s, _residual_likelihood),
    )
    fits = [fit for fit in pairs if fit is not None]
    if not fits:
        return None
    log_likelihood = np.sum([fit[0] for fit in fits], axis=0)
    weight = np.exp(log_likelihood - log_likelihood.max())
    weight /= weight.sum()
    offset_s = float(weight @ grid_s)
    step_s = float(np.median(np.diff(time_s[known]))) if known.sum() > 1 else 0.0
    variance_s2 = (
        float(weight @ (grid_s - offset_s) ** 2)
        + _STEP_S**2 / 12
        + (_INTERPOLATION_FRACTION * step_s) ** 2
    )
    sigma_s = math.sqrt(variance_s2)
    best = int(np.argmax(log_likelihood))
    correlation = max(float(fit[1][best]) for fit in fits)
    is_inside = abs(offset_s) + 2 * sigma_s < MAX_OFFSET_S
    is_certain = correlation >= _MIN_CORRELATION and sigma_s <= _MAX_SIGMA_S and is_inside
    return TimeOffset(offset_s, sigma_s, correlation, is_certain)


def _course_rate(
    time_s: FloatArray, speed_mps: FloatArray, course_rad: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Times and rates of the course between successive samples that move."""
    known = np.isfinite(course_rad) & (np.nan_to_num(speed_mps) >= _MIN_SPEED_MPS)
    t, course = time_s[known], course_rad[known]
    if len(t) < 2:
        return np.empty(0), np.empty(0)
    change = np.remainder(np.diff(course) + np.pi, 2 * np.pi) - np.pi
    return (t[1:] + t[:-1]) / 2, change / np.diff(t)


# times, motion (N,), telemetry (G, N) -> (G,)
_Likelihood = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]


def _fit(
    t: FloatArray,
    image: FloatArray,
    at_s: FloatArray,
    value: FloatArray,
    grid_s: FloatArray,
    likelihood: _Likelihood,
) -> tuple[FloatArray, FloatArray] | None:
    """(G,) log likelihood and correlation by offset of (N,) motion at `t`, (M,) telemetry at
    `at_s`; None = too few.
    """
    if len(at_s) < _MIN_FIXES:
        return None
    is_used = np.isfinite(image) & (t >= at_s[0]) & (t <= at_s[-1])
    after = np.clip(np.searchsorted(at_s, t), 1, len(at_s) - 1)
    is_used &= at_s[after] - at_s[after - 1] <= MAX_GAP_S
    if is_used.sum() < _MIN_SAMPLES:
        return None
    t, e = t[is_used], image[is_used]
    centre, spread = float(np.median(e)), 5 * mad_sigma(e)
    e = np.clip(e, centre - spread, centre + spread) if spread > 0 else e  # against single failures
    values = np.array([np.interp(t + offset_s, at_s, value) for offset_s in grid_s.tolist()])
    centred, e_centred = values - values.mean(axis=1, keepdims=True), e - e.mean()
    spread = np.sqrt((centred**2).mean(axis=1) * (e_centred**2).mean())
    correlation = np.divide(
        (centred @ e_centred) / len(e), spread, out=np.zeros(len(grid_s)), where=spread > 1e-9
    )
    return likelihood(t, e, values), correlation


def _depth_likelihood(t: FloatArray, e: FloatArray, values: FloatArray) -> FloatArray:
    """Log likelihood of expansions with a changing typical depth; the covariance does not depend on
    the offset.
    """
    width = max(round(_CORRELATION_S / float(np.median(np.diff(t)))), 1)
    level = np.maximum(
        np.convolve(np.pad(np.abs(e), width, mode="edge"), np.ones(2 * width + 1), "valid"), 0.0
    )
    level = np.maximum(level / (2 * width + 1), _MIN_LEVEL_HZ)
    # of white noise
    noise = MAD_TO_SIGMA * float(np.median(np.abs(np.diff(e, n=2)))) / math.sqrt(6)
    decay = np.exp(-np.abs(t[:, None] - t[None, :]) / _DEPTH_TIME_S)
    covariance = (_DEPTH_SIGMA**2 * level[:, None] * level[None, :]) * decay
    covariance[np.diag_indices(len(t))] += max(noise, 0.02 * float(level.mean())) ** 2
    inverse = np.linalg.inv(covariance)
    weighted = values @ inverse
    square = (weighted * values).sum(axis=1)
    k = np.maximum((weighted @ e) / np.maximum(square, 1e-12), 0.0)
    residuals = e - k[:, None] * values
    return -0.5 * np.asarray(((residuals @ inverse) * residuals).sum(axis=1))


def _residual_likelihood(t: FloatArray, e: FloatArray, values: FloatArray) -> FloatArray:
    """Log likelihood with normal noise of unknown variance, -N/2 log RSS, for N independent
    samples.
    """
    square = (values**2).sum(axis=1)
    q = np.maximum((values @ e) / np.maximum(square, 1e-12), 0.0)
    residuals = e - q[:, None] * values
    rss = (residuals**2).mean(axis=1)
    independent_s = _correlation_time_s(t, residuals[int(np.argmin(rss))])
    n = max(float(t[-1] - t[0]) / independent_s, 1.0)
    floor = max(1e-4 * float((e**2).mean()), 1e-12)
    return -n / 2 * np.asarray(np.log(rss + floor))


def _correlation_time_s(t: FloatArray, residual: FloatArray) -> float:
    """Time between independent samples of a residual, 2 dt (1/2 + sum of its autocorrelation), at
    least 1 s.
    """
    centred = residual - residual.mean()
    variance, step_s = float((centred**2).mean()), float(np.median(np.diff(t)))
    if variance <= 0:
        return _CORRELATION_S
    total = 0.5
    for lag in range(1, len(t) // 2):
        rho = float((centred[lag:] * centred[:-lag]).mean()) / variance
        if rho <= 0:
            break
        total += rho
    return max(2 * step_s * total, _CORRELATION_S)
