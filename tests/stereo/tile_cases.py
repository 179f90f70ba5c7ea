"""Tiles of single boxes, for tests of the steps of the patch matcher."""

from __future__ import annotations

import numpy as np

from tests.stereo.shifted_pairs import HEIGHT, WIDTH, Image
from track_range.stereo.matching.tiles import FINE, BoxTiles, TileShape, box_tiles

EXACT_BOX = (199.5, 49.5, 247.5, 81.5)
"""A box of 48 x 32 px, the size of a fine tile: columns 200 .. 247, rows 50 .. 81; u and v are
-0.375 .. 0.375."""


def tiles_of(
    images: tuple[Image, Image] | None = None,
    *boxes: tuple[float, ...],
    first_px: float = 12.0,
    n_disparities: int = 17,
    shape: TileShape = FINE,
) -> BoxTiles:
    """Tiles of boxes, `EXACT_BOX` if none is given, in a pair of images; None = black images."""
    left, right = images or (np.zeros((HEIGHT, WIDTH), np.uint8),) * 2
    xyxy_px = np.array(boxes or [EXACT_BOX])
    return box_tiles(left, right, xyxy_px, np.full(len(xyxy_px), first_px), n_disparities, shape)


def box_of_scale(scale: float, shape: TileShape = FINE) -> tuple[float, float, float, float]:
    """A box about (x, y) = (300, 200) px that just fits the tile at a scale."""
    half_width, half_height = (
        0.5 * scale * side / 0.65 - 0.01 for side in (shape.hw[1], shape.hw[0])
    )
    return 300.0 - half_width, 200.0 - half_height, 300.0 + half_width, 200.0 + half_height
