"""Semi-global matching on the grid compared with brute force, and planes through the windows of the object."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from track_range.foundation.arrays import FloatArray
from track_range.stereo.matching.plane_fit import Surface, object_surface
from track_range.stereo.matching.window_sgm import match_windows

SMALL_STEP, LARGE_STEP, UNSEEN = 1.5, 6.0, 8.0
NO_PRIOR = np.array([np.nan])


def slow_path_costs(cost: FloatArray, step: tuple[int, int]) -> FloatArray:
    """L(w, d) of a path with the step `step` (rows, columns) through costs (rows, columns, D)."""
    rows, columns, n_disparities = cost.shape
    paths = np.zeros_like(cost)
    for row in range(rows)[:: step[0] or 1]:
        for column in range(columns)[:: step[1] or 1]:
            row_before, column_before = row - step[0], column - step[1]
            for d in range(n_disparities):
                paths[row, column, d] = cost[row, column, d]
                if not (0 <= row_before < rows and 0 <= column_before < columns):
                    continue
                before = paths[row_before, column_before]
                candidates = [before[d], before.min() + LARGE_STEP]
                candidates += [before[k] + SMALL_STEP for k in (d - 1, d + 1) if 0 <= k < n_disparities]
                paths[row, column, d] += min(candidates) - before.min()
    return paths


def slow_matches(cost: FloatArray) -> tuple[list[int], list[float], list[float]]:
    """Index, offset and weight of the windows of one box, from costs (D, G), by the definition."""
    side = int(np.sqrt(cost.shape[1]))
    known = np.where(np.isnan(cost), UNSEEN, cost)
    grid = known.T.reshape(side, side, -1)
    total = sum(slow_path_costs(grid, step) for step in ((0, 1), (0, -1), (1, 0), (-1, 0))).reshape(side * side, -1)
    index, offset, weight = [], [], []
    for window, paths in enumerate(total):
        own = known[:, window]
        chosen = min(max(int(np.argmin(paths)), 1), len(own) - 2)
        best = min(range(chosen - 1, chosen + 2), key=lambda k: (own[k], k))
        best = min(max(best, 1), len(own) - 2)
        below, at, above = own[best - 1 : best + 2]
        is_seen = bool(np.isfinite(cost[best - 1 : best + 2, window]).all())
        is_minimum = is_seen and at <= min(below, above) and max(below, above) > at
        slope = max(below, above) - at
        index.append(best)
        offset.append((below - above) / (2 * slope) if is_minimum else 0.0)
        weight.append(slope if is_minimum else 0.0)
    return index, offset, weight


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("side", [3, 6])
def test_window_sgm_equals_brute_force(seed: int, side: int) -> None:
    rng = np.random.default_rng(seed)
    cost = rng.uniform(0, 12, (9, 4, side * side))
    cost[rng.uniform(size=cost.shape) < 0.1] = np.nan
    cost[:, 3, :2] = np.nan  # windows outside the right image
    matches = match_windows(cost.astype(np.float32))
    for box in range(4):
        index, offset, weight = slow_matches(cost[:, box])
        assert matches.index[box].tolist() == index
        assert np.allclose(matches.offset[box], offset, atol=1e-5)
        assert np.allclose(matches.weight[box], weight, atol=1e-5)
    assert not matches.weight[3, :2].any()


def test_window_without_minimum_follows_neighbours() -> None:
    cost = np.full((15, 1, 9), 10.0, np.float32)
    cost[6, 0, :] = 2.0
    cost[:, 0, 4] = 9.0  # without texture, in the middle
    cost[12, 0, 4] = 8.9
    matches = match_windows(cost)
    assert matches.index[0, [0, 3, 5, 8]].tolist() == [6] * 4
    assert matches.index[0, 4] in (5, 6, 7)  # its least cost is at 12
    assert matches.weight[0].tolist() == [8.0] * 4 + [0.0] + [8.0] * 4


def test_the_v_shaped_fit_is_exact_for_a_v() -> None:
    true = np.array([5.0, 5.2, 5.49, 4.6, 4.51, 5.3, 5.1, 4.9, 4.8])
    cost = 3.0 + 4.0 * np.abs(np.arange(12)[:, None, None] - true)
    matches = match_windows(cost.astype(np.float32))
    assert np.allclose(matches.index[0] + matches.offset[0], true, atol=1e-5)
    assert np.allclose(matches.weight[0], 4.0, atol=1e-5)


def test_a_common_minimum_at_the_end_has_no_weight() -> None:
    cost = np.broadcast_to(np.linspace(2, 10, 9)[:, None, None], (9, 1, 9)).astype(np.float32)
    matches = match_windows(cost)
    assert matches.index.tolist() == [[1] * 9]
    assert not matches.weight.any()


def grid_positions(side: int = 6) -> tuple[FloatArray, FloatArray]:
    """One box's windows, -0.5 .. 0.5 to the right and down, row by row."""
    line = np.linspace(-0.5, 0.5, side)
    down, right = np.meshgrid(line, line, indexing="ij")
    return right.reshape(1, -1), down.reshape(1, -1)


