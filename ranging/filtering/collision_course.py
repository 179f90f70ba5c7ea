r"""CollisionCourse: where a track will be, sideways, when its distance has run out: on us, or passing beside.

       v per second
    o ---.            The lateral position x of an object and its rate v are a constant-velocity Kalman filter, whose
    |     \           measurement is the bearing of the box's centre times the filtered distance. At the time T of the
    |      \          collision the object passes the camera at
    +--[]---'             o = x + v T,    var o = P_xx + 2 T P_xv + T^2 P_vv + (a T^2 / 2)^2,
     camera  o        where a is the sideways acceleration that may come until then: either may steer, and the road
                      may bend. A bearing that does not change is o = 0.

A track is on a collision course unless |o| is larger than half the box's width, half our own, and one standard
deviation. A box that the edge of the image cuts is not a measurement: its visible centre stays where it is, as if on a
collision course, while it passes.
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
"""Half the width of our own car."""

_LATERAL_ACCELERATION_MPS2 = 0.25
"""a, one sigma; a lane change reaches twice that. Chosen on simulated drives."""

_INITIAL_RATE_SIGMA_MPS = 5.0
"""Standard deviation of v of a new track: a runner, or a car in town."""

_ACCELERATION_NOISE = 0.7
"""Random walk of v, m/s per root second."""

_CENTRE_SIGMA_PX, _CENTRE_SIGMA_SHARE = 1.0, 0.02
"""Noise of a box's centre: a constant, and a share of its width."""

_GATE_SIGMA = 5.0
"""A measurement farther from its prediction, in standard deviations, restarts the track's filter: it is another object,
or was one."""

_BORDER_PX = 2.0
"""A box that ends within this distance from the left or right edge of the image is cut by it."""

_MAX_GAP_S = 1.0
"""A track without a measurement for longer starts anew."""

_N_STATE = 7  # x, v, P_xx, P_xv, P_vv, time of the state, time of the last measurement


@dataclass(frozen=True, slots=True)
class PassingOffsets:
    """Where tracks will pass the camera, (N,) each; NaN = unknown.

    Attributes:
        lateral_offset_m: how far to the right of the camera the object's centre will be at the time of the collision.
        sigma_m: its standard deviation.
        half_width_m: half the width of the object, as its box shows it now.
        may_hit: False where the object will pass beside; True also where that is unknown.
    """

    lateral_offset_m: FloatArray
    sigma_m: FloatArray
    half_width_m: FloatArray
    may_hit: BoolArray


class CollisionCourse:
    """Lateral motion of all tracks of a video, as one camera sees them."""

    def __init__(self, camera: PinholeCamera) -> None:
        """Start without tracks; `camera` is the one whose pixels the boxes are in."""
        self._camera = camera
        self._tracks = TrackState(np.full(_N_STATE, np.nan))

    def update(self, tracks: Tracks, distance_m: FloatArray, ttc_s: FloatArray, time_s: float) -> PassingOffsets:
        """Where every track will pass, after this frame.

        Args:
            tracks: boxes; those that are predicted, or cut by the image's left or right edge, are not measurements.
            distance_m: (N,) filtered distance, NaN = unknown.
            ttc_s: (N,) time to collision, NaN = it does not close, and its offset is unknown.
            time_s: of the frame, never earlier than the one before.
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
        is_near = ~is_stale & (innovation**2 < _GATE_SIGMA**2 * (predicted.P_xx + R))
        updated = predicted.update(innovation, R, valid=valid & is_near)

        state = np.array([updated.x, updated.v, updated.P_xx, updated.P_xv, updated.P_vv])
        state[:, is_stale] = np.nan
        initial = np.array([z, 0 * z, R, 0 * z, 0 * z + _INITIAL_RATE_SIGMA_MPS**2])
        np.copyto(state, initial, where=valid & ~is_near)
        measured_s = np.where(valid, time_s, measured_s)
        is_recent = time_s - self._tracks.known[-1] <= _MAX_GAP_S
        kept = np.concatenate([state, [np.full(len(tracks), time_s), measured_s]])
        self._tracks.put(tracks.track_id, kept, keep_known=is_recent)
        return _offsets(ConstantVelocity(*state), ttc_s, half_width_m=width_px * m_per_px / 2)


def _offsets(state: ConstantVelocity, ttc_s: FloatArray, *, half_width_m: FloatArray) -> PassingOffsets:
    """The states `ttc_s` later, when the distances are 0."""
    offset_m = state.x + ttc_s * state.v
    variance = state.P_xx + ttc_s * (2 * state.P_xv + ttc_s * state.P_vv)
    sigma_m = np.sqrt(variance + (_LATERAL_ACCELERATION_MPS2 * ttc_s**2 / 2) ** 2)
    is_beside = np.abs(offset_m) > _EGO_HALF_WIDTH_M + half_width_m + sigma_m  # False for NaN
    return PassingOffsets(offset_m, sigma_m, half_width_m, ~is_beside)
