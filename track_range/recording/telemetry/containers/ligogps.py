"""LIGOGPSINFO: lines of text such as `2026/08/03 11:34:53 N:48.100000 W:002.100000 19.0 km/h x:0.00
... A:212.0`.

They are in a trailer of the file in slots of 132 bytes, in a box `skip`, or in records that start
with `####`, which are encrypted: then the number before "km/h" is in knots, and the positions are
distorted. Times are local or UTC, as the camera is set. Layouts and encryption after ExifTool's
documentation (exiftool.org, LIGO tags).
"""

import math
import re
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np

from track_range.foundation.files.numeric_text import number
from track_range.recording.telemetry.containers.mp4_boxes import Movie, read_at
from track_range.recording.telemetry.tracks.positions import MPS_PER_UNIT
from track_range.recording.telemetry.tracks.samples import (
    MAX_SAMPLES,
    Sample,
    Unit,
    date_s,
    degrees,
    signed,
    track,
)
from track_range.recording.telemetry.tracks.track import TelemetryTrack

_MAX_BYTES = 16_000_000  # size limit of the trailer; 33 hours at 1 Hz
_SLOT_BYTES = 132  # size of a slot or record: 4 bytes of number, then text or encrypted text
_TERMINATORS = (b"####", b"&&&&")  # marks before the length at the end of a trailer

_LINE = re.compile(
    rb"(\d{4})/(\d\d)/(\d\d)[ _](\d\d):(\d\d):(\d\d)\s+([NS]):(-?[\d.]+)\s+([EW]):(-?[\d.]+)\s+(-?[\d.]+)"
    rb"(?: km/h)?([^\0\n]*)"
)
_COURSE = re.compile(rb"\bA:(\d+(?:\.\d+)?)")
_JSON = re.compile(rb"LIGOGPSINFO (\{[^}]{20,1000}\})")
_FIELD = re.compile(rb'"(\w{1,20})"\s*:\s*"?([-+.\w]{1,20})')
# encrypted speeds are too small by this factor, besides being in knots
_SPEED_SCALE = 1.85407333 / 1.852


def read_ligogps(file: BinaryIO, movie: Movie, _path: Path) -> TelemetryTrack | None:
    """Telemetry of the trailer or of a box of a movie; None = there is none."""
    for content in _contents(file, movie):
        if lines := [_sample(match) for match in _LINE.finditer(content)]:
            return _track(lines, "assumed")
        starts = (match.start() for match in islice(re.finditer(rb"####", content), MAX_SAMPLES))
        records = (parse_ligo_record(content[start : start + _SLOT_BYTES]) for start in starts)
        encrypted = [sample for sample in records if sample]
        texts = [_from_json(match[1]) for match in _JSON.finditer(content)]
        if encrypted or texts:
            return _track(encrypted or texts, "known")
    return None


def _contents(file: BinaryIO, movie: Movie) -> Iterator[bytes]:
    end = read_at(file, movie.n_bytes - 8, 8)
    n_bytes = int.from_bytes(end[4:], "big")
    if end[:4] in _TERMINATORS and 16 <= n_bytes <= min(movie.n_bytes, _MAX_BYTES):
        yield read_at(file, movie.n_bytes - n_bytes, n_bytes)
    for box in movie.top:
        if box.type in (b"skip", b"SKIP", b"free") and b"GPSINFO" in read_at(file, box.start, 24):
            yield read_at(file, box.start, min(box.end - box.start, _MAX_BYTES))
    for content in movie.inner.values():
        if b"LIGOGPSINFO" in content[:65_536]:
            yield content[:_MAX_BYTES]


def _track(samples: Sequence[Sample], unit: Unit) -> TelemetryTrack | None:
    """Telemetry of samples at 1 Hz from the start of the video, timed by their own clock if it does
    not jump.
    """
    utc_s = np.array([sample.utc_s for sample in samples])
    is_steady = bool(
        np.isfinite(utc_s).all()
        and (np.diff(utc_s) >= 0).all()
        and utc_s[-1] - utc_s[0] < 2 * len(utc_s)
    )
    time_s = utc_s - utc_s[0] if is_steady else np.arange(len(utc_s), dtype=float)
    timed = [sample.at(second) for sample, second in zip(samples, time_s.tolist(), strict=True)]
    return track(timed, "LIGO GPS", unit=unit)


