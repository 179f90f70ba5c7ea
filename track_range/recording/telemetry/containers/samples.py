"""Samples of speed and position read from a video file, and the TelemetryTrack of a list of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Literal

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.recording.telemetry.positions import speed_from_positions
from track_range.recording.telemetry.sidecars.units import MPS_PER_UNIT
from track_range.recording.telemetry.track import GPS_SPEED_SIGMA_MPS, Clock, TelemetryTrack

MAX_SAMPLES = 500_000
"""Largest number of samples read from one file: seven hours at 18 Hz, GoPro's rate."""

Unit = Literal["known", "assumed", "unknown"]
"""Whether the unit of a format's speed is documented, assumed from few recordings, or unknown."""

_UNIT_TOLERANCE = 0.06
"""Largest relative difference of speeds to those from positions at which a unit counts as confirmed; the units are 15 %
apart or more."""

_PACE_TOLERANCE = 0.1
"""Largest relative difference between the pace of a track and that of the receiver's clock."""

_MAX_SPEED_MPS = 120.0
"""Largest plausible speed, as in the checks of telemetry."""

_MIN_MOVING = 5
"""Smallest number of moving samples that confirm a unit."""

_COURSE_AGREEMENT = 0.3
"""Largest relative difference between the speed from positions and the stated one at which the course is used."""

_MOVING_MPS = 3.0
"""Speed above which a sample is moving: the noise of positions is small against it."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One record of a receiver; NaN = not stated, or no fix.

    Attributes:
        time_s: seconds from the first frame of the video, or since 1970 where the file has no other time.
        utc_s: date and time of the receiver, seconds since 1970; local time where the format states local time.
        speed_mps: horizontal speed.
        course_deg: clockwise from north.
        latitude_deg, longitude_deg: position.
    """

    time_s: float = math.nan
    utc_s: float = math.nan
    speed_mps: float = math.nan
    course_deg: float = math.nan
    latitude_deg: float = math.nan
    longitude_deg: float = math.nan

    def at(self, time_s: float) -> Sample:
        """This sample with another time."""
        return replace(self, time_s=time_s)


def track(
    samples: Sequence[Sample],
    source: str,
    clock: Clock = "video",
    *,
    speed_sigma_mps: float = GPS_SPEED_SIGMA_MPS,
    has_own_speed: bool = True,
    notes: tuple[str, ...] = (),
) -> TelemetryTrack | None:
    """Telemetry of samples; None = no sample has a time, or no two have the positions that are needed.

    Numbers that no receiver reports (negative speeds, latitudes beyond 90 degrees) become NaN. Without an own speed,
    `speed_mps` is derived from the positions.
    """
    rows = np.array(
        [(s.time_s, s.utc_s, s.speed_mps, s.course_deg, s.latitude_deg, s.longitude_deg) for s in samples]
    ).reshape(-1, 6)
    rows = rows[np.isfinite(rows[:, 0])][:MAX_SAMPLES]
    if not len(rows):
        return None
    rows[~np.isfinite(rows)] = np.nan
    time_s, utc_s, speed_mps, course_deg, latitude_deg, longitude_deg = rows.T.copy()
    is_wild = (np.abs(latitude_deg) > 90) | (np.abs(longitude_deg) > 180)
    latitude_deg[is_wild] = longitude_deg[is_wild] = np.nan
    if not has_own_speed:
        derived = speed_from_positions(time_s, latitude_deg, longitude_deg, utc_s, source=source, clock=clock)
        return replace(derived, notes=notes) if derived else None
    speed_mps[speed_mps < 0] = np.nan
    if not np.isfinite(course_deg).any():
        course_deg = _course_from_positions(time_s, speed_mps, latitude_deg, longitude_deg)
    return TelemetryTrack(
        time_s=time_s,
        speed_mps=speed_mps,
        course_rad=np.radians(course_deg) % (2 * np.pi),
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        utc_s=utc_s,
        source=source,
        clock=clock,
        speed_sigma_mps=speed_sigma_mps,
        notes=notes,
    )


