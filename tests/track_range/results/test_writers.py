"""Result writers by name: a toy writer in a run, selection, errors."""

from __future__ import annotations

import json

import pytest

from tests.support.results.frame_results import INFO, result
from tests.toys.registrations import registered_writer
from tests.toys.toy_writer import NAME, JsonLinesWriter
from track_range.foundation.errors import UsageError
from track_range.foundation.files.output_files import OutputError
from track_range.results.writers import (
    DEFAULT_WRITERS,
    WRITERS,
    OpenWriters,
    WriterError,
    create_writer,
    create_writers,
    register_writer,
    result_names,
)
from track_range.run.options.precedence import settings_from
from track_range.run.options.settings import RunSettings

BUILT_IN = (
    *("csv", "mot", "parquet", "poses", "kitti", "recorded", "mcap", "rrd", "openscenario"),
    *("depth", "osi", "osi-gt", "osi-mcap", "mf4", "openlabel"),
)
ROW = "0 1 Car 0 0 0 10 10 40 40 -1 -1 -1 -1000 -1000 -1000 -10 0.9\n"


class FullDisk:
    files = ("full.bin",)

    def open(self, info, folder):
        pass

    def write(self, result):
        raise OSError(28, "No space left on device")

    def close(self, summary):
        raise OSError(28, "No space left on device")


@pytest.fixture
def mono_run(tmp_path, cli, film):
    """Runs on three frames with these settings; returns the standard output."""
    video = film(tmp_path / "film.mp4", [0.0, 0.1, 0.2])
    (tmp_path / "boxes.txt").write_text(ROW)

    def run(*settings, out="out"):
        (tmp_path / "settings.yaml").write_text(
            "\n".join(["track_range_settings: 1", "run:", *settings]) + "\n"
        )
        inputs = (
            "--mono",
            video,
            "--detections",
            tmp_path / "boxes.txt",
            "--focal-px",
            60,
            "--lanes",
            "off",
        )
        options = (
            "--no-overlay",
            "--settings",
            tmp_path / "settings.yaml",
            "--out",
            tmp_path / out,
        )
        return cli(*inputs, *options)

    return run


def test_toy_writer_in_a_run(tmp_path, mono_run):
    with registered_writer(NAME, JsonLinesWriter):
        status, printed, complaint = mono_run("  write: [csv, jsonl]")
        assert status == 0, complaint
        assert (
            "report.html, events.csv, events.parquet, tracks.csv, frames.jsonl, summary.json"
            in printed
        )
        names = {path.name for path in (tmp_path / "out").iterdir()}
        always = {"events.csv", "events.parquet", "summary.json", "settings.yaml", "report.html"}
        assert names == {"tracks.csv", "frames.jsonl", *always}
        lines = [
            json.loads(line) for line in (tmp_path / "out/frames.jsonl").read_text().splitlines()
        ]
        assert [line.get("frame") for line in lines] == [0, 1, 2, None]
        assert lines[-1] == {"focal_px": 60.0, "fps": pytest.approx(10.0), "frames": 3}
        assert mono_run("  write: [mot]")[0] == 0
        assert {path.name for path in (tmp_path / "out").iterdir()} >= {"mot.txt"}
        assert not (tmp_path / "out/frames.jsonl").exists(), "of the earlier run"
        assert not (tmp_path / "out/tracks.csv").exists()


def test_summary_does_not_depend_on_the_writers(tmp_path, mono_run):
    summaries = []
    for number, names in enumerate(("[csv, mot]", "[mot]")):
        assert mono_run(f"  write: {names}", out=f"out{number}")[0] == 0
        summary = json.loads((tmp_path / f"out{number}/summary.json").read_text())
        summaries.append(
            {key: value for key, value in summary.items() if key in ("frames", "methods", "tracks")}
        )
    assert summaries[0] == summaries[1]


def test_entry_point(install):
    install("track_range.result_writers", toy="tests.toys.toy_writer:JsonLinesWriter")
    assert WRITERS.names == (*BUILT_IN, "toy")
    assert isinstance(create_writer("toy"), JsonLinesWriter)
    assert "frames.jsonl" in result_names()


def test_settings_name_writers():
    assert RunSettings(mono="a.mp4").write == DEFAULT_WRITERS
    assert settings_from({"mono": "a.mp4", "write": "mot, csv"}).write == ("mot", "csv")
    with pytest.raises(UsageError, match=r"unknown format parquetry: .*csv"):
        settings_from({"mono": "a.mp4", "write": "csv,parquetry"})


