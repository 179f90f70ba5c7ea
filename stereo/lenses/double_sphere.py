"""Usenko's double sphere lens."""

from collections.abc import Sequence

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.lenses.lens import KalibrModel, Lens


def _distort(xyz: FloatArray, coefficients: Sequence[float]) -> FloatArray:
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


def _undistort(m: FloatArray, coefficients: Sequence[float]) -> FloatArray:
    xi, alpha = coefficients
    squared = (m**2).sum(axis=1)
    # outside the image circle the roots are of negative numbers
    with np.errstate(invalid="ignore"):
        m_z = (1 - alpha**2 * squared) / (
            alpha * np.sqrt(1 - (2 * alpha - 1) * squared) + 1 - alpha
        )
        scale = (m_z * xi + np.sqrt(m_z**2 + (1 - xi**2) * squared)) / (m_z**2 + squared)
    return np.stack([scale * m[:, 0], scale * m[:, 1], scale * m_z - xi], axis=1)


LENS = Lens(
    ("xi", "alpha"), _distort, _undistort, kalibr=(KalibrModel("ds", "none", n_intrinsics=2),)
)
