"""What logs state about their speeds and times: units, signs, starts, orders and dates; and questions
where they do not."""

from __future__ import annotations

import re
import struct
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from tests.support.damaged_text import check_damaged, damaged
from tests.track_range.recording.telemetry.telemetry_files import START_S, part
from track_range.recording.speed_source import _NO_MOTION, _is_table, _named
from track_range.recording.telemetry.checks import usable
from track_range.recording.telemetry.containers.ros_topics import _SPEEDS
from track_range.recording.telemetry.found import named_telemetry
from track_range.recording.telemetry.sidecars.reading import read_sidecar
from track_range.recording.telemetry.sidecars.speed_csv import log_table
from track_range.recording.telemetry.sidecars.time_texts import times_of_texts
from track_range.recording.telemetry.tracks.samples import unit_in
from track_range.recording.telemetry.tracks.signal_choice import ANY_SIGNAL
from track_range.recording.telemetry.tracks.track import TelemetryError, TelemetryTrack

T = np.arange(20.0)
V = 5 + 0.25 * T
START = datetime.fromtimestamp(START_S, UTC)


def read(tmp_path: Path, text: str | bytes, name: str = "log.csv") -> TelemetryTrack:
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    track = read_sidecar(path, "drive.mp4", 20.0)
    assert track is not None
    return usable(track)


def table(header: str, *columns: Any) -> str:
    rows = [",".join(f"{value:.6f}" for value in row) for row in zip(*columns, strict=True)]
    return "\n".join([header, *rows]) + "\n"


@pytest.mark.parametrize(
    ("unit", "texts"),
    [
        (
            "km/h",
            "kilometers per hour;kilometres/hour;speed_kmh;speedkmh;(km / h);kph;speed_km_h;km h-1;k.p.h.",
        ),
        ("mph", "MPH;miles per hour;mi/h;speed_mph;miles_per_hour;m.p.h."),
        ("kn", "knots;kts;speed [kn];nautical miles per hour;nmi/h;NM/h"),
        ("m/s", "meters per second;Meters/second;speed_mps;m/sec;m s-1;speed_m_s"),
        ("cm/s", "cm/s;centimeters per second;cm s-1"),
        ("mm/s", "mm/s;millimeters per second"),
        ("ft/s", "ft/s;feet per second"),
        (None, "speed;m/s^2;m/s²;km/s;miles;lamps;seconds;speed (furlongs);meters;m/min"),
        # multiples of a unit, and values
        (None, "0.1 km/h;1/256 km/h;0.01m/s;km/h * 100;kph_x100;m/s [0.001];(km/h)/10;at 45 km/h"),
    ],
)
def test_units_are_words(unit: str | None, texts: str) -> None:
    assert {text: unit_in(text) for text in texts.split(";")} == dict.fromkeys(
        texts.split(";"), unit
    )


@pytest.mark.parametrize(
    ("heading", "scale"),
    [
        ("time (us)", 1e6),
        ("timestamp_us", 1e6),
        ("elapsed (µs)", 1e6),
        ("Time (msec)", 1e3),
        ("millis", 1e3),
        ("time [nsec]", 1e9),
        ("Elapsed time (sec)", 1.0),
        ("seconds_elapsed", 1.0),
        ("time (min)", 1 / 60),
        ("t_us", 1e6),
        ("timeMs", 1e3),
        ("timestampMs", 1e3),
        ("elapsed_realtime_nanos", 1e9),
        ("time_cs", 100.0),
    ],
)
@pytest.mark.parametrize("step_s", [0.001, 1.0, 60.0])
def test_units_of_times(tmp_path: Path, heading: str, scale: float, step_s: float) -> None:
    track = read(tmp_path, table(f"{heading},speed_mps", T * step_s * scale, V / 100))
    assert track.time_s == pytest.approx(T * step_s, abs=max(1e-6, 1e-6 / scale))
    assert track.clock == "video"
    epoch = read(tmp_path, table(f"{heading},speed_mps", (START_S + T * step_s) * scale, V / 100))
    assert epoch.clock == "utc"
    assert epoch.time_s[0] == pytest.approx(START_S, abs=1e-3)


