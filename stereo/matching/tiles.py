"""BoxTiles: each box of a frame resampled to a tile of the same size, with the strip of the right
image it may match.

+---+---+---+---+     A tile has 8 x 8 cells; each 2 x 2 cells are a window, so that 7 x 7 windows overlap by half.
|   |   |   |   |     All boxes of a frame form one array, whatever their size: large boxes are shrunk to the tile, and
+---+---+---+---+     small boxes are not enlarged: their tile also shows what surrounds them, and the windows outside
|   | window|   |     the box are not used. Scales are multiples of a quarter, so that all tiles of a strip begin at
+---+  2x2  +---+     whole pixels.
|   | cells |   |
+---+---+---+---+     Arrays are (rows, columns, boxes): each numpy operation runs over all boxes.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32, Image, IntArray
from track_range.stereo.geometry.frames import ImageView

Grey = npt.NDArray[np.uint8]
N_CELLS = 8  # cells per row and per column of a tile
N_SIDE = N_CELLS - 1  # windows per row and per column of a tile
N_WINDOWS = N_SIDE**2  # windows per tile, G
# pixels around a tile that are read as well: for the census (2), smoothing and derivatives (2)
MARGIN_PX = 4
# of a box's sides that its tile covers, around its centre; the rest is mostly background
_BOX_FRACTION = 0.65
# largest ratio of the scales in x and y: of longer boxes, the tile shows the middle
_MAX_ASPECT = 4.0
# smallest distance of a used window's centre from the box's edges, in window sizes
_OVERHANG = 0.25
# Possible scales of tiles, px of the image per px of the tile.
_SCALES = np.concatenate(
    [np.arange(1.0, 2.0, 0.25), np.arange(2.0, 4.0, 0.5), np.arange(4, 8), 2.0 ** np.arange(3, 8)]
)
_STEPS_MULTIPLE = 4  # D - 1 is a multiple of this, so that strips end at whole pixels at each scale


class TileShape(NamedTuple):
    """Resolution of a tile."""

    cell_hw: tuple[int, int]  # height and width of a cell, px of the tile
    min_scale: float  # smallest scale, px of the image per px of the tile

    @property
    def hw(self) -> tuple[int, int]:
        """Height and width of a tile without its margin."""
        return N_CELLS * self.cell_hw[0], N_CELLS * self.cell_hw[1]

    @property
    def window_px(self) -> int:
        """Number of pixels of a window."""
        return 4 * self.cell_hw[0] * self.cell_hw[1]


FINE = TileShape((4, 6), 1.0)  # tiles for the measurement
COARSE = TileShape((2, 3), 2.0)  # tiles for the search of the full range of disparities
# smallest image that contains a window, px
MIN_IMAGE_HW = (FINE.cell_hw[0] * 2 + 3, FINE.cell_hw[1] * 2 + 1)


@dataclass(frozen=True, slots=True)
class BoxTiles:
    """The tiles of N boxes, and the strips of the right image for D disparities.

    Window g at disparity index k of a tile matches the strip's columns that start D - 1 - k further
    right.
    """

    shape: TileShape  # resolution of the tiles
    both: Grey  # (H + 8, 2 W + 16 + D - 1, N) grey values: `left` and, beside it, `right`
    scale: FloatArray  # (2, N) px of the image per px of the tile, in x and in y
    # (N,) disparity of index 0 in px of the image; that of index k is first_px + k scale[0]
    first_px: FloatArray
    n_disparities: int  # D
    # (N, G) position of a window's centre to the right of the box's centre, divided by the box's
    # width
    u: FloatArray
    v: FloatArray  # (N, G) position below the box's centre, divided by the box's height
    is_used: BoolArray  # (N, G) windows inside the box and the left image
    is_seen: BoolArray  # (W + 8 + D - 1, N) columns of the strip inside the right image

    @property
    def left(self) -> Grey:
        """(H + 8, W + 8, N) grey values of the left image, with a margin of 4 px."""
        return self.both[:, : self.shape.hw[1] + 2 * MARGIN_PX]

    @property
    def right(self) -> Grey:
        """(H + 8, W + 8 + D - 1, N) grey values of the right image."""
        return self.both[:, self.shape.hw[1] + 2 * MARGIN_PX :]

    @property
    def first(self) -> FloatArray:
        """(N,) disparity of index 0, px of the tile."""
        return np.asarray(self.first_px / self.scale[0])

    def disparity_px(self, index: FloatArray) -> FloatArray:
        """(N, ...) disparities in px of the image at indices (N, ...)."""
        shape = (-1, *(1,) * (index.ndim - 1))
        return np.asarray(self.first_px.reshape(shape) + index * self.scale[0].reshape(shape))

    def pixel_positions(self) -> tuple[FloatArray, FloatArray]:
        """U (W, N) of the columns and v (H, N) of the rows of the tiles, without the margin."""
        (height, width), (cell_height, cell_width) = self.shape.hw, self.shape.cell_hw
        column = np.arange(width)[:, None] + 0.5 - cell_width
        row = np.arange(height)[:, None] + 0.5 - cell_height
        step_u, step_v = self.u[:, 1] - self.u[:, 0], self.v[:, N_SIDE] - self.v[:, 0]
        return self.u[:, 0] + column * step_u / cell_width, self.v[
            :, 0
        ] + row * step_v / cell_height


def tile_scale(xyxy_px: FloatArray, shape: TileShape) -> FloatArray:
    """(2, N) scales in x and y of the tiles of boxes (N, 4)."""
    size_px = (xyxy_px[:, 2:] - xyxy_px[:, :2]).T
    required = np.maximum(
        _BOX_FRACTION * size_px / np.array(shape.hw[::-1])[:, None], shape.min_scale
    )
    required = np.minimum(required, _MAX_ASPECT * required[::-1])
    allowed = _SCALES * (shape.min_scale / FINE.min_scale)
    return np.asarray(
        allowed[np.minimum(np.searchsorted(allowed, required - 1e-9), len(allowed) - 1)]
    )


def box_tiles(
    left: Image,
    right: ImageView,
    xyxy_px: FloatArray,
    first_px: FloatArray,
    n_disparities: int,
    shape: TileShape,
) -> BoxTiles:
    """The tiles of boxes (N, 4) inside the left image, grey or BGR; only their pixels and strips
    are read.

    `first_px` (N,) are the smallest disparities, rounded to whole pixels, `n_disparities` is the
    smallest D.
    """
    n_disparities = -(-(n_disparities - 1) // _STEPS_MULTIPLE) * _STEPS_MULTIPLE + 1
    n, (height, width) = len(xyxy_px), shape.hw
    scale = tile_scale(xyxy_px, shape)
    centre_px = (xyxy_px[:, :2] + xyxy_px[:, 2:]).T / 2 + 0.5  # coordinates of pixel edges
    tile_wh = np.array([[width + 2 * MARGIN_PX], [height + 2 * MARGIN_PX]])
    start_px = np.rint(centre_px - tile_wh * scale / 2).astype(np.int64)
    # Column j of the strip shows the tile's column j at the largest disparity.
    reach_px = np.rint(first_px) + (n_disparities - 1) * scale[0]
    strip_px = start_px[0] - np.ceil(reach_px).astype(np.int64)
    first_px = start_px[0] - strip_px - (n_disparities - 1) * scale[0]
    strip_width = width + 2 * MARGIN_PX + n_disparities - 1

    both = np.empty((n, tile_wh[1, 0], tile_wh[0, 0] + strip_width), np.uint8)
    left_tiles, strips = both[:, :, : tile_wh[0, 0]], both[:, :, tile_wh[0, 0] :]
    tops, starts = start_px[1].tolist(), start_px[0].tolist()
    bottoms = np.rint(start_px[1] + tile_wh[1] * scale[1]).astype(np.int64).tolist()
    ends = np.rint(start_px[0] + tile_wh[0] * scale[0]).astype(np.int64).tolist()
    strip_ends = np.rint(strip_px + strip_width * scale[0]).astype(np.int64).tolist()
    for i, strip_start in enumerate(strip_px.tolist()):
        _resample(left, tops[i], bottoms[i], starts[i], ends[i], left_tiles[i])
        _resample(right, tops[i], bottoms[i], strip_start, strip_ends[i], strips[i])

    column_px = strip_px + (np.arange(strip_width)[:, None] + 0.5) * scale[0]
    u, v, is_used = _window_positions(
        xyxy_px, (centre_px - start_px) / scale - MARGIN_PX, scale, shape
    )
    is_used &= _is_inside(start_px, scale, shape, (left.shape[0], left.shape[1]))
    return BoxTiles(
        shape,
        np.ascontiguousarray(both.transpose(1, 2, 0)),
        scale,
        np.asarray(first_px, np.float64),
        n_disparities,
        u,
        v,
        is_used,
        (column_px > 0) & (column_px < left.shape[1]),
    )


def _window_positions(
    xyxy_px: FloatArray, centre: FloatArray, scale: FloatArray, shape: TileShape
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """U, v (N, G) of the windows' centres, and whether they are inside the box; `centre` (2, N) of
    the box in px.
    """
    size = (xyxy_px[:, 2:] - xyxy_px[:, :2]).T / scale
    steps = np.arange(1, N_SIDE + 1)
    u = (steps * shape.cell_hw[1] - centre[0][:, None]) / size[0][:, None]
    v = (steps * shape.cell_hw[0] - centre[1][:, None]) / size[1][:, None]
    u, v = np.tile(u, (1, N_SIDE)), np.repeat(v, N_SIDE, axis=1)
    # In a small box, even the windows nearest to its centre may reach beyond it.
    inside = 0.5 - _OVERHANG * 2 * np.array(shape.cell_hw[::-1])[:, None] / size
    limit_u = np.maximum(inside[0][:, None], np.abs(u).min(axis=1, keepdims=True) + 1e-6)
    limit_v = np.maximum(inside[1][:, None], np.abs(v).min(axis=1, keepdims=True) + 1e-6)
    return u, v, (np.abs(u) <= limit_u) & (np.abs(v) <= limit_v)


def _is_inside(
    start_px: IntArray, scale: FloatArray, shape: TileShape, image_hw: tuple[int, int]
) -> BoolArray:
    """(N, G) windows of tiles that lie entirely in the left image."""
    inside = []
    for axis, (cell, side_px) in enumerate(zip(shape.cell_hw[::-1], image_hw[::-1], strict=True)):
        first = np.arange(N_SIDE) * cell + MARGIN_PX
        first_px = start_px[axis][:, None] + first * scale[axis][:, None]
        last_px = first_px + 2 * cell * scale[axis][:, None]
        inside.append(
            (first_px >= -0.5 * scale[axis][:, None])
            & (last_px <= side_px + 0.5 * scale[axis][:, None])
        )
    return np.asarray((inside[1][:, :, None] & inside[0][:, None, :]).reshape(len(scale[0]), -1))


def _resample(image: ImageView, top: int, bottom: int, start: int, end: int, tile: Grey) -> None:
    """Fill a tile with means of the grey pixels [top:bottom, start:end]; outside the image, its
    border is repeated.
    """
    height, width = image.shape[:2]
    inside = max(top, 0), min(bottom, height), max(start, 0), min(end, width)
    if inside[0] >= inside[1] or inside[2] >= inside[3]:
        tile[:] = 0
        return
    crop = image[inside[0] : inside[1], inside[2] : inside[3]]
    grey = cv2.cvtColor(crop, cv2.COLOR_BGR2GRAY) if crop.ndim == 3 else crop
    if inside != (top, bottom, start, end):
        border = (inside[0] - top, bottom - inside[1], inside[2] - start, end - inside[3])
        grey = cv2.copyMakeBorder(grey, *border, cv2.BORDER_REPLICATE)
    tile[:] = (
        grey
        if grey.shape == tile.shape
        else cv2.resize(grey, tile.shape[::-1], interpolation=cv2.INTER_AREA)
    )


def window_sums(values: FloatArray32, cell_hw: tuple[int, int]) -> FloatArray32:
    """(K, 7, 7, N) sums over the windows of K arrays (K, H, W, N), as products with matrices of 0
    and 1.
    """
    n_arrays, height, width, n = values.shape
    down = _window_matrix(cell_hw[0]) @ values.reshape(n_arrays, height, width * n)
    return np.asarray(_window_matrix(cell_hw[1]) @ down.reshape(n_arrays, N_SIDE, width, n))


@lru_cache
def _window_matrix(cell: int) -> FloatArray32:
    """(7, 8 * cell) masks of the windows along one axis: 1 = the pixel belongs to the window."""
    first, pixel = cell * np.arange(N_SIDE)[:, None], np.arange(N_CELLS * cell)
    return np.asarray((pixel >= first) & (pixel < first + 2 * cell), np.float32)
