"""Folders of workers for remote recordings."""

import subprocess
import sys
import tempfile
from pathlib import Path

from track_range.fleet.engine.worker import scratch_folder

HOLDER = """
import sys, time
from pathlib import Path
from track_range.fleet.engine.worker import scratch_folder
with scratch_folder(Path(sys.argv[1])) as folder:
    (folder / "part").write_bytes(b"x")
    print(folder, flush=True)
    time.sleep(60)
"""


def test_folder_of_a_killed_process_is_removed(tmp_path):
    (tmp_path / "other").mkdir()
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    with process:
        part = Path(process.stdout.readline().strip()) / "part"
        with scratch_folder(tmp_path):
            assert part.exists()  # that of the living process stays
        process.kill()
    assert part.exists()
    before = tempfile.gettempdir()
    with scratch_folder(tmp_path) as mine:
        assert mine == Path(tempfile.gettempdir())
        assert {path.name for path in tmp_path.iterdir()} == {mine.name, "other"}
    assert tempfile.gettempdir() == before
    assert {path.name for path in tmp_path.iterdir()} == {"other"}


def test_earlier_content_of_the_folder_is_removed(tmp_path):
    with scratch_folder(tmp_path) as folder:
        pass
    folder.mkdir()
    (folder / "old").write_bytes(b"x")
    with scratch_folder(tmp_path) as again:
        assert again == folder
        assert list(again.iterdir()) == []
