"""Lens models: central projections from directions to the normalised image plane, which a camera
matrix maps to pixels.

X = (x, y, z)  --distort-->  m = (m_x, m_y),    u = f_x m_x + c_x,    v = f_y m_y + c_y
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from track_range.foundation.arrays import FloatArray

# names of the default, and of OpenCV's fisheye model
PINHOLE, KANNALA_BRANDT = "pinhole", "kannala-brandt"


class KalibrModel(NamedTuple):
    """A lens in Kalibr's files: the first of its coefficients are `intrinsics` before fu, the
    others are `distortion_coeffs`.
    """

    camera: str  # camera_model
    distortion: str  # distortion_model; "none" = the others are 0
    n_intrinsics: int = 0
    n_distortion: int | None = None  # numbers of the others; None = as many as the lens has

    @property
    def names(self) -> tuple[str, str]:
        """Its camera_model and distortion_model."""
        return self.camera, self.distortion


@dataclass(frozen=True, slots=True)
class Lens:
    """One lens model; its name in rig.yaml is that in `LENSES`."""

    # names of its coefficients, in the order in which they are given to the functions
    coefficients: tuple[str, ...]
    # (N, 2) points of the normalised image plane of directions (N, 3) of any length, in the
    # camera's frame; NaN for directions that the lens does not image
    distort: Callable[[FloatArray, Sequence[float]], FloatArray]
    # (N, 3) unit directions of points (N, 2) of the normalised image plane; NaN outside the image
    # circle
    undistort: Callable[[FloatArray, Sequence[float]], FloatArray]
    # whether the lens can image directions behind z = 0; False = OpenCV's distortion of a pinhole,
    # whose undistorted images have the same camera matrix
    is_wide: bool = True
    kalibr: tuple[KalibrModel, ...] = ()  # its names in Kalibr's files
