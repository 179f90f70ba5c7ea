"""Census words and cost curves compared with their definition, pixel by pixel."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.stereo.shifted_pairs import pair
from track_range.foundation.arrays import Image
from track_range.stereo.matching.census import census, cost_curves
from track_range.stereo.matching.sample_windows import BoxWindows, GreyLevels


def slow_differing_bits(left: Image, right: Image, xy: tuple[int, int], disparity_px: int) -> int:
    x, y = xy
    count = 0
    for dy in range(-2, 3):
        for dx in range(-2, 3):
            left_bit = left[y + dy, x + dx] > left[y, x]
            right_bit = right[y + dy, x + dx - disparity_px] > right[y, x - disparity_px]
            count += int(left_bit != right_bit)
    return count


def slow_cost(left: Image, right: Image, *, column: int, row: int, disparity_px: int) -> float:
    """Mean differing bits of a window 9 wide and 7 high, NaN where it is not 2 px or more inside the right image."""
    if not 2 <= column - disparity_px <= right.shape[1] - 2 - 9:
        return float("nan")
    pixels = [(x, y) for y in range(row, row + 7) for x in range(column, column + 9)]
    return float(np.mean([slow_differing_bits(left, right, xy, disparity_px) for xy in pixels]))


def shrunk(image: Image, level: int) -> Image:
    """Each pixel the mean of 2 x 2, `level` times; an odd last row or column is dropped."""
    for _ in range(level):
        even = image[: len(image) // 2 * 2, : image.shape[1] // 2 * 2].astype(np.int64)
        mean = (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2] + 2) // 4
        image = mean.astype(np.uint8)
    return image


def windows_at(level: int, *corners: tuple[int, int]) -> BoxWindows:
    """One box with windows that start at these columns and rows."""
    column, row = np.array(corners).T
    return BoxWindows(np.array([level]), column[None, :], row[None, :])


def test_census_of_one_window() -> None:
    window = np.arange(25, dtype=np.uint8).reshape(5, 5, 1)  # the 12 pixels after the centre are brighter
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


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize(("first_px", "n_disparities"), [(0, 22), (4, 11), (-1, 5)])
def test_costs_equal_brute_force_also_in_corners(level: int, first_px: int, n_disparities: int) -> None:
    left, right = pair(11.3, seed=level, noise=4.0, height=59, width=149)
    small_left, small_right = shrunk(left, level), shrunk(right, level)
    height, width = small_left.shape
    corners = ((2, 2), (width - 11, 2), (2, height - 9), (width - 11, height - 9), (width // 2, 3), (width // 3, 4))
    fast = cost_curves(
        GreyLevels.of(left, 3),
        GreyLevels.of(right, 3),
        windows_at(level, *corners),
        first=np.array([first_px]),
        n_disparities=n_disparities,
    )
    slow = [
        [slow_cost(small_left, small_right, column=x, row=y, disparity_px=first_px + k) for x, y in corners]
        for k in range(n_disparities)
    ]
    assert np.isnan(slow).any()
    assert np.allclose(fast[:, 0], slow, equal_nan=True)


def test_boxes_of_different_levels_are_independent() -> None:
    left, right = pair(8.0, noise=3.0)
    levels = GreyLevels.of(left, 3), GreyLevels.of(right, 3)
    one, two = windows_at(0, (150, 40), (160, 40)), windows_at(2, (60, 10), (50, 12))
    both = BoxWindows(
        *(
            np.concatenate(parts)
            for parts in zip((one.level, one.column, one.row), (two.level, two.column, two.row), strict=True)
        )
    )
    together = cost_curves(*levels, both, first=np.array([5, 0]), n_disparities=9)
    alone = [
        cost_curves(*levels, w, first=np.array([first]), n_disparities=9)[:, 0] for w, first in ((one, 5), (two, 0))
    ]
    assert np.array_equal(together, np.stack(alone, axis=1), equal_nan=True)
    assert together.argmin(axis=0).tolist() == [[3, 3], [2, 2]]  # 8 = 5 + 3 px; 8 / 4 = 2 px of level 2


def test_pyramid_levels_are_means() -> None:
    image = np.random.default_rng(1).integers(0, 256, (23, 37), dtype=np.uint8)
    levels = GreyLevels.of(image, 3)
    assert levels.width.tolist() == [37, 18, 9]
    assert levels.begin.tolist() == [0, 23 * 37, 23 * 37 + 11 * 18]
    for level, begin in enumerate(levels.begin):
        expected = shrunk(image, level).ravel().astype(np.int64)
        pixels = levels.pixels[begin : begin + expected.size].astype(np.int64)
        assert np.abs(pixels - expected).max() <= level  # exact halves are rounded either way
    colour = GreyLevels.of(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), 3)
    assert np.array_equal(colour.pixels, levels.pixels)
