"""InputFormat: what a network wants to see (placement, padding, channel order, divisor), and writing an image that way.

An image goes into the network's own buffer in one resize and one multiplication per channel, with nothing allocated
between: a third of the time of OpenCV's blobFromImage, which the padding would have to be copied around besides.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from track_range.detection.yolo.letterbox import Letterbox, Placement
from track_range.foundation.arrays import Image

Colours = Literal["rgb", "bgr"]

LETTERBOXES = "centred-114, centred-128, top-left-114, stretch"
"""What users write most: a placement, and the grey (0..255) of the padding."""

_LETTERBOX = re.compile(r"(centred|top-left|stretch)(?:-(\d{1,3}))?")


@dataclass(frozen=True, slots=True, kw_only=True)
class InputFormat:
    """How an image becomes a network's input.

    Attributes:
        placement: where the image lies in the input.
        pad_grey: 0..255, what surrounds it.
        colours: the channels' order.
        divisor: pixel values 0..255 are divided by it.
    """

    placement: Placement = "centred"
    pad_grey: int = 114
    colours: Colours = "rgb"
    divisor: float = 255.0

    @property
    def letterbox(self) -> str:
        """Placement and padding as `--letterbox` takes them."""
        return self.placement if self.placement == "stretch" else f"{self.placement}-{self.pad_grey}"

    def fill_padding(self, buffer: npt.NDArray[Any]) -> None:
        """Fill a network's input with the padding's grey."""
        buffer[:] = self.pad_grey / self.divisor

    def write(self, image: Image, letterbox: Letterbox, buffer: npt.NDArray[Any], *, scaled: Image) -> None:
        """Write an image, (H, W, 3) uint8 BGR, into its place in `buffer` (1, 3, H, W); the padding stays as it is.

        `scaled` is scratch of the letterbox's resized size.
        """
        pixels = letterbox.scaled(image, buffer=scaled)
        rows, columns = letterbox.inside
        factor = np.float32(1 / self.divisor)
        for channel in range(3):
            source = 2 - channel if self.colours == "rgb" else channel
            np.multiply(pixels[..., source], factor, out=buffer[0, channel, rows, columns], casting="unsafe")


def placement_and_grey(text: object) -> tuple[Placement, int]:
    """Placement and padding of a word such as `centred-114`.

    Raises:
        ValueError: it is no such word; the message lists some.
    """
    match = _LETTERBOX.fullmatch(str(text).strip().lower())
    grey = int(match[2] or 114) if match else 256
    if match is None or grey > 255:
        raise ValueError(f"'{text}' is no letterbox; known are {LETTERBOXES} (the number is the padding's grey)")
    placement: Placement = next(word for word in get_args(Placement) if word == match[1])
    return placement, grey
