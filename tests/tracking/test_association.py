from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays

from track_range.detection.classes import ROAD_CLASSES
from track_range.tracking.association import are_compatible, iou_cost, min_cost_matching, widened


def test_iou_cost_by_hand() -> None:
    # 10 x 10 boxes, shifted by half: intersection 50, union 150
    cost = iou_cost(
        np.array([[0.0, 0.0, 10.0, 10.0]]),
        np.array([[5.0, 0.0, 15.0, 10.0], [0.0, 0.0, 10.0, 10.0]]),
    )
    np.testing.assert_allclose(cost, [[2 / 3, 0.0]])


def test_margin_lets_separate_boxes_overlap() -> None:
    left, right = np.array([[0.0, 0.0, 10.0, 10.0]]), np.array([[12.0, 0.0, 22.0, 10.0]])
    assert iou_cost(left, right)[0, 0] == 1.0
    # widened by 0.3: -3..13 and 9..25, both 16 x 16: intersection 4 * 16, union 2 * 256 - 64
    assert iou_cost(left, right, margin=0.3)[0, 0] == pytest.approx(1 - 64 / 448)


def test_widened_by_hand() -> None:
    np.testing.assert_allclose(
        widened(np.array([[0.0, 10.0, 10.0, 30.0]]), 0.5), [[-5.0, 0.0, 15.0, 40.0]]
    )


@pytest.mark.parametrize(
    ("a", "b", "is_compatible"),
    [
        ("car", "car", True),
        ("car", "truck", True),
        ("bus", "car", True),
        ("bicycle", "motorcycle", True),
        ("person", "bicycle", False),
        ("person", "car", False),
        ("traffic light", "traffic sign", False),
    ],
)
def test_compatible_classes(a: str, b: str, is_compatible: bool) -> None:
    i, j = ROAD_CLASSES.index(a), ROAD_CLASSES.index(b)
    votes = np.eye(len(ROAD_CLASSES))[[i]]
    assert are_compatible(np.array([i]), votes, np.array([j]))[0, 0] == is_compatible
    assert are_compatible(np.array([i]), votes, np.array([j]), "same")[0, 0] == (i == j)
    assert are_compatible(np.array([i]), votes, np.array([j]), "any")[0, 0]


def test_a_track_of_two_names_continues_with_either() -> None:
    votes = np.zeros((2, len(ROAD_CLASSES)))
    votes[0, [0, 1]] = 5.0, 0.3  # a rider: person, and once bicycle
    votes[1, 0] = 5.0
    classes = np.array([ROAD_CLASSES.index(name) for name in ("bicycle", "motorcycle", "car")])
    assert are_compatible(np.array([0, 0]), votes, classes).tolist() == [
        [True, True, False],
        [False] * 3,
    ]


def test_total_cost_is_minimised() -> None:
    # Greedy matching would take (0, 0) at 0.1, then (1, 1) at 0.9.
    rows, columns = min_cost_matching(np.array([[0.1, 0.2], [0.2, 0.9]]), max_cost=1.0)
    assert list(zip(rows, columns, strict=True)) == [(0, 1), (1, 0)]


def test_a_bad_pair_does_not_displace_a_good_one() -> None:
    # Matching both rows would cost 0.5 and 0.85 > 0.7.
    rows, columns = min_cost_matching(np.array([[0.1, 0.5], [0.85, np.inf]]), max_cost=0.7)
    assert list(zip(rows, columns, strict=True)) == [(0, 0)]


def test_infinite_cost_forbids() -> None:
    rows, columns = min_cost_matching(np.full((2, 3), np.inf), max_cost=0.9)
    assert len(rows) == len(columns) == 0


@pytest.mark.parametrize("shape", [(0, 0), (0, 3), (2, 0)])
def test_empty_cost_matrix(shape: tuple[int, int]) -> None:
    rows, columns = min_cost_matching(np.zeros(shape), max_cost=0.5)
    assert rows.dtype == columns.dtype == np.int64
    assert len(rows) == len(columns) == 0


@given(
    cost=st.tuples(st.integers(1, 4), st.integers(1, 4)).flatmap(
        lambda s: arrays(float, s, elements=st.floats(0, 1))
    ),
    max_cost=st.floats(0.1, 0.9),
)
@settings(deadline=None)
def test_matching_is_optimal(cost: np.ndarray, max_cost: float) -> None:
    rows, columns = min_cost_matching(cost, max_cost=max_cost)
    assert len(set(rows)) == len(rows)
    assert len(set(columns)) == len(columns)
    assert (cost[rows, columns] <= max_cost).all()
    total = cost[rows, columns].sum() + max_cost * (len(cost) - len(rows))
    # one more column per row: unmatched
    padded = np.pad(cost, ((0, 0), (0, len(cost))), constant_values=max_cost)
    choices = permutations(range(padded.shape[1]), len(cost))
    assert total == pytest.approx(min(padded[np.arange(len(cost)), list(c)].sum() for c in choices))
