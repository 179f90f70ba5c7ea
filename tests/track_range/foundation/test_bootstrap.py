"""Block bootstrap against resamples that are written out."""

import numpy as np
import pytest

from track_range.foundation.bootstrap import (
    N_RESAMPLES,
    Resamples,
    Statistic,
    figures_of,
    interval,
)


def data(seed: int, n: int, n_tracks: int) -> tuple[np.ndarray, np.ndarray]:
    """Values, some of them unknown, and their tracks."""
    rng = np.random.default_rng(seed)
    values = rng.normal(size=n)
    values[rng.random(n) < 0.1] = np.nan
    return values, rng.integers(0, n_tracks, n)


@pytest.mark.parametrize("level", [None, 0.5, 0.95, 0.0, 1.0])
@pytest.mark.parametrize(("n", "n_tracks"), [(5, 3), (40, 7), (997, 60)])
def test_figures_of_resamples_are_those_of_the_repeated_values(
    level: float | None, n: int, n_tracks: int
) -> None:
    values, track = data(n, n, n_tracks)
    resamples = Resamples.of(track, rows=np.ones(n, bool), seed=1)
    found = Statistic(values, level, 100).of_resamples(resamples)
    for figure, counts in zip(found[:50], resamples.counts, strict=False):
        repeated = np.repeat(values, counts[resamples.block].astype(int))
        known = repeated[np.isfinite(repeated)]
        if len(known):
            expected = known.mean() if level is None else np.quantile(known, level)
            assert figure == pytest.approx(100 * expected, abs=1e-9)
        else:
            assert np.isnan(figure)


def test_resamples_of_one_drive_have_as_many_tracks_as_it() -> None:
    rows = np.array([True] * 6 + [False])
    resamples = Resamples.of(np.array([4, 4, 9, 2, 2, 2, 7]), rows=rows)
    assert resamples.counts.shape == (N_RESAMPLES, 3)
    assert set(resamples.counts.sum(axis=1)) == {3}
    assert resamples.block.tolist() == [1, 1, 2, 0, 0, 0, -1]


def test_drives_are_drawn_before_their_tracks() -> None:
    """Track 1 of drive 0 is another one than that of drive 1; a drive is drawn as a whole."""
    track, drive = np.array([1, 2, 3, 1]), np.array([0, 0, 0, 1])
    resamples = Resamples.of(track, drive=drive, rows=np.ones(4, bool))
    of_first, of_second = resamples.counts[:, :3].sum(axis=1), resamples.counts[:, 3]
    assert (of_first / 3 + of_second).tolist() == [2] * N_RESAMPLES
    assert set(of_first) == {0, 3, 6}


def test_interval_covers_the_mean_of_tracks_with_an_error_in_common() -> None:
    """Errors of a track are equal: an interval by rows would be 10 times too narrow."""
    n_tracks, n_frames, n_trials = 30, 100, 200
    n_inside = widths = 0
    for trial in range(n_trials):
        common = np.random.default_rng(trial).normal(size=n_tracks)
        track = np.repeat(np.arange(n_tracks), n_frames)
        resamples = Resamples.of(track, rows=np.ones(len(track), bool), seed=trial)
        ends = interval(Statistic(common[track]).of_resamples(resamples))
        assert ends is not None
        n_inside += ends[0] <= 0 <= ends[1]
        widths += ends[1] - ends[0]
    assert 0.88 <= n_inside / n_trials <= 0.98
    assert 2 * 1.96 / n_tracks**0.5 == pytest.approx(widths / n_trials, rel=0.1)


def test_no_interval_of_one_track_or_without_values() -> None:
    one = Resamples.of(np.zeros(5, int), rows=np.ones(5, bool))
    assert figures_of({"a": Statistic(np.arange(5.0))}, one) == {"a": 2.0}
    two = Resamples.of(np.array([0, 1]), rows=np.ones(2, bool))
    assert figures_of({"a": Statistic(np.full(2, np.nan), 0.5)}, two) == {"a": None}
    figures = figures_of({"a": Statistic(np.array([1.0, 3.0]), 0.5)}, two)
    assert figures == {"a": 2.0, "a_ci95": [1.0, 3.0]}


def test_equal_seeds_are_paired() -> None:
    values, track = data(3, 200, 20)
    resamples = Resamples.of(track, rows=np.ones(200, bool), seed=5)
    first, second = (Statistic(part).of_resamples(resamples) for part in (values, values + 0.25))
    np.testing.assert_allclose(second - first, 0.25)
    again = Resamples.of(track, rows=np.ones(200, bool), seed=5)
    np.testing.assert_array_equal(again.counts, resamples.counts)
