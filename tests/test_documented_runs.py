"""Six commands and the Python example of the README and the pages of docs/, run as they are printed."""

import shlex
from pathlib import Path

import pytest

from tests.command_line import run_command
from tests.documented_commands import PAGES, README, commands, python_blocks
from tests.documented_inputs import copy_inputs, write_inputs

pytestmark = pytest.mark.slow

RESULTS = ("tracks.csv", "mot.txt", "summary.json", "report.html", "overlay.mp4", "settings.yaml")

RUNS = {
    "track-range --stereo left.mp4 right.mp4 --rig rig.yaml": (
        [f"left-track-range/{name}" for name in RESULTS],
        ("Results in left-track-range",),
    ),
    "track-range --mono dashcam.mp4 --focal-px 1150 --detector yolov5n.onnx": (
        [f"dashcam-track-range/{name}" for name in RESULTS],
        ("Results in dashcam-track-range",),
    ),
    "track-range --stereo left/ right/ --rig calib.txt --detections det.txt --truth labels.txt --out results": (
        [f"results/{name}" for name in RESULTS],
        ("Results in results", "Distance error"),
    ),
    "track-range calibrate --stereo 'left*.jpg' 'right*.jpg' --board 9x6 --square-mm 20 --out rig.yaml": (
        ["rig.yaml", "rig.png"],
        ("7 of 7",),
    ),
    "track-range track det.txt --out tracks": (["tracks/mot/det.txt"], ("tracks/mot",)),
    "track-range evaluate tracks --truth labels/ --results tracks --class car": ([], ("HOTA", "IDF1")),
}
"""By command: files that it writes, and words that it prints."""


@pytest.fixture(scope="session")
def store(tmp_path_factory, small_drive):
    """Files of all names that the commands use."""
    return write_inputs(tmp_path_factory.mktemp("store"), small_drive)


@pytest.mark.parametrize("line", RUNS, ids=str)
def test_documented_command_runs(line, store, tmp_path):
    words = shlex.split(line)[1:]
    copy_inputs(store, words, tmp_path)
    done = run_command(*words, folder=tmp_path)
    files, printed = RUNS[line]
    assert (done.status, done.stderr) == (0, "")
    assert [word for word in printed if word not in done.stdout] == []
    assert [name for name in files if not (tmp_path / name).is_file() or not (tmp_path / name).stat().st_size] == []


def test_runs_are_documented():
    shown = {line for text in PAGES.values() for line in commands(text)}
    assert [line for line in RUNS if line not in shown] == []


def test_python_example_runs(store, tmp_path, monkeypatch, capsys):
    copy_inputs(store, ["left.mp4", "right.mp4", "rig.yaml"], tmp_path)
    monkeypatch.chdir(tmp_path)
    (code,) = python_blocks(README)
    assert len(code.splitlines()) <= 10
    exec(compile(code, "README.md", "exec"), {})  # noqa: S102 - our own text
    printed = capsys.readouterr().out.splitlines()
    assert any("track 1 at" in line for line in printed)
    assert sorted(path.name for path in Path().iterdir()) == ["left.mp4", "rig.yaml", "right.mp4"]
