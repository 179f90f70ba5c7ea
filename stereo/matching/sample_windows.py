"""BoxWindows: a grid of small windows over the inner half of each box; GreyLevels: the image pyramid they sample.

+---------------------+     Every box is sampled by the same number of windows of the same size, so that all boxes of a
|    # # # # # #      |     frame form one array. Large boxes are sampled in a smaller image: level l is the image
|    # # # # # #      |     shrunk by 2^l, in which disparities are 2^l times smaller.
|    # # # # # #      |
+---------------------+     Windows of small boxes overlap.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.stereo.geometry.frames import ImageView

MARGIN_PX = 2
"""Pixels read around a window: half the width of the 5 x 5 census."""

WINDOW_HW = (7, 9)
"""(height, width) of a window, px of its level."""

MAX_LEVEL = 2
"""Highest level of the image pyramid: the image shrunk by 4."""


class SamplingGrid(NamedTuple):
    """Density of the samples in boxes.

    Attributes:
        n: windows per row, and per column.
        max_inner_hw: largest (height, width) of a box's inner half, px of its level; larger ones are shrunk.
    """

    n: int
    max_inner_hw: tuple[int, int]


FINE_GRID = SamplingGrid(6, (64, 128))
"""Grid for the measurement around a prior."""

COARSE_GRID = SamplingGrid(3, (10, 20))
"""Grid for the search of the full range, which has a few dozen disparities at this size."""

_INNER_SHARE = 0.5
"""Fraction of a box's width and height that is sampled, around its centre, with little background."""


