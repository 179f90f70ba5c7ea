"""Frame: the image of one camera, or of two synchronised cameras, at one time."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Protocol

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray32, Image
from track_range.stereo.geometry.alignment import Alignment


class ImageView(Protocol):
    """An image that may be computed only where it is read; every array is an `ImageView`."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W) or (H, W, 3)."""
        ...

    def __getitem__(self, window: tuple[slice, slice], /) -> Image:
        """The pixels of `[top:bottom, start:end]`, as with an array."""
        ...


def whole_image(view: ImageView) -> Image:
    """The entire image, (H, W) or (H, W, 3)."""
    return view if isinstance(view, np.ndarray) else view[:, :]


def grey(image: Image) -> Image:
    """An image (H, W) or (H, W, 3) BGR in grey."""
    return (
        np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8) if image.ndim == 3 else image
    )


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame of a video or stereo video; the arrays are never modified."""

    index: int  # frame number in the left video, from 0, including skipped frames
    time_s: float  # seconds from the left video's first frame, from the file's timestamps
    left: Image  # (H, W, 3) uint8 BGR, rectified (one camera: undistorted)
    # rectified right image of equal size, in colour or grey, possibly computed only where it is
    # read (`whole_image` gives all of it); None for one camera
    right: ImageView | None
    # time of the frame in seconds since 1970-01-01 00:00 UTC; NaN = unknown
    utc_s: float = math.nan
    # left image of a wide lens before it was undistorted; None for other lenses
    recorded: Image | None = None
    # correction of the disparities of these images, as known at their time; None = that of the rig
    alignment: Alignment | None = None
    # (h, w) depth z in m that the camera recorded, NaN = unknown, of the whole left image, perhaps
    # at another resolution; None = it recorded none
    depth_m: FloatArray32 | None = None

    def __reduce__(self) -> tuple[type[Frame], tuple[object, ...]]:
        """Pickled with all of its right image."""
        values = [getattr(self, field.name) for field in fields(self)]
        right = None if self.right is None else whole_image(self.right)
        return Frame, (*values[:3], right, *values[4:])

    def __repr__(self) -> str:
        height, width = self.left.shape[:2]
        cameras = "one camera" if self.right is None else "two cameras"
        return (
            f"Frame(index={self.index}, time_s={self.time_s:.3f}, {width} x {height} px, {cameras})"
        )
