"""NMEA 0183: sentences RMC in text files, subtitles and records; speed in knots, course, date and
time in UTC.

Files without RMC are read from GGA (time of the day, position), VTG (speed, course) and ZDA (date).
"""

import math
import re
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from functools import reduce
from operator import xor
from pathlib import Path
from typing import Any

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import read_text
from track_range.foundation.files.numeric_text import plain_number
from track_range.recording.telemetry.sidecars.sidecar import Sidecar, of_file
from track_range.recording.telemetry.sidecars.time_texts import DAY_S, unwrapped
from track_range.recording.telemetry.tracks.positions import MPS_PER_UNIT, speed_from_positions
from track_range.recording.telemetry.tracks.samples import Sample, plain_track, track
from track_range.recording.telemetry.tracks.track import (
    MAX_SIDECAR_BYTES,
    TelemetryError,
    TelemetryTrack,
    optional_package,
)

# of any satellite system
_RMC = re.compile(r"\$[A-Z]{2}RMC,[^$*\r\n]{10,90}(?:\*([0-9A-Fa-f]{2}))?")

_OTHERS = re.compile(r"\$[A-Z]{2}(GGA|VTG|ZDA),[^$*\r\n]{6,110}(?:\*[0-9A-Fa-f]{2})?")

_RMC_IN_RECORD = re.compile(rb"([A-Z]{2}RMC,[ -#%-)+-:<-~]{6,90}(?:\*[0-9A-Fa-f]{2})?)")
"""RMC sentence in a record; the dollar sign is missing in some subtitles."""

# of right checksums, above which wrong ones are dropped; some programs never correct any
_MIN_RIGHT_FRACTION = 0.5


def read_nmea(path: Path) -> TelemetryTrack | None:
    """Telemetry of a file of NMEA sentences with their own date and time; None = it has none.

    BlackVue's files .gps have the camera's clock, in local time, before each sentence, which is not
    used. Raises TelemetryError if it cannot be read, or pynmea2 is not installed.
    """
    text = read_text(path, TelemetryError, "NMEA sentences", max_bytes=MAX_SIDECAR_BYTES)
    fixes = [fix for fix in fixes_in(text.splitlines(), str(path)) if fix is not None]
    if not fixes:
        return _without_rmc(text.splitlines(), path)
    dated = [fix.at(fix.utc_s) for fix in fixes if math.isfinite(fix.utc_s)]
    return plain_track(dated, path.name, "utc", unit="kn") if dated else None


def _without_rmc(lines: Iterable[str], path: Path) -> TelemetryTrack | None:
    """Telemetry of the sentences GGA, VTG and ZDA of a file; None = it has no GGA.

    Times are times of the day if no ZDA states the date.
    """
    sentences = [match for line in lines if (match := _OTHERS.search(line)) is not None]
    if not any(match[1] == "GGA" for match in sentences):
        return None
    pynmea2 = optional_package("pynmea2", str(path))
    kinds: list[str] = []
    rows: list[tuple[float, float, float]] = []
    for match in sentences:
        try:
            rows.append(_values(match[1], pynmea2.parse(match.group().partition("*")[0])))
            kinds.append(match[1])
        except (ValueError, OverflowError, AttributeError, LookupError, TypeError):
            continue
    kind = np.array(kinds)
    if "GGA" not in kinds:
        return None
    clock_s, first, second = np.array(rows).T
    clock_s = unwrapped(clock_s)
    dated = np.flatnonzero(kind == "ZDA")
    day_s = first[dated[0]] - clock_s[dated[0]] // DAY_S * DAY_S if len(dated) else 0.0
    is_speed, is_fix = kind == "VTG", kind == "GGA"
    fixes = np.column_stack([clock_s, first, second])[is_fix]
    fix_s, lat, lon = fixes.T
    positions = speed_from_positions(fix_s, lat, lon, np.full(len(fixes), np.nan))
    moments_s = _moments_s(clock_s, first[is_speed], kinds, positions).tolist()
    speeds = zip(first[is_speed].tolist(), second[is_speed].tolist(), strict=True)
    speed_at = dict(zip(moments_s, speeds, strict=True))
    samples = [
        Sample(time_s + day_s, time_s + day_s, *speed_at.get(time_s, (math.nan, math.nan)), *place)
        for time_s, *place in fixes.tolist()
        if time_s in speed_at or not speed_at  # positions may come more often than speeds
    ]
    has_speed = any(math.isfinite(sample.speed_mps) for sample in samples)
    return track(samples, path.name, "utc", has_own_speed=has_speed)


