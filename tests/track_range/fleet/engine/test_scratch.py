"""Folders of workers for remote recordings."""

import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from track_range.fleet.engine.scratch import folder_of, open_scratch

HOLDER = """
import sys, time
from pathlib import Path
from track_range.fleet.engine.scratch import open_scratch
(open_scratch(Path(sys.argv[1])) / "part").write_bytes(b"x")
print("ready", flush=True)
time.sleep(60)
"""


@pytest.fixture(autouse=True)
def _temporary_folder():
    before = tempfile.tempdir
    yield
    tempfile.tempdir = before


def test_folder_of_a_killed_process_is_removed(tmp_path):
    (tmp_path / "other").mkdir()
    process = subprocess.Popen([sys.executable, "-c", HOLDER, str(tmp_path)], stdout=subprocess.PIPE)
    with process:
        assert process.stdout.readline().strip() == b"ready"
        part = folder_of(process.pid, tmp_path) / "part"
        mine = open_scratch(tmp_path)
        assert part.exists()  # that of the living process stays
        process.kill()
    assert part.exists()
    assert open_scratch(tmp_path) == mine == Path(tempfile.gettempdir())
    assert {path.name for path in tmp_path.iterdir()} == {mine.name, "other"}


def test_earlier_content_of_the_folder_is_removed(tmp_path):
    (open_scratch(tmp_path) / "old").write_bytes(b"x")
    assert list(open_scratch(tmp_path).iterdir()) == []
