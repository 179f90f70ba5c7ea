"""Margins of a surface's minimum, by hand."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from track_range.stereo.matching.confidence import MatchConfidence, match_confidence
from track_range.stereo.matching.plane_fit import Surface
from track_range.stereo.matching.sample_windows import BoxWindows

N_DISPARITIES = 41
GRID = np.arange(3) * 10
WINDOWS = BoxWindows(np.array([0]), np.tile(100 + GRID, 3)[None], np.repeat(50 + GRID, 3)[None])


def surface(centre: float, *, tilt: tuple[float, float] = (0.0, 0.0), others: tuple[int, ...] = ()) -> Surface:
    residual = np.zeros((1, 9))
    residual[0, list(others)] = np.nan
    return Surface(np.array([centre]), np.array([tilt]), residual, np.array([1.0]))


def costs(*minima: tuple[int, float]) -> npt.NDArray[np.float32]:
    """12 bits in all nine windows, except at these (disparity, bits)."""
    cost = np.full((N_DISPARITIES, 1, 9), 12.0, np.float32)
    for disparity, bits in minima:
        cost[disparity] = bits
    return cost


def confidence_of(cost: npt.NDArray[np.float32], plane: Surface, first: int = 0) -> MatchConfidence:
    return match_confidence(cost, plane, WINDOWS, np.array([first]))


def test_single_minimum() -> None:
    confidence = confidence_of(costs((20, 3.0), (19, 6.0), (21, 6.0)), surface(19.8))
    assert (confidence.cost[0], confidence.margin[0], confidence.second_best_margin[0]) == (3.0, 9.0, 9.0)
    assert confidence.is_inside[0]


def test_second_best_minimum() -> None:
    # at 20 px the minimum extends over 2 + 20 // 20 = 3 px
    assert confidence_of(costs((20, 3.0), (23, 4.0)), surface(20.0)).second_best_margin[0] == 9.0
    assert confidence_of(costs((20, 3.0), (24, 4.0)), surface(20.0)).second_best_margin[0] == 1.0
    assert confidence_of(costs((20, 3.0), (24, 2.0)), surface(20.0)).second_best_margin[0] == -1.0
    # the same costs 80 px nearer: within 2 + 100 // 20 = 7 px
    assert confidence_of(costs((20, 3.0), (27, 4.0)), surface(100.0), first=80).second_best_margin[0] == 9.0
    assert confidence_of(costs((20, 3.0), (28, 4.0)), surface(100.0), first=80).second_best_margin[0] == 1.0


def test_windows_of_other_surfaces_are_ignored() -> None:
    cost = costs((20, 3.0))
    cost[30, 0, :4] = 0.0  # another surface in four windows
    confidence = confidence_of(cost, surface(20.0, others=(0, 1, 2, 3)))
    assert (confidence.margin[0], confidence.second_best_margin[0]) == (9.0, 9.0)


def test_a_slanted_surface_has_one_minimum() -> None:
    cost = np.full((N_DISPARITIES, 1, 9), 12.0, np.float32)
    for window, disparity in enumerate([17, 20, 23, 18, 21, 24, 19, 22, 25]):  # 6 px to the right, 2 px down
        cost[disparity, 0, window] = 2.0
    assert confidence_of(cost, surface(21.0, tilt=(6.0, 2.0))).margin[0] == 10.0
    assert confidence_of(cost, surface(21.0)).margin[0] < 2.0


def test_disparities_seen_by_few_windows_are_ignored() -> None:
    cost = costs((20, 3.0), (30, 1.0))
    cost[30, 0, :5] = np.nan
    assert confidence_of(cost, surface(20.0)).second_best_margin[0] == 9.0
    cost[30, 0, 4] = 1.0
    assert confidence_of(cost, surface(20.0)).second_best_margin[0] == -2.0


@pytest.mark.parametrize(("centre", "is_inside"), [(0.4, False), (0.6, True), (39.4, True), (39.6, False)])
def test_the_ends_of_the_range_are_not_inside(centre: float, is_inside: bool) -> None:
    assert bool(confidence_of(costs((20, 3.0)), surface(centre)).is_inside[0]) is is_inside
    assert bool(confidence_of(costs((20, 3.0)), surface(centre + 7), first=7).is_inside[0]) is is_inside


def test_chance_cost_is_the_upper_quartile() -> None:
    cost = np.broadcast_to(np.arange(41, dtype=np.float32)[:, None, None], (41, 1, 9)).copy()
    assert confidence_of(cost, surface(5.0)).margin[0] == pytest.approx(30.0 - 5.0)


def test_no_surface_and_no_costs() -> None:
    nothing = confidence_of(costs((20, 3.0)), surface(np.nan, others=tuple(range(9))))
    assert not nothing.is_inside[0]
    assert not nothing.margin[0] > 0
    unseen = confidence_of(np.full((N_DISPARITIES, 1, 9), np.nan, np.float32), surface(20.0))
    assert not unseen.margin[0] > 0
    assert not np.isfinite(unseen.cost[0])
