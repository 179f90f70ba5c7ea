"""ConstantVelocity: Kalman filters of values x and their rates v, one per element of arrays of any
shape.

    predict    x' = x + v dt     v' = v     P' = F P F^T + Q     F = [[1, dt], [0, 1]]
               Q = q [[dt^3/3, dt^2/2], [dt^2/2, dt]]
    update     S = P_xx + R      K = [P_xx, P_xv] / S      [x, v]' = [x, v] + K nu      P' = P - K S K^T

q is the power spectral density of continuous noise, so that two steps of dt/2 equal one step of dt.
nu = z - x is the innovation of a measurement z of x with variance R.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class ConstantVelocity:
    """Values x, rates v per second and covariances P; shared covariances may have axes of length
    1.
    """

    x: FloatArray
    v: FloatArray
    P_xx: FloatArray
    P_xv: FloatArray
    P_vv: FloatArray

    @property
    def columns(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """The values in the order of the constructor."""
        return self.x, self.v, self.P_xx, self.P_xv, self.P_vv

    def scaled(self, factor: FloatArray | float) -> ConstantVelocity:
        """The states of values times a factor."""
        x, v, *P = self.columns
        return ConstantVelocity(factor * x, factor * v, *(factor**2 * part for part in P))

    def predict(self, dt: FloatArray | float, *, q: FloatArray | float) -> ConstantVelocity:
        """The states after `dt` >= 0 seconds, in each of which the variance of v grows by `q`."""
        P_xv = self.P_xv + dt * self.P_vv
        return ConstantVelocity(
            x=self.x + dt * self.v,
            v=self.v,
            P_xx=self.P_xx + dt * (self.P_xv + P_xv + q * (dt * dt / 3)),
            P_xv=P_xv + q * (dt * dt / 2),
            P_vv=self.P_vv + q * dt,
        )

    def update(
        self, innovation: FloatArray, R: FloatArray | float, *, valid: BoolArray | bool = True
    ) -> ConstantVelocity:
        """The states after measurements with innovation nu and variance R > 0; states outside
        `valid` do not change.
        """
        S, nu = self.P_xx + R, innovation
        if valid is not True:
            S, nu = np.where(valid, S, np.inf), np.where(valid, innovation, 0.0)
        return self.correct(nu, S)

    def correct(self, nu: FloatArray, S: FloatArray) -> ConstantVelocity:
        """The states after innovations nu of variance S; with S = inf and nu = 0, states do not
        change.
        """
        weight = 1.0 / S
        K_x, K_v = weight * self.P_xx, weight * self.P_xv
        return ConstantVelocity(
            x=self.x + K_x * nu,
            v=self.v + K_v * nu,
            P_xx=self.P_xx - K_x * self.P_xx,
            P_xv=self.P_xv - K_x * self.P_xv,
            P_vv=self.P_vv - K_v * self.P_xv,
        )
