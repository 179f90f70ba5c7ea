r"""CollisionCourse: where a track will be, sideways, when its distance has run out: on us, or passing beside.

       x' per second
    o ---.            o's place sideways, x, and its rate x' are a Kalman filter's, fed with the bearing of the box's
    |     \           centre times the filtered distance; at the time T of the collision it will have missed the camera
    |      \          by      m = x + x' T
    +--[]---'         with a variance of the filter's own, and (a T^2 / 2)^2 for what may happen until then: either may
     camera  m        steer, and the road may bend. A bearing that does not change is m = 0.

A track is on course unless |m| is larger than half the box's width, half our own, and one standard deviation. A box
that the image's edge cuts tells nothing: its visible middle stays where it is, as if on course, while it passes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.ranging.remembered import TrackMemory
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.tracking.tracks import Tracks

_HALF_CAR_M = 0.9
"""Of our own car."""

_STEERING_MPS2 = 0.25
"""Sideways acceleration that may come, one sigma; a lane change reaches twice that. Chosen on simulated drives."""

_RATE_SIGMA_MPS = 5.0
"""How fast a new track may move sideways: what runs across comes at a run, or at the speed of a car in town."""

_WANDER_MPS = 0.7
"""How far the rate wanders, m/s per root second."""

_EDGE_SIGMA_PX, _EDGE_SIGMA_SHARE = 1.0, 0.02
"""Noise of a box's middle: so many pixels, and so much of its width."""

_JUMP = 5.0
"""So many sigma from where it was expected it is another object, or was one: the track's filter starts anew."""

_CUT_PX = 2.0
_MAX_GAP_S = 1.0

_MEASURED_S, _TIME_S, _X, _RATE, _VAR_X, _COV, _VAR_RATE = range(7)


@dataclass(frozen=True, slots=True)
class Misses:
    """Where tracks will pass, (N,) each; NaN = cannot be told.

    Attributes:
        miss_m: how far to the right of the camera the object's middle will be, at the time of the collision.
        sigma_m: its standard deviation.
        half_width_m: half the width of the object, as it is seen now.
        may_hit: False where the object will pass beside; True also where that cannot be told.
    """

    miss_m: FloatArray
    sigma_m: FloatArray
    half_width_m: FloatArray
    may_hit: BoolArray


class CollisionCourse:
    """Watches all tracks of a video, as one camera sees them."""

    def __init__(self, camera: PinholeCamera) -> None:
        """Know no track."""
        self._camera = camera
        self._memory = TrackMemory(np.full(7, np.nan))

    def update(self, tracks: Tracks, distance_m: FloatArray, ttc_s: FloatArray, time_s: float) -> Misses:
        """Take in a frame, and give every track's miss.

        Args:
            tracks: boxes; those that are predicted, or cut by the image's left or right edge, tell nothing new.
            distance_m: (N,) filtered distance, NaN = unknown.
            ttc_s: (N,) time to collision, NaN = it does not close: no miss is told.
            time_s: of the frame, never earlier than the one before.
        """
        left, right = tracks.xyxy_px[:, 0], tracks.xyxy_px[:, 2]
        m_per_px = np.where(np.isfinite(distance_m), distance_m, np.nan) / self._camera.fx_px
        x_m = ((left + right) / 2 - self._camera.cx_px) * m_per_px
        width_px = right - left
        noise = ((_EDGE_SIGMA_PX + _EDGE_SIGMA_SHARE * width_px) * m_per_px) ** 2
        is_whole = (left > _CUT_PX) & (right < self._camera.width_px - 1 - _CUT_PX)
        state = _predicted(self._memory.recall(tracks.track_id), time_s)
        use = tracks.observed & is_whole & np.isfinite(x_m)
        _correct(state, x_m, noise, use=use)
        state[_MEASURED_S, use] = time_s
        is_recent = time_s - self._memory.known[_MEASURED_S] <= _MAX_GAP_S
        self._memory.remember(tracks.track_id, state, is_recent=is_recent)
        return _misses(state, ttc_s, half_width_m=width_px * m_per_px / 2)


def _predicted(state: FloatArray, time_s: float) -> FloatArray:
    state[:, ~(time_s - state[_MEASURED_S] <= _MAX_GAP_S)] = np.nan
    dt = time_s - state[_TIME_S]
    state[_X] += dt * state[_RATE]
    state[_VAR_X] += dt * (2 * state[_COV] + dt * state[_VAR_RATE]) + _WANDER_MPS**2 * dt**3 / 3
    state[_COV] += dt * state[_VAR_RATE] + _WANDER_MPS**2 * dt**2 / 2
    state[_VAR_RATE] += _WANDER_MPS**2 * dt
    state[_TIME_S] = time_s
    return state


def _correct(state: FloatArray, x_m: FloatArray, noise: FloatArray, *, use: BoolArray) -> None:
    innovation = x_m - state[_X]
    fits = innovation**2 < _JUMP**2 * (state[_VAR_X] + noise)
    fresh, known = use & ~fits, use & fits
    state[_X, fresh], state[_VAR_X, fresh] = x_m[fresh], noise[fresh]
    state[_RATE, fresh] = state[_COV, fresh] = 0.0
    state[_VAR_RATE, fresh] = _RATE_SIGMA_MPS**2
    of_x, of_both, of_rate = state[_VAR_X:, known]
    gain, rate_gain = np.stack([of_x, of_both]) / (of_x + noise[known])
    state[_X, known] += gain * innovation[known]
    state[_RATE, known] += rate_gain * innovation[known]
    state[_VAR_X:, known] = (1 - gain) * of_x, (1 - gain) * of_both, of_rate - rate_gain * of_both


def _misses(state: FloatArray, ttc_s: FloatArray, *, half_width_m: FloatArray) -> Misses:
    miss_m = state[_X] + ttc_s * state[_RATE]
    variance = state[_VAR_X] + ttc_s * (2 * state[_COV] + ttc_s * state[_VAR_RATE])
    sigma_m = np.sqrt(variance + (_STEERING_MPS2 * ttc_s**2 / 2) ** 2)
    passes = np.abs(miss_m) > _HALF_CAR_M + half_width_m + sigma_m  # False for NaN
    return Misses(miss_m, sigma_m, half_width_m, ~passes)
