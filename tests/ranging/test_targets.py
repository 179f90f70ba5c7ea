"""Targets without boxes: tables, matching over whole tracks, and the offset of clocks."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.foundation.arrays import FloatArray
from track_range.ranging.truth import target_matching
from track_range.ranging.truth.target_matching import (
    MatchedTargets,
    MeasuredRows,
    match_targets,
    offset_notes,
)
from track_range.ranging.truth.target_table import TargetTable, is_target_table, read_targets

SECONDS, RATE_HZ = 20.0, 10.0

# distance, offset to the right and closing speed of each target at a time
PATHS = {
    "lead": lambda t: (25 + 8 * np.sin(0.5 * t), 0.1 + 0 * t, -4 * np.cos(0.5 * t)),
    "left": lambda t: (60 - 2.2 * t, -3.6 + 0 * t, 2.2 + 0 * t),
    "right": lambda t: (30 + 5 * np.cos(0.7 * t), 3.6 + 0 * t, 3.5 * np.sin(0.7 * t)),
}


def table(path: Path, *, shift_s: float = 0.0, rate_hz: float = 5.0) -> Path:
    """A log of the targets whose clock is `shift_s` before that of the video."""
    lines = ["time_s,target,range_m,range_rate_mps,lateral_m"]
    for name, values in PATHS.items():
        for t in np.arange(0, SECONDS, 1 / rate_hz):
            z, x, v = (float(value) for value in values(t))
            lines.append(f"{t - shift_s:.4f},{name},{np.hypot(z, x):.4f},{-v:.4f},{-x:.4f}")
    path.write_text("\n".join(lines) + "\n")
    return path


def rows(
    tracks: Mapping[int, tuple[str, float, float]], *, scale: float = 1.0, seed: int = 0
) -> MeasuredRows:
    """Rows of tracks that see a target from one time to another, with noise of 4 % and 0.3 m/s."""
    rng = np.random.default_rng(seed)
    parts: list[tuple[FloatArray, ...]] = []
    for number, (name, start_s, end_s) in tracks.items():
        t = np.arange(start_s, end_s, 1 / RATE_HZ)
        z, x, v = PATHS[name](t)
        noise = rng.normal(size=(3, len(t)))
        values = np.stack(
            [scale * z * (1 + 0.04 * noise[0]), scale * x + 0.2 * noise[1], v + 0.3 * noise[2]]
        )
        sigma_m = (abs(scale - 1) + 0.05) * z
        sigmas = np.stack([sigma_m, 0.3 + abs(scale - 1) * np.abs(x), 0.3 + 0 * t])
        parts.append((t, np.full(len(t), number), values, sigmas))
    times, track_id = (np.concatenate(part) for part in list(zip(*parts, strict=True))[:2])
    values, sigmas = (np.concatenate(part, axis=1) for part in list(zip(*parts, strict=True))[2:])
    frame = np.rint(times * RATE_HZ).astype(np.int64)
    return MeasuredRows(frame, times, track_id.astype(np.int64), values, sigmas)


def matched_names(
    targets: TargetTable, seen: MeasuredRows
) -> tuple[MatchedTargets, dict[int, str]]:
    """The matches, and the name of the target of each track, "" = none."""
    matches = match_targets(targets, seen)
    names = {}
    for track in np.unique(seen.track_id).tolist():
        found = set(matches.target[seen.track_id == track].tolist()) - {-1}
        assert len(found) <= 1
        names[track] = targets.names[found.pop()] if found else ""
    return matches, names


ALL = {7: ("lead", 0.0, 20.0), 3: ("left", 2.0, 18.0), 5: ("right", 0.0, 15.0)}


@pytest.mark.parametrize("shift_s", [0.0, 0.73, -2.4])
@pytest.mark.parametrize("scale", [1.0, 1.2])
def test_offset_of_the_clocks_is_found_with_its_sigma(
    tmp_path: Path, shift_s: float, scale: float
) -> None:
    """An error of scale is not taken for an offset."""
    targets = read_targets(table(tmp_path / "log.csv", shift_s=shift_s))
    matches, names = matched_names(targets, rows(ALL, scale=scale))
    assert names == {track: name for track, (name, *_) in ALL.items()}
    assert matches.offset_s == pytest.approx(shift_s, abs=max(0.06, 3 * matches.offset_sigma_s))
    assert matches.offset_sigma_s < 0.15
    assert f"{matches.offset_s:+.2f} s" in offset_notes(targets, matches)[0]


def test_sigma_of_the_offset_is_that_of_its_errors(tmp_path: Path) -> None:
    targets = read_targets(table(tmp_path / "log.csv", shift_s=0.4))
    errors = []
    for seed in range(12):
        matches = match_targets(targets, rows(ALL, seed=seed))
        errors.append((matches.offset_s - 0.4) / matches.offset_sigma_s)
    assert np.sqrt(np.mean(np.square(errors))) < 1.6


def test_given_offset_is_used(tmp_path: Path) -> None:
    targets = read_targets(table(tmp_path / "log.csv", shift_s=0.73), offset_s=0.73)
    matches, _ = matched_names(targets, rows(ALL))
    assert matches.offset_s == 0.73
    assert np.isnan(matches.offset_sigma_s)
    assert offset_notes(targets, matches) == ()
    z, x, v = matches.values
    true = PATHS["lead"](rows(ALL).time[:200])
    known = np.isfinite(z[:200])
    assert known.sum() > 180
    for values, expected in zip((z, x, v), true, strict=True):
        np.testing.assert_allclose(
            values[:200][known], np.broadcast_to(expected, 200)[known], atol=0.1
        )


def test_constant_gap_shows_no_offset(tmp_path: Path) -> None:
    """A lead at a constant distance fits at any time."""
    path = tmp_path / "log.csv"
    lines = [f"{t / 5},lead,25.0,0.0" for t in range(100)]
    path.write_text("\n".join(["time_s,target,range_m,range_rate_mps", *lines]) + "\n")
    rng = np.random.default_rng(1)
    t = np.arange(0, 20, 0.1)
    values = np.stack([25 * (1 + 0.04 * rng.normal(size=200)), 0 * t, 0.3 * rng.normal(size=200)])
    seen = MeasuredRows(
        np.arange(200),
        t,
        np.ones(200, np.int64),
        values,
        np.stack([1.2 + 0 * t, 1 + 0 * t, 0.3 + 0 * t]),
    )
    targets = read_targets(path)
    matches = match_targets(targets, seen)
    assert matches.offset_s == 0.0
    assert "no offset" in offset_notes(targets, matches)[0]
    assert (matches.target == 0).sum() > 190


def test_a_target_has_one_track_at_a_time_and_may_be_found_again(tmp_path: Path) -> None:
    targets = read_targets(table(tmp_path / "log.csv"), offset_s=0.0)
    split = {1: ("lead", 0.0, 9.0), 2: ("lead", 10.0, 20.0), 4: ("lead", 3.0, 5.0)}
    matches, names = matched_names(targets, rows(split))
    # track 4 sees the same object a second time, which is no other target
    assert names == {1: "lead", 2: "lead", 4: ""}
    assert "2 of 3 targets: left, right" in offset_notes(targets, matches)[0]


def test_wrong_distances_of_a_matched_track_count(tmp_path: Path) -> None:
    """The whole track decides, and not each frame: an error of a moment is one of the run."""
    targets = read_targets(table(tmp_path / "log.csv"), offset_s=0.0)
    seen = rows(ALL)
    seen.values[0, 50:60] *= 2.0
    matches = match_targets(targets, seen)
    assert (matches.target[50:60] == targets.names.index("lead")).all()


def test_map_with_poses(tmp_path: Path) -> None:
    """A car 4 m long, 20 m ahead and 3 m to the left of a camera that looks along y."""
    log, poses = tmp_path / "boxes.csv", tmp_path / "poses.csv"
    header = "utc_s,id,x_m,y_m,heading_deg,length_m,width_m"
    log.write_text(f"{header}\n1000,a,97,60,90,4,1.8\n1001,a,97,60,90,4,1.8\n")
    poses.write_text("utc_s,x_m,y_m,heading_deg\n999,100,38,90\n1001,100,42,90\n")
    targets = read_targets(log, poses=poses)
    assert (targets.clock, targets.names) == ("utc_s", ("a",))
    np.testing.assert_allclose(targets.values[:2], [[18.0, 16.0], [-3.0, -3.0]], atol=1e-6)
    across = f"{header}\n1000,a,97,60,0,4,1.8\n1001,a,97,60,0,4,1.8\n"
    log.write_text(across)
    ahead = read_targets(log, poses=poses, ahead_m=-1.5)
    np.testing.assert_allclose(ahead.values[0], [20 - 0.9 - 1.5, 18 - 0.9 - 1.5], atol=1e-6)
    log.write_text("time_s,id,x_m,y_m\n0,a,1,2\n")
    with pytest.raises(LabelFileError, match="truth-poses"):
        read_targets(log)


def test_columns_and_faults(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("frame;id;forward_m;right_m;closing_mps\n4;7;20,5;1,5;3\n5;7;20;;\n")
    targets = read_targets(log)
    assert (targets.clock, targets.offset_s) == ("frame", 0.0)
    np.testing.assert_array_equal(targets.values, [[20.5, 20.0], [1.5, np.nan], [3.0, np.nan]])
    for text, word in (
        ("target,range_m\n1,2\n", "time_s"),
        ("time_s,target,range_m\n1,a,x\n", "range_m"),
        ("time_s,range_m\n1,2\n", "target"),
        ("time_s,target,distance_m\n1,a,20\n", "range_m, forward_m, or x_m and y_m"),
    ):
        log.write_text(text)
        with pytest.raises(LabelFileError, match=word):
            read_targets(log)


def test_which_tables_have_targets() -> None:
    assert is_target_table("Time_s, target ,range_m".split(","))
    assert is_target_table(["utc_s", "id", "x_m", "y_m"])
    assert is_target_table(["time_s", "target", "distance_m"])  # the reader says what is missing
    assert not is_target_table("frame,id,class,x1,y1,x2,y2,distance_m,range_m".split(","))
    assert not is_target_table(["time_s", "id", "x_m"])


def test_long_runs_show_the_offset_by_some_of_their_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(target_matching, "_MOST_ROWS", 150)
    targets = read_targets(table(tmp_path / "log.csv", shift_s=0.73))
    matches, names = matched_names(targets, rows(ALL))
    assert set(names.values()) == set(PATHS)
    assert matches.offset_s == pytest.approx(0.73, abs=0.15)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("time_s,target,range_m\n", "none"),
        ("time_s,target,range_m\n0.1,a,20\n0.2,a,21\n0.1,a,40\n", "a twice at 0.1"),
        ("frame,target,range_m\n1,a,20\n2,a,21\n", "--truth-offset-s"),
    ],
)
def test_tables_that_are_no_truth(tmp_path: Path, text: str, word: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(LabelFileError, match=word):
        read_targets(path, offset_s=0.5)
