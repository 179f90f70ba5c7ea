"""Telemetry that ExifTool finds. The program of these tests is a stand-in with output in the real
one's JSON format."""

import json
import os

import pytest

from tests.track_range.recording.telemetry.telemetry_files import part
from track_range.recording.telemetry.exiftool import read_with_exiftool, track_of_records
from track_range.recording.telemetry.found import candidates, named_telemetry
from track_range.recording.telemetry.tracks.track import TelemetryError

RECORDS = {
    "SourceFile": "clip.avi",
    **{
        f"Doc{i + 1}:{tag}": value
        for i in range(12)
        for tag, value in {
            "SampleTime": i * 1.001,
            "SampleDuration": 1.001,
            "GPSDateTime": f"2026:05:03 10:00:{i:02d}Z",
            "GPSLatitude": 50 + i * 8.99e-5,
            "GPSLongitude": 8.0,
            "GPSSpeed": 36.0,
            "GPSSpeedRef": "K",
            "GPSTrack": 0.0,
        }.items()
    },
}
"""Output for a drive to the north at 10 m/s."""


@pytest.fixture
def program(tmp_path, monkeypatch):
    """Puts a stand-in for ExifTool onto the PATH that runs these lines of sh."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")

    def install(lines):
        (folder / "exiftool").write_text(f"#!/bin/sh\n{lines}\n")
        (folder / "exiftool").chmod(0o755)

    return install


@pytest.fixture
def video(tmp_path):
    """A file that no reader of telemetry knows."""
    path = tmp_path / "clip; touch x.avi"
    path.write_bytes(b"RIFF" + bytes(100))
    return path


def printing(content, then="exit 0"):
    return f"cat <<'END'\n{json.dumps([content])}\nEND\n{then}"


def test_file_of_an_unknown_format(program, video, tmp_path):
    program(f'echo "$@" > {tmp_path}/arguments\n' + printing(RECORDS, "exit 1"))
    (telemetry,) = candidates([part(video, duration_s=12.0)])
    assert telemetry.notes == ()
    assert telemetry.track.source == f"ExifTool in {video.name}"
    assert telemetry.track.speed_mps == pytest.approx([10.0] * 12)
    assert telemetry.track.time_s[:2] == pytest.approx([0.0, 1.001])
    arguments = (tmp_path / "arguments").read_text()
    assert arguments.startswith("-ee3 -n -j -G3 -api largefilesupport=1 ")
    assert arguments.endswith(f"{video}\n")
    assert named_telemetry(video, [part(video, duration_s=12.0)]).track is not None


def test_without_the_program(video, monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert read_with_exiftool(video) is None
    assert list(candidates([part(video)])) == []


@pytest.mark.parametrize(
    "lines", ["exit 1", "echo '['", "echo '[{}]'", "echo '[3]'", 'echo \'[{"Doc1:GPSSpeed":"x"}]\'']
)
def test_output_without_telemetry(program, video, lines):
    program(lines)
    telemetry = read_with_exiftool(video)
    assert telemetry is None or not (telemetry.speed_mps >= 0).any()


def test_program_that_hangs(program, video):
    program("exec sleep 30")
    with pytest.raises(TelemetryError, match="did not finish"):
        read_with_exiftool(video, timeout_s=0.3)


@pytest.mark.parametrize(
    ("unit", "mps"), [("K", 10 / 3.6), ("M", 4.4704), ("N", 5.1444), (None, 10 / 3.6)]
)
def test_units(unit, mps):
    given = {
        "Doc1:SampleTime": 0,
        "Doc1:GPSSpeed": 10,
        "Doc1:GPSLatitude": 50,
        "Doc1:GPSLongitude": 8,
    }
    telemetry = track_of_records(given | ({"Doc1:GPSSpeedRef": unit} if unit else {}))
    assert telemetry.speed_mps == pytest.approx([mps], rel=1e-4)
    assert telemetry.unit == (unit and "m/s")


def test_records_of_one_sample_are_spread_over_its_duration():
    given = {"Doc1:SampleTime": 2.0, "Doc1:SampleDuration": 1.0, "Doc1:GPSSpeed": 1}
    given |= {f"Doc1-{i}:GPSSpeed": i + 1 for i in (1, 2, 3)}
    assert track_of_records(given).time_s.tolist() == [2.0, 2.25, 2.5, 2.75]


def test_times_of_the_receiver():
    given = {"Doc1:GPSSpeed": 1, "Doc1:GPSDateTime": "2026:05:03 10:00:00.500Z"}
    assert track_of_records(given).clock == "utc"
    assert track_of_records(given).time_s % 60 == 0.5
    assert track_of_records(given | {"Doc1:GPSDateTime": "2026:05:03 10:00:00"}).clock == "local"


def test_clock_that_was_never_set():
    given = {"Doc1:SampleTime": 0, "Doc1:GPSSpeed": 1, "Doc1:GPSDateTime": "1970:01:02 00:00:00Z"}
    assert track_of_records(given).utc_s.tolist() == [86_400.0]


@pytest.mark.parametrize(
    "void", [{"GPSLatitude": 0, "GPSLongitude": 0}, {"GPSMeasureMode": 0}, {"GPSStatus": "V"}]
)
def test_record_without_a_fix(void):
    tags = {"SampleTime": 0, "GPSSpeed": 10, "GPSLatitude": 50, "GPSLongitude": 8} | void
    telemetry = track_of_records({f"Doc1:{tag}": value for tag, value in tags.items()})
    assert (telemetry.speed_mps != telemetry.speed_mps).all()


def test_positions_only():
    given = {key: value for key, value in RECORDS.items() if "Speed" not in key}
    assert track_of_records(given).speed_mps == pytest.approx([10.0] * 11, rel=0.01)
