"""Margins of a surface's minimum, by hand."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from tests.stereo.tile_cases import tiles_of
from track_range.stereo.matching.confidence import MatchConfidence, match_confidence
from track_range.stereo.matching.subpixel import RefinedSurface
from track_range.stereo.matching.surfaces import SurfaceFit

N_DISPARITIES = 41


def surface(
    centre: float, *, tilt: tuple[float, float] = (0.0, 0.0), others: tuple[int, ...] = ()
) -> RefinedSurface:
    """A plane with p0 = `centre` from index 0, through all 49 windows but `others`."""
    residual = np.zeros((1, 49))
    residual[0, list(others)] = np.nan
    is_member = np.isfinite(residual)
    return RefinedSurface(
        SurfaceFit(np.array([[centre, *tilt, 0.0, 0.0]])), residual, is_member * 1.0, is_member
    )


def costs(*minima: tuple[int, float]) -> npt.NDArray[np.float32]:
    """12 bits in all windows, except at these (index, bits)."""
    cost = np.full((N_DISPARITIES, 49, 1), 12.0, np.float32)
    for index, bits in minima:
        cost[index] = bits
    return cost


def confidence_of(
    cost: npt.NDArray[np.float32], plane: RefinedSurface, first_px: float = 0.0
) -> MatchConfidence:
    return match_confidence(cost, plane, tiles_of(first_px=first_px, n_disparities=N_DISPARITIES))


def test_single_minimum() -> None:
    confidence = confidence_of(costs((20, 3.0), (19, 6.0), (21, 6.0)), surface(19.8))
    assert (confidence.cost[0], confidence.margin[0], confidence.second_best_margin[0]) == (
        3.0,
        9.0,
        9.0,
    )
    assert confidence.is_inside[0]


def test_second_best_minimum() -> None:
    # at 20 px the minimum extends over 2 + 20 // 20 = 3 px; the V-shaped fit to a single low cost
    # is that cost
    assert confidence_of(costs((20, 3.0), (23, 4.0)), surface(20.0)).second_best_margin[0] == 9.0
    assert confidence_of(costs((20, 3.0), (24, 4.0)), surface(20.0)).second_best_margin[0] == 1.0
    assert confidence_of(costs((20, 3.0), (24, 2.0)), surface(20.0)).second_best_margin[0] == -1.0
    # the same costs 80 px nearer: within 2 + 100 // 20 = 7 px
    assert (
        confidence_of(costs((20, 3.0), (27, 4.0)), surface(20.0), first_px=80).second_best_margin[0]
        == 9.0
    )
    assert (
        confidence_of(costs((20, 3.0), (28, 4.0)), surface(20.0), first_px=80).second_best_margin[0]
        == 1.0
    )


def test_second_best_minimum_between_disparities() -> None:
    # costs 9, 5, 6 about index 30: the V has its minimum 1.5 bits below
    confidence = confidence_of(costs((20, 3.0), (29, 9.0), (30, 5.0), (31, 6.0)), surface(20.0))
    assert confidence.second_best_margin[0] == pytest.approx(5.0 - 1.5 - 3.0)


def test_windows_of_other_surfaces_are_ignored() -> None:
    cost = costs((20, 3.0))
    cost[30, :20] = 0.0  # another surface in twenty windows
    confidence = confidence_of(cost, surface(20.0, others=tuple(range(20))))
    assert (confidence.margin[0], confidence.second_best_margin[0]) == (9.0, 9.0)


def test_a_slanted_surface_has_one_minimum() -> None:
    cost = costs()
    # 16 px per box width to the right and 8 px per height down: 2 and 1 px per window
    for g in range(49):
        cost[20 + 2 * (g % 7 - 3) + (g // 7 - 3), g] = 2.0
    assert confidence_of(cost, surface(20.0, tilt=(16.0, 8.0))).margin[0] == 10.0
    assert confidence_of(cost, surface(20.0)).margin[0] < 2.0


def test_disparities_seen_by_few_windows_are_ignored() -> None:
    cost = costs((20, 3.0), (30, 1.0))
    cost[30, :25] = np.nan
    assert confidence_of(cost, surface(20.0)).second_best_margin[0] == 9.0
    cost[30, 24] = 1.0
    assert confidence_of(cost, surface(20.0)).second_best_margin[0] == -2.0


@pytest.mark.parametrize(
    ("centre", "is_inside"), [(0.4, False), (0.6, True), (39.4, True), (39.6, False)]
)
def test_the_ends_of_the_range_are_not_inside(centre: float, is_inside: bool) -> None:
    assert bool(confidence_of(costs((20, 3.0)), surface(centre)).is_inside[0]) is is_inside
    assert (
        bool(confidence_of(costs((20, 3.0)), surface(centre), first_px=7).is_inside[0]) is is_inside
    )


def test_chance_cost_is_the_upper_quartile() -> None:
    cost = np.broadcast_to(np.arange(41, dtype=np.float32)[:, None, None], (41, 49, 1)).copy()
    assert confidence_of(cost, surface(5.0)).margin[0] == pytest.approx(30.0 - 5.0)


def test_no_surface_and_no_costs() -> None:
    nothing = confidence_of(costs((20, 3.0)), surface(0.0, others=tuple(range(49))))
    assert not nothing.is_inside[0]
    assert not nothing.margin[0] > 0
    unseen = confidence_of(np.full((N_DISPARITIES, 49, 1), np.nan, np.float32), surface(20.0))
    assert not unseen.margin[0] > 0
    assert not np.isfinite(unseen.cost[0])