def _values(kind: str, message: Any) -> tuple[float, float, float]:
    """Time of the day, s, with latitude and longitude of a GGA, or the date of a ZDA, s since 1970;
    speed in m/s and course of a VTG.
    """
    if kind == "VTG":
        speed_mps = plain_number(message.spd_over_grnd_kmph) * MPS_PER_UNIT["km/h"]
        if math.isnan(speed_mps) and message.spd_over_grnd_kts is not None:
            speed_mps = float(message.spd_over_grnd_kts) * MPS_PER_UNIT["kn"]
        return math.nan, speed_mps, plain_number(message.true_track)
    t = message.timestamp
    clock_s = 3600 * t.hour + 60 * t.minute + t.second + t.microsecond / 1e6
    if kind == "ZDA":
        day = datetime(message.year, message.month, message.day, tzinfo=UTC)
        return clock_s, day.timestamp(), math.nan
    if message.gps_qual and message.lat and message.lon:
        return clock_s, float(message.latitude), float(message.longitude)
    return clock_s, math.nan, math.nan


def _moments_s(
    clock_s: FloatArray,
    speed_mps: FloatArray,
    kinds: Sequence[str],
    positions: TelemetryTrack | None,
) -> FloatArray:
    """Times of the speeds, which state none: of the sentence before each, or of that after it if
    bursts begin with the speed, as the file does. Of a file that begins and ends with a speed, one
    burst is cut: the positions show which.
    """
    is_timed, is_speed = np.isfinite(clock_s), np.array(kinds) == "VTG"
    times_s = np.concatenate([[-np.inf], clock_s[is_timed], [np.inf]])
    n_before = np.cumsum(is_timed)[is_speed]
    before_s, after_s = times_s[n_before], times_s[n_before + 1]
    is_first = kinds[0] == "VTG"
    if is_first and kinds[-1] == "VTG":
        is_first = _error_mps(positions, after_s, speed_mps) < _error_mps(
            positions, before_s, speed_mps
        )
    return np.asarray(after_s if is_first else before_s)


def _error_mps(
    positions: TelemetryTrack | None, time_s: FloatArray, speed_mps: FloatArray
) -> float:
    """Mean difference of speeds at these times to those of the positions; NaN = unknown."""
    known = np.isfinite(time_s) & np.isfinite(speed_mps)
    if positions is None or not known.any():
        return math.nan
    expected_mps = np.interp(positions.time_s, time_s[known], speed_mps[known])
    return float(np.abs(expected_mps - positions.speed_mps).mean())


def has_rmc(content: bytes) -> bool:
    """Whether a record of a video file has an RMC sentence."""
    return b"RMC," in content and _RMC_IN_RECORD.search(content) is not None


def rmc_samples(contents: Iterable[bytes], source: str) -> list[Sample | None]:
    """The first RMC sentence of each record of a video file; see `fixes_in`."""
    matches = [_RMC_IN_RECORD.search(content) for content in contents]
    return fixes_in(
        ["$" + match[1].decode("ascii").rstrip(";") if match else "" for match in matches], source
    )


def fixes_in(texts: Iterable[str], source: str) -> list[Sample | None]:
    """The first RMC sentence in each text, without time in the video; None if it has none. Needs
    pynmea2.
    """
    matches = [_RMC.search(text) for text in texts]
    if not any(matches):
        return [None] * len(matches)
    checked = [_is_right(match.group()) for match in matches if match and match[1]]
    needs_right = bool(checked) and sum(checked) >= _MIN_RIGHT_FRACTION * len(checked)
    pynmea2 = optional_package("pynmea2", source)
    return [
        None
        if match is None or (needs_right and match[1] and not _is_right(match.group()))
        else _fix(pynmea2, match.group().partition("*")[0])
        for match in matches
    ]


def _is_right(sentence: str) -> bool:
    """Whether the checksum of a sentence, the exclusive or of its characters, is right."""
    content, _, stated = sentence[1:].partition("*")
    return reduce(xor, map(ord, content), 0) == int(stated, 16)


def _fix(pynmea2: Any, sentence: str) -> Sample | None:
    """Content of a sentence without checksum; None = it cannot be read."""
    try:
        message = pynmea2.parse(sentence)
        day, clock, status = message.datestamp, message.timestamp, message.status
    except (ValueError, AttributeError, LookupError):
        return None
    utc_s = latitude_deg = longitude_deg = math.nan
    if day and clock and not isinstance(day, str) and not isinstance(clock, str):
        utc_s = datetime.combine(day, clock.replace(tzinfo=None), UTC).timestamp()
    if status != "A":
        return Sample(utc_s=utc_s)
    try:
        if message.lat and message.lon:
            latitude_deg, longitude_deg = float(message.latitude), float(message.longitude)
    except (ValueError, TypeError, AttributeError):
        latitude_deg = longitude_deg = math.nan
    speed_kn, course_deg = plain_number(message.spd_over_grnd), plain_number(message.true_course)
    return Sample(
        math.nan, utc_s, speed_kn * MPS_PER_UNIT["kn"], course_deg, latitude_deg, longitude_deg
    )


NMEA = Sidecar(suffixes=(".nmea", ".log"), read=of_file(read_nmea))
NMEA_TEXT = Sidecar(suffixes=(".txt", ".gps"), read=of_file(read_nmea), priority=-30)
