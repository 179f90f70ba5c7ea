"""DenseMap: a depth, inverse depth or disparity for the pixels of an image, as networks, dense
matchers and depth cameras give it.
"""

from dataclasses import dataclass, replace
from typing import Literal, Self

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, FloatArray32
from track_range.ranging.measurement.rig_scale import CALIBRATED, RigScale
from track_range.stereo.geometry.alignment import Alignment, column_from_axis
from track_range.stereo.geometry.rig import StereoRig

Quantity = Literal["depth", "inverse_depth", "disparity"]


@dataclass(frozen=True, slots=True)
class MapPair:
    """The rectified pair of a map of disparities, and the alignment that corrects them."""

    rig: StereoRig
    alignment: Alignment


@dataclass(frozen=True, slots=True)
class DenseMap:
    """Values for the pixels of one image, at its resolution or at another one.

    The map covers the whole image: the centre of pixel (column i, row j) of a map of (h, w) is at
    x = (i + 0.5) W / w - 0.5, y = (j + 0.5) H / h - 0.5 in the image of `image_hw` = (H, W).
    """

    # (h, w), NaN = unknown: depth z in m, inverse depth in 1/m, or disparity x_left - x_right in
    # pixels of the image (not of the map)
    values: FloatArray32
    quantity: Quantity
    image_hw: tuple[int, int]
    # False = the values are right up to a factor, and inverse depths also up to an added constant
    is_metric: bool = True
    confidence: FloatArray32 | None = None  # (h, w), 0..1; None = the source has none
    pair: MapPair | None = None  # of disparities as a ranger measured them; else None
    # by which `depth_m` corrects the distances, as the drive shows; the values stay as measured
    scale: RigScale = CALIBRATED

    def in_map(self, xyxy_px: FloatArray) -> FloatArray:
        """Boxes (N, 4) of the image in pixels of the map."""
        h, w = self.values.shape
        scale_y, scale_x = h / self.image_hw[0], w / self.image_hw[1]
        return np.asarray((xyxy_px + 0.5) * [scale_x, scale_y, scale_x, scale_y] - 0.5)

    @property
    def is_depth(self) -> bool:
        """Whether `depth_m` gives metres."""
        return self.pair is not None if self.quantity == "disparity" else self.is_metric

    def depth_m(self) -> FloatArray32:
        """(h, w) depth z in metres in the left camera's frame, with all corrections that distances
        of boxes have; NaN = unknown, everywhere if the map is not metric.
        """
        if not self.is_depth:
            return np.full_like(self.values, np.nan)
        values = self.values
        if self.pair is not None:
            rig, w = self.pair.rig, values.shape[1]
            x_px = (np.arange(w) + 0.5) * self.image_hw[1] / w - 0.5
            error_px = self.pair.alignment.error_px(column_from_axis(x_px, rig.left))
            focal_baseline = rig.left.fx_px * rig.baseline_m
            values = (values + error_px.astype(np.float32)) / np.float32(focal_baseline)
        with np.errstate(invalid="ignore", divide="ignore"):
            inverse = values if self.quantity != "depth" else 1.0 / values
            offset = self.scale.offset
            if offset is not None:
                inverse = inverse + np.float32(offset.px / offset.focal_baseline_px_m)
            depth = np.float32(self.scale.factor) / inverse
        return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(np.nan))

    def stretched(self, log_factor: float) -> Self:
        """The map with depths that are smaller by exp(-log_factor)."""
        scale = replace(self.scale, log_factor=self.scale.log_factor + log_factor)
        return replace(self, scale=scale)

    def in_image(self, values: FloatArray32) -> FloatArray32:
        """Values (h, w) of the map for the pixels (H, W) of the image, each that of the nearest
        pixel of the map.
        """
        if values.shape == self.image_hw:
            return values
        size = self.image_hw[::-1]
        return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_NEAREST_EXACT))
