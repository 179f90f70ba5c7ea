"""SRT subtitles with positions or speeds: DJI's drones and cameras, dashcams and apps; NMEA sentences in subtitles."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from track_range.foundation.files.input_files import read_text
from track_range.recording.telemetry.errors import TelemetryError
from track_range.recording.telemetry.positions import speed_from_positions
from track_range.recording.telemetry.sidecars.nmea import Fix, fixes_in
from track_range.recording.telemetry.sidecars.units import MPS_PER_UNIT, unit_in
from track_range.recording.telemetry.track import TelemetryTrack

MAX_SRT_BYTES = 100_000_000
"""Size limit of a file of subtitles, bytes; DJI writes about 10 kB per second of video at 60 Hz, an hour is 36 MB."""

_CUE = re.compile(r"(\d{1,3}):(\d\d):(\d\d)[,.](\d{1,3})\s*-->")
_TAG = re.compile(r"<[^<>]{0,200}>")
_VERTICAL = re.compile(r"\b[VW]\.?S\.?\s*:?\s*[-+]?[\d.]+\s*m/s", re.IGNORECASE)
"""Vertical speed or wind of a drone."""

_HORIZONTAL = re.compile(r"\bH\.?S\.?\s*:?\s*([\d.]{1,10})\s*m/s", re.IGNORECASE)
_UNIT = r"(?:km\s?/\s?h|kmh|kmph|kph|mph|mi/h|m/s|knots?|kn|kt)(?![a-z²^]|\s?2\b)"
_OTHER_SPEED = re.compile(
    r"\b(?:limit|wind|max(?:imum)?|avg|average|target|set)\b[^\d\n]{0,12}[-+]?[\d.,]+\s?" + _UNIT, re.IGNORECASE
)
"""Speed limit, wind, or a mean or largest speed."""

_WITH_UNIT = re.compile(rf"(?<![\d.,])(\d{{1,3}}(?:[.,]\d{{1,6}})?)\s?({_UNIT})", re.IGNORECASE)
_WITHOUT_UNIT = re.compile(r"\bspeed\s*[:=]\s*(\d{1,3}(?:\.\d{1,6})?)(?![\d.]|\s?[a-z/])", re.IGNORECASE)
_POSITION = (
    (
        re.compile(r"latitude\s*[:=]\s*([-+]?\d{1,3}\.\d+)", re.I),
        re.compile(r"long?i?tude\s*[:=]\s*([-+]?\d{1,3}\.\d+)", re.I),
    ),
    (
        re.compile(r"\blat\s*[:=]?\s*([-+]?\d{1,3}\.\d+)", re.I),
        re.compile(r"\blo?ng?\s*[:=]?\s*([-+]?\d{1,3}\.\d+)", re.I),
    ),
)
_DJI_POSITION = re.compile(r"GPS\s*\(\s*([-+]?\d{1,3}\.\d+)\s*,\s*([-+]?\d{1,3}\.\d+)\s*,")
"""DJI's older form: longitude first."""

_HEMISPHERES = re.compile(r"\b([NS])\s*:?\s*(\d{1,2}\.\d+)[\s,;]+([EW])\s*:?\s*(\d{1,3}\.\d+)")
_MIN_FRACTION = 0.5
"""Share of the subtitles that must have a speed or a position: a film's dialogue may mention a speed."""


def read_srt(path: Path) -> TelemetryTrack | None:
    """Telemetry of the subtitles beside a video, in its time; None = they have neither speeds nor positions.

    Raises:
        TelemetryError: the file cannot be read, or states speeds without a unit.
    """
    text = read_text(path, TelemetryError, "subtitles in SRT", max_bytes=MAX_SRT_BYTES)
    cues = list(_cues(text))
    return subtitle_track([time_s for time_s, _ in cues], [content for _, content in cues], str(path), path.name)