RIGHT, DOWN = grid_positions()


def surface_of(disparity: FloatArray, *, weight: FloatArray | None = None, prior: FloatArray = NO_PRIOR) -> Surface:
    """Surface of one box of 6 x 6 windows."""
    return object_surface(
        disparity, np.full((1, 36), 4.0) if weight is None else weight, positions=(RIGHT, DOWN), prior=prior
    )


def test_a_tilted_plane_by_hand_with_outliers() -> None:
    disparity = 30.0 + 3.0 * RIGHT - 1.0 * DOWN
    disparity[0, [0, 7, 20, 33]] += [14.0, -12.0, 25.0, -28.0]  # other surfaces
    disparity[0, [3, 16]] += [2.5, -2.0]  # bad matches of the same surface
    surface = surface_of(disparity)
    assert surface.centre[0] == pytest.approx(30.0, abs=0.05)
    assert surface.tilt[0] == pytest.approx([3.0, -1.0], abs=0.1)
    assert np.flatnonzero(np.isnan(surface.residual[0])).tolist() == [0, 7, 20, 33]
    assert surface.residual[0, [3, 16]] == pytest.approx([2.5, -2.0], abs=0.1)
    assert surface.support[0] == pytest.approx(32 / 36)


def test_windows_without_minimum_are_ignored() -> None:
    disparity, weight = np.full((1, 36), 20.0), np.full((1, 36), 4.0)
    disparity[0, 20:], weight[0, 20:] = 55.0, 0.0
    surface = surface_of(disparity, weight=weight)
    assert surface.centre[0] == pytest.approx(20.0, abs=1e-3)
    assert surface.support[0] == 1.0
    assert np.isnan(surface.residual[0, 20:]).all()


@pytest.mark.parametrize(
    ("is_object", "object_px", "other_px"),
    [
        (np.abs(RIGHT) < 0.35, 25.0, 10.0),  # a person before the background
        (DOWN > -0.15, 25.0, 10.0),  # a car under the sky
        (RIGHT > -0.2, 20.0, 40.0),  # a car behind a pillar at the left
        (np.abs(RIGHT - 0.1) > 0.05, 20.0, 45.0),  # behind a pole
    ],
)
def test_object_is_the_surface_at_the_lower_middle(
    is_object: npt.NDArray[np.bool_], object_px: float, other_px: float
) -> None:
    surface = surface_of(np.where(is_object, object_px, other_px))
    assert surface.centre[0] == pytest.approx(object_px, abs=1e-3)
    assert np.array_equal(np.isfinite(surface.residual), is_object)


def test_lower_half_or_prior_decides() -> None:
    halves = np.where(DOWN > 0, 20.0, 30.0)
    for prior_px, expected_px in ((np.nan, 20.0), (19.0, 20.0), (31.0, 30.0), (90.0, 20.0)):
        assert surface_of(halves, prior=np.array([prior_px])).centre[0] == pytest.approx(expected_px, abs=1e-3)


def test_the_prior_decides_between_equal_halves() -> None:
    halves = np.where(RIGHT > 0, 20.0, 30.0)
    for prior_px in (20.0, 30.0):
        assert surface_of(halves, prior=np.array([prior_px])).centre[0] == pytest.approx(prior_px, abs=1e-3)


def test_few_windows_near_the_prior_do_not_win() -> None:
    few = np.where(np.arange(36) < 6, 40.0, 20.0)[None]
    assert surface_of(few, prior=np.array([40.0])).centre[0] == pytest.approx(20.0, abs=1e-3)


def test_less_than_four_windows_are_no_surface() -> None:
    weight = np.zeros((1, 36))
    weight[0, [14, 15, 20]] = 4.0
    disparity = np.full((1, 36), 20.0)
    assert np.isnan(surface_of(disparity, weight=weight).centre[0])
    weight[0, 21] = 4.0
    assert surface_of(disparity, weight=weight).centre[0] == pytest.approx(20.0)
    nothing = surface_of(disparity, weight=np.zeros((1, 36)))
    assert np.isnan(nothing.centre[0])
    assert nothing.support[0] == 0.0


def test_planes_of_boxes_are_independent() -> None:
    rng = np.random.default_rng(2)
    disparity, weight = rng.uniform(18, 24, (5, 36)), rng.uniform(0, 5, (5, 36))
    positions = np.repeat(RIGHT, 5, axis=0), np.repeat(DOWN, 5, axis=0)
    together = object_surface(disparity, weight, positions=positions, prior=np.full(5, 21.0))
    for i in range(5):
        alone = surface_of(disparity[i : i + 1], weight=weight[i : i + 1], prior=np.array([21.0]))
        assert together.centre[i] == pytest.approx(alone.centre[0])
        assert np.allclose(together.residual[i], alone.residual[0], equal_nan=True)
