"""The inner half of a box: its central half in width and height, which contains the object and little background.

+-----------------+
|    +-------+    |     The patch matcher and the median of the dense disparities use the same patch,
|    | inner |    |     so that the two methods are compared on the same pixels.
|    +-------+    |
+-----------------+
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray

_FRACTION_CUT = 0.25  # fraction of the box's width (height) that is cut off on each side


class Patch(NamedTuple):
    """A rectangle of pixels; all four edges are inclusive."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def window(self) -> tuple[slice, slice]:
        """Index of the pixels in an image."""
        return np.s_[self.top : self.bottom + 1, self.left : self.right + 1]


def inner_halves(
    xyxy_px: FloatArray, image_hw: tuple[int, int], *, margin_px: int, min_side_px: int
) -> Iterator[Patch | None]:
    """The inner half of each box (N, 4), clipped at `margin_px` from the image border.

    None where fewer than `min_side_px` columns or rows are left, or the box is not finite or inverted.
    """
    height, width = image_hw
    with np.errstate(invalid="ignore", over="ignore"):  # infinite boxes become NaN, which gives no patch
        cut = (xyxy_px[:, 2:] - xyxy_px[:, :2]) * _FRACTION_CUT
        first = np.maximum(np.ceil(xyxy_px[:, :2] + cut), margin_px)
        last = np.minimum(np.floor(xyxy_px[:, 2:] - cut), np.array([width, height]) - 1.0 - margin_px)
    big_enough = (last - first + 1 >= min_side_px).all(axis=1)  # False for NaN too
    for i, usable in enumerate(np.asarray(big_enough).tolist()):
        yield Patch(*first[i].astype(np.int64).tolist(), *last[i].astype(np.int64).tolist()) if usable else None
