"""Subtitle and metadata tracks of dashcams: RMC sentences and the makers' own texts and records,
timed by the track.

Thinkware, Nextbase and many others write RMC sentences; Garmin, DJI, Kingslim, Rove, Neoline and
Vantrue's N2S have their own forms, as ExifTool's documentation of QuickTime streams lists them
(exiftool.org).
"""

import math
import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO, NamedTuple

from track_range.recording.telemetry.containers.free_gps import parse_free_gps
from track_range.recording.telemetry.containers.ligogps import parse_ligo_text
from track_range.recording.telemetry.containers.mp4_boxes import Movie, Track, read_samples
from track_range.recording.telemetry.sidecars.nmea import has_rmc, rmc_samples
from track_range.recording.telemetry.sidecars.srt import subtitle_track
from track_range.recording.telemetry.tracks.positions import MPS_PER_UNIT
from track_range.recording.telemetry.tracks.samples import (
    MAX_SAMPLES,
    Sample,
    Unit,
    date_s,
    degrees,
    on_receiver_clock,
    signed,
    track,
)
from track_range.recording.telemetry.tracks.track import TelemetryTrack

MAX_TEXT_BYTES = 4096  # bytes of a sample that are read
# number of samples at the start of a track in which the first record must be found
_PROBED_SAMPLES = 600

_HANDLERS = (b"sbtl", b"text", b"subt", b"clcp", b"data", b"meta", b"camm", b"hint")
_FORMATS = (b"tx3g", b"text", b"sbtt", b"mett", b"camm", b"gpmd", b"ssmd")
_NO_COORDINATE = 4294967295.0  # coordinate of 32- and 40-byte records without a fix

# a sample has some 150 characters between position and speed
_DJI = re.compile(rb"GPS ?\([-+.\d]++, ?[-+.\d]++[^)]*+\).{0,1000}?H\.S [-+.\d]++m/s", re.DOTALL)


def read_text_tracks(file: BinaryIO, movie: Movie, path: Path) -> TelemetryTrack | None:
    """Telemetry of the first track of a movie with readable records; None = there is none."""
    parts = [part for part in movie.tracks if part.handler in _HANDLERS or part.format in _FORMATS]
    return next(
        (telemetry for part in parts if (telemetry := _read_track(file, movie, part, path))), None
    )


def _read_track(file: BinaryIO, movie: Movie, part: Track, path: Path) -> TelemetryTrack | None:
    times_s: list[float] = []
    texts: list[bytes] = []
    form: _Form | None = None
    for index, content in read_samples(
        file, part, range(min(len(part), MAX_SAMPLES)), MAX_TEXT_BYTES
    ):
        text = _plain(content)
        form = form or next((known for known in _FORMS if known.read(text) is not None), None)
        if form is None and index >= _PROBED_SAMPLES:
            return None
        if form is not None and (form is not _RMC or has_rmc(text)):
            times_s.append(float(part.time_s[index]) - movie.start_s)
            texts.append(text)
    if form is None:
        return None
    if form is _DJI_TEXTS:
        return _dji_track(texts, times_s, path)
    read = rmc_samples(texts, str(path)) if form is _RMC else [form.read(text) for text in texts]
    samples = [sample.at(time_s) for sample, time_s in zip(read, times_s, strict=True) if sample]
    if movie.video is None:
        samples = on_receiver_clock(samples)
    return track(samples, form.name, unit=form.unit)


def _plain(content: bytes) -> bytes:
    """Text of a sample without its length before and the box `encd` after it, in plain
    characters.
    """
    content = content.removesuffix(b"\0\0\0\x0cencd\0\0\x01\0")
    if len(content) >= 2 and int.from_bytes(content[:2], "big") == len(content) - 2:
        content = content[2:]
    # E-PRANCE: all characters are shifted
    if content[:1] == b"\0" and content[-1:] == b"\n" and len(content) > 5:
        shift = ord("*") - content[-4]
        shifted = bytes((byte + shift) & 0xFF for byte in content[1:-1])
        return shifted if has_rmc(shifted) else content
    return content


def _has_rmc(text: bytes) -> Sample | None:
    """A sample if there is an RMC sentence: sentences are read together, by `rmc_samples`."""
    return Sample() if has_rmc(text) else None


