"""SRT subtitles with positions or speeds: DJI's drones and cameras, dashcams and apps; NMEA
sentences in subtitles.
"""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import read_text
from track_range.foundation.files.numeric_text import number
from track_range.recording.telemetry.sidecars.nmea import fixes_in
from track_range.recording.telemetry.sidecars.sidecar import Sidecar, of_file
from track_range.recording.telemetry.tracks.positions import (
    MPS_PER_UNIT,
    speed_from_positions,
    speed_ratio,
)
from track_range.recording.telemetry.tracks.samples import (
    Sample,
    course_from_positions,
    plain_track,
    signed,
    unit_in,
)
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
    _pattern(r"\bHOME\s*\([^()]{0,60}\)"),  # position of a drone's start
    _pattern(r"\b[VW]\.?S\.?\s*+:?\s*+[-+]?[\d.]+\s*m/s"),  # vertical speed or wind of a drone
    _pattern(
        r"\b(?:limit|wind|max(?:imum)?|avg|average|target|set|cruise|climb|vertical)\b[^\d\n]{0,12}[-+]?[\d.,]+\s?"
        + _UNIT
    ),
)

_HORIZONTAL = _pattern(r"\bH\.?S\.?\s*+:?\s*+[-+]?([\d.]{1,10})\s*m/s")
_WITH_UNIT = _pattern(rf"(?<![\d.,])((?:(?<=[:=\s])-)?\d{{1,3}}(?:[.,]\d{{1,6}})?)\s?({_UNIT})")
_WITHOUT_UNIT = _pattern(r"\bspeed\s*[:=]\s*(\d{1,3}(?:\.\d{1,6})?)(?![\d.]|\s?[a-z/])")

_DEGREES = r"\s*([-+]?\d{1,3}\.\d+)"
_POSITION = (
    (
        _pattern(r"latitude\s*[:=]" + _DEGREES),
        _pattern(r"long?t?i?tude\s*[:=]" + _DEGREES),
    ),
    (_pattern(r"\blat\s*+[:=]?" + _DEGREES), _pattern(r"\blo?ng?\s*+[:=]?" + _DEGREES)),
)
# DJI's older form: longitude first, or, with heights such as 0.0M, latitude first
_DJI_POSITION = re.compile(rf"GPS\s*\({_DEGREES}\s*,{_DEGREES}\s*,\s*[-+]?[\d.]*(M?)")
_HEMISPHERES = re.compile(r"\b([NS])\s*+:?\s*+(\d{1,2}\.\d+)[\s,;]+([EW])\s*+:?\s*+(\d{1,3}\.\d+)")

# speeds that are compared, and relative and absolute differences up to which they are the same
_MIN_MOVING, _SAME, _SAME_MPS = 5, 0.1, 0.5
_MIN_FRACTION = 0.5  # of subtitles with a speed or position: a film's dialogue may mention a speed


def read_srt(path: Path) -> TelemetryTrack | None:
    """Telemetry of subtitles, in the time of the video; None if there is none. Raises
    TelemetryError without a unit.
    """
    cues = list(
        _cues(read_text(path, TelemetryError, "subtitles in SRT", max_bytes=MAX_SIDECAR_BYTES))
    )
    return subtitle_track([content for _, content in cues], [time_s for time_s, _ in cues], path)


def subtitle_track(
    texts: Sequence[str], times_s: Sequence[float], path: Path
) -> TelemetryTrack | None:
    """See `read_srt`, of the texts of subtitles at these times."""
    sentences = fixes_in(texts, str(path))
    if any(fix is not None for fix in sentences):
        moved = [
            (fix or Sample()).at(time_s) for fix, time_s in zip(sentences, times_s, strict=True)
        ]
        return plain_track(moved, path.name, "video")
    for ignored in _IGNORED:
        texts = [ignored.sub(" ", text) for text in texts]
    time_s = np.array(times_s)
    places_deg = np.array([_position(text) for text in texts]).reshape(-1, 2)
    speeds = _speeds(texts)
    notes = tuple[str, ...]()
    if not np.isfinite(places_deg).any():
        places_deg, notes = _dji_positions(texts, time_s, speeds[:, :1].ravel())
    blank = np.full(len(time_s), np.nan)
    positions = speed_from_positions(
        time_s, places_deg[:, 0], places_deg[:, 1], blank, source=path.name
    )
    n_needed = max(1.0, _MIN_FRACTION * len(texts))
    if np.isfinite(speeds).any(axis=1).sum() >= n_needed:
        speed_mps, chosen_notes = _chosen(speeds, positions, time_s, path)
        course_deg = course_from_positions(time_s, speed_mps, *places_deg.T)
        rows = np.column_stack([time_s, blank, speed_mps, course_deg, places_deg])
        return plain_track(rows, path.name, "video", notes=(*notes, *chosen_notes))
    if np.isfinite(places_deg[:, 0]).sum() >= n_needed:
        return None if positions is None else replace(positions, notes=notes)
    if sum(bool(_WITHOUT_UNIT.search(text)) for text in texts) >= n_needed:
        raise TelemetryError(f"{path}: expected a unit such as km/h after each speed, found none.")
    return None


