"""Sample: one record of a receiver with its date, coordinates and unit of speed, and the track of a
list of samples.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, Literal, NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.recording.telemetry.tracks.positions import (
    MPS_PER_UNIT,
    speed_from_positions,
    speed_ratio,
    unit_of_ratio,
)
from track_range.recording.telemetry.tracks.track import Clock, TelemetryTrack
from track_range.stereo.speed.ego_speed import MAX_SPEED_MPS

# largest number of samples read from one file: seven hours at 18 Hz, GoPro's rate
MAX_SAMPLES = 500_000
Unit = Literal["known", "assumed", "unknown"]  # how the unit of a format's speed is documented
# difference to speeds from positions, and moving samples, that confirm a unit
_UNIT_TOLERANCE, _MIN_MOVING = 0.06, 5
# largest relative difference between the pace of a track and that of the receiver's clock
_PACE_TOLERANCE = 0.1
# largest difference to the stated speed at which the course from positions is used
_COURSE_AGREEMENT = 0.3

_METERS = r"m(?:et(?:er|re)s?)?"
_SHORT = r"(?<![er])[\s_.·*]?"  # between the letters of a unit, as in km_h and m s-1
_HOUR = rf"(?:[\s_]*(?:/|per|p)[\s_]*h(?:(?:ou)?rs?)?|{_SHORT}h\^?(?:-1|⁻¹)?)"
_SECOND = rf"(?:[\s_]*(?:/|per|p)[\s_]*s(?:ec(?:ond)?s?)?|{_SHORT}s\^?(?:-1|⁻¹)?)"
# A unit begins after no letter, except in speedkmh. Beside a number, as in 0.1 km/h, km/h * 100 and
# mph_x10, it is not that of the numbers.
_BEFORE = r"(?:(?<![a-z])|(?<=speed))(?<!\d)(?<!\d[\s*])"
_AFTER = (
    r"(?![a-z/]|\s?(?:²|[-^*]{0,2}2)|[\])\s_]*(?:[*x/]\s?\d|[\[(]\s*(?:[*x]|\d+/|1e|0?\.)[-\d]|"
    r".{0,9}(?:factor|scale)))"
)
_UNITS = {  # notations of each unit, in the order in which they are looked for
    unit: re.compile(rf"{_BEFORE}(?:{notation}){_AFTER}", re.IGNORECASE)
    for unit, notation in {
        "kn": rf"knots?|k[nt]s?|n(?:autical)?[\s_]?m(?:i(?:les?)?)?{_HOUR}|nmph",
        "km/h": rf"k(?:ilo)?(?:{_METERS}|ms){_HOUR}|kmhr|k\.?p\.?h|км[\s_]*/[\s_]*ч",
        "mph": rf"mi(?:les?)?{_HOUR}|m\.?p\.?h",
        "cm/s": rf"c(?:enti)?{_METERS}{_SECOND}",
        "mm/s": rf"m(?:illi)?{_METERS}{_SECOND}",
        "ft/s": rf"(?:ft|feet|foot){_SECOND}",
        "m/s": rf"{_METERS}{_SECOND}",
    }.items()
}


class Sample(NamedTuple):
    """One record of a receiver; NaN = not stated, or no fix."""

    # seconds from the first frame, or since 1970 where the file has no other time
    time_s: float = math.nan
    # receiver's date and time, seconds since 1970; local where the format states local time
    utc_s: float = math.nan
    speed_mps: float = math.nan  # horizontal speed
    course_deg: float = math.nan  # clockwise from north
    latitude_deg: float = math.nan
    longitude_deg: float = math.nan

    def at(self, time_s: float) -> Sample:
        """This sample with another time."""
        return self._replace(time_s=time_s)


def plain_track(
    samples: Sequence[Sample] | FloatArray, source: str, clock: Clock, **given: Any
) -> TelemetryTrack:
    """Telemetry of samples, or of (N, 6) rows of their fields, as they are; `given`: other
    attributes of the track.
    """
    rows = np.array(samples, np.float64).reshape(-1, 6)
    names = ("time_s", "utc_s", "speed_mps", "course_rad", "latitude_deg", "longitude_deg")
    columns: dict[str, Any] = dict(zip(names, rows.T.copy(), strict=True))
    columns["course_rad"] = np.radians(columns["course_rad"])
    return TelemetryTrack(source=source, clock=clock, **columns, **given)


def track(
    samples: Sequence[Sample],
    source: str,
    clock: Clock = "video",
    *,
    has_own_speed: bool = True,
    unit: Unit = "known",
    notes: tuple[str, ...] = (),
    **given: Any,
) -> TelemetryTrack | None:
    """Telemetry of samples; None = no sample has a time, or no two have the positions that are
    needed.

    Numbers that no receiver reports (negative speeds, latitudes beyond 90 degrees) become NaN.
    Without a stated speed, `speed_mps` is derived from the positions; `unit`: see `in_known_unit`;
    `given`: other attributes of the track.
    """
    samples, unit_notes = in_known_unit(samples, unit)
    notes = (*notes, *unit_notes)
    rows = np.array(samples, np.float64).reshape(-1, 6)
    rows = rows[np.isfinite(rows[:, 0])][:MAX_SAMPLES]
    if not len(rows):
        return None
    rows[~np.isfinite(rows)] = np.nan
    time_s, utc_s, speed_mps, course_deg, latitude_deg, longitude_deg = rows.T  # parts of the rows
    is_wild = (np.abs(latitude_deg) > 90) | (np.abs(longitude_deg) > 180)
    latitude_deg[is_wild] = longitude_deg[is_wild] = np.nan
    if not has_own_speed:
        derived = speed_from_positions(
            time_s, latitude_deg, longitude_deg, utc_s, source=source, clock=clock
        )
        return replace(derived, notes=notes) if derived else None
    speed_mps[speed_mps < 0] = np.nan
    if not np.isfinite(course_deg).any():
        course_deg[:] = course_from_positions(time_s, speed_mps, latitude_deg, longitude_deg)
    plain = plain_track(rows, source, clock, notes=notes, **given)
    return replace(plain, course_rad=plain.course_rad % (2 * np.pi))


def on_receiver_clock(samples: Sequence[Sample]) -> list[Sample]:
    """Samples of a track without video, scaled to the receiver's clock if the paces differ by more
    than 10 %.
    """
    known = [sample for sample in samples if math.isfinite(sample.utc_s)]
    if len(known) < 2 or known[-1].time_s <= known[0].time_s:
        return list(samples)
    pace = (known[-1].utc_s - known[0].utc_s) / (known[-1].time_s - known[0].time_s)
    steps_s = np.diff([sample.utc_s for sample in known])
    if abs(pace - 1) <= _PACE_TOLERANCE or not (steps_s > 0).all():
        return list(samples)
    return [sample.at(sample.time_s * pace) for sample in samples]


def has_plausible_positions(samples: Sequence[Sample]) -> bool:
    """Whether positions are on the Earth and nine tenths of the speeds between them are possible
    for a vehicle.
    """
    rows = np.array(samples, np.float64).reshape(-1, 6)[:, [0, 4, 5]]
    time_s, latitude_deg, longitude_deg = rows[np.isfinite(rows).all(axis=1)].T
    if ((np.abs(latitude_deg) > 90) | (np.abs(longitude_deg) > 180)).any():
        return False
    moved = speed_from_positions(time_s, latitude_deg, longitude_deg, time_s)
    return moved is None or float(np.percentile(moved.speed_mps, 90)) <= MAX_SPEED_MPS


def in_known_unit(samples: Sequence[Sample], unit: Unit) -> tuple[list[Sample], tuple[str, ...]]:
    """Samples, read as km/h, in the unit that positions confirm, and notes; NaN speeds if it stays
    unknown.
    """
    if unit == "known":
        return list(samples), ()
    time_s, _, speed_mps, _, latitude_deg, longitude_deg = (
        np.array(samples, np.float64).reshape(-1, 6).T
    )
    moved = speed_from_positions(time_s, latitude_deg, longitude_deg, time_s)
    ratio = speed_ratio(moved, time_s, speed_mps, _MIN_MOVING).median
    confirmed = None if math.isnan(ratio) else unit_of_ratio(ratio, _UNIT_TOLERANCE, "km/h")
    if confirmed is not None:
        factor = MPS_PER_UNIT[confirmed] / MPS_PER_UNIT["km/h"]
        return [sample._replace(speed_mps=sample.speed_mps * factor) for sample in samples], ()
    if unit == "assumed":
        return list(samples), ("The unit of the speed is not documented; km/h is assumed.",)
    without = [sample._replace(speed_mps=math.nan) for sample in samples]
    return without, (
        "The unit of the speed is unknown, and the positions are encrypted; the speed is not used.",
    )


def course_from_positions(
    time_s: FloatArray, speed_mps: FloatArray, latitude_deg: FloatArray, longitude_deg: FloatArray
) -> FloatArray:
    """(N,) course in degrees from the positions where they agree with the stated speed; NaN
    elsewhere.
    """
    course_deg = np.full(len(time_s), np.nan)
    moved = speed_from_positions(time_s, latitude_deg, longitude_deg, time_s)
    if (
        moved is None
        or (np.diff(moved.time_s) <= 0).any()
        or not np.isfinite(moved.course_rad).any()
    ):
        return course_deg
    is_known = np.isfinite(moved.course_rad)
    east, north = (
        np.interp(time_s, moved.time_s[is_known], f(moved.course_rad[is_known]))
        for f in (np.sin, np.cos)
    )
    speed_of_positions = np.interp(time_s, moved.time_s, moved.speed_mps)
    agrees = (speed_mps > 1) & (
        np.abs(speed_of_positions - speed_mps) < np.maximum(1, _COURSE_AGREEMENT * speed_mps)
    )
    course_deg[agrees] = np.degrees(np.arctan2(east, north))[agrees]
    return course_deg


def date_s(
    year: float, month: float, day: float, hour: float, minute: float, second: float
) -> float:
    """Seconds since 1970 of a date and time; NaN = invalid. Years below 100 count from 2000."""
    try:
        date = int(year) + 2000 if year < 100 else int(year), int(month), int(day)
        whole = datetime(*date, int(hour), int(minute), tzinfo=UTC)
    except (ValueError, OverflowError):
        return math.nan
    return whole.timestamp() + second if 0 <= second < 61 else math.nan


def degrees(ddmm: float, hemisphere: str = "") -> float:
    """Decimal degrees of a coordinate in degrees and minutes (DDMM.MMMM), negative in the south and
    west.
    """
    if not math.isfinite(ddmm):
        return math.nan
    whole = math.trunc(ddmm / 100)
    return signed(whole + (ddmm - 100 * whole) / 60, hemisphere)


def signed(value: float, hemisphere: str) -> float:
    """A coordinate that is negative in the south and west."""
    return -abs(value) if hemisphere in ("S", "W") else value


def unit_in(text: str) -> str | None:
    """The unit of speed that a heading or a text names; None if it names none."""
    return next((unit for unit, notation in _UNITS.items() if notation.search(text)), None)
