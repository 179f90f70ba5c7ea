"""Sampling windows of boxes, and the required pixels of the right image."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.stereo.shifted_pairs import texture, to_u8
from track_range.stereo.matching.sample_windows import (
    COARSE_GRID,
    FINE_GRID,
    MARGIN_PX,
    WINDOW_HW,
    BoxWindows,
    SamplingGrid,
    band_of,
)

IMAGE_HW = (375, 1242)


def of_box(*edges: float, image_hw: tuple[int, int] = IMAGE_HW, grid: SamplingGrid = FINE_GRID) -> BoxWindows:
    return BoxWindows.of_boxes(np.array([edges]), image_hw, grid=grid)


def test_windows_of_a_box_by_hand() -> None:
    # 120 x 80 px, inner half 100..160 and 70..110: columns 100 + k * (60 - 9) / 5, rows 70 + k * (40 - 7) / 5
    windows = of_box(69.5, 49.5, 189.5, 129.5)
    assert windows.level.tolist() == [0]
    assert windows.column.reshape(6, 6)[0].tolist() == [100, 110, 120, 131, 141, 151]
    assert windows.row.reshape(6, 6)[:, 0].tolist() == [70, 77, 83, 90, 96, 103]
    right, down = windows.normalized_positions()
    assert right.min() == down.min() == -0.5
    assert right.max() == down.max() == 0.5
    assert windows.n_pixels.tolist() == [36 * 7 * 9]  # fewer than the 60 x 40 of the inner half


def test_windows_of_a_small_box_coincide() -> None:
    windows = of_box(95.5, 95.5, 106.5, 104.5)  # smaller than a window; its middle is at 101, 100
    assert set(windows.column.ravel().tolist()) == {97}  # 97 .. 105
    assert set(windows.row.ravel().tolist()) == {97}  # 97 .. 103
    assert windows.n_pixels.tolist() == [63]
    assert not np.any(windows.normalized_positions())


@pytest.mark.parametrize(
    ("width_px", "height_px", "fine", "coarse"),
    [(40, 20, 0, 0), (41, 20, 0, 1), (100, 21, 0, 2), (256, 128, 0, 2), (257, 128, 1, 2), (256, 300, 2, 2)],
)
def test_level_of_large_boxes(width_px: int, height_px: int, fine: int, coarse: int) -> None:
    box = (300.0, 20.0, 300.0 + width_px, 20.0 + height_px)
    assert of_box(*box).level.tolist() == [fine]
    assert of_box(*box, grid=COARSE_GRID).level.tolist() == [coarse]


def test_a_level_without_room_for_a_window_is_not_used() -> None:
    # 43 rows are 21 and 10 in the smaller images; a window with its margin takes 11
    assert of_box(10.0, 2.0, 590.0, 40.0, image_hw=(43, 600)).level.tolist() == [1]
    assert of_box(10.0, 2.0, 590.0, 40.0, image_hw=(44, 600)).level.tolist() == [2]
    assert of_box(-0.5, -0.5, 599.5, 10.5, image_hw=(11, 600)).level.tolist() == [0]


@settings(deadline=None, max_examples=100)
@given(
    st.tuples(st.integers(11, 400), st.integers(13, 1300)),
    st.tuples(*[st.floats(0, 1)] * 4),
    st.sampled_from([FINE_GRID, COARSE_GRID]),
)
def test_windows_with_margins_are_inside_the_image(
    image_hw: tuple[int, int], shares: tuple[float, float, float, float], grid: SamplingGrid
) -> None:
    height, width = image_hw
    x, y = sorted(shares[:2]), sorted(shares[2:])
    windows = of_box(
        x[0] * width - 0.5, y[0] * height - 0.5, x[1] * width - 0.5, y[1] * height - 0.5, image_hw=image_hw, grid=grid
    )
    level = int(windows.level[0])
    assert windows.column.min() >= MARGIN_PX
    assert windows.row.min() >= MARGIN_PX
    assert windows.column.max() + WINDOW_HW[1] + MARGIN_PX <= width >> level
    assert windows.row.max() + WINDOW_HW[0] + MARGIN_PX <= height >> level
    assert np.abs(windows.normalized_positions()).max() <= 0.5


def test_required_pixels_by_hand() -> None:
    windows = BoxWindows(np.array([0, 1]), np.array([[100, 150]] * 2), np.array([[20, 31]] * 2))
    required = windows.required_pixels(np.array([3, -1]), np.array([40, 20]), IMAGE_HW)
    # level 0: columns 100 - 40 - 2 .. 150 + 9 + 2, rows 18 .. 40, in steps of 4 px
    assert required[0].tolist() == [56, 16, 164, 40]
    # level 1: columns 78 .. 150 + 1 + 11 = 162, rows 18 .. 40, twice as many pixels
    assert required[1].tolist() == [156, 36, 324, 80]


def test_required_pixels_end_at_the_image() -> None:
    windows = BoxWindows(np.array([0]), np.array([[10, 1231]]), np.array([[2, 366]]))
    assert windows.required_pixels(np.array([0]), np.array([200]), IMAGE_HW).tolist() == [[0, 0, 1242, 375]]


class RecordingImage:
    """An image that records which windows of it are read."""

    def __init__(self, image: npt.NDArray[np.uint8]) -> None:
        self._image = image
        self.windows: list[tuple[int, int, int, int]] = []

    @property
    def shape(self) -> tuple[int, ...]:
        return self._image.shape

    def __getitem__(self, window: tuple[slice, slice], /) -> npt.NDArray[np.uint8]:
        rows, columns = window
        self.windows.append((columns.start, rows.start, columns.stop, rows.stop))
        return self._image[window]


@pytest.mark.parametrize("depth", [(), (3,)])
def test_band_of_boxes(depth: tuple[int, ...]) -> None:
    image = np.maximum(np.broadcast_to(to_u8(texture(0)).reshape(140, 400, *[1] * len(depth)), (140, 400, *depth)), 1)
    boxes = np.array([[10, 20, 30, 40], [200, 36, 260, 60]])
    view = RecordingImage(image)
    band = band_of(view, boxes)
    assert view.windows == [(10, 20, 30, 40), (200, 36, 260, 60)]
    expected = np.zeros((40, 400, *depth), np.uint8)
    expected[:20, 10:30] = image[20:40, 10:30]
    expected[16:, 200:260] = image[36:60, 200:260]
    assert np.array_equal(band, expected)
    assert np.array_equal(band_of(image, boxes), image[20:60])