def test_unknown_and_unusable_writers():
    with pytest.raises(WriterError, match="nothing"):
        create_writer("nothing")
    with pytest.raises(WriterError, match="csv"):
        register_writer("csv", JsonLinesWriter)
    with (
        registered_writer("gone", "tests.toys.toy_writer:Gone"),
        pytest.raises(WriterError, match="gone"),
    ):
        create_writer("gone")


def test_failing_writer(tmp_path):
    with registered_writer("full", FullDisk), registered_writer(NAME, JsonLinesWriter):
        opened = OpenWriters(["jsonl", "full", "mot"], INFO, tmp_path)
        with pytest.raises(OutputError, match=r"full\.bin: .*No space"):
            opened.write(result())
        opened.close({"frames": 0})  # the failure has been reported
    assert json.loads((tmp_path / "frames.jsonl").read_text().splitlines()[-1])["frames"] == 0
    assert (tmp_path / "mot.txt").exists()


def test_failure_at_the_end_is_reported(tmp_path):
    with registered_writer("full", FullDisk):
        opened = OpenWriters(["full"], INFO, tmp_path)
        with pytest.raises(OutputError, match=r"full\.bin"):
            opened.close(None)


def test_file_that_cannot_be_created(tmp_path):
    (tmp_path / "mot.txt").mkdir()
    with pytest.raises(OutputError, match=r"mot\.txt"):
        OpenWriters(["csv", "mot"], INFO, tmp_path)


def test_writers_left_open_are_closed(tmp_path):
    with registered_writer(NAME, JsonLinesWriter):
        with OpenWriters(["jsonl"], INFO, tmp_path) as opened:
            opened.write(result())
        assert (
            json.loads((tmp_path / "frames.jsonl").read_text().splitlines()[-1])["frames"] is None
        )


def writer_of(*files):
    return type("Custom", (JsonLinesWriter,), {"files": files})


def test_unusable_writers(tmp_path, mono_run, monkeypatch, install):
    (tmp_path / "broken_writer.py").write_text("1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    install("track_range.result_writers", broken="broken_writer:Writer")
    without_files = type("WithoutFiles", (), dict.fromkeys(("open", "write", "close"), print))
    with registered_writer("plain", object), registered_writer("nameless", without_files):
        status, _, complaint = mono_run("  write: [csv]")
        assert status == 0, complaint
        (tmp_path / "out/tracks.csv").write_text("of the earlier run")
        for name in ("broken", "plain", "nameless"):
            status, _, complaint = mono_run(f"  write: [csv, {name}]")
            assert status == 1
            assert f"'{name}'" in complaint
            assert len(complaint.strip().splitlines()) == 1
        assert (tmp_path / "out/tracks.csv").read_text() == "of the earlier run"


@pytest.mark.parametrize(
    "files",
    [
        ("../evil.txt",),
        ("folder/a.txt",),
        ("folder\\a.txt",),
        ("C:a.txt",),
        ("/a.txt",),
        ("..",),
        (".",),
        ("",),
        ("a\n.txt",),
        ("summary.json",),
        ("Report.html",),
        ("overlay.mp4",),
        ("a.txt", "a.txt"),
        (5,),
    ],
)
def test_invalid_file_names_of_writers(tmp_path, files):
    with registered_writer("custom", writer_of(*files)):
        with pytest.raises(WriterError, match="custom"):
            create_writer("custom")
        assert not set(files) - {"summary.json", "overlay.mp4"} & set(result_names())


def test_files_outside_the_folder_are_kept(tmp_path, mono_run):
    (tmp_path / "evil.txt").write_text("precious")
    with registered_writer("custom", writer_of("../evil.txt")):
        assert mono_run("  write: [csv]")[0] == 0
        assert mono_run("  write: [custom]")[0] == 1
    assert (tmp_path / "evil.txt").read_text() == "precious"


def test_two_writers_of_one_file():
    with registered_writer("custom", writer_of("tracks.csv")):
        assert len(create_writers(["custom", "mot"])) == 2
        with pytest.raises(WriterError, match=r"'csv' and 'custom'.*tracks\.csv"):
            create_writers(["csv", "custom"])
    assert len(create_writers(["csv", "csv"])) == 1