@pytest.mark.parametrize(
    "heading", ["time (0.1 s)", "time (10 ms)", "timestamp_100ns", "timestamp (ms/10)"]
)
def test_multiples_of_a_unit_of_times_are_asked_for(tmp_path: Path, heading: str) -> None:
    with pytest.raises(TelemetryError, match="a multiple of one"):
        read(tmp_path, table(f"{heading},time,speed_mps", T, T, V))


@pytest.mark.parametrize(("heading", "first_s"), [("elapsed", 3), ("time", 0)])
def test_hours_and_minutes_since_the_start(tmp_path: Path, heading: str, first_s: int) -> None:
    rows = [f"00:00:{first_s + i:02d}.5,{v},0" for i, v in enumerate(V.tolist())]
    track = read(tmp_path, "\n".join([f"{heading},speed_mps,x", *rows]))
    assert (track.clock, track.time_s[0]) == ("video", first_s + 0.5)


def test_values_before_the_header_are_no_units(tmp_path: Path) -> None:
    with pytest.raises(TelemetryError, match="a unit in the heading 'speed'"):
        read(tmp_path, "Max speed,132 km/h\n" + table("time_s,speed,x", T, V, T))


def test_times_without_a_unit_are_noted(tmp_path: Path) -> None:
    track = read(tmp_path, table("time,speed_mps", T * 1000, V))
    assert track.time_s == pytest.approx(T)
    assert "milliseconds" in track.notes[-1]


PREAMBLES = {
    "OBD Fusion": "# StartTime = 05/03/2026 12:00:00.3973 PM\n"
    + table("Time (sec),Vehicle speed (MPH),Engine RPM (RPM)", T, V / 0.44704, T),
    "TrackAddict": "# RaceRender Data: TrackAddict 4\n# Device: phone, speed and time by GPS\n"
    + table('"Time","UTC Time","Speed (Km/h)"', T, START_S + T, V * 3.6),
    "RaceChrono": 'This file is created using RaceChrono.\n\nFormat,3\nSession title,"Speed, time"\n'
    "Created,03/05/2026,10:00\n\ntimestamp,fragment_id,elapsed_time,speed\nunix time,,s,m/s\n"
    ",,,100: gps\n" + table("", START_S + T, 0 * T, T, V)[1:],
    "AiM": '"Format","AiM CSV File"\n"Date","Sunday, May 3, 2026"\n"Time","10:00 AM"\n\n'
    '"Time","GPS Speed","GPS Nsat"\n"s","km/h","#"\n\n' + table("", T, V * 3.6, 0 * T)[1:],
    "a unit": "Speed unit: mph\n" + table("time_s,speed,x", T, V / 0.44704, T),
    "a comment": table("# time_s speed\n# t,speed_kmh", T, V * 3.6),
    "text.txt": table("date time,speed(m/s),x", START_S + T, V, T),
}


def test_start_that_is_not_read_is_noted(tmp_path: Path) -> None:
    notes = read(tmp_path, PREAMBLES["AiM"]).notes
    assert any("10:00 AM" in note and "first frame" in note for note in notes)


def test_a_stated_clock_comes_before_times_since_a_start(tmp_path: Path) -> None:
    track = read(tmp_path, PREAMBLES["TrackAddict"])
    assert (track.clock, track.time_s[0]) == ("utc", START_S)


@pytest.mark.parametrize("name", PREAMBLES)
def test_lines_before_and_below_the_header(tmp_path: Path, name: str) -> None:
    file_name = name if name.endswith("txt") else "log.csv"
    track = read(tmp_path, PREAMBLES[name], file_name)
    assert track.speed_mps == pytest.approx(V, rel=1e-4)
    assert np.diff(track.time_s) == pytest.approx(1.0)
    if name == "OBD Fusion":
        assert (track.clock, track.time_s[0]) == ("local", START_S + 7200)
    assert not _is_table(tmp_path / file_name)


