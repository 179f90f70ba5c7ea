"""Five commands and the Python examples of the README and the pages of docs/, run as they are
printed."""

import re
import shlex
from pathlib import Path

import pytest

from tests.documentation.documented_commands import PAGES, README, commands, python_blocks
from tests.documentation.documented_inputs import copy_inputs, write_inputs
from tests.support.command_line import run_command

pytestmark = pytest.mark.slow

RESULTS = (
    "tracks.csv",
    "mot.txt",
    "tracks.parquet",
    "summary.json",
    "report.html",
    "overlay.mp4",
    "settings.yaml",
)

RUNS = {
    "track-range --stereo left.mp4 right.mp4 --rig rig.yaml": (
        [f"left-track-range/{name}" for name in RESULTS],
        ("Results in left-track-range",),
    ),
    "track-range --mono dashcam.mp4": (
        [f"dashcam-track-range/{name}" for name in RESULTS],
        ("Results in dashcam-track-range",),
    ),
    "track-range --stereo left/ right/ --rig calib.txt --detections det.txt --truth labels.txt "
    "--out results": (
        [f"results/{name}" for name in RESULTS],
        ("Results in results", "Accuracy against"),
    ),
    "track-range track det.txt --out tracks": (["tracks/mot/det.txt"], ("tracks/mot",)),
    "track-range evaluate tracks --truth labels/ --results tracks --class car": (
        [],
        ("HOTA", "IDF1"),
    ),
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
    assert [
        name
        for name in files
        if not (tmp_path / name).is_file() or not (tmp_path / name).stat().st_size
    ] == []


def test_runs_are_documented():
    shown = {line for text in PAGES.values() for line in commands(text)}
    assert [line for line in RUNS if line not in shown] == []


def run_code(code, name):
    exec(compile(code, name, "exec"), {"__name__": "example"})  # noqa: S102 - our own text


@pytest.fixture
def recording(store, tmp_path, monkeypatch):
    """A folder with the videos that the examples name, and it is the current one."""
    copy_inputs(store, ["left.mp4", "right.mp4", "rig.yaml", "dashcam.mp4"], tmp_path)
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("recording")
def test_readme_example_runs(capsys):
    (code,) = (code for code in python_blocks(README) if "tr.Run" in code)
    assert len(code.splitlines()) <= 10
    run_code(code, "README.md")
    assert re.search(
        r"^0\.\d s: car 1 at \d+\.\d \+- \d\.\d m$", capsys.readouterr().out, re.MULTILINE
    )
    assert len(list(Path().iterdir())) == 4  # nothing is written


@pytest.mark.usefixtures("recording")
def test_parts_example_runs(capsys):
    run_code(python_blocks(PAGES["docs/reference/api/parts.md"])[0], "parts.md")
    assert len(capsys.readouterr().out.splitlines()) > 5


@pytest.mark.usefixtures("recording")
def test_detector_example_runs():
    (code,) = (
        code for code in python_blocks(PAGES["docs/project/extending.md"]) if "def detect" in code
    )
    run_code(code + "assert next(iter(run)).index == 0\nrun.close()\n", "extending.md")
