"""Whether the errors of two runs differ by more than noise."""

import numpy as np
import pytest

from track_range.results.rows.rows import Rows
from track_range.views.report.comparison import ComparedRun, comparison_notes
from track_range.views.report.paired_comparison import NO_DIFFERENCE, paired_grid

N_TRACKS, N_FRAMES = 12, 20


def rows(error: np.ndarray, *, n_tracks: int = N_TRACKS) -> Rows:
    """Rows whose fused distances have the relative errors (tracks, frames)."""
    track, frame = (part.ravel() for part in np.mgrid[:n_tracks, :N_FRAMES])
    truth_m = 20.0 + track
    return Rows(
        {
            "frame": frame,
            "time_s": frame / 10,
            "fused_m": truth_m * (1 + error[:n_tracks].ravel()),
            "fused_sigma_m": truth_m / 20,
            "scored_truth_m": truth_m,
            "truth_track": track,
        }
    )


def errors(seed: int, scale: float) -> np.ndarray:
    """Relative errors that the frames of a track have in common, beside small ones of each frame."""
    rng = np.random.default_rng(seed)
    common = rng.normal(0, scale, (N_TRACKS, 1))
    return common + rng.normal(0, 0.002, (N_TRACKS, N_FRAMES))


def results(first: Rows, second: Rows) -> dict[str, tuple[str, ...]]:
    """Texts of the rows by figure: boxes, tracks, both values, difference, interval, result."""
    grid = paired_grid(("old", "new"), (first, second))
    return {row[1].text: tuple(cell.text for cell in row[2:]) for row in grid.rows}


def test_a_better_run_is_named_and_marked() -> None:
    old, new = errors(0, 0.08), errors(0, 0.08) / 2
    found = results(rows(old), rows(new))["mean error, %"]
    assert found[:2] == (str(N_TRACKS * N_FRAMES), str(N_TRACKS))
    assert found[-1] == "new is better"
    grid = paired_grid(("old", "new"), (rows(new), rows(old)))
    row = next(row for row in grid.rows if row[1].text == "mean error, %")
    assert row[-1].text == "old is better"
    assert [cell.best for cell in row[4:6]] == [True, False]


def test_another_noise_is_no_difference() -> None:
    """Tracks have errors in common: by boxes, 240 of them would make a difference of each pair."""
    n_named = 0
    for seed in range(1, 21):
        found = results(rows(errors(seed, 0.05)), rows(errors(100 + seed, 0.05)))
        n_named += found["mean error, %"][-1] != NO_DIFFERENCE
    assert n_named <= 4


def test_few_tracks_show_no_difference() -> None:
    old, new = (rows(errors(0, scale), n_tracks=5) for scale in (0.08, 0.02))
    assert results(old, new)["mean error, %"][-1] == "too few tracks (5 of at least 6)"


def test_only_boxes_of_both_runs_count() -> None:
    old = rows(errors(0, 0.05))
    new = old.select(old["frame"] >= 15)
    found = results(old, new)["mean error, %"]
    assert found[0] == str(5 * N_TRACKS)
    assert float(found[4]) == 0.0
    assert found[-1] == NO_DIFFERENCE


@pytest.mark.parametrize("changed", ["scored_truth_m", "truth_track"])
def test_runs_with_other_truth_are_not_compared(changed: str) -> None:
    old = rows(errors(0, 0.05))
    assert paired_grid(("a", "b"), (old, old)).rows
    other = old.with_columns({changed: old[changed] + 1000.0})
    assert not paired_grid(("a", "b"), (old, other)).rows
    without = old.select(slice(0, 0))
    assert not paired_grid(("a", "b"), (old, without)).rows
    assert not paired_grid(("a", "b"), (Rows({"fused_m": np.ones(3)}), old)).rows


def test_other_offsets_of_the_clocks_are_said() -> None:
    """Targets without boxes have true distances in common only at the same offset."""

    def run(offset_s: float | None) -> ComparedRun:
        summary = {} if offset_s is None else {"targets": {"offset_s": offset_s}}
        return ComparedRun(name="run", summary=summary, settings={}, rows=rows(errors(0, 0.1)))

    assert comparison_notes([run(0.5), run(0.5), run(None)]) == []
    (note,) = comparison_notes([run(0.5), run(0.48)])
    assert "--truth-offset-s" in note
