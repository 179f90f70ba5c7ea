"""Speed and course from positions, for files that state no speed, and the unit of stated speeds by comparison."""

from __future__ import annotations

import math

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.recording.telemetry.track import Clock, TelemetryTrack

EARTH_RADIUS_M = 6_371_008.8  # mean radius of the Earth in metres (IUGG)
MPS_PER_UNIT = {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704, "kn": 1852 / 3600}  # a knot is 1852 m per hour
_MIN_STEP_S = 0.9  # shortest time between positions for a speed: receivers repeat them; at 1 Hz, noise is 0.3 m/s
_POSITION_SPEED_SIGMA_MPS = 0.5  # standard deviation of such speeds; assumed, with the rounding of times to 0.01 s
MOVING_MPS = 3.0  # speed above which a sample is moving: the noise of positions is small against it


def has_position(latitude_deg: FloatArray, longitude_deg: FloatArray) -> BoolArray:
    """(N,) whether there is a position; 0, 0 is that of receivers without a fix."""
    is_known = np.isfinite(latitude_deg) & np.isfinite(longitude_deg)
    return is_known & ((np.abs(latitude_deg) > 1e-6) | (np.abs(longitude_deg) > 1e-6))


def steps_m(latitude_deg: FloatArray, longitude_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N - 1,) northward and eastward distance from each position to the next, on a sphere, for short steps."""
    lat_rad, lon_rad = np.radians(latitude_deg), np.radians(longitude_deg)
    east_rad = np.remainder(np.diff(lon_rad) + np.pi, 2 * np.pi) - np.pi
    middle_rad = (lat_rad[1:] + lat_rad[:-1]) / 2
    return np.diff(lat_rad) * EARTH_RADIUS_M, east_rad * np.cos(middle_rad) * EARTH_RADIUS_M


def thinned(time_s: FloatArray, min_step_s: float = _MIN_STEP_S) -> list[int]:
    """Indices of samples at least `min_step_s` apart, in the order of increasing times."""
    kept: list[int] = []
    for index in np.argsort(time_s, kind="stable").tolist():
        if not kept or time_s[index] - time_s[kept[-1]] >= min_step_s:
            kept.append(index)
    return kept


def speed_from_positions(
    time_s: FloatArray,
    latitude_deg: FloatArray,
    longitude_deg: FloatArray,
    utc_s: FloatArray,
    *,
    source: str = "",
    clock: Clock = "video",
) -> TelemetryTrack | None:
    """Telemetry with the speed and course between successive positions, at the middle of each step.

    The (N,) times are of the clock `clock`, `utc_s` are the dates and times; NaN = unknown. None = fewer than two
    positions.
    """
    known = np.flatnonzero(has_position(latitude_deg, longitude_deg) & np.isfinite(time_s))
    index = known[thinned(time_s[known])] if len(known) else known
    if len(index) < 2:
        return None
    north_m, east_m = steps_m(latitude_deg[index], longitude_deg[index])
    step_s = np.diff(time_s[index])
    return TelemetryTrack(
        time_s=(time_s[index][1:] + time_s[index][:-1]) / 2,
        speed_mps=np.hypot(north_m, east_m) / step_s,
        course_rad=np.where(np.hypot(north_m, east_m) > 0, np.arctan2(east_m, north_m) % (2 * np.pi), np.nan),
        latitude_deg=(latitude_deg[index][1:] + latitude_deg[index][:-1]) / 2,
        longitude_deg=longitude_deg[index][:-1],
        utc_s=(utc_s[index][1:] + utc_s[index][:-1]) / 2,
        source=source,
        clock=clock,
        speed_sigma_mps=_POSITION_SPEED_SIGMA_MPS,
        has_own_speed=False,
    )


def speed_ratio(
    positions: TelemetryTrack | None, time_s: FloatArray, stated: FloatArray, n_min: int
) -> tuple[float | None, int]:
    """Median ratio of speeds from positions to stated ones (N,), None = below `n_min`; and number of moving samples."""
    known = np.flatnonzero(np.isfinite(time_s) & np.isfinite(stated))
    if positions is None or not len(known):
        return None, 0
    known = known[np.argsort(time_s[known], kind="stable")]
    stated = np.interp(positions.time_s, time_s[known], stated[known])
    is_moving = (positions.speed_mps > MOVING_MPS) & (stated > 0)
    n_moving = int(is_moving.sum())
    if len(known) < n_min or n_moving < n_min:
        return None, n_moving
    return float(np.median(positions.speed_mps[is_moving] / stated[is_moving])), n_moving


def unit_of_ratio(ratio: float, tolerance: float) -> str | None:
    """The unit whose factor to m/s is within a fraction `tolerance` of a ratio; None = none. Units differ by 13 %."""
    unit = min(MPS_PER_UNIT, key=lambda name: abs(math.log(MPS_PER_UNIT[name] / ratio)))
    return unit if abs(MPS_PER_UNIT[unit] / ratio - 1) <= tolerance else None
