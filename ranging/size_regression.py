"""SizeRegressionRanger: monocular distance from the size of a track's box, by class."""

from __future__ import annotations

import numpy as np

from detection.detections import FloatArray
from ranging.ranges import Ranges
from ranging.size_curve import SizeCurves, load_curves
from stereo.camera import PinholeCamera
from stereo.frames import Frame
from tracking.tracks import Tracks

_BORDER_PX = 1.5  # a box this near the image's border is taken as cut off by it: detectors stop a pixel short
_MIN_HEIGHT_PX = 4.0


class SizeRegressionRanger:
    """Ranges observed boxes that the image does not cut at top or bottom; a cut side is left out of the measure."""

    def __init__(self, camera: PinholeCamera, curves: SizeCurves | None = None, *, box_sigma_px: float = 1.5) -> None:
        """Range for `camera` (undistorted); `box_sigma_px`: standard deviation of one edge of a detector's box."""
        self._camera = camera
        self._curves = curves or load_curves()
        self._box_sigma_px = box_sigma_px

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances by size; NaN for predicted boxes, for boxes cut at top or bottom, for classes without a curve."""
        height_px, width_px = frame.left.shape[:2]
        xyxy_px = tracks.xyxy_px
        size_px = xyxy_px[:, 2:] - xyxy_px[:, :2]
        last = np.array([width_px, height_px]) - 0.5 - _BORDER_PX
        cut = (xyxy_px[:, :2] < _BORDER_PX - 0.5) | (xyxy_px[:, 2:] > last)
        usable = tracks.observed & ~cut[:, 1] & (size_px[:, 1] >= _MIN_HEIGHT_PX) & (size_px[:, 0] > 0)
        distance_m, sigma_m = self._curves.distance(
            np.where(usable[:, None], size_px, 1.0) / self._focal_px,
            self._bearing(xyxy_px),
            class_id=tracks.class_id,
            use_width=~cut[:, 0],
            noise_over_f=self._box_sigma_px / self._camera.fy_px,
        )
        return Ranges(tracks.track_id, np.where(usable, distance_m, np.nan), np.where(usable, sigma_m, np.nan))

    @property
    def _focal_px(self) -> FloatArray:
        return np.array([self._camera.fx_px, self._camera.fy_px])

    def _bearing(self, xyxy_px: FloatArray) -> FloatArray:
        return self._camera.rays((xyxy_px[:, :2] + xyxy_px[:, 2:]) / 2)[:, 0]
