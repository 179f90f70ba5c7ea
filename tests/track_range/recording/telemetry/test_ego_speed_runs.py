"""Runs with telemetry beside the video: the speed, its notes, and no positions in the results."""

import json
import sys
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.track_range.recording.telemetry.telemetry_files import (
    LATITUDE,
    LONGITUDE,
    START_S,
    gpx_text,
    rmc,
)
from track_range.fleet.inputs.clip import Clip
from track_range.recording.recording import open_recording
from track_range.recording.speed_source import open_speed
from track_range.recording.telemetry.sidecars.reading import read_sidecar
from track_range.recording.telemetry.speed_files import EgoSpeedError
from track_range.recording.telemetry.tracks.signal_choice import SignalChoice
from track_range.recording.telemetry.tracks.track import TelemetryError
from track_range.stereo.geometry.mounting import Mounting

TIMES_S = [0.2 * i for i in range(16)]
N = len(TIMES_S)
BOXES = "".join(
    f"{i} 1 Car 0 0 0 10 10 40 40 -1 -1 -1 -1000 -1000 -1000 -10 0.9\n" for i in range(N)
)
DATE = datetime.fromtimestamp(START_S, UTC).isoformat()


@pytest.fixture
def video(tmp_path, film):
    """A video of 3 s and recorded boxes."""
    (tmp_path / "in").mkdir()
    film(tmp_path / "in/drive.mp4", TIMES_S)
    (tmp_path / "in/boxes.txt").write_text(BOXES)
    return tmp_path / "in/drive.mp4"


def run(cli, video, *options, out="out", succeeds=True):
    """Summary, printed text and rows of a run."""
    folder = video.parents[1] / out
    inputs = (
        "--mono",
        video,
        "--detections",
        video.parent / "boxes.txt",
        "--focal-px",
        60,
        "--start-utc",
        DATE,
    )
    status, printed, errors = cli(
        *inputs, "--lanes", "off", "--no-overlay", *options, "--out", folder
    )
    if not succeeds:
        assert status == 1
        return errors
    assert status == 0, errors
    summary = json.loads((folder / "summary.json").read_text())
    rows = [line.split(",") for line in (folder / "tracks.csv").read_text().splitlines()]
    column = rows[0].index("ego_mps")
    return summary, printed + errors, [row[column] for row in rows[1:]]


def test_nothing_found(cli, video):
    summary, printed, speeds = run(cli, video)
    assert summary["ego_speed"] is None
    assert set(speeds) == {""}
    assert "The ego speed is unknown: no frame shows it by the motion of the road" in printed
    assert "The ego speed comes" not in printed
    without = run(cli, video, "--ego-speed", "off", out="off")
    assert without[2] == speeds
    assert (video.parents[1] / "out/tracks.csv").read_bytes() == (
        video.parents[1] / "off/tracks.csv"
    ).read_bytes()


def test_gpx_beside_the_video(cli, video):
    (video.parent / "drive.gpx").write_text(
        gpx_text([8.0] * 10, start_s=START_S - 2, field="speed")
    )
    summary, printed, speeds = run(cli, video)
    assert summary["ego_speed"]["source"] == "drive.gpx"
    assert summary["ego_speed"]["median_mps"] == 8.0
    assert summary["ego_speed"]["coverage"] == 1.0
    assert set(speeds) == {"8.000"}
    assert "The ego speed comes from drive.gpx" in printed
    assert summary["ego_speed"]["offset_s"] is None


def test_region_of_the_positions(cli, video):
    assert run(cli, video, out="without")[0]["region"] == "unknown"
    (video.parent / "drive.gpx").write_text(
        gpx_text([8.0] * 10, start_s=START_S - 2, field="speed")
    )
    assert run(cli, video, out="europe")[0]["region"] == "europe"
    assert run(cli, video, "--region", "east-asia", out="given")[0]["region"] == "east-asia"
    assert run(cli, video, "--region", "unknown", out="unknown")[0]["region"] == "unknown"


