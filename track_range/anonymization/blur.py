r"""Irreversible blur of regions: low-pass filter, mosaic, noise and quantization.

The colours of a region are replaced by those of a mosaic with cells of c px:

    image -> area average to c/4 px -> Gaussian, sigma = c -> area average to c px -> noise -> quantization -> cells

Why it cannot be inverted:
- One image: a head has about 2 x 3 cells, a plate 3 x 1, with at most 16 levels per colour and noise of half a level.
  A deconvolution can only choose one of the many images with these averages.
- Many images: a mosaic alone samples a moving head at different positions, from which details could be
  reconstructed (super-resolution). The Gaussian removes them before the sampling: its gain at the Nyquist frequency of
  the cells, 1 / (2 c), is exp(-pi^2 / 2) = 0.007, and at twice that frequency 3e-9. A contrast of 100 levels at the
  Nyquist frequency becomes 0.7, a tenth of the noise of a cell; to measure it, hundreds of perfectly registered images
  are necessary, for the next octave more than 10^14.
- The operating system seeds the generator of the noise, and the seed is not stored, so that the noise cannot be
  subtracted.

The pixels are replaced before drawing and encoding.
"""

from __future__ import annotations

import cv2
import numpy as np

from track_range.anonymization.regions import Regions
from track_range.foundation.arrays import Image

NOISE_GREY, COLOUR_NOISE_GREY = 8.0, 3.0
"""Standard deviations of the noise of each cell, common to its colours and separate by colour, grey levels."""

STEP_GREY = 16
"""Quantization step, grey levels."""

_FINE = 4
"""Samples per cell and axis before the low-pass filter."""


def blurred(image: Image, regions: Regions, rng: np.random.Generator) -> Image:
    """A copy of an image with mosaics in all regions; where regions overlap, the one with the largest cells applies.

    Args:
        image: (H, W, 3) uint8 BGR; not modified.
        regions: rectangles to cover, also partly or entirely outside the image.
        rng: generator of the noise.
    """
    result = image.copy()
    size_px = np.array(image.shape[1::-1])
    low = np.clip(np.floor(regions.xyxy_px[:, :2] + 0.5), 0, size_px).astype(np.int64).tolist()
    high = np.clip(np.ceil(regions.xyxy_px[:, 2:] + 0.5), 0, size_px).astype(np.int64).tolist()
    cells = np.clip(np.ceil(regions.cell_px), 1, size_px.max(initial=1)).astype(np.int64).tolist()
    for row in np.argsort(regions.cell_px, kind="stable").tolist():
        (left, top), (right, bottom) = low[row], high[row]
        if left < right and top < bottom:
            part = np.s_[top:bottom, left:right]
            result[part] = _mosaic(image[part], cells[row], rng)
    return result


def _mosaic(part: Image, cell_px: int, rng: np.random.Generator) -> Image:
    """The mosaic of a part of an image, of equal shape."""
    height, width = part.shape[:2]
    n_rows, n_columns = -(-height // cell_px), -(-width // cell_px)
    below, beside = n_rows * cell_px - height, n_columns * cell_px - width
    whole = cv2.copyMakeBorder(part, 0, below, 0, beside, cv2.BORDER_REPLICATE)
    fine = cv2.resize(whole, (_FINE * n_columns, _FINE * n_rows), interpolation=cv2.INTER_AREA).astype(np.float32)
    smooth = cv2.GaussianBlur(fine, (0, 0), _FINE, borderType=cv2.BORDER_REPLICATE)
    cells = cv2.resize(smooth, (n_columns, n_rows), interpolation=cv2.INTER_AREA)
    noisy = cells + rng.normal(0.0, NOISE_GREY, cells.shape[:2])[:, :, None]
    noisy += rng.normal(0.0, COLOUR_NOISE_GREY, cells.shape)
    levels = np.clip(np.floor(noisy / STEP_GREY), 0, 255 // STEP_GREY) * STEP_GREY + STEP_GREY // 2
    size_px = (n_columns * cell_px, n_rows * cell_px)
    mosaic = cv2.resize(levels.astype(np.uint8), size_px, interpolation=cv2.INTER_NEAREST)
    return np.asarray(mosaic[:height, :width], np.uint8)