def _garmin(text: bytes) -> Sample | None:
    """Garmin Dash Cam: PNDM, speed in miles per hour, coordinates in units of 180 / 2^31 degrees;
    big-endian.
    """
    start = 4 if text[4:8] == b"PNDM" else 0
    if text[start : start + 4] != b"PNDM" or len(text) < start + 20:
        return None
    speed, latitude, longitude = struct.unpack_from(">Hxxii", text, start + 8)
    if latitude == 0 and longitude == 0:
        return Sample()
    position_deg = latitude * 180 / 2**31, longitude * 180 / 2**31
    return Sample(math.nan, math.nan, speed * MPS_PER_UNIT["mph"], math.nan, *position_deg)


def _dji_track(
    texts: Sequence[bytes], times_s: Sequence[float], path: Path
) -> TelemetryTrack | None:
    subtitles = subtitle_track([text.decode("utf-8", "replace") for text in texts], times_s, path)
    return None if subtitles is None else replace(subtitles, source=_DJI_TEXTS.name)


def _has_dji(text: bytes) -> Sample | None:
    """A sample if there is a text of DJI: texts are read together, as subtitles beside a video."""
    return Sample() if _DJI.search(text) else None


def _kingslim(text: bytes) -> Sample | None:
    """Kingslim D4: the short layout of `freeGPS` records without header."""
    if not re.match(rb".{24}[AV][NS0][EW0]", text, re.DOTALL) or len(text) < 44:
        return None
    record = parse_free_gps(bytes(16) + text)
    return record.samples[0] if record else None


def _vantrue(text: bytes) -> Sample | None:
    """Vantrue N2S: FMAS, date and time at 0x60, status and hemispheres at 0x78, speed in miles per
    hour at 0x86.
    """
    if text[:4] != b"FMAS" or len(text) < 0x8C or text[0x50:0x54] != b"SAMM":
        return None
    year, month, day, hour, minute, second = struct.unpack_from("<HBBBBB", text, 0x60)[:6]
    utc_s = date_s(year, month, day, hour, minute, second)
    (
        status,
        east,
        north,
        east_deg,
        east_min,
        _,
        east_part,
        north_deg,
        north_min,
        north_part,
        mph,
        course_deg,
    ) = struct.unpack_from("<cccBBBHBBHHH", text, 0x78)
    if status != b"A":
        return Sample(utc_s=utc_s)
    longitude_deg = east_deg + (east_min + east_part / 6000) / 60
    latitude_deg = north_deg + (north_min + north_part / 6000) / 60
    position_deg = (
        signed(latitude_deg, north.decode("latin-1")),
        signed(longitude_deg, east.decode("latin-1")),
    )
    return Sample(math.nan, utc_s, mph * MPS_PER_UNIT["mph"], course_deg % 360, *position_deg)


def _rove(text: bytes) -> Sample | None:
    """Rove R2-4K (32 bytes; knots, years since 2000) and Neoline (40 bytes; km/h, years since
    1900).
    """
    if len(text) not in (32, 40):
        return None
    latitude, longitude, _, speed, year, month, day, hour, minute, second, half_course = (
        struct.unpack_from("<ddiH6BB", text)
    )
    utc_s = date_s(year + (1900 if year >= 100 else 2000), month, day, hour, minute, second)
    if not math.isfinite(utc_s) or not all(math.isfinite(value) for value in (latitude, longitude)):
        return None
    if latitude == _NO_COORDINATE or longitude == _NO_COORDINATE or speed == 0xFFFF:
        return Sample()  # its time comes from the camera, in another time zone
    is_plain = abs(latitude) <= 90 and abs(longitude) <= 180 and len(text) == 40
    speed_mps = speed * MPS_PER_UNIT["km/h" if len(text) == 40 else "kn"]
    course_deg = math.nan if half_course == 0xFF else half_course * 2.0 % 360
    position_deg = (latitude, longitude) if is_plain else (degrees(latitude), degrees(longitude))
    return Sample(math.nan, utc_s, speed_mps, course_deg, *position_deg)


class _Form(NamedTuple):
    """A form of records: its reader, which returns None for other records, name of the source, and
    unit of speed.
    """

    read: Callable[[bytes], Sample | None]
    name: str
    unit: Unit = "known"


_RMC = _Form(_has_rmc, "NMEA subtitles")
_DJI_TEXTS = _Form(_has_dji, "DJI subtitles")
_FORMS = (  # in the order in which they are tried
    _RMC,
    _Form(_garmin, "Garmin dashcam"),
    _DJI_TEXTS,
    _Form(parse_ligo_text, "LIGO GPS", "assumed"),
    _Form(_vantrue, "Vantrue dashcam"),
    _Form(_kingslim, "Kingslim dashcam"),
    _Form(_rove, "SigmaStar dashcam"),
)
