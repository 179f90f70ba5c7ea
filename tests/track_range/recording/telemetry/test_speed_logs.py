"""Logs of one simulated drive in the layouts of loggers and apps: the right column, unit and time,
or a refusal."""

import struct
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from tests.support.damaged_text import check_damaged, damaged
from tests.track_range.recording.telemetry.telemetry_files import START_S, part
from track_range.recording.speed_source import (
    SpeedSource,
    _checked,
    _is_table,
    open_ego_speed,
)
from track_range.recording.telemetry.checks import usable
from track_range.recording.telemetry.found import named_telemetry
from track_range.recording.telemetry.sidecars.nmea import read_nmea
from track_range.recording.telemetry.sidecars.reading import read_sidecar
from track_range.recording.telemetry.speed_files import EgoSpeedError
from track_range.recording.telemetry.tracks.track import TelemetryError
from track_range.recording.telemetry.video_clock import on_video_clock
from track_range.stereo.speed.ego_speed import EgoSpeed

T = np.arange(60.0)
V = 14 + 2 * np.sin(T / 8)
COURSE = np.radians(30 + T)
NORTH, EAST = (np.cumsum(np.append(0, (V * f(COURSE))[:-1])) for f in (np.cos, np.sin))
LAT = 48.1 + np.degrees(NORTH / 6_371_008.8)
LON = 11.5 + np.degrees(EAST / 6_371_008.8 / np.cos(np.radians(48.1)))
DATES = [datetime.fromtimestamp(START_S, UTC) + timedelta(seconds=t) for t in T.tolist()]
POSITIONS = {"latitude": [f"{x:.7f}" for x in LAT], "longitude": [f"{x:.7f}" for x in LON]}
EPOCH = {"timestamp": [f"{START_S + t:.3f}" for t in T.tolist()]}
ISO = {"time": [date.isoformat() for date in DATES]}


def cells(values, decimals=4):
    return [f"{value:.{decimals}f}" for value in values]


def table(columns, separator=","):
    if separator != ",":
        columns = {
            name: [cell.replace(".", ",") for cell in values] for name, values in columns.items()
        }
    rows = [columns, *zip(*columns.values(), strict=True)]
    return "\n".join(separator.join(row) for row in rows)


def read(tmp_path, text, name="log.csv"):
    path = tmp_path / name
    path.write_bytes(text) if isinstance(text, bytes) else path.write_text(text)
    track = read_sidecar(path, "drive.mp4", 60.0)
    assert track is not None
    return usable(track)


def check(track, *, tolerance=0.02):
    """The speed of a track is that of the drive, which starts at START_S in the clock of the track,
    if it has one."""
    start_s = (
        START_S if track.clock != "video" else track.time_s[0] - (0 if track.has_own_speed else 0.5)
    )
    expected = np.interp(track.time_s - start_s, T, V)
    assert len(track) >= 55
    assert track.speed_mps == pytest.approx(expected, rel=tolerance, abs=0.1)