def on_receiver_clock(samples: Sequence[Sample]) -> list[Sample]:
    """Samples with their times scaled to the pace of the receiver's clock where the two differ by more than 10 %.

    For tracks without a video, of which the times may be nominal.
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
    """Whether positions are on the Earth and the median of the speeds between them is possible for a vehicle."""
    rows = np.array([(s.time_s, s.latitude_deg, s.longitude_deg) for s in samples]).reshape(-1, 3)
    time_s, latitude_deg, longitude_deg = rows[np.isfinite(rows).all(axis=1)].T
    if ((np.abs(latitude_deg) > 90) | (np.abs(longitude_deg) > 180)).any():
        return False
    moved = speed_from_positions(time_s, latitude_deg, longitude_deg, time_s, source="", clock="video")
    return moved is None or float(np.percentile(moved.speed_mps, 90)) <= _MAX_SPEED_MPS


def in_known_unit(samples: Sequence[Sample], unit: Unit) -> tuple[list[Sample], tuple[str, ...]]:
    """Samples with their speeds in m/s as positions confirm, and notes.

    Args:
        samples: samples with times, and speeds as if the file had km/h.
        unit: what is known of the unit. If it is unknown and positions do not confirm one, speeds become NaN.
    """
    if unit == "known":
        return list(samples), ()
    factor = _confirmed_factor(samples)
    if factor is not None:
        return [replace(sample, speed_mps=sample.speed_mps * factor) for sample in samples], ()
    if unit == "assumed":
        return list(samples), ("The unit of the speed is not documented; km/h is assumed.",)
    without = [replace(sample, speed_mps=math.nan) for sample in samples]
    return without, ("The unit of the speed is unknown, and the positions are encrypted; it is not used.",)


def _confirmed_factor(samples: Sequence[Sample]) -> float | None:
    """Factor to speeds read as km/h with which they agree with the positions; None = no unit agrees."""
    rows = np.array([(s.time_s, s.latitude_deg, s.longitude_deg, s.speed_mps) for s in samples]).reshape(-1, 4)
    moved = speed_from_positions(rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 0], source="", clock="video")
    if moved is None:
        return None
    known = np.isfinite(rows[:, 0]) & np.isfinite(rows[:, 3])
    if known.sum() < _MIN_MOVING:
        return None
    order = np.argsort(rows[known, 0], kind="stable")
    stated_mps = np.interp(moved.time_s, rows[known, 0][order], rows[known, 3][order])
    is_moving = (moved.speed_mps > _MOVING_MPS) & (stated_mps > 0)
    if is_moving.sum() < _MIN_MOVING:
        return None
    ratio = float(np.median(moved.speed_mps[is_moving] / stated_mps[is_moving]))
    factors = [factor / MPS_PER_UNIT["km/h"] for factor in MPS_PER_UNIT.values()]
    return next((factor for factor in factors if abs(ratio / factor - 1) <= _UNIT_TOLERANCE), None)


def _course_from_positions(
    time_s: FloatArray, speed_mps: FloatArray, latitude_deg: FloatArray, longitude_deg: FloatArray
) -> FloatArray:
    """(N,) course in degrees from the positions where they agree with the stated speed; NaN elsewhere."""
    course_deg = np.full(len(time_s), np.nan)
    moved = speed_from_positions(time_s, latitude_deg, longitude_deg, time_s, source="", clock="video")
    if moved is None or (np.diff(moved.time_s) <= 0).any():
        return course_deg
    is_known = np.isfinite(moved.course_rad)
    if not is_known.any():
        return course_deg
    east, north = (np.interp(time_s, moved.time_s[is_known], f(moved.course_rad[is_known])) for f in (np.sin, np.cos))
    speed_of_positions = np.interp(time_s, moved.time_s, moved.speed_mps)
    agrees = (speed_mps > 1) & (np.abs(speed_of_positions - speed_mps) < np.maximum(1, _COURSE_AGREEMENT * speed_mps))
    course_deg[agrees] = np.degrees(np.arctan2(east, north))[agrees]
    return course_deg


def date_s(year: float, month: float, day: float, hour: float, minute: float, second: float) -> float:
    """Seconds since 1970 of a date and time; NaN = it is none. Years below 1980 count from 2000."""
    if not all(math.isfinite(value) for value in (year, month, day, hour, minute, second)) or not 0 <= second < 61:
        return math.nan
    try:
        whole = datetime(
            int(year) + 2000 if year < 1980 else int(year), int(month), int(day), int(hour), int(minute), tzinfo=UTC
        )
    except (ValueError, OverflowError):
        return math.nan
    return whole.timestamp() + second


def degrees(ddmm: float, hemisphere: str = "") -> float:
    """Decimal degrees of a coordinate in degrees and minutes (DDMM.MMMM), negative in the south and west."""
    if not math.isfinite(ddmm):
        return math.nan
    whole = math.trunc(ddmm / 100)
    value = whole + (ddmm - 100 * whole) / 60
    return -abs(value) if hemisphere in ("S", "W") else value
