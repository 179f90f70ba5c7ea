"""`--tracker` of a run: built-in names, and a class of another package whose ids appear in the
results."""

import csv
import sys

import pytest

from tests.toys.toy_tracker import GreedyIouTracker
from track_range.tracking import registry


@pytest.fixture
def mono_run(tmp_path, film, cli):
    """Runs on a video of eight frames with a box each; returns status, ids in tracks.csv, and the
    error."""
    video = film(tmp_path / "film.mp4", [0.1 * i for i in range(8)])
    boxes = tmp_path / "boxes.txt"
    boxes.write_text("".join(f"{i},10,10,40,40,0.9\n" for i in range(8)))

    def run(*options):
        arguments = (
            "--mono",
            video,
            "--focal-px",
            100,
            "--detections",
            boxes,
            "--no-overlay",
            "--lanes",
            "off",
        )
        status, _, complaint = cli(*arguments, "--out", tmp_path / "out", *options)
        table = tmp_path / "out/tracks.csv"
        rows = list(csv.DictReader(table.read_text().splitlines())) if status == 0 else []
        return status, {int(row["track_id"]) for row in rows}, complaint

    return run


@pytest.mark.parametrize(
    ("name", "ids"),
    [("road", {1}), ("sort", {1}), ("tests.toys.toy_tracker:GreedyIouTracker", {101})],
)
def test_ids_are_the_trackers(mono_run, name, ids):
    assert mono_run("--tracker", name)[:2] == (0, ids)


def test_registered_tracker(mono_run):
    with registry.TRACKERS.restored():
        registry.register_tracker("greedy", GreedyIouTracker)
        assert mono_run("--tracker", "greedy")[:2] == (0, {101})


@pytest.mark.parametrize(
    ("name", "status"),
    [("none", 2), ("tests.none:X", 2), ("tests.toys.toy_tracker:NotATracker", 1)],
)
def test_wrong_tracker(mono_run, name, status):
    result, _, complaint = mono_run("--tracker", name)
    assert (result, name in complaint) == (status, True), complaint


def test_tracker_of_the_current_folder(mono_run, tmp_path, monkeypatch):
    (tmp_path / "local_module.py").write_text(
        "from tests.toys.toy_tracker import GreedyIouTracker as LocalTracker\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [folder for folder in sys.path if folder])
    assert mono_run("--tracker", "local_module:LocalTracker")[:2] == (0, {101})
    sys.modules.pop("local_module")
