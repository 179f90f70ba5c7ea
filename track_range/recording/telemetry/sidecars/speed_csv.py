"""CSV files with speeds or positions, from loggers, extraction tools and apps.

The columns are found by their names. Components of the velocity are combined. Among several speeds
or units, the file's positions decide; without positions, a speed needs a unit in its heading
(`speed_kmh`, `Speed (m/s)`, `speed [kn]`), in a row below it or in the lines before it, and the
car's own instruments come before its GPS receiver. Speeds are negative backwards.
"""

import math
import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import UserError
from track_range.foundation.files.csv_tables import CsvTable, line_of_header, read_csv_table
from track_range.foundation.files.input_files import quoted, read_text, shortened
from track_range.foundation.files.numeric_text import number, numbers
from track_range.recording.telemetry.sidecars.sidecar import Sidecar, of_file
from track_range.recording.telemetry.sidecars.time_texts import DAY_S, times_of_texts
from track_range.recording.telemetry.tracks.positions import (
    MPS_PER_UNIT,
    speed_from_positions,
    speed_ratio,
    unit_of_ratio,
)
from track_range.recording.telemetry.tracks.samples import plain_track, unit_in
from track_range.recording.telemetry.tracks.track import (
    MAX_SIDECAR_BYTES,
    Clock,
    TelemetryError,
    TelemetryTrack,
)

_SPEED = re.compile(r"speed|velocity|(?<![a-z])v(?:el)?_(?:mps|kmh)")
NOT_SPEED = re.compile(
    r"vertical|3d|accura|limit|wind|sigma|error|z.?speed|angular|accel|fan|engine|rpm|unit|valid|flag|status|"
    r"max|avg|average|target|front|lead|preced|ahead|object|other|(?<![a-z])(?:obj|rel|set)(?![a-z])|relative|diff|"
    r"delta|cruise|allowed|desired|predicted|closing|approach|pedestrian|climb"
)
_RANKS = (  # patterns of preferred names, best first
    re.compile(r"(?<![a-z])(?:ego|own|host|vehicle|car|obd|can)(?![a-z])|speedometer"),
    re.compile(r"gps|gnss|ground|(?<![a-z])(?:sog|2d)(?![a-z])"),
)
_LATITUDE = re.compile(r"(?<![a-z])lat(?:itude)?(?![a-z])")
_LONGITUDE = re.compile(r"(?<![a-z])(?:lon|lng|longt?)(?:gitude|itude)?(?![a-z])")
_COURSE = re.compile(r"(?<![a-z])(?:course|heading|bearing|track)(?![a-z])")
_SECOND_UNITS = {  # in headings, s
    r"n(?:ano)?s(?:ec(?:ond)?s?)?": 1e-9,
    r"(?:[uµμ]|micro)s(?:ec(?:ond)?s?)?": 1e-6,
    r"cts|m(?:illi)?s(?:ec(?:ond)?s?)?": 1e-3,
    r"s(?:ec(?:ond)?s?)?": 1.0,
}
_ANY_SECOND = "|".join(_SECOND_UNITS)
_VIDEO_TIME = re.compile(
    rf"^(?:t(?:ime)?[ _/(\[]*(?:{_ANY_SECOND})[)\]]*|t|(?:m|u|milli|micro|nano)?sec(?:ond)?s?|[mu]s|"
    r"millis|micros|seconds?[ _(].*|elapsed.*|video_?time.*|cts|offset.*)$"
)
_CLOCK_TIME = re.compile(
    r"(?:^|[^a-z])(?:utc|date|time|timestamp(?:[mun]s)?|datetime|epoch|gpstime)(?:$|[^a-z])|"
    r"since_?1970"
)
_DATED = re.compile(r"utc|epoch|unix|1970")  # before others, which may count from a start
# in separate columns
_DATE, _TIME_OF_DAY = re.compile(r"(?:^|[^a-z])date$"), re.compile(r"(?:^|[^a-z])time$")

_VELOCITY = re.compile(r"(?:v|vel|velocity|speed|linear)(?=[^a-z]|$)|v[neduxyz]?$")
_AXES = dict(zip("nedu", ("north", "east", "down", "up"), strict=True))
_AXES |= {"longitudinal": "forward", "right": "left", "lateral": "left"}
_AXIS = re.compile(
    r"(?<![a-z])(?:v|vel)?(north|east|down|up|forward|longitudinal|lateral|left|right|[neduxyz])(?:ward)?(?![a-z])"
)
_UNIT_OF_NAME = re.compile(r"[(\[].*$|_(?:mps|kmh|kph|mph|kn)$")
# Components of which the length is the speed, best first. In x, y and z, the vertical one is
# unknown and small.
_HORIZONTAL = (("north", "east"), ("x", "y", "z"), ("x", "y"), ("forward", "left"), ("forward",))

