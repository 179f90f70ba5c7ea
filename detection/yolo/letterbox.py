"""Letterbox: an image scaled into a network's input with its aspect ratio preserved, and the exact
inverse for boxes.

    x_net = (x + 0.5) * scale + pad          x:     image pixels, pixel centres at integers
    x     = (x_net - pad) / scale - 0.5      x_net: corner coordinates of the input, pixel i covers [i, i + 1)

Each axis has its own scale, resized size / image size, because the resized size is a whole number
of pixels. OpenCV's resize maps pixel areas onto pixel areas, so these equations are exact. (YOLOv5
and YOLOX divide both axes by the scale before rounding, and YOLOv5 subtracts the padding before
rounding, which is wrong by up to 0.7 px of the network's input at the far edge.) The half pixel
matters: it is 3-4 % of the distance at 100 m on a ground plane.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image

Placement = Literal["centred", "top-left", "stretch"]

_MAX_LONGER_SIDE = 2.5  # of an input, in sides of a square of the same area


@dataclass(frozen=True, slots=True)
class Letterbox:
    """Scale and position of an image inside a network's input, all in pixels."""

    image_hw: tuple[int, int]  # (height, width) of the image
    input_hw: tuple[int, int]  # (height, width) of the network's input
    resized_hw: tuple[int, int]  # (height, width) of the scaled image inside the input
    # number of padding rows above and padding columns left of the scaled image
    pad_yx: tuple[int, int]

    @classmethod
    def of_placement(
        cls, placement: Placement, image_hw: tuple[int, int], input_hw: tuple[int, int]
    ) -> Letterbox:
        """The letterbox of the largest image that fits into the input, or of an image that is
        stretched to it.

        "centred" as in YOLOv5: odd padding has its smaller half top and left; "top-left" as in
        YOLOX: sizes are rounded down; "stretch": regardless of the aspect ratio, as Darknet does
        without letter_box=1.
        """
        if placement == "stretch":
            return cls(image_hw, input_hw, input_hw, (0, 0))
        scale = min(input_hw[0] / image_hw[0], input_hw[1] / image_hw[1])
        height, width = (
            max(round(side * scale) if placement == "centred" else int(side * scale), 1)
            for side in image_hw
        )
        pad_yx = (
            ((input_hw[0] - height) // 2, (input_hw[1] - width) // 2)
            if placement == "centred"
            else (0, 0)
        )
        return cls(image_hw, input_hw, (height, width), pad_yx)

    def scaled(self, image: Image, *, buffer: Image | None = None) -> Image:
        """The image resized to `resized_hw`, in `buffer` if given; `image` itself if it already has
        that size.
        """
        if self.resized_hw == self.image_hw:
            return image
        height, width = self.resized_hw
        return np.asarray(
            cv2.resize(image, (width, height), dst=buffer, interpolation=cv2.INTER_LINEAR), np.uint8
        )

    @property
    def inside(self) -> tuple[slice, slice]:
        """Rows and columns of the input that the scaled image occupies."""
        (y, x), (height, width) = self.pad_yx, self.resized_hw
        return slice(y, y + height), slice(x, x + width)

    def to_image(self, xyxy_net: FloatArray) -> FloatArray:
        """(N, 4) boxes in image pixels, not clipped, from boxes in the network's corner
        coordinates.
        """
        pad_y, pad_x = self.pad_yx
        scale_y = self.resized_hw[0] / self.image_hw[0]
        scale_x = self.resized_hw[1] / self.image_hw[1]
        pad = np.array([pad_x, pad_y, pad_x, pad_y], np.float64)
        scale: FloatArray = np.array([scale_x, scale_y, scale_x, scale_y])
        return (xyxy_net - pad) / scale - 0.5

    def to_image_clipped(self, xyxy_net: FloatArray) -> FloatArray:
        """(N, 4) boxes in image pixels, clipped to the image's outer borders (-0.5 .. size -
        0.5).
        """
        h, w = self.image_hw
        limit = np.array([w, h, w, h]) - 0.5
        return np.clip(self.to_image(xyxy_net), -0.5, limit)


def rectangular_input_hw(
    image_hw: tuple[int, int], *, size_px: int, stride_px: int = 32
) -> tuple[int, int]:
    """The smallest input (height, width), divisible by `stride_px`, for an image scaled to a longer
    side `size_px`.
    """
    scale = size_px / max(image_hw)
    height, width = (
        max(-(-round(side * scale) // stride_px) * stride_px, stride_px) for side in image_hw
    )
    return height, width


def input_hw_of_area(
    image_hw: tuple[int, int], *, area_px2: float, stride_px: int = 32
) -> tuple[int, int]:
    """The input (height, width), multiples of `stride_px`, with the aspect ratio of an image and
    about a given area.

    Images of every shape then take the same time, and wide images, in which road users are small,
    keep more detail than with a common longer side. The longer side is at most 2.5 times the side
    of a square of the same area.
    """
    side_px = math.sqrt(area_px2)
    scale = min(
        side_px / math.sqrt(image_hw[0] * image_hw[1]), _MAX_LONGER_SIDE * side_px / max(image_hw)
    )
    height, width = (
        max(round(side * scale / stride_px) * stride_px, stride_px) for side in image_hw
    )
    return height, width
