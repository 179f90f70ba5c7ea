"""CSV files with speeds or positions: those of loggers, of extraction tools, and of apps.

The columns are found by their names. A speed needs a unit in its heading (`speed_kmh`, `Speed (m/s)`, `speed [kn]`);
without one, it is inferred if the file has positions too, and the file is refused otherwise.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.csv_tables import CsvTable, read_csv_table
from track_range.foundation.files.input_files import shortened
from track_range.foundation.files.numeric_text import numbers
from track_range.recording.telemetry.positions import MPS_PER_UNIT, speed_from_positions, speed_ratio, unit_of_ratio
from track_range.recording.telemetry.samples import plain_track, unit_in
from track_range.recording.telemetry.track import Clock, TelemetryError, TelemetryTrack

_SPEED = re.compile(r"speed|velocity|(?<![a-z])v(?:el)?_(?:mps|kmh)")
_NOT_SPEED = re.compile(
    r"vertical|3d|accuracy|limit|wind|sigma|error|z.?speed|angular|fan|engine|rpm|unit|"
    r"max|avg|average|target|lead|diff|delta|cruise|allowed|(?<![a-z])set(?![a-z])"
)
_LATITUDE = re.compile(r"(?<![a-z])lat(?:itude)?(?![a-z])")
_LONGITUDE = re.compile(r"(?<![a-z])(?:lon|lng|long)(?:gitude|itude)?(?![a-z])")
_COURSE = re.compile(r"(?<![a-z])(?:course|heading|bearing|track)(?![a-z])")
_VIDEO_TIME = re.compile(r"^(?:time_s|t|seconds?|elapsed.*|video_?time.*|cts|time ?\(?\[?s\)?\]?|offset.*)$")
_CLOCK_TIME = re.compile(r"(?:^|[^a-z])(?:utc|date|time|timestamp|datetime|epoch|gpstime)(?:$|[^a-z])")
_EPOCH_UNITS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3), (1e8, 1.0))  # smallest value, seconds per unit
_UNIT_TOLERANCE, _MIN_MOVING = 0.08, 10  # difference to speeds from positions, and moving samples, that show a unit


def is_telemetry_csv(table: CsvTable) -> bool:
    """Whether a table has a column of speeds or positions, and of times."""
    return bool(_columns(table, _SPEED, _NOT_SPEED) or _columns(table, _LATITUDE)) and _time_column(table) is not None


def read_csv(path: Path) -> TelemetryTrack | None:
    """Telemetry of a CSV file; None = no such columns. Raises TelemetryError without readable times or unit."""
    table = read_csv_table(path, TelemetryError, "columns of times and speeds")
    if not is_telemetry_csv(table) or not len(table):
        return None
    time_s, clock = _times(table)
    lat, lon = _columns(table, _LATITUDE), _columns(table, _LONGITUDE)
    names = (lat[0], lon[0]) if lat and lon else ("", "")
    latitude_deg, longitude_deg = (table.numbers(name) if name else np.full(len(table), np.nan) for name in names)
    known = np.flatnonzero(np.isfinite(time_s))
    if not len(known):
        raise TelemetryError(
            f"{path}: expected times in the column {shortened(repr(_time_column(table)))}, found none."
        )
    utc_s = time_s if clock != "video" else np.full(len(time_s), np.nan)
    positions = speed_from_positions(time_s, latitude_deg, longitude_deg, utc_s, source=path.name, clock=clock)
    speeds = _columns(table, _SPEED, _NOT_SPEED)
    if not speeds:
        if positions is None:
            raise TelemetryError(f"{path}: expected speeds, or at least two positions, found fewer.")
        return positions
    named = next((name for name in speeds if unit_in(name) is not None), speeds[0])
    values, unit = table.numbers(named), unit_in(named)
    notes: tuple[str, ...] = ()
    if unit is None:
        ratio, _ = speed_ratio(positions, time_s, values, _MIN_MOVING)
        unit = None if ratio is None else unit_of_ratio(ratio, _UNIT_TOLERANCE)
        if unit is None:
            raise TelemetryError(
                f"{path}: expected a unit in the heading {shortened(repr(named))}, found none; rename it to speed_mps "
                "or speed_kmh."
            )
        notes = (f"the speeds have no unit; compared with the positions they are in {unit}.",)
    course = _columns(table, _COURSE)
    course_deg = table.numbers(course[0]) if course else np.full(len(table), np.nan)
    speed_mps = np.abs(values) * MPS_PER_UNIT[unit]
    samples = np.column_stack([time_s, utc_s, speed_mps, course_deg, latitude_deg, longitude_deg])[known]
    return plain_track(samples, path.name, clock, notes=notes)


def _columns(table: CsvTable, name: re.Pattern[str], excluded: re.Pattern[str] | None = None) -> list[str]:
    """Headings that match; those of repeated columns only once."""
    return [
        heading
        for heading in dict.fromkeys(table.header)
        if name.search(heading[:100]) and not (excluded and excluded.search(heading[:100]))
    ]


def _time_column(table: CsvTable) -> str | None:
    """The heading of the times: a date and time if there is one, else seconds of the video."""
    clocks = _columns(table, _CLOCK_TIME, _VIDEO_TIME)
    video = _columns(table, _VIDEO_TIME)
    return next(iter((*[name for name in video if name == "time_s"], *clocks, *video)), None)


def _times(table: CsvTable) -> tuple[FloatArray, Clock]:
    """(N,) times, NaN = unknown, and their clock: numbers, or dates and times in ISO 8601."""
    name = _time_column(table) or ""
    texts = table.texts(name)
    values = np.array(numbers(texts))
    if np.isfinite(values).sum() > len(values) / 2:
        typical = float(np.nanmedian(np.abs(values)))
        for least, scale in _EPOCH_UNITS:
            if typical > least:
                return values * scale, "utc"
        is_ms = name == "cts" or re.search(r"ms(?![a-z])|milli", name) is not None
        return values * (1e-3 if is_ms else 1.0), "video"
    seconds, n_zoned = np.full(len(texts), np.nan), 0
    for index, text in enumerate(texts):
        try:
            moment = datetime.fromisoformat(text[:40].replace("/", "-"))
            n_zoned += moment.tzinfo is not None
            seconds[index] = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
        except (ValueError, OverflowError):
            continue
    return seconds, "utc" if n_zoned > len(texts) / 2 else "local"