_TIME_UNITS = tuple(
    (re.compile(rf"(?:(?<![a-z])|(?<=time)|(?<=timestamp))(?:{notation})(?![a-z])"), scale)
    for notation, scale in (
        *_SECOND_UNITS.items(),
        (r"c(?:enti)?s(?:ec(?:ond)?s?)?", 1e-2),
        (r"d(?:eci)?s(?:ec(?:ond)?s?)?", 0.1),
        (r"min(?:ute)?s?", 60.0),
        (r"h(?:(?:ou)?rs?)?", 3600.0),
    )
)
_MULTIPLE = re.compile(  # 0.1 s, 100ns, ms/10; not "since 1970 s"
    rf"(?<=\d)(?<!1970)[\s*]?(?:{_ANY_SECOND})(?![a-z])|(?<![a-z])(?:{_ANY_SECOND})\s?[*x/]\s?\d"
)
# seconds since 1970 from 1973 to 2286; of numbers without a unit: smallest value, seconds per unit
_FIRST_EPOCH_S, _LAST_EPOCH_S = 1e8, 1e10
_EPOCH_UNITS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3), (_FIRST_EPOCH_S, 1.0))
# smallest median step of times since the start, alike
_STEP_UNITS = (
    (1e7, "nanoseconds", 1e-9),
    (1e4, "microseconds", 1e-6),
    (10.0, "milliseconds", 1e-3),
)
# lines before the header that state the unit of speeds, and the start of a log
_UNIT_LINE = re.compile(r"^\D*(?:speed|velocity|unit)\D*$", re.IGNORECASE)  # and no value
_START = re.compile(r"\bstart[^=:,;\d]{0,20}[=:,;]([^,;]{0,40}?\d:\d\d[^,;]{0,30})", re.IGNORECASE)
_MOMENT = re.compile(r"\d:\d\d")
_MAX_UNIT_ROWS = 3  # below the header: units, sources of the columns
# difference to speeds from positions, and moving samples, that show a unit
_UNIT_TOLERANCE, _MIN_MOVING = 0.05, 10
_MAX_VALUE = 1e4  # of speeds in any unit
_TURNING = 0.2  # lateral part of a velocity above which a vehicle turns
_MAX_SCATTER = 0.2  # largest median relative deviation of single speeds from the positions' speeds


class _Speeds(NamedTuple):
    """A column of speeds, or the length of components of the velocity."""

    name: str  # of the columns, for notes
    rank: int  # preferred are small ones
    unit: str | None  # in the heading
    values: FloatArray  # (N,) negative = backwards


def is_telemetry_header(header: Sequence[str]) -> bool:
    """Whether a table has a column of times, and another one of speeds or positions."""
    time = _time_column(header)
    others = [name for name in header if name != time]
    has_speed = (
        _columns(others, _SPEED, NOT_SPEED) or _components(others) or _columns(others, _LATITUDE)
    )
    is_data = any(_MOMENT.search(name) or "{" in name for name in header)
    return bool(has_speed) and time is not None and not is_data


def has_positions(table: CsvTable) -> bool:
    """Whether a table has columns of positions."""
    return bool(_columns(table.header, _LATITUDE) and _columns(table.header, _LONGITUDE))


def log_table(path: Path, error: type[UserError] = TelemetryError) -> CsvTable:
    """The table of a log, whose headings have the units of the rows below them; raises `error`."""
    expected = "columns of times and speeds"
    table = _wide(read_csv_table(path, error, expected, is_header=is_telemetry_header))
    header, n_rows = list(table.header), 0
    time = _time_column(header)
    while n_rows < min(_MAX_UNIT_ROWS, len(table)) and time is not None:
        row = table.rows[n_rows]
        has_time = re.search(r"\d", row[header.index(time)])
        if has_time or any(math.isfinite(number(cell)) for cell in row):
            break
        header = [
            f"{name} ({cell.lower()})" if cell else name
            for name, cell in zip(header, row, strict=False)
        ]
        n_rows += 1
        time = _time_column(header)
    return replace(
        table, header=tuple(header), rows=table.rows[n_rows:], lines=table.lines[n_rows:]
    )


