"""InputPlacement: where an image lies in a network's input, and its pixels back from the output.

An image of (H, W) is resized to (h, w) and stands at the input's upper left corner, or at its
centre with a letterbox. The output covers the whole input, at its resolution or at another one.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from track_range.detection.yolo.letterbox import input_hw_of_area
from track_range.foundation.arrays import FloatArray, FloatArray32, Image
from track_range.ranging.networks.network_format import Fit, NetworkFormat

# of the padding of a letterbox: the mean of ImageNet, which most networks subtract
_GREY_BGR = (104.0, 116.0, 124.0)


@dataclass(frozen=True, slots=True)
class InputPlacement:
    """Scale and position of an image inside a network's input, all in pixels."""

    image_hw: tuple[int, int]
    input_hw: tuple[int, int]
    resized_hw: tuple[int, int]
    top_left: tuple[int, int]  # row and column of the resized image in the input
    fit: Fit

    @classmethod
    def within(
        cls,
        network: NetworkFormat,
        image_hw: tuple[int, int],
        fixed_hw: tuple[int | None, int | None],
    ) -> "InputPlacement":
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

    def intrinsics(self, fx_px: float) -> FloatArray:
        """(3, 3) camera matrix of the input, the corner of its first pixel at 0, for square pixels
        and a principal point in the centre of the image.
        """
        (top, left), (height, width) = self.top_left, self.resized_hw
        fy_px = fx_px * height / self.image_hw[0]
        centre = left + width / 2, top + height / 2
        return np.array([[fx_px * self.scale_x, 0, centre[0]], [0, fy_px, centre[1]], [0, 0, 1]])

    def rays(self, fx_px: float, hw: tuple[int, int] | None = None) -> FloatArray:
        """(h, w, 3) unit vectors along the rays of the pixels of the input, or of an output of
        `hw`.
        """
        h, w = hw or self.input_hw
        x = (np.arange(w) + 0.5) * self.input_hw[1] / w
        y = (np.arange(h) + 0.5) * self.input_hw[0] / h
        matrix = self.intrinsics(fx_px)
        slopes_x = np.broadcast_to((x - matrix[0, 2]) / matrix[0, 0], (h, w))
        slopes_y = np.broadcast_to(((y - matrix[1, 2]) / matrix[1, 1])[:, None], (h, w))
        rays = np.stack([slopes_x, slopes_y, np.ones((h, w))], axis=2)
        return np.asarray(rays / np.linalg.norm(rays, axis=2, keepdims=True))

    def placed(self, image: Image) -> Image:
        """The input's image (h, w, 3)."""
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
            padded = cv2.copyMakeBorder(image, top, bottom, left, right, border, value=_GREY_BGR)
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
