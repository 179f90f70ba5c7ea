"""SRT subtitles with positions or speeds: DJI's drones and cameras, dashcams and apps; NMEA
sentences in subtitles.
"""

import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from track_range.foundation.files.input_files import read_text
from track_range.foundation.files.numeric_text import number
from track_range.recording.telemetry.sidecars.nmea import fixes_in
from track_range.recording.telemetry.sidecars.sidecar import Sidecar, of_file
from track_range.recording.telemetry.tracks.positions import MPS_PER_UNIT, speed_from_positions
from track_range.recording.telemetry.tracks.samples import Sample, plain_track, signed, unit_in
from track_range.recording.telemetry.tracks.track import (
    MAX_SIDECAR_BYTES,
    TelemetryError,
    TelemetryTrack,
)

_CUE = re.compile(r"(\d{1,3}):(\d\d):(\d\d)[,.](\d{1,3})\s*-->")


def _pattern(text: str) -> re.Pattern[str]:
    return re.compile(text, re.IGNORECASE)


_UNIT = r"(?:km\s?/\s?h|kmh|kmph|kph|mph|mi/h|m/s|knots?|kn|kt)(?![a-z²^]|\s?2\b)"
_IGNORED = (  # no speeds of the camera; each is removed before the next is looked for
    _pattern(r"<[^<>]{0,200}>"),  # formatting
    _pattern(r"\b[VW]\.?S\.?\s*+:?\s*+[-+]?[\d.]+\s*m/s"),  # vertical speed or wind of a drone
    _pattern(
        r"\b(?:limit|wind|max(?:imum)?|avg|average|target|set)\b[^\d\n]{0,12}[-+]?[\d.,]+\s?"
        + _UNIT
    ),
)

_HORIZONTAL = _pattern(r"\bH\.?S\.?\s*+:?\s*+([\d.]{1,10})\s*m/s")
_WITH_UNIT = _pattern(rf"(?<![\d.,])(\d{{1,3}}(?:[.,]\d{{1,6}})?)\s?({_UNIT})")
_WITHOUT_UNIT = _pattern(r"\bspeed\s*[:=]\s*(\d{1,3}(?:\.\d{1,6})?)(?![\d.]|\s?[a-z/])")

_DEGREES = r"\s*([-+]?\d{1,3}\.\d+)"
_POSITION = (
    (
        _pattern(r"latitude\s*[:=]" + _DEGREES),
        _pattern(r"long?t?i?tude\s*[:=]" + _DEGREES),
    ),
    (_pattern(r"\blat\s*+[:=]?" + _DEGREES), _pattern(r"\blo?ng?\s*+[:=]?" + _DEGREES)),
)
# DJI's older form: longitude first
_DJI_POSITION = re.compile(rf"GPS\s*\({_DEGREES}\s*,{_DEGREES}\s*,")
_HEMISPHERES = re.compile(r"\b([NS])\s*+:?\s*+(\d{1,2}\.\d+)[\s,;]+([EW])\s*+:?\s*+(\d{1,3}\.\d+)")

_MIN_FRACTION = 0.5  # of subtitles with a speed or position: a film's dialogue may mention a speed


def read_srt(path: Path) -> TelemetryTrack | None:
    """Telemetry of subtitles, in the time of the video; None if there is none. Raises
    TelemetryError without a unit.
    """
    cues = list(
        _cues(read_text(path, TelemetryError, "subtitles in SRT", max_bytes=MAX_SIDECAR_BYTES))
    )
    return _track([content for _, content in cues], [time_s for time_s, _ in cues], path)


def _track(texts: Sequence[str], times_s: Sequence[float], path: Path) -> TelemetryTrack | None:
    sentences = fixes_in(texts, str(path))
    is_nmea = any(fix is not None for fix in sentences)
    samples = (
        [fix or Sample() for fix in sentences] if is_nmea else [_sample(text) for text in texts]
    )
    samples = [sample.at(time_s) for sample, time_s in zip(samples, times_s, strict=True)]
    n_needed = max(1.0, _MIN_FRACTION * len(samples))
    if is_nmea or sum(math.isfinite(sample.speed_mps) for sample in samples) >= n_needed:
        return plain_track(samples, path.name, "video")
    if sum(math.isfinite(sample.latitude_deg) for sample in samples) >= n_needed:
        time_s, utc_s, _, _, latitude_deg, longitude_deg = np.array(samples).T
        return speed_from_positions(
            time_s, latitude_deg, longitude_deg, utc_s, source=path.name, clock="video"
        )
    if sum(bool(_WITHOUT_UNIT.search(text)) for text in texts) >= n_needed:
        raise TelemetryError(f"{path}: expected a unit such as km/h after each speed, found none.")
    return None


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


def _sample(text: str) -> Sample:
    for ignored in _IGNORED:
        text = ignored.sub(" ", text)
    speed_mps = math.nan
    if horizontal := _HORIZONTAL.search(text):
        speed_mps = number(horizontal[1])
    elif stated := _WITH_UNIT.search(text):
        speed_mps = float(stated[1].replace(",", ".")) * MPS_PER_UNIT[unit_in(stated[2]) or "km/h"]
    latitude_deg, longitude_deg = _position(text)
    return Sample(speed_mps=speed_mps, latitude_deg=latitude_deg, longitude_deg=longitude_deg)


def _position(text: str) -> tuple[float, float]:
    """Latitude and longitude in degrees; NaN = none."""
    for latitude, longitude in _POSITION:
        lat, lon = latitude.search(text), longitude.search(text)
        if lat and lon:
            return float(lat[1]), float(lon[1])
    if dji := _DJI_POSITION.search(text):
        return float(dji[2]), float(dji[1])
    if marked := _HEMISPHERES.search(text):
        return signed(float(marked[2]), marked[1]), signed(float(marked[4]), marked[3])
    return math.nan, math.nan


SRT = Sidecar(suffixes=(".srt",), read=of_file(read_srt), priority=-10)
