"""GoPro's telemetry format GPMF: the streams GPS5 and GPS9 of the track `gpmd`, or payloads alone in a file.

Format: github.com/gopro/gpmf-parser. A payload holds devices (DEVC) with streams (STRM); an entry has a key of four
characters, the type of its values, the size and the number of its rows, all big-endian, and is padded to four bytes.

GPS5  latitude, longitude, altitude, horizontal speed, speed in space; with GPSF (fix), GPSP (dilution of precision)
      and GPSU (date and time in UTC) for the payload; HERO5 to HERO10, Fusion, MAX
GPS9  as GPS5, then days since 2000, seconds of the day, dilution of precision and fix of each row; since HERO11
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.recording.telemetry.containers.mp4_boxes import Movie, read_samples
from track_range.recording.telemetry.containers.samples import MAX_SAMPLES, Sample, date_s, track
from track_range.recording.telemetry.track import TelemetryTrack

MAX_PAYLOAD_BYTES = 1_000_000
"""Size limit of a payload, which covers about one second; GoPro's have 10 to 100 kB."""

MAX_BARE_BYTES = 64_000_000
"""Size limit of a file of payloads alone."""

MIN_FIX = 2
"""Smallest GPSF with a fix: 0 = none, 2 = two-dimensional, 3 = three-dimensional."""

MAX_DOP = 10.0
"""Dilution of precision above which positions count as poor, the scale's usual upper end; GoPro recommends 5."""

NO_FIX_DOP = 99.99
"""Dilution of precision that GoPro writes without a fix (GPSP 9999)."""

MAX_ENTRIES = 20_000
"""Largest number of entries read on one level; a payload has about 500."""

_RATE_HZ = 18.0
"""Nominal rate of GPS5, for payloads without a duration."""

_MAX_PAYLOAD_S = 3.0
"""Longest time between two payloads that is taken as the duration of the first."""

_DAY_S = 86_400.0
_YEAR_2000_S = date_s(2000, 1, 1, 0, 0, 0)
_TYPES = {
    "b": ">i1", "B": ">u1", "s": ">i2", "S": ">u2", "l": ">i4", "L": ">u4", "j": ">i8", "J": ">u8", "f": ">f4",
    "d": ">f8", "q": ">i4", "Q": ">i8",
}  # fmt: skip
_FIXED_POINT = {"q": 2.0**16, "Q": 2.0**32}
"""Divisor of the fixed-point types."""


@dataclass(frozen=True, slots=True)
class GpsRows:
    """Rows of one GPS stream of one payload.

    Attributes:
        key: "GPS5" or "GPS9".
        device: number of the device.
        values: (N, 5) latitude and longitude in degrees, altitude in m, horizontal speed and speed in space in m/s.
        utc_s: (N,) seconds since 1970; in GPS5 only the first is known, the others are NaN.
        dop: (N,) dilution of precision.
        fix: (N,) GPSF; 3 where the file states none.
    """

    key: str
    device: int
    values: FloatArray
    utc_s: FloatArray
    dop: FloatArray
    fix: FloatArray


@dataclass(slots=True)
class _Stream:
    """Entries of a stream that are read before its GPS rows."""

    scale: FloatArray = field(default_factory=lambda: np.ones(1))
    types: str = ""
    fix: float = 3.0
    dop: float = math.nan
    utc_s: float = math.nan


def read_gpmf(file: BinaryIO, movie: Movie, _path: Path) -> TelemetryTrack | None:
    """Telemetry of the track `gpmd` of a movie; None = it has no GPS stream."""
    source = next((part for part in movie.tracks if part.format == b"gpmd"), None)
    if source is None:
        return None
    payloads: list[tuple[float, float, list[GpsRows]]] = []
    n_rows = 0
    for index, content in read_samples(file, source, range(len(source)), MAX_PAYLOAD_BYTES):
        if index == _PROBED_PAYLOADS and not n_rows:
            return None
        streams = list(gps_rows(content))
        n_rows += sum(len(rows.values) for rows in streams)
        payloads.append((source.time_s[index] - movie.start_s, source.durations_s[index], streams))
        if n_rows > MAX_SAMPLES:
            break
    return _track(payloads, "video")


_PROBED_PAYLOADS = 60
"""Number of payloads without GPS rows after which a file counts as one without GPS."""


def read_bare_gpmf(content: bytes) -> TelemetryTrack | None:
    """Telemetry of payloads alone, timed by their GPSU or GPS9; None = there is no GPS stream."""
    return _track([(math.nan, math.nan, [rows]) for rows in gps_rows(content)], "utc")