@dataclass(frozen=True, slots=True)
class BoxWindows:
    """The windows of N boxes; G per box, a square grid row by row.

    Attributes:
        level: (N,) 0, 1 or 2: the image shrunk by 2^level.
        column: (N, G) first column of each window at its level.
        row: (N, G) first row.
    """

    level: IntArray
    column: IntArray
    row: IntArray

    @classmethod
    def of_boxes(cls, xyxy_px: FloatArray, image_hw: tuple[int, int], *, grid: SamplingGrid = FINE_GRID) -> BoxWindows:
        """Windows of finite boxes (N, 4) inside the image, which must have room for a window with its margin."""
        size_px = xyxy_px[:, 2:] - xyxy_px[:, :2]
        excess = (size_px * _INNER_SHARE / np.array(grid.max_inner_hw[::-1])).max(axis=1)
        level_hw = np.array(image_hw) // (2 ** np.arange(MAX_LEVEL + 1))[:, None]
        has_room = (level_hw >= np.array(WINDOW_HW) + 2 * MARGIN_PX).all(axis=1)
        largest = max(int(has_room.sum()) - 1, 0)
        level = np.clip(np.ceil(np.log2(np.maximum(excess, 1.0))), 0, largest).astype(np.int64)
        boxes = (xyxy_px + 0.5) / (2.0**level)[:, None] - 0.5
        height, width = level_hw[level].T
        column = _spread(boxes[:, 0], boxes[:, 2], WINDOW_HW[1], width, grid.n)
        row = _spread(boxes[:, 1], boxes[:, 3], WINDOW_HW[0], height, grid.n)
        shape = (len(boxes), grid.n, grid.n)
        return cls(
            level,
            np.broadcast_to(column[:, None, :], shape).reshape(len(boxes), -1),
            np.broadcast_to(row[:, :, None], shape).reshape(len(boxes), -1),
        )

    @property
    def scale(self) -> FloatArray:
        """(N,) pixels of the image per pixel of the level."""
        return np.asarray(2.0**self.level)

    @property
    def n_pixels(self) -> FloatArray:
        """(N,) largest number of pixels of the level that the windows cover together."""
        height, width = WINDOW_HW
        rows = np.ptp(self.row, axis=1) + height
        columns = np.ptp(self.column, axis=1) + width
        return np.asarray(np.minimum(rows * columns, self.row.shape[1] * height * width), np.float64)

    def normalized_positions(self) -> tuple[FloatArray, FloatArray]:
        """U and v, (N, G) each: position of a window in the box's inner half, to the right and down, -0.5 .. 0.5."""
        return _normalized(self.column), _normalized(self.row)

    def required_pixels(self, smallest: IntArray, largest: IntArray, image_hw: tuple[int, int]) -> IntArray:
        """(N, 4) rectangles of pixels needed for the disparities `smallest` .. `largest` (N,), px of the box's level.

        Left, top, right, bottom, with exclusive ends; multiples of the coarsest level's pixels.
        """
        unit = 1 << MAX_LEVEL
        scale = self.scale.astype(np.int64)
        corners = np.stack(
            [
                (self.column.min(axis=1) - largest - MARGIN_PX) * scale // unit * unit,
                (self.row.min(axis=1) - MARGIN_PX) * scale // unit * unit,
                -(-(self.column.max(axis=1) - np.minimum(smallest, 0) + WINDOW_HW[1] + MARGIN_PX) * scale // unit)
                * unit,
                -(-(self.row.max(axis=1) + WINDOW_HW[0] + MARGIN_PX) * scale // unit) * unit,
            ],
            axis=1,
        )
        height, width = image_hw
        return np.asarray(np.clip(corners, 0, [width, height, width, height]))


def _spread(first: FloatArray, last: FloatArray, side: int, image_side: IntArray, n: int) -> IntArray:
    """(N, n) starts of windows of length `side`, evenly spaced over the inner half of first .. last, in the image."""
    centre, reach = (first + last) / 2, _INNER_SHARE * (last - first) / 2
    start = np.minimum(centre - reach, centre - side / 2)
    end = np.maximum(centre + reach - side, centre - side / 2)
    starts = np.rint(start[:, None] + 0.5 + (end - start)[:, None] * np.linspace(0, 1, n)).astype(np.int64)
    return np.clip(starts, MARGIN_PX, (image_side - MARGIN_PX - side)[:, None])


def _normalized(start: IntArray) -> FloatArray:
    """(N, G) starts of windows, mapped to -0.5 .. 0.5 over the range of each row."""
    low, high = start.min(axis=1, keepdims=True), start.max(axis=1, keepdims=True)
    return np.asarray((start - (low + high) / 2) / np.maximum(high - low, 1))


@dataclass(frozen=True, slots=True)
class GreyLevels:
    """An image pyramid: the grey image, and the image shrunk by 2 and 4, in one flat array.

    Attributes:
        pixels: (P,) pixels of all levels, row by row.
        begin: (L,) index of the first pixel of each level.
        width: (L,) number of columns of each level.
    """

    pixels: npt.NDArray[np.uint8]
    begin: IntArray
    width: IntArray

    @classmethod
    def of(cls, image: Image, n_levels: int) -> GreyLevels:
        """The first `n_levels` levels of an image (H, W) or (H, W, 3)."""
        grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8) if image.ndim == 3 else image
        levels = [np.ascontiguousarray(grey)]
        for _ in range(n_levels - 1):
            larger = levels[-1]
            even = larger[: len(larger) // 2 * 2, : larger.shape[1] // 2 * 2]
            size = (even.shape[1] // 2, even.shape[0] // 2)
            levels.append(np.asarray(cv2.resize(even, size, interpolation=cv2.INTER_AREA), np.uint8))
        sizes = np.array([level.size for level in levels])
        return cls(
            np.concatenate([level.ravel() for level in levels]) if n_levels > 1 else levels[0].ravel(),
            np.cumsum(sizes) - sizes,
            np.array([level.shape[1] for level in levels]),
        )

    def windows(self, windows: BoxWindows, column: IntArray, *, width: int) -> npt.NDArray[np.uint8]:
        """(H + 4, width + 4, N * G) pixels of windows that start at columns (N, G), with the margin of the census.

        Columns outside the image repeat its border.
        """
        margin = MARGIN_PX
        rows = np.arange(-margin, WINDOW_HW[0] + margin)[:, None, None, None]
        columns = np.arange(-margin, width + margin)[:, None, None]
        image_width = self.width[windows.level][:, None]
        inside = np.clip(column + columns, 0, image_width - 1)
        index = self.begin[windows.level][:, None] + (windows.row + rows) * image_width + inside
        return np.asarray(self.pixels.take(index, mode="wrap")).reshape(index.shape[0], index.shape[1], -1)


def band_of(view: ImageView, boxes: IntArray) -> Image:
    """The image rows from the highest top to the lowest bottom of boxes (N, 4), with exclusive ends.

    An array is sliced without copying; a lazily computed view is computed only within the boxes, and black elsewhere.
    """
    top, bottom = int(boxes[:, 1].min()), int(boxes[:, 3].max())
    if isinstance(view, np.ndarray):
        return view[top:bottom]
    band: Image | None = None
    for left, first, right, last in boxes.tolist():
        crop = view[first:last, left:right]
        if band is None:
            band = np.zeros((bottom - top, view.shape[1], *crop.shape[2:]), np.uint8)
        band[first - top : last - top, left:right] = crop
    return np.zeros((0, 0), np.uint8) if band is None else band
