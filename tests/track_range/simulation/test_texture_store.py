"""Tests of averaged textures: sizes, mean colours, margin and cache."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.simulation.render.face_table import TextureStore, quantized_up

SIZES = st.integers(1, 4000)


def noise(shape, *, seed=0):
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def test_quantized_sizes_worked_by_hand():
    # 2^(k/4) rounded up: ... 8, 9.51 -> 10, 11.3 -> 12, 13.5 -> 14, 16, 19.03 -> 20
    expected = np.array([1, 8, 10, 10, 12, 14, 16, 20])
    np.testing.assert_array_equal(
        quantized_up(np.array([1, 8, 9, 10, 11, 14, 15, 17]), np.full(8, 1000)), expected
    )
    assert quantized_up(np.array([17]), np.array([18]))[0] == 18


@settings(deadline=None)
@given(SIZES, SIZES)
def test_quantized_size_is_at_most_19_percent_larger(size, texels):
    step = int(quantized_up(np.array([size]), np.array([texels]))[0])
    assert min(size, texels) <= step <= min(np.ceil(1.19 * size), texels)


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 90), st.integers(1, 70), st.data())
def test_average_has_the_mean_colour_of_its_window(rows, columns, data):
    picture = noise((90, 70, 4))
    picture[:, :, 3] = 255
    top, left = data.draw(st.integers(0, 90 - rows)), data.draw(st.integers(0, 70 - columns))
    size = (data.draw(st.integers(1, rows)), data.draw(st.integers(1, columns)))
    store = TextureStore()
    number = store.add(picture)
    average = store.averaged(number, (top, top + rows, left, left + columns), size)
    assert average.shape == (size[0] + 2, size[1] + 2, 4)
    window = picture[top : top + rows, left : left + columns, :3].reshape(-1, 3)
    np.testing.assert_allclose(
        average[1:-1, 1:-1, :3].reshape(-1, 3).mean(axis=0), window.mean(axis=0), atol=2.0
    )


def test_mean_of_powers_of_two():
    picture = noise((64, 128, 4), seed=1)
    store = TextureStore()
    average = store.averaged(store.add(picture), (0, 64, 0, 128), (4, 16))
    np.testing.assert_allclose(
        average[1:-1, 1:-1].mean(axis=(0, 1)), picture.mean(axis=(0, 1)), atol=1.0
    )


def test_margin_is_transparent_with_edge_colours():
    picture = noise((6, 5, 4), seed=2)
    picture[:, :, 3] = 255
    store = TextureStore()
    padded = store.averaged(store.add(picture), (0, 6, 0, 5), (6, 5))
    np.testing.assert_array_equal(padded[1:-1, 1:-1], picture)
    np.testing.assert_array_equal(padded[0, 1:-1, :3], picture[0, :, :3])
    assert padded[[0, -1], :, 3].max() == padded[:, [0, -1], 3].max() == 0


def test_margin_of_a_shadow_is_transparent():
    store = TextureStore()
    padded = store.averaged(store.add(np.full((4, 4), 200, np.uint8)), (0, 4, 0, 4), (2, 2))
    assert padded.shape == (4, 4)
    assert padded[1:-1, 1:-1].min() == 200
    assert padded[[0, -1]].max() == padded[:, [0, -1]].max() == 0


@pytest.mark.parametrize("max_bytes", [10**9, 0])
def test_cached_and_recomputed_averages_are_equal(max_bytes):
    store = TextureStore(max_bytes)
    number = store.add(noise((40, 40, 4), seed=3))
    first = store.averaged(number, (0, 40, 0, 40), (7, 9))
    again = store.averaged(number, (0, 40, 0, 40), (7, 9))
    assert (again is first) == (max_bytes > 0)
    np.testing.assert_array_equal(again, first)