def gps_rows(content: bytes) -> Iterator[GpsRows]:
    """GPS rows of all devices and streams in one or more payloads."""
    device = 0
    for key, kind, start, end, _, _ in _entries(content, 0, len(content)):
        if key != "DEVC" or kind != "\0":
            continue
        for part, part_kind, part_start, part_end, _, _ in _entries(content, start, end):
            if part == "DVID" and part_end - part_start >= 4:
                device = int.from_bytes(content[part_start : part_start + 4], "big")
            elif part == "STRM" and part_kind == "\0" and content.find(b"GPS", part_start, part_end) >= 0:
                yield from _stream_rows(content, part_start, part_end, device)


def _entries(content: bytes, start: int, end: int) -> Iterator[tuple[str, str, int, int, int, int]]:
    """Key, type, start and end of the values, size of a row and number of rows of each entry."""
    for _ in range(MAX_ENTRIES):
        if start + 8 > end:
            return
        name, kind, row_bytes, n_rows = struct.unpack_from(">4scBH", content, start)
        n_bytes = row_bytes * n_rows
        if not name.strip(b"\0"):
            return
        yield (
            name.decode("latin-1"),
            kind.decode("latin-1"),
            start + 8,
            min(start + 8 + n_bytes, end),
            row_bytes,
            n_rows,
        )
        start += 8 + (n_bytes + 3) // 4 * 4


def _stream_rows(content: bytes, start: int, end: int, device: int) -> Iterator[GpsRows]:
    stream = _Stream()
    for key, kind, first, last, row_bytes, _ in _entries(content, start, end):
        value = content[first:last]
        if key == "GPS5":
            yield from _gps5(_numbers(value, kind), stream, device)
        elif key == "GPS9":
            yield from _gps9(_complex_rows(value, stream.types if kind == "?" else kind * 9, row_bytes), stream, device)
        else:
            _describe(stream, key, value, kind)


def _describe(stream: _Stream, key: str, value: bytes, kind: str) -> None:
    """Store an entry that describes the rows after it."""
    if key not in ("SCAL", "TYPE", "GPSF", "GPSP", "GPSU"):
        return
    numbers = _numbers(value, kind)
    if key == "SCAL":
        stream.scale = numbers if len(numbers) and (numbers != 0).all() else np.ones(1)
    elif key == "TYPE":
        stream.types = value.decode("latin-1")
    elif key == "GPSF":
        stream.fix = float(numbers[0]) if len(numbers) else 0.0
    elif key == "GPSP":
        stream.dop = float(numbers[0]) / 100 if len(numbers) else math.nan
    elif key == "GPSU":
        stream.utc_s = _utc_s(value.decode("latin-1"))