def read_text_log(path: Path) -> TelemetryTrack | None:
    """See `read_csv`; None for a text whose first lines have no header of telemetry."""
    text = read_text(path, TelemetryError, "a log", max_bytes=MAX_SIDECAR_BYTES)
    if line_of_header(text.split("\n"), is_telemetry_header) is None:
        return None
    return read_csv(path)


def read_csv(path: Path) -> TelemetryTrack | None:
    """Telemetry of a CSV file; None = no such columns. Raises TelemetryError without readable times
    or unit.
    """
    table = log_table(path)
    if not is_telemetry_header(table.header) or not len(table):
        return None
    time_s, clock, time_notes = _times(table)
    lat, lon = _columns(table.header, _LATITUDE), _columns(table.header, _LONGITUDE)
    names = (lat[0], lon[0]) if lat and lon else ("", "")
    latitude_deg, longitude_deg = (
        table.numbers(name) if name else np.full(len(table), np.nan) for name in names
    )
    utc_s = time_s if clock != "video" else np.full(len(time_s), np.nan)
    positions = speed_from_positions(
        time_s, latitude_deg, longitude_deg, utc_s, source=path.name, clock=clock
    )
    speeds = _speeds(table)
    if not speeds:
        if positions is not None:
            return replace(positions, notes=(*positions.notes, *time_notes))
        components = " and ".join(repr(name) for name in _components(table.header))
        present = (
            f"only the component {components} of the velocity; add the rest"
            if components
            else "fewer"
        )
        raise TelemetryError(
            f"{path}: expected speeds, or at least two positions, found {shortened(present, 120)}."
        )
    chosen, unit, note = _chosen(path, speeds, positions, time_s)
    course = _columns(table.header, _COURSE)
    course_deg = table.numbers(course[0]) if course else np.full(len(table), np.nan)
    speed_mps = chosen.values * MPS_PER_UNIT[unit]
    samples = np.column_stack([time_s, utc_s, speed_mps, course_deg, latitude_deg, longitude_deg])
    samples = samples[np.isfinite(time_s)]
    return plain_track(samples, path.name, clock, notes=(note, *time_notes), unit=unit)


def _chosen(
    path: Path, speeds: Sequence[_Speeds], positions: TelemetryTrack | None, time_s: FloatArray
) -> tuple[_Speeds, str, str]:
    """The speeds to use, their unit, and a note that names both; raises TelemetryError if they are
    unknown.
    """
    shown = _units_by_positions(speeds, positions, time_s)
    agreeing = [column for column in speeds if column.name in shown]
    stated = [column for column in speeds if column.unit is not None]
    if agreeing:
        # as stated before converted
        column = min(agreeing, key=lambda one: one.unit not in (None, shown[one.name]))
        unit = shown[column.name]
        if column.unit is None:
            how = "as the positions show"
        elif column.unit == unit:
            how = "as stated and as the positions show"
        else:
            how = f"as the positions show, not in {column.unit} as stated"
    elif stated:
        column, how = stated[0], "as stated; no positions confirm the unit"
        unit = column.unit or "m/s"
        _check_rivals(path, column, unit, stated)
    else:
        shows = "" if positions is None else ", and the positions do not move enough to show it"
        raise TelemetryError(
            f"{path}: expected a unit in the heading {shortened(repr(speeds[0].name))}, found "
            f"none{shows}; rename it to speed_mps or speed_kmh."
        )
    others = {other.name for other in speeds} - {column.name}
    unused = f"; not {shortened(', '.join(sorted(others)))}" if others else ""
    return column, unit, f"the speed is {shortened(column.name)} in {unit}, {how}{unused}."


def _units_by_positions(
    speeds: Sequence[_Speeds], positions: TelemetryTrack | None, time_s: FloatArray
) -> dict[str, str]:
    """Units that the positions show, by the name of the column."""
    shown = {}
    for column in speeds:
        ratio = speed_ratio(positions, time_s, column.values, _MIN_MOVING)
        if not math.isnan(ratio.median) and ratio.scatter <= _MAX_SCATTER:
            unit = unit_of_ratio(ratio.median, _UNIT_TOLERANCE)
            if unit is not None:
                shown[column.name] = unit
    return shown


def _check_rivals(path: Path, column: _Speeds, unit: str, stated: Sequence[_Speeds]) -> None:
    """TelemetryError: another column is as likely the speed of the car, and differs."""
    rivals = [other for other in stated if other.rank == column.rank and _differ(other, column)]
    if rivals:
        raise TelemetryError(
            f"{path}: expected one speed of the car, found {shortened(repr(column.name))} and "
            f"{shortened(repr(rivals[0].name))}, which differ; remove one, or rename the right "
            f"column to ego_speed_{'mps' if unit == 'm/s' else 'kmh'}."
        )