NORTH_MPS, EAST_MPS = V * np.cos(COURSE), V * np.sin(COURSE)
LEAD = np.full(60, 26.4)
LAYOUTS = {
    "ins": EPOCH
    | POSITIONS
    | {"velocity_north (m/s)": cells(NORTH_MPS), "velocity_east (m/s)": cells(EAST_MPS)},
    "ins without unit": EPOCH
    | POSITIONS
    | {"vel_n": cells(NORTH_MPS), "vel_e": cells(EAST_MPS), "vel_d": cells(V * 0)},
    "vx vy vz": EPOCH
    | {"vx_mps": cells(NORTH_MPS), "vy_mps": cells(EAST_MPS), "vz_mps": cells(0 * V)},
    "twist": EPOCH
    | {
        "twist.linear.x (m/s)": cells(V),
        "twist.linear.y (m/s)": cells(0 * V),
        "twist.angular.z": cells(V),
    },
    "forward": EPOCH | {"forward_velocity_mps": cells(V), "lateral_velocity_mps": cells(V * 0.01)},
    "microseconds": {
        "timestamp": [f"{(START_S + t) * 1e6:.0f}" for t in T.tolist()],
        "speed_mps": cells(V),
    },
    "lead first": EPOCH
    | {
        "front_vehicle_speed_kmh": cells(LEAD),
        "relative speed (m/s)": cells(V),
        "ego_speed_kmh": cells(V * 3.6),
    },
    "lead and object": EPOCH
    | {"object_speed_mps": cells(LEAD), "speed_limit_kmh": cells(LEAD), "speed_mps": cells(V)},
    "GPS and OBD": EPOCH
    | {"GPS Speed (km/h)": cells(V * 3.5), "Speed (OBD)(km/h)": cells(V * 3.6)},
    "evidence": EPOCH
    | POSITIONS
    | {"ego_speed_mps": cells(LEAD * 0 + 3), "gps_speed_kmh": cells(V * 3.6)},
    "wrong unit": EPOCH | POSITIONS | {"speed_mps": cells(V * 3.6)},
    "no unit": EPOCH | POSITIONS | {"speed": cells(V / 0.44704)},
    "no speed": EPOCH | POSITIONS,
    "milliseconds": {
        "elapsed": [f"{1000 * t:.0f}" for t in T.tolist()],
        "speed_kmh": cells(V * 3.6),
    },
    "Torque": {
        "GPS Time": [date.strftime("%a %b %d %H:%M:%S GMT+00:00 %Y") for date in DATES],
        "Device Time": [date.strftime("%d-%b-%Y %H:%M:%S.000") for date in DATES],
        "Longitude": POSITIONS["longitude"],
        "Latitude": POSITIONS["latitude"],
        "GPS Speed (Meters/second)": cells(V),
        "Speed (OBD)(km/h)": cells(V * 3.6, 0),
    },
    "AM and PM": {
        "Date": [date.strftime("%m/%d/%Y %I:%M:%S %p") for date in DATES],
        "Speed (mph)": cells(V / 0.44704),
    },
    "date and time": {
        "date": [date.strftime("%d.%m.%Y") for date in DATES],
        "time": [date.strftime("%H:%M:%S.000") for date in DATES],
        "speed_kmh": cells(V * 3.6),
    },
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_layouts_of_tables(tmp_path, name):
    track = read(tmp_path, table(LAYOUTS[name]))
    check(track, tolerance=0.05 if name == "Torque" else 0.02)
    assert track.notes or not track.has_own_speed


def test_the_note_names_column_unit_and_reason(tmp_path):
    for name, expected in {
        "evidence": "the speed is gps_speed_kmh in km/h, as stated and as the positions show; not "
        "ego_speed_mps.",
        "wrong unit": "the speed is speed_mps in km/h, as the positions show, not in m/s as "
        "stated.",
        "GPS and OBD": (
            "the speed is speed (obd)(km/h) in km/h, as stated; no positions confirm the unit; not "
            "gps speed (km/h)."
        ),
    }.items():
        assert read(tmp_path, table(LAYOUTS[name])).notes[0] == expected


@pytest.mark.parametrize("separator", [";", "\t"])
def test_decimal_commas(tmp_path, separator):
    columns = {
        "Time (s)": cells(T),
        "Latitude (°)": cells(LAT, 9),
        "Longitude (°)": cells(LON, 9),
        "Velocity (m/s)": cells(V),
    }
    check(read(tmp_path, table(columns, separator)))


def test_one_value_per_row(tmp_path):
    """Car Scanner: SECONDS since midnight, one PID per row."""
    midnight_s = START_S % 86_400
    rows = ['"SECONDS";"PID";"VALUE";"UNITS";"LATITUDE";"LONGTITUDE";']
    for t, v, lat, lon in zip(T, V, LAT, LON, strict=True):
        for pid, value, unit in (
            ("Average speed", 9, "km/h"),
            ("Engine RPM", 1500, "rpm"),
            ("Vehicle speed", v * 3.6, "km/h"),
        ):
            rows.append(f'"{midnight_s + t}";"{pid}";"{value}";"{unit}";"{lat:.7f}";"{lon:.7f}";')
    track, _ = on_video_clock(read(tmp_path, "\n".join(rows)), part(duration_s=60.0))
    assert track.time_s[0] == pytest.approx(0.0)
    assert track.speed_mps == pytest.approx(V, rel=0.01)


REFUSED = {
    "one component": (
        EPOCH | {"velocity_east (m/s)": cells(V)},
        "only the component 'velocity_east .* add the rest",
    ),
    "only a lead car": (EPOCH | {"lead_speed_kmh": cells(V)}, None),
    "two that differ": (
        EPOCH | {"speed_a_kmh": cells(V), "speed_b_kmh": cells(3 * V)},
        "which differ",
    ),
    "no unit, no positions": (EPOCH | {"speed": cells(V)}, "expected a unit"),
    "noise": (
        EPOCH | POSITIONS | {"speed_mps": cells(np.random.default_rng(1).uniform(1, 40, 60))},
        "contradict|jump",
    ),
    "day or month": (
        {"date": ["05/06/2026 10:00:01"] * 60, "speed_kmh": cells(V)},
        "day and month",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_tables(tmp_path, name):
    columns, word = REFUSED[name]
    if word is None:
        (tmp_path / "log.csv").write_text(table(columns))
        assert read_sidecar(tmp_path / "log.csv", "drive.mp4", 60.0) is None
        return
    with pytest.raises(TelemetryError, match=word):
        read(tmp_path, table(columns))


def nmea(content):
    total = 0
    for character in content:
        total ^= ord(character)
    return f"${content}*{total:02X}"


def ddmm(value, digits):
    return f"{int(value):0{digits}d}{(value - int(value)) * 60:010.7f}"


def log_of(kind):
    if kind == "nmea":
        lines = []
        for date, lat, lon, v in zip(DATES, LAT, LON, V, strict=True):
            lines += [
                nmea(
                    f"GPGGA,{date:%H%M%S}.00,{ddmm(lat, 2)},N,{ddmm(lon, 3)},E,1,09,0.9,520.0,M,"
                    "47.0,M,,"
                )
            ]
            lines += [nmea(f"GPVTG,90.0,T,,M,{v * 1.94384:.3f},N,{v * 3.6:.3f},K,A")]
            lines += [nmea(f"GPZDA,{date:%H%M%S}.00,{date:%d,%m,%Y},00,00")]
        return "\n".join(lines)
    if kind == "vbo":
        rows = [
            f"009 {date:%H%M%S}.00 {lat * 60:+013.6f} {-lon * 60:+013.6f} {v * 3.6:07.3f} 090.00 "
            "+0520.00"
            for date, lat, lon, v in zip(DATES, LAT, LON, V, strict=True)
        ]
        header = (
            f"File created on {DATES[0]:%d/%m/%Y} at 10:00:00\n\n[header]\ntime\nvelocity "
            "kmh\n\n[column names]\n"
        )
        return header + "sats time lat long velocity heading height\n\n[data]\n" + "\n".join(rows)
    if kind == "tcx":
        points = [
            f"<Trackpoint><Time>{date:%Y-%m-%dT%H:%M:%SZ}</Time><Position><LatitudeDegrees>"
            f"{lat}</LatitudeDegrees><LongitudeDegrees>{lon}</LongitudeDegrees></Position>"
            f"<Extensions><ns3:TPX xmlns:ns3='x'><ns3:Speed>{v}</ns3:Speed></ns3:TPX></Extensions>"
            "</Trackpoint>"
            for date, lat, lon, v in zip(DATES, LAT, LON, V, strict=True)
        ]
        outer = ("TrainingCenterDatabase", "Activities", "Activity", "Lap", "Track")
        return f"<{'><'.join(outer)}>{''.join(points)}</{'></'.join(outer[::-1])}>"
    whens = "".join(f"<when>{date:%Y-%m-%dT%H:%M:%SZ}</when>" for date in DATES)
    coords = "".join(
        f"<gx:coord>{lon} {lat} 520</gx:coord>" for lat, lon in zip(LAT, LON, strict=True)
    )
    if kind == "kml":
        return (
            f"<kml xmlns:gx='x'><Document><Placemark><gx:Track>{whens}{coords}</gx:Track>"
            "</Placemark></Document></kml>"
        )
    places = "".join(
        f"<Placemark><TimeStamp><when>{date:%Y-%m-%dT%H:%M:%SZ}</when></TimeStamp><Point>"
        f"<coordinates>{lon},{lat},0</coordinates></Point></Placemark>"
        for date, lat, lon in zip(DATES, LAT, LON, strict=True)
    )
    return f"<kml><Document>{places}</Document></kml>"


@pytest.mark.parametrize(
    ("kind", "name"), [(k, f"a.{k}") for k in ("nmea", "vbo", "tcx", "kml")] + [("places", "a.kml")]
)
def test_formats(tmp_path, kind, name):
    track = read(tmp_path, log_of(kind), name)
    check(track)
    assert track.has_own_speed == (kind in ("nmea", "vbo", "tcx"))


def fit_file():
    """A FIT file with one definition and records of time, position and speed (FIT protocol 2.0)."""
    semicircles = [np.round(x * 2**31 / 180).astype(int) for x in (LAT, LON)]
    fields = ((253, 4, 0x86), (0, 4, 0x85), (1, 4, 0x85), (6, 2, 0x84))
    body = struct.pack("<BBBHB", 0x40, 0, 0, 20, len(fields)) + b"".join(
        struct.pack("<BBB", *field) for field in fields
    )
    seconds = [round(START_S - 631_065_600 + t) for t in T.tolist()]  # since 1989-12-31
    for row in zip(seconds, *semicircles, np.round(V * 1000).astype(int), strict=True):
        body += struct.pack("<BIiiH", 0, *map(int, row))
    return struct.pack("<BBHI4sH", 14, 0x20, 2132, len(body), b".FIT", 0) + body + b"\0\0"


def test_fit(tmp_path):
    check(read(tmp_path, fit_file(), "a.fit"))
    (tmp_path / "b.fit").write_bytes(b"no FIT file at all")
    with pytest.raises(TelemetryError, match="FIT"):
        read_sidecar(tmp_path / "b.fit", "drive.mp4", 60.0)


def test_ros_topics(tmp_path):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        names = {"/fix": "sensor_msgs/msg/NavSatFix", "/vel": "geometry_msgs/msg/TwistStamped"}
        topics = {
            name: writer.add_connection(name, kind, typestore=store) for name, kind in names.items()
        }
        for t, lat, lon, n, e in zip(T.tolist(), LAT, LON, NORTH_MPS, EAST_MPS, strict=True):
            header = types["std_msgs/msg/Header"](
                types["builtin_interfaces/msg/Time"](int(START_S + t), 0), "gps"
            )
            vector = types["geometry_msgs/msg/Vector3"]
            twist = types["geometry_msgs/msg/Twist"](vector(n, e, 0.0), vector(0.0, 0.0, 0.0))
            fix = types[names["/fix"]](
                header, types["sensor_msgs/msg/NavSatStatus"](0, 1), lat, lon, 0.0, np.zeros(9), 0
            )
            for name, message in (("/fix", fix), ("/vel", types[names["/vel"]](header, twist))):
                stored = bytes(store.serialize_cdr(message, names[name]))
                writer.write(topics[name], int((START_S + t) * 1e9), stored)
    found = named_telemetry(tmp_path / "bag", [part(duration_s=59.0)])
    assert found.track is not None
    assert found.track.source == "topic /vel"
    assert found.track.speed_mps == pytest.approx(V, rel=1e-3)
    assert found.track.time_s == pytest.approx(T, abs=1e-3)


def test_comma2k19(tmp_path):
    for name, values in {
        "CAN/speed/t": 100 + T,
        "CAN/speed/value": V[:, None],
        "global_pose/frame_times": 99.5 + T,
    }.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            np.save(file, values)
    ego = open_ego_speed(str(tmp_path))
    assert ego.time_s[0] == pytest.approx(0.5)
    assert ego.speed_mps == pytest.approx(V)
    (tmp_path / "CAN/speed/value").write_bytes(b"\x80\x04pickle")
    with pytest.raises(EgoSpeedError, match="damaged"):
        open_ego_speed(str(tmp_path))


def test_oxts_in_another_unit(tmp_path):
    (tmp_path / "timestamps.txt").write_text(
        "\n".join(date.strftime("%Y-%m-%d %H:%M:%S.000000000") for date in DATES)
    )
    for i, (lat, lon, v) in enumerate(zip(LAT, LON, V * 3.6, strict=True)):
        (tmp_path / f"{i:010d}.txt").write_text(
            " ".join(map(str, [lat, lon, *[0] * 6, v, *[0] * 21]))
        )
    ego, notes = _checked(open_ego_speed(str(tmp_path)), [part(duration_s=60.0)])
    assert ego.speed_mps == pytest.approx(V, rel=1e-3)
    assert "km/h instead of m/s" in notes[0]


def test_a_named_file_of_another_drive(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(table({"time_s": cells(T + 700), "speed_mps": cells(V)}))
    assert _is_table(path)
    with pytest.raises(TelemetryError, match="cover 0% of the video"):
        _checked(open_ego_speed(str(path)), [part(duration_s=60.0)])
    path.write_text(table({"time_s": cells(T)} | POSITIONS | {"speed_mps": cells(V)}))
    assert not _is_table(path)  # its speeds are compared with its positions
    path.write_text(table(EPOCH | {"speed_mps": cells(V)}))
    with pytest.raises(TelemetryError, match="is local, give --start-utc as 2026-05-03 10:00:00"):
        named_telemetry(path, [part(duration_s=50.0, start_s=START_S + 7200, source="--start-utc")])


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("event.json", "Tesla"),
        ("rlog.zst", "openpilot"),
        ("can.trc", "CAN bus"),
        ("can.blf", "a BLF file, found another format"),
        ("track.kmz", "KML"),
        ("gps.ubx", "NMEA"),
    ],
)
def test_kinds_that_are_not_read(tmp_path, name, word):
    (tmp_path / name).write_bytes(b"\x01\x02\x03 neither text nor video")
    with pytest.raises(TelemetryError, match=word):
        named_telemetry(tmp_path / name, [part()])


DAMAGED = {
    **{f"a.{kind}": log_of(kind).encode() for kind in ("nmea", "vbo", "tcx", "kml")},
    "a.fit": fit_file(),
    "a.csv": table(LAYOUTS["Torque"]).encode(),
    "b.csv": table(LAYOUTS["vx vy vz"], ";").encode(),
}


def test_a_date_that_no_calendar_has_is_left_out(tmp_path):
    path = tmp_path / "a.nmea"
    lines = [
        nmea(f"GPGGA,10000{k}.00,4806.{k},N,01130.0,E,1,09,0.9,520.0,M,47.0,M,,") for k in range(3)
    ]
    date = nmea("GPZDA,100000.00,03,05,202611111111111111111,00,00")
    path.write_text("\n".join([*lines, date]))
    found = read_nmea(path)
    assert found is not None
    assert found.time_s.tolist() == [36001.0]  # seconds of the day


@pytest.mark.parametrize("name", DAMAGED)
@settings(
    deadline=None, max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_damaged_logs(tmp_path, name, data):
    content = DAMAGED[name]
    damaged_content = data.draw(damaged(content[: len(content) // 4]))
    check_damaged(
        lambda path: named_telemetry(path, [part(duration_s=60.0)]),
        tmp_path / name,
        damaged_content,
    )


def test_origin_and_covered_part_are_one_note() -> None:
    ego = EgoSpeed(np.array([2.0, 3.0]), np.array([10.0, 10.0]), source="drive.gpx")
    found = SpeedSource(
        ego=ego, origin="The ego speed comes from drive.gpx; --ego-speed off ignores this source."
    )
    covered = (
        "covers 2.0-3.0 s of the video; elsewhere closing speeds are estimated from distances "
        "alone."
    )
    assert found.note(9.0) == f"{found.origin} The speed {covered}"
    assert replace(found, ego=None).note(9.0) == found.origin
    assert SpeedSource(ego=ego).note(9.0) == f"The ego speed from drive.gpx {covered}"
    assert SpeedSource().note(9.0) == ""
