"""Types of the keyword arguments of `Run.mono` and `Run.stereo`."""

import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[3]

PROGRAM = """\
import track_range as tr
from track_range.detection.detector import ObjectDetector


def runs(detector: ObjectDetector) -> None:
    tr.Run.mono("a.mp4", focal_px=1150, duration=0.3, rig=None, min_score=0.2, progress=True)
    tr.Run.stereo("a.mp4", "b.mp4", detector=detector, classes=["car"], sgbm_options={"block_size": 5})
    tr.Run.mono("a.mp4", focal_length=1150)
    tr.Run.stereo("a.mp4", "b.mp4", sgbm="no")
    tr.Run.mono("a.mp4", mcap_profile="ros1")
"""


def test_file_is_that_of_the_settings():
    subprocess.run([sys.executable, ".ci/run_options.py", "--check"], cwd=PROJECT, check=True)


@pytest.mark.slow
def test_type_checker_finds_wrong_keywords(tmp_path):
    (tmp_path / "program.py").write_text(PROGRAM)
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--strict",
        "--config-file=",
        f"--cache-dir={tmp_path / 'cache'}",
    ]
    command += ["--follow-imports=silent", "--ignore-missing-imports", str(tmp_path / "program.py")]
    done = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, check=False)
    lines = [
        line.partition("program.py:")[2]
        for line in done.stdout.splitlines()
        if ": error: " in line and "program.py:" in line
    ]
    assert [line.partition(":")[0] for line in lines] == ["8", "9", "10"], done.stdout
    assert 'Unexpected keyword argument "focal_length"' in lines[0]
    assert '"sgbm"' in lines[1] or "bool" in lines[1]
