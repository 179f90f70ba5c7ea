"""FixedParts: what stays in its place in the image while the scene moves, and the boxes on it.

Burnt-in text and logos, stickers, things on the dashboard and the outline of the bonnet do not
move by a pixel. All of the scene does while the car drives, also a vehicle that is followed at a
constant distance, since the camera pitches and yaws. So the slopes g = (g_x, g_y), differences of
neighbouring pixels, are compared in N images that show the scene in other places. The part of their
energy that is always the same,

    c = (N |mean g|^2 - mean |g|^2) / ((N - 1) mean |g|^2),

is 1 for what never changes and 0 in the mean for independent images (as in the search for
watermarks of Dekel et al., 2017). An image is compared when most of the textured image has changed
since the one before: while the camera stands, parked cars are as still as text, and nothing is
learnt.

A box is no road user if most of the texture that it shows now is fixed. Texture is counted in small
blocks, since letters have more contrast than a car behind them.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np

from track_range.detection.detections import Detections
from track_range.foundation.arrays import BoolArray, FloatArray32, Image, IntArray
from track_range.foundation.errors import Note
from track_range.foundation.files.input_files import counted

# longer side of the grid of compared pixels; their neighbours are those of the whole image, in
# which the smallest shift shows
_GRID_PX = 420
# shortest time between compared images until something may be fixed, and later: slowly, so that a
# vehicle ahead would have to stay in place for a minute
_FIRST_STEP_S, _STEP_S, _N_REMEMBERED = 0.25, 1.0, 60
# mean squares of slopes in grey levels: of texture, and the least that moves in a block, above the
# noise of a camera and of compression
_TEXTURE, _LEAST_MOVING = 100.0, 30.0
# side of the means in which motion is sought, grid pixels, and the least sum of their mean squared
# slopes in two images, above the noise
_COARSE, _LEAST_COARSE = 2, 150.0
# square tiles along the shorter side of an image; textured ones below which it is too dark to say
# what moves; the change of a tile, relative to independent images, and the fraction that has
# changed
_N_TILES, _MIN_TILES, _MIN_CHANGE, _CHANGED = 8, 8, 0.5, 0.5
# of a fixed pixel: half of the pixels of text have more, hardly any of a vehicle that is followed
_MIN_IMAGES, _MIN_COHERENCE = 6, 0.85
_UNCHANGED = 0.5  # largest change of a fixed slope, relative to its square
# largest distance of the centre of a box from that of the image, of its width and height, in which
# it is kept: near the vanishing point of a straight road, cars do not move either before a steady
# camera, and text is not there
_MIDDLE = (0.2, 0.25)
_BLOCK = 3  # side of the blocks that are counted in boxes, grid pixels
# least fraction of fixed pixels in a box, and of fixed blocks in its textured ones: a car behind
# text has up to 0.05 and 0.4, text and things on the dashboard at least 0.08 and 0.8
_LEAST_FIXED, _MOST_TEXTURE = 0.05, 0.6


def _nothing_fixed() -> BoolArray:
    return np.zeros((0, 0), np.bool_)


@dataclass(slots=True)
class FixedParts:
    """What does not move in the images of one stream, as far as they showed it."""

    n_images: int = 0  # number of compared images, at most those that are remembered
    # (H // stride, W // stride) pixels that do not move with the scene; (0, 0) = not known
    is_fixed: BoolArray = field(default_factory=_nothing_fixed)
    n_left_out: int = 0  # number of boxes that were left out
    # number of fixed pixels above and on the left of each pixel
    _n_fixed: IntArray = field(default_factory=lambda: np.zeros((1, 1), np.int64))
    _last_s: float = -np.inf
    _image_hw: tuple[int, ...] = (0, 0)
    # coarse slopes of the last compared image; mean and mean square of the slopes of all
    _last: FloatArray32 = field(default_factory=lambda: np.zeros((2, 0, 0), np.float32))
    _mean: FloatArray32 = field(default_factory=lambda: np.zeros((2, 0, 0), np.float32))
    _square: FloatArray32 = field(default_factory=lambda: np.zeros((0, 0), np.float32))

    @property
    def notes(self) -> tuple[str, ...]:
        """A note on the boxes that were left out."""
        if self.n_left_out == 0:
            return ()
        return (
            Note(
                "On parts of the image that never move (burnt-in text, things on the dashboard), "
                f"{counted(self.n_left_out, 'box', 'boxes')} left out.",
                "fixed-parts",
                "ok",
                "detector",
            ),
        )

    def add(self, image: Image, time_s: float) -> None:
        """Compare the next image (H, W) or (H, W, 3) BGR, if its time has come; one of another size
        is the first one of another camera.
        """
        is_first = self._image_hw != image.shape[:2]
        step_s = _FIRST_STEP_S if self.n_images < _MIN_IMAGES else _STEP_S
        if not is_first and 0 <= time_s - self._last_s < step_s:
            return
        self._last_s = time_s
        stride_px = _stride_px(image)
        coarse = _coarse_slopes(image, stride_px)
        if is_first:
            self.n_images, self.is_fixed = 0, _nothing_fixed()
            self._last, self._image_hw = coarse, image.shape[:2]
        elif _has_moved(self._last, coarse):
            self._last = coarse
            self._compare(_slopes(image, stride_px))

    def _compare(self, slopes: FloatArray32) -> None:
        """Add slopes in which the scene has moved."""
        if self.n_images == 0:
            self._mean, self._square = np.zeros_like(slopes), np.zeros_like(slopes[0])
        n = self.n_images = min(self.n_images + 1, _N_REMEMBERED)
        self._mean += (slopes - self._mean) / n
        self._square += (_squared(slopes) - self._square) / n
        if n < _MIN_IMAGES:
            return
        same = n * _squared(self._mean) - self._square
        self.is_fixed = same > _MIN_COHERENCE * (n - 1) * np.maximum(self._square, _TEXTURE)
        self._n_fixed = cv2.integral(self.is_fixed.view(np.uint8)).astype(np.int64)

    def moving(self, detections: Detections, image: Image) -> Detections:
        """The detections in the image of the last `add` without those on fixed parts."""
        if not self.is_fixed.size:
            return detections
        edges = np.clip(detections.xyxy_px / _stride_px(image), 0, 2 * self.is_fixed.shape[::-1])
        x1, y1, x2, y2 = edges.astype(np.int64).T
        n = self._n_fixed
        n_fixed = n[y2, x2] - n[y1, x2] - n[y2, x1] + n[y1, x1]
        is_large = (x2 - x1 >= _BLOCK) & (y2 - y1 >= _BLOCK)
        centre = (detections.xyxy_px[:, :2] + detections.xyxy_px[:, 2:]) / 2
        from_middle = np.abs(centre / image.shape[1::-1] - 0.5)
        is_possible = is_large & (n_fixed >= _LEAST_FIXED * (x2 - x1) * (y2 - y1))
        is_possible &= (from_middle > _MIDDLE).any(axis=1)
        if not is_possible.any():
            return detections
        is_moving = np.ones(len(detections), np.bool_)
        for row in np.flatnonzero(is_possible).tolist():  # few: most boxes show no fixed pixel
            window = slice(y1[row], y2[row]), slice(x1[row], x2[row])
            is_moving[row] = not self._is_fixed_in(image, window)
        self.n_left_out += int(np.count_nonzero(~is_moving))
        return detections.select(is_moving)

    def _is_fixed_in(self, image: Image, window: tuple[slice, slice]) -> bool:
        """Whether most of the texture in a window of the grid, which has a block, is fixed."""
        rows, columns = window
        stride_px, is_fixed = _stride_px(image), self.is_fixed[window]
        part = image[
            rows.start * stride_px : rows.stop * stride_px + 1,
            columns.start * stride_px : columns.stop * stride_px + 1,
        ]
        now, mean = _slopes(part, stride_px), self._mean[:, rows, columns]
        fixed = _squared(mean)
        is_as_ever = is_fixed & (_squared(now - mean) < _UNCHANGED * fixed)
        # the digits of a clock change beside letters that do not
        beside = cv2.dilate(is_fixed.view(np.uint8), np.ones((_BLOCK, 3 * _BLOCK), np.uint8)) > 0
        fixed_blocks = _means(np.where(is_as_ever, fixed, 0).astype(np.float32), _BLOCK)
        moving_blocks = _means(np.where(beside, 0, _squared(now)).astype(np.float32), _BLOCK)
        is_fixed_block = (fixed_blocks > moving_blocks) & (fixed_blocks > _TEXTURE / 2)
        is_textured = is_fixed_block | (moving_blocks > _LEAST_MOVING)
        n_fixed = np.count_nonzero(is_fixed_block)
        return bool(n_fixed > _MOST_TEXTURE * np.count_nonzero(is_textured))


def _stride_px(image: Image) -> int:
    return max(1, int(max(image.shape[:2]) / _GRID_PX + 0.5))


def _slopes(image: Image, stride_px: int) -> FloatArray32:
    """(2, h, w) differences to the next pixel on the right and below, at each `stride_px`-th
    pixel.
    """
    grey = image if image.ndim == 2 else image[:, :, 1]
    height = (grey.shape[0] - 1) // stride_px * stride_px
    width = (grey.shape[1] - 1) // stride_px * stride_px

    def at(down_px: int, right_px: int) -> FloatArray32:
        part = grey[down_px : height + down_px, right_px : width + right_px]
        return part[::stride_px, ::stride_px].astype(np.float32)

    return np.stack([at(0, 1) - at(0, 0), at(1, 0) - at(0, 0)])


def _squared(slopes: FloatArray32) -> FloatArray32:
    """(H, W) squared lengths of slopes (2, H, W)."""
    x, y = slopes
    return np.asarray(x * x + y * y, np.float32)


def _coarse_slopes(image: Image, stride_px: int) -> FloatArray32:
    """(2, h, w) differences of neighbouring means, in which the noise of a camera hardly counts."""
    grey = image if image.ndim == 2 else image[:, :, 1]
    coarse = _means(grey[::stride_px, ::stride_px].astype(np.float32), _COARSE)
    return np.stack([coarse[:-1, 1:] - coarse[:-1, :-1], coarse[1:, :-1] - coarse[:-1, :-1]])


def _has_moved(before: FloatArray32, now: FloatArray32) -> bool:
    """Whether most of the textured tiles of two images have changed."""
    side = max(now.shape[1] // _N_TILES, 1)
    both = _means(_squared(before) + _squared(now), side)
    change = _means(_squared(now - before), side)
    is_textured = both > _LEAST_COARSE
    is_changed = is_textured & (change > _MIN_CHANGE * both)
    n_textured = np.count_nonzero(is_textured)
    n_changed = np.count_nonzero(is_changed)
    return bool(n_textured >= _MIN_TILES and n_changed >= _CHANGED * n_textured)


def _means(values: FloatArray32, side_px: int) -> FloatArray32:
    """Means of values (H, W) in squares; the rest at the right and the bottom is left out."""
    n_rows, n_columns = values.shape[0] // side_px, values.shape[1] // side_px
    whole = values[: n_rows * side_px, : n_columns * side_px]
    size = n_columns, n_rows
    return np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), np.float32)
