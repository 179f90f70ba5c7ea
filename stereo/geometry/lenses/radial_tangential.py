"""OpenCV's distortion of a pinhole: radial and tangential terms, Kalibr's `radtan`.

    a = x / z,  b = y / z,  r^2 = a^2 + b^2
    m = (a, b) (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) + tangential (p1, p2), thin prism, tilt

(docs.opencv.org, calib3d, with 0, 4, 5, 8, 12 or 14 coefficients k1 k2 p1 p2 k3 k4 k5 k6 s1 .. s4 tau_x tau_y.)
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.lenses.lens import Lens

_IDENTITY = np.eye(3)
# Stop criteria of the iterative inversion: number of iterations and error.
_CRITERIA = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-12)


def _distort(xyz: FloatArray, coefficients: Sequence[float]) -> FloatArray:
    is_seen = xyz[:, 2] > 0
    points = np.where(is_seen[:, None], xyz, (0.0, 0.0, 1.0))
    if not len(points):
        return np.zeros((0, 2))
    m = cv2.projectPoints(points, np.zeros(3), np.zeros(3), _IDENTITY, _padded(coefficients))[0].reshape(-1, 2)
    return np.where(is_seen[:, None], m, np.nan)


def _undistort(m: FloatArray, coefficients: Sequence[float]) -> FloatArray:
    if not len(m):
        return np.zeros((0, 3))
    source = np.ascontiguousarray(m, np.float64).reshape(-1, 1, 2)
    ideal = cv2.undistortPoints(source, _IDENTITY, _padded(coefficients), criteria=_CRITERIA).reshape(-1, 2)
    rays = np.concatenate([ideal, np.ones((len(ideal), 1))], axis=1)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _padded(coefficients: Sequence[float]) -> FloatArray:
    """The coefficients as OpenCV takes them: none are four zeros."""
    return np.array(coefficients or (0.0,) * 4)


RADIAL_TANGENTIAL = Lens(
    name="pinhole", coefficients=("k1", "k2", "p1", "p2", "..."), distort=_distort, undistort=_undistort, is_wide=False
)
