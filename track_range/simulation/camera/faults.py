"""Faults of a stereo pair and their effect on the images.

Row and disparity offsets are errors of the right camera's principal point in the rig file. The
scene is rendered with the true principal point, so that the shift is exact. Rain consists of
streaks of drops at distances from 1.5 to 12 m, with the corresponding disparities.
"""

from dataclasses import replace

import cv2
import numpy as np

from track_range.foundation.arrays import Image
from track_range.simulation.camera.fault_options import Faults
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

# of a wrong rig file; shift to the right
BASELINE_FACTOR, FOCAL_FACTOR, PRINCIPAL_PX = 1.05, 1.04, 15.0
DROPS_PER_M3 = 1.2  # density of drops at rain = 1, a cloudburst
# speed of drops and exposure time; together they give streaks of about 10 cm
DROP_SPEED_MPS, EXPOSURE_S = 8.0, 0.012


def right_camera(camera: PinholeCamera, faults: Faults) -> PinholeCamera:
    """The true right camera, for a rig file with the right camera `camera`."""
    cx_px, cy_px = camera.cx_px - faults.disparity_offset_px, camera.cy_px + faults.row_offset_px
    return replace(camera, cx_px=cx_px, cy_px=cy_px)


def with_blur_and_gain(image: Image, faults: Faults, *, is_right: bool) -> Image:
    """The image with blur and, if it is the right image, with gain."""
    if faults.blur_px > 0:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), faults.blur_px), np.uint8)
    if is_right and faults.gain != 1.0:
        image = np.asarray(cv2.convertScaleAbs(image, alpha=faults.gain), np.uint8)
    return image


def kept_frames(faults: Faults, n_frames: int, seed: int, *, is_right: bool) -> list[int]:
    """Numbers of the frames that a camera does not drop; the first frame, from which times count,
    is never dropped.
    """
    is_dropped = (
        np.random.default_rng([seed, 8, int(is_right)]).uniform(size=n_frames)
        < faults.drop_fraction
    )
    is_dropped[:1] = False
    return [int(number) for number in np.flatnonzero(~is_dropped)]


def rig_in_file(rig: StereoRig, faults: Faults) -> StereoRig:
    """The content of the rig file for the true rig `rig`."""
    left, baseline_m = rig.left, rig.baseline_m
    match faults.wrong_rig:
        case "baseline":
            baseline_m *= BASELINE_FACTOR
        case "focal":
            left = replace(left, fx_px=left.fx_px * FOCAL_FACTOR, fy_px=left.fy_px * FOCAL_FACTOR)
        case "principal":
            left = replace(left, cx_px=left.cx_px + PRINCIPAL_PX)
    return StereoRig.rectified(left, baseline_m)


def with_rain(
    image: Image, rig: StereoRig, seed: list[int], *, rain: float, is_right: bool
) -> Image:
    """A copy of an image (H, W, 3) with streaks of rain, density 0 to 1; a pair of images has one
    `seed`.
    """
    camera = rig.left
    rng = np.random.default_rng(seed)
    n_drops = rng.poisson(rain * DROPS_PER_M3 * 900)
    z = 1.5 + 10.5 * np.sqrt(rng.uniform(size=n_drops))  # the field of view widens with z
    x = rng.uniform(-0.5, 0.5, n_drops) * z * camera.width_px / camera.fx_px - (
        rig.baseline_m if is_right else 0
    )
    y = rng.uniform(-0.5, 0.5, n_drops) * z * camera.height_px / camera.fy_px
    wind = rng.normal(0.05, 0.02, n_drops)
    fall_m = DROP_SPEED_MPS * EXPOSURE_S
    from_px = camera.project(np.stack([x, y, z], axis=1))
    to_px = camera.project(np.stack([x + wind * fall_m, y + fall_m, z], axis=1))
    alpha = np.zeros(image.shape[:2], np.uint8)
    ends = np.rint(np.stack([from_px, to_px], axis=1) * 16).astype(np.int32)
    for (start, end), opacity in zip(
        ends.tolist(), (110 / np.sqrt(z)).astype(int).tolist(), strict=True
    ):
        cv2.line(alpha, start, end, opacity, 1, cv2.LINE_AA, 4)
    alpha = cv2.GaussianBlur(alpha, (3, 3), 0)[:, :, None].astype(np.uint16)
    return np.asarray((image * (256 - alpha) + 215 * alpha) >> 8, np.uint8)
