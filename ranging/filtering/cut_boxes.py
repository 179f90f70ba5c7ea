r"""CutBoxes: boxes cut by the left or right image border, on whose objects the measured point
slides.

      __               The ray through the middle of the box, with the bearing b (x / z), meets the side of the object
     |  | z_f          at the distance d. While the object passes, the ray slides along it, so that d hardly changes.
     |  |              The free edge, with the bearing b_f, belongs to the far end at z_f, a fixed point of the object.
     |__| d            The inverse depth is linear in the bearing along a side:

           o camera        z_f = d / (1 - k q)      q = 1 - b_f / b      k = b / (b - tan theta)

theta is the heading relative to the camera's axis: k = 1 for traffic along the road, 0 for a side
across it. As long as the ray meets the near end instead of the side, z_f is d plus the length L, so
that z_f = min(d + L, d / (1 - k q)). The filter predicts z_f, with the object's speed, instead of
d. k is estimated with d and v, since k is constant while the heading is constant: its covariances
with both are part of the state (`SideState`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.filtering.lateral_motion import LENGTH_M, sides_cut
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.tracking.tracks import Tracks

_K_SIGMA = 0.2  # of k: headings differ by some 5 degrees between road users along the same road
_K_NOISE = 0.25  # random walk of k per square root of a second: that of a slow turn
# of the length of a car; with it the ray changes from the near end to the side
_LENGTH_SIGMA_M = 0.6
# of k: sides that face the other way, and those that point towards the camera
_K_RANGE = (-1.0, 1.4)
# of the free edge: px, plus a fraction of the width of the box
_EDGE_SIGMA_PX, _EDGE_SIGMA_FRACTION = 1.0, 0.01
# of the noise while it is unknown which end is measured, whose errors add up over some frames
_SLIDE_FACTOR = 1.5
_LEAST = 0.05  # smallest 1 - k q and |b|, against a division by zero


@dataclass(frozen=True, slots=True)
class CutBoxes:
    """The boxes of N tracks in one frame, (N,) each."""

    # whether the border cuts the box at the side away from the camera's axis, and only there
    is_cut: BoolArray
    # 1 - b_f / b, 0 where the free edge is on the other side of the axis; also of whole boxes
    q: FloatArray
    q_sigma: FloatArray  # its standard deviation
    length_m: FloatArray  # typical length L of the class
    bearing: FloatArray  # b, of the middle of the box

    @classmethod
    def of(cls, tracks: Tracks, camera: PinholeCamera) -> CutBoxes:
        """The boxes of the tracks, in the pixels of `camera`; predicted boxes are not cut."""
        left, right = edges = (tracks.xyxy_px[:, ::2].T - camera.cx_px) / camera.fx_px
        middle = edges.mean(axis=0)
        at_left, at_right = sides_cut(tracks, camera)
        is_cut = np.where(middle < 0, at_left & ~at_right, at_right & ~at_left) & tracks.observed
        b_f, b = np.where(middle < 0, -right, left), np.maximum(np.abs(middle), _LEAST)
        q = np.where(b_f > 0, 1 - b_f / b, 0.0)
        edge_sigma = _EDGE_SIGMA_PX / camera.fx_px + _EDGE_SIGMA_FRACTION * (right - left)
        return cls(is_cut, q, edge_sigma / b, LENGTH_M[tracks.class_id], middle)


class SideState(NamedTuple):
    """Estimate of k of the filters of M methods for N tracks, (M, N) each."""

    q: FloatArray  # of the last box
    k: FloatArray
    P_dk: FloatArray
    P_vk: FloatArray
    P_kk: FloatArray  # 0 = the last box was not cut

    def predicted(
        self, state: ConstantVelocity, cut: CutBoxes, dt: FloatArray, *, q: FloatArray | float
    ) -> tuple[ConstantVelocity, SideState, FloatArray]:
        """State of d and v and of k after `dt`, and the relative variance of d by the noise of the
        free edges.

        `q` is the noise of the acceleration, see `ConstantVelocity.predict`.
        """
        was_cut = self.P_kk > 0
        begins, moves = cut.is_cut & ~was_cut, cut.is_cut | was_cut
        k, P_kk = np.where(begins, 1.0, self.k), np.where(begins, _K_SIGMA**2, self.P_kk)
        P_dk, P_vk = self.P_dk, self.P_vk  # 0 at the beginning

        # From the surface to the far end.
        shrinks = np.maximum(1 - k * self.q, _LEAST)
        was_side = moves & (state.x / shrinks < state.x + cut.length_m)
        G = np.where(was_side, 1 / shrinks, 1.0)
        J = np.where(was_side, state.x * self.q * G * G, 0.0)
        far, P_dk = _transformed(state, G, J, (P_dk, P_vk, P_kk))
        near_m = np.where(moves, cut.length_m, 0.0)
        far_m = far.x + np.where(was_side, 0.0, near_m)
        far = far.predict(dt, q=q)
        far_m = far_m + dt * far.v
        P_dk, P_kk = P_dk + dt * P_vk, P_kk + _K_NOISE**2 * dt

        # And back. Within 2 sigma of the change from near end to side, the difference of both
        # predictions is noise.
        is_unclear = moves & (
            np.abs(state.x / shrinks - state.x - cut.length_m) < 2 * _LENGTH_SIGMA_M
        )
        step_m, before = dt * state.v, shrinks
        shrinks = np.maximum(1 - k * cut.q, _LEAST)
        slide_m = (state.x / before + step_m) * shrinks - (state.x + step_m)
        is_side = moves & (far_m * shrinks > far_m - cut.length_m)
        G, J = np.where(is_side, shrinks, 1.0), np.where(is_side, -far_m * cut.q, 0.0)
        P_xx = far.P_xx + np.where(is_side != was_side, _LENGTH_SIGMA_M**2, 0.0)
        P_xx += np.where(is_unclear, (_SLIDE_FACTOR * slide_m / G) ** 2, 0.0)
        far = ConstantVelocity(far_m, far.v, P_xx, far.P_xv, far.P_vv)
        state, P_dk = _transformed(far, G, J, (P_dk, P_vk, P_kk))
        state = ConstantVelocity(state.x - np.where(is_side, 0.0, near_m), *state.columns[1:])
        edge_variance = np.where(is_side, k * cut.q_sigma / G, 0.0) ** 2
        kept = [np.where(cut.is_cut, part, 0.0) for part in (P_dk, P_vk, P_kk)]
        return state, SideState(np.broadcast_to(cut.q, k.shape), k, *kept), edge_variance

    def updated(
        self, state: ConstantVelocity, nu: FloatArray, R: FloatArray, *, valid: BoolArray
    ) -> SideState:
        """The estimate after the measurements that update `state`, see
        `ConstantVelocity.update`.
        """
        K = np.where(valid, self.P_dk / (state.P_xx + R), 0.0)
        k = np.clip(self.k + K * np.where(valid, nu, 0.0), *_K_RANGE)
        P_dk, P_vk = self.P_dk - K * state.P_xx, self.P_vk - K * state.P_xv
        return SideState(self.q, k, P_dk, P_vk, self.P_kk - K * self.P_dk)


def _transformed(
    state: ConstantVelocity,
    G: FloatArray,
    J: FloatArray,
    P_k: tuple[FloatArray, FloatArray, FloatArray],
) -> tuple[ConstantVelocity, FloatArray]:
    """The state with x times G, where J is the derivative of the product by k, and its covariance
    with k.
    """
    P_dk, P_vk, P_kk = P_k
    P_xx = G * (G * state.P_xx + 2 * J * P_dk) + J * J * P_kk
    return ConstantVelocity(
        G * state.x, state.v, P_xx, G * state.P_xv + J * P_vk, state.P_vv
    ), G * P_dk + J * P_kk
