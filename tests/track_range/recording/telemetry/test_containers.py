"""Telemetry inside video files that are made from the published formats: no recording of these
cameras is available."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.track_range.recording.telemetry.mp4_files import (
    VIDEO,
    MadeTrack,
    box,
    camm_gps,
    camm_position,
    free_gps,
    gps5_payload,
    gps9_payload,
    long_record,
    mp4,
    rmc,
    short_record,
    tesla_frame,
    transport_stream,
)
from track_range.recording.telemetry.checks import usable
from track_range.recording.telemetry.containers.free_gps import parse_free_gps
from track_range.recording.telemetry.containers.ligogps import parse_ligo_record
from track_range.recording.telemetry.found import embedded
from track_range.recording.telemetry.tracks.track import TelemetryError, TelemetryTrack

KNOT = 1852 / 3600


@pytest.fixture
def read(tmp_path: Path) -> Callable[[bytes], TelemetryTrack | None]:
    def read_content(content: bytes) -> TelemetryTrack | None:
        path = tmp_path / "video.mp4"
        path.write_bytes(content)
        return embedded(path)

    return read_content


def test_video_without_telemetry(
    read: Callable[[bytes], TelemetryTrack | None], tmp_path: Path
) -> None:
    assert read(mp4([VIDEO])) is None
    assert read(b"") is None
    assert read(b"RIFF, not an MP4 file") is None
    with pytest.raises(TelemetryError, match=r"absent\.mp4"):
        embedded(tmp_path / "absent.mp4")


def test_gpmf_in_video(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    payloads = [gps5_payload([10.0, 11.0], second=0), gps5_payload([12.0, 13.0], fix=0, second=1)]
    track = read(mp4([VIDEO, MadeTrack(b"meta", b"gpmd", payloads)]))
    assert track is not None
    assert track.time_s.tolist() == [0, 0.5, 1, 1.5]
    assert track.speed_mps == pytest.approx([10, 11, math.nan, math.nan], nan_ok=True)
    assert np.diff(track.utc_s)[0] == 0.5
    assert np.isnan(track.utc_s[2:]).all()


def test_gpmf_gps9_first(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    payloads = [gps5_payload([9.0]) + gps9_payload(10.0), gps9_payload(20.0, fix=0, second=1)]
    track = read(mp4([VIDEO, MadeTrack(b"meta", b"gpmd", payloads)]))
    assert track is not None
    assert track.source == "GoPro GPMF (GPS9)"
    assert track.speed_mps == pytest.approx([10, math.nan], nan_ok=True)
    assert track.utc_s[0] == 1736245982  # 2025-01-07 10:33:02, 9138 days after 2000


def test_gpmf_doubtful_dop(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    track = read(gps5_payload([3.0], dop=1500) + gps5_payload([4.0], dop=9999))
    assert track is not None
    assert track.speed_mps == pytest.approx([3, math.nan], nan_ok=True)
    assert "dilution" in track.notes[0]


def test_camm(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    samples = [camm_gps(3.0, 4.0), struct.pack("<HH3f", 0, 2, 0, 0, 0), camm_gps(3.0, 4.0, fix=0)]
    track = read(mp4([VIDEO, MadeTrack(b"camm", b"camm", samples)]))
    assert track is not None
    assert track.speed_mps == pytest.approx([5, math.nan], nan_ok=True)
    assert track.time_s.tolist() == [0, 2]
    assert math.degrees(track.course_rad[0]) == pytest.approx(36.87, abs=0.01)
    assert track.utc_s[0] == 1.3e9 + 315964800 - 18
    assert track.speed_sigma_mps == pytest.approx(0.3)


@pytest.mark.parametrize("with_gps", [False, True])
def test_camm_positions_only(
    read: Callable[[bytes], TelemetryTrack | None], with_gps: bool
) -> None:
    step_deg = 10 / 111_195  # 10 m of latitude
    made = [
        camm_gps(0, 0, latitude_deg=50 + i * step_deg)
        if with_gps
        else camm_position(50 + i * step_deg)
        for i in range(9)
    ]
    track = read(mp4([VIDEO, MadeTrack(b"camm", b"camm", made)]))
    assert track is not None
    assert not track.has_own_speed
    assert track.speed_mps == pytest.approx(10, abs=0.01)


@pytest.mark.parametrize(
    "record", [short_record(), long_record(), short_record(order=">"), long_record(order=">")]
)
def test_free_gps_layouts(record: bytes) -> None:
    content = parse_free_gps(free_gps(record))
    assert content is not None
    (sample,) = content.samples
    assert sample.speed_mps == pytest.approx(48.59 * KNOT, abs=1e-4)
    assert (sample.course_deg, sample.latitude_deg, sample.longitude_deg) == (7, 50, 30)
    assert sample.utc_s == 1634139477


@pytest.mark.parametrize("flags", [b"V00", b"V\0\0", b"VNE"])
def test_free_gps_void(flags: bytes) -> None:
    for record in (short_record(flags=flags), long_record(flags=flags)):
        content = parse_free_gps(free_gps(record))
        assert content is not None
        assert math.isnan(content.samples[0].speed_mps)


def test_free_gps_missing_status() -> None:
    content = parse_free_gps(free_gps(short_record(flags=b"\0NE")))
    assert content is not None
    assert content.samples[0].speed_mps == pytest.approx(48.59 * KNOT, abs=1e-4)


def test_free_gps_further_layouts() -> None:
    date = (14, 39, 44, 2019, 5, 29)
    kenwood = bytes(48) + short_record()
    iqs = b"IQS".ljust(32, b"\0") + struct.pack(
        "<6I3sxiiif", *date, b"ANE", 500000000, 300000000, 2500, 0
    )
    doubles = struct.pack(
        "<IIIcxxxdcxxxxxxxdcxxxxxxxdd3I",
        13,
        22,
        30,
        b"A",
        5000.0,
        b"N",
        3000.0,
        b"E",
        48.59,
        7.0,
        22,
        12,
        14,
    )
    s1 = bytes(32) + b"horsontech".ljust(16, b"\0")
    s1 += struct.pack("<3sx6I5f", b"ANE", 21, 7, 2, 3, 53, 5, 3000.0, 5000.0, 48.59, 7.0, 141.0)
    innovv = struct.pack("<3sx4f12x", b"ANE", 5000.0, 3000.0, 48.59, 7.0) * 2
    nextbase = (
        bytes(32)
        + b"$S"
        + struct.pack(">HhHBBBBHBii", 2500, 700, 2018, 10, 8, 6, 42, 465, 2, 500000000, 300000000)
    )
    mask = bytes.fromhex("aaaaf2e1f0ee5454")
    text = b"20180924224928.5567GP" + b" " * 9 + b"N50000000E030000000" + b"00000090"
    azdome = b"\1\3" + mask + bytes(byte ^ 0xAA for byte in text)
    for record, speed_mps in (
        (kenwood, 48.59 * KNOT),
        (iqs, 25.0),
        (doubles, 48.59 * KNOT),
        (bytes(32) + doubles, 48.59 * KNOT),
        (s1, 48.59 * KNOT),
        (innovv, 48.59 * KNOT),
        (nextbase, 25.0),
        (azdome, 25.0),
    ):
        content = parse_free_gps(free_gps(record))
        assert content is not None
        assert content.samples[0].speed_mps == pytest.approx(speed_mps, abs=1e-4)
        assert content.samples[0].latitude_deg == pytest.approx(50)
        assert content.samples[0].longitude_deg == pytest.approx(30)


def test_free_gps_unknown_unit(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    record = bytes(32) + struct.pack(
        "<6I3s5xdd2f", 14, 39, 44, 2019, 5, 29, b"ANE", 1e300, 1e-300, 25.1, 7.0
    )
    track = read(mp4([VIDEO], top=box(b"free", free_gps(record)[4:]) * 3))
    assert track is not None
    assert np.isnan(track.speed_mps).all()
    assert "unit" in track.notes[0]


def test_free_gps_unit_from_positions(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    step = 20 * KNOT / 1852  # minutes of latitude in a second at 20 kn
    blocks = [
        struct.pack(
            "<3IcxxxfcxxxfcxxxffIII",
            18,
            47,
            i,
            b"A",
            5000 + i * step,
            b"N",
            3000.0,
            b"E",
            20.0,
            0.0,
            2020,
            1,
            12,
        )
        for i in range(20)
    ]
    track = read(
        mp4(
            [VIDEO], top=b"".join(box(b"free", free_gps(bytes(32) + block)[4:]) for block in blocks)
        )
    )
    assert track is not None
    assert np.median(track.speed_mps) == pytest.approx(20 * KNOT, rel=0.001)
    assert track.notes == ()


def test_free_gps_encrypted_positions(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    blocks = [
        struct.pack(
            "<6I3sx4f", 15, 37, i, 21, 10, 13, b"ANE", 4000 + 97 * i % 13, 700 * (i % 5), 48.59, 7.0
        )
        for i in range(9)
    ]
    track = read(mp4([VIDEO], top=b"".join(box(b"free", free_gps(block)[4:]) for block in blocks)))
    assert track is not None
    assert track.speed_mps == pytest.approx(48.59 * KNOT, abs=1e-4)
    assert np.isnan(track.latitude_deg).all()
    assert len(usable(track)) == 9


def test_free_gps_unknown_layout(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    with pytest.raises(TelemetryError, match=r"video\.mp4.*layout"):
        read(mp4([VIDEO], between=free_gps(b"another layout" * 20)))
    assert read(mp4([VIDEO], between=free_gps(b""))) is None


def test_free_gps_between_frames(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    track = read(mp4([VIDEO], between=free_gps(long_record())))
    assert track is not None
    assert track.time_s.tolist() == list(range(10))
    assert track.speed_mps == pytest.approx(48.59 * KNOT, abs=1e-4)


def test_free_gps_index(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    content = mp4([VIDEO], between=free_gps(short_record()))
    places = [i for i in range(len(content)) if content.startswith(b"freeGPS ", i)][:3]
    index = struct.pack(">II", 0x101, 3) + b"".join(
        struct.pack(">II", place - 4, 0x200) for place in places
    )
    track = read(mp4([VIDEO], between=free_gps(short_record()), inner=box(b"gps ", index)))
    assert track is not None
    assert len(track) == 3


@pytest.mark.parametrize(("stream_id", "packet_bytes"), [(0xBF, 188), (0xBD, 188), (0xBF, 192)])
def test_transport_stream(
    read: Callable[[bytes], TelemetryTrack | None], stream_id: int, packet_bytes: int
) -> None:
    records = [short_record(10 + i).ljust(500, b"\0") for i in range(6)]
    track = read(transport_stream(records, stream_id=stream_id, packet_bytes=packet_bytes))
    assert track is not None
    assert track.time_s.tolist() == list(range(6))
    assert track.speed_mps / KNOT == pytest.approx(np.arange(10, 16), abs=1e-3)


def test_transport_stream_resynchronised(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    stream = transport_stream([short_record().ljust(500, b"\0")] * 6)
    track = read(stream[: 188 * 12] + b"lost" + stream[188 * 12 + 100 :])
    assert track is not None
    assert len(track) >= 4


def test_transport_stream_rmc(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    track = read(transport_stream([rmc(20.0, second) for second in range(5)]))
    assert track is not None
    assert track.speed_mps == pytest.approx(20 * KNOT)


def test_rmc_subtitles(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    texts = [b"gsensori,4,512;" + rmc(i, i, "V" if i == 2 else "A") for i in range(4)]
    samples = [struct.pack(">H", len(text)) + text for text in texts] + [b"\0\3abc"]
    track = read(mp4([VIDEO, MadeTrack(b"text", b"text", samples)]))
    assert track is not None
    assert track.speed_mps / KNOT == pytest.approx([0, 1, math.nan, 3], nan_ok=True)
    assert track.time_s.tolist() == [0, 1, 2, 3]


def test_shifted_subtitles(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    plain = b"\t0.1" + rmc(20.0).rstrip() + b"\n"
    shifted = b"\0" + bytes((byte - 7) & 0xFF for byte in plain[:-1]) + b"\n"
    assert shifted[-4] == (ord("*") - 7) & 0xFF
    track = read(mp4([VIDEO, MadeTrack(b"text", b"text", [shifted] * 3)]))
    assert track is not None
    assert track.speed_mps == pytest.approx(20 * KNOT)


def test_makers_own_texts(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    garmin = (
        b"PNDM" + bytes(4) + struct.pack(">Hxxii", 60, int(50 * 2**31 / 180), int(8 * 2**31 / 180))
    )
    dji = b"F/3.5, SS 1000, GPS (8.6499, 53.1665, 18), D 24.26m, H 6.00m, H.S 2.10m/s, V.S 0.00m/s"
    kingslim = short_record()
    rove = struct.pack("<ddiH6BB3x", 5000.0, 800.0, 100, 30, 24, 5, 20, 18, 45, 27, 122)
    vantrue = (
        b"FMAS".ljust(0x50, b"\0")
        + b"SAMM".ljust(16, b"\0")
        + struct.pack("<H5B", 2021, 9, 24, 8, 0, 34)
    )
    vantrue = vantrue.ljust(0x78, b"\0") + struct.pack(
        "<cccBBBHBBHHH", b"A", b"E", b"N", 8, 0, 0, 0, 50, 0, 0, 60, 82
    )
    for format_, sample, speed_mps in (
        (b"text", garmin, 60 * 0.44704),
        (b"tx3g", dji, 2.1),
        (b"gpmd", kingslim, 48.59 * KNOT),
        (b"ssmd", rove, 30 * KNOT),
        (b"gpmd", vantrue.ljust(160, b"\0"), 60 * 0.44704),
    ):
        track = read(mp4([VIDEO, MadeTrack(b"meta", format_, [sample] * 3)]))
        assert track is not None, format_
        assert track.speed_mps == pytest.approx(speed_mps, abs=1e-3)
        assert track.latitude_deg == pytest.approx(50, abs=4)


def test_order_of_dji_positions_in_a_video(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    """As beside it: heights with M, and values, mark latitude first."""
    for place in ("53.3, {:.7f}, 0.0M", "53.3, {:.7f}, 18", "{:.7f}, 53.3, 18"):
        lon_deg = 120 if place.endswith("18") else -6.2
        texts = [
            f"GPS ({place.format(lon_deg + i / 5e4)}), D 1m, H.S 2.10m/s".encode() for i in range(3)
        ]
        track = read(mp4([VIDEO, MadeTrack(b"text", b"text", texts)]))
        assert track is not None
        assert track.latitude_deg == pytest.approx(53.3)
        assert track.longitude_deg == pytest.approx(lon_deg, abs=1e-3)


def test_blackvue(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    lines = b"".join(b"[%d]%s" % (1751900000250 + 1000 * i, rmc(48.0, i)) for i in range(5))
    start = struct.pack(">Q", 1751900000000)
    with_start = box(b"free", box(b"cprt", b"Pittasoft"), box(b"gps ", lines), box(b"sttm", start))
    track = read(mp4([VIDEO], top=with_start))
    assert track is not None
    assert track.speed_mps == pytest.approx(48 * KNOT)
    assert track.time_s == pytest.approx(0.25 + np.arange(5))
    without_start = read(
        mp4([VIDEO], top=box(b"free", box(b"cprt", b"Pittasoft"), box(b"gps ", lines)))
    )
    assert without_start is not None
    assert without_start.time_s[0] == 0


def test_blackvue_sidecar_as_box(
    shared_data: Path, read: Callable[[bytes], TelemetryTrack | None]
) -> None:
    lines = (shared_data / "telemetry" / "sidecars" / "blackvue.gps").read_bytes()
    track = read(mp4([VIDEO], top=box(b"free", box(b"gps ", lines))))
    assert track is not None
    assert track.speed_mps[0] == pytest.approx(48.0 * KNOT)
    assert math.degrees(track.course_rad[0]) == pytest.approx(145.2)


def test_ligo_record() -> None:
    # start of a record as published, with its first field decrypted: 2024/05/22 02:54:29
    head = bytes.fromhex("c1ec412020f012101224e50e10112f92101200")
    assert parse_ligo_record(b"####" + struct.pack("<I", len(head)) + head) is None
    text = b"2024/05/22 02:54:29 N:42.382470 W:83.389570 53.6 km/h A:269.2"
    groups = b"".join(_encrypted(text[i : i + 4].ljust(4)) for i in range(0, len(text), 4))
    sample = parse_ligo_record(b"####" + struct.pack("<I", len(groups)) + groups)
    assert sample is not None
    assert sample.speed_mps == pytest.approx(53.6 * 1.85407333 / 3.6, abs=1e-3)
    assert math.isnan(sample.latitude_deg)


def _encrypted(four: bytes) -> bytes:
    """Group of a control byte 0b11...: its bits replace some bits of the four characters."""
    bits = [(byte ^ 0x20) & mask for byte, mask in zip(four, (1, 2, 0x0C, 0), strict=True)]
    control = 0xC0 | sum(bits) | four[3] & 0x30
    rest = [(byte ^ 0x20) & ~mask & 0xFF for byte, mask in zip(four[:3], (1, 2, 0x0C), strict=True)]
    return bytes([control, *rest, (four[3] & ~0x30 & 0xFF) ^ 0x20])


def test_ligo_json(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    fields = b'"Hour": "23", "Minute": "10", "Second": "%02d", "Year": "2023", "Month": "12", '
    fields += b'"Day": "28", "status": "A", '
    fields += b'"NS": "N", "EW": "W", "Latitude": "50.1", "Longitude": "8.1", "Speed": "20.0"'
    rows = b"".join((b"LIGOGPSINFO {" + fields % i + b"}").ljust(512, b"\0") for i in range(3))
    track = read(mp4([VIDEO], top=box(b"skip", rows)))
    assert track is not None
    assert track.speed_mps == pytest.approx(20 * KNOT)
    assert track.time_s.tolist() == [0, 1, 2]


def test_seventymai_table(read: Callable[[bytes], TelemetryTrack | None]) -> None:
    rows = b"".join(
        struct.pack("<4IcIcI10x", 1, 1, i, 36000, b"N", 5000000, b"E", 800000) for i in range(4)
    )
    track = read(mp4([VIDEO], end=box(b"GPS ", rows)))
    assert track is not None
    assert track.speed_mps == pytest.approx(10)
    assert track.time_s.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("codec", ["h264", "hevc"])
def test_tesla(read: Callable[[bytes], TelemetryTrack | None], codec: str) -> None:
    frames = [tesla_frame(speed, codec=codec) for speed in (0.0, 1.5, None, -2.0)]
    format_ = b"avc1" if codec == "h264" else b"hvc1"
    track = read(mp4([MadeTrack(b"vide", format_, frames, ticks=28, timescale=1000)]))
    assert track is not None
    assert track.speed_mps == pytest.approx([0, 1.5, 2.0])
    assert track.time_s == pytest.approx([0, 0.028, 0.084])
    assert track.longitude_deg.tolist() == [8, 8, 8]
    assert math.degrees(track.course_rad[0]) == pytest.approx(90)


def test_video_with_gap_of_gigabytes(tmp_path: Path) -> None:
    """Only tables are read: a sparse file of 8 GB takes no longer than a small one."""
    small = mp4([VIDEO], top=box(b"free", free_gps(long_record())[4:]) * 3)
    path = tmp_path / "large.mp4"
    with path.open("wb") as file:
        file.write(small[:24] + struct.pack(">I4sQ", 1, b"mdat", 8 << 30))
        file.seek((8 << 30) - 16, 1)
        file.write(small[24:])
    track = embedded(path)
    assert track is not None
    assert len(track) == 3
