"""Files beside a video: a run finds those, and a fleet fetches those."""

import pytest

from track_range.fleet.inputs.clip import Clip
from track_range.recording.telemetry.companions import companions


def test_names_of_a_video_and_of_a_folder_of_images():
    of_video, of_folder = companions("drive.mp4"), companions("data", is_folder=True)
    assert of_video["rig"] == ("drive.rig.yaml", "drive.calib.txt", "rig.yaml", "calib.txt")
    assert of_folder["rig"] == ("data.rig.yaml", "data.calib.txt", "rig.yaml", "calib.txt")
    assert of_video["times"] == of_folder["telemetry"] == ()
    assert {"drive.gpx", "drive.GPX", "drive.nmea"} <= set(of_video["telemetry"])
    assert of_video["speed"] == ("drive.ego_speed.csv", "ego_speed.csv", "oxts/")


@pytest.mark.parametrize("times", ["timestamps.txt", "times.txt", "data.csv"])
def test_fleet_fetches_times_beside_a_folder(tmp_path, times):
    (tmp_path / "left").mkdir()
    (tmp_path / times).write_text("0.0\n0.1\n")
    (tmp_path / "oxts").write_text("a file, no folder")
    assert Clip("a", str(tmp_path / "left")).files() == {
        "left": str(tmp_path / "left"),
        "left_timestamps": str(tmp_path / times),
    }
    (tmp_path / "left.mp4").touch()
    assert set(Clip("a", str(tmp_path / "left.mp4")).files()) == {"left"}
