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
from track_range.ranging.measurement.growth import Growth


class KeyDistance(NamedTuple):
    """Distance of the key frame in the filters of M methods, G models and N tracks, (M, G, N) each.

    With d and v it is the state x = [d v r]', with the steps

        F = [1 dt 0; 0 1 0; 0 0 1]    Q_rr = 0
        H = [1 0 0]                   of a distance
        H = d [-1/d 0 1/r]            of a growth in m, nu = d (log s - log r/d), R = d^2 sigma^2

    d, v and their covariance P_dd, P_dv, P_vv are a `ConstantVelocity`.
    """

    r: FloatArray  # m; NaN = there is no key frame
    P_dr: FloatArray
    P_vr: FloatArray
    P_rr: FloatArray

    @classmethod
    def none(cls) -> KeyDistance:
        """The state without a key frame, () each."""
        zero = np.array(0.0)
        return cls(np.array(np.nan), zero, zero, zero)

    @property
    def exists(self) -> BoolArray:
        """(M, G, N) whether there is a key frame."""
        return np.isfinite(self.r)

    def predict(self, dt: FloatArray) -> KeyDistance:
        """The state after `dt` seconds."""
        return self._replace(P_dr=self.P_dr + dt * self.P_vr)

    def scaled(self, factor: FloatArray) -> KeyDistance:
        """The state of both distances times a factor."""
        squared = factor * factor
        return KeyDistance(
            self.r * factor, self.P_dr * squared, self.P_vr * squared, self.P_rr * squared
        )

    def step(self, d: FloatArray, variance: FloatArray) -> KeyDistance:
        """The state after a relative step of both distances, which adds `variance` to the variance
        of d.
        """
        c = np.fmax(self.r / d, 0.0)  # 0 without a key frame
        return self._replace(P_dr=self.P_dr + c * variance, P_rr=self.P_rr + c * c * variance)

    def correct(self, motion: ConstantVelocity, nu: FloatArray, S: FloatArray) -> KeyDistance:
        """The state after the distances with the innovations nu of variance S that correct
        `motion`.
        """
        K = self.P_dr / S
        P_dr, P_vr = self.P_dr - K * motion.P_xx, self.P_vr - K * motion.P_xv
        return KeyDistance(self.r + K * nu, P_dr, P_vr, self.P_rr - K * self.P_dr)

    def innovation(
        self, motion: ConstantVelocity, growth: Growth, *, valid: BoolArray
    ) -> GrowthInnovation:
        """Innovations of the growth of those `valid` filters that have a key frame."""
        d = motion.x
        # NaN without a key frame, and if a model predicts the object behind the camera
        nu = d * (growth.log_ratio - np.log(np.where(self.r * d > 0.0, self.r / d, np.nan)))
        valid = valid & np.isfinite(nu)
        c = np.where(valid, d / self.r, 0.0)
        P_dz = c * self.P_dr - motion.P_xx
        P_vz = c * self.P_vr - motion.P_xv
        P_rz = c * self.P_rr - self.P_dr
        return GrowthInnovation(
            valid=valid,
            nu=np.where(valid, nu, 0.0),
            R=(d * growth.sigma) ** 2,
            P_dz=P_dz,
            P_vz=P_vz,
            P_rz=P_rz,
            P_zz=np.maximum(c * P_rz - P_dz, 0.0),
            c=c,
        )

    def correct_by_growth(
        self, motion: ConstantVelocity, growth: GrowthInnovation, *, outlier_sigma: float
    ) -> tuple[ConstantVelocity, KeyDistance, FloatArray]:
        """Motion and key distance after the growth, and the weight 1 / S that it had.

        A weight of 0 = unchanged, since the growth is not valid or the key frame was given up.

        Measurements beyond `outlier_sigma` standard deviations are down-weighted. Where the
        covariance would not be positive, since distances far apart are not linear, the key frame is
        given up instead.
        """
        nu, P_dz, P_vz, P_rz = growth.nu, growth.P_dz, growth.P_vz, growth.P_rz
        excess = np.abs(nu) / (outlier_sigma * np.sqrt(growth.P_zz + growth.R))
        R = growth.R * np.maximum(1.0, excess) ** 2
        weight = np.where(growth.valid, 1 / (growth.P_zz + R), 0.0)
        K_d, K_v, K_r = weight * P_dz, weight * P_vz, weight * P_rz
        grown = ConstantVelocity(
            x=motion.x + K_d * nu,
            v=motion.v + K_v * nu,
            P_xx=motion.P_xx - K_d * P_dz,
            P_xv=motion.P_xv - K_d * P_vz,
            P_vv=motion.P_vv - K_v * P_vz,
        )
        key = KeyDistance(
            r=self.r + K_r * nu,
            P_dr=self.P_dr - K_d * P_rz,
            P_vr=self.P_vr - K_v * P_rz,
            P_rr=self.P_rr - K_r * P_rz,
        )
        is_lost = growth.valid & ~key._is_positive(grown)
        if not is_lost.any():
            return grown, key, weight
        kept = (
            np.where(is_lost, *pair) for pair in zip(motion.columns, grown.columns, strict=True)
        )
        return ConstantVelocity(*kept), key.drop(is_lost), np.where(is_lost, 0.0, weight)

    def _is_positive(self, motion: ConstantVelocity) -> BoolArray:
        """Whether variances are positive and d and v not more than fully correlated."""
        is_impossible = (
            (motion.P_xx <= 0)
            | (motion.P_vv <= 0)
            | (motion.P_xx * motion.P_vv < motion.P_xv**2)
            | (self.P_rr <= 0)
        )
        return np.asarray(~is_impossible)

    def drop(self, where: BoolArray) -> KeyDistance:
        """The state without the key frames of filters `where`."""
        return self._replace(r=np.where(where, np.nan, self.r))

    def restart(self, starts: BoolArray) -> KeyDistance:
        """The state where filters of d and v restart, whose covariances may have been NaN."""
        pairs = zip(self.none(), self, strict=True)
        return KeyDistance(*(np.where(starts, new, part) for new, part in pairs))

    def start(self, motion: ConstantVelocity, is_key: BoolArray) -> KeyDistance:
        """The state with copies of the distances where this frame becomes the key frame."""
        P_dr = np.where(np.isnan(motion.P_xx), 0.0, motion.P_xx)
        P_vr = np.where(np.isnan(motion.P_xv), 0.0, motion.P_xv)
        copy = KeyDistance(r=motion.x, P_dr=P_dr, P_vr=P_vr, P_rr=P_dr)
        return KeyDistance(*(np.where(is_key, *pair) for pair in zip(copy, self, strict=True)))


class GrowthInnovation(NamedTuple):
    """Innovations z of the growths of N tracks in the filters of M methods and G models, (M, G, N)
    each.
    """

    valid: BoolArray  # False = no growth, or no key frame
    nu: FloatArray  # m; 0 = not valid
    R: FloatArray  # m^2
    # P H', covariances of d, v and r with the prediction of z
    P_dz: FloatArray
    P_vz: FloatArray
    P_rz: FloatArray
    P_zz: FloatArray  # H P H'; the variance of nu is P_zz + R
    c: FloatArray  # d / r; 0 = not valid
