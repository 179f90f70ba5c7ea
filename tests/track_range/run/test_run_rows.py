"""tracks.csv of runs that were killed, damaged, or made by an earlier version."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from track_range.foundation.files.output_files import OutputError
from track_range.results.folder import read_run_rows, valid_rows

HEADER = "frame,time_s,track_id,class,x1_px,y1_px,x2_px,y2_px,fused_m"


def row(frame: str = "0", time_s: str = "0.0", track_id: str = "1", x1_px: str = "10") -> str:
    return f"{frame},{time_s},{track_id},car,{x1_px},10,20,20,18.5"


def write(folder: Path, *lines: str, end: str = "\n") -> Path:
    path = folder / "tracks.csv"
    path.write_text("\n".join([HEADER, *lines]) + end)
    return path


def test_valid_rows_and_missing_columns(tmp_path: Path) -> None:
    missing: list[str] = []
    columns = read_run_rows(write(tmp_path, row("0"), row("1", "0.1")), missing)
    assert missing == []
    assert columns["fused_m"].tolist() == [18.5, 18.5]
    assert columns["class"].tolist() == ["car", "car"]
    assert np.isnan(columns["closing_mps"]).all()
    assert len(columns["closing_sigma_mps"]) == 2
    assert "fused_sigma_m" not in columns  # methods without sigmas are not scored


@pytest.mark.parametrize(
    "broken",
    [
        *(row(frame) for frame in ("nan", "inf", "-1", "1.5", "1e400", "1e300", "")),
        *(row("1", time_s) for time_s in ("nan", "inf", "")),
        *(row("1", track_id=track_id) for track_id in ("0", "-3", "nan", "2.5", "")),
        *(row("1", x1_px=x1_px) for x1_px in ("inf", "")),
        row("0", "0.5"),
    ],
)
def test_invalid_rows_are_skipped(tmp_path: Path, broken: str) -> None:
    missing: list[str] = []
    columns = read_run_rows(write(tmp_path, row("0"), broken, row("2", "0.2")), missing)
    assert columns["frame"].tolist() == [0.0, 2.0]
    assert len(missing) == 1
    assert missing[0].startswith("1 of 3 rows of tracks.csv")


def test_file_that_ends_within_a_row(tmp_path: Path) -> None:
    missing: list[str] = []
    columns = read_run_rows(write(tmp_path, row("0"), "1,0.1,1,ca", end=""), missing)
    assert columns["frame"].tolist() == [0.0]
    assert len(missing) == 1
    assert "middle of a row" in missing[0]


def test_file_with_text_for_numbers(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"tracks\.csv: "):
        read_run_rows(write(tmp_path, "a,b,c,d,e,f,g,h,i"), [])


def test_unfinished_quote_is_an_unfinished_row(tmp_path: Path) -> None:
    columns = read_run_rows(write(tmp_path, row("0"), '1,0.1,1,"car' + 200_000 * "x"), [])
    assert columns["frame"].tolist() == [0.0]


def test_duplicate_column(tmp_path: Path) -> None:
    (tmp_path / "tracks.csv").write_text(f"{HEADER},frame\n{row()},0\n")
    with pytest.raises(OutputError, match=r"tracks\.csv: "):
        read_run_rows(tmp_path / "tracks.csv", [])


def test_duplicate_track_in_a_frame() -> None:
    ones = np.ones(4)
    box = dict.fromkeys(("x1_px", "y1_px", "x2_px", "y2_px"), ones)
    columns = {
        "frame": np.array([0.0, 0, 0, 1]),
        "track_id": np.array([2.0, 1, 2, 2]),
        "time_s": ones,
        **box,
    }
    assert valid_rows(columns).tolist() == [True, True, False, True]


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ([row(frame="-1"), row(time_s="")], r"malformed .*2"),
        (["1,2,3", "4,5"], "2 rows"),
        ([row(time_s="soon")], "'soon' in the column time_s in line 2"),
    ],
)
def test_file_of_malformed_rows_only(tmp_path: Path, lines: list[str], words: str) -> None:
    with pytest.raises(OutputError, match=rf"tracks\.csv: .*{words}"):
        read_run_rows(write(tmp_path, *lines), [])


def test_too_many_columns(tmp_path: Path) -> None:
    path = tmp_path / "tracks.csv"
    path.write_text(",".join(f"c{column}" for column in range(1001)) + "\n")
    with pytest.raises(OutputError, match=r"tracks\.csv: .*1001 columns"):
        read_run_rows(path, [])
