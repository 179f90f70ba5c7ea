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

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
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
        left, right = (tracks.xyxy_px[:, ::2].T - camera.cx_px) / camera.fx_px
        middle = (left + right) / 2
        at_left, at_right = sides_cut(tracks, camera)
        is_left = middle < 0
        is_cut = (at_left ^ at_right) & np.where(is_left, at_left, at_right) & tracks.observed
        b_f, b = np.where(is_left, -right, left), np.maximum(np.abs(middle), _LEAST)
        q = np.where(b_f > 0, 1 - b_f / b, 0.0)
        edge_sigma = _EDGE_SIGMA_PX / camera.fx_px + _EDGE_SIGMA_FRACTION * (right - left)
        return cls(is_cut, q, edge_sigma / b, LENGTH_M[tracks.class_id], middle)

    def of_tracks(self, tracks: IntArray) -> CutBoxes:
        """The boxes of some tracks (N,)."""
        return CutBoxes(*(getattr(self, name)[tracks] for name in self.__slots__))


class SideState(NamedTuple):
    """Estimate of k in the filters of M methods, G models and N tracks, (M, G, N) each.

    With d and v it is the state x = [d v k]', with the steps

        F = [1 dt 0; 0 1 0; 0 0 1]   of the far end, Q_kk = dt 0.25^2    between T and T^-1,
        T = [G 0 J; 0 1 0; 0 0 1]    from the surface to the far end, z_f = G d and J = dz_f / dk
        H = [1 0 0]                  of a distance

    d, v and their covariance P_dd, P_dv, P_vv are a `ConstantVelocity`.
    """

    k: FloatArray
    P_dk: FloatArray
    P_vk: FloatArray
    P_kk: FloatArray  # 0 = the last box was not cut

    @classmethod
    def none(cls) -> SideState:
        """The estimate without a cut box, () each."""
        zero = np.array(0.0)
        return cls(zero, zero, zero, zero)

    @property
    def is_cut(self) -> BoolArray:
        """(M, G, N) whether the last box was cut."""
        return np.asarray(self.P_kk > 0)

    def predict(
        self,
        motion: ConstantVelocity,
        last_q: FloatArray,
        cut: CutBoxes,
        dt: FloatArray,
        *,
        noise: FloatArray | float,
    ) -> tuple[ConstantVelocity, SideState, FloatArray]:
        """The motion and k after `dt`, and the relative variance of d by the noise of free edges,
        of boxes that are cut or were in the last frame.

        `last_q` is q of the last boxes, `noise` that of the acceleration, see
        `ConstantVelocity.predict`.
        """
        near_m, side = cut.length_m, self._begin(cut)

        # From the surface to the far end.
        d = motion.x
        last_ratio = np.maximum(1 - side.k * last_q, _LEAST)
        far_m = d / last_ratio
        was_side = far_m < d + cut.length_m
        G = np.where(was_side, 1 / last_ratio, 1.0)
        J = np.where(was_side, d * last_q * G * G, 0.0)
        far, side = side._transform(motion, G, J, np.where(was_side, 0.0, near_m))

        # The motion of the far end.
        far = far.predict(dt, q=noise)
        side = side._replace(P_dk=side.P_dk + dt * side.P_vk, P_kk=side.P_kk + _K_NOISE**2 * dt)

        # And back; which of both the ray met is not certain near the change.
        ratio = np.maximum(1 - side.k * cut.q, _LEAST)
        is_side = far.x * ratio > far.x - cut.length_m
        G = np.where(is_side, ratio, 1.0)
        J = np.where(is_side, -far.x * cut.q, 0.0)
        step_m = dt * motion.v
        slide_m = (far_m + step_m) * ratio - (d + step_m)
        is_unclear = np.abs(far_m - d - cut.length_m) < 2 * _LENGTH_SIGMA_M
        P_xx = far.P_xx + np.where(is_side != was_side, _LENGTH_SIGMA_M**2, 0.0)
        P_xx += np.where(is_unclear, (_SLIDE_FACTOR * slide_m / G) ** 2, 0.0)
        far = ConstantVelocity(far.x, far.v, P_xx, far.P_xv, far.P_vv)
        motion, side = side._transform(far, G, J, np.where(is_side, 0.0, -near_m))
        edge_variance = np.where(is_side, side.k * cut.q_sigma / G, 0.0) ** 2
        return motion, side._end(cut), edge_variance

    def correct(self, motion: ConstantVelocity, nu: FloatArray, S: FloatArray) -> SideState:
        """The estimate after the distances with the innovations nu of variance S that correct
        `motion`.
        """
        K = self.P_dk / S
        k = np.clip(self.k + K * nu, *_K_RANGE)
        P_dk, P_vk = self.P_dk - K * motion.P_xx, self.P_vk - K * motion.P_xv
        return SideState(k, P_dk, P_vk, self.P_kk - K * self.P_dk)

    def restart(self, starts: BoolArray) -> SideState:
        """The estimate where filters of d and v restart: k stays, and is not correlated."""
        return self._replace(
            P_dk=np.where(starts, 0.0, self.P_dk), P_vk=np.where(starts, 0.0, self.P_vk)
        )

    def _begin(self, cut: CutBoxes) -> SideState:
        """The estimate with boxes that the border begins to cut: a side along the axis, k = 1."""
        begins = cut.is_cut & ~self.is_cut
        if not begins.any():
            return self
        k = np.where(begins, 1.0, self.k)
        return self._replace(k=k, P_kk=np.where(begins, _K_SIGMA**2, self.P_kk))

    def _end(self, cut: CutBoxes) -> SideState:
        """The estimate without boxes that the border no longer cuts."""
        kept = (np.where(cut.is_cut, part, 0.0) for part in (self.P_dk, self.P_vk, self.P_kk))
        return SideState(self.k, *kept)

    def _transform(
        self, motion: ConstantVelocity, G: FloatArray, J: FloatArray, shift_m: FloatArray
    ) -> tuple[ConstantVelocity, SideState]:
        """The state T x and T P T': d times G, plus `shift_m`, where J is its derivative by k."""
        P_xx = G * (G * motion.P_xx + 2 * J * self.P_dk) + J * J * self.P_kk
        P_xv = G * motion.P_xv + J * self.P_vk
        moved = ConstantVelocity(G * motion.x + shift_m, motion.v, P_xx, P_xv, motion.P_vv)
        return moved, self._replace(P_dk=G * self.P_dk + J * self.P_kk)
