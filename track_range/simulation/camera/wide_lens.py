"""WideLens: images of a fisheye pair from images of a pinhole pair with the same optical centres.

A pinhole with the lens's resolution on the axis and its field of view, at most 120 degrees, is rendered
(`virtual_pinhole.py`); each pixel of the wide image is the mean of SAMPLES x SAMPLES directions in it. Beyond the
pinhole's field of view the image is black. Boxes of the ground truth are in pixels of the pinhole, to which a run
undistorts the images; detections are in pixels of the wide image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.foundation.arrays import FloatArray32, Image
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rectification import Undistorter
from track_range.stereo.geometry.rig import StereoRig

SAMPLES = 3
"""Samples per pixel of the wide image and axis."""


@dataclass(frozen=True, slots=True)
class WideLens:
    """The lens of both cameras of a drive.

    Attributes:
        rig: the wide pair; its cameras are equal and parallel.
        pinholes: the pair that is rendered.
        xy_px: (SAMPLES H, SAMPLES W, 2) pixel of the pinhole's image of each sample of the wide image.
    """

    rig: StereoRig
    pinholes: StereoRig
    xy_px: FloatArray32

    @classmethod
    def of(cls, rig: StereoRig) -> WideLens:
        """The lens of a pair of equal, parallel cameras with wide lenses.

        Raises:
            ValueError: the cameras differ, or are not parallel.
        """
        camera = rig.left
        if camera != rig.right or not np.allclose(rig.right_from_left[:3, :3], np.eye(3), atol=1e-6):
            raise ValueError("rig: expected equal, parallel cameras with a wide lens")
        pinhole = Undistorter(camera).camera
        steps = [(np.arange(side * SAMPLES) + 0.5) / SAMPLES - 0.5 for side in (camera.width_px, camera.height_px)]
        x, y = np.meshgrid(*steps)
        rays = camera.recorded_rays(np.stack([x.ravel(), y.ravel()], axis=1))
        with np.errstate(invalid="ignore"):
            xy_px = pinhole.project(rays)
        shown = np.where(np.isfinite(xy_px), xy_px, -1e4).clip(-1e4, 1e4)
        return cls(
            rig,
            StereoRig.rectified(pinhole, rig.baseline_m),
            shown.reshape(*x.shape, 2).astype(np.float32),
        )

    @property
    def camera(self) -> PinholeCamera:
        """The left camera with its lens."""
        return self.rig.left

    def recorded(self, image: Image) -> Image:
        """The wide image of an image of the pinhole, which may be rendered with several samples per pixel and axis."""
        scale = image.shape[1] / self.pinholes.left.width_px
        x, y = ((self.xy_px[..., axis] + 0.5) * scale - 0.5 for axis in (0, 1))
        samples = cv2.remap(image, x, y, cv2.INTER_LINEAR)
        size_px = (self.camera.width_px, self.camera.height_px)
        return np.asarray(cv2.resize(samples, size_px, interpolation=cv2.INTER_AREA), np.uint8)

    def recorded_labels(self, labels: KittiLabels) -> KittiLabels:
        """Labels of the pinhole's images with boxes in pixels of the wide images, without those outside of them."""
        xyxy_px = Undistorter(self.camera).recorded_boxes(labels.xyxy_px)
        edge = np.array([self.camera.width_px, self.camera.height_px] * 2, np.float64) - 1
        moved = replace(labels, xyxy_px=np.clip(xyxy_px, 0.0, edge))
        sides = moved.xyxy_px[:, 2:] - moved.xyxy_px[:, :2]
        return moved.select(np.flatnonzero((sides >= 1).all(axis=1)))  # false for NaN
