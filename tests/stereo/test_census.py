"""Census words and the costs of windows compared with their definition, pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest

from tests.stereo.shifted_pairs import pair
from tests.stereo.tile_cases import EXACT_BOX, tiles_of
from track_range.foundation.arrays import FloatArray
from track_range.stereo.matching.tiles import COARSE, FINE, MARGIN_PX, BoxTiles, Grey, TileShape
from track_range.stereo.matching.window_matches import census, window_costs

NEIGHBOURS = [(-2, -2), (-2, 0), (-2, 2), (-1, -1), (-1, 0), (-1, 1), (0, -2), (0, -1)]
NEIGHBOURS += [(-dx, -dy) for dx, dy in NEIGHBOURS]


def slow_bits(grey: Grey) -> list[list[list[bool]]]:
    """Whether each of the 16 neighbours is brighter, of the pixels of a tile (H, W) without its
    margin."""
    values = grey.tolist()
    rows, columns = (range(MARGIN_PX, side - MARGIN_PX) for side in grey.shape)
    return [
        [[values[y + dy][x + dx] > values[y][x] for dx, dy in NEIGHBOURS] for x in columns]
        for y in rows
    ]


def slow_costs(tiles: BoxTiles, box: int) -> FloatArray:
    """C(w, d), (D, G), of one box; NaN where a column of the window is outside the right image."""
    left, right = (
        np.array(slow_bits(tiles.left[:, box].T)),
        np.array(slow_bits(tiles.right[:, box].T)),
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
                cost[k, g] = 1.5 * differs.sum(axis=2).mean()
    return cost


def test_census_of_one_window() -> None:
    # of the neighbours, the 8 after the centre are brighter
    window = np.arange(25, dtype=np.uint8).reshape(5, 1, 5)
    assert census(window).shape == (1, 1, 5)
    assert int(census(window)[0, 0, 2]).bit_count() == 8
    assert int(census(np.full((5, 1, 5), 7, np.uint8))[0, 0, 2]) == 0


def test_each_neighbour_has_one_bit() -> None:
    n = len(NEIGHBOURS)
    windows = np.zeros((5, n, 5), np.uint8)
    windows[[2 + dx for dx, _ in NEIGHBOURS], np.arange(n), [2 + dy for _, dy in NEIGHBOURS]] = 1
    assert sorted(census(windows)[0, :, 2].tolist()) == [1 << bit for bit in range(n)]


def test_only_the_order_of_grey_values_counts() -> None:
    grey = np.random.default_rng(0).integers(0, 120, (13, 4, 11), dtype=np.uint8)
    assert np.array_equal(census(grey)[:, :, 2:-2], census(2 * grey + 10)[:, :, 2:-2])


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
