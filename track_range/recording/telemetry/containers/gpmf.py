"""GoPro's telemetry format GPMF: the streams GPS5 and GPS9 of the track `gpmd`, or payloads alone in a file.

Format: github.com/gopro/gpmf-parser. A payload holds devices (DEVC) with streams (STRM); an entry has a key of four
characters, the type of its values, the size and the number of its rows, all big-endian, and is padded to four bytes.

GPS5  latitude, longitude, altitude, horizontal speed, speed in space; with GPSF (fix), GPSP (dilution of precision)
      and GPSU (date and time in UTC) for the payload; HERO5 to HERO10, Fusion, MAX
GPS9  as GPS5, then days since 2000, seconds of the day, dilution of precision and fix of each row; since HERO11
"""

import math
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.recording.telemetry.containers.mp4_boxes import Movie, read_samples
from track_range.recording.telemetry.tracks.samples import MAX_SAMPLES, Sample, date_s, track
from track_range.recording.telemetry.tracks.track import Clock, TelemetryTrack

# size limit of a payload, which covers about one second; GoPro's have 10 to 100 kB
MAX_PAYLOAD_BYTES = 1_000_000
_PROBED_PAYLOADS = 60  # payloads without GPS rows after which a file counts as one without GPS
_MIN_FIX = 2  # smallest GPSF with a fix: 0 = none, 2 = two-dimensional, 3 = three-dimensional
# dilution of precision above which positions count as poor, as usual; GoPro recommends 5
_MAX_DOP = 10.0
_NO_FIX_DOP = 99.99  # dilution of precision that GoPro writes without a fix (GPSP 9999)
_MAX_ENTRIES = 20_000  # largest number of entries read on one level; a payload has about 500
_RATE_HZ = 18.0  # nominal rate of GPS5, for payloads without a duration
_MAX_PAYLOAD_S = 3.0  # longest time between two payloads that is taken as the duration of the first

_YEAR_2000_S = date_s(2000, 1, 1, 0, 0, 0)
_TYPES = {
    "b": ">i1", "B": ">u1", "s": ">i2", "S": ">u2", "l": ">i4", "L": ">u4", "j": ">i8", "J": ">u8", "f": ">f4",
    "d": ">f8", "q": ">i4", "Q": ">i8",
}  # fmt: skip
_FIXED_POINT = {"q": 2.0**16, "Q": 2.0**32}  # divisor of the fixed-point types


class GpsRows(NamedTuple):
    """Rows of one GPS stream of one payload."""

    key: str  # "GPS5" or "GPS9"
    device: int  # number of the device
    # (N, 5) latitude and longitude in degrees, altitude in m, horizontal speed and speed in space
    # in m/s
    values: FloatArray
    # (N,) seconds since 1970; in GPS5 only the first is known, the others are NaN
    utc_s: FloatArray
    dop: FloatArray  # (N,) dilution of precision
    # (N,) whether the receiver had a fix: without one GoPro repeats or extrapolates the last
    has_fix: BoolArray


_Payload = tuple[float, float, list[GpsRows]]  # start and duration in s, NaN = unknown, and rows


def read_gpmf(file: BinaryIO, movie: Movie, _path: Path) -> TelemetryTrack | None:
    """Telemetry of the track `gpmd` of a movie; None = it has no GPS stream."""
    source = next((part for part in movie.tracks if part.format == b"gpmd"), None)
    if source is None:
        return None
    payloads: list[_Payload] = []
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


def read_bare_gpmf(content: bytes) -> TelemetryTrack | None:
    """Telemetry of payloads alone, timed by their GPSU or GPS9; None = there is no GPS stream."""
    return _track([(math.nan, math.nan, [rows]) for rows in gps_rows(content)], "utc")


def gps_rows(content: bytes) -> Iterator[GpsRows]:
    """GPS rows of all devices and streams in one or more payloads."""
    device = 0
    for key, letter, start, end, _ in _entries(content, 0, len(content)):
        if key != "DEVC" or letter != "\0":
            continue
        for part, part_letter, part_start, part_end, _ in _entries(content, start, end):
            if part == "DVID" and part_end - part_start >= 4:
                device = int.from_bytes(content[part_start : part_start + 4], "big")
            elif (
                part == "STRM"
                and part_letter == "\0"
                and content.find(b"GPS", part_start, part_end) >= 0
            ):
                yield from _stream_rows(content, part_start, part_end, device)


