"""Logs of speeds that people own, each with what is right: the speed at moments of the video, or the
sentence that names the choice."""

from __future__ import annotations

import math
import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest

from track_range.foundation.errors import UserError
from track_range.recording.recording import open_recording
from track_range.recording.speed_source import open_speed

NAN = math.nan


@dataclass(frozen=True, kw_only=True)
class Case:
    """A log of the shared folder, the start of the video, and what a run should find."""

    name: str
    log: str
    start: str = "09:30:20"
    speeds_mps: dict[float, float] | None = None  # by second of the video; None = refused
    tolerance_mps: float = 0.01
    sentence: str = ""  # in the notes, or the error


# 5 m/s at 0 s, and 0.25 m/s^2
STEADY = {0.0: 5.0, 1.0: 5.25, 4.0: 6.0}

CASES = (
    Case(name="tel_unit_kilometers_words", log="speed_words.csv", speeds_mps=STEADY),
    Case(name="tel_time_us_1khz", log="blackbox.csv", speeds_mps=STEADY),
    Case(
        name="tel_time_sec_15s",
        log="slow.csv",
        speeds_mps={0.0: 5.0, 1.0: NAN, 5.0: NAN},
    ),
    Case(name="tel_nmea_vtg_before_gga", log="nav.nmea", speeds_mps=STEADY),
    Case(name="tel_obd_fusion", log="fusion.csv", speeds_mps=STEADY, sentence="(mph) in mph"),
    Case(name="tel_kinds_without_name", log="gpslogger.txt", speeds_mps=STEADY),
    Case(name="tel_kinds_without_name", log="candump.log", sentence="a log of a CAN bus"),
    Case(name="tel_gpx_minus1_message", log="app.gpx", speeds_mps=STEADY, sentence="speeds of -1"),
    Case(
        name="tel_ios_minus1",
        log="Location.csv",
        start="09:30:52",
        speeds_mps={0.0: NAN, 2.5: NAN, 5.0: NAN},
        sentence="speeds of -1",
    ),
    Case(
        name="tel_ios_minus1",
        log="Location.csv",
        start="09:30:48",
        speeds_mps={1.0: 12.25},
    ),
    Case(name="tel_reverse_can", log="can.csv", speeds_mps={0.0: -2.0, 4.0: -2.0}),
    Case(
        name="tel_dji_m300_order",
        log="m300.srt",
        speeds_mps={1.0: 15.0, 4.0: 15.0},
        tolerance_mps=0.05,
    ),
    Case(name="tel_date_notations", log="dashes.csv", sentence="order of day and month"),
    Case(
        name="tel_torque",
        log="torque.csv",
        sentence="give --start-utc as 2024-05-12 07:30:20",
    ),
    Case(name="tel_torque", log="torque.csv", start="07:30:20", speeds_mps={0.0: 57 / 3.6}),
    Case(name="tel_phyphox_comma", log="phyphox_comma.csv", speeds_mps={0.123: 13.89}),
    Case(name="tel_ins_ne", log="ins_ne.csv", speeds_mps={0.0: 15.86}, tolerance_mps=0.05),
    Case(
        name="tel_robotcar_turn65",
        log="robotcar_turn65.csv",
        start="09:31:35",
        speeds_mps={0.0: 11.6},
        tolerance_mps=0.1,
    ),
    Case(name="tel_lead", log="lead.csv", speeds_mps={0.0: 50 / 3.6}, sentence="ego_speed_kmh"),
    Case(
        name="tel_lie_mps_is_kmh",
        log="lie_mps_is_kmh.csv",
        speeds_mps={0.0: 15.85},
        tolerance_mps=0.1,
        sentence="not in m/s as stated",
    ),
    Case(name="tel_s_dji_typo", log="s_dji_typo.srt", speeds_mps={1.0: 14.2}, tolerance_mps=0.6),
    Case(name="tel_pos4dec", log="pos4dec.csv", speeds_mps={0.5: 15.4}, tolerance_mps=2.0),
)


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.name}-{case.log}-{case.start}")
def test_log(shared_data: Path, tmp_path: Path, case: Case) -> None:
    shutil.copy(shared_data / "cases" / case.name / case.log, tmp_path)
    start = f"2024-05-12T{case.start}Z"
    video = shared_data / "dashcam/solid_white_right.mp4"
    recording = open_recording(video, focal_px=900.0, start_utc=start, duration_s=5.0)
    log = str(tmp_path / case.log)
    if case.speeds_mps is None:
        with pytest.raises(UserError) as raised:
            open_speed(log, recording)
        assert case.sentence in str(raised.value)
    else:
        source = open_speed(log, recording)
        assert source.ego is not None
        shift_s = 0.0
        if source.offset is not None and source.offset.is_certain:
            shift_s = source.offset.offset_s
        for time_s, speed_mps in case.speeds_mps.items():
            found_mps = source.ego.at(time_s - shift_s)
            assert found_mps == pytest.approx(speed_mps, abs=case.tolerance_mps, nan_ok=True)
        assert any(case.sentence in note for note in (*source.notes, ""))
    recording.close()


def test_pos4dec_is_uncertain(shared_data: Path) -> None:
    """Positions with four decimals are 11 m apart."""
    from track_range.recording.telemetry.sidecars.speed_csv import read_csv

    track = read_csv(shared_data / "cases/tel_pos4dec/pos4dec.csv")
    assert track is not None
    assert track.speed_sigma_mps > 0.9