def test_order_of_preference(video):
    def source():
        with closing(open_recording(video, focal_px=60, start_utc=DATE)) as recording:
            return open_speed("auto", recording).ego

    (video.parent / "drive.gpx").write_text(
        gpx_text([8.0] * 10, start_s=START_S - 2, field="speed")
    )
    (video.parent / "drive.NMEA").write_text("\n".join(rmc(i, 10) for i in range(5)))
    assert source().source == "drive.gpx"
    (video.parent / "ego_speed.csv").write_text("time_s,speed_mps\n0,5\n10,5\n")
    assert source().source == "ego_speed.csv"
    (video.parent / "ego_speed.csv").unlink()
    (video.parent / "drive.gpx").write_text("broken")
    assert source().source == "drive.NMEA"
    assert source().at(1.0) == pytest.approx(5.144, abs=1e-3)


def test_signal_of_a_log_that_is_not_there(video):
    choice = SignalChoice(name="VehicleSpeed")
    with closing(open_recording(video, focal_px=60)) as recording:
        assert "--speed-channel and --dbc are not used" in " ".join(
            open_speed("auto", recording, None, choice).notes
        )
        (video.parent / "ego_speed.csv").write_text("time_s,speed_mps\n0,5\n10,5\n")
        source = open_speed("auto", recording, None, choice)
        assert "--speed-channel and --dbc are not used" in " ".join(source.notes)
        assert source.ego.at(0.0) == 5.0
        assert open_speed("off", recording, None, choice).notes == ()


def test_negative_speed_of_a_drive_is_that_of_a_camera_that_looks_back(video):
    table = video.parent / "ego_speed.csv"
    with closing(open_recording(video, focal_px=60)) as recording:
        table.write_text("time_s,speed_mps,speed_over_ground_mps\n0,-5,5\n2,-5,5\n4,1,1\n")
        (note,) = open_speed("auto", recording).notes
        assert "--mount" in note
        (note,) = open_speed("-18", recording).notes
        assert "--mount" in note
        backwards = open_speed("auto", recording, Mounting(yaw_deg=180.0))
        assert (backwards.notes, backwards.ego.at(1.0)) == ((), 5.0)
        table.write_text("time_s,speed_mps\n0,-1\n2,5\n4,5\n")  # out of a parking space
        assert open_speed("auto", recording).notes == ()


@pytest.mark.parametrize(
    ("name", "text", "word"),
    [
        ("drive.gpx", gpx_text([8.0] * 10, start_s=START_S + 86400 * 3), "another day"),
        ("drive.gpx", gpx_text([8.0] * 20, field="speed", factor=1.4), "contradict"),
        ("drive.gpx", gpx_text([8.0] * 20, field="speed", factor=90), "contradict"),
        ("drive.gpx", "not XML", "XML"),
        ("drive.nmea", "\n".join(rmc(i, "", status="V") for i in range(5)), "no fix"),
        ("drive.nmea", "\n".join([*(rmc(i, 10) for i in range(3)), rmc(3, 10, hour=13)]), "clock"),
        ("drive.csv", "time_s,speed\n0,10\n9,10\n", "unit"),
        ("drive.csv", "time_s,speed_kmh\n0,700\n9,700\n", "432"),
        ("drive.srt", "1\n00:00:00,000 --> 00:00:09,000\nspeed: 50\n", "unit"),
        ("ego_speed.csv", "frame,x\n0,1\n", "columns"),
    ],
)
def test_unusable_telemetry_is_a_note(video, name, text, word):
    path = video.parent / name
    path.write_text(text)
    with closing(open_recording(video, focal_px=60, start_utc=DATE)) as recording:
        source = open_speed("auto", recording)
        assert source.ego is None
        assert len(source.notes) == 1
        assert name in source.notes[0]
        assert word in source.notes[0]
        assert len(source.notes[0].replace(str(path), "")) <= 300
        with pytest.raises((TelemetryError, EgoSpeedError), match=name):
            open_speed(str(path), recording)


