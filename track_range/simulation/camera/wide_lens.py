"""WideLens: images of a fisheye pair from images of pinhole pairs with the same optical centres.

A pinhole ahead with the lens's resolution on the axis and its field of view, at most 120 degrees
(`virtual_pinhole.py`), is rendered, and for lenses that see more, two pinholes to the sides; each
pixel of the wide image is the mean of SAMPLES x SAMPLES directions. Directions behind the camera,
and directions to the sides at night and in rain, are black. Boxes of the ground truth are in pixels
of the pinhole ahead, to which a run undistorts the images; detections are in pixels of the wide
image.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32, Image
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rectification import Undistorter
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.geometry.virtual_pinhole import axial_focal_px, view_from_camera

SAMPLES = 3  # samples per pixel of the wide image and axis


# of the axes of the pinholes to the sides, and half their fields of view
SIDE_DEG, SIDE_HALF_DEG = 75.0, 40.0


@dataclass(frozen=True, slots=True)
class SideView:
    """A pinhole to one side."""

    yaw_deg: float  # direction of its axis, to the right of the lens's (`view_from_camera`)
    camera: PinholeCamera  # the pinhole
    # (SAMPLES H, SAMPLES W, 2) pixel of its image of each sample of the wide image
    xy_px: FloatArray32
    # (SAMPLES H, SAMPLES W) 255 for samples that it shows and the pinhole ahead does not, else 0
    is_shown: Image


@dataclass(frozen=True, slots=True)
class WideLens:
    """The lens of both cameras of a drive."""

    rig: StereoRig  # the wide pair; its cameras are equal and parallel
    pinholes: StereoRig  # the pair ahead that is rendered
    # (SAMPLES H, SAMPLES W, 2) pixel of the pinhole's image of each sample of the wide image
    xy_px: FloatArray32
    sides: tuple[SideView, ...]  # the views to the sides

    @classmethod
    def of(cls, rig: StereoRig) -> WideLens:
        """The lens of a pair of identical, parallel cameras with wide lenses."""
        camera = rig.left
        if camera != rig.right or not np.allclose(
            rig.right_from_left[:3, :3], np.eye(3), atol=1e-6
        ):
            raise ValueError("rig: expected identical, parallel cameras with a wide lens")
        pinhole = Undistorter(camera).camera
        steps = [
            (np.arange(side * SAMPLES) + 0.5) / SAMPLES - 0.5
            for side in (camera.width_px, camera.height_px)
        ]
        x, y = np.meshgrid(*steps)
        rays = camera.recorded_rays(np.stack([x.ravel(), y.ravel()], axis=1)).reshape(*x.shape, 3)
        xy_px, is_ahead = _projected(pinhole, rays)
        half_px = axial_focal_px(camera) * math.tan(math.radians(SIDE_HALF_DEG))
        side_px = 2 * round(half_px)
        middle_px = (side_px - 1) / 2
        beside = PinholeCamera(pinhole.fx_px, pinhole.fy_px, middle_px, middle_px, side_px, side_px)
        sides = []
        for yaw_deg in (-SIDE_DEG, SIDE_DEG):
            side_xy_px, is_inside = _projected(beside, rays @ view_from_camera(yaw_deg).T)
            is_shown = is_inside & ~is_ahead
            if is_shown.any():
                sides.append(
                    SideView(
                        yaw_deg, beside, side_xy_px, np.where(is_shown, 255, 0).astype(np.uint8)
                    )
                )
        return cls(rig, StereoRig.rectified(pinhole, rig.baseline_m), xy_px, tuple(sides))

    def recorded(self, ahead: Image, beside: Sequence[Image] = ()) -> Image:
        """The wide image from an image of the pinhole ahead and, if they are rendered, images of
        `sides`.

        The images may be rendered with several samples per pixel and axis.
        """
        samples = _remapped(ahead, self.pinholes.left, self.xy_px)
        for image, side in zip(beside, self.sides, strict=False):
            cv2.copyTo(_remapped(image, side.camera, side.xy_px), side.is_shown, samples)
        size_px = (self.rig.left.width_px, self.rig.left.height_px)
        return np.asarray(cv2.resize(samples, size_px, interpolation=cv2.INTER_AREA), np.uint8)

    def recorded_labels(self, labels: KittiLabels) -> KittiLabels:
        """Labels of the pinhole's images with boxes in pixels of the wide images, without boxes
        outside these.
        """
        camera = self.rig.left
        xyxy_px = Undistorter(camera).recorded_boxes(labels.xyxy_px)
        edge = np.array([camera.width_px, camera.height_px] * 2, np.float64) - 1
        moved = replace(labels, xyxy_px=np.clip(xyxy_px, 0.0, edge))
        sides = moved.xyxy_px[:, 2:] - moved.xyxy_px[:, :2]
        return moved.select(np.flatnonzero((sides >= 1).all(axis=1)))  # false for NaN


def _projected(pinhole: PinholeCamera, rays: FloatArray) -> tuple[FloatArray32, BoolArray]:
    """(H, W, 2) pixels of directions (H, W, 3), and whether (H, W) they are inside the image."""
    with np.errstate(invalid="ignore"):
        xy_px = pinhole.project(rays.reshape(-1, 3)).reshape(*rays.shape[:2], 2)
        is_inside = np.all(
            (xy_px >= 0) & (xy_px <= (pinhole.width_px - 1, pinhole.height_px - 1)), axis=2
        )
    return np.where(np.isfinite(xy_px), xy_px, -1e4).clip(-1e4, 1e4).astype(np.float32), np.asarray(
        is_inside
    )


def _remapped(image: Image, pinhole: PinholeCamera, xy_px: FloatArray32) -> Image:
    scale = image.shape[1] / pinhole.width_px
    x, y = ((xy_px[..., axis] + 0.5) * scale - 0.5 for axis in (0, 1))
    return np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR), np.uint8)
