"""Drivers in separate processes, with a Ray cluster of this machine each: kill -9, Ctrl-C, a full
disk."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("ray")

from track_range.fleet.output.data_set import read_clips
from track_range.fleet.output.state import read_state
from track_range.fleet.storage.location import Location

pytestmark = pytest.mark.slow

PROJECT = Path(__file__).resolve().parents[4]


def start(tmp_path, n_clips, **options):
    command = [
        sys.executable,
        "-m",
        "tests.track_range.fleet.driver_process",
        tmp_path / "out",
        tmp_path / "clips",
    ]
    environment = {**os.environ, "PYTHONPATH": str(PROJECT)}
    return subprocess.Popen(
        [*map(str, command), str(n_clips)],
        env=environment,
        cwd=PROJECT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def rows_of(tmp_path):
    return {row["clip"]: row for row in read_clips(Location.of(tmp_path / "out")).to_pylist()}


def wait_for_clips(tmp_path, process, n_clips):
    for _ in range(1500):
        if (tmp_path / "out").exists() and len(rows_of(tmp_path)) >= n_clips:
            return
        assert process.poll() is None, process.communicate()
        time.sleep(0.2)
    raise AssertionError("no clips")


def is_running(*texts):
    """Whether a process with all these texts in its command line is running."""
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                command = (folder / "cmdline").read_bytes()
            except OSError:
                continue
            if all(text.encode() in command for text in texts):
                return True
    return False


def test_killed_driver_continues(tmp_path):
    process = start(tmp_path, 24)
    wait_for_clips(tmp_path, process, 6)
    assert is_running(f"tr-ray-{process.pid}")
    # it would ask for the cloud provider; see `cluster`
    assert not is_running(f"tr-ray-{process.pid}", "ray/dashboard/dashboard.py")
    process.kill()
    process.communicate()
    before = rows_of(tmp_path)
    state = read_state(Location.of(tmp_path / "out"))
    assert state.state == "running"
    assert not state.is_alive
    for _ in range(600):  # Ray's processes notice the end of the driver
        if not is_running(f"tr-ray-{process.pid}"):
            break
        time.sleep(0.2)
    assert not is_running(f"tr-ray-{process.pid}")
    again = start(tmp_path, 24)
    assert again.communicate(timeout=300)[1] == ""
    rows = rows_of(tmp_path)
    assert len(rows) == 24
    assert {row["status"] for row in rows.values()} == {"done"}
    assert all(rows[name] == row for name, row in before.items())
    assert not list((tmp_path / "out" / "journal").iterdir())
    assert len(list((tmp_path / "out" / "tracks").rglob("*"))) == 48


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_driver(tmp_path, number):
    process = start(tmp_path, 200)
    wait_for_clips(tmp_path, process, 3)
    process.send_signal(number)
    _, stderr = process.communicate(timeout=300)
    assert process.returncode == 1
    assert "stopped by the user" in stderr
    assert len(stderr.splitlines()) == 1
    rows = rows_of(tmp_path)
    assert 3 <= len(rows) < 200
    assert not list((tmp_path / "out" / "journal").iterdir())
    assert read_state(Location.of(tmp_path / "out")).state == "stopped"
    assert not is_running(f"tr-ray-{process.pid}")


@pytest.fixture
def small_disk(tmp_path):
    """A folder on a file system of 150 kB."""
    folder = tmp_path / "out"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=150k", "tmpfs", folder], capture_output=True, text=True
    )
    if mounted.returncode:
        pytest.skip(f"no permission to mount a file system ({mounted.stderr.strip()})")
    yield folder
    subprocess.run(["umount", folder], check=True)


def test_full_disk_ends_the_run(tmp_path, small_disk):
    process = start(tmp_path, 60)
    _, stderr = process.communicate(timeout=300)
    assert process.returncode == 1, stderr
    assert len(stderr.splitlines()) == 1, stderr
    assert "space" in stderr
    rows = rows_of(tmp_path)
    assert 0 < len(rows) < 60
    assert {row["status"] for row in rows.values()} == {"done"}
    for name in rows:
        assert (small_disk / "tracks" / f"clip={name}" / "tracks.parquet").stat().st_size > 0
