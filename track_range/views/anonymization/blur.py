r"""Irreversible blur of regions: low-pass filter, mosaic, noise and quantization.

The colours of a region are replaced by a mosaic with cells of c px:

    image -> average of c/4 px, twice -> Gaussian, sigma = c -> average of c px -> noise -> quantization -> cells

Why it cannot be inverted:
- One image: a head has about 2 x 3 cells, a plate 3 x 1, with at most 16 levels per colour and noise of half a level.
  A deconvolution can only choose one of the many images with these averages.
- Many images: a mosaic alone samples a moving head at different positions, from which details could be
  reconstructed (super-resolution). The Gaussian removes them before the sampling: a sine with the Nyquist frequency of
  the cells, 1 / (2 c), keeps 0.6 % of its amplitude, and with a higher frequency at most 0.4 % (measured; a test holds
  it). A contrast of 100 grey levels becomes 0.4 to 0.6, where the noise of a cell is 8: to measure it, hundreds of
  perfectly registered images of an unchanged head are necessary.
- The operating system seeds the generator of the noise, and the seed is not stored, so that the noise cannot be
  subtracted.

The pixels are replaced before drawing and encoding.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import Image
from track_range.views.anonymization.regions import Regions

# sigmas of each cell's noise, common and by colour, grey levels
NOISE_GREY, COLOUR_NOISE_GREY = 8.0, 3.0
STEP_GREY = 16  # quantization step, grey levels
_FINE = 4  # samples per cell and axis before the low-pass filter


def blurred(image: Image, regions: Regions, rng: np.random.Generator) -> Image:
    """A copy of an image (H, W, 3) uint8 BGR with mosaics in all regions.

    Regions may be partly or entirely outside; where they overlap, the one with the largest cells
    applies. `rng` generates the noise.
    """
    result = image.copy()
    size_px = np.array(image.shape[1::-1])
    low = np.clip(np.floor(regions.xyxy_px[:, :2] + 0.5), 0, size_px).astype(np.int64).tolist()
    high = np.clip(np.ceil(regions.xyxy_px[:, 2:] + 0.5), 0, size_px).astype(np.int64).tolist()
    n_fine = np.clip(np.ceil(regions.cell_px / _FINE), 1, size_px.max(initial=1))
    cells = (_FINE * n_fine).astype(np.int64).tolist()
    for row in np.argsort(regions.cell_px, kind="stable").tolist():
        (left, top), (right, bottom) = low[row], high[row]
        if left < right and top < bottom:
            part = np.s_[top:bottom, left:right]
            result[part] = _mosaic(image[part], cells[row], rng)
    return result


def cell_colours(whole: Image, cell_px: int) -> npt.NDArray[np.float32]:
    """(n, m, 3) colours of the cells of an image of (n cell_px, m cell_px, 3), without noise."""
    fine_px = cell_px // _FINE
    n_rows, n_columns = whole.shape[0] // cell_px, whole.shape[1] // cell_px
    averaged = cv2.blur(whole, (fine_px, fine_px), borderType=cv2.BORDER_REPLICATE)
    fine = cv2.resize(
        averaged, (_FINE * n_columns, _FINE * n_rows), interpolation=cv2.INTER_AREA
    ).astype(np.float32)
    smooth = cv2.GaussianBlur(
        fine, (6 * _FINE + 1, 6 * _FINE + 1), _FINE, borderType=cv2.BORDER_REPLICATE
    )
    return np.asarray(
        cv2.resize(smooth, (n_columns, n_rows), interpolation=cv2.INTER_AREA), np.float32
    )


def _mosaic(part: Image, cell_px: int, rng: np.random.Generator) -> Image:
    """The mosaic of a part of an image, of equal shape; the cell size is a multiple of `_FINE`."""
    height, width = part.shape[:2]
    n_rows, n_columns = -(-height // cell_px), -(-width // cell_px)
    below, beside = n_rows * cell_px - height, n_columns * cell_px - width
    whole = np.asarray(
        cv2.copyMakeBorder(part, 0, below, 0, beside, cv2.BORDER_REPLICATE), np.uint8
    )
    cells = cell_colours(whole, cell_px)
    noisy = cells + rng.normal(0.0, NOISE_GREY, cells.shape[:2])[:, :, None]
    noisy += rng.normal(0.0, COLOUR_NOISE_GREY, cells.shape)
    levels = np.clip(np.floor(noisy / STEP_GREY), 0, 255 // STEP_GREY) * STEP_GREY + STEP_GREY // 2
    size_px = (n_columns * cell_px, n_rows * cell_px)
    mosaic = cv2.resize(levels.astype(np.uint8), size_px, interpolation=cv2.INTER_NEAREST)
    return np.asarray(mosaic[:height, :width], np.uint8)