def _numbers(value: bytes, kind: str) -> FloatArray:
    """All values of an entry of a plain type; empty for another type."""
    if kind not in _TYPES:
        return np.empty(0)
    dtype = np.dtype(_TYPES[kind])
    numbers = np.frombuffer(value, dtype=dtype, count=len(value) // dtype.itemsize).astype(np.float64)
    return np.asarray(numbers / _FIXED_POINT.get(kind, 1.0))


def _complex_rows(value: bytes, types: str, row_bytes: int) -> FloatArray:
    """(N, M) rows of an entry with one type per column, such as "lllllllSS" or "l[7]S[2]"."""
    letters = re.sub(r"(.)\[(\d{1,2})\]", lambda match: match[1] * int(match[2]), types.strip("\0 ")[:64])
    if not 0 < len(letters) <= 64 or any(letter not in _TYPES for letter in letters):
        return np.empty((0, 0))
    dtype = _row_type(letters)
    if dtype.itemsize != row_bytes:
        return np.empty((0, 0))
    rows = np.frombuffer(value, dtype=dtype, count=len(value) // row_bytes)
    columns = [rows[str(i)].astype(float) / _FIXED_POINT.get(letter, 1.0) for i, letter in enumerate(letters)]
    return np.stack(columns, axis=1)


@cache
def _row_type(letters: str) -> np.dtype[Any]:
    return np.dtype([(str(i), _TYPES[letter]) for i, letter in enumerate(letters)])


def _gps5(numbers: FloatArray, stream: _Stream, device: int) -> Iterator[GpsRows]:
    values = _scaled(numbers[: len(numbers) // 5 * 5].reshape(-1, 5), stream.scale)
    n = len(values)
    if n:
        utc_s = np.full(n, np.nan)
        utc_s[0] = stream.utc_s
        yield GpsRows("GPS5", device, values, utc_s, np.full(n, stream.dop), np.full(n, stream.fix))


def _gps9(rows: FloatArray, stream: _Stream, device: int) -> Iterator[GpsRows]:
    if rows.ndim == 2 and len(rows) and rows.shape[1] >= 9:
        values = _scaled(rows[:, :9], stream.scale)
        utc_s = _YEAR_2000_S + values[:, 5] * _DAY_S + values[:, 6]
        yield GpsRows("GPS9", device, values[:, :5], utc_s, values[:, 7], values[:, 8])


def _scaled(values: FloatArray, scale: FloatArray) -> FloatArray:
    """Values divided by the entry SCAL, which has one number or one per column."""
    if len(scale) == 1 or len(scale) >= values.shape[1]:
        return np.asarray(values / scale[: values.shape[1]])
    return np.asarray(values / np.append(scale, np.ones(values.shape[1] - len(scale))))


def _utc_s(text: str) -> float:
    """Seconds since 1970 of a GPSU such as "170417173103.000"; NaN = it is none."""
    match = re.fullmatch(r"(\d\d)(\d\d)(\d\d)(\d\d)(\d\d)(\d\d(?:\.\d*)?)", text.strip("\0 "))
    return date_s(*(float(part) for part in match.groups())) if match else math.nan


def _track(payloads: list[tuple[float, float, list[GpsRows]]], clock: str) -> TelemetryTrack | None:
    """Telemetry of the payloads' start, duration and rows."""
    chosen = _best_stream([rows for _, _, streams in payloads for rows in streams])
    if chosen is None:
        return None
    parts = [(s, d, rows) for s, d, streams in payloads for rows in streams if (rows.key, rows.device) == chosen]
    starts_s = [float(rows.utc_s[0]) for _, _, rows in parts]
    samples: list[Sample] = []
    n_poor = 0
    for index, (start_s, duration_s, rows) in enumerate(parts):
        n = len(rows.values)
        utc_s = _all_utc_s(rows, starts_s[index + 1] if index + 1 < len(parts) else math.nan)
        time_s = start_s + np.arange(n) / n * duration_s if clock == "video" else utc_s
        has_fix = _has_fix(rows)
        n_poor += int((has_fix & (rows.dop > MAX_DOP)).sum())
        for i in range(n):
            latitude_deg, longitude_deg, _, speed_mps, _ = rows.values[i] if has_fix[i] else (math.nan,) * 5
            samples.append(
                Sample(
                    float(time_s[i]),
                    # without a fix, the camera's clock may be years off, which is no jump of the receiver's clock
                    float(utc_s[i]) if has_fix[i] or clock != "video" else math.nan,
                    float(speed_mps),
                    latitude_deg=float(latitude_deg),
                    longitude_deg=float(longitude_deg),
                )
            )
    notes: tuple[str, ...] = ()
    if n_poor:
        notes = (f"{n_poor} of {len(samples)} GPS samples have a dilution of precision over {MAX_DOP:g}.",)
    return track(samples, f"GoPro GPMF ({chosen[0]})", "video" if clock == "video" else "utc", notes=notes)


def _best_stream(all_rows: list[GpsRows]) -> tuple[str, int] | None:
    """Key and device of the stream with most fixes; GPS9, which states the fix of each row, before GPS5."""
    counts: dict[tuple[str, int], tuple[int, str, int]] = {}
    for rows in all_rows:
        n_fixes, _, n = counts.get((rows.key, rows.device), (0, "", 0))
        counts[rows.key, rows.device] = (n_fixes + int(_has_fix(rows).sum()), rows.key, n + len(rows.values))
    return max(counts, key=lambda stream: counts[stream]) if counts else None


def _has_fix(rows: GpsRows) -> BoolArray:
    """(N,) whether the receiver had a fix: without one GoPro repeats or extrapolates the last."""
    return (rows.fix >= MIN_FIX) & ~(rows.dop >= NO_FIX_DOP)


def _all_utc_s(rows: GpsRows, next_s: float) -> FloatArray:
    """(N,) date and time of rows; those of GPS5 are spread evenly until the next payload."""
    if rows.key == "GPS9":
        return rows.utc_s
    n = len(rows.values)
    duration_s = next_s - rows.utc_s[0]
    if not 0 < duration_s <= _MAX_PAYLOAD_S:
        duration_s = n / _RATE_HZ
    return np.asarray(rows.utc_s[0] + np.arange(n) / n * duration_s)
