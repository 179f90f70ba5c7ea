r"""CollisionCourse: lateral offset at which a track will pass the camera, and whether it may hit the ego vehicle.

       v per second
    o ---.            The state of a constant-velocity Kalman filter is the lateral position x of the object and its
    |     \           rate v; the measurement z is the bearing of the box centre times the filtered distance. At the
    |      \          time to collision T the object passes the camera at the lateral offset
    +--[]---'             o = x + v T,    var o = P_xx + 2 T P_xv + T^2 P_vv + (a T^2 / 2)^2
     camera  o        where a is the standard deviation of the lateral acceleration until then (steering, curves).
                      At constant bearing o = 0.

A track is on a collision course unless |o| exceeds the sum of half the box width, half the width of the ego vehicle and
one standard deviation. A box that is truncated at the left or right image border is not a measurement: the bearing of
its visible part stays constant while the object passes, as on a collision course.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.foundation.track_state import TrackState
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.tracking.tracks import Tracks

_EGO_HALF_WIDTH_M = 0.9
"""Half the width of the ego vehicle in m, of a typical passenger car."""

_LATERAL_ACCELERATION_MPS2 = 0.25
"""Standard deviation a of the lateral acceleration, tuned on simulated drives; a lane change reaches twice as much."""

_INITIAL_RATE_SIGMA_MPS = 5.0
"""Standard deviation of v for a new track: lateral speed of a runner, or of a car in town."""

_ACCELERATION_NOISE = 0.7
"""Process noise: random walk of v in m/s per square root of a second, tuned on simulated drives."""

_CENTRE_SIGMA_PX, _CENTRE_SIGMA_SHARE = 1.0, 0.02
"""Standard deviation of a box centre: a constant in px, plus a fraction of the box width; typical of detectors."""

_GATE_SIGMA = 5.0
"""Gate in standard deviations of the innovation; a measurement outside restarts the track's filter."""

_BORDER_PX = 2.0
"""Distance in px from the left or right image border within which a box counts as cut by it."""

_MAX_GAP_S = 1.0
"""Longest time without a measurement in s; after it the track's filter restarts."""

_N_STATE = 7
"""Values per track: x, v, P_xx, P_xv, P_vv, time of the state, time of the last measurement."""


@dataclass(frozen=True, slots=True)
class PassingOffsets:
    """Lateral offsets at which tracks will pass the camera, (N,) each; NaN = unknown.

    Attributes:
        lateral_offset_m: offset o of the object's centre at the time of collision, positive = right of the camera.
        sigma_m: its standard deviation.
        half_width_m: half the width of the object, from its current box.
        may_hit: False if the object will pass the ego vehicle; True also if that is unknown.
    """

    lateral_offset_m: FloatArray
    sigma_m: FloatArray
    half_width_m: FloatArray
    may_hit: BoolArray


class CollisionCourse:
    """Kalman filters of the lateral motion of all tracks of a video, relative to one camera."""

    def __init__(self, camera: PinholeCamera) -> None:
        """Start without tracks; boxes are in the pixels of `camera` (undistorted)."""
        self._camera = camera
        self._tracks = TrackState(np.full(_N_STATE, np.nan))

    def update(self, tracks: Tracks, distance_m: FloatArray, ttc_s: FloatArray, time_s: float) -> PassingOffsets:
        """Passing offsets of the tracks after the measurements of this frame.

        Args:
            tracks: N tracks; predicted boxes and boxes truncated at the left or right border are not measurements.
            distance_m: (N,) filtered distance, NaN = unknown.
            ttc_s: (N,) time to collision T; NaN = not closing, the offset is then NaN too.
            time_s: time of the frame, not earlier than that of the previous frame.
        """
        left, right = tracks.xyxy_px[:, 0], tracks.xyxy_px[:, 2]
        width_px = right - left
        m_per_px = np.where(np.isfinite(distance_m), distance_m, np.nan) / self._camera.fx_px
        z = ((left + right) / 2 - self._camera.cx_px) * m_per_px
        R = ((_CENTRE_SIGMA_PX + _CENTRE_SIGMA_SHARE * width_px) * m_per_px) ** 2
        is_whole = (left > _BORDER_PX) & (right < self._camera.width_px - 1 - _BORDER_PX)
        valid = tracks.observed & is_whole & np.isfinite(z)

        *stored, state_s, measured_s = self._tracks.get(tracks.track_id)
        is_stale = ~(time_s - measured_s <= _MAX_GAP_S)
        predicted = ConstantVelocity(*stored).predict(time_s - state_s, q=_ACCELERATION_NOISE**2)
        innovation = z - predicted.x
        is_in_gate = ~is_stale & (innovation**2 < _GATE_SIGMA**2 * (predicted.P_xx + R))
        updated = predicted.update(innovation, R, valid=valid & is_in_gate)

        state = np.array([updated.x, updated.v, updated.P_xx, updated.P_xv, updated.P_vv])
        state[:, is_stale] = np.nan
        initial = np.array([z, 0 * z, R, 0 * z, 0 * z + _INITIAL_RATE_SIGMA_MPS**2])
        np.copyto(state, initial, where=valid & ~is_in_gate)
        measured_s = np.where(valid, time_s, measured_s)
        is_recent = time_s - self._tracks.known[-1] <= _MAX_GAP_S
        columns = np.concatenate([state, [np.full(len(tracks), time_s), measured_s]])
        self._tracks.put(tracks.track_id, columns, keep_known=is_recent)
        return _offsets(ConstantVelocity(*state), ttc_s, half_width_m=width_px * m_per_px / 2)


def _offsets(state: ConstantVelocity, ttc_s: FloatArray, *, half_width_m: FloatArray) -> PassingOffsets:
    """Offsets o of the states, predicted by T = `ttc_s`."""
    T, a = ttc_s, _LATERAL_ACCELERATION_MPS2
    offset_m = state.x + T * state.v
    variance = state.P_xx + T * (2 * state.P_xv + T * state.P_vv)
    sigma_m = np.sqrt(variance + (a * T**2 / 2) ** 2)
    passes = np.abs(offset_m) > _EGO_HALF_WIDTH_M + half_width_m + sigma_m  # False for NaN
    return PassingOffsets(offset_m, sigma_m, half_width_m, ~passes)
