"""Placement: where an image lies in a network's input, and its pixels back from the output.

An image of (H, W) is resized to (h, w) and stands at the input's upper left corner, or at its centre with
a letterbox. The output covers the whole input, at its resolution or at another one.
"""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from track_range.detection.yolo.letterbox import input_hw_of_area
from track_range.foundation.arrays import FloatArray32, Image
from track_range.ranging.networks.network_format import Fit, NetworkFormat


@dataclass(frozen=True, slots=True)
class Placement:
    """Scale and position of an image inside a network's input, all in pixels."""

    image_hw: tuple[int, int]
    input_hw: tuple[int, int]
    resized_hw: tuple[int, int]
    top_left: tuple[int, int]  # row and column of the resized image in the input
    fit: Fit

    @classmethod
    def of_image(
        cls,
        network: NetworkFormat,
        image_hw: tuple[int, int],
        fixed_hw: tuple[int | None, int | None],
    ) -> "Placement":
        """The placement of an image in an input, whose sides are None where they vary."""
        input_hw = _input_hw(network, image_hw, fixed_hw)
        if network.fit == "stretch":
            return cls(image_hw, input_hw, input_hw, (0, 0), network.fit)
        scale = min(input_hw[0] / image_hw[0], input_hw[1] / image_hw[1])
        if network.fit == "pad":
            scale = min(scale, 1.0)
        height, width = (max(round(side * scale), 1) for side in image_hw)
        top_left = (0, 0)
        if network.fit == "letterbox":
            top_left = ((input_hw[0] - height) // 2, (input_hw[1] - width) // 2)
        return cls(image_hw, input_hw, (height, width), top_left, network.fit)

    @property
    def scale_x(self) -> float:
        """Pixels of the input per pixel of the image, along x."""
        return self.resized_hw[1] / self.image_hw[1]

    @property
    def focal_scale(self) -> float:
        """Focal length in pixels of the input per focal length in pixels of the image: the mean of
        both axes.
        """
        return math.sqrt(self.scale_x * self.resized_hw[0] / self.image_hw[0])

    @property
    def centre(self) -> tuple[float, float]:
        """Row and column of the image's centre in the input, the corner of its first pixel at 0."""
        (top, left), (height, width) = self.top_left, self.resized_hw
        return top + height / 2, left + width / 2

    def placed(self, image: Image, fill: tuple[float, float, float]) -> Image:
        """The input's image (h, w, 3); `fill` is the colour of the padding of a letterbox."""
        if image.ndim == 2:
            image = np.repeat(image[..., None], 3, axis=2)
        height, width = self.resized_hw
        if self.resized_hw != self.image_hw:
            is_smaller = height * width < image.shape[0] * image.shape[1]
            method = cv2.INTER_AREA if is_smaller else cv2.INTER_CUBIC
            image = np.asarray(cv2.resize(image, (width, height), interpolation=method), np.uint8)
        top, left = self.top_left
        bottom, right = self.input_hw[0] - height - top, self.input_hw[1] - width - left
        if top or left or bottom or right:
            border = cv2.BORDER_REPLICATE if self.fit == "pad" else cv2.BORDER_CONSTANT
            padded = cv2.copyMakeBorder(image, top, bottom, left, right, border, value=fill)
            image = np.asarray(padded, np.uint8)
        return image

    def of_the_image(self, output: npt.NDArray[Any]) -> FloatArray32:
        """The part of an output (h, w) that covers the image; values are not interpolated."""
        h, w = output.shape
        per_y, per_x = h / self.input_hw[0], w / self.input_hw[1]
        height = max(round(self.resized_hw[0] * per_y), 1)
        width = max(round(self.resized_hw[1] * per_x), 1)
        rows = _nearest(self.top_left[0] * per_y, self.resized_hw[0] * per_y, height, h)
        columns = _nearest(self.top_left[1] * per_x, self.resized_hw[1] * per_x, width, w)
        return np.ascontiguousarray(output[np.ix_(rows, columns)], np.float32)


def _nearest(start: float, length: float, n: int, size: int) -> npt.NDArray[np.int64]:
    """The pixels of an output nearest to the centres of `n` equal parts of it."""
    centres = start + (np.arange(n) + 0.5) * length / n - 0.5
    return np.clip(np.floor(centres + 0.5), 0, size - 1).astype(np.int64)


def _input_hw(
    network: NetworkFormat, image_hw: tuple[int, int], fixed_hw: tuple[int | None, int | None]
) -> tuple[int, int]:
    """Height and width of the input: the network's, else that of the format for this image."""
    area = network.area
    if network.fit == "pad" and area is not None and area >= image_hw[0] * image_hw[1]:
        area = None  # images are not enlarged
    if network.size is not None:
        height, width = network.size
    elif area is None:
        height, width = image_hw
    else:
        height, width = input_hw_of_area(image_hw, area_px2=area, stride_px=network.multiple)
    step = network.multiple
    height, width = -(-height // step) * step, -(-width // step) * step
    return fixed_hw[0] or height, fixed_hw[1] or width