def _speeds(texts: Sequence[str]) -> FloatArray:
    """(N, K) speeds in m/s of each text in its order, NaN = none; that of a drone over ground is
    the only one.
    """
    stated = [[number(match[1]) for match in _HORIZONTAL.finditer(text)] for text in texts]
    if not any(stated):
        stated = [
            [
                float(match[1].replace(",", ".")) * MPS_PER_UNIT[unit_in(match[2]) or "km/h"]
                for match in _WITH_UNIT.finditer(text)
            ]
            for text in texts
        ]
    n_speeds = min((len(speeds) for speeds in stated if speeds), default=1)
    rows = [(speeds + [math.nan] * n_speeds)[:n_speeds] for speeds in stated]
    return np.array(rows).reshape(len(texts), n_speeds)


def _chosen(
    speeds_mps: FloatArray, positions: TelemetryTrack | None, time_s: FloatArray, path: Path
) -> tuple[FloatArray, tuple[str, ...]]:
    """(N,) the one of (N, K) speeds that changes, or that the positions show, and notes; others are
    limits, or the same in another unit. Raises TelemetryError if several are possible.
    """
    changes = np.nanmax(speeds_mps, axis=0) > np.nanmin(speeds_mps, axis=0)
    columns = list(speeds_mps.T[changes] if changes.any() else speeds_mps.T)
    ratios = [speed_ratio(positions, time_s, column, _MIN_MOVING).median for column in columns]
    shown = [abs(ratio - 1) <= _SAME for ratio in ratios]
    columns = [
        column for column, is_shown in zip(columns, shown, strict=True) if is_shown
    ] or columns
    first = columns[0]
    largest_mps = _SAME * np.nanmedian(np.abs(first)) + _SAME_MPS
    for other in columns[1:]:
        if not np.nanmedian(np.abs(other - first)) <= largest_mps:  # NaN, too
            both_kmh = [3.6 * float(np.nanmedian(values)) for values in (first, other)]
            raise TelemetryError(
                f"{path}: expected one speed of the car in each subtitle, found {both_kmh[0]:.0f} "
                f"and {both_kmh[1]:.0f} km/h in the median; remove the other one."
            )
    note = (
        "of the speeds in each subtitle, the one is used that changes, or that the positions show, "
        f"{3.6 * float(np.nanmedian(first)):.0f} km/h in the median."
    )
    return np.asarray(first), () if len(columns) == speeds_mps.shape[1] else (note,)


def _dji_positions(
    texts: Sequence[str], time_s: FloatArray, speed_mps: FloatArray
) -> tuple[FloatArray, tuple[str, ...]]:
    """(N, 2) latitude and longitude in degrees of DJI's GPS(a, b, height), NaN = none, in the order
    that the values and the speeds allow, else that of the form; and notes.
    """
    matches = [_DJI_POSITION.search(text) for text in texts]
    given = [(float(match[1]), float(match[2])) if match else (math.nan,) * 2 for match in matches]
    latitude_first = np.array(given).reshape(-1, 2)
    orders = [latitude_first[:, ::-1], latitude_first]
    orders = [order for order in orders if not (np.abs(order[:, 0]) > 90).any()] or orders
    if len(orders) == 1:
        return orders[0], ()
    blank = np.full(len(time_s), np.nan)
    tracks = [speed_from_positions(time_s, lat, lon, blank) for lat, lon in (o.T for o in orders)]
    ratios = [speed_ratio(one, time_s, speed_mps, _MIN_MOVING).median for one in tracks]
    errors = np.abs(np.array(ratios) - 1)  # NaN = without motion
    if (errors <= _SAME).any():
        return orders[int(np.nanargmin(errors))], ()
    if any(match and match[3] for match in matches):
        return latitude_first, ()
    note = "GPS(...) is read as longitude, latitude; the file does not state the order."
    return orders[0], () if tracks[0] is None else (note,)


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


def _position(text: str) -> tuple[float, float]:
    """Latitude and longitude in degrees; NaN = none."""
    for latitude, longitude in _POSITION:
        lat, lon = latitude.search(text), longitude.search(text)
        if lat and lon:
            return float(lat[1]), float(lon[1])
    if marked := _HEMISPHERES.search(text):
        return signed(float(marked[2]), marked[1]), signed(float(marked[4]), marked[3])
    return math.nan, math.nan


SRT = Sidecar(suffixes=(".srt",), read=of_file(read_srt), priority=-10)
