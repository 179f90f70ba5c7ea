r"""KeyDistance: growth of objects in the images since a key frame, as a measurement of the filters
of distances.

The ratio of an object's size now and in its key frame gives the ratio of its distances, without a
focal length or a size:

    log s = log r - log d      r: distance in the key frame, H = [-1/d 0 1/r] for the state [d v r]'

r is part of the state from the key frame on: it starts as a copy of d, with its covariances
(stochastic cloning, Roumeliotis and Burdick, ICRA 2002), so that the noise of the distance in the
key frame is not counted twice.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.foundation.constant_velocity import ConstantVelocity


class Growth(NamedTuple):
    """Sizes of N tracks in the image relative to the sizes in their key frames, (N,) each."""

    log_ratio: FloatArray  # log(size now / size in the key frame); NaN = not measured
    sigma: FloatArray  # its standard deviation
    is_key: BoolArray  # whether this frame becomes the key frame of those that follow


class KeyDistance(NamedTuple):
    """Distance of the key frame in the filters of M methods for N tracks, (M, N) each."""

    r: FloatArray  # m; NaN = there is no key frame
    P_dr: FloatArray
    P_vr: FloatArray
    P_rr: FloatArray

    def predicted(self, dt: FloatArray) -> KeyDistance:
        """The state after `dt` seconds."""
        return self._replace(P_dr=self.P_dr + dt * self.P_vr)

    def stepped(self, d: FloatArray, variance: FloatArray) -> KeyDistance:
        """The state after a relative step of both distances, which adds `variance` to the variance
        of d.
        """
        c = np.fmax(self.r / d, 0.0)  # 0 without a key frame
        return self._replace(P_dr=self.P_dr + c * variance, P_rr=self.P_rr + c * c * variance)

    def updated(
        self, state: ConstantVelocity, nu: FloatArray, R: FloatArray, *, valid: BoolArray
    ) -> KeyDistance:
        """The state after the measurements of d that update `state`, see
        `ConstantVelocity.update`.
        """
        K = np.where(valid, self.P_dr / (state.P_xx + R), 0.0)
        r = self.r + K * np.where(valid, nu, 0.0)
        P_dr, P_vr = self.P_dr - K * state.P_xx, self.P_vr - K * state.P_xv
        return KeyDistance(r, P_dr, P_vr, self.P_rr - K * self.P_dr)

    def grown(
        self, state: ConstantVelocity, growth: Growth, *, valid: BoolArray, outlier_sigma: float
    ) -> tuple[ConstantVelocity, KeyDistance, FloatArray, FloatArray]:
        """Both states after the growth, and its innovation in m, NaN = not measured, with its
        variance.

        Measurements beyond `outlier_sigma` standard deviations are down-weighted. Where the
        covariance would not be positive, since distances far apart are not linear, the key frame is
        given up instead.
        """
        d, c = state.x, state.x / self.r
        nu = d * (growth.log_ratio - np.log(self.r / d))
        valid = valid & np.isfinite(nu)
        # P H^T
        H_d, H_v, H_r = (
            c * self.P_dr - state.P_xx,
            c * self.P_vr - state.P_xv,
            c * self.P_rr - self.P_dr,
        )
        S = np.maximum(c * H_r - H_d, 0.0)
        R = (d * growth.sigma) ** 2
        innovation, variance = np.where(valid, nu, np.nan), S + R
        R = R * np.maximum(1.0, np.abs(nu) / (outlier_sigma * np.sqrt(variance))) ** 2
        weight, nu = np.where(valid, 1 / (S + R), 0.0), np.where(valid, nu, 0.0)
        H_d, H_v, H_r = (np.where(valid, part, 0.0) for part in (H_d, H_v, H_r))
        K_d, K_v, K_r = weight * H_d, weight * H_v, weight * H_r
        grown = ConstantVelocity(
            x=d + K_d * nu,
            v=state.v + K_v * nu,
            P_xx=state.P_xx - K_d * H_d,
            P_xv=state.P_xv - K_d * H_v,
            P_vv=state.P_vv - K_v * H_v,
        )
        key = KeyDistance(
            self.r + K_r * nu, self.P_dr - K_d * H_r, self.P_vr - K_v * H_r, self.P_rr - K_r * H_r
        )
        is_lost = (
            (grown.P_xx <= 0)
            | (grown.P_vv <= 0)
            | (grown.P_xx * grown.P_vv < grown.P_xv**2)
            | (key.P_rr <= 0)
        )
        is_lost &= valid
        grown = ConstantVelocity(
            *(np.where(is_lost, *pair) for pair in zip(state.columns, grown.columns, strict=True))
        )
        return grown, key._replace(r=np.where(is_lost, np.nan, key.r)), innovation, variance

    def started(self, state: ConstantVelocity, is_key: BoolArray) -> KeyDistance:
        """The state with copies of the distances where this frame becomes the key frame."""
        new = (
            state.x,
            *(np.where(np.isnan(part), 0.0, part) for part in (state.P_xx, state.P_xv, state.P_xx)),
        )
        return KeyDistance(*(np.where(is_key, *pair) for pair in zip(new, self, strict=True)))
