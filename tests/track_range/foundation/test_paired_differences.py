"""Paired differences of methods, against cases whose answer is known."""

import numpy as np
import pytest

from track_range.foundation.bootstrap import (
    Resamples,
    Statistic,
    measured_by_all,
    paired_differences,
)

N_TRACKS, N_FRAMES = 12, 20
TRACK = np.repeat(np.arange(N_TRACKS), N_FRAMES)
ALL = np.ones(len(TRACK), bool)


def compared(errors, rows=ALL):
    statistics = {
        name: Statistic(np.where(rows, values, np.nan), 0.5, 100) for name, values in errors.items()
    }
    return paired_differences(statistics, Resamples.of(TRACK, rows=rows), "median")


def test_methods_that_differ_by_less_than_their_noise_are_not_ranked():
    """Half of the tracks are better by one method, half by the other one."""
    hard = np.random.default_rng(0).uniform(0.02, 0.2, N_TRACKS)[TRACK]
    sign = np.where(TRACK % 2, 1, -1)
    result = compared({"a": hard + 0.01 * sign, "b": hard - 0.01 * sign, "c": hard + 0.02})
    smallest = result["reference"]
    assert smallest in ("a", "b")
    other = "b" if smallest == "a" else "a"
    assert result["n_blocks"] == N_TRACKS
    assert result["methods"][other]["is_worse"] is False
    low, high = result["methods"][other]["difference_ci95"]
    assert low <= 0 < high
    assert "difference" not in result["methods"][smallest]


def test_small_difference_on_the_same_boxes_is_found_where_single_intervals_overlap():
    hard = np.random.default_rng(0).uniform(0.02, 0.2, N_TRACKS)[TRACK]
    result = compared({"worse": hard + 0.005, "better": hard})
    worse, better = result["methods"]["worse"], result["methods"]["better"]
    assert result["reference"] == "better"
    assert worse["is_worse"] is True
    assert worse["difference"] == pytest.approx(0.5)
    assert worse["median_ci95"][0] < better["median_ci95"][1]


def test_few_tracks_give_no_result():
    rows = TRACK < 5
    result = compared({"a": np.full(len(TRACK), 0.1), "b": np.full(len(TRACK), 0.2)}, rows)
    assert (result["n_blocks"], result["methods"]["b"]["is_worse"]) == (5, None)
    assert compared({"a": np.full(len(TRACK), np.nan)}) == {}


def test_rows_that_all_methods_measured():
    values = np.full(len(TRACK), 0.1)
    sparse, half, rows = values.copy(), values.copy(), TRACK > 0
    sparse[: 8 * N_FRAMES] = np.nan
    half[: 4 * N_FRAMES] = np.nan
    common, names = measured_by_all({"all": values, "half": half, "sparse": sparse}, rows)
    assert names == ("all", "half")  # one that measured few boxes would leave few for all
    assert common.tolist() == (TRACK >= 4).tolist()
    nothing, none = measured_by_all({"a": values}, np.zeros(len(TRACK), bool))
    assert (nothing.any(), none) == (False, ())
