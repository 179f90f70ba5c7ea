"""StereoRig: two cameras and their relative pose.

left o-----------o right        right_from_left transforms points from the left camera's frame to the right's;
     |  baseline |              in a rectified pair it is a translation by (-baseline_m, 0, 0), and a point at depth z
     v z         v z            has the disparity d_px = x_left - x_right = fx baseline_m / z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, check_shape
from track_range.foundation.errors import UserError
from track_range.stereo.geometry.alignment import UNCALIBRATED_SIGMA_PX, Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame


class RigError(UserError):
    """A rig or calibration file that cannot be used; the message gives the reason and what to
    do.
    """


def rigid_motion(rotation: npt.ArrayLike, translation: npt.ArrayLike) -> FloatArray:
    """(4, 4) transform x -> R x + t of a (3, 3) rotation R and a translation t of 3 numbers, in any
    unit.
    """
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotation, np.ravel(translation)
    return motion


def inverse_motion(motion: FloatArray) -> FloatArray:
    """(4, 4) inverse of a rigid transform by its transpose, even if a file states the rotation with
    few digits.
    """
    return rigid_motion(motion[:3, :3].T, -motion[:3, :3].T @ motion[:3, 3])


@dataclass(frozen=True, slots=True)
class StereoRig:
    """A calibrated pair of cameras.

    Example:
        >>> import numpy as np, track_range as tr
        >>> camera = tr.PinholeCamera(700.0, 700.0, 320.0, 180.0, width_px=640, height_px=360)
        >>> rig = tr.StereoRig.rectified(camera, baseline_m=0.5)
        >>> rig.distance_m(np.array([17.5])).tolist()
        [20.0]
    """

    left: PinholeCamera  # the left camera; all distances are in its frame
    right: PinholeCamera  # the right camera
    right_from_left: FloatArray  # (4, 4) rigid transform, metres
    # correction of the disparities of a rectified pair, for frames that hold none; None = unknown
    alignment: Alignment | None = None
    # of a calibration with a board, which every sigma contains; None = unknown
    accuracy: RigAccuracy | None = None
    # standard deviation of the logarithm of a baseline that is only assumed; 0 = it is calibrated
    baseline_sigma: float = 0.0

    def __post_init__(self) -> None:
        check_shape("right_from_left", self.right_from_left, (4, 4))

    @classmethod
    def rectified(cls, camera: PinholeCamera, baseline_m: float) -> StereoRig:
        """A rig of two identical, parallel cameras side by side, without distortion."""
        return cls(camera, camera, rigid_motion(np.eye(3), [-baseline_m, 0.0, 0.0]))

    @property
    def baseline_m(self) -> float:
        """Distance between the cameras, metres; negative if the right camera is to the left of the
        left camera.
        """
        translation = self.right_from_left[:3, 3]
        return float(np.copysign(np.linalg.norm(translation), -translation[0]))

    @property
    def is_assumed(self) -> bool:
        """Whether the baseline is only assumed, so that a drive has to show the scale."""
        return self.baseline_sigma > 0.0

    @property
    def is_rectified(self) -> bool:
        """Whether corresponding points already have equal rows in both images."""
        translation = rigid_motion(np.eye(3), [self.right_from_left[0, 3], 0.0, 0.0])
        return (
            not (self.left.is_distorted or self.right.is_distorted)
            and self.left.has_square_pixels
            and self.left.size_px == self.right.size_px
            and np.allclose(self.left.matrix, self.right.matrix, atol=1e-6)
            and np.allclose(self.right_from_left, translation, atol=1e-9)
        )

    @property
    def unaligned(self) -> Alignment:
        """What is known of the disparities before an alignment is measured."""
        if not self.is_assumed:
            return Alignment()
        return Alignment(residual_px=UNCALIBRATED_SIGMA_PX, offset_sigma_px=UNCALIBRATED_SIGMA_PX)

    def alignment_of(self, frame: Frame) -> Alignment:
        """The correction of the disparities of a frame of this pair; without any, their sigma is that
        of a pair that was not aligned.
        """
        return frame.alignment or self.alignment or self.unaligned

    def distance_m(self, disparity_px: FloatArray) -> FloatArray:
        """(N,) depth z, metres, of disparities (N,) of the rectified pair; NaN for disparities <=
        0.
        """
        positive = np.where(disparity_px > 0, disparity_px, np.nan)
        return np.asarray(self.left.fx_px * self.baseline_m / positive)


@dataclass(frozen=True, slots=True, kw_only=True)
class RigAccuracy:
    """Relative standard deviations of a calibration with a board; the names of the attributes are
    keys of rig.yaml.
    """

    focal_sigma: float  # of the focal length, of a pair of the left camera's
    # of the scale of distances: of focal length times baseline, of one camera of the focal length
    scale_sigma: float

    @property
    def sentence(self) -> str:
        """Message for the user on the accuracy of the calibration."""
        return (
            "Calibrated with a board: the focal length is known within "
            f"{100 * self.focal_sigma:.2g} %, the scale of distances within "
            f"{100 * self.scale_sigma:.2g} %, which is part of the sigma of every distance."
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadCalibration:
    """Results of a calibration from the road; the names of the attributes are keys of rig.yaml."""

    focal_sigma: float  # relative standard deviation of the focal length
    camera_height_m: float  # height of the camera above the road
    camera_height_sigma_m: float  # its standard deviation
    pitch_deg: float  # angle of the camera's axis below the horizon
    pitch_sigma_deg: float  # its standard deviation
    # standard deviation of the first radial coefficient; None = no distortion was estimated
    k1_sigma: float | None = None

    @property
    def sentence(self) -> str:
        """Message for the user on the focal length, height and pitch, with their standard
        deviations.
        """
        height, pitch = self.camera_height_m, self.pitch_deg
        return (
            "Calibrated on the road: the focal length is known within "
            f"{100 * self.focal_sigma:.1f} %, which is part of the sigma of every distance; camera "
            f"height {height:.2f} ± {self.camera_height_sigma_m:.2f} m, pitch {pitch:+.1f} ± "
            f"{self.pitch_sigma_deg:.1f} degrees (positive = down)."
        )