def subtitle_track(times_s: Sequence[float], texts: Sequence[str], path: str, source: str) -> TelemetryTrack | None:
    """Telemetry of subtitles; None = they have neither speeds nor positions.

    Args:
        times_s: (N,) start of each subtitle in seconds from the first frame.
        texts: their N texts.
        path: the file, for messages.
        source: origin of the telemetry, for notes.

    Raises:
        TelemetryError: the speeds have no unit.
    """
    sentences = fixes_in(texts, path)
    is_nmea = any(fix is not None for fix in sentences)
    fixes = [fix or Fix() for fix in sentences] if is_nmea else [_fix(text) for text in texts]
    has_speed = [math.isfinite(fix.speed_mps) for fix in fixes]
    has_position = [math.isfinite(fix.latitude_deg) for fix in fixes]
    n_needed = max(1.0, _MIN_FRACTION * len(fixes))
    if not is_nmea and sum(has_speed) < n_needed and sum(has_position) < n_needed:
        if sum(bool(_WITHOUT_UNIT.search(text)) for text in texts) >= n_needed:
            raise TelemetryError(f"{path}: expected a unit such as km/h after each speed, found none.")
        return None
    time_s = np.array(times_s, np.float64)
    latitude_deg = np.array([fix.latitude_deg for fix in fixes])
    longitude_deg = np.array([fix.longitude_deg for fix in fixes])
    utc_s = np.array([fix.utc_s for fix in fixes])
    if not is_nmea and sum(has_speed) < n_needed:
        return speed_from_positions(time_s, latitude_deg, longitude_deg, utc_s, source=source, clock="video")
    return TelemetryTrack(
        time_s=time_s,
        speed_mps=np.array([fix.speed_mps for fix in fixes]),
        course_rad=np.array([fix.course_rad for fix in fixes]),
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        utc_s=utc_s,
        source=source,
        clock="video",
    )


def _cues(text: str) -> Iterable[tuple[float, str]]:
    """Start in seconds and text of each subtitle."""
    start_s, lines = math.nan, list[str]()
    for line in text.splitlines():
        match = _CUE.search(line)
        if match is None:
            lines.append(line[:2000])
            continue
        if math.isfinite(start_s):
            yield start_s, "\n".join(lines[:-1])  # without the number of the next subtitle
        hours, minutes, seconds, fraction = match.groups()
        start_s = int(hours) * 3600 + int(minutes) * 60 + int(seconds) + float(f"0.{fraction}")
        lines = []
    if math.isfinite(start_s):
        yield start_s, "\n".join(lines)


def _fix(text: str) -> Fix:
    """Speed and position in the text of a subtitle; NaN = none."""
    plain = _OTHER_SPEED.sub(" ", _VERTICAL.sub(" ", _TAG.sub(" ", text)))
    latitude_deg, longitude_deg = _position(plain)
    speed_mps = math.nan
    if horizontal := _HORIZONTAL.search(plain):
        speed_mps = _number(horizontal.group(1))
    elif stated := _WITH_UNIT.search(plain):
        speed_mps = float(stated.group(1).replace(",", ".")) * MPS_PER_UNIT[unit_in(stated.group(2)) or "km/h"]
    return Fix(speed_mps=speed_mps, latitude_deg=latitude_deg, longitude_deg=longitude_deg)


def _position(text: str) -> tuple[float, float]:
    """Latitude and longitude in degrees; NaN = none."""
    for latitude, longitude in _POSITION:
        lat, lon = latitude.search(text), longitude.search(text)
        if lat and lon:
            return float(lat.group(1)), float(lon.group(1))
    if dji := _DJI_POSITION.search(text):
        return float(dji.group(2)), float(dji.group(1))
    if signed := _HEMISPHERES.search(text):
        north, lat_deg, east, lon_deg = signed.groups()
        return float(lat_deg) * (1 if north == "N" else -1), float(lon_deg) * (1 if east == "E" else -1)
    return math.nan, math.nan


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