def test_unusable_telemetry_does_not_stop_a_run(cli, video):
    (video.parent / "drive.gpx").write_text("not XML")
    summary, printed, speeds = run(cli, video)
    assert summary["ego_speed"] is None
    assert set(speeds) == {""}
    assert "Telemetry is not used" in printed
    assert "The ego speed comes" not in printed
    errors = run(cli, video, "--ego-speed", video.parent / "drive.gpx", succeeds=False)
    assert "drive.gpx" in errors
    assert "Traceback" not in errors


def test_camera_at_rest_against_the_telemetry(cli, tmp_path, film):
    rng = np.random.default_rng(0)
    image = cv2.resize(
        rng.integers(0, 255, (30, 40, 3), np.uint8), (320, 240), interpolation=cv2.INTER_CUBIC
    )
    (tmp_path / "in").mkdir()
    video = film(tmp_path / "in/drive.mp4", TIMES_S, images=[image] * N)
    (tmp_path / "in/boxes.txt").write_text(BOXES)
    (tmp_path / "in/drive.csv").write_text(
        "time_s,speed_kmh,note\n" + "".join(f"{i},120,\n" for i in range(5))
    )
    summary, _, speeds = run(cli, video)
    # of the images, whose near points have to stay in place for 0.5 s
    assert "the road in the images" in summary["ego_speed"]["source"]
    first = speeds.index("0.000")
    assert 0.4 < TIMES_S[first] < 0.7
    assert speeds == [""] * first + ["0.000"] * (N - first)
    assert any("120 km/h while the camera is at rest" in note for note in summary["notes"])


def texts_of(folder: Path) -> str:
    return "".join(
        path.read_bytes().decode("latin-1") for path in folder.rglob("*") if path.is_file()
    )


def test_positions_only_if_requested(cli, video):
    (video.parent / "drive.gpx").write_text(
        gpx_text([8.0] * 10, start_s=START_S - 2, field="speed")
    )
    run(cli, video, "--write", "csv,mot,parquet,kitti", out="plain")
    shown = texts_of(video.parents[1] / "plain")
    assert not (video.parents[1] / "plain/telemetry.csv").exists()
    for position in (f"{LATITUDE:.3f}", f"{LONGITUDE:.3f}", "latitude", "longitude"):
        assert position not in shown
    run(cli, video, "--keep-gps", out="kept")
    lines = (video.parents[1] / "kept/telemetry.csv").read_text().splitlines()
    assert lines[0] == "time_s,latitude_deg,longitude_deg,speed_mps,course_deg"
    assert [float(line.split(",")[0]) for line in lines[1:]] == [-1.0, 0.0, 1.0, 2.0, 3.0, 4.0]
    assert lines[1].split(",")[2] == f"{LONGITUDE:.7f}"
    run(cli, video, out="kept")
    assert not (video.parents[1] / "kept/telemetry.csv").exists()


def test_positions_without_telemetry(cli, video):
    summary, _, _ = run(cli, video, "--keep-gps")
    assert any("--keep-gps" in note for note in summary["notes"])
    assert not (video.parents[1] / "out/telemetry.csv").exists()


def test_positions_and_anonymization(cli, video):
    status, _, errors = cli("--mono", video, "--keep-gps", "--anonymize")
    assert status == 2
    assert "--keep-gps" in errors


def test_missing_package(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pynmea2", None)
    (tmp_path / "a.nmea").write_text(rmc(0, 10))
    with pytest.raises(TelemetryError, match="pip install"):
        read_sidecar(tmp_path / "a.nmea", "a.mp4", 0.0)


def test_telemetry_belongs_to_a_clip_of_a_fleet(video):
    clip = Clip("a", str(video))
    assert set(clip.files()) == {"left"}
    (video.parent / "drive.gpx").write_text("")
    (video.parent / "ego_speed.csv").write_text("")
    files = clip.files()
    assert [Path(files[f"telemetry_{i}"]).name for i in range(2)] == ["ego_speed.csv", "drive.gpx"]
    assert set(Clip("a", str(video), settings={"ego_speed": "off"}).files()) == {"left"}
