"""TargetStates: the Gaussian states of all distance filters, in one array that every step changes at
once.

    x = [d v a r]'      distance d in m, its rate v, the acceleration a of moving objects over ground,
                        the distance r in the key frame of the growth in the images

a lasts for about a second. Drivers brake and speed up for a second or two at a time: the change of
speed over four seconds is larger than that of a random walk that has the right changes over one
(Singer, Estimating optimal tracking filter performance for manned maneuvering targets, IEEE TAES
1970):

    F = [1 dt f 0; 0 1 g 0; 0 0 e 0; 0 0 0 1]      e = exp(-dt / tau), g = tau (1 - e), f = tau (dt - g)
    Q_dd, Q_dv, Q_vv = q dt^3/3, q dt^2/2, q dt    q: density of the noise of v
    Q_vv, Q_va += j dt^3/3, j dt^2/2               j = 2 sigma_a^2 / tau
    Q_aa = sigma_a^2 (1 - e^2)

r starts as a copy of d, with its covariances (stochastic cloning, Roumeliotis and Burdick, ICRA
2002), so that the noise of the distance in the key frame is not counted twice.
"""

import math

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.filtering.own_acceleration import MANOEUVRE_S

N_STATES = 4


class TargetStates:
    """States of the filters of M methods, G models and N tracks, and the steps of a Kalman filter,
    which change them in place.

    The array `table` (4, 5, M, G, N) is [P x]: a row has the covariances of one state with all
    four, and its mean. So one sum of rows multiplies P and x by F, and one product of a column and
    a row corrects both. All attributes are views of it.
    """

    __slots__ = ("P", "P_dd", "a", "d", "r", "table", "v", "x")

    def __init__(self, table: FloatArray) -> None:
        """The states in `table`, which is not copied."""
        self.table = table
        self.P, self.x = table[:, :4], table[:, 4]
        # d in m, NaN = new or expired; v in m/s, negative = closing; a in m/s^2, positive = drawing
        # away, 0 for static models; r in m, NaN = there is no key frame
        self.d, self.v, self.a, self.r = self.x
        self.P_dd = self.P[0, 0]

    @property
    def motion(self) -> ConstantVelocity:
        """Distances and rates with their covariances."""
        (P_dd, P_dv), (_, P_vv) = self.P[0, :2], self.P[1, :2]
        return ConstantVelocity(self.d, self.v, P_dd, P_dv, P_vv)

    def predict(self, dt: FloatArray, *, q: FloatArray, sigma_mps2: FloatArray) -> None:
        """The states after dt (N,): x' = F x, P' = F P F' + Q; `q` and `sigma_mps2`, sigma_a, are
        (G, N).
        """
        steps_s = dt.tolist()
        if len(set(steps_s)) == 1:
            self._predict(steps_s[0], q, sigma_mps2)
            return
        for step_s in set(steps_s):  # of new tracks, and of those that were absent
            tracks = (dt == step_s).nonzero()[0]
            states = TargetStates(self.table[..., tracks])
            states._predict(step_s, q[:, tracks], sigma_mps2[:, tracks])
            self.table[..., tracks] = states.table

    def _predict(self, dt: float, q: FloatArray, sigma_mps2: FloatArray) -> None:
        """The states of tracks with the same dt."""
        e = math.exp(-dt / MANOEUVRE_S)
        g = MANOEUVRE_S * (1.0 - e)
        f = MANOEUVRE_S * (dt - g)
        F = np.array([[1.0, dt, f], [0.0, 1.0, g], [0.0, 0.0, e]])  # r does not change
        rows, columns, P = self.table[:3], self.P[:, :3], self.P
        rows[...] = (F @ rows.reshape(3, -1)).reshape(rows.shape)
        columns[...] = (F @ columns.reshape(4, 3, -1)).reshape(columns.shape)
        half, third, variance = dt * dt / 2, dt * dt * dt / 3, sigma_mps2 * sigma_mps2
        jerk = (2.0 / MANOEUVRE_S) * variance
        P[0, 0] += q * third
        P[0, 1] += q * half
        P[1, 1] += q * dt + jerk * third
        P[1, 2] += jerk * half
        P[2, 2] += variance * (1.0 - e * e)
        for i in range(3):  # rounding errors that are not symmetric would grow
            P[i + 1 :, i] = P[i, i + 1 :]

    def add_input(self, dt: FloatArray, change_mps: FloatArray, variance: FloatArray) -> None:
        """Change the speed of the camera by dV: x' = x + B dV, P' = P + B B' var(dV), with B =
        [-dt/2 -1 0 0]'.
        """
        half, P = dt / 2, self.P
        d, v, _, _ = self.x
        d -= half * change_mps
        v -= change_mps
        of_both = half * variance
        P[0, 0] += half * of_both
        P[0, 1] += of_both
        P[1, 0] += of_both
        P[1, 1] += variance

    def motion_of(self, tracks: IntArray) -> ConstantVelocity:
        """A copy of d and v with their covariance of some tracks, columns of the states."""
        d, v = self.table[:2][..., tracks]
        return ConstantVelocity(d[4], v[4], d[0], d[1], v[1])

    def add_motion(self, motion: ConstantVelocity, tracks: IntArray) -> None:
        """Add means and covariances of d and v for some tracks, columns of the states."""
        added = np.zeros((2, *self.table.shape[1:-1], len(tracks)))
        d, v = added
        d[0], d[1], d[4] = motion.P_xx, motion.P_xv, motion.x
        v[0], v[1], v[4] = motion.P_xv, motion.P_vv, motion.v
        self.table[:2][..., tracks] += added

    def scale(self, factor: FloatArray) -> None:
        """Multiply all lengths by a factor."""
        self.x[...] *= factor
        self.P[...] *= factor * factor

    def step(self, variance: FloatArray) -> None:
        """Add a relative step of both distances, of this variance of d: P' = P + h h' var with h =
        [1 0 0 r/d]'.
        """
        c = np.fmax(self.r / self.d, 0.0)  # 0 without a key frame
        of_both = c * variance
        self.P[0, 0] += variance
        self.P[0, 3] += of_both
        self.P[3, 0] += of_both
        self.P[3, 3] += c * of_both

    def correct_by_distance(self, nu: FloatArray, weight: FloatArray) -> None:
        """Correct by innovations nu of d with the weight 1 / S; 0 = not measured."""
        self._correct(self.table[0].copy(), nu, weight)

    def correct_by_difference(self, c: FloatArray, nu: FloatArray, weight: FloatArray) -> None:
        """Correct by innovations nu of c r - d with the weight 1 / S; 0 = not measured."""
        self._correct(c * self.table[3] - self.table[0], nu, weight)

    def _correct(self, row: FloatArray, nu: FloatArray, weight: FloatArray) -> None:
        """X' = x + K nu, P' = P - K S K', with K = P H' / S and P H' in the first four of `row`."""
        row[4] = -nu
        self.table -= row[:4, None] * row * weight

    def forget_distance(self, where: BoolArray) -> None:
        """Make d and v NaN."""
        np.copyto(self.x[:2], np.nan, where=where)

    def forget_key(self, where: BoolArray) -> None:
        """Leave the key frames."""
        np.copyto(self.r, np.nan, where=where)

    def start_key(self, where: BoolArray) -> None:
        """Make this frame the key frame: r is a copy of d."""
        row = self.table[0].copy()
        row[:4][np.isnan(row[:4])] = 0.0
        np.copyto(self.table[3], row, where=where)
        np.copyto(self.P[:, 3], row[[0, 1, 2, 0]], where=where)

    def start(
        self,
        where: BoolArray,
        motion: ConstantVelocity,
        acceleration_variance: FloatArray,
    ) -> None:
        """Start with these uncorrelated d and v, with a = 0, and without a key frame."""
        new = np.zeros(self.table.shape)
        x = new[:, 4]
        x[0], x[1], x[2], x[3] = motion.x, motion.v, 0.0, np.nan
        new[0, 0], new[1, 1], new[2, 2] = motion.P_xx, motion.P_vv, acceleration_variance
        np.copyto(self.table, new, where=where)
