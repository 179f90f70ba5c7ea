"""Damaged, cut and hostile video files: no exception but TelemetryError, no hang, little memory."""

from __future__ import annotations

import struct
import tracemalloc
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from tests.track_range.recording.telemetry.mp4_files import (
    VIDEO,
    MadeTrack,
    box,
    camm_gps,
    fragmented_mp4,
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
from track_range.recording.telemetry.containers.free_gps import parse_free_gps
from track_range.recording.telemetry.containers.gpmf import gps_rows
from track_range.recording.telemetry.containers.ligogps import parse_ligo_record, parse_ligo_text
from track_range.recording.telemetry.containers.tesla import parse_message
from track_range.recording.telemetry.found import embedded
from track_range.recording.telemetry.tracks.track import TelemetryError

LINE = b"2026/08/03 11:34:53 N:48.1 W:002.1 19.0 km/h A:212.0"
TRAILER = (
    b"SKIPLIGOGPSINFO     " + struct.pack(">I", 2) + (b"\0\0\0\1" + LINE.ljust(128, b"\0")) * 2
)

SEEDS = {
    "gpmf": mp4(
        [VIDEO, MadeTrack(b"meta", b"gpmd", [gps5_payload([1.0, 2.0]), gps9_payload(3.0)])]
    ),
    "bare gpmf": gps5_payload([1.0]) + gps9_payload(3.0),
    "fragments": fragmented_mp4([VIDEO, MadeTrack(b"camm", b"camm", [camm_gps(3, 4)] * 3)]),
    "camm": mp4([VIDEO, MadeTrack(b"camm", b"camm", [camm_gps(3, 4)] * 3)]),
    "free gps": mp4([VIDEO], between=free_gps(long_record(), 0x80)),
    "transport stream": transport_stream([short_record().ljust(300, b"\0")] * 4),
    "subtitles": mp4([VIDEO, MadeTrack(b"text", b"tx3g", [rmc(20.0)] * 3)]),
    "blackvue": mp4([VIDEO], top=box(b"free", box(b"gps ", b"[1751900000250]" + rmc(48.0)))),
    "ligo": mp4(
        [VIDEO],
        end=struct.pack(">I", len(TRAILER) + 12)
        + TRAILER
        + b"####"
        + struct.pack(">I", len(TRAILER) + 12),
    ),
    "tesla": mp4([MadeTrack(b"vide", b"avc1", [tesla_frame(1.5)] * 3)]),
}


def test_seeds_have_telemetry(tmp_path: Path) -> None:
    for name, content in SEEDS.items():
        (tmp_path / name).write_bytes(content)
        assert embedded(tmp_path / name) is not None, name


@pytest.mark.parametrize("name", SEEDS)
@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_damaged_file(tmp_path: Path, name: str, data: st.DataObject) -> None:
    content = bytearray(SEEDS[name])
    for _ in range(data.draw(st.integers(1, 6))):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place : place + 4] = data.draw(
            st.sampled_from([b"\xff\xff\xff\xff", b"\0\0\0\0", b"\x7f", b"\0\0\0\1", b""])
        )
    cut = data.draw(st.integers(0, len(content)))
    path = tmp_path / "damaged"
    path.write_bytes(bytes(content[:cut] if data.draw(st.booleans()) else content))
    with suppress(TelemetryError):
        embedded(path)


@settings(max_examples=50, deadline=None)
@given(
    noise=st.binary(max_size=400),
    seed=st.sampled_from([short_record(), long_record(), b"LIGOGPSINFO\0", b"$S"]),
)
def test_damaged_records(noise: bytes, seed: bytes) -> None:
    for record in (noise, seed + noise, noise[:32] + seed):
        parse_free_gps(free_gps(record))
        parse_ligo_record(b"####" + record)
        parse_ligo_text(record)
        parse_message(b"\x42\x42\x69" + record)
        list(gps_rows(b"DEVC\0\1" + struct.pack(">H", len(record)) + record))


def _with_table(kind: bytes, table: bytes) -> bytes:
    """A video in which one table announces more than the file has."""
    content = SEEDS["gpmf"]
    place = content.rindex(kind)
    return content[: place + 4] + table + content[place + 4 + len(table) :]


@pytest.mark.parametrize(
    ("kind", "table"),
    [
        (b"stsz", struct.pack(">III", 0, 1, 0xFFFFFFFF)),
        (b"stsz", struct.pack(">III", 0, 0xFFFFFFFF, 0xFFFFFFFF)),
        (b"stts", struct.pack(">IIII", 0, 1, 0xFFFFFFFF, 0xFFFFFFFF)),
        (b"stsc", struct.pack(">IIIII", 0, 1, 1, 0xFFFFFFFF, 1)),
        (b"stco", struct.pack(">III", 0, 0xFFFFFFFF, 0xFFFFFFFF)),
        (b"gpmd", bytes(8)),
    ],
)
def test_announced_sizes(tmp_path: Path, kind: bytes, table: bytes) -> None:
    path = tmp_path / "hostile.mp4"
    path.write_bytes(_with_table(kind, table))
    tracemalloc.start()
    embedded(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 200e6


def test_other_files(tmp_path: Path) -> None:
    for content in (
        b"",
        b"\0" * 5000,
        b"\x47" * 5000,
        b"DEVC" * 500,
        box(b"moov", box(b"trak") * 50),
        b"\0\0\0\1ftyp" * 99,
    ):
        path = tmp_path / "other"
        path.write_bytes(content)
        assert embedded(path) is None
