"""OwnAcceleration: acceleration of moving objects over ground, which lasts for about a second.

Drivers brake and speed up for a second or two at a time: the change of speed over four seconds is
larger than that of a random walk that has the right changes over one (Singer, Estimating optimal
tracking filter performance for manned maneuvering targets, IEEE TAES 1970):

    a(t + dt) = e a(t) + noise        e = exp(-dt / tau), var a = sigma_a^2
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.filtering.key_distance import GrowthInnovation, KeyDistance

# tau, from changes of speed of moving vehicles on 13 of KITTI's sequences: their mean square grows
# by factors of 3.3, 3.0 and 2.7 from 0.5 over 1 and 2 to 4 s, that of a random walk by 2
MANOEUVRE_S = 1.5
_MAX_LAG_S = 0.6  # of a motion that is corrected


class OwnAcceleration(NamedTuple):
    """Acceleration in the filters of M methods, G models and N tracks, (M, G, N) each.

    With d and v it is the state x = [d v a]', with the steps

        F = [1 dt f; 0 1 g; 0 0 e]      g = tau (1 - e), f = tau (dt - g)
        Q_aa = sigma_a^2 (1 - e^2)      Q_va, Q_vv = j dt^2 / 2, j dt^3 / 3, j = 2 sigma_a^2 / tau
        H = [1 0 0]                     of a distance

    r is the distance of the key frame (`KeyDistance`); the heading k of a cut box is taken to be
    independent of a. d, v and their covariance P_dd, P_dv, P_vv are a `ConstantVelocity`.
    """

    a: FloatArray  # m/s^2, positive = drawing away; 0 for static models
    P_da: FloatArray
    P_va: FloatArray
    P_aa: FloatArray
    P_ra: FloatArray

    @classmethod
    def none(cls) -> OwnAcceleration:
        """No acceleration, () each."""
        zero = np.array(0.0)
        return cls(zero, zero, zero, zero, zero)

    def predict(
        self, motion: ConstantVelocity, dt: FloatArray, sigma_mps2: FloatArray
    ) -> tuple[ConstantVelocity, OwnAcceleration]:
        """The motion, which is predicted without a, and the acceleration after `dt`.

        `sigma_mps2` is sigma_a.
        """
        e, f, g = _transition(dt)
        variance = sigma_mps2 * sigma_mps2
        jerk = 2 / MANOEUVRE_S * dt * dt * variance
        P_da, P_aa = self.P_da + dt * self.P_va, self.P_aa
        after_da, after_va = P_da + f * P_aa, self.P_va + g * P_aa
        moved = ConstantVelocity(
            x=motion.x + f * self.a,
            v=motion.v + g * self.a,
            P_xx=motion.P_xx + f * (P_da + after_da),
            P_xv=motion.P_xv + g * P_da + f * after_va,
            P_vv=motion.P_vv + g * (self.P_va + after_va) + dt / 3 * jerk,
        )
        return moved, OwnAcceleration(
            a=e * self.a,
            P_da=e * after_da,
            P_va=e * after_va + jerk / 2,
            P_aa=variance + e * e * (P_aa - variance),
            P_ra=e * self.P_ra,
        )

    def correct(
        self, motion: ConstantVelocity, P_dr: FloatArray | float, nu: FloatArray, S: FloatArray
    ) -> OwnAcceleration:
        """The acceleration after the distances with the innovations nu of variance S that correct
        `motion`; `P_dr` is the covariance of d and r.
        """
        K = self.P_da / S
        return OwnAcceleration(
            a=self.a + K * nu,
            P_da=self.P_da - K * motion.P_xx,
            P_va=self.P_va - K * motion.P_xv,
            P_aa=self.P_aa - K * self.P_da,
            P_ra=self.P_ra - K * P_dr,
        )

    def scaled(self, factor: FloatArray) -> OwnAcceleration:
        """The acceleration in another scale of all lengths."""
        squared = factor * factor
        return OwnAcceleration(factor * self.a, *(squared * part for part in self[1:]))

    def predict_key(self, key: KeyDistance, dt: FloatArray) -> KeyDistance:
        """The key distance after `dt`, by the acceleration before it."""
        _, f, g = _transition(dt)
        key = key.predict(dt)
        return key._replace(P_dr=key.P_dr + f * self.P_ra, P_vr=key.P_vr + g * self.P_ra)

    def correct_by_growth(self, growth: GrowthInnovation, weight: FloatArray) -> OwnAcceleration:
        """The acceleration after the growths with the `weight` 1 / S; 0 = not used."""
        P_az = growth.c * self.P_ra - self.P_da
        K = weight * P_az
        return OwnAcceleration(
            a=self.a + K * growth.nu,
            P_da=self.P_da - K * growth.P_dz,
            P_va=self.P_va - K * growth.P_vz,
            P_aa=self.P_aa - K * P_az,
            P_ra=self.P_ra - K * growth.P_rz,
        )

    def restart(self, starts: BoolArray, sigma_mps2: FloatArray) -> OwnAcceleration:
        """The acceleration where filters of d and v restart: 0 +- sigma_a."""
        none = self.none()
        new = none._replace(P_aa=sigma_mps2 * sigma_mps2)
        return OwnAcceleration(*(np.where(starts, *pair) for pair in zip(new, self, strict=True)))

    def start_key(self, is_key: BoolArray) -> OwnAcceleration:
        """The acceleration where this frame becomes the key frame, whose r is d."""
        return self._replace(P_ra=np.where(is_key, self.P_da, self.P_ra))


def without_lag(
    motion: ConstantVelocity, missed_mps2: FloatArray, variance: FloatArray
) -> ConstantVelocity:
    """Filtered distances and rates, corrected for their lag behind an acceleration of which the
    filter follows all but `missed_mps2`, with its variance.

    In the steady state, a filter of constant speed is behind by e_v = a T and e_x = a T^2 / 2 with
    T = P_xx / P_xv; one that follows a part of a is behind by the rest.
    """
    T = np.clip(motion.P_xx / np.maximum(motion.P_xv, 1e-9), 0.0, _MAX_LAG_S)
    return ConstantVelocity(
        motion.x + missed_mps2 * T * T / 2,
        motion.v + missed_mps2 * T,
        motion.P_xx + variance * T**4 / 4,
        motion.P_xv + variance * T**3 / 2,
        motion.P_vv + variance * T * T,
    )


def _transition(dt: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """e, f and g of the time steps."""
    e = np.exp(-dt / MANOEUVRE_S)
    g = MANOEUVRE_S * (1 - e)
    return e, MANOEUVRE_S * (dt - g), g