def test_lines_of_a_table_keep_their_numbers(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("# one\n\n" + PREAMBLES["AiM"])
    assert log_table(tmp_path / "log.csv").lines[0] == 10


@pytest.mark.parametrize(
    "text",
    [
        "a drive, at some time\nand at some speed\n",
        '{"time": 1, "speed": 3}\n',
        "May 12 09:30:20 host kernel: time, speed link 100 Mbps\n",
    ],
)
def test_text_without_a_log_is_none(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.log").write_text(text)
    assert read_sidecar(tmp_path / "a.log", "drive.mp4", 20.0) is None


@pytest.mark.parametrize("unit", ["kmh", "mps"])
def test_signs(tmp_path: Path, unit: str) -> None:
    """Reversing is negative; -1 marks a missing speed, if no other speed is negative."""
    mps = {"kmh": 1 / 3.6, "mps": 1.0}[unit]
    reversing = np.where(T < 10, -T / 4, V)
    track = read(tmp_path, table(f"time_s,vehicle_speed_{unit}", T, reversing))
    assert track.speed_mps == pytest.approx(reversing * mps)
    for mark in (-1.0, -999.0):
        marked = np.where(T < 10, V, mark)
        track = read(tmp_path, table(f"time_s,vehicle_speed_{unit}", T, marked))
        assert track.speed_mps == pytest.approx(np.where(T < 10, V * mps, np.nan), nan_ok=True)
        assert f"speeds of {mark:g}" in track.notes[-1]
    forward = table(f"time_s,vel_forward_{unit},vel_left_{unit}", T, reversing, 0 * T)
    assert read(tmp_path, forward).speed_mps == pytest.approx(reversing * mps)
    vehicle = table(f"time_s,vx_{unit},vy_{unit}", T, reversing, 0.01 * T)
    assert read(tmp_path, vehicle).speed_mps == pytest.approx(reversing * mps, abs=0.02)
    turning = table(f"time_s,vx_{unit},vy_{unit}", T, 9 * np.cos(T / 5), 9 * np.sin(T / 5))
    assert read(tmp_path, turning).speed_mps == pytest.approx(9 * mps)


@pytest.mark.parametrize(
    "text",
    [
        "2026-05-13 09:30:20.5",
        "2026-5-13 9:30:20,5",
        "13-05-2026 09:30:20.5",
        "13.05.2026 09:30:20.5",
        "05/13/2026 9:30:20.5 AM",
        "13/05/2026 9:30:20.5 a.m.",
        "2026/05/13 09:30:20.5",
        "2026.05.13 09:30:20.5",
        "20260513 09:30:20.5",
        "13 May 2026 09:30:20.5",
        "May 13, 2026 09:30:20.5",
        "Wed, 13 May 2026 09:30:20.5 GMT",
        "Wed May 13 11:30:20.5 GMT+02:00 2026",
        "2026年05月13日 09:30:20.5",
        "09:30:20.5 13-05-2026",
        "2026-05-13T09:30:20.5000001Z",
    ],
)
def test_dates_of_the_world(text: str) -> None:
    time_s, _ = times_of_texts([text] * 3, Path("log.csv"))
    assert time_s.tolist() == [datetime(2026, 5, 13, 9, 30, 20, 500_000, UTC).timestamp()] * 3


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("12-05-2026 09:30:20", "day and month"),
        ("05/06/2026 09:30", "day and month"),
        ("12. Mai 2026 09:30:20", "found '12. Mai 2026 09:30:20'; write them like 2026"),
        ("26-05-12 09:30:20", "found '26-05-12"),
    ],
)
def test_dates_that_are_asked_for(text: str, word: str) -> None:
    with pytest.raises(TelemetryError, match=word):
        times_of_texts([text] * 3, Path("log.csv"))


def nmea(bursts: str, *, hour: int = 10) -> str:
    """Bursts of sentences, of which each has the letter V (VTG), G (GGA) or Z (ZDA), every
    second."""
    lines: list[str] = []
    for second, speed_mps in enumerate(V.tolist()):
        t = datetime.fromtimestamp(START_S + (hour - 10) * 3600 + second - 5, UTC)
        sentences = {
            "V": f"GPVTG,45.0,T,,M,,N,{3.6 * speed_mps:.3f},K,A",
            "G": f"GPGGA,{t:%H%M%S}.00,4800.0000,N,01100.{second:04d},E,1,10,0.9,512,M,46,M,,",
            "Z": f"GPZDA,{t:%H%M%S}.00,{t:%d,%m,%Y},00,00",
        }
        lines += [f"${sentences[letter]}" for letter in bursts]
    return "\n".join(lines)


