"""StereoRig: two cameras and the motion between them.

left o-----------o right        right_from_left moves a point given in the left camera's frame into the right's;
     |  baseline |              for a rectified pair it is a shift by (-baseline_m, 0, 0), and a point at depth z
     v z         v z            has the disparity d_px = x_left - x_right = fx baseline_m / z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import UserError
from track_range.stereo.geometry.camera import PinholeCamera


class RigError(UserError):
    """A rig or calibration file that cannot be used; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class StereoRig:
    """A calibrated pair of cameras.

    Example:
        >>> import numpy as np, track_range as tr
        >>> camera = tr.PinholeCamera(700.0, 700.0, 320.0, 180.0, width_px=640, height_px=360)
        >>> rig = tr.StereoRig.rectified(camera, baseline_m=0.5)
        >>> rig.distance_m(np.array([17.5])).tolist()
        [20.0]

    Attributes:
        left: the left camera; its frame is the one that all distances are given in.
        right: the right camera.
        right_from_left: (4, 4) rigid motion, metres.
    """

    left: PinholeCamera
    right: PinholeCamera
    right_from_left: FloatArray

    def __post_init__(self) -> None:
        if self.right_from_left.shape != (4, 4):
            raise ValueError(f"right_from_left: shape (4, 4) wanted, {self.right_from_left.shape} got")

    @classmethod
    def rectified(cls, camera: PinholeCamera, baseline_m: float) -> StereoRig:
        """Two equal, parallel, undistorted cameras side by side."""
        right_from_left = np.eye(4)
        right_from_left[0, 3] = -baseline_m
        return cls(camera, camera, right_from_left)

    @property
    def baseline_m(self) -> float:
        """Distance between the two eyes, negative when the right camera stands left of the left one."""
        translation = self.right_from_left[:3, 3]
        return float(np.copysign(np.linalg.norm(translation), -translation[0]))

    @property
    def is_rectified(self) -> bool:
        """Whether pixels of one row in the left image already lie in the same row of the right one."""
        shift_only = np.eye(4)
        shift_only[0, 3] = self.right_from_left[0, 3]
        cameras_equal = np.allclose(self.left.matrix, self.right.matrix, atol=1e-6)
        straight = not (self.left.is_distorted or self.right.is_distorted)
        return straight and cameras_equal and np.allclose(self.right_from_left, shift_only, atol=1e-9)

    def distance_m(self, disparity_px: FloatArray) -> FloatArray:
        """(N,) depth z of each disparity of the rectified pair; NaN where it is not positive."""
        positive = np.where(disparity_px > 0, disparity_px, np.nan)
        return np.asarray(self.left.fx_px * self.baseline_m / positive)