def _differ(first: _Speeds, second: _Speeds) -> bool:
    """Whether two columns of speeds with units differ by more than 10 % in the median."""
    a, b = (
        np.abs(column.values) * MPS_PER_UNIT[column.unit or "m/s"] for column in (first, second)
    )
    known = np.isfinite(a) & np.isfinite(b)
    return (
        bool(known.any())
        and float(np.median(np.abs(a - b)[known])) > 0.1 * float(np.median(np.abs(b[known]))) + 0.3
    )


def _speeds(table: CsvTable) -> list[_Speeds]:
    """Speeds of a table, in the order of preference."""
    components = _components(table.header)
    stated = {unit_in(line) for line in table.preamble if _UNIT_LINE.search(line)} - {None}
    usual = stated.pop() if len(stated) == 1 else None  # of headings without a unit
    groups: dict[tuple[str, str | None], dict[str, str]] = defaultdict(dict)
    for name, (stem, axis) in components.items():
        groups[stem, unit_in(name) or usual].setdefault(axis, name)
    speeds = [
        _Speeds(name, _rank(name), unit_in(name) or usual, _numbers(table, name))
        for name in _columns(table.header, _SPEED, NOT_SPEED)
        if name not in components
    ]
    for (_, unit), by_axis in groups.items():
        axes = next((axes for axes in _HORIZONTAL if set(axes) <= set(by_axis)), ())
        if axes:
            names = [by_axis[axis] for axis in axes]
            parts = [_numbers(table, name) for name in names]
            length = _signed_length(axes, parts)
            speeds.append(_Speeds(" and ".join(names), min(_rank(names[0]), 1), unit, length))
    return sorted(speeds, key=lambda speeds: (speeds.rank, speeds.unit is None))


def _signed_length(axes: Sequence[str], parts: Sequence[FloatArray]) -> FloatArray:
    """(N,) length of a velocity, negative backwards where the axes are those of a vehicle."""
    length: FloatArray = np.linalg.norm(parts, axis=0)
    is_signed = axes[0] == "forward" or (axes[0] == "x" and _reverses(*parts[:2]))
    return np.copysign(length, parts[0]) if is_signed else length


def _reverses(x: FloatArray, y: FloatArray) -> bool:
    """Whether components (N,) are along the axes of a vehicle that drives both ways: on the Earth's
    axes, it would turn through the other one.
    """
    moving = np.abs(x) > _TURNING * np.nanmax(np.abs(x), initial=0.0)
    is_straight = bool((np.abs(y) <= _TURNING * np.abs(x))[moving].all())
    return is_straight and bool((x[moving] > 0).any() and (x[moving] < 0).any())


