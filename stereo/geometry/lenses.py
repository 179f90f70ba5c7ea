"""Lens models: central projections from directions to the normalised image plane, which a camera
matrix maps to pixels.

X = (x, y, z)  --distort-->  m = (m_x, m_y),    u = f_x m_x + c_x,    v = f_y m_y + c_y

A new model is a `Lens` and a member of `LENSES`.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray

# Stop criteria of the iterative inversion of OpenCV's distortion: number of iterations and error.
_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-12)
# number of steps of the table in which a polynomial is inverted; Newton's method refines the result
_N_STEPS = 4096
# number of Newton steps; the table is within 1e-3 rad, and each step squares the error
_N_NEWTON = 3


@dataclass(frozen=True, slots=True)
class Lens:
    """One lens model."""

    # names of its coefficients, in the order in which they are given to the functions
    coefficients: tuple[str, ...]
    # (N, 2) points of the normalised image plane of directions (N, 3) of any length, in the
    # camera's frame; NaN for directions that the lens does not image
    distort: Callable[[FloatArray, Sequence[float]], FloatArray]
    # (N, 3) unit directions of points (N, 2) of the normalised image plane; NaN outside the image
    # circle
    undistort: Callable[[FloatArray, Sequence[float]], FloatArray]
    is_wide: bool = True  # whether the lens can image directions behind z = 0


def _pinhole_distort(xyz: FloatArray, coefficients: Sequence[float]) -> FloatArray:
    """OpenCV's radial and tangential terms, Kalibr's `radtan`, with 0, 4, 5, 8, 12 or 14 coefficients.

    a = x / z,  b = y / z,  r^2 = a^2 + b^2
    m = (a, b) (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) + tangential (p1, p2), thin prism, tilt

    (docs.opencv.org, calib3d: k1 k2 p1 p2 k3 k4 k5 k6 s1 .. s4 tau_x tau_y.)
    """
    is_seen = xyz[:, 2] > 0
    points = np.where(is_seen[:, None], xyz, (0.0, 0.0, 1.0))
    if not len(points):
        return np.zeros((0, 2))
    known = np.array(coefficients or (0.0,) * 4)  # OpenCV takes four or more
    m = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), known)[0].reshape(-1, 2)
    return np.where(is_seen[:, None], m, np.nan)


def _pinhole_undistort(m: FloatArray, coefficients: Sequence[float]) -> FloatArray:
    if not len(m):
        return np.zeros((0, 3))
    source = np.ascontiguousarray(m, np.float64).reshape(-1, 1, 2)
    known = np.array(coefficients or (0.0,) * 4)
    ideal = cv2.undistortPoints(source, np.eye(3), known, criteria=_CRITERIA).reshape(-1, 2)
    rays = np.concatenate([ideal, np.ones((len(ideal), 1))], axis=1)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


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


def _fisheye_distort(xyz: FloatArray, k: Sequence[float]) -> FloatArray:
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


def _fisheye_undistort(m: FloatArray, k: Sequence[float]) -> FloatArray:
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


def _double_sphere_distort(xyz: FloatArray, coefficients: Sequence[float]) -> FloatArray:
    """Double sphere lens, Kalibr's `ds`: projection through the centres of two unit spheres that
    are xi apart.

    d1 = |X|,    d2 = sqrt(x^2 + y^2 + (xi d1 + z)^2)
    m  = (x, y) / (alpha d2 + (1 - alpha) (xi d1 + z))

    (Usenko, Demmel and Cremers 2018: The Double Sphere Camera Model, equations 40 to 52.)
    """
    xi, alpha = coefficients
    x, y, z = np.asarray(xyz, np.float64).T
    d1 = np.sqrt(x**2 + y**2 + z**2)
    shifted = xi * d1 + z
    d2 = np.sqrt(x**2 + y**2 + shifted**2)
    w1 = alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha
    w2 = (w1 + xi) / np.sqrt(2 * w1 * xi + xi**2 + 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.where(z > -w2 * d1, 1 / (alpha * d2 + (1 - alpha) * shifted), np.nan)
    return np.asarray(np.stack([x, y], axis=1) * scale[:, None])


def _double_sphere_undistort(m: FloatArray, coefficients: Sequence[float]) -> FloatArray:
    xi, alpha = coefficients
    squared = (m**2).sum(axis=1)
    # outside the image circle the roots are of negative numbers
    with np.errstate(invalid="ignore"):
        m_z = (1 - alpha**2 * squared) / (
            alpha * np.sqrt(1 - (2 * alpha - 1) * squared) + 1 - alpha
        )
        scale = (m_z * xi + np.sqrt(m_z**2 + (1 - xi**2) * squared)) / (m_z**2 + squared)
    return np.stack([scale * m[:, 0], scale * m[:, 1], scale * m_z - xi], axis=1)


def _unified_distort(xyz: FloatArray, coefficients: Sequence[float]) -> FloatArray:
    """Unified lens with radial and tangential distortion: Kalibr's `omni` with `radtan`, OpenCV's
    omnidir.

    m' = (x, y) / (z + xi |X|),    m = m' distorted by k1 k2 p1 p2

    (Mei and Rives 2007: Single View Point Omnidirectional Camera Calibration from Planar Grids.)
    """
    xi, *radtan = coefficients
    length = np.linalg.norm(xyz, axis=1)
    lowest_z = -length * (xi if xi <= 1 else 1 / xi)
    depth = xyz[:, 2] + xi * length
    is_seen = (xyz[:, 2] > lowest_z) & (depth > 0)
    on_plane = np.stack([xyz[:, 0], xyz[:, 1], np.where(is_seen, depth, -1.0)], axis=1)
    return _pinhole_distort(on_plane, radtan)


def _unified_undistort(m: FloatArray, coefficients: Sequence[float]) -> FloatArray:
    xi, *radtan = coefficients
    ideal = _pinhole_undistort(m, radtan)
    x, y = (ideal[:, :2] / ideal[:, 2:]).T
    squared = x**2 + y**2
    with np.errstate(invalid="ignore"):  # outside the image circle the root is of a negative number
        scale = (xi + np.sqrt(1 + (1 - xi**2) * squared)) / (squared + 1)
    return np.stack([scale * x, scale * y, scale - xi], axis=1)


# names of the default, and of OpenCV's fisheye model
PINHOLE, KANNALA_BRANDT = "pinhole", "kannala-brandt"
LENSES: dict[str, Lens] = {  # the lens models by their names in rig.yaml
    PINHOLE: Lens(
        ("k1", "k2", "p1", "p2", "..."), _pinhole_distort, _pinhole_undistort, is_wide=False
    ),
    KANNALA_BRANDT: Lens(("k1", "k2", "k3", "k4"), _fisheye_distort, _fisheye_undistort),
    "double-sphere": Lens(("xi", "alpha"), _double_sphere_distort, _double_sphere_undistort),
    "omni": Lens(("xi", "k1", "k2", "p1", "p2"), _unified_distort, _unified_undistort),
}
