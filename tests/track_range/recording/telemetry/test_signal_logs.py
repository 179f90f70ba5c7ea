"""Logs with many signals: MF4, and CAN buses in BLF, ASC and MF4, each written by its library."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from tests.track_range.recording.telemetry.telemetry_files import START_S, part
from tests.track_range.results.moving_frames import frame, info
from track_range.recording.speed_source import _named
from track_range.recording.telemetry.found import named_telemetry
from track_range.recording.telemetry.sidecars.reading import read_sidecar
from track_range.recording.telemetry.speed_files import EgoSpeedError
from track_range.recording.telemetry.tracks.signal_choice import ANY_SIGNAL, SignalChoice
from track_range.recording.telemetry.tracks.track import TelemetryError
from track_range.results.writers import OpenWriters
from track_range.run.options.settings import RunSettings

asammdf = pytest.importorskip("asammdf", reason="asammdf is not installed (extra adas)")
can = pytest.importorskip("can", reason="python-can is not installed (extra adas)")
cantools = pytest.importorskip("cantools", reason="cantools is not installed (extra adas)")

T = np.arange(0.0, 20.0, 0.1)
V = 12.0 + 3.0 * np.sin(T / 3.0)  # m/s
KMH = np.round(V * 3.6 / 0.01).astype(np.uint16)  # raw, 0.01 km/h per bit
DBC = """VERSION ""
BU_: ESP
BO_ 1168 ESP_A: 8 ESP
 SG_ VehicleSpeed : 8|16@1+ (0.01,0) [0|400] "km/h" ESP
 SG_ YawRate : 24|16@1- (0.01,0) [0|0] "deg/s" ESP
 SG_ Force : 40|8@1+ (1,0) [0|0] "kN" ESP
BO_ 1169 Wheels: 8 ESP
 SG_ SpeedFront : 0|16@1+ (0.01,0) [0|0] "" ESP
 SG_ SpeedRear : 16|16@1+ (0.01,0) [0|0] "" ESP
