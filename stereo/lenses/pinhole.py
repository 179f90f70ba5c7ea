"""The pinhole with OpenCV's radial and tangential distortion."""

from collections.abc import Sequence

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.lenses.lens import KalibrModel, Lens

# Stop criteria of the iterative inversion of OpenCV's distortion: number of iterations and error.
_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-12)


def distort(xyz: FloatArray, coefficients: Sequence[float]) -> FloatArray:
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


def undistort(m: FloatArray, coefficients: Sequence[float]) -> FloatArray:
    """(N, 3) unit directions of points (N, 2), by iteration."""
    if not len(m):
        return np.zeros((0, 3))
    source = np.ascontiguousarray(m, np.float64).reshape(-1, 1, 2)
    known = np.array(coefficients or (0.0,) * 4)
    ideal = cv2.undistortPoints(source, np.eye(3), known, criteria=_CRITERIA).reshape(-1, 2)
    rays = np.concatenate([ideal, np.ones((len(ideal), 1))], axis=1)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def first_radial(coefficients: Sequence[float]) -> float:
    """Coefficient of r^2 in the series of the radial terms: k1 - k4; 0 without any."""
    k1, *_, k4 = (*coefficients, *(0.0,) * 6)[:6]
    return k1 - k4


LENS = Lens(
    ("k1", "k2", "p1", "p2", "..."),
    distort,
    undistort,
    is_wide=False,
    kalibr=(
        KalibrModel("pinhole", "radtan", n_distortion=4),
        KalibrModel("pinhole", "none", n_distortion=0),
    ),
)
