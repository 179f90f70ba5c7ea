"""Galleries: compared with a loop, slots by hand, tracks and boxes without embeddings."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.tracking.appearance.gallery import Gallery, unit_rows

EAST, NORTH, WEST = np.float32([[1, 0]]), np.float32([[0, 1]]), np.float32([[-1, 0]])
UNKNOWN = np.zeros((1, 2), np.float32)
FIRST = np.array([0])


def random_rows(rng, n, length, *, unknown=0.3):
    rows = unit_rows(rng.normal(size=(n, length)))
    rows[rng.random(n) < unknown] = 0
    return rows


def of_one(*embeddings, nn_budget=4):
    gallery = Gallery.empty(nn_budget=nn_budget).initiate(embeddings[0])
    for embedding in embeddings[1:]:
        gallery = gallery.append(FIRST, embedding)
    return gallery


class ListGallery:
    """Reference implementation for one track, with lists."""

    def __init__(self, first, nn_budget):
        self.nn_budget, self.mean, self.last = nn_budget, None, []
        self.append(first)

    def append(self, new):
        if not new.any():
            return
        mixed = new if self.mean is None else 0.9 * self.mean + 0.1 * new
        self.mean = mixed / np.linalg.norm(mixed)
        self.last = [new, *self.last][: self.nn_budget - 1]

    def distance(self, embedding):
        if self.mean is None or not embedding.any():
            return np.inf
        return min(1 - float(slot @ embedding) for slot in (self.mean, *self.last))


@settings(deadline=None, max_examples=60)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 6),
    st.integers(0, 7),
    st.integers(1, 5),
    st.integers(2, 5),
    st.floats(0, 1),
)
def test_equals_a_loop_over_lists(seed, n, m, nn_budget, length, fraction):
    rng = np.random.default_rng(seed)
    first = random_rows(rng, n, length)
    gallery, reference = (
        Gallery.empty(nn_budget=nn_budget).initiate(first),
        [ListGallery(e, nn_budget) for e in first],
    )
    for _ in range(4):
        rows = rng.permutation(n)[: rng.integers(0, n + 1)]
        new = random_rows(rng, len(rows), length)
        gallery = gallery.append(rows, new)
        for row, embedding in zip(rows, new, strict=True):
            reference[row].append(embedding)
    boxes = random_rows(rng, m, length)
    expected = np.array([[track.distance(box) for box in boxes] for track in reference]).reshape(
        n, m
    )
    np.testing.assert_allclose(gallery.cosine_distance(boxes), expected, atol=1e-5)
    among = rng.random((n, m)) < fraction
    np.testing.assert_allclose(
        gallery.cosine_distance(boxes, among), np.where(among, expected, np.inf), atol=1e-5
    )


def test_single_pairs_equal_the_matrix_product():
    rng = np.random.default_rng(3)
    gallery = (
        Gallery.empty(nn_budget=3)
        .initiate(random_rows(rng, 120, 16))
        .append(np.arange(120), random_rows(rng, 120, 16))
    )
    boxes = random_rows(rng, 150, 16)
    among = rng.random((120, 150)) < 0.05  # one by one, in more than one block
    assert among.sum() > 512
    expected = np.where(among, gallery.cosine_distance(boxes), np.inf)
    np.testing.assert_allclose(gallery.cosine_distance(boxes, among), expected, atol=1e-6)


def test_a_distance_is_never_negative():
    rows = random_rows(np.random.default_rng(2), 300, 144, unknown=0)
    assert (1 - np.einsum("nd,nd->n", rows, rows)).min() < 0  # by rounding
    gallery = Gallery.empty(nn_budget=2).initiate(rows)
    for among in (None, np.eye(300, dtype=bool)):
        nearest = np.diag(gallery.cosine_distance(rows, among))
        assert 0 <= nearest.min() <= nearest.max() < 1e-6


def test_distances_by_hand():
    gallery = Gallery.empty(nn_budget=4).initiate(np.concatenate([EAST, NORTH, UNKNOWN]))
    boxes = np.concatenate([EAST, WEST, UNKNOWN])
    expected = [[0, 2, np.inf], [1, 1, np.inf], [np.inf] * 3]
    np.testing.assert_array_equal(gallery.cosine_distance(boxes), expected)
    assert gallery.is_known.tolist() == [True, True, False]


def test_slots_hold_mean_and_last_embeddings():
    gallery = of_one(EAST, NORTH, NORTH)
    assert gallery.cosine_distance(EAST)[0, 0] == 0  # the first is the last slot
    gallery = gallery.append(FIRST, NORTH)
    mean = np.array([0.9, 0.1]) / np.hypot(0.9, 0.1)
    for _ in range(2):
        mean = 0.9 * mean + [0, 0.1]
        mean /= np.linalg.norm(mean)
    np.testing.assert_allclose(gallery.embedding[0], [mean, [0, 1], [0, 1], [0, 1]], atol=1e-6)
    assert gallery.cosine_distance(EAST)[0, 0] == pytest.approx(
        1 - mean[0], abs=1e-6
    )  # only the mean still depends on it


def test_one_slot_is_the_mean_alone():
    gallery = of_one(EAST, NORTH, nn_budget=1)
    np.testing.assert_allclose(
        gallery.embedding[0, 0], np.array([0.9, 0.1]) / np.hypot(0.9, 0.1), atol=1e-6
    )


def test_unknown_embeddings_change_nothing():
    assert of_one(EAST, UNKNOWN).embedding.tolist() == of_one(EAST).embedding.tolist()
    late = of_one(UNKNOWN, UNKNOWN, WEST)
    np.testing.assert_array_equal(late.embedding, np.broadcast_to(WEST[0], (1, 4, 2)))
    assert late.cosine_distance(EAST)[0, 0] == 2  # an empty slot would give 1


def test_mean_of_opposite_embeddings_is_finite():
    gallery = Gallery(np.repeat(EAST[:, None], 2, axis=1), mean_memory=0.5).append(FIRST, WEST)
    assert np.isfinite(gallery.embedding).all()
    assert np.isfinite(Gallery.empty(nn_budget=2).initiate(EAST).cosine_distance(WEST)).all()


def test_inputs_are_not_modified():
    rng = np.random.default_rng(0)
    first, new = random_rows(rng, 5, 4, unknown=0), random_rows(rng, 2, 4, unknown=0)
    gallery = Gallery.empty(nn_budget=3).initiate(first)
    before = [array.copy() for array in (gallery.embedding, first, new)]
    for array in (gallery.embedding, first, new):
        array.setflags(write=False)
    later = gallery.append(np.array([3, 1]), new)
    later.select(np.array([1, 0])).concatenate(gallery).cosine_distance(new)
    for array, copy in zip((gallery.embedding, first, new), before, strict=True):
        np.testing.assert_array_equal(array, copy)
    np.testing.assert_array_equal(later.embedding[[0, 2, 4]], gallery.embedding[[0, 2, 4]])
    np.testing.assert_array_equal(later.embedding[[3, 1], 1], new)


def test_select_and_concatenate():
    gallery = Gallery(
        np.repeat(np.concatenate([EAST, NORTH, WEST])[:, None], 2, axis=1), mean_memory=0.7
    )
    chosen = gallery.select(np.array([2, 0]))
    both = chosen.concatenate(gallery.select(np.array([False, True, False])))
    np.testing.assert_array_equal(both.embedding[:, 0], np.concatenate([WEST, EAST, NORTH]))
    assert (len(both), both.mean_memory) == (3, 0.7)


def test_gallery_without_embeddings():
    none = np.zeros((3, 0), np.float32)
    gallery = Gallery.empty(nn_budget=4).initiate(none)
    gallery = gallery.append(np.array([0, 1, 2]), none).select(np.array([True, False, True]))
    assert gallery.embedding.shape == (2, 4, 0)
    np.testing.assert_array_equal(gallery.cosine_distance(none), np.full((2, 3), np.inf))
    np.testing.assert_array_equal(
        gallery.cosine_distance(np.concatenate([EAST, WEST])), np.full((2, 2), np.inf)
    )
    assert Gallery.empty(nn_budget=4).cosine_distance(EAST).shape == (0, 1)
    assert of_one(EAST).cosine_distance(np.zeros((0, 2), np.float32)).shape == (1, 0)


def test_embeddings_of_some_frames_only():
    gallery = Gallery.empty(nn_budget=2).initiate(np.zeros((2, 0), np.float32))
    gallery = (
        gallery.append(np.array([1]), EAST).initiate(NORTH).initiate(np.zeros((1, 0), np.float32))
    )
    gallery = gallery.append(np.array([1, 2]), np.zeros((2, 0), np.float32))
    np.testing.assert_array_equal(gallery.cosine_distance(EAST)[:, 0], [np.inf, 0, 1, np.inf])


def test_embeddings_of_other_lengths():
    longer = np.float32([[1, 0, 0]])
    for method in (
        of_one(EAST).initiate,
        of_one(EAST).cosine_distance,
        lambda d: of_one(EAST).append(FIRST, d),
    ):
        with pytest.raises(ValueError, match="length"):
            method(longer)
    with pytest.raises(ValueError, match=r"embedding.*shape"):
        Gallery(np.zeros((2, 3), np.float32))
    with pytest.raises(ValueError, match="slot"):
        Gallery.empty(nn_budget=0)


def test_unit_rows():
    rows = unit_rows(
        np.array([[3.0, 4.0], [0, 0], [np.nan, 1], [np.inf, 1], [1e300, 0], [1e-300, 1e-300]])
    )
    assert rows.dtype == np.float32
    np.testing.assert_allclose(
        rows, [[0.6, 0.8], [0, 0], [0, 0], [0, 0], [1, 0], [0.5**0.5] * 2], atol=1e-6
    )
    assert unit_rows(np.zeros((2, 0))).shape == (2, 0)
    assert unit_rows(np.zeros((0, 3))).shape == (0, 3)