def _components(header: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Headings of components of the velocity, with the rest of the name and the axis."""
    components: dict[str, tuple[str, str]] = {}
    for heading in dict.fromkeys(header):
        name = _UNIT_OF_NAME.sub("", heading[:100]).strip()
        axis = _AXIS.search(name.replace("_", " "))
        if (
            axis is not None
            and _VELOCITY.search(name.replace("_", " "))
            and not NOT_SPEED.search(name)
        ):
            stem = name.replace("_", " ").replace(axis[0], "", 1)
            components[heading] = (stem, _AXES.get(axis[1], axis[1]))
    return components


def _numbers(table: CsvTable, name: str) -> FloatArray:
    """(N,) numbers of a column of speeds; NaN for numbers that are not a speed in any unit."""
    values = table.numbers(name)
    return np.where(np.abs(values) < _MAX_VALUE, values, np.nan)


def _rank(name: str) -> int:
    return next((rank for rank, pattern in enumerate(_RANKS) if pattern.search(name)), len(_RANKS))


def _wide(table: CsvTable) -> CsvTable:
    """The rows of the best speed, as a column, of a table with one value per row (Car Scanner: pid,
    value, units).
    """
    if not {"pid", "value"} <= set(table.header):
        return table
    names = [
        f"{pid} ({unit})".lower()
        for pid, unit in zip(table.texts("pid"), table.texts("units"), strict=True)
    ]
    speeds = [
        name for name in dict.fromkeys(names) if _SPEED.search(name) and not NOT_SPEED.search(name)
    ]
    if not speeds:
        return table
    best = min(speeds, key=_rank)
    rows = [index for index, name in enumerate(names) if name == best]
    header = tuple(best if name == "value" else name for name in table.header if name != "pid")
    pid = table.header.index("pid")
    cells = [[cell for column, cell in enumerate(table.rows[row]) if column != pid] for row in rows]
    return replace(table, header=header, rows=cells, lines=[table.lines[row] for row in rows])


def _columns(
    header: Sequence[str], name: re.Pattern[str], excluded: re.Pattern[str] | None = None
) -> list[str]:
    """Headings that match; headings of repeated columns appear only once."""
    return [
        heading
        for heading in dict.fromkeys(header)
        if name.search(heading[:100]) and not (excluded and excluded.search(heading[:100]))
    ]


def _time_column(header: Sequence[str]) -> str | None:
    """The heading of the times: a date and time if there is one, else seconds of the video."""
    clocks = _columns(header, _CLOCK_TIME, _VIDEO_TIME)
    clocks.sort(key=lambda name: _DATED.search(name) is None)
    video = _columns(header, _VIDEO_TIME)
    return next(iter((*[name for name in video if name == "time_s"], *clocks, *video)), None)


def _times(table: CsvTable) -> tuple[FloatArray, Clock, tuple[str, ...]]:
    """(N,) times, NaN = unknown, and their clock, of numbers, or dates and times; and notes."""
    name = _time_column(table.header) or ""
    texts = table.texts(name)
    dates, times = (_columns(table.header, pattern) for pattern in (_DATE, _TIME_OF_DAY))
    if dates and times and not any(":" in text for text in table.texts(dates[0])):
        texts = [
            " ".join(cells)
            for cells in zip(table.texts(dates[0]), table.texts(times[0]), strict=True)
        ]
    values = np.array(numbers(texts))
    if np.isfinite(values).sum() <= len(values) / 2:
        time_s, clock = times_of_texts(texts, table.path)
        is_date = np.nanmax(time_s) > 2 * DAY_S
        if not is_date and (_VIDEO_TIME.search(name) or np.nanmin(time_s) < 1.0):
            clock = "video"  # hours, minutes and seconds since the start
        return time_s, clock, ()
    return _times_of_numbers(values, name, table)


def _times_of_numbers(
    values: FloatArray, name: str, table: CsvTable
) -> tuple[FloatArray, Clock, tuple[str, ...]]:
    """See `_times`; times since the start of a log are on the clock of the start that the lines
    before the header state, else on that of the video.
    """
    known = values[np.isfinite(values)]
    typical = float(np.median(np.abs(known)))
    if name == "seconds" and 3600 < typical < 2 * DAY_S:  # Car Scanner's, since midnight
        return values, "local", ()
    if _MULTIPLE.search(name):
        raise TelemetryError(
            f"{table.path}: expected a unit of the times in the heading {shortened(repr(name))}, "
            "found a multiple of one; convert the times, and rename it to time_s."
        )
    scale, notes = _scale(name, typical, np.diff(known))
    time_s = values * scale
    if typical * scale > _FIRST_EPOCH_S:
        return time_s, "utc", notes
    starts = [match[1].strip(' "') for line in table.preamble if (match := _START.search(line))]
    if starts:
        start_s, clock = times_of_texts(starts[:1], table.path)
        # whole seconds, as videos state their start
        return time_s + np.floor(start_s[0]), clock, notes
    unread = [
        f"its times count from the first frame of the video, not from {quoted(line, 60)}; dates "
        "and times in a column would be matched with those of the video."
        for line in table.preamble
        if _MOMENT.search(line)
    ]
    return time_s, "video", (*notes, *unread[:1])


def _scale(name: str, typical: float, steps: FloatArray) -> tuple[float, tuple[str, ...]]:
    """Seconds per unit of times in the unit of their heading, else by their size; and notes."""
    scale = next((scale for unit, scale in _TIME_UNITS if unit.search(name)), None)
    # a unit with which the times would be in a distant future is not that of the column
    if scale is not None and typical * scale <= _LAST_EPOCH_S:
        return scale, ()
    scale = next((scale for least, scale in _EPOCH_UNITS if typical > least), None)
    if scale is not None:
        return scale, ()
    step = float(np.median(steps)) if len(steps) else 0.0
    for least, unit, scale in _STEP_UNITS:
        if step > least:
            return scale, (f"the times have no unit; by their steps, they are {unit}.",)
    return 1.0, ()


CSV = Sidecar(suffixes=(".csv", ".tsv"), read=of_file(read_csv), priority=-10)
TEXT_LOG = Sidecar(suffixes=(".txt", ".log"), read=of_file(read_text_log), priority=-40)
