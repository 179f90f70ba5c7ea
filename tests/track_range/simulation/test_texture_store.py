"""Averages of textures: their sizes, what they keep of the colours, and that they are made once."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from track_range.simulation.render.texture_store import TextureStore, stepped_up

SIZES = st.integers(1, 4000)


def noise(shape, *, seed=0):
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def test_steps_by_hand():
    # 2^(k/4) rounded up: ... 8, 9.51 -> 10, 11.3 -> 12, 13.5 -> 14, 16, 19.03 -> 20
    wanted = np.array([1, 8, 10, 10, 12, 14, 16, 20])
    np.testing.assert_array_equal(stepped_up(np.array([1, 8, 9, 10, 11, 14, 15, 17]), np.full(8, 1000)), wanted)
    assert stepped_up(np.array([17]), np.array([18]))[0] == 18


@settings(deadline=None)
@given(SIZES, SIZES)
def test_a_step_has_at_least_the_texels_wanted_and_a_fifth_more_at_most(size, texels):
    step = int(stepped_up(np.array([size]), np.array([texels]))[0])
    assert min(size, texels) <= step <= min(np.ceil(1.19 * size), texels)


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 90), st.integers(1, 70), st.data())
def test_an_average_keeps_the_mean_colour_of_its_window(rows, columns, data):
    picture = noise((90, 70, 4))
    picture[:, :, 3] = 255
    top, left = data.draw(st.integers(0, 90 - rows)), data.draw(st.integers(0, 70 - columns))
    size = (data.draw(st.integers(1, rows)), data.draw(st.integers(1, columns)))
    store = TextureStore()
    number = store.add(picture)
    average = store.averaged(number, (top, top + rows, left, left + columns), size)
    assert average.shape == (size[0] + 2, size[1] + 2, 4)
    window = picture[top : top + rows, left : left + columns, :3].reshape(-1, 3)
    np.testing.assert_allclose(average[1:-1, 1:-1, :3].reshape(-1, 3).mean(axis=0), window.mean(axis=0), atol=2.0)


def test_powers_of_two_keep_the_mean_exactly():
    picture = noise((64, 128, 4), seed=1)
    store = TextureStore()
    average = store.averaged(store.add(picture), (0, 64, 0, 128), (4, 16))
    np.testing.assert_allclose(average[1:-1, 1:-1].mean(axis=(0, 1)), picture.mean(axis=(0, 1)), atol=1.0)


def test_the_margin_is_transparent_and_has_the_edge_s_colours():
    picture = noise((6, 5, 4), seed=2)
    picture[:, :, 3] = 255
    store = TextureStore()
    framed = store.averaged(store.add(picture), (0, 6, 0, 5), (6, 5))
    np.testing.assert_array_equal(framed[1:-1, 1:-1], picture)
    np.testing.assert_array_equal(framed[0, 1:-1, :3], picture[0, :, :3])
    assert framed[[0, -1], :, 3].max() == framed[:, [0, -1], 3].max() == 0


def test_a_shadow_s_margin_is_no_shadow():
    store = TextureStore()
    framed = store.averaged(store.add(np.full((4, 4), 200, np.uint8)), (0, 4, 0, 4), (2, 2))
    assert framed.shape == (4, 4)
    assert framed[1:-1, 1:-1].min() == 200
    assert framed[[0, -1]].max() == framed[:, [0, -1]].max() == 0


@pytest.mark.parametrize("most_bytes", [10**9, 0])
def test_what_was_made_is_kept_while_there_is_room_and_the_same_when_made_again(most_bytes):
    store = TextureStore(most_bytes)
    number = store.add(noise((40, 40, 4), seed=3))
    first = store.averaged(number, (0, 40, 0, 40), (7, 9))
    again = store.averaged(number, (0, 40, 0, 40), (7, 9))
    assert (again is first) == (most_bytes > 0)
    np.testing.assert_array_equal(again, first)