def parse_ligo_text(content: bytes) -> Sample | None:
    """Sample of the first line in a content; None = there is none."""
    match = _LINE.search(content)
    return _sample(match) if match else None


def _sample(match: re.Match[bytes]) -> Sample:
    utc_s = date_s(*(int(match[i]) for i in range(1, 7)))
    course = _COURSE.search(match[12])
    north, latitude, east, longitude, kmh = (match[i].decode() for i in range(7, 12))
    latitude_deg, longitude_deg = _coordinate(latitude, north), _coordinate(longitude, east)
    if latitude_deg == 0 and longitude_deg == 0:
        return Sample(utc_s=utc_s)
    course_deg = float(course[1]) if course else math.nan
    return Sample(
        math.nan, utc_s, number(kmh) * MPS_PER_UNIT["km/h"], course_deg, latitude_deg, longitude_deg
    )


def _coordinate(text: str, hemisphere: str) -> float:
    """Degrees of a coordinate, negative in the south and west; numbers above 180 are degrees and
    minutes.
    """
    value = number(text)
    return signed(degrees(value) if abs(value) > 180 else value, hemisphere)


def parse_ligo_record(record: bytes) -> Sample | None:
    """Sample of a record that starts with `####`, with the speed in m/s and without position; None
    = unreadable.
    """
    if record[:4] != b"####":
        return None
    text = _decrypted(record[8 : 8 + min(int.from_bytes(record[4:8], "little"), _SLOT_BYTES - 8)])
    match = _LINE.search(text)
    if match is None:
        return None
    sample = _sample(match)
    speed_mps = number(match[11].decode()) * MPS_PER_UNIT["kn"] * _SPEED_SCALE
    return (
        Sample(math.nan, sample.utc_s, speed_mps, sample.course_deg)
        if math.isfinite(sample.speed_mps)
        else sample
    )


_MASKS: dict[int, tuple[int | None, ...]] = {
    2: (None, 0x01, 0x06, 0x18),
    3: (0x03, None, 0x04, 0x18),
    4: (0x03, 0x0C, None, 0x10),
    5: (0x01, 0x06, 0x18, None),
    6: (0x01, 0x02, 0x0C, 0x30),
    7: (0x01, 0x02, 0x0C, 0x30),
}
"""Bits of the control byte that belong to each of the four characters after it, by its upper three
bits; None = the character is a space that takes no byte."""


def _decrypted(content: bytes) -> bytes:
    """Text of an encrypted record: groups of a control byte and up to four bytes."""
    text = bytearray()
    start = 0
    while start < len(content):
        control = content[start]
        start += 1
        masks = _MASKS.get(control >> 5)
        if masks is None:  # one byte, of which two bits are in the control byte
            if control >> 5 != 0 or start >= len(content):
                break
            text.append(content[start] | control & 0x13)
            start += 1
            continue
        for mask in masks:
            if mask is None:
                text.append(0x20)
            elif start < len(content):
                text.append(_decrypted_byte(content[start], control, mask))
                start += 1
    return bytes(text)


def _decrypted_byte(byte: int, control: int, mask: int) -> int:
    """A byte with the bits of `mask` from the control byte."""
    if mask == 0x30:  # includes the bit that is inverted
        return byte ^ 0x20 | control & mask
    return (byte | control & mask) ^ 0x20


def _from_json(content: bytes) -> Sample:
    """Sample of the variant in JSON (Yada RoadCam): date and time in UTC, speed in knots."""
    fields = {key.decode(): value.decode() for key, value in _FIELD.findall(content)}

    def text(name: str) -> str:
        return str(fields.get(name, ""))

    utc_s = date_s(
        *(number(text(name)) for name in ("Year", "Month", "Day", "Hour", "Minute", "Second"))
    )
    if text("status") != "A":
        return Sample(utc_s=utc_s)
    latitude_deg, longitude_deg = (
        _coordinate(text("Latitude"), text("NS")),
        _coordinate(text("Longitude"), text("EW")),
    )
    return Sample(
        math.nan,
        utc_s,
        number(text("Speed")) * MPS_PER_UNIT["kn"],
        math.nan,
        latitude_deg,
        longitude_deg,
    )
