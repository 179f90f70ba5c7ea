"""VideoFrame: one image with its place in the file and its time, and the clock that makes those times increase."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from track_range.foundation.arrays import Image
from track_range.foundation.errors import UserError

TIME_EPSILON_S = 1e-6
"""Times closer than this are one: far below any frame interval, far above the rounding of a float64."""

_NEUTRAL_DIFFERENCE = 8  # grey levels between channels; lossy chroma of a grey video differs by 1 to 3
_NEUTRAL_SHARE = 0.999


class VideoError(UserError):
    """A video that cannot be read, paired or written; the message names the path and what to do."""


class DecodedImage(Protocol):
    """An image in the decoder's own format, smaller than as BGR."""

    @property
    def n_bytes(self) -> int:
        """Memory that it takes."""
        ...

    def to_bgr(self) -> Image:
        """(H, W, 3) uint8 BGR, upright; the same at each call."""
        ...


@dataclass(frozen=True, slots=True)
class VideoFrame:
    """One image of a video.

    Attributes:
        index: number of the frame in its file, from 0, counting also frames that were skipped, dropped or missing.
        time_s: the file's own time of the frame, with the stream's start offset; strictly increasing.
        image: (H, W, 3) uint8 BGR, upright.
        decoded: the same image in the decoder's format; None = there is no other format.
    """

    index: int
    time_s: float
    image: Image
    decoded: DecodedImage | None = field(default=None, repr=False, compare=False)

    @property
    def n_packed_bytes(self) -> int:
        """Memory of the image once packed."""
        return self.image.nbytes if self.decoded is None else self.decoded.n_bytes

    def packed(self) -> Callable[[], VideoFrame]:
        """A function that returns this frame and holds its image in the smaller format only."""
        decoded, index, time_s = self.decoded, self.index, self.time_s
        if decoded is None:
            return lambda: self
        return lambda: VideoFrame(index, time_s, decoded.to_bgr(), decoded)


def is_neutral(image: Image) -> bool:
    """Whether a BGR image has no colour: its channels are equal but for a codec's noise."""
    sample = image[::4, ::4].astype(np.int16)
    return bool((np.ptp(sample, axis=2) <= _NEUTRAL_DIFFERENCE).mean() >= _NEUTRAL_SHARE)


def strictly_later(stamp_s: float | None, last_s: float | None, *, interval_s: float) -> float | None:
    """The time of a frame stamped `stamp_s` after one at `last_s`; None = a repeated or backward stamp.

    A frame without a stamp comes one nominal interval after the last, or at 0 when it is the first.
    """
    if stamp_s is None:
        return 0.0 if last_s is None else last_s + interval_s
    return stamp_s if last_s is None or stamp_s > last_s + TIME_EPSILON_S else None


def counted(n: int, noun: str, plural: str | None = None) -> str:
    """`1 frame`, `2 frames`."""
    return f"{n} {noun if n == 1 else plural or noun + 's'}"
