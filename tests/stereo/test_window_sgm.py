"""Semi-global matching on the windows of a box compared with brute force."""

from __future__ import annotations

import numpy as np
import pytest

from track_range.foundation.arrays import FloatArray
from track_range.stereo.matching.window_matches import match_windows

SMALL_STEP, LARGE_STEP, UNSEEN = 1.5, 6.0, 8.0


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
                candidates += [
                    before[k] + SMALL_STEP for k in (d - 1, d + 1) if 0 <= k < n_disparities
                ]
                paths[row, column, d] += min(candidates) - before.min()
    return paths


def slow_matches(cost: FloatArray) -> tuple[list[float], list[float], list[float]]:
    """Index, slope and cost of the windows of one box, from costs (D, G), by the definition."""
    side = int(np.sqrt(cost.shape[1]))
    known = np.where(np.isnan(cost), UNSEEN, cost)
    grid = known.T.reshape(side, side, -1)
    total = sum(slow_path_costs(grid, step) for step in ((0, 1), (0, -1), (1, 0), (-1, 0))).reshape(
        side * side, -1
    )
    index, slopes, least = [], [], []
    for window, paths in enumerate(total):
        own = known[:, window]
        chosen = min(max(int(np.argmin(paths)), 1), len(own) - 2)
        best = min(range(chosen - 1, chosen + 2), key=lambda k: (own[k], k))
        best = min(max(best, 1), len(own) - 2)
        below, at, above = own[best - 1 : best + 2]
        is_seen = bool(np.isfinite(cost[best - 1 : best + 2, window]).all())
        is_minimum = is_seen and at <= min(below, above) and max(below, above) > at
        slope = max(below, above) - at
        index.append(best + ((below - above) / (2 * slope) if is_minimum else 0.0))
        slopes.append(slope if is_minimum else 0.0)
        least.append(at)
    return index, slopes, least


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("side", [3, 7])
def test_window_sgm_equals_brute_force(seed: int, side: int) -> None:
    rng = np.random.default_rng(seed)
    cost = rng.uniform(0, 12, (9, side * side, 4))
    cost[rng.uniform(size=cost.shape) < 0.1] = np.nan
    cost[:, :2, 3] = np.nan  # windows outside the right image
    matches = match_windows(cost.astype(np.float32))
    for box in range(4):
        index, slope, least = slow_matches(cost[:, :, box])
        assert np.allclose(matches.index[box], index, atol=1e-5)
        assert np.allclose(matches.slope[box], slope, atol=1e-5)
        assert np.allclose(matches.cost[box], least, atol=1e-5)
    assert not matches.slope[3, :2].any()


def test_window_without_minimum_follows_neighbours() -> None:
    cost = np.full((15, 9, 1), 10.0, np.float32)
    cost[6] = 2.0
    cost[:, 4, 0] = 9.0  # without texture, in the middle
    cost[12, 4, 0] = 8.9
    matches = match_windows(cost)
    assert matches.index[0, [0, 3, 5, 8]].tolist() == [6] * 4
    assert matches.index[0, 4] in (5, 6, 7)  # its least cost is at 12
    assert matches.slope[0].tolist() == [8.0] * 4 + [0.0] + [8.0] * 4


def test_the_v_shaped_fit_is_exact_for_a_v() -> None:
    true = np.array([5.0, 5.2, 5.49, 4.6, 4.51, 5.3, 5.1, 4.9, 4.8])
    cost = 3.0 + 4.0 * np.abs(np.arange(12)[:, None, None] - true[:, None])
    matches = match_windows(cost.astype(np.float32))
    assert np.allclose(matches.index[0], true, atol=1e-5)
    assert np.allclose(matches.slope[0], 4.0, atol=1e-5)
    assert np.allclose(matches.cost[0], 3.0 + 4.0 * np.abs(np.rint(true) - true), atol=1e-5)


def test_a_common_minimum_at_the_end_has_no_weight() -> None:
    cost = np.broadcast_to(np.linspace(2, 10, 9)[:, None, None], (9, 9, 1)).astype(np.float32)
    matches = match_windows(cost)
    assert matches.index.tolist() == [[1] * 9]
    assert not matches.slope.any()


def test_boxes_of_one_call_are_independent() -> None:
    cost = np.random.default_rng(1).uniform(0, 12, (9, 49, 5)).astype(np.float32)
    together = match_windows(cost)
    for i in range(5):
        alone = match_windows(cost[:, :, i : i + 1])
        for name in ("index", "slope", "cost"):
            assert np.array_equal(getattr(together, name)[i], getattr(alone, name)[0])
