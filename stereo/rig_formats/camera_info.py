"""CameraInfo: ROS's calibration of a camera (sensor_msgs/CameraInfo, foxglove.CameraCalibration),
and its rigs.

P = [K' | K' t'],  x' = R x,  t' = (-baseline, 0, 0) for the right camera

x = point in the camera's frame, x' = in its rectified frame. All are of the images of the whole
sensor; images may have a region of it, and pixels that are binned
(http://docs.ros.org/en/api/sensor_msgs/html/msg/CameraInfo.html).
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError, StereoRig, rigid_motion
from track_range.stereo.geometry.rig_checks import NO_VERTICAL_PAIRS
from track_range.stereo.lenses.lens import KANNALA_BRANDT, PINHOLE
from track_range.stereo.rig_formats.values.lens_models import kalibr_names

# largest relative difference of the focal lengths of two rectified cameras
_FOCAL_DIFFERENCE = 0.01
_ROW_DIFFERENCE_PX = 2.0  # largest difference of their principal rows
_COEFFICIENTS = (0, 4, 5, 8, 12, 14)  # numbers of coefficients of OpenCV's model


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """Calibration of one camera."""

    size_px: tuple[int, int]  # (width, height) of images of the whole sensor
    model: str  # name of the distortion model
    distortion: tuple[float, ...]  # its coefficients
    k: FloatArray  # (3, 3) camera matrix
    r: FloatArray  # (3, 3) rotation to the rectified frame
    p: FloatArray  # (3, 4) projection matrix
    # (x, y, width, height) of the part of the sensor that the images show; width 0 = all of it
    region_px: tuple[int, int, int, int] = (0, 0, 0, 0)
    binning: tuple[int, int] = (1, 1)  # pixels of the sensor per pixel of the images

    @property
    def is_fisheye(self) -> bool:
        """Whether the distortion is OpenCV's fisheye model."""
        return kalibr_names(self.model) == ("", "equidistant")

    @property
    def is_of_opencv(self) -> bool:
        """Whether the distortion is OpenCV's radial and tangential one, or not stated."""
        names = kalibr_names(self.model)
        is_of_pinhole = names is not None and names[0] in ("", "pinhole")
        return not self.model or (is_of_pinhole and not self.is_fisheye)

    def of_images(self, size_px: tuple[int, int], source: str) -> "CameraInfo":
        """The calibration of images of this size: those of the region, binned, or of the whole
        sensor, of which the images may be resized. RigError, which names the source: of neither.
        """
        x_px, y_px, *region = self.region_px
        part_px = tuple(region) if region[0] and region[1] else self.size_px
        x_bin, y_bin = (max(count, 1) for count in self.binning)
        binned_px = part_px[0] // x_bin, part_px[1] // y_bin
        if size_px == self.size_px or (part_px == self.size_px and size_px != binned_px):
            return self
        if size_px != binned_px:
            raise RigError(
                f"{source}: expected images of {binned_px[0]}x{binned_px[1]} px, as the region of "
                f"interest and the binning state, or of {self.size_px[0]}x{self.size_px[1]} px, "
                f"the whole sensor, found {size_px[0]}x{size_px[1]}; give --rig or --focal-px."
            )
        # pixel edges map to edges
        scale_x, scale_y = 1 / x_bin, 1 / y_bin
        shift = np.array(
            [
                [scale_x, 0.0, (0.5 - x_px) * scale_x - 0.5],
                [0.0, scale_y, (0.5 - y_px) * scale_y - 0.5],
                [0.0, 0.0, 1.0],
            ]
        )
        return replace(self, size_px=size_px, k=shift @ self.k, p=shift @ self.p)


def camera_of(message: CameraInfo, path: Path, *, is_rectified: bool) -> PinholeCamera:
    """The camera of a message: P for rectified images, else K with distortion; RigError for an
    unknown lens model.
    """
    if is_rectified:
        return PinholeCamera.of_matrix(message.p, message.size_px)
    n_coefficients = len(message.distortion)
    has_distortion = any(message.distortion) or (message.is_fisheye and n_coefficients == 4)
    is_known = n_coefficients == 4 if message.is_fisheye else message.is_of_opencv
    if has_distortion and not (is_known and n_coefficients in _COEFFICIENTS):
        raise RigError(
            f"{path}: expected a distortion model plumb_bob, rational_polynomial or equidistant, "
            f"found {quoted(message.model)} with {n_coefficients} coefficients; use rectified "
            "images, or give a rig.yaml."
        )
    lens = KANNALA_BRANDT if message.is_fisheye else PINHOLE
    return PinholeCamera.of_matrix(
        message.k, message.size_px, message.distortion if has_distortion else (), lens
    )


def rig_of(left: CameraInfo, right: CameraInfo, path: Path, *, is_rectified: bool) -> StereoRig:
    """The rig of two messages; RigError for an unknown lens model, no baseline, or contradicting
    messages.
    """
    if not left.p[0, 0] or not right.p[0, 0]:
        raise RigError(
            f"{path}: expected projection matrices P in both calibrations, found zeros; "
            "give a rig.yaml."
        )
    # the origin of the rectified frames is the left camera in most recordings, another camera in
    # KITTI's
    offset_m = right.p[0, 3] / right.p[0, 0] - left.p[0, 3] / left.p[0, 0]
    if not offset_m:
        if left.p[1, 3] != right.p[1, 3]:
            raise RigError(
                f"{path}: expected cameras side by side, found one above the other (P[0, 3] is 0, "
                f"P[1, 3] is not); {NO_VERTICAL_PAIRS}."
            )
        offset = f"{left.p[0, 3]:.6g} in both matrices P"
        cause = "; both seem to be of the right camera" if left.p[0, 3] else ""
        raise RigError(
            f"{path}: expected a baseline (P[0, 3] = 0 for the left camera and -f B for the right "
            f"one), found {offset}{cause}; calibrate the cameras as a pair, or give a rig.yaml."
        )
    left_focal_px, right_focal_px = (
        (message.p[0, 0], message.p[1, 1]) for message in (left, right)
    )
    left_row_px, right_row_px = left.p[1, 2], right.p[1, 2]
    is_equal = np.allclose(left_focal_px, right_focal_px, rtol=_FOCAL_DIFFERENCE)
    if is_rectified and not (is_equal and abs(left_row_px - right_row_px) <= _ROW_DIFFERENCE_PX):
        raise RigError(
            f"{path}: expected equal focal lengths and principal rows in the matrices P of "
            f"rectified images, found {left_focal_px[0]:.6g} and {right_focal_px[0]:.6g} px, rows "
            f"{left_row_px:.6g} and {right_row_px:.6g}; give a rig.yaml."
        )
    r1, r2 = (np.eye(3), np.eye(3)) if is_rectified else (left.r, right.r)
    cameras = [camera_of(message, path, is_rectified=is_rectified) for message in (left, right)]
    motion = rigid_motion(r2.T @ r1, r2.T @ [offset_m, 0.0, 0.0])
    return StereoRig(cameras[0], cameras[1], motion)


def is_undistorted(message: CameraInfo) -> bool:
    """Whether the message describes rectified images: no distortion, and P equals K."""
    return (
        not any(message.distortion)
        and not message.is_fisheye
        and np.allclose(message.r, np.eye(3))
        and np.allclose(message.p[:, :3], message.k)
    )