@pytest.mark.parametrize("bursts", ["ZVG", "VG", "GV", "VGZ", "ZGV", "GZV", "GVZ"])
@pytest.mark.parametrize("hour", [10, 24])
def test_nmea_without_rmc(tmp_path: Path, bursts: str, hour: int) -> None:
    track = read(tmp_path, nmea(bursts, hour=hour), "nav.nmea")
    assert track.speed_mps == pytest.approx(V, abs=1e-3)
    first_s = START_S + (hour - 10) * 3600 - 5
    expected_s = first_s if "Z" in bursts else first_s % 86400
    assert track.time_s == pytest.approx(expected_s + T)


@pytest.mark.parametrize(("bursts", "cut"), [("VG", "VG" * 20 + "V"), ("GV", "V" + "GV" * 20)])
def test_nmea_that_begins_and_ends_with_a_speed(tmp_path: Path, bursts: str, cut: str) -> None:
    east_m = np.concatenate([[0.0], np.cumsum((V[1:] + V[:-1]) / 2)])
    minutes = np.degrees(east_m / 6_371_008.8 / np.cos(np.radians(48))) * 60
    lines = nmea(bursts).splitlines()
    fixes = [line for line in lines if "GGA" in line]
    for line, minute in zip(fixes, minutes.tolist(), strict=True):
        lines[lines.index(line)] = re.sub(r"01100\.\d+", f"011{minute:010.7f}", line)
    lines = [*lines, lines[-2]] if cut.startswith("VG") else [lines[1], *lines]
    track = read(tmp_path, "\n".join(lines), "nav.nmea")
    assert track.speed_mps == pytest.approx(V, abs=1e-3)


def test_nmea_with_few_speeds_in_knots(tmp_path: Path) -> None:
    lines = nmea("GV").replace("N,", "N,;").splitlines()
    speeds = [f"$GPVTG,45.0,T,,M,{v * 3600 / 1852:.3f},N,,,A" for v in V.tolist()]
    text = nmea("G").splitlines()
    lines = [
        line
        for fix, speed in zip(text, speeds, strict=True)
        for line in (fix, speed, *(fix.replace(".00,4800", f".{k}0,4800") for k in (2, 4, 6, 8)))
    ]
    track = read(tmp_path, "\n".join(lines), "nav.nmea")
    assert track.speed_mps == pytest.approx(V, abs=1e-3)


def test_vbo_without_a_unit_is_noted(tmp_path: Path) -> None:
    rows = "\n".join(f"1000{i:02d}.00 0 0 {3.6 * v:.3f}" for i, v in enumerate(V.tolist()))
    names = "[header]\nvelocity\n[column names]\ntime lat long velocity\n[data]\n"
    track = read(tmp_path, names + rows, "a.vbo")
    assert track.speed_mps == pytest.approx(V, abs=1e-3)
    assert "km/h is assumed" in track.notes[0]


def srt(*texts: str) -> str:
    return "\n\n".join(
        f"{i + 1}\n00:00:{i:02d},000 --> 00:00:{i + 1:02d},000\n{text}"
        for i, text in enumerate(texts)
    )


@pytest.mark.parametrize(
    "form",
    [
        "50 km/h | {kmh:.1f} km/h",
        "{kmh:.1f} km/h ({mph:.1f} mph)",
        "{odd:.1f} km/h  {kmh:.1f} km/h  lat: 48.0 lon: {lon:.7f}",
    ],
)
def test_two_speeds_in_a_subtitle(tmp_path: Path, form: str) -> None:
    east_m = np.concatenate([[0.0], np.cumsum((V[1:] + V[:-1]) / 2)])
    lon = 11 + np.degrees(east_m / 6_371_008.8 / np.cos(np.radians(48)))
    texts = [
        form.format(kmh=3.6 * v, mph=v / 0.44704, odd=90 + 2 * v, lon=x)
        for v, x in zip(V.tolist(), lon.tolist(), strict=True)
    ]
    assert read(tmp_path, srt(*texts), "a.srt").speed_mps == pytest.approx(V, abs=0.03)


