"""EgoPath: pose of the camera in the world, integrated from its speed and yaw rate, with a growing
covariance.

World frame `map`: origin at the camera in the first frame with a known speed, x along its optical
axis, y to the left, z up; headings are counterclockwise from x (ISO 8855, as in OpenSCENARIO). The
road is taken to be a plane.

    psi' = psi - w dt        [x' y'] = [x y] + R(psi - w dt / 2) [V -U] dt

V is the speed along the axis, U that to the right of it, w the yaw rate (positive = to the right).
The errors of both speeds and the yaw rate have a part that all frames share (scale, bias), whose
effect J on the pose grows with the distance travelled, and a part that decays within a second:

    P' = F P F^T + Q        J' = F J + B        covariance = P + J J^T        F = d pose' / d pose
"""

import math
from dataclasses import dataclass, field

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.odometry.ego_motion import EgoMotion

_UNKNOWN_SPEED_SIGMA = 0.03  # relative standard deviation of a speed without one
# standard deviation of the error of the yaw rate that all frames share; assumed
_YAW_BIAS_RAD_S = 0.0005
YAW_NOISE_RAD_S = 0.005  # that of the other error; assumed
_CORRELATION_S = 1.0  # time over which that error is the same; on KITTI's odometry, up to a second
# lateral acceleration of a vehicle whose yaw rate is unknown, 1 sigma; chosen with the values of the
# collision warning
UNKNOWN_LATERAL_MPS2 = 0.4
_MIN_SPEED_MPS = 2.0  # smallest speed for the yaw rate of that acceleration
_NOISE_S = 0.3  # time over which the errors of measured speeds that are new in each frame last
_GAP_MPS2 = 1.5  # growth of the standard deviation of a speed that is no longer measured


@dataclass(frozen=True, slots=True)
class EgoPose:
    """Pose of the left camera in the frame `map`; NaN = unknown."""

    x_m: float = math.nan
    y_m: float = math.nan
    heading_rad: float = math.nan  # of the optical axis, counterclockwise from x, not wrapped
    # of x, y and heading
    covariance: FloatArray = field(default_factory=lambda: np.full((3, 3), np.nan))

    @property
    def sigmas(self) -> tuple[float, float, float]:
        """Standard deviations of x and y in m, and of the heading in rad."""
        x, y, heading = np.sqrt(np.diag(self.covariance)).tolist()
        return x, y, heading

    def to_world(self, forward_m: FloatArray, right_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N,) x and y in the frame `map` of points at given distances along and to the right of
        the optical axis.
        """
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return self.x_m + c * forward_m + s * right_m, self.y_m + s * forward_m - c * right_m


class EgoPath:
    """Integrates the motion of the camera, frame by frame.

    A missing speed is replaced by the last frame's speed, with a growing sigma; a missing yaw rate
    is 0, with the sigma of usual lateral accelerations.
    """

    def __init__(self) -> None:
        self._pose = EgoPose()
        self._velocity_mps = math.nan, math.nan
        self._drive = 1.0, 0.0  # parts of the speed along the axis and to its right
        self._P, self._J = np.zeros((3, 3)), np.zeros((3, 3))
        self._time_s = self._known_s = math.nan

    def update(self, time_s: float, motion: EgoMotion) -> EgoPose:
        """The pose at `time_s`, after the motion since the previous frame; unknown before the first
        known speed.
        """
        dt, self._time_s = time_s - self._time_s, time_s
        if math.isfinite(motion.speed_mps):
            self._known_s = time_s
        elif math.isnan(self._known_s):
            return self._pose
        V, U = self._velocity_mps
        if math.isfinite(motion.speed_mps):
            V, U = motion.speed_mps, motion.right_mps
        sigma, sigma_U = motion.speed_sigma_mps, motion.right_sigma_mps
        # at rest, the errors show the direction
        parts = math.hypot(V, sigma), math.hypot(U, sigma_U)
        length = math.hypot(*parts)
        if length > 0:  # False for NaN
            self._drive = parts[0] / length, parts[1] / length
        if not math.isfinite(sigma):
            sigma, sigma_U = _UNKNOWN_SPEED_SIGMA * abs(V), _UNKNOWN_SPEED_SIGMA * abs(U)
        w, sigma_w = motion.yaw_rad_s, YAW_NOISE_RAD_S
        if math.isnan(w):
            w, sigma_w = 0.0, UNKNOWN_LATERAL_MPS2 / max(math.hypot(V, U), _MIN_SPEED_MPS)
        if motion.is_still:
            V = U = sigma = sigma_U = w = sigma_w = 0.0
        self._velocity_mps = V, U
        noise = min(motion.noise_mps, sigma)
        sigma = math.sqrt(sigma**2 - noise**2)
        if math.isnan(self._pose.x_m):
            self._pose = EgoPose(0.0, 0.0, 0.0, np.zeros((3, 3)))
            return self._pose
        # a vehicle accelerates or brakes for seconds
        gap_mps = _GAP_MPS2 * (time_s - self._known_s)
        sigma = math.hypot(sigma, gap_mps * self._drive[0])
        sigma_U = math.hypot(sigma_U, gap_mps * self._drive[1])
        psi = self._pose.heading_rad - w * dt / 2
        c, s = math.cos(psi), math.sin(psi)  # right of the axis is (s, -c)
        dx, dy = (V * c + U * s) * dt, (V * s - U * c) * dt
        F = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
        turn = dy / 2 * dt, -dx / 2 * dt, -dt  # d pose' / d w
        bias = 0.0 if motion.is_still else _YAW_BIAS_RAD_S
        along_m, right_m = sigma * dt, sigma_U * dt
        shared = [
            [c * along_m, s * right_m, turn[0] * bias],
            [s * along_m, -c * right_m, turn[1] * bias],
            [0.0, 0.0, turn[2] * bias],
        ]
        self._J = F @ self._J + shared
        new_m = noise * math.sqrt(_NOISE_S * dt)
        turn_sigma = sigma_w * math.sqrt(max(_CORRELATION_S / dt, 1.0)) if dt > 0 else 0.0
        new = np.array(
            [
                [turn[0] * turn_sigma, c * new_m],
                [turn[1] * turn_sigma, s * new_m],
                [turn[2] * turn_sigma, 0.0],
            ]
        )
        self._P = F @ self._P @ F.T + new @ new.T
        self._pose = EgoPose(
            self._pose.x_m + dx,
            self._pose.y_m + dy,
            self._pose.heading_rad - w * dt,
            self._P + self._J @ self._J.T,
        )
        return self._pose
