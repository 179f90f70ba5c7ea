"""The unified lens of Mei and Rives."""

from collections.abc import Sequence

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.lenses import pinhole
from track_range.stereo.lenses.lens import KalibrModel, Lens


def _distort(xyz: FloatArray, coefficients: Sequence[float]) -> FloatArray:
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
    return pinhole.distort(on_plane, radtan)


def _undistort(m: FloatArray, coefficients: Sequence[float]) -> FloatArray:
    xi, *radtan = coefficients
    ideal = pinhole.undistort(m, radtan)
    x, y = (ideal[:, :2] / ideal[:, 2:]).T
    squared = x**2 + y**2
    with np.errstate(invalid="ignore"):  # outside the image circle the root is of a negative number
        scale = (xi + np.sqrt(1 + (1 - xi**2) * squared)) / (squared + 1)
    return np.stack([scale * x, scale * y, scale - xi], axis=1)


LENS = Lens(
    ("xi", "k1", "k2", "p1", "p2"),
    _distort,
    _undistort,
    kalibr=(
        KalibrModel("omni", "radtan", n_intrinsics=1),
        KalibrModel("omni", "none", n_intrinsics=1),
    ),
)
