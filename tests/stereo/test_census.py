"""Census words and the costs of windows compared with their definition, pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest

from tests.stereo.shifted_pairs import pair
from tests.stereo.tile_cases import EXACT_BOX, tiles_of
from track_range.foundation.arrays import FloatArray
from track_range.stereo.matching.tiles import COARSE, FINE, MARGIN_PX, BoxTiles, Grey, TileShape
from track_range.stereo.matching.window_matches import census, window_costs


def slow_bits(grey: Grey) -> list[list[list[bool]]]:
    """Whether each of the 24 neighbours is brighter, of the pixels of a tile (H, W) without its
    margin."""
    values = grey.tolist()
    neighbours = [(y, x) for y in range(-2, 3) for x in range(-2, 3) if (y, x) != (0, 0)]
    rows, columns = (range(MARGIN_PX, side - MARGIN_PX) for side in grey.shape)
    return [
        [[values[y + dy][x + dx] > values[y][x] for dy, dx in neighbours] for x in columns]
        for y in rows
    ]


def slow_costs(tiles: BoxTiles, box: int) -> FloatArray:
    """C(w, d), (D, G), of one box; NaN where a column of the window is outside the right image."""
    left, right = (
        np.array(slow_bits(tiles.left[:, :, box])),
        np.array(slow_bits(tiles.right[:, :, box])),
    )
    seen = tiles.is_seen[MARGIN_PX:-MARGIN_PX, box]
    cell_height, cell_width = tiles.shape.cell_hw
    cost = np.full((tiles.n_disparities, 49), np.nan)
    for k in range(tiles.n_disparities):
        for g in range(49):
            rows = slice(g // 7 * cell_height, (g // 7 + 2) * cell_height)
            first, shift = g % 7 * cell_width, tiles.n_disparities - 1 - k
            if seen[first + shift : first + shift + 2 * cell_width].all():
                bits = right[rows, first + shift : first + shift + 2 * cell_width]
                differs = left[rows, first : first + 2 * cell_width] != bits
                cost[k, g] = differs.sum(axis=2).mean()
    return cost


def test_census_of_one_window() -> None:
    # the 12 pixels after the centre are brighter
    window = np.arange(25, dtype=np.uint8).reshape(5, 5, 1)
    assert census(window).shape == (1, 1, 1)
    assert int(census(window)[0, 0, 0]).bit_count() == 12
    assert int(census(np.full((5, 5, 1), 7, np.uint8))[0, 0, 0]) == 0


def test_each_neighbour_has_one_bit() -> None:
    windows = np.zeros((5, 5, 25), np.uint8)
    windows[np.repeat(np.arange(5), 5), np.tile(np.arange(5), 5), np.arange(25)] = 1
    words = census(windows)[0, 0].tolist()
    assert words.pop(12) == 0
    assert sorted(words) == [1 << bit for bit in range(24)]


def test_only_the_order_of_grey_values_counts() -> None:
    grey = np.random.default_rng(0).integers(0, 120, (11, 13, 4), dtype=np.uint8)
    assert np.array_equal(census(grey), census(2 * grey + 10))


@pytest.mark.parametrize("shape", [FINE, COARSE])
@pytest.mark.parametrize(("first_px", "n_disparities"), [(0.0, 21), (4.0, 9), (-4.0, 5)])
def test_costs_equal_brute_force_also_at_borders(
    shape: TileShape, first_px: float, n_disparities: int
) -> None:
    boxes = (
        EXACT_BOX,
        (-0.5, -0.5, 60.0, 40.0),
        (380.0, 90.0, 399.5, 139.5),
        (20.0, 60.0, 120.0, 75.0),
    )
    tiles = tiles_of(
        pair(11.3, noise=4.0), *boxes, first_px=first_px, n_disparities=n_disparities, shape=shape
    )
    fast = window_costs(tiles)
    assert fast.shape == (n_disparities, 49, 4)
    slow = np.stack([slow_costs(tiles, i) for i in range(4)], axis=2)
    assert np.isnan(slow).any()
    assert np.allclose(fast, slow, equal_nan=True)


def test_boxes_of_different_scales_are_independent() -> None:
    images = pair(8.0, noise=3.0)
    boxes = (EXACT_BOX, (150.0, 10.0, 330.0, 130.0))  # scales 1 and 2.5
    together = window_costs(tiles_of(images, *boxes, first_px=3.0, n_disparities=9))
    for i, box in enumerate(boxes):
        alone = window_costs(tiles_of(images, box, first_px=3.0, n_disparities=9))
        assert np.array_equal(together[:, :, i], alone[:, :, 0], equal_nan=True)
    assert set(together[:, :, 0].argmin(axis=0).tolist()) == {5}  # 8 = 3 + 5 px
    assert set(together[:, :, 1].argmin(axis=0).tolist()) == {2}  # 8 = 3 + 2 * 2.5 px
