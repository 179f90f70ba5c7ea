"""Frame: what one camera, or two in step, saw at one instant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from track_range.foundation.arrays import Image


class ImageView(Protocol):
    """An image that may exist only where it is looked at; each array is one."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W) or (H, W, 3)."""
        ...

    def __getitem__(self, window: tuple[slice, slice], /) -> Image:
        """The pixels of `[top:bottom, start:end]`, as an array's."""
        ...


def whole_image(view: ImageView) -> Image:
    """All of it, (H, W) or (H, W, 3)."""
    return view if isinstance(view, np.ndarray) else view[:, :]


@dataclass(frozen=True, slots=True)
class Frame:
    """One instant of a video; the arrays are never written to.

    Attributes:
        index: number of the frame in the left video, from 0, counting also frames that were skipped.
        time_s: seconds from the left video's first frame, from the file's timestamps.
        left: (H, W, 3) uint8 BGR, rectified (one camera: undistorted).
        right: the same of the right eye, in the same rows, in colour or grey, perhaps rectified only where it is looked
            at (`whole_image` gives all of it); None for one camera.
    """

    index: int
    time_s: float
    left: Image
    right: ImageView | None
