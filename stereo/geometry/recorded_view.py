"""RecordedView: boxes and points of undistorted images, back in the recorded image of a wide lens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.rectification import Rectifier, Undistorter

N_OUTLINE = 8  # number of points of each edge of a box in the recorded image, where edges are curves


@dataclass(frozen=True, slots=True)
class RecordedView:
    """The recorded image behind the left, or only, undistorted images."""

    rectifier: Rectifier | Undistorter  # what computes the undistorted images
    size_px: tuple[int, int]  # (width, height) of the recorded images

    def points(self, xy_px: FloatArray) -> FloatArray:
        """(N, 2) points in pixels of the recorded image; NaN where the lens shows nothing."""
        return self.rectifier.recorded_points(xy_px)

    def boxes(self, xyxy_px: FloatArray) -> FloatArray:
        """(N, 4) boxes in pixels of the recorded image: each edge is moved like its midpoint."""
        return self.rectifier.recorded_boxes(xyxy_px)

    def outlines(self, xyxy_px: FloatArray) -> FloatArray:
        """(N, 4 N_OUTLINE, 2) closed outlines of boxes (N, 4) in pixels of the recorded image."""
        if not len(xyxy_px):
            return np.zeros((0, 4 * N_OUTLINE, 2))
        corners = xyxy_px[:, [0, 1, 2, 1, 2, 3, 0, 3]].reshape(-1, 4, 2)
        following = np.roll(corners, -1, axis=1)
        fraction = (np.arange(N_OUTLINE) / N_OUTLINE)[:, None]
        points = corners[:, :, None] * (1 - fraction) + following[:, :, None] * fraction
        return self.points(points.reshape(-1, 2)).reshape(len(xyxy_px), -1, 2)
