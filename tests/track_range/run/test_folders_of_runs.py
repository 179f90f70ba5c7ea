"""Names of output folders, results that a run replaces, and files that belong to one video or to a folder."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

import track_range as tr
from track_range.errors import OutputError
from track_range.recording.video.file_names import stem_of_path

RUN = {"detections": "boxes.txt", "lanes": "off", "write": "csv", "overlay": False}


@pytest.mark.parametrize(
    ("name", "stem"),
    [("clip.mp4", "clip"), (".", "drive"), ("images/..", "drive"), ("./", "drive"), ("a/b", "b")],
)
def test_stems_of_videos_and_folders(tmp_path, monkeypatch, name, stem):
    (tmp_path / "drive" / "images").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "drive")
    assert stem_of_path(Path(name)) == stem


@pytest.fixture
def folders(tmp_path: Path, monkeypatch) -> Path:
    """Two recordings with the same name in two folders, and empty detections."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "boxes.txt").touch()
    image = np.random.default_rng(0).integers(0, 255, (72, 128, 3), np.uint8)
    for side in ("front", "rear"):
        folder = tmp_path / side / "clip"
        folder.mkdir(parents=True)
        for index in range(2):
            cv2.imwrite(str(folder / f"{index:06}.png"), image)
    return tmp_path


def write(video: str, **options) -> None:
    with tr.Run.mono(video, focal_px=100.0, out="results", **RUN, **options) as run:
        for _ in run:
            pass


def test_results_of_another_recording_are_not_replaced(folders):
    write("front/clip")
    first = Path("results/summary.json").read_bytes()
    with pytest.raises(OutputError, match=r"front/clip.*another folder.*overwrite"):
        write("rear/clip")
    assert Path("results/summary.json").read_bytes() == first
    write("rear/clip", overwrite=True)
    assert "rear" in Path("results/settings.yaml").read_text()


def test_results_of_the_same_recording_are_replaced_and_this_is_said(folders, cli):
    options = ("--mono", "front/clip", "--focal-px", "100", "--detections", "boxes.txt")
    options = (*options, "--out", "results", "--lanes", "off", "--write", "csv", "--no-overlay")
    assert "are replaced" not in cli(*options).stdout
    hash_before = json.loads(Path("results/summary.json").read_text())["settings_hash"]
    assert "The results of an earlier run in results are replaced." in cli(*options).stdout
    cli(*options, "--overwrite")
    assert json.loads(Path("results/summary.json").read_text())["settings_hash"] == hash_before


def test_a_pair_replaces_the_results_of_its_left_recording(folders):
    write("front/clip")
    options = {**RUN, "align": "off"}
    with tr.Run.stereo("front/clip", "rear/clip", out="results", **options) as run:
        assert run.replaces_results
        for _ in run:
            pass
    with pytest.raises(OutputError, match="front/clip"):
        write("rear/clip")


def test_a_file_is_no_folder(folders, cli):
    finished = cli("--mono", "front/clip", "--focal-px", "100", "--out", "boxes.txt")
    assert "expected a folder for the results, found a file" in finished.stderr


@pytest.mark.parametrize("name", ["rig.yaml", "calib.txt"])
def test_a_calibration_for_several_videos_is_noted(small_drive, tmp_path, name):
    shutil.copy(small_drive.left, tmp_path / "left.mp4")
    shutil.copy(small_drive.rig, tmp_path / name)

    def note() -> str:
        recording = tr.open_recording(tmp_path / "left.mp4")
        notes = [note for note in recording.notes if "Using calibration" in note]
        recording.close()
        (found,) = notes
        return found

    assert "every video" not in note()
    shutil.copy(small_drive.left, tmp_path / "other.mp4")
    assert "every video of its folder, such as other.mp4" in note()
    assert f"rename it to left.{name}" in note()
    (tmp_path / name).rename(tmp_path / f"left.{name}")
    assert f"left.{name}" in note()
    assert "every video" not in note()


def test_a_pair_is_not_another_video_of_its_folder(small_drive):
    recording = tr.open_recording(small_drive.left, small_drive.right, align="off")
    assert not any("every video" in note for note in recording.notes)
    recording.close()


def test_a_speed_for_several_videos_is_noted(small_drive, tmp_path):
    for name in ("left.mp4", "other.mp4"):
        shutil.copy(small_drive.left, tmp_path / name)
    table = tmp_path / "ego_speed.csv"
    table.write_text("time_s,speed_mps\n0,10\n30,10\n")
    (tmp_path / "boxes.txt").touch()

    def origin() -> str:
        options = {**RUN, "detections": tmp_path / "boxes.txt"}
        with tr.Run.mono(tmp_path / "left.mp4", rig=small_drive.rig, **options) as run:
            for _ in run:
                pass
            return next(note for note in run.notes if "The ego speed comes from" in note)

    assert "rename it to left.ego_speed.csv" in origin()
    table.rename(tmp_path / "left.ego_speed.csv")
    assert "left.ego_speed.csv beside the video" in origin()
    assert "rename" not in origin()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--focal-px", "abc"), "expected a number, found 'abc'"),
        (("--every", "x"), "expected an integer, found 'x'"),
    ],
)
def test_values_that_are_no_numbers(cli, options, text):
    finished = cli("--mono", "clip.mp4", *options)
    assert finished.status == 2
    assert text in finished.stderr
    assert "Input should be" not in finished.stderr


def test_a_choice_that_does_not_exist(cli, tmp_path):
    finished = cli("export", tmp_path, "--to", "scenario")
    assert finished.status == 2
    assert "openscenario" in finished.stderr
    assert "Value error" not in finished.stderr