@pytest.mark.parametrize(
    ("form", "has_note"),
    [
        ("Speed: {v:.2f} m/s Climb: {t} m/s", False),
        ("Speed: {v:.2f} m/s, 50 km/h", True),
        ("HOME(N: 48.0, E: 11.5) GPS(N: 48.0, E: {lon:.7f}) {v:.2f} m/s", False),
    ],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_signs_and_other_values_in_a_subtitle(
    tmp_path: Path, form: str, has_note: bool, sign: int
) -> None:
    degrees = np.degrees(np.cumsum(V - 0.125) / 6_371_008.8 / np.cos(np.radians(48)))
    texts = [
        form.format(v=sign * v, t=t / 2, lon=11 + x) for v, t, x in zip(V, T, degrees, strict=True)
    ]
    track = read(tmp_path, srt(*texts), "a.srt")
    assert track.speed_mps == pytest.approx(sign * V)
    assert any("of the speeds" in note for note in track.notes) == has_note


@pytest.mark.parametrize("form", ["{0} km/h {1} km/h", "30 km/h 50 km/h"])
def test_two_possible_speeds_are_a_question(tmp_path: Path, form: str) -> None:
    texts = [form.format(40 + i, 80 - i) for i in range(10)]
    with pytest.raises(TelemetryError, match="one speed of the car in each subtitle, found"):
        read(tmp_path, srt(*texts), "a.srt")


@pytest.mark.parametrize(
    ("form", "has_note"),
    [
        ("GPS({lat:.7f},{lon:.7f},0.0M)", False),
        ("GPS({lon:.7f},{lat:.7f},20)", True),
        ("GPS({lat:.7f},{lon:.7f},20) H.S 15.0m/s", False),
        ("GPS({lon:.7f},{lat:.7f},20) H.S 15.0m/s", False),
        ("GPS({lat:.7f},{far:.7f},20)", False),
    ],
)
def test_order_of_dji_positions(tmp_path: Path, form: str, has_note: bool) -> None:
    step_deg = np.degrees(15 / 6_371_008.8 / np.cos(np.radians(53.3)))
    texts = [form.format(lat=53.3, lon=-6.2 + step_deg * t, far=120 + step_deg * t) for t in T]
    track = read(tmp_path, srt(*texts), "a.srt")
    assert track.speed_mps == pytest.approx(15.0, abs=0.01)
    assert np.nanmedian(track.latitude_deg) == pytest.approx(53.3)
    assert any("does not state the order" in note for note in track.notes) == has_note


def test_dji_order_by_speeds_where_the_other_one_does_not_move(tmp_path: Path) -> None:
    """Of two orders, one has no speeds to compare with; the other one agrees with the stated ones."""
    step_deg = np.degrees(15 / 6_371_008.8)
    texts = [f"GPS(89.9, {6.2 + step_deg * t:.7f}, 20), H.S 15.00m/s" for t in T]
    track = read(tmp_path, srt(*texts), "a.srt")
    assert np.nanmedian(track.latitude_deg) == pytest.approx(6.2, abs=0.1)
    assert not any("does not state the order" in note for note in track.notes)


def virb() -> bytes:
    """A FIT file with messages gps_metadata (160) at 10 Hz, whose timestamps count since the start
    of the camera (FIT protocol 2.0)."""
    fields = ((253, 4, 0x86), (0, 2, 0x84), (1, 4, 0x85), (2, 4, 0x85), (4, 4, 0x86), (6, 4, 0x86))
    body = struct.pack("<BBBHB", 0x40, 0, 0, 160, len(fields)) + b"".join(
        struct.pack("<BBB", *field) for field in fields
    )
    for tick in range(100):
        system_ms = 12_340 + 100 * tick
        utc_s = int(START_S - 631_065_600 + tick / 10)
        north_m = 5 * tick / 10 + 0.125 * (tick / 10) ** 2
        latitude_deg = 48 + np.degrees(north_m / 6_371_008.8)
        semicircles = round(latitude_deg * 2**31 / 180), round(11 * 2**31 / 180)
        times = *divmod(system_ms, 1000), *semicircles
        body += struct.pack("<BIHiiII", 0, *times, round(1000 * (5 + tick / 40)), utc_s)
    return struct.pack("<BBHI4sH", 14, 0x20, 2132, len(body), b".FIT", 0) + body + b"\0\0"


def test_virb(tmp_path: Path) -> None:
    track = read(tmp_path, virb(), "a.fit")
    assert track.time_s == pytest.approx(START_S + np.arange(100) / 10, abs=1e-3)
    assert track.speed_mps == pytest.approx(5 + np.arange(100) / 40, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "text", "word"),
    [
        ("candump.log", "(1715506220.000000) can0 1F5#01F40000\n", "CAN bus"),
        ("a.trc", ";$FILEVERSION=1.1\n", "CAN bus"),
        ("log.csv", "%DataLog%\nDataLogVersion : 1.1\nChannel : RPM\n10:00:00,1,2\n", "Haltech"),
    ],
)
def test_kinds_by_their_first_line(tmp_path: Path, name: str, text: str, word: str) -> None:
    (tmp_path / name).write_text(text)
    assert not _is_table(tmp_path / name)
    with pytest.raises(TelemetryError, match=word):
        named_telemetry(tmp_path / name, [part()])


