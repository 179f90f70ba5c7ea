"""Letterbox: scale an image into a network's input with its aspect kept, pad the rest; and the exact inverse for boxes.

    corner_net = (x + 0.5) * scale + pad          x: our pixel, centres at whole numbers
    x          = (corner_net - pad) / scale - 0.5  corner_net: the network's, pixel i covers [i, i + 1)

This file alone converts between the two conventions: half a pixel is 3-4 % of the distance at 100 m on a ground plane.
The resize itself (OpenCV's) maps pixel areas onto pixel areas, so the equations hold exactly, each axis with its own
scale, since the resized size is a whole number of pixels. (YOLOv5's and YOLOX's own inverses divide both axes by the
scale before that rounding, and YOLOv5's subtracts the padding before its rounding: up to 0.7 px of the network's input
away from where the pixels went, at the far edge.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image

Placement = Literal["centred", "top-left", "stretch"]


@dataclass(frozen=True, slots=True)
class Letterbox:
    """Where an image lies inside a network's input.

    Attributes:
        image_hw: (height, width) of the image.
        input_hw: (height, width) of the network's input.
        resized_hw: (height, width) of the scaled image inside the input.
        pad_yx: rows above and columns left of the scaled image.
    """

    image_hw: tuple[int, int]
    input_hw: tuple[int, int]
    resized_hw: tuple[int, int]
    pad_yx: tuple[int, int]

    @classmethod
    def placed(cls, placement: Placement, image_hw: tuple[int, int], input_hw: tuple[int, int]) -> Letterbox:
        """The image in the input by a placement's name."""
        return _PLACED[placement](image_hw, input_hw)

    @classmethod
    def centred(cls, image_hw: tuple[int, int], input_hw: tuple[int, int]) -> Letterbox:
        """The image as large as fits, in the middle (YOLOv5's way; an odd pad has its smaller half first)."""
        scale = min(input_hw[0] / image_hw[0], input_hw[1] / image_hw[1])
        resized_hw = (max(round(image_hw[0] * scale), 1), max(round(image_hw[1] * scale), 1))
        pad_yx = ((input_hw[0] - resized_hw[0]) // 2, (input_hw[1] - resized_hw[1]) // 2)
        return cls(image_hw, input_hw, resized_hw, pad_yx)

    @classmethod
    def top_left(cls, image_hw: tuple[int, int], input_hw: tuple[int, int]) -> Letterbox:
        """The image as large as fits, in the upper left corner (YOLOX's way: sizes are cut off, not rounded)."""
        scale = min(input_hw[0] / image_hw[0], input_hw[1] / image_hw[1])
        return cls(image_hw, input_hw, (max(int(image_hw[0] * scale), 1), max(int(image_hw[1] * scale), 1)), (0, 0))

    @classmethod
    def stretched(cls, image_hw: tuple[int, int], input_hw: tuple[int, int]) -> Letterbox:
        """The image over the whole input, its aspect lost (what Darknet itself does unless told letter_box=1)."""
        return cls(image_hw, input_hw, input_hw, (0, 0))

    @property
    def _scale_xyxy(self) -> FloatArray:
        y, x = (r / i for r, i in zip(self.resized_hw, self.image_hw, strict=True))
        return np.array([x, y, x, y])

    @property
    def _pad_xyxy(self) -> FloatArray:
        y, x = self.pad_yx
        return np.array([x, y, x, y], np.float64)

    def scaled(self, image: Image, *, buffer: Image | None = None) -> Image:
        """The image at `resized_hw`, in `buffer` where one is given; the same array where that is its size."""
        if self.resized_hw == self.image_hw:
            return image
        height, width = self.resized_hw
        return np.asarray(cv2.resize(image, (width, height), dst=buffer, interpolation=cv2.INTER_LINEAR), np.uint8)

    @property
    def inside(self) -> tuple[slice, slice]:
        """Rows and columns of the input that the scaled image takes."""
        (y, x), (height, width) = self.pad_yx, self.resized_hw
        return slice(y, y + height), slice(x, x + width)

    def to_image(self, xyxy_net: FloatArray) -> FloatArray:
        """(N, 4) boxes in the network's corner coordinates -> in the image's pixels, not clipped."""
        return (xyxy_net - self._pad_xyxy) / self._scale_xyxy - 0.5

    def to_image_clipped(self, xyxy_net: FloatArray) -> FloatArray:
        """As `to_image`, with the edges kept inside the image's outer borders (-0.5 .. size - 0.5)."""
        h, w = self.image_hw
        limit = np.array([w, h, w, h]) - 0.5
        return np.clip(self.to_image(xyxy_net), -0.5, limit)


_PLACED = {"centred": Letterbox.centred, "top-left": Letterbox.top_left, "stretch": Letterbox.stretched}


def rectangular_input_hw(image_hw: tuple[int, int], *, size_px: int, stride_px: int = 32) -> tuple[int, int]:
    """The smallest input (height, width), in whole strides, for the image scaled to a longer side of `size_px`."""
    scale = size_px / max(image_hw)
    height, width = (max(-(-round(side * scale) // stride_px) * stride_px, stride_px) for side in image_hw)
    return height, width
