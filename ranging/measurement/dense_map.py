"""DenseMap: a depth, inverse depth or disparity for the pixels of an image, as networks, dense
matchers and depth cameras give it.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from track_range.foundation.arrays import FloatArray, FloatArray32

Quantity = Literal["depth", "inverse_depth", "disparity"]


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

    def in_map(self, xyxy_px: FloatArray) -> FloatArray:
        """Boxes (N, 4) of the image in pixels of the map."""
        h, w = self.values.shape
        scale_y, scale_x = h / self.image_hw[0], w / self.image_hw[1]
        return np.asarray((xyxy_px + 0.5) * [scale_x, scale_y, scale_x, scale_y] - 0.5)
