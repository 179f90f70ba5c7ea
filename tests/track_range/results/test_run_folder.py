"""Reading the folder of a run, complete or with missing files, and rewriting its report."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import yaml

from tests.support.results.run_folder import N_FRAMES, write_run
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.evaluation.sequences.find import find_sequences
from track_range.foundation.files.output_files import OutputError
from track_range.ranging.truth.truth import Truth
from track_range.results.folder import read_run_folder, read_run_rows
from track_range.results.formats.parquet_file import write_table
from track_range.results.rows.columns import column_names
from track_range.results.summary import matched_truth, with_truth
from track_range.views.report.run_folders import report, short_names

Cli = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return write_run(tmp_path / "run")


def test_complete_run(run: Path) -> None:
    read = read_run_folder(run)
    assert read.missing == ()
    assert (read.summary["frames"], read.summary["notes"]) == (9, ["a note"])
    assert read.rows["truth_m"] == pytest.approx([18.0] * N_FRAMES)
    assert read.rows["scored_truth_m"] == pytest.approx([18.0] * N_FRAMES)
    assert read.summary["focal_px"] == 1000.0
    assert read.summary["settings"] == {
        key: value for key, value in read.settings.items() if key != "classes"
    }


@pytest.mark.parametrize(("old", "new"), [("Car", "Van"), (" 20.0 ", " 120.0 ")])
def test_unscored_truth_is_shown(run: Path, old: str, new: str) -> None:
    labels = (run / "truth.txt").read_text().replace(old, new)
    (run / "truth.txt").write_text(labels)
    columns = read_run_folder(run).rows
    assert columns["truth_m"].min() > 10
    assert bool(np.isnan(columns["scored_truth_m"]).all())


def test_truth_without_labels(run: Path) -> None:
    columns = read_run_folder(run).rows
    nothing = Truth(*(np.zeros((0, 4) if n == 4 else 0, np.int64) for n in range(7)))
    assert bool(
        np.isnan(with_truth(columns, matched_truth(columns, nothing))["scored_truth_m"]).all()
    )


def test_truth_in_a_csv(run: Path) -> None:
    rows = "".join(f"{frame},1,car,280,140,360,220,18.0,2.0\n" for frame in range(N_FRAMES))
    (run / "truth.txt").write_text("frame,id,class,x1,y1,x2,y2,distance_m,closing_mps\n" + rows)
    lines = (run / "tracks.csv").read_text().splitlines()
    place = {name: column_names().index(name) for name in ("closing_mps", "closing_sigma_mps")}
    cells = [line.split(",") for line in lines[1:]]
    for row in cells:
        row[place["closing_mps"]], row[place["closing_sigma_mps"]] = "2.5", "0.4"
    (run / "tracks.csv").write_text("\n".join([lines[0], *(",".join(row) for row in cells)]) + "\n")
    (run / "summary.json").unlink()
    page = report([run]).page.read_text()
    summary = read_run_folder(run).summary
    assert summary["methods"]["fused"]["median_relative_error_pct"] == pytest.approx(5.0)
    assert summary["closing"]["median_error_mps"] == pytest.approx(0.5)
    assert "CSV" in summary["truth"]
    assert "Error of the closing speed" in page


def test_killed_run(run: Path) -> None:
    (run / "summary.json").unlink()
    with (run / "tracks.csv").open("a") as file:
        file.write("6,0.6,1,ca")  # an incomplete row
    read = read_run_folder(run)
    assert read.missing[0].startswith("summary.json is missing")
    assert read.summary["notes"] == list(read.missing)
    assert read.summary["frames"] == N_FRAMES
    assert read.summary["methods"]["fused"]["median_relative_error_pct"] == pytest.approx(5.0)
    assert read.summary["tracks"]["mota"] == pytest.approx(100.0)
    assert read.summary["files"] == {"overlay": "overlay.mp4"}
    assert read.summary["inputs"] == {"mono": "drive.mp4", "truth": str(run / "truth.txt")}
    assert read.summary["versions"] == {"numpy": "2"}


def test_killed_run_of_each_second_frame(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", every=2)
    (run / "summary.json").unlink()
    header, *rows = (run / "tracks.csv").read_text().splitlines()
    (run / "tracks.csv").write_text("\n".join([header, *rows[::2]]) + "\n")
    summary = read_run_folder(run).summary
    assert summary["frames"] == 3
    assert (summary["tracks"]["mota"], summary["tracks"]["hota"]) == pytest.approx((100.0, 100.0))
    # frame 2 is missed, 1 and 3 are not
    (run / "tracks.csv").write_text("\n".join([header, rows[0], rows[4]]) + "\n")
    assert read_run_folder(run).summary["tracks"]["mota"] == pytest.approx(200 / 3, abs=1e-3)


@pytest.mark.parametrize("every", ["two", 0, 10**30, None])
def test_killed_run_with_a_damaged_step(tmp_path: Path, every: object) -> None:
    run = write_run(tmp_path / "run", every=every)
    (run / "summary.json").unlink()
    assert read_run_folder(run).summary["frames"] == N_FRAMES


def test_killed_run_of_a_pair(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", mono=None, stereo=["l.mp4", "r.mp4"])
    (folder / "summary.json").unlink()
    assert read_run_folder(folder).summary["inputs"] | {"mono": None, "truth": None} == {
        "left": "l.mp4",
        "right": "r.mp4",
        "mono": None,
        "truth": None,
    }


@pytest.mark.parametrize(
    ("gone", "words"),
    [
        ("settings.yaml", "settings.yaml is missing"),
        ("truth.txt", "The ground truth cannot be read"),
        ("overlay.mp4", "overlay.mp4 is missing"),
    ],
)
def test_missing_files(run: Path, gone: str, words: str) -> None:
    (run / gone).unlink()
    written = report([run])
    assert any(words in sentence for sentence in written.missing)
    page = written.page.read_text()
    assert words in page
    assert "a note" in page
    assert ("<video" in page) == (gone != "overlay.mp4")


def test_run_without_rows_is_refused(run: Path, tmp_path: Path, cli: Cli) -> None:
    page = report([run]).page
    before = page.read_bytes()
    (run / "tracks.csv").unlink()
    for arguments in (
        ("report", run),
        ("export", run, "--to", "coco", "--out", tmp_path / "boxes.json"),
    ):
        status, _, stderr = cli(*arguments)
        assert status == 1
        assert "found neither; restore" in stderr
    (run / "truth.txt").unlink()
    with pytest.raises(LabelFileError, match=r"tracks\.csv, .*no such file"):
        find_sequences(run, "det")
    assert page.read_bytes() == before
    assert not (tmp_path / "boxes.json").exists()


def test_clip_of_a_fleet(run: Path, tmp_path: Path, cli: Cli) -> None:
    """The rows of a clip are in tracks/clip=NAME; the files of the clip, in runs/clip=NAME, have no
    settings.yaml."""
    tracks, runs = tmp_path / "fleet" / "tracks" / "clip=a", tmp_path / "fleet" / "runs" / "clip=a"
    tracks.mkdir(parents=True)
    runs.parent.mkdir()
    rows = read_run_rows(run / "tracks.csv", [])
    write_table(tracks / "tracks.parquet", pa.table(dict(rows.columns)))
    shutil.copytree(run, runs, ignore=shutil.ignore_patterns("tracks.csv", "settings.yaml"))
    boxes = tmp_path / "boxes.json"
    report([runs])
    assert len(read_run_folder(runs).rows["frame"]) == N_FRAMES
    assert (
        cli("export", runs, "--to", "coco", "--out", boxes)[1]
        .rstrip()
        .endswith(f"{N_FRAMES} boxes")
    )
    assert [sequence.path for sequence in find_sequences(runs, "det")] == [
        tracks / "tracks.parquet"
    ]
    before = (runs / "report.html").read_bytes()
    (tracks / "tracks.parquet").unlink()
    with pytest.raises(OutputError, match=r"clip=a/tracks\.parquet"):
        report([runs])
    with pytest.raises(LabelFileError, match=r"clip=a/tracks\.parquet"):
        find_sequences(runs, "det")
    assert (runs / "report.html").read_bytes() == before


@pytest.mark.parametrize("text", ["{", "[]", "\x00"])
def test_damaged_summary(run: Path, text: str) -> None:
    (run / "summary.json").write_text(text)
    read = read_run_folder(run)
    assert len(read.missing) == 1
    assert read.missing[0].startswith("summary.json cannot be read")
    assert read.summary["frames"] == N_FRAMES


def test_settings_without_a_camera(run: Path) -> None:
    settings = yaml.safe_load((run / "settings.yaml").read_text())
    for read in ({}, {"focal_px": 1.0, "principal_point_px": None, "image_size_px": 3}):
        (run / "settings.yaml").write_text(yaml.safe_dump(settings | {"found": read}))
        read = read_run_folder(run)
        assert "truth_m" not in read.rows
        assert len(read.missing) == 1


def test_folders_without_a_run(run: Path, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="nowhere: "):
        read_run_folder(tmp_path / "nowhere")
    with pytest.raises(OutputError, match=r"neither .*tracks\.csv.* nor summary\.json"):
        read_run_folder(tmp_path)
    (run / "tracks.csv").write_text("frame,time_s,class\n1,2,car\n")
    with pytest.raises(OutputError, match=r"tracks\.csv: .*track_id, x1_px, x2_px, y1_px, y2_px\."):
        read_run_folder(run)
    (run / "tracks.csv").write_bytes(b"\xff\xfe")
    with pytest.raises(OutputError, match=r"tracks\.csv: "):
        read_run_folder(run)


def test_killed_run_without_tracks(run: Path) -> None:
    (run / "tracks.csv").write_text(",".join(column_names()) + "\n")
    (run / "summary.json").unlink()
    assert "No track was confirmed in this run." in report([run]).page.read_text()


def test_page_in_another_folder_links_the_overlay(run: Path, tmp_path: Path) -> None:
    (tmp_path / "pages").mkdir()
    path = report([run], tmp_path / "pages" / "page.html").page
    assert path == tmp_path / "pages" / "page.html"
    assert 'src="../run/overlay.mp4"' in path.read_text()
    assert not (run / "report.html").exists()


def test_page_must_not_overwrite_an_input(run: Path, tmp_path: Path) -> None:
    other = write_run(tmp_path / "other")
    for folders, out, words in (
        ([run], run / "tracks.csv", "tracks.csv: .*overwritten"),
        ([run], run, "run: .*folder"),
        ([run, other], other / "report.html", "report.html: .*two"),
    ):
        with pytest.raises(OutputError, match=words):
            report(folders, out)
    assert len(read_run_folder(run).rows["frame"]) == N_FRAMES
    assert report([run], run / "report.html").page.is_file()
    assert report([run], tmp_path / "new" / "page.html").page.is_file()


def test_row_with_a_huge_frame_number(run: Path) -> None:
    (run / "summary.json").unlink()
    text = (run / "tracks.csv").read_text()
    (run / "tracks.csv").write_text(text.replace("\n5,0.5", "\n99999999999,0.5"))
    assert read_run_folder(run).summary["tracks"]["n"] == 1


@pytest.mark.parametrize(("part", "name"), [({"start_s": "x"}, "starts_s"), ({"found": 3}, None)])
def test_settings_of_wrong_types(run: Path, part: dict[str, Any], name: str | None) -> None:
    settings = yaml.safe_load((run / "settings.yaml").read_text())
    settings["run"] |= part
    (run / "settings.yaml").write_text(yaml.safe_dump(settings))
    read = read_run_folder(run)
    sentences = [sentence for sentence in read.missing if "unexpected types" in sentence]
    assert [sentence.rpartition(": ")[2] for sentence in sentences] == (
        [] if name is None else [f"{name}."]
    )


def test_several_runs_are_compared(run: Path, tmp_path: Path) -> None:
    other = write_run(tmp_path / "more" / "run", sgbm=False)
    (other / "summary.json").unlink()
    written = report([run, other, run / "."], tmp_path / "all.html")
    page = written.page.read_text()
    assert "Comparison of 2 runs" in page
    assert 'href="run/report.html"' in page
    assert 'href="more/run/report.html"' in page
    assert '<th scope="row">sgbm</th><td>-</td><td>False</td>' in page
    assert (run / "report.html").exists()
    assert "The runs have different numbers of frames." in written.notes
    assert "Settings that differ" in [grid.title for grid in written.grids]
    cells = {cell.text for grid in written.grids for row in grid.rows for cell in row}
    assert {"more/run", "5.00 (6)", "too few tracks (1 of at least 6)"} <= cells


def test_short_names() -> None:
    assert short_names([Path("/a/x"), Path("/a/y")]) == ["x", "y"]
    assert short_names([Path("/a/x"), Path("/b/x"), Path("/b/y")]) == ["a/x", "b/x", "b/y"]