def _entries(content: bytes, start: int, end: int) -> Iterator[tuple[str, str, int, int, int]]:
    """Key, letter of the type, start and end of the values, and size of a row of each entry."""
    for _ in range(_MAX_ENTRIES):
        if start + 8 > end:
            return
        name, letter, row_bytes, n_rows = struct.unpack_from(">4scBH", content, start)
        if not name.strip(b"\0"):
            return
        stop = start + 8 + row_bytes * n_rows
        yield name.decode("latin-1"), letter.decode("latin-1"), start + 8, min(stop, end), row_bytes
        start = start + 8 + (row_bytes * n_rows + 3) // 4 * 4


class _Stream:
    """A stream of a payload: its entries state the scale, types, fix, precision and time of the rows
    that follow them.
    """

    def __init__(self, device: int) -> None:
        self._device = device
        self._scale: FloatArray = np.ones(1)
        self._types, self._fix, self._dop, self._utc_s = "", 3.0, math.nan, math.nan

    def state(self, key: str, value: bytes, letter: str) -> None:
        """Store what an entry states about the next rows."""
        if key == "TYPE":
            self._types = value.decode("latin-1")
        elif key == "GPSU":
            self._utc_s = _utc_s(value.decode("latin-1"))
        elif key in ("SCAL", "GPSF", "GPSP"):
            numbers = _complex_rows(value, letter, 0)[:, 0]
            self._state_number(key, numbers)

    def _state_number(self, key: str, numbers: FloatArray) -> None:
        n = len(numbers)
        if key == "SCAL":
            self._scale = numbers if n and (numbers != 0).all() else np.ones(1)
        elif key == "GPSF":
            self._fix = float(numbers[0]) if n else 0.0
        else:
            self._dop = float(numbers[0]) / 100 if n else math.nan

    def gps9(self, value: bytes, letter: str, row_bytes: int) -> GpsRows | None:
        """Rows with a time, a precision and a fix each; None = the entry has none."""
        rows = _complex_rows(value, self._types if letter == "?" else letter * 9, row_bytes)
        if not len(rows) or rows.shape[1] < 9:
            return None
        values = _scaled(rows[:, :9], self._scale)
        times_s = _YEAR_2000_S + values[:, 5] * 86_400.0 + values[:, 6]
        has_fix = (values[:, 8] >= _MIN_FIX) & ~(values[:, 7] >= _NO_FIX_DOP)
        return GpsRows("GPS9", self._device, values[:, :5], times_s, values[:, 7], has_fix)

    def gps5(self, value: bytes, letter: str) -> GpsRows | None:
        """Rows of which the first has the time of the payload; None = the entry has none."""
        numbers = _complex_rows(value, letter, 0)[:, 0]
        n = len(numbers) // 5
        if not n:
            return None
        values = _scaled(numbers[: 5 * n].reshape(n, 5), self._scale)
        times_s = np.append(self._utc_s, np.full(n - 1, np.nan))
        has_fix = np.full(n, self._fix >= _MIN_FIX and not self._dop >= _NO_FIX_DOP)
        return GpsRows("GPS5", self._device, values, times_s, np.full(n, self._dop), has_fix)


def _stream_rows(content: bytes, start: int, end: int, device: int) -> Iterator[GpsRows]:
    """GPS rows of a stream."""
    stream = _Stream(device)
    for key, letter, first, last, row_bytes in _entries(content, start, end):
        value, rows = content[first:last], None
        if key == "GPS9":
            rows = stream.gps9(value, letter, row_bytes)
        elif key == "GPS5":
            rows = stream.gps5(value, letter)
        else:
            stream.state(key, value, letter)
        if rows is not None:
            yield rows


