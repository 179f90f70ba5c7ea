"""What can be wrong with a pair of cameras, and what it does to their images.

A wrong row or disparity offset is a right camera whose principal point is not where the rig file says: it is drawn
with, so the shift is exact. Rain is streaks of falling drops between 1.5 and 12 m, at their own disparity in each eye.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from track_range.foundation.arrays import Image
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

WrongRig = Literal["baseline", "focal", "principal"]

BASELINE_FACTOR, FOCAL_FACTOR, PRINCIPAL_PX = 1.05, 1.04, 15.0
"""By how much a rig file with an error is wrong; the principal point is so many pixels too far right, in both eyes."""

DROPS_PER_M3 = 1.2
"""At rain = 1: a cloudburst."""

DROP_SPEED_MPS, EXPOSURE_S = 8.0, 0.012
"""A drop falls this far while the shutter is open: about 10 cm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Faults:
    """Faults of a drive's cameras; the defaults are none.

    Attributes:
        gain: brightness of the right eye as a multiple of the left one's.
        blur_px: standard deviation of an additional blur of both eyes.
        rain: 0 = dry .. 1 = cloudburst.
        row_offset_px: the right image is so many rows lower.
        disparity_offset_px: disparities are so much larger than the rig tells.
        drop_share: share of frames that each eye loses; the files' times tell.
        late_s: the right eye opens so much later than its times tell.
        wrong_rig: what is wrong in the rig file; None = nothing.
    """

    gain: float = 1.0
    blur_px: float = 0.0
    rain: float = 0.0
    row_offset_px: float = 0.0
    disparity_offset_px: float = 0.0
    drop_share: float = 0.0
    late_s: float = 0.0
    wrong_rig: WrongRig | None = None

    def right_camera(self, camera: PinholeCamera) -> PinholeCamera:
        """The camera that the right eye really is."""
        return replace(camera, cx_px=camera.cx_px - self.disparity_offset_px, cy_px=camera.cy_px + self.row_offset_px)

    def seen(self, image: Image, *, is_right: bool) -> Image:
        """An image with the lens's blur and the eye's gain."""
        if self.blur_px > 0:
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), self.blur_px), np.uint8)
        if is_right and self.gain != 1.0:
            image = np.asarray(cv2.convertScaleAbs(image, alpha=self.gain), np.uint8)
        return image

    def kept_frames(self, n_frames: int, seed: int, *, is_right: bool) -> list[int]:
        """Numbers of the frames that an eye keeps; never without the first, from which times count."""
        rng = np.random.default_rng([seed, 8, int(is_right)])
        lost = rng.uniform(size=n_frames) < self.drop_share
        lost[:1] = False
        return [int(number) for number in np.flatnonzero(~lost)]

    def told_rig(self, rig: StereoRig) -> StereoRig:
        """What the rig file says of a rig."""
        left = rig.left
        if self.wrong_rig == "baseline":
            return StereoRig.rectified(left, rig.baseline_m * BASELINE_FACTOR)
        if self.wrong_rig == "focal":
            left = replace(left, fx_px=left.fx_px * FOCAL_FACTOR, fy_px=left.fy_px * FOCAL_FACTOR)
        if self.wrong_rig == "principal":
            left = replace(left, cx_px=left.cx_px + PRINCIPAL_PX)
        return StereoRig.rectified(left, rig.baseline_m)


NO_FAULTS = Faults()


def rained(image: Image, rig: StereoRig, seed: list[int], rain: tuple[float, str]) -> Image:
    """An image with streaks of rain; both eyes see the same drops.

    Args:
        image: (H, W, 3) of one eye; not written to.
        rig: tells where the eyes are.
        seed: of the drops of this frame.
        rain: how much, and the eye.
    """
    share, side = rain
    camera = rig.left
    rng = np.random.default_rng(seed)
    n_drops = rng.poisson(share * DROPS_PER_M3 * 900)
    z = 1.5 + 10.5 * np.sqrt(rng.uniform(size=n_drops))  # the view widens with z
    x = rng.uniform(-0.5, 0.5, n_drops) * z * camera.width_px / camera.fx_px - (
        rig.baseline_m if side == "right" else 0
    )
    y = rng.uniform(-0.5, 0.5, n_drops) * z * camera.height_px / camera.fy_px
    wind = rng.normal(0.05, 0.02, n_drops)
    fall_m = DROP_SPEED_MPS * EXPOSURE_S
    from_px = camera.project(np.stack([x, y, z], axis=1))
    to_px = camera.project(np.stack([x + wind * fall_m, y + fall_m, z], axis=1))
    veil = np.zeros(image.shape[:2], np.uint8)
    ends = np.rint(np.stack([from_px, to_px], axis=1) * 16).astype(np.int32)
    for (start, end), light in zip(ends.tolist(), (110 / np.sqrt(z)).astype(int).tolist(), strict=True):
        cv2.line(veil, start, end, light, 1, cv2.LINE_AA, 4)
    veil = cv2.GaussianBlur(veil, (3, 3), 0)[:, :, None].astype(np.uint16)
    return np.asarray((image * (256 - veil) + 215 * veil) >> 8, np.uint8)
