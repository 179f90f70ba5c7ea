"""`track-range fleet run` and `status` on real videos, on a real cluster."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pyarrow.dataset
import pyarrow.parquet
import pytest
from pydantic import ValidationError

from tests.track_range.fleet.killing import killed_workers
from track_range.fleet.engine import fleet_run
from track_range.fleet.engine.plan import common_options
from track_range.fleet.output.data_set import read_clips
from track_range.fleet.settings import FleetSettings, size_bytes
from track_range.fleet.storage.location import Location


@pytest.fixture(scope="module")
def drives(small_drive, tmp_path_factory):
    """Two pairs with a calibration, and one with a left video that cannot be read."""
    folder = tmp_path_factory.mktemp("drives")
    for name in ("one", "two", "corrupt"):
        (folder / name).mkdir()
        for file in (small_drive.left, small_drive.right, small_drive.rig):
            shutil.copy(file, folder / name)
    left = folder / "corrupt" / small_drive.left.name
    left.write_bytes(left.read_bytes()[:2000])
    return folder, f"{{clip}}/{small_drive.left.name},{{clip}}/{small_drive.right.name}"


@pytest.fixture(scope="module")
def finished(cli, cluster, drives, tmp_path_factory):
    """The output of a fleet with these drives, and what the command printed."""
    recordings, pattern = drives
    out = tmp_path_factory.mktemp("fleet") / "out"
    arguments = (
        "fleet",
        "run",
        recordings,
        "--pattern",
        pattern,
        "--out",
        out,
        "--address",
        cluster.address,
    )
    return out, arguments, cli(*arguments, "--workers", 2, "--no-sgbm", "--worker-memory", "2GB")


@pytest.mark.slow
def test_corrupt_clip_is_one_row(finished):
    out, _, (status, stdout, stderr) = finished
    rows = {row["clip"]: row for row in read_clips(Location.of(out)).to_pylist()}
    assert {name: row["status"] for name, row in rows.items()} == {
        "one": "done",
        "two": "done",
        "corrupt": "failed",
    }
    assert rows["corrupt"]["error_kind"] == "input"
    assert status == 3
    assert "corrupt" in stderr
    assert "2 of 3 clips done" in stdout
    assert rows["one"]["frames"] == 12
    assert rows["one"]["calibration"] == "rig"
    assert rows["one"]["read_ms"] > 0
    assert (rows["one"]["focal_px"] > 0, rows["one"]["focal_sigma"]) == (True, 0.0)
    assert 0 < rows["one"]["fused_coverage"] <= 1


@pytest.mark.slow
def test_rows_equal_those_of_a_run(finished, drives, small_drive, tmp_path):
    out, _, _ = finished
    recordings, _ = drives
    left, right = (
        recordings / "one" / video.name for video in (small_drive.left, small_drive.right)
    )
    command = [
        sys.executable,
        "-m",
        "track_range",
        "run",
        "--stereo",
        left,
        right,
        "--out",
        tmp_path,
        "--no-sgbm",
    ]
    # the last digits depend on the threads of linear algebra
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run([*command, "--no-overlay"], check=True, env=environment, capture_output=True)
    ordinary = pyarrow.parquet.ParquetFile(tmp_path / "tracks.parquet").read()
    for name in ("one", "two"):
        file = out / "tracks" / f"clip={name}" / "tracks.parquet"
        assert pyarrow.parquet.ParquetFile(file).read().equals(ordinary)
        metadata = pyarrow.parquet.read_schema(file).metadata
        assert metadata[b"track_range.clip"].decode() == name
        assert str(recordings) not in str(metadata)


@pytest.mark.slow
def test_killed_workers_leave_the_same_rows(cli, cluster, small_drive, tmp_path, monkeypatch):
    monkeypatch.setattr(fleet_run, "HEARTBEAT_S", 0.2)  # fleet.json names the processes to kill
    for number in range(8):
        (tmp_path / "clips").mkdir(exist_ok=True)
        shutil.copy(small_drive.left, tmp_path / "clips" / f"clip-{number}.mp4")
    arguments = (
        "--focal-px",
        500,
        "--out",
        tmp_path / "out",
        "--address",
        cluster.address,
        "--workers",
        2,
    )
    with killed_workers(tmp_path / "out", 4, interval_s=1.5) as killed:
        status, _, stderr = cli("fleet", "run", tmp_path / "clips", *arguments)
    rows = read_clips(Location.of(tmp_path / "out")).to_pylist()
    failures = [(row["clip"], row["error_kind"], row["error"]) for row in rows if row["error_kind"]]
    assert (status, stderr, failures) == (0, "", [])
    assert killed
    tables = [
        pyarrow.parquet.ParquetFile(file).read()
        for file in (tmp_path / "out" / "tracks").rglob("*.parquet")
    ]
    assert len(tables) == 8
    assert all(table.equals(tables[0]) for table in tables)
    assert {row["rows"] for row in rows} == {tables[0].num_rows}
    assert sum(row["attempts"] for row in rows) > 8


@pytest.mark.slow
def test_data_set_is_partitioned_by_clip(finished):
    import duckdb

    out, _, _ = finished
    table = pyarrow.dataset.dataset(out / "tracks", partitioning="hive").to_table()
    assert set(table["clip"].to_pylist()) == {"one", "two"}
    query = f"""select clip, count(*) from read_parquet('{out}/tracks/*/*.parquet', hive_partitioning = true)
        join '{out}/clips.parquet' using (clip) group by clip"""  # noqa: S608
    counts = dict(duckdb.sql(query).fetchall())
    assert counts["one"] == counts["two"] == table.num_rows / 2


@pytest.mark.slow
def test_other_settings_repeat_the_clips(finished, cli):
    out, arguments, _ = finished
    options = (*arguments, "--workers", 2, "--worker-memory", "2GB", "--no-sgbm")
    before = read_clips(Location.of(out))
    status, stdout, _ = cli(*options)
    assert (status, "2 in earlier runs" in stdout) == (3, True)
    assert read_clips(Location.of(out)).equals(before)
    others = ("--reports", "--classes", "car", "--write", "csv")
    status, _, stderr = cli(*options, *others)
    assert (status, "of 2 clips" in stderr, "--overwrite" in stderr) == (1, True, True)
    assert read_clips(Location.of(out)).equals(before)
    status, stdout, _ = cli(*options, *others, "--overwrite")
    assert "earlier runs" not in stdout
    assert {file.name for file in (out / "runs" / "clip=one").iterdir()} == {
        *("tracks.csv", "events.csv", "report.html", "summary.json"),
    }
    after = read_clips(Location.of(out)).to_pylist()
    assert len(after) == 3
    assert len({row["settings_hash"] for row in after}) == 1


@pytest.mark.slow
def test_status_of_a_finished_fleet(finished, cli):
    out, _, _ = finished
    status, stdout, _ = cli("fleet", "status", out)
    assert status == 0
    assert "2 of 3 clips done" in stdout
    assert "corrupt" in stdout


def test_status_without_a_fleet(cli, tmp_path):
    status, _, stderr = cli("fleet", "status", tmp_path)
    assert (status, str(tmp_path) in stderr) == (1, True)


@pytest.mark.parametrize("option", ["--truth", "--detections", "--mono", "--table"])
def test_options_that_a_fleet_refuses(cli, tmp_path, option):
    (tmp_path / "a.mp4").touch()
    status, _, stderr = cli("fleet", "run", tmp_path, "--out", tmp_path / "out", option, "x")
    assert (status, option in stderr) == (2, True)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "options",
    [
        ("--ego-speed", "speed.csv"),
        ("--min-score", "2"),
        ("--worker-memory", "much"),
        ("--classes", "cat"),
    ],
)
def test_invalid_options_of_a_fleet(cli, tmp_path, options):
    (tmp_path / "a.mp4").touch()
    status, _, stderr = cli("fleet", "run", tmp_path, "--out", tmp_path / "out", *options)
    assert status in (1, 2)
    assert options[0] in stderr or options[1] in stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere", "127.0.0.1:99999", "host:"])
def test_address_without_a_cluster(tmp_path, small_drive, address):
    """In another process, since this one may be connected to a cluster."""
    command = [
        sys.executable,
        "-m",
        "track_range",
        "fleet",
        "run",
        small_drive.left,
        "--focal-px",
        "500",
    ]
    arguments = ["--out", tmp_path / "out", "--address", address]
    ended = subprocess.run(
        [*map(str, (*command, *arguments))], capture_output=True, text=True, timeout=60
    )
    assert ended.returncode == 1
    assert "--address" in ended.stderr
    assert len(ended.stderr.splitlines()) == 1


@pytest.mark.slow
def test_address_of_another_server(tmp_path, small_drive, web):
    address = web[0].removeprefix("http://")
    command = [
        sys.executable,
        "-m",
        "track_range",
        "fleet",
        "run",
        small_drive.left,
        "--focal-px",
        "500",
    ]
    arguments = ["--out", tmp_path / "out", "--address", address]
    ended = subprocess.run(
        [*map(str, (*command, *arguments))], capture_output=True, text=True, timeout=60
    )
    assert (ended.returncode, len(ended.stderr.splitlines())) == (1, 1)
    assert address in ended.stderr


def test_dry_run_prints_each_note_once(cli, film, tmp_path):
    (tmp_path / "clips").mkdir()
    for name in "abc":
        film(tmp_path / "clips" / f"{name}.mp4", [0, 0.1, 0.2])
    status, stdout, _ = cli(
        "fleet", "run", tmp_path / "clips", "--out", tmp_path / "out", "--dry-run"
    )
    text = " ".join(stdout.split())
    assert (status, text.count("focal length is estimated")) == (0, 1)
    assert "estimates it once. (3 clips)" in text
    assert "0.3 s, calibration: none" in text


def test_dry_run_with_options_of_the_runs(cli, film, tmp_path):
    (tmp_path / "clips").mkdir()
    film(tmp_path / "clips" / "a.mp4", [0, 0.1])
    arguments = ("fleet", "run", tmp_path / "clips", "--out", tmp_path / "out", "--dry-run")
    status, stdout, _ = cli(*arguments)
    assert (status, "focal length is estimated" in " ".join(stdout.split())) == (0, True)
    status, stdout, _ = cli(*arguments, "--focal-px", 50)
    assert (status, "focal length" in stdout) == (0, True)


def test_settings_of_an_earlier_run(cli, film, tmp_path):
    (tmp_path / "clips").mkdir()
    film(tmp_path / "clips" / "a.mp4", [0, 0.1])
    file = tmp_path / "settings.yaml"
    file.write_text(
        "track_range_settings: 1\nrun: {mono: x.mp4, out: y, focal_px: 50, overlay: true, classes: "
        "[car]}\n"
    )
    arguments = (
        "fleet",
        "run",
        tmp_path / "clips",
        "--out",
        tmp_path / "out",
        "--dry-run",
        "--settings",
        file,
    )
    status, stdout, _ = cli(*arguments)
    assert (status, "focal length" in stdout) == (0, True)
    assert common_options(file) == {"focal_px": 50, "classes": ["car"]}
    file.write_text("track_range_settings: 1\nrun: {mono: x.mp4, focal_pixels: 50}\n")
    status, _, stderr = cli(*arguments)
    assert (status, "focal_pixels" in stderr) == (1, True)


@pytest.mark.slow
def test_anonymized_fleet_names_no_folders(cli, cluster, small_drive, tmp_path):
    folder = tmp_path / "j.doe"
    folder.mkdir()
    shutil.copy(small_drive.left, folder / "good.mp4")
    (folder / "bad.mp4").write_text("no video")
    options = (
        "--out",
        tmp_path / "out",
        "--address",
        cluster.address,
        "--workers",
        1,
        "--focal-px",
        500,
    )
    status, _, _ = cli("fleet", "run", folder, *options, "--anonymize", "--no-sgbm")
    assert status == 3
    rows = read_clips(Location.of(tmp_path / "out")).to_pylist()
    assert [(row["status"], row["left"]) for row in rows] == [
        ("failed", "bad.mp4"),
        ("done", "good.mp4"),
    ]
    assert rows[0]["error"].startswith("bad.mp4")
    assert "j.doe" not in f"{rows}{(tmp_path / 'out' / 'fleet.json').read_text()}"


def test_web_server_as_output(cli, tmp_path):
    (tmp_path / "a.mp4").touch()
    status, _, stderr = cli("fleet", "run", tmp_path, "--out", "https://127.0.0.1/x")
    assert (status, "--out" in stderr) == (1, True)


@pytest.mark.parametrize(
    "option", ["--reid", "--curves", "--align", "--lanes", "--detector", "--names"]
)
def test_missing_shared_file(cli, tmp_path, option):
    (tmp_path / "a.mp4").touch()
    status, _, stderr = cli(
        "fleet", "run", tmp_path, "--out", tmp_path / "out", option, tmp_path / "missing.txt"
    )
    assert status in (1, 2)
    assert "missing.txt" in stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "n_bytes"), [("2GB", 2e9), ("1.5 gb", 1.5e9), ("300MB", 3e8), ("7", 7)]
)
def test_size_bytes(text, n_bytes):
    assert size_bytes(text) == n_bytes


@pytest.mark.parametrize("text", ["", "GB", "-2GB", "0", "1e9", "2 PB"])
def test_sizes_that_are_refused(text):
    with pytest.raises(ValueError, match="2GB"):
        size_bytes(text)
    with pytest.raises(ValidationError):
        FleetSettings(recordings=("x",), out="y", worker_memory=text)
