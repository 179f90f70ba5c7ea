"""Tiles of boxes: geometry by hand, equal resampling of both images, and the pixels that are
read."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st

from tests.stereo.shifted_pairs import pair, texture, to_u8
from tests.stereo.tile_cases import EXACT_BOX, box_of_scale, tiles_of
from track_range.stereo.matching.tiles import (
    COARSE,
    FINE,
    MARGIN_PX,
    N_SIDE,
    N_WINDOWS,
    TileShape,
    box_tiles,
    tile_scale,
)

SCALES = (1.0, 1.25, 1.5, 2.5, 3.0)
LARGE = to_u8(texture(4, height=420, width=640))


def scale_of(width_px: float, height_px: float, shape: TileShape = FINE) -> list[float]:
    return [
        float(s)
        for s in tile_scale(np.array([[10.0, 20.0, 10.0 + width_px, 20.0 + height_px]]), shape)[
            :, 0
        ]
    ]


def test_tile_of_a_box_by_hand() -> None:
    left, right = pair(12.0)
    tiles = tiles_of((left, right), first_px=12.0, n_disparities=9)
    assert tiles.scale[:, 0].tolist() == [1.0, 1.0]
    # 4 px around columns 200 .. 247, rows 50 .. 81
    assert np.array_equal(tiles.left[:, 0].T, left[46:86, 196:252])
    assert np.array_equal(tiles.right[:, 0].T, right[46:86, 196 - 20 : 252 - 12])
    assert tiles.is_used.all()
    assert tiles.is_seen.all()
    assert tiles.u[0].reshape(7, 7)[2] == pytest.approx(
        [-0.375, -0.25, -0.125, 0.0, 0.125, 0.25, 0.375]
    )
    assert tiles.v[0].reshape(7, 7)[:, 2] == pytest.approx(
        [-0.375, -0.25, -0.125, 0.0, 0.125, 0.25, 0.375]
    )
    assert (tiles.first_px.tolist(), tiles.first.tolist()) == ([12.0], [12.0])
    assert tiles.disparity_px(np.array([[0.0, 8.0]])).tolist() == [[12.0, 20.0]]


@pytest.mark.parametrize(
    ("width_px", "height_px", "fine", "coarse"),
    [
        (20, 10, [1.0, 1.0], [2.0, 2.0]),
        (73, 49, [1.0, 1.0], [2.0, 2.0]),
        (75, 49, [1.25, 1.0], [2.5, 2.0]),
        (180, 49, [2.5, 1.0], [5.0, 2.0]),
        (180, 120, [2.5, 2.5], [5.0, 5.0]),
        (1200, 8, [4.0, 1.0], [8.0, 2.0]),  # at most four times as wide as high
        (9, 360, [1.0, 4.0], [2.0, 8.0]),
        (1e5, 1e5, [128.0, 128.0], [256.0, 256.0]),
    ],
)
def test_scale_of_boxes(
    width_px: float, height_px: float, fine: list[float], coarse: list[float]
) -> None:
    assert scale_of(width_px, height_px) == fine
    assert scale_of(width_px, height_px, COARSE) == coarse


@pytest.mark.parametrize("shape", [FINE, COARSE])
def test_large_boxes_are_covered(shape: TileShape) -> None:
    for side_px in (100, 170, 300, 333):
        tiles = tiles_of(
            (LARGE, LARGE), (100.0, 20.0, 100.0 + side_px, 20.0 + side_px), shape=shape
        )
        window_px = 2 * np.array(shape.cell_hw[::-1]) * tiles.scale[:, 0]
        covered = np.array([np.ptp(tiles.u), np.ptp(tiles.v)]) + window_px / side_px
        assert (covered >= 0.65).all()
        assert (covered < 0.85 * max(1.0, 32 * shape.min_scale / side_px / 0.65)).all()
        assert tiles.is_used.all()


@pytest.mark.parametrize("shape", [FINE, COARSE])
@pytest.mark.parametrize("scale", SCALES)
def test_whole_shifts_give_equal_pixels(scale: float, shape: TileShape) -> None:
    """At each disparity of whole image pixels, the strip has the pixels of the left tile at every
    scale."""
    box = box_of_scale(scale * shape.min_scale, shape)
    step = 4 * scale * shape.min_scale  # px of the image in 4 px of the tile
    assert step.is_integer()
    for k in (0, 4, 12):
        shift = 24 + round(k / 4 * step)
        right = np.roll(LARGE, -shift, axis=1)
        tiles = tiles_of((LARGE, right), box, first_px=24.0, n_disparities=17, shape=shape)
        assert tiles.scale[:, 0].tolist() == [scale * shape.min_scale] * 2
        index = (shift - float(tiles.first_px[0])) / float(tiles.scale[0, 0])
        assert index == pytest.approx(round(index))
        start = 16 - round(index)
        width = tiles.left.shape[0]
        seen = tiles.is_seen[start : start + width, 0]
        assert seen.all()
        assert np.array_equal(tiles.right[start : start + width, 0], tiles.left[:, 0])


def test_resampled_pixels_are_means() -> None:
    tiles = tiles_of((LARGE, LARGE), box_of_scale(2.0), first_px=0.0)
    crop = LARGE[200 - 40 :, 300 - 56 :][:80, :112]  # 40 x 56 px of the tile about (300, 200)
    expected = crop.reshape(40, 2, 56, 2).mean(axis=(1, 3))
    assert np.abs(tiles.left[:, 0].T - expected).max() <= 0.5


@pytest.mark.parametrize("scale", [1.0, 1.5, 4.0])
def test_pixel_positions_average_to_windows(scale: float) -> None:
    tiles = tiles_of((LARGE, LARGE), box_of_scale(scale))
    column_u, row_v = (positions.squeeze() for positions in tiles.pixel_positions())
    assert (column_u.shape, row_v.shape) == ((48,), (32,))
    for row in range(N_SIDE):
        for column in range(N_SIDE):
            g = row * N_SIDE + column
            assert column_u[6 * column : 6 * column + 12].mean() == pytest.approx(
                tiles.u[0, g], abs=1e-9
            )
            assert row_v[4 * row : 4 * row + 8].mean() == pytest.approx(tiles.v[0, g], abs=1e-9)


def test_a_small_box_uses_its_central_windows() -> None:
    # 8 x 8 px about (223.5, 65.5)
    used = tiles_of(None, (219.5, 61.5, 227.5, 69.5)).is_used.reshape(7, 7)
    assert used.sum() == 1
    assert used[3, 3]
    # 24 x 16 px: u and v from -0.25 to 0.25
    used = tiles_of(None, (211.5, 57.5, 235.5, 73.5)).is_used.reshape(7, 7)
    assert np.array_equal(used, np.pad(np.ones((3, 3), np.bool_), 2))


def test_windows_outside_the_left_image_are_unused() -> None:
    tiles = tiles_of(pair(5.0), (-0.5, 39.5, 47.5, 71.5), (-0.5, 107.5, 23.5, 139.5))
    assert tiles.is_used[0].all()  # the tile begins at the image border
    small = tiles.is_used[1].reshape(7, 7)
    x_px = 11.5 + 24.0 * tiles.u[1].reshape(7, 7)[0]
    assert np.array_equal(
        small[3], (x_px - 6 >= -1.0) & (np.abs(tiles.u[1].reshape(7, 7)[0]) <= 0.5 - 0.125)
    )
    assert not small[:, x_px < 5].any()


def test_strip_outside_the_right_image() -> None:
    left, right = pair(5.0)
    tiles = tiles_of((left, right), (19.5, 49.5, 67.5, 81.5), first_px=10.0, n_disparities=17)
    first = 16 - 10 - 16  # column of the image at the strip's first column
    assert tiles.is_seen[:, 0].tolist() == [0 <= first + j < 400 for j in range(72)]
    # the border is repeated
    assert np.array_equal(tiles.right[:10, 0].T, np.repeat(right[46:86, :1], 10, axis=1))
    beyond = tiles_of((left, right), (19.5, 49.5, 67.5, 81.5), first_px=300.0)
    assert not beyond.is_seen.any()
    assert not beyond.right.any()


@settings(deadline=None, max_examples=50)
@given(
    st.tuples(st.integers(11, 300), st.integers(13, 600)),
    st.tuples(*[st.floats(0, 1)] * 4),
    st.sampled_from([FINE, COARSE]),
)
def test_used_windows_are_in_box_and_image(
    image_hw: tuple[int, int], fractions: tuple[float, float, float, float], shape: TileShape
) -> None:
    height, width = image_hw
    (left, right), (top, bottom) = sorted(fractions[:2]), sorted(fractions[2:])
    box = np.array([left * width, top * height, right * width, bottom * height]) - 0.5
    size_px = np.maximum(box[2:] - box[:2], 8.0)
    box[2:] = box[:2] + size_px
    image = np.zeros(image_hw, np.uint8)
    tiles = box_tiles(image, image, box[None], np.array([3.0]), 9, shape)
    assert tiles.left.shape == (shape.hw[1] + 2 * MARGIN_PX, 1, shape.hw[0] + 2 * MARGIN_PX)
    assert len(tiles.right) == len(tiles.left) + 8
    assert tiles.u.shape == tiles.v.shape == tiles.is_used.shape == (1, N_WINDOWS)
    assert abs(tiles.first_px[0] - 3.0) <= 1.0
    for axis, (position, cell, side_px) in enumerate(
        zip((tiles.u, tiles.v), shape.cell_hw[::-1], (width, height), strict=True)
    ):
        scale = tiles.scale[axis, 0]
        used = position[tiles.is_used]
        centre_px = (box[axis] + box[axis + 2]) / 2 + used * size_px[axis]
        half_px, rounding_px = cell * scale, 0.5 * scale + 1e-6
        assert (centre_px - half_px >= -0.5 - rounding_px).all()
        assert (centre_px + half_px <= side_px - 0.5 + rounding_px).all()
        # a quarter of a window may be outside the box; of small boxes, the windows nearest to the
        # centre are used
        nearest = np.abs(position).min() + 1e-6
        assert (np.abs(used) <= np.maximum(0.5 - 0.5 * half_px / size_px[axis], nearest)).all()


def test_tiles_of_boxes_are_independent() -> None:
    boxes = (
        EXACT_BOX,
        (10.0, 10.0, 390.0, 130.0),
        (380.0, 120.0, 399.5, 139.5),
        (100.0, 30.0, 260.0, 60.0),
    )
    images = pair(20.0)
    together = tiles_of(images, *boxes)
    for i, box in enumerate(boxes):
        alone = tiles_of(images, box)
        for name in ("left", "right", "scale", "is_seen"):
            assert np.array_equal(getattr(together, name)[:, i], getattr(alone, name)[:, 0])
        for name in ("first_px", "u", "v", "is_used"):
            assert np.array_equal(getattr(together, name)[i], getattr(alone, name)[0])


def test_colour_images() -> None:
    grey = pair(12.0)
    colour = np.dstack([grey[0]] * 3), np.dstack([grey[1]] * 3)
    for box in (EXACT_BOX, (10.0, 10.0, 390.0, 130.0)):
        assert np.array_equal(tiles_of(colour, box).left, tiles_of(grey, box).left)
        assert np.array_equal(tiles_of(colour, box).right, tiles_of(grey, box).right)


class RecordingImage:
    """An image that records which rectangles of it are read: left, top, right, bottom."""

    def __init__(self, image: npt.NDArray[np.uint8]) -> None:
        self._image = image
        self.rectangles: list[tuple[int, int, int, int]] = []

    @property
    def shape(self) -> tuple[int, ...]:
        return self._image.shape

    def __getitem__(self, window: tuple[slice, slice], /) -> npt.NDArray[np.uint8]:
        rows, columns = window
        self.rectangles.append((columns.start, rows.start, columns.stop, rows.stop))
        return self._image[window]


def test_only_the_strips_are_read() -> None:
    left, right = pair(12.0)
    view = RecordingImage(right)
    boxes = np.array([EXACT_BOX, (19.5, 49.5, 67.5, 81.5)])
    box_tiles(left, view, boxes, np.array([12.0, 10.0]), 17, FINE)
    assert view.rectangles == [(196 - 28, 46, 252 - 12, 86), (0, 46, 72 - 10, 86)]
    assert all(0 <= edge <= 400 for rectangle in view.rectangles for edge in rectangle)
