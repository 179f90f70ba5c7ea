"""InputFormat: a network's input format (placement, padding, channel order, scale) and the
conversion of images.

An image is written into the network's buffer with one resize and one multiplication per channel and
without temporary arrays: a third of the time of OpenCV's blobFromImage, whose result would also
have to be copied into the padding.
"""

import re
from dataclasses import dataclass
from typing import Any, Literal, get_args

import cv2
import numpy as np
import numpy.typing as npt

from track_range.detection.yolo.letterbox import Letterbox, Placement
from track_range.foundation.arrays import Image
from track_range.foundation.files.input_files import quoted

Colours = Literal["rgb", "bgr"]

Triple = tuple[float, float, float]

IMAGENET_MEAN: Triple = (0.485, 0.456, 0.406)
# ImageNet's, RGB / 255; many backbones are trained with them
IMAGENET_STD: Triple = (0.229, 0.224, 0.225)
# common `--letterbox`: placement, padding
LETTERBOXES = "centred-114, centred-128, top-left-114, stretch"
_LETTERBOX = re.compile(r"(centred|top-left|stretch)(?:-(\d{1,3}))?")


@dataclass(frozen=True, slots=True, kw_only=True)
class InputFormat:
    """Format of a network's input image: (pixel / divisor - mean) / std, by channel in the order of
    `colours`.
    """

    placement: Placement = "centred"  # position of the scaled image in the input
    pad_grey: int = 114  # grey level of the padding, 0..255
    colours: Colours = "rgb"  # channel order
    divisor: float = 255.0  # number by which pixel values 0..255 are divided
    mean: Triple = (0.0, 0.0, 0.0)
    std: Triple = (1.0, 1.0, 1.0)

    @property
    def letterbox(self) -> str:
        """Placement and padding in the format of `--letterbox`, such as `centred-114`."""
        return (
            self.placement if self.placement == "stretch" else f"{self.placement}-{self.pad_grey}"
        )

    def fill_padding(self, buffer: npt.NDArray[Any]) -> None:
        """Fill a network's input with the grey of the padding."""
        for channel in range(3):
            buffer[:, channel] = (self.pad_grey / self.divisor - self.mean[channel]) / self.std[
                channel
            ]

    def write(
        self, image: Image, letterbox: Letterbox, buffer: npt.NDArray[Any], *, scaled: Image
    ) -> None:
        """Write an image (H, W, 3) into a network's input (1, 3, height, width) without changing
        the padding.

        `scaled` (*resized_hw, 3) is a uint8 scratch buffer.
        """
        channels = cv2.split(letterbox.scaled(image, buffer=scaled))
        rows, columns = letterbox.inside
        for channel in range(3):
            target = buffer[0, channel, rows, columns]
            target[:] = channels[2 - channel if self.colours == "rgb" else channel]
            target *= np.float32(1 / (self.divisor * self.std[channel]))
            if self.mean[channel]:
                target -= buffer.dtype.type(self.mean[channel] / self.std[channel])


def placement_and_grey(text: object) -> tuple[Placement, int]:
    """Placement and grey level 0..255 from text such as `centred-114`; ValueError for another
    format.
    """
    match = _LETTERBOX.fullmatch(str(text).strip().lower())
    grey = int(match[2] or 114) if match else 256
    if match is None or grey > 255:
        raise ValueError(
            f"expected a letterbox such as {LETTERBOXES} (the number is the grey level), got "
            f"{quoted(text)}"
        )
    placement: Placement = next(value for value in get_args(Placement) if value == match[1])
    return placement, grey
