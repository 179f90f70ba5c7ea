"""VideoFrame: one image with its frame number and time; and helpers that all video sources
share.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction

import av
import numpy as np
from av.video.reformatter import VideoReformatter

from track_range.foundation.arrays import Image
from track_range.foundation.errors import UserError

# times closer than this are equal: below frame intervals, above the rounding of a float64
TIME_EPSILON_S = 1e-6
# grey levels (lossy chroma: 1 to 3); fraction of such pixels
_NEUTRAL_DIFFERENCE, _NEUTRAL_FRACTION = 8, 0.999
UPRIGHT = (1, 0, 0, 1)  # axes of an image that needs no rotation
_MAX_PIXEL_ASPECT = 4.0  # largest plausible ratio of the sides of a pixel
_reformatters = threading.local()  # one converter of colours per thread, whose buffers are reused


class VideoError(UserError):
    """A video that cannot be read, paired or written; the message names the path and what to do."""


class FrameError(UserError, ValueError):
    """An image or a time of a frame in memory that cannot be used; a pipeline is as before."""


@dataclass(frozen=True, slots=True)
class DecodedImage:
    """A frame in the decoder's native format, which takes less memory than BGR."""

    frame: av.VideoFrame
    # signs (a, b, c, d) of x' = a x + c y, y' = b x + d y, which rotate the stored image upright
    axes: tuple[int, int, int, int]

    @property
    def n_bytes(self) -> int:
        """Size in memory."""
        return sum(plane.buffer_size for plane in self.frame.planes)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the upright image."""
        size_px = (self.frame.width, self.frame.height)
        return size_px[::-1] if self.axes[1] else size_px

    def to_bgr(self) -> Image:
        """The image as (H, W, 3) uint8 BGR, upright; every call gives the same pixels."""
        image = bgr_image(self.frame)
        if self.axes == UPRIGHT:
            return image
        x_from_x, y_from_x, x_from_y, y_from_y = self.axes
        if y_from_x:
            return np.ascontiguousarray(image.swapaxes(0, 1)[::y_from_x, ::x_from_y])
        return np.ascontiguousarray(image[::y_from_y, ::x_from_x])


@dataclass(frozen=True, slots=True)
class VideoFrame:
    """One image of a video."""

    # number of the frame in its file, from 0; skipped, dropped and missing frames are counted too
    index: int
    time_s: float  # timestamp in the file, including the stream's start offset; strictly increasing
    image: Image  # (H, W, 3) uint8 BGR, upright
    # the same image in the decoder's native format; None = not available
    decoded: DecodedImage | None = field(default=None, repr=False, compare=False)

    @property
    def n_packed_bytes(self) -> int:
        """Size in memory of the image in the smaller format."""
        return self.image.nbytes if self.decoded is None else self.decoded.n_bytes

    def packed(self) -> Callable[[], VideoFrame]:
        """A function that returns this frame but stores its image only in the smaller format."""
        # not the frame, which holds the image
        decoded, index, time_s = self.decoded, self.index, self.time_s
        if decoded is None:
            return lambda: self
        return lambda: VideoFrame(index, time_s, decoded.to_bgr(), decoded)


@dataclass(frozen=True, slots=True)
class RecordedFrame:
    """The images of one or two cameras at one time, before they are rectified."""

    index: int  # number of the frame
    time_s: float  # since the first frame
    images: tuple[Image, ...]  # of the left or only camera, and of the right one
    utc_s: float = math.nan  # NaN = unknown


def bgr_image(frame: av.VideoFrame) -> Image:
    """A decoded frame as (H, W, 3) uint8 BGR, converted in the calling thread.

    `frame.to_ndarray(format="bgr24")` has the same pixels, but starts a converter with several
    threads for each frame, which takes twice the processor time and exists until Python's garbage
    collector finds the frame.
    """
    if not hasattr(_reformatters, "converter"):
        _reformatters.converter = VideoReformatter()
    converted = _reformatters.converter.reformat(frame, format="bgr24", threads=1)
    return np.asarray(converted.to_ndarray(), np.uint8)


def stated_pixel_aspect(ratio: Fraction | None, *, is_turned: bool = False) -> float | None:
    """Width / height of the pixels of upright images, from the sample aspect ratio of a stream or
    decoder; None = not stated, or not plausible.

    `is_turned`: the stored images are turned by a quarter.
    """
    stored = float(ratio or 0)
    if not 1 / _MAX_PIXEL_ASPECT <= stored <= _MAX_PIXEL_ASPECT:
        return None
    return 1 / stored if is_turned else stored


def is_neutral(image: Image) -> bool:
    """Whether a BGR image has no colour: its channels are equal except for compression noise."""
    sample = image[::4, ::4].astype(np.int16)
    return bool((np.ptp(sample, axis=2) <= _NEUTRAL_DIFFERENCE).mean() >= _NEUTRAL_FRACTION)


def strictly_later(
    stamp_s: float | None, last_s: float | None, *, interval_s: float
) -> float | None:
    """The time of a frame with timestamp `stamp_s` after a frame at `last_s`; None = repeated or
    backward timestamp.

    A frame without a timestamp gets the last time plus one nominal interval, or 0 if it is the
    first.
    """
    if stamp_s is None:
        return 0.0 if last_s is None else last_s + interval_s
    return stamp_s if last_s is None or stamp_s > last_s + TIME_EPSILON_S else None
