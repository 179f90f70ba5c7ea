"""BoxTiles: each box of a frame resampled to a tile of the same size, with the strip of the right
image it may match.

+---+---+---+---+     A tile has 8 x 8 cells; each 2 x 2 cells are a window, so that 7 x 7 windows overlap by half.
|   |   |   |   |     All boxes of a frame form one array, whatever their size: large boxes are shrunk to the tile, and
+---+---+---+---+     small boxes are not enlarged: their tile also shows what surrounds them, and the windows outside
|   | window|   |     the box are not used. Scales are multiples of a quarter, so that all tiles of a strip begin at
+---+  2x2  +---+     whole pixels.
|   | cells |   |
+---+---+---+---+     Pixels are (columns, boxes, rows): one operation runs over all boxes, a disparity is an offset of
                      the first axis, and the rows of a cell are neighbours in memory.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32, Image
from track_range.stereo.geometry.frames import ImageView, grey

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
    both: Grey  # (2 W + 16 + D - 1, N, H + 8) grey values: `left` and, after it, `right`
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
        """(W + 8, N, H + 8) grey values of the left image, with a margin of 4 px."""
        return self.both[: self.shape.hw[1] + 2 * MARGIN_PX]

    @property
    def right(self) -> Grey:
        """(W + 8 + D - 1, N, H + 8) grey values of the right image."""
        return self.both[self.shape.hw[1] + 2 * MARGIN_PX :]

    @property
    def first(self) -> FloatArray:
        """(N,) disparity of index 0, px of the tile."""
        return np.asarray(self.first_px / self.scale[0])

    def disparity_px(self, index: FloatArray) -> FloatArray:
        """(N, ...) disparities in px of the image at indices (N, ...)."""
        shape = (-1, *(1,) * (index.ndim - 1))
        return np.asarray(self.first_px.reshape(shape) + index * self.scale[0].reshape(shape))

    def pixel_positions(self) -> tuple[FloatArray, FloatArray]:
        """U (W, N) of the columns and v (N, H) of the rows of the tiles, without the margin."""
        row, column = (_pixels_in_cells(cell) for cell in self.shape.cell_hw)
        step_u, step_v = self.u[:, 1] - self.u[:, 0], self.v[:, N_SIDE] - self.v[:, 0]
        return self.u[:, 0] + column[:, None] * step_u, self.v[:, :1] + row * step_v[:, None]


def tile_scale(xyxy_px: FloatArray, shape: TileShape) -> FloatArray:
    """(2, N) scales in x and y of the tiles of boxes (N, 4)."""
    size_px = (xyxy_px[:, 2:] - xyxy_px[:, :2]).T
    tile_wh = np.array(shape.hw[::-1])[:, None]
    required = np.maximum(_BOX_FRACTION * size_px / tile_wh, shape.min_scale)
    required = np.minimum(required, _MAX_ASPECT * required[::-1])
    allowed = _SCALES * (shape.min_scale / FINE.min_scale)
    return np.asarray(allowed.take(allowed.searchsorted(required - 1e-9), mode="clip"))


def box_tiles(
    left: Image,
    right: ImageView,
    xyxy_px: FloatArray,
    first_px: FloatArray,
    n_disparities: int,
    shape: TileShape,
    *,
    scale: FloatArray | None = None,
) -> BoxTiles:
    """The tiles of boxes (N, 4) inside the left image, grey or BGR; only their pixels and strips
    are read.

    `first_px` (N,) are the smallest disparities, rounded to whole pixels, `n_disparities` is the
    smallest D, `scale` (2, N) the result of `tile_scale` if it is known.
    """
    n_disparities = -(-(n_disparities - 1) // _STEPS_MULTIPLE) * _STEPS_MULTIPLE + 1
    height, width = (side + 2 * MARGIN_PX for side in shape.hw)
    strip_width = width + n_disparities - 1
    if scale is None:
        scale = tile_scale(xyxy_px, shape)
    centre_px = (xyxy_px[:, :2] + xyxy_px[:, 2:]).T / 2 + 0.5  # coordinates of pixel edges
    side_px = np.array([[width], [height]]) * scale
    start_px = np.rint(centre_px - side_px / 2)
    # Column j of the strip shows the tile's column j at the largest disparity.
    range_px = (n_disparities - 1) * scale[0]
    strip_px = start_px[0] - np.ceil(np.rint(first_px) + range_px)
    # (N, 6) left, right and strip's left and right edge, then top and bottom of the tiles, whole px
    strip_end_px = strip_px + strip_width * scale[0]
    end_px = start_px + side_px
    edges = np.stack([start_px[0], end_px[0], strip_px, strip_end_px, start_px[1], end_px[1]], 1)
    image_hw = left.shape[0], left.shape[1]
    tile_hw = height, width + strip_width
    both = _resampled(left, right, np.rint(edges), tile_hw)
    column_px = strip_px + (np.arange(strip_width)[:, None] + 0.5) * scale[0]
    start = start_px / scale
    centre = centre_px / scale - start - MARGIN_PX
    size = (xyxy_px[:, 2:] - xyxy_px[:, :2]).T / scale
    image_size = np.array(image_hw[::-1])[:, None] / scale
    return BoxTiles(
        shape,
        both,
        scale,
        start_px[0] - strip_px - range_px,
        n_disparities,
        *_windows(centre, size, start, image_size, shape),
        (column_px > 0) & (column_px < image_hw[1]),
    )


def _windows(
    centre: FloatArray,
    size: FloatArray,
    start: FloatArray,
    image_size: FloatArray,
    shape: TileShape,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """U, v (N, G) of the windows' centres, and whether the windows are inside the box and the image.

    All (2, N) in x and y, px of the tile: centre of the box from the tile's first pixel, size of
    the box, the tile's first pixel with its margin from that of the image, size of the image.
    """
    cell = np.array(shape.cell_hw[::-1])[:, None]
    first = (np.arange(N_SIDE) * cell)[:, None]  # (2, 1, 7) first pixels of the windows
    position = (first + (cell - centre)[..., None]) / size[..., None]  # (2, N, 7)
    distance = np.abs(position)
    # In a small box, even the windows nearest to its centre may reach beyond it.
    limit = np.maximum(0.5 - _OVERHANG * 2 * cell / size, distance.min(axis=2) + 1e-6)
    in_image = first + (start + MARGIN_PX)[..., None]
    is_used = distance <= limit[..., None]
    is_used &= (in_image >= -0.5) & (in_image <= (image_size + 0.5 - 2 * cell)[..., None])
    grid = np.empty((2, size.shape[1], N_SIDE, N_SIDE))
    grid[0], grid[1] = position[0][:, None], position[1][..., None]
    u, v = grid.reshape(2, -1, N_WINDOWS)
    return u, v, (is_used[1][:, :, None] & is_used[0][:, None]).reshape(u.shape)


def _resampled(left: Image, right: ImageView, edges: FloatArray, tile_hw: tuple[int, int]) -> Grey:
    """(W', N, H) means of the grey pixels between edges (N, 6) as in `box_tiles`, the tile and the
    strip of a box in a row of W' pixels; outside the images, their border is repeated.
    """
    n, (height, width) = len(edges), left.shape[:2]
    limits = np.array([width] * 4 + [height] * 2)
    inside = np.minimum(np.maximum(edges, 0), limits)
    border = np.abs(inside - edges).astype(np.int64)
    is_cut = border.any(axis=1).tolist()
    both = np.empty((n, *tile_hw), np.uint8)
    for i, (x1, x2, strip_x1, strip_x2, y1, y2) in enumerate(inside.astype(np.int64).tolist()):
        tile, strip = left[y1:y2, x1:x2], right[y1:y2, strip_x1:strip_x2]
        if is_cut[i]:
            start, end, strip_start, strip_end, top, bottom = border[i].tolist()
            tile = _padded_grey(tile, (top, bottom, start, end))
            strip = _padded_grey(strip, (top, bottom, strip_start, strip_end))
        else:
            tile, strip = grey(tile), grey(strip)
        # One call resamples both: their widths are whole pixels of the image and of the tile.
        row = cv2.hconcat((tile, strip))
        if row.shape != tile_hw:
            row = cv2.resize(row, tile_hw[::-1], interpolation=cv2.INTER_AREA)
        both[i] = row
    columns = cv2.transpose(both.reshape(-1, tile_hw[1]))
    return np.asarray(columns, np.uint8).reshape(-1, n, tile_hw[0])


def _padded_grey(image: Image, border: tuple[int, int, int, int]) -> Grey:
    """A part of an image in grey with its border repeated at the top, bottom, left and right; black
    where there is no part.
    """
    if image.size:
        return np.asarray(cv2.copyMakeBorder(grey(image), *border, cv2.BORDER_REPLICATE), np.uint8)
    top, bottom, start, end = border
    return np.zeros((image.shape[0] + top + bottom, image.shape[1] + start + end), np.uint8)


def window_sums(
    values: FloatArray32, cell_hw: tuple[int, int], *, column_step: int = 1
) -> FloatArray32:
    """(K, N, G) sums over the windows of K arrays (K, W, N, H).

    Of every `column_step`-th column, the arrays hold W / column_step columns.
    """
    n_arrays, _, n, height = values.shape
    by_cell = values.reshape(n_arrays, N_CELLS, cell_hw[1] // column_step, n * height).sum(axis=2)
    across = (by_cell[:, :-1] + by_cell[:, 1:]).reshape(-1, height)
    sums = across @ _window_matrix(cell_hw[0])
    by_box = sums.reshape(n_arrays, N_SIDE, n, N_SIDE).transpose(0, 2, 3, 1)
    return np.asarray(by_box.reshape(n_arrays, n, N_WINDOWS))


@lru_cache
def _pixels_in_cells(cell: int) -> FloatArray:
    """(8 * cell,) places of the pixels along one axis from the centre of the first window, in cells."""
    return (np.arange(N_CELLS * cell) + 0.5 - cell) / cell


@lru_cache
def _window_matrix(cell: int) -> FloatArray32:
    """(8 * cell, 7) masks of the windows along one axis: 1 = the pixel belongs to the window."""
    first, pixel = cell * np.arange(N_SIDE), np.arange(N_CELLS * cell)[:, None]
    return np.asarray((pixel >= first) & (pixel < first + 2 * cell), np.float32)
