r"""RoadHorizon: horizon, roll and vertical curvature of the road ahead of one camera, from its
motion, frame by frame.

    row(Z) = y + h / Z - k(Z) Z / 2        tangent, below the camera's axis, of the road at distance Z

y is the horizon, the vanishing line of the road under the car; h the height of the camera; k the
curvature of the road in the vertical plane, positive where it turns upwards. A Kalman filter has
the state

    x = [y, m, k, g, r, q]  m: mean of y over the drive (mounting, load); g: error of the measured rotation per frame
                            r: roll; q: its mean over the drive

    y' = y + (pitch - g) - k V dt       the camera turns with the road, its horizon only with the pitch of the car
    k' = k exp(-V dt / l)               a random road with standard deviation and correlation length of its curvature

A car pitches on its springs about its mean, so y - m is near 0. Measurements of y are the direction
of travel, since a car drives parallel to the road, and the slope of the shifts of near and distant
strips of the road (`GroundOdometry`): it belongs to the road Z ahead, whose horizon is y - k Z / 2.
The height of a curved road at Z is a mean of the curvatures on the way with their centre at Z / 3,
so k(Z) = k exp(-Z / 3l).

All of it is in the axes of travel (right, down, forward), which are the camera's if it looks ahead.
A camera that looks aside sees the roll as its own pitch, and the strips beside the lane measure it.

Lengths are in units of the height that the speeds were measured with: if it is wrong by a factor,
so is 1 / k.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from track_range.foundation.arrays import FloatArray

# standard deviation of the mean angle between the camera's axis and the road at the start
_MOUNTING_RAD = 0.03
# its random walk, rad per square root of a second: load, long phases of braking
_MOUNTING_DRIFT_RAD = 0.0005
# standard deviation of a car's pitch on its springs, and its correlation time
_SPRINGS_RAD, _SPRINGS_S = 0.0025, 0.3
# Errors of the pitch between two frames, independent and constant: 0.15 and 0.08 px at KITTI's
# focal length on simulated drives, seeds 0-2.
_ROTATION_RAD, _ROTATION_BIAS_RAD = 0.0002, 0.00012
_LOST_RAD = 0.003  # standard deviation of the pitch between two frames if it is not measured
# standard deviation of the vertical curvature (radii of 3 km are usual on roads)
_CURVATURE_PER_M = 0.0003
_CURVATURE_LENGTH_M = 80.0  # its correlation length
# time constant to roll 0: errors of the measured rotation add up to more than a car rolls
_ROLL_S = 0.5
# standard deviation of a car's roll against the lanes beside it, by springs and crowns of roads
_ROLL_RAD = 0.01
_Y, _K, _R, _Q = 0, 2, 4, 5  # indices of y, k, r and q in the state
_SPRINGS = np.array([1.0, -1.0, 0.0, 0.0, 0.0, 0.0])  # y - m


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadView:
    """The road as the camera sees it in one frame; angles are tangents in the image."""

    horizon: float  # tangent of the horizon below the camera's axis, at the middle column
    horizon_variance: float  # its variance
    slope: float = 0.0  # slope of the horizon in the image, positive = lower on the right-hand side
    # x and z, in the camera's axes, of the direction across the road to the right
    across: tuple[float, float] = (1.0, 0.0)
    # curvature k in the vertical plane below the camera, positive = turns upwards
    curvature_per_m: float = 0.0
    curvature_variance: float = 0.0  # variance of k
    covariance: float = 0.0  # covariance of the horizon and k
    # height of the camera and its standard deviation, if it was measured; None = not
    height_m: tuple[float, float] | None = None

    def scaled(self, factor: float) -> RoadView:
        """The road if all lengths are `factor` times as long."""
        return replace(
            self,
            curvature_per_m=self.curvature_per_m / factor,
            curvature_variance=self.curvature_variance / factor**2,
            covariance=self.covariance / factor,
        )


def curvature_fraction(distance_m: FloatArray) -> FloatArray:
    """Fraction of the curvature at the camera, (...), in the mean curvature up to distances (...):
    exp(-Z / 3l).
    """
    return np.asarray(np.exp(distance_m / (-3.0 * _CURVATURE_LENGTH_M)))


def unknown_curvature_variance(distance_m: FloatArray) -> FloatArray:
    """Variance of the mean curvature (...) up to distances (...) that the curvature at the camera
    does not show.
    """
    return np.asarray(_CURVATURE_PER_M**2 * (1.0 - curvature_fraction(distance_m) ** 2))


class RoadHorizon:
    """Kalman filter of the horizon; the state belongs to the instance."""

    def __init__(self) -> None:
        self._x = np.zeros(6)
        mounting, springs, roll = _MOUNTING_RAD**2, _SPRINGS_RAD**2, _ROLL_RAD**2
        bias = _ROTATION_BIAS_RAD**2
        self._P = np.diag(
            [mounting + springs, mounting, _CURVATURE_PER_M**2, bias, mounting + roll, mounting]
        )
        self._P[0, 1] = self._P[1, 0] = self._P[_R, _Q] = self._P[_Q, _R] = mounting

    @property
    def view(self) -> RoadView:
        """The road in the last frame, in the axes of travel."""
        y, _, k, _, roll, _ = self._x.tolist()
        P = self._P
        return RoadView(
            horizon=y,
            horizon_variance=float(P[_Y, _Y]),
            slope=-roll,
            curvature_per_m=k,
            curvature_variance=float(P[_K, _K]),
            covariance=float(P[_Y, _K]),
        )

    def seen(self, travel_from_camera: FloatArray, since_s: float = 0.0) -> RoadView:
        """The road in the axes of a camera, from which the rotation (3, 3) leads to the axes of
        travel, `since_s` after the last frame: the camera pitches and rolls on the springs.
        """
        right, down, forward = travel_from_camera.tolist()
        y, roll = float(self._x[_Y]), float(self._x[_R])
        # normal n of the road, and the horizon: n . (x, horizon + slope x, 1) = 0
        n_x, n_y, n_z = (d - y * f + roll * r for r, d, f in zip(right, down, forward, strict=True))
        horizon, slope = -n_z / n_y, -n_x / n_y
        # derivatives of the horizon by y and r
        by_y = (forward[1] * horizon + forward[2]) / n_y
        by_roll = -(right[1] * horizon + right[2]) / n_y
        along = forward[2] ** 2  # curvature along the axis
        P = self._P.tolist()
        # a random process of this variance and correlation time moves by so much
        pitched = 2.0 * _SPRINGS_RAD**2 * (1.0 - math.exp(-since_s / _SPRINGS_S))
        rolled = 2.0 * _ROLL_RAD**2 * (1.0 - math.exp(-since_s / _ROLL_S))
        return RoadView(
            horizon=horizon,
            horizon_variance=by_y**2 * (P[_Y][_Y] + pitched)
            + 2 * by_y * by_roll * P[_Y][_R]
            + by_roll**2 * (P[_R][_R] + rolled),
            slope=slope,
            across=(right[0], right[2]),
            curvature_per_m=along * float(self._x[_K]),
            curvature_variance=along**2 * P[_K][_K],
            covariance=along * (by_y * P[_Y][_K] + by_roll * P[_R][_K]),
        )

    def predict(
        self, dt_s: float, *, pitch_rad: float, roll_rad: float, travelled_m: float
    ) -> None:
        """Move on to the next frame, with pitch (positive = upwards), roll (clockwise) and distance
        since the last one.

        NaN = unknown.
        """
        is_known = math.isfinite(pitch_rad)
        travelled_m = abs(travelled_m) if math.isfinite(travelled_m) else 0.0
        stays = math.exp(-travelled_m / _CURVATURE_LENGTH_M)
        stays_rolled = math.exp(-dt_s / _ROLL_S)
        F = np.eye(6)
        F[0, 2:4] = (-travelled_m, -1.0) if is_known else 0.0
        F[_K, _K] = stays
        F[_R, _R:] = stays_rolled, 1.0 - stays_rolled
        pitch_noise = (_ROTATION_RAD if is_known else _LOST_RAD) ** 2
        drift = _MOUNTING_DRIFT_RAD**2 * dt_s
        curvature_noise = _CURVATURE_PER_M**2 * (1 - stays**2)
        roll_noise = _ROLL_RAD**2 * (1 - stays_rolled**2)
        self._x = F @ self._x
        self._P = F @ self._P @ F.T
        self._P.flat[::7] += pitch_noise, drift, curvature_noise, 0.0, roll_noise, drift
        if is_known:
            self._x[_Y] += pitch_rad
        if math.isfinite(roll_rad):
            self._x[_R] += stays_rolled * roll_rad
        frames_per_pitch = max(2 * _SPRINGS_S / dt_s, 1.0)
        self._update(_SPRINGS, 0.0, _SPRINGS_RAD**2 * frames_per_pitch)

    def measure(
        self,
        horizon: float,
        variance: float,
        *,
        ahead_m: float = 0.0,
        frames: float = 0.0,
        by_roll: float = 0.0,
        max_sigma: float = math.inf,
    ) -> bool:
        """Add a measurement of the horizon, as a tangent, and its variance; False = not added, an
        outlier.

        The road was seen to `ahead_m`: the measurement is y - k ahead / 2. `frames` is its error
        per constant error of the rotation between two frames, `by_roll` per error of the roll,
        `max_sigma` the largest innovation, in standard deviations.
        """
        h = np.array([1.0, 0.0, -ahead_m / 2, frames, by_roll, 0.0])
        return self._update(h, horizon, variance, max_sigma)

    @property
    def roll_variance(self) -> float:
        """Variance of the roll."""
        return float(self._P[_R, _R])

    def measure_roll(self, roll: float, variance: float, *, max_sigma: float = math.inf) -> bool:
        """Add a measurement of the roll, as a tangent, and its variance; False = not added, an
        outlier.
        """
        return self._update(np.eye(6)[_R], roll, variance, max_sigma)

    def _update(self, h: FloatArray, z: float, R: float, max_sigma: float = math.inf) -> bool:
        Ph = self._P @ h
        S, innovation = float(h @ Ph) + R, z - float(h @ self._x)
        if abs(innovation) > max_sigma * math.sqrt(S):
            return False
        self._x = self._x + Ph * (innovation / S)
        self._P = self._P - Ph[:, None] * (Ph / S)
        return True