VAL_ 1168 VehicleSpeed 65534 "SNA" 65533 "Init" 0 "Standstill" ;
"""


@pytest.fixture
def dbc(tmp_path):
    (tmp_path / "car.dbc").write_text(DBC)
    return tmp_path / "car.dbc"


def frames(values=KMH, *, identifier=1168, extended=False, channel=1, shift_s=0.0, start_s=START_S):
    """One message for each time, with a speed of 16 bits from the second byte on."""
    for t, value in zip(T, values, strict=True):
        yield can.Message(
            timestamp=start_s + t + shift_s,
            arbitration_id=identifier,
            is_extended_id=extended,
            channel=channel,
            data=[0xFF, int(value) & 0xFF, int(value) >> 8, 0, 0, 0, 0, 0],
        )


def log_of(path, *streams):
    """A log with the messages of all streams in the order of time."""
    with can.Logger(str(path)) as log:
        for message in sorted((m for one in streams for m in one), key=lambda m: m.timestamp):
            log(message)
    return path


def signal(name, values, unit="", **given):
    return asammdf.Signal(values, T, name=name, unit=unit, **given)


def mdf_of(path, signals, start=None, version="4.10"):
    with asammdf.MDF(version=version) as mdf:
        mdf.header.start_time = start or datetime.fromtimestamp(START_S, UTC)
        for each in signals:
            mdf.append(each, acq_name="vehicle", common_timebase=True)
        return mdf.save(path, overwrite=True)


def read(path, choice=ANY_SIGNAL):
    track = read_sidecar(path, "drive.mp4", 20.0, choice)
    assert track is not None
    return track


def check(track, *, clock, start_s=START_S):
    np.testing.assert_allclose(track.speed_mps, V, atol=0.002)
    np.testing.assert_allclose(track.time_s, start_s + T, atol=0.002)
    assert (track.clock, track.unit) == (clock, "km/h")


@pytest.mark.parametrize("kind", ["blf", "asc", "mf4"])
def test_frames_of_a_bus(tmp_path, dbc, kind):
    """The only signal with a unit of speed, of the message with its identifier, without error frames;
    the clocks of BLF and ASC files are local, whatever the time zone of this machine.
    """
    others = frames(np.zeros(len(T)), identifier=1170, shift_s=0.01)
    noise = [can.Message(timestamp=START_S + 1.0, is_error_frame=True, arbitration_id=1168)]
    path = log_of(tmp_path / f"drive.{kind}", frames(), others, noise if kind == "blf" else ())
    start_s = START_S
    if kind != "blf":  # python-can writes the time of this machine
        zone = datetime.fromtimestamp(START_S, UTC).astimezone().utcoffset()
        start_s += zone.total_seconds()
    track = read(path, SignalChoice(database=dbc))
    check(track, clock="local", start_s=start_s)
    assert track.notes[0] == "the speed is ESP_A.VehicleSpeed in km/h."
    found = named_telemetry(
        path, [part(duration_s=20.0, start_s=start_s)], SignalChoice(database=dbc)
    )
    np.testing.assert_allclose(found.track.time_s, T, atol=0.002)


def test_values_that_are_no_speed(tmp_path, dbc):
    """Texts of the database, all bits set, values above its range, and short frames."""
    values = KMH.copy()
    values[:6] = [65534, 65533, 0, 65535, 40_001, 40_000]
    short = can.Message(
        timestamp=START_S - 1.0, arbitration_id=1168, is_extended_id=False, data=[1]
    )
    track = read(log_of(tmp_path / "a.blf", frames(values), [short]), SignalChoice(database=dbc))
    expected = [math.nan, math.nan, 0.0, math.nan, math.nan, 400 / 3.6]
    np.testing.assert_allclose(track.speed_mps[:6], expected)
    assert track.notes[1:] == (
        "1 frame cannot be decoded.",
        "4 samples have no valid value.",
    )
    no_speed = log_of(tmp_path / "b.blf", frames(np.full(len(T), 65535)))
    with pytest.raises(TelemetryError, match="none that is valid in 200 samples"):
        read(no_speed, SignalChoice(database=dbc))


def test_signals_by_name(tmp_path, dbc):
    path = log_of(tmp_path / "a.blf", frames(), frames(identifier=1169, shift_s=0.01))
    for name, word in (
        ("Wheels.SpeedFront", r"found ''; give it with --speed-channel 'SpeedFront \[km/h\]'"),
        ("Speed", "one signal 'Speed', found ESP_A.VehicleSpeed"),
    ):
        with pytest.raises(TelemetryError, match=word):
            read(path, SignalChoice(name=name, database=dbc))
    track = read(path, SignalChoice(name="Wheels.SpeedFront [m/s]", database=dbc))
    assert track.unit == "m/s"
    np.testing.assert_allclose(
        track.speed_mps[0], 0.01 * ((int(KMH[0]) & 0xFF) << 8 | 0xFF), rtol=1e-6
    )
    assert track.notes[0] == "the speed is Wheels.SpeedFront in m/s."
    yaw = read(path, SignalChoice(name="YawRate [km/h]", database=dbc))
    assert "in km/h, as given, not in its stated unit 'deg/s'" in yaw.notes[0]


def test_j1939_needs_no_database(tmp_path, dbc):
    """Wheel-based vehicle speed of CCVS1 from any source address; error codes are no speed."""
    raw = np.round(V * 3.6 * 256).astype(int)
    raw[3] = 0xFE00
    path = log_of(tmp_path / "truck.blf", frames(raw, identifier=0x18FEF121, extended=True))
    track = read(path)
    assert math.isnan(track.speed_mps[3])
    np.testing.assert_allclose(np.delete(track.speed_mps, 3), np.delete(V, 3), atol=0.002)
    silent = frames(np.full(len(T), 0xFFFF), identifier=0x18FEF100, extended=True, shift_s=0.01)
    both = read(
        log_of(tmp_path / "two.blf", frames(raw, identifier=0x18FEF121, extended=True), silent)
    )
    np.testing.assert_allclose(both.speed_mps, track.speed_mps)
    with pytest.raises(TelemetryError, match="give its DBC with --dbc"):
        read(log_of(tmp_path / "car.blf", frames()))
    with pytest.raises(TelemetryError, match="give the database of this bus"):
        read(path, SignalChoice(database=dbc))


def test_several_buses(tmp_path, dbc):
    """The same message on another bus is the same speed; two that differ are a question."""
    choice = SignalChoice(database=dbc)
    mirror = frames(channel=2, shift_s=0.003)
    track = read(log_of(tmp_path / "a.blf", frames(), mirror), choice)
    assert len(track) == len(T)
    other = frames(KMH // 2, channel=2)
    with pytest.raises(TelemetryError, match="2 buses or control units, which differ"):
        read(log_of(tmp_path / "b.blf", frames(), other), choice)


def test_damaged_and_empty_logs(tmp_path, dbc):
    choice = SignalChoice(database=dbc)
    many = [frames(channel=1, shift_s=20.0 * k) for k in range(40)]
    path = log_of(tmp_path / "a.blf", *many)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 3 // 4])
    assert 200 < len(read(path, choice)) < 8000
    for name, given, word in (
        ("b.blf", b"", "a BLF file, found another format"),
        ("b.blf", b"LOGG" + bytes(300), "b.blf"),
        ("b.asc", b"\xff\xfe\0text", "b.asc"),
        ("b.asc", b"date Fri\n 1e300 1 490 Rx d 8 FF 10 0E 00 00 00 00 00\n", "b.asc"),
        ("b.asc", b"date Fri\nbase hex  timestamps relative\n", "expected"),
        ("b.mf4", b"MDF     4.10    " + bytes(60), "an ASAM MDF file, found"),
        ("b.mf4", b"not a measurement", "another format"),
    ):
        (tmp_path / name).write_bytes(given)
        with pytest.raises(TelemetryError, match=word):
            read(tmp_path / name, choice)
    dbc.write_text("BO_ nothing")
    with pytest.raises(TelemetryError, match=r"car\.dbc: expected a DBC file"):
        read(path, choice)


def test_channels_of_a_measurement(tmp_path):
    """One channel with a unit of speed; invalid samples and all bits set are no speed."""
    invalid = np.zeros(len(T), np.bool_)
    invalid[1] = True
    raw = KMH.copy()
    raw[2] = 65535
    linear = asammdf.blocks.conversion_utils.from_dict({"a": 0.01, "b": 0.0})
    speed = signal("ESP_v", raw, "km/h", conversion=linear, invalidation_bits=invalid)
    others = [
        signal("AccelPedal", V, "%"),
        signal("TargetSpeed", V * 3.6, "km/h"),
        signal("a", V, "m/s2"),
        signal("Force", V, "kN"),
    ]
    path = mdf_of(tmp_path / "a.mf4", [[*others, speed]])
    track = read(path)
    expected = np.delete(V, 1)
    expected[1] = np.nan
    np.testing.assert_allclose(track.speed_mps, expected, atol=0.002)
    assert track.clock == "utc"
    assert track.notes[0] == "the speed is vehicle.ESP_v in km/h."
    local = mdf_of(tmp_path / "b.mf4", [[speed]], datetime(2026, 5, 3, 10, 0, 0))
    assert read(local).clock == "local"
    undated = mdf_of(tmp_path / "c.mf4", [[speed]], datetime.fromtimestamp(0, UTC))
    assert read(undated).clock == "video"
    old = mdf_of(tmp_path / "d.mdf", [[signal("v_kmh", V * 3.6)]], version="3.30")
    track = read(old, SignalChoice(name="v_kmh"))
    np.testing.assert_allclose(track.speed_mps, V, rtol=1e-6)


def test_several_channels_are_a_question(tmp_path):
    pair = [signal("VehV", V * 3.6, "km/h"), signal("SpeedGps", V, "m/s")]
    path = mdf_of(tmp_path / "a.mf4", [pair, [signal("VehV", V * 3.0, "km/h")]])
    with pytest.raises(
        TelemetryError, match=r"unit of speed, found .*VehV.*SpeedGps.*VehV.*--speed"
    ):
        read(path)
    with pytest.raises(TelemetryError, match=r"one signal 'VehV', found 0\.VehV, 1\.VehV"):
        read(path, SignalChoice(name="VehV"))
    np.testing.assert_allclose(read(path, SignalChoice(name="1.VehV")).speed_mps, V / 1.2)
    assert read(path, SignalChoice(name="SpeedGps")).unit == "m/s"
    texts = mdf_of(
        tmp_path / "b.mf4", [[signal("v", np.array([b"SNA"] * len(T)), "km/h", encoding="utf-8")]]
    )
    with pytest.raises(TelemetryError, match="none that is valid"):
        read(texts)


def test_options_of_a_run():
    """The signal is that of --speed-channel and --dbc, which a number has not."""
    settings = RunSettings(mono="drive.mp4", speed_channel="VehV [km/h]", dbc="car.dbc")
    assert settings.speed_signal == SignalChoice(name="VehV [km/h]", database=Path("car.dbc"))
    with pytest.raises(EgoSpeedError, match=r"--ego-speed 50: expected .*\.mf4, .*--speed-channel"):
        _named("50", [part()], lambda: None, settings.speed_signal)


def test_speed_of_a_run(tmp_path):
    """The ego speed of run.mf4 is read back, not the speeds of its objects."""
    with OpenWriters(("mf4",), info(start_utc_s=START_S), tmp_path) as writers:
        for index in range(20):
            writers.write(frame(index))
        writers.close(None)
    track = read(tmp_path / "run.mf4")
    assert track.notes[0].startswith("the speed is ego.ego_speed in m/s")
    np.testing.assert_allclose(track.speed_mps, 10.0)
    np.testing.assert_allclose(track.time_s, START_S + 0.1 * np.arange(20))
