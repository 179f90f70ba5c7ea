"""NMEA 0183: sentences RMC in text files and subtitles; speed over ground in knots, course, date and time in UTC."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from track_range.foundation.files.input_files import read_text
from track_range.recording.telemetry.errors import TelemetryError
from track_range.recording.telemetry.libraries import imported
from track_range.recording.telemetry.track import TelemetryTrack

MPS_PER_KNOT = 1852 / 3600
"""Definition of the knot: 1852 m per hour."""

MAX_NMEA_BYTES = 100_000_000
"""Size limit of a file of sentences, bytes; a day at 10 Hz with all usual sentences has 60 MB."""

_RMC = re.compile(r"\$[A-Z]{2}RMC,[^$*\r\n]{10,90}(?:\*([0-9A-Fa-f]{2}))?")
"""Recommended minimum sentence of any satellite system."""

_MIN_RIGHT_FRACTION = 0.5
"""Share of right checksums above which sentences with a wrong one are dropped. Some programs change positions in files
without correcting any checksum."""


@dataclass(frozen=True, slots=True)
class Fix:
    """Content of one RMC sentence; NaN = not stated, or no fix.

    Attributes:
        utc_s: seconds since 1970.
        speed_mps: speed over ground.
        course_rad: clockwise from north.
        latitude_deg, longitude_deg: position.
    """

    utc_s: float = math.nan
    speed_mps: float = math.nan
    course_rad: float = math.nan
    latitude_deg: float = math.nan
    longitude_deg: float = math.nan


def read_nmea(path: Path) -> TelemetryTrack | None:
    """Telemetry of a file of NMEA sentences; None = it has no RMC sentence.

    Raises:
        TelemetryError: it cannot be read, or pynmea2 is not installed.
    """
    text = read_text(path, TelemetryError, "NMEA sentences", max_bytes=MAX_NMEA_BYTES)
    fixes = [fix for fix in fixes_in(text.splitlines(), str(path)) if fix is not None]
    return nmea_track(fixes, path.name)


def nmea_track(fixes: Sequence[Fix], source: str) -> TelemetryTrack | None:
    """Telemetry of fixes with their own date and time; None = no fix has one."""
    dated = [fix for fix in fixes if math.isfinite(fix.utc_s)]
    if not dated:
        return None
    return TelemetryTrack(
        time_s=np.array([fix.utc_s for fix in dated]),
        speed_mps=np.array([fix.speed_mps for fix in dated]),
        course_rad=np.array([fix.course_rad for fix in dated]),
        latitude_deg=np.array([fix.latitude_deg for fix in dated]),
        longitude_deg=np.array([fix.longitude_deg for fix in dated]),
        source=source,
        clock="utc",
    )


def fixes_in(texts: Iterable[str], source: str) -> list[Fix | None]:
    """The fix of the first RMC sentence in each text; None = it has none.

    Args:
        texts: lines of a file, or the texts of subtitles.
        source: name of the file, for messages.

    Raises:
        TelemetryError: there are sentences, but pynmea2 is not installed.
    """
    matches = [_RMC.search(text) for text in texts]
    checked = [_is_right(match.group()) for match in matches if match and match.group(1)]
    needs_right = bool(checked) and sum(checked) >= _MIN_RIGHT_FRACTION * len(checked)
    if not any(matches):
        return [None] * len(matches)
    pynmea2 = imported("pynmea2", source)
    return [
        None
        if match is None or (needs_right and match.group(1) and not _is_right(match.group()))
        else _fix(pynmea2, match.group().partition("*")[0])
        for match in matches
    ]


def _is_right(sentence: str) -> bool:
    """Whether the checksum of a sentence, the exclusive or of its characters, is right."""
    content, _, stated = sentence[1:].partition("*")
    return reduce(lambda total, character: total ^ ord(character), content, 0) == int(stated, 16)


def _fix(pynmea2: Any, sentence: str) -> Fix | None:
    """Content of a sentence without checksum; None = it cannot be read."""
    try:
        message = pynmea2.parse(sentence)
        day, clock, status = message.datestamp, message.timestamp, message.status
    except (ValueError, AttributeError, LookupError):
        return None
    utc_s = math.nan
    if day and clock and not isinstance(day, str) and not isinstance(clock, str):
        utc_s = datetime.combine(day, clock.replace(tzinfo=None), UTC).timestamp()
    if status != "A":
        return Fix(utc_s)
    try:
        latitude_deg, longitude_deg = float(message.latitude), float(message.longitude)
    except (ValueError, TypeError, AttributeError):
        latitude_deg = longitude_deg = math.nan
    has_position = bool(message.lat) and bool(message.lon)
    return Fix(
        utc_s,
        _number(message.spd_over_grnd) * MPS_PER_KNOT,
        math.radians(_number(message.true_course)),
        latitude_deg if has_position else math.nan,
        longitude_deg if has_position else math.nan,
    )


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else math.nan