@pytest.mark.parametrize(
    ("frame", "is_signed"),
    [("base_link", True), ("imu", True), ("odom", False), ("gps", False), ("", False)],
)
def test_sign_of_velocities_by_their_frame(frame: str, is_signed: bool) -> None:
    linear = SimpleNamespace(x=-3.0, y=0.1, z=0.0)
    twist = SimpleNamespace(linear=linear)
    odometry = SimpleNamespace(twist=SimpleNamespace(twist=twist), child_frame_id=frame)
    stamped = SimpleNamespace(twist=twist, header=SimpleNamespace(frame_id=frame))
    for kind, message in (
        ("nav_msgs/msg/Odometry", odometry),
        ("geometry_msgs/msg/TwistStamped", stamped),
    ):
        (speed_mps,) = _SPEEDS[kind](message)
        assert speed_mps == pytest.approx(-3.0 if is_signed else 3.0, abs=0.01)
    linear.y = 4.0  # along another axis
    assert _SPEEDS["nav_msgs/msg/Odometry"](odometry) == (5.0,)


def test_folder_of_a_bag_as_speed(tmp_path: Path) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store, kind = get_typestore(Stores.ROS2_HUMBLE), "geometry_msgs/msg/TwistStamped"
    types = store.types
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topic = writer.add_connection("/vel", kind, typestore=store)
        for t, v in zip(T.tolist(), V.tolist(), strict=True):
            # nanoseconds that no clock states: the time of recording is used
            time = types["builtin_interfaces/msg/Time"](int(START_S + t), 2_000_000_000)
            vector = types["geometry_msgs/msg/Vector3"]
            twist = types["geometry_msgs/msg/Twist"](vector(v, 0.0, 0.0), vector(0.0, 0.0, 0.0))
            message = types[kind](types["std_msgs/msg/Header"](time, "gps"), twist)
            stored = bytes(store.serialize_cdr(message, kind))
            writer.write(topic, int((START_S + t) * 1e9), stored)
    source = _named(str(tmp_path / "bag"), [part()], lambda: _NO_MOTION, ANY_SIGNAL)
    assert source.ego is not None
    assert source.ego.time_s == pytest.approx(T)
    assert source.ego.speed_mps == pytest.approx(V)


DAMAGED = {
    **{f"{name[:2]}.csv": text.encode() for name, text in PREAMBLES.items()},
    "a.nmea": nmea("ZVG").encode(),
    "a.srt": srt(*(f"GPS(53.3,-6.2{i},0.0M) 50 km/h {i} km/h" for i in range(12))).encode(),
    "a.fit": virb(),
    "a.log": PREAMBLES["AiM"].encode(),
}


@pytest.mark.parametrize("name", DAMAGED)
@settings(
    deadline=None, max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_damaged_logs(tmp_path: Path, name: str, data: st.DataObject) -> None:
    content = DAMAGED[name]
    damaged_content = data.draw(damaged(content[: len(content) // 2]))
    check_damaged(lambda path: named_telemetry(path, [part()]), tmp_path / name, damaged_content)