def _complex_rows(value: bytes, types: str, row_bytes: int) -> FloatArray:
    """(N, M) rows of an entry with one type per column, such as "lllllllSS" or "l[7]S[2]";
    `row_bytes` 0 = any.
    """
    letters = re.sub(
        r"(.)\[(\d{1,2})\]", lambda match: match[1] * int(match[2]), types.strip("\0 ")[:64]
    )
    if not 0 < len(letters) <= 64 or any(letter not in _TYPES for letter in letters):
        return np.empty((0, 1))
    dtype = np.dtype([(str(i), _TYPES[letter]) for i, letter in enumerate(letters)])
    if row_bytes not in (0, dtype.itemsize):
        return np.empty((0, 1))
    rows = np.frombuffer(value, dtype=dtype, count=len(value) // dtype.itemsize)
    columns = [
        rows[str(i)].astype(float) / _FIXED_POINT.get(letter, 1.0)
        for i, letter in enumerate(letters)
    ]
    return np.stack(columns, axis=1)


def _scaled(values: FloatArray, scale: FloatArray) -> FloatArray:
    """Values divided by the entry SCAL, which has one number or one per column."""
    n = values.shape[1]
    divisor = (
        scale[:n] if len(scale) == 1 else np.append(scale, np.ones(max(n - len(scale), 0)))[:n]
    )
    return np.asarray(values / divisor)


def _utc_s(text: str) -> float:
    """Seconds since 1970 of a GPSU such as "170417173103.000"; NaN = invalid."""
    match = re.fullmatch(r"(\d\d)(\d\d)(\d\d)(\d\d)(\d\d)(\d\d(?:\.\d*)?)", text.strip("\0 "))
    return date_s(*(float(part) for part in match.groups())) if match else math.nan


def _track(payloads: list[_Payload], clock: Clock) -> TelemetryTrack | None:
    """Telemetry of the stream with most fixes; GPS9, which states the fix of each row, before
    GPS5.
    """
    counts: dict[tuple[str, int], tuple[int, str, int]] = {}
    for rows in (rows for _, _, streams in payloads for rows in streams):
        n_fixes, _, n = counts.get((rows.key, rows.device), (0, "", 0))
        counts[rows.key, rows.device] = (
            n_fixes + int(rows.has_fix.sum()),
            rows.key,
            n + len(rows.values),
        )
    if not counts:
        return None
    chosen = max(counts, key=lambda stream: counts[stream])
    parts = [
        (s, d, rows)
        for s, d, streams in payloads
        for rows in streams
        if (rows.key, rows.device) == chosen
    ]
    starts_s = [*(float(rows.utc_s[0]) for _, _, rows in parts), math.nan]
    samples: list[Sample] = []
    n_poor = 0
    for index, (start_s, duration_s, rows) in enumerate(parts):
        n = len(rows.values)
        utc_s = (
            rows.utc_s if rows.key == "GPS9" else _spread_s(starts_s[index], starts_s[index + 1], n)
        )
        time_s = start_s + np.arange(n) / n * duration_s if clock == "video" else utc_s
        n_poor += int((rows.has_fix & (rows.dop > _MAX_DOP)).sum())
        # without a fix, the camera's clock may be years off, which is no jump of the receiver's
        # clock
        dated_s = np.where(rows.has_fix, utc_s, np.nan) if clock == "video" else utc_s
        values = np.where(rows.has_fix[:, None], rows.values, np.nan)[:, [3, 0, 1]]
        columns = zip(time_s.tolist(), dated_s.tolist(), values.tolist(), strict=True)
        samples += [
            Sample(time, utc, mps, math.nan, *position_deg)
            for time, utc, (mps, *position_deg) in columns
        ]
    notes: tuple[str, ...] = ()
    if n_poor:
        notes = (
            f"{n_poor} of {len(samples)} GPS samples have a dilution of precision over {_MAX_DOP:g}.",
        )
    return track(samples, f"GoPro GPMF ({chosen[0]})", clock, notes=notes)


def _spread_s(start_s: float, next_s: float, n: int) -> FloatArray:
    """(n,) times of the rows of a payload of GPS5, spread evenly until the next payload."""
    duration_s = next_s - start_s
    if not 0 < duration_s <= _MAX_PAYLOAD_S:
        duration_s = n / _RATE_HZ
    return np.asarray(start_s + np.arange(n) / n * duration_s)
