"""Kannala and Brandt's lens: OpenCV's fisheye model."""

import math
from collections.abc import Sequence

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.lenses.lens import KalibrModel, Lens

# number of steps of the table in which a polynomial is inverted; Newton's method refines the result
_N_STEPS = 4096
# number of Newton steps; the table is within 1e-3 rad, and each step squares the error
_N_NEWTON = 3


def distorted_angle(theta_rad: FloatArray, k: Sequence[float]) -> FloatArray:
    """theta_d of Kannala and Brandt's lens for angles theta from the optical axis, of any shape."""
    squared = theta_rad**2
    k1, k2, k3, k4 = k
    return theta_rad * (1 + squared * (k1 + squared * (k2 + squared * (k3 + squared * k4))))


def largest_angle_rad(k: Sequence[float]) -> float:
    """The angle up to which theta_d increases, at most pi."""
    theta = np.linspace(0.0, math.pi, _N_STEPS + 1)
    falls = np.flatnonzero(_slope(theta, k) <= 0)
    return float(theta[max(falls[0] - 1, 1)]) if len(falls) else math.pi


def _slope(theta_rad: FloatArray, k: Sequence[float]) -> FloatArray:
    """Derivative of theta_d by theta."""
    squared = theta_rad**2
    k1, k2, k3, k4 = k
    return np.asarray(
        1 + squared * (3 * k1 + squared * (5 * k2 + squared * (7 * k3 + squared * 9 * k4)))
    )


def _distort(xyz: FloatArray, k: Sequence[float]) -> FloatArray:
    """Kannala and Brandt's lens: OpenCV's fisheye model, Kalibr's and ROS's equidistant distortion.

    theta   = angle between the direction and the optical axis
    theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)
    m       = theta_d (x, y) / |(x, y)|

    The polynomial is used up to its first maximum, at most to 180 degrees. (Kannala and Brandt
    2006: A Generic Camera Model and Calibration Method, IEEE TPAMI 28(8), equation 6 divided by k1;
    docs.opencv.org, fisheye camera model.)
    """
    x, y, z = np.asarray(xyz, np.float64).T
    r = np.hypot(x, y)
    theta = np.arctan2(r, z)
    theta = np.where(theta <= largest_angle_rad(k), theta, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        # on the axis theta_d / r tends to 1 / z
        scale = np.where(r > 0, distorted_angle(theta, k) / r, np.where(z > 0, 1 / z, np.nan))
    return np.asarray(np.stack([x, y], axis=1) * scale[:, None])


def _undistort(m: FloatArray, k: Sequence[float]) -> FloatArray:
    theta_d = np.hypot(m[:, 0], m[:, 1])
    table = np.linspace(0.0, largest_angle_rad(k), _N_STEPS + 1)
    distorted = distorted_angle(table, k)
    theta = np.interp(theta_d, distorted, table)
    theta = np.where(theta_d <= distorted[-1] * (1 + 1e-9), theta, np.nan)
    for _ in range(_N_NEWTON):
        theta = np.clip(
            theta - (distorted_angle(theta, k) - theta_d) / _slope(theta, k), 0.0, table[-1]
        )
    # sin(theta) / theta_d tends to 1 on the axis
    scale = np.where(theta_d > 0, np.sin(theta) / np.where(theta_d > 0, theta_d, 1.0), 1.0)
    return np.stack([m[:, 0] * scale, m[:, 1] * scale, np.cos(theta)], axis=1)


LENS = Lens(
    ("k1", "k2", "k3", "k4"),
    _distort,
    _undistort,
    kalibr=(KalibrModel("pinhole", "equidistant"),),
)
