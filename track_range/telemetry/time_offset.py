"""estimated_offset: time by which telemetry lags behind a video, from the motion in its images.

    yaw(t)       = course'(t + o) + n      the yaw rate of the images is that of the course, in the same unit
    expansion(t) = k v(t + o) + n          the expansion is the speed over a typical depth, 1/k, which is unknown

o is searched on a grid. With normal noise n of unknown variance, the log likelihood of o is -N/2 log RSS(o), with the
sum of squared residuals RSS and N independent samples: one per second, since the speeds of GPS are filtered over about
this time. The mean and the standard deviation of o follow from the product of both likelihoods.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray

MAX_OFFSET_S = 3.0
"""Largest offset in s that is searched: receivers lag by up to 1 s, and clocks in whole seconds by another one."""

_STEP_S = 0.05
_CORRELATION_S = 1.0
"""Time between independent samples, s; see above."""

_MIN_SAMPLES = 20
"""Smallest number of images for an estimate."""

_MIN_CORRELATION = 0.7
"""Smallest correlation between image motion and telemetry at the best offset."""

_MAX_SIGMA_S = 0.3
"""Largest standard deviation of an offset that is applied, s: below the lag that it corrects."""

_MIN_SPEED_MPS = 2.0
"""Smallest speed at which a course is known, m/s."""

_MAX_GAP_S = 3.0
"""Longest interval between samples that is interpolated, as in `ranging.ego_speed`."""


@dataclass(frozen=True, slots=True)
class TimeOffset:
    """Time offset between telemetry and video.

    Attributes:
        offset_s: time by which the telemetry is late: a motion at t in the video is at t + offset_s in the telemetry.
        sigma_s: its standard deviation.
        correlation: largest correlation of yaw or expansion at this offset.
        is_certain: whether it may be applied: correlated, precise, and not at the edge of the search.
    """

    offset_s: float
    sigma_s: float
    correlation: float
    is_certain: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionSeries:
    """Motion of the images over time, (N,) each; NaN = unknown.

    Attributes:
        time_s: increasing times.
        yaw_rad_s: yaw rate, positive = to the right.
        expansion_hz: forward speed over a typical depth.
        is_still: whether the camera is at rest.
    """

    time_s: FloatArray
    yaw_rad_s: FloatArray
    expansion_hz: FloatArray
    is_still: np.ndarray


def estimated_offset(
    motion: MotionSeries, time_s: FloatArray, speed_mps: FloatArray, course_rad: FloatArray
) -> TimeOffset | None:
    """Offset of telemetry; None = too few samples, or nothing changes in them.

    Args:
        motion: motion of the images.
        time_s: (M,) increasing times of the telemetry in the video.
        speed_mps: (M,) NaN = unknown.
        course_rad: (M,) clockwise from north, NaN = unknown.
    """
    grid_s = np.arange(-MAX_OFFSET_S, MAX_OFFSET_S + _STEP_S / 2, _STEP_S)
    yaw_s, yaw_rad_s = _course_rate(time_s, speed_mps, course_rad)
    known = np.isfinite(speed_mps)
    pairs = (
        _fit(motion.time_s, motion.expansion_hz, time_s[known], speed_mps[known], grid_s, has_scale=True),
        _fit(motion.time_s, motion.yaw_rad_s, yaw_s, yaw_rad_s, grid_s, has_scale=False),
    )
    fits = [fit for fit in pairs if fit is not None]
    if not fits:
        return None
    log_likelihood = np.sum([fit[0] for fit in fits], axis=0)
    weight = np.exp(log_likelihood - log_likelihood.max())
    weight /= weight.sum()
    offset_s = float(weight @ grid_s)
    sigma_s = float(np.sqrt(weight @ (grid_s - offset_s) ** 2 + _STEP_S**2 / 12))
    best = int(np.argmax(log_likelihood))
    correlation = max(float(fit[1][best]) for fit in fits)
    is_inside = abs(offset_s) + 2 * sigma_s < MAX_OFFSET_S
    is_certain = correlation >= _MIN_CORRELATION and sigma_s <= _MAX_SIGMA_S and is_inside
    return TimeOffset(offset_s, sigma_s, correlation, is_certain)


def _course_rate(time_s: FloatArray, speed_mps: FloatArray, course_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Times and rates of the course between successive samples that move."""
    known = np.isfinite(course_rad) & (np.nan_to_num(speed_mps) >= _MIN_SPEED_MPS)
    t, course = time_s[known], course_rad[known]
    if len(t) < 2:
        return np.empty(0), np.empty(0)
    change = np.remainder(np.diff(course) + np.pi, 2 * np.pi) - np.pi
    return (t[1:] + t[:-1]) / 2, change / np.diff(t)


def _fit(
    t: FloatArray, image: FloatArray, at_s: FloatArray, value: FloatArray, grid_s: FloatArray, *, has_scale: bool
) -> tuple[FloatArray, FloatArray] | None:
    """Log likelihood and correlation of each offset; None = too few samples, or none changes.

    Args:
        t: (N,) times of the images.
        image: (N,) motion, NaN = unknown.
        at_s: (M,) times of the telemetry.
        value: (M,) its motion.
        grid_s: (G,) offsets.
        has_scale: whether the image motion is proportional to the telemetry instead of equal.
    """
    if len(at_s) < 3:
        return None
    # the same images for all offsets
    is_used = np.isfinite(image) & (t - MAX_OFFSET_S >= at_s[0]) & (t + MAX_OFFSET_S <= at_s[-1])
    is_used &= np.array([_is_dense(at_s, time) for time in t.tolist()])
    if is_used.sum() < _MIN_SAMPLES:
        inner = np.isfinite(image) & (t >= at_s[0]) & (t <= at_s[-1])
        if inner.sum() < _MIN_SAMPLES:
            return None
        is_used = inner
    t, e = t[is_used], _clipped(image[is_used])
    n = max((t[-1] - t[0]) / _CORRELATION_S, 1.0)
    rss, correlation = np.empty(len(grid_s)), np.empty(len(grid_s))
    for i, offset_s in enumerate(grid_s.tolist()):
        v = np.interp(t + offset_s, at_s, value)
        k = float(v @ e / (v @ v)) if has_scale and v @ v > 0 else 1.0
        rss[i] = float(((e - max(k, 0.0) * v) ** 2).mean())
        spread = float(e.std() * v.std())
        correlation[i] = float(((e - e.mean()) * (v - v.mean())).mean()) / spread if spread > 0 else 0.0
    floor = max(1e-4 * float((e**2).mean()), 1e-12)
    return -n / 2 * np.log(rss + floor), correlation


def _is_dense(at_s: FloatArray, time_s: float) -> bool:
    """Whether the telemetry has no long gap around a time."""
    after = int(np.clip(np.searchsorted(at_s, time_s), 1, len(at_s) - 1))
    return bool(at_s[after] - at_s[after - 1] <= _MAX_GAP_S)


def _clipped(values: FloatArray) -> FloatArray:
    """Values within five robust standard deviations of their running level, against single failures."""
    centre = float(np.median(values))
    spread = 1.4826 * float(np.median(np.abs(values - centre)))
    return np.asarray(np.clip(values, centre - 5 * spread, centre + 5 * spread)) if spread > 0 else values
