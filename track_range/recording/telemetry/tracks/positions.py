"""Speed and course from positions, for files that state no speed, and the unit of stated speeds by
comparison.
"""

import math
from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.recording.telemetry.tracks.track import Clock, TelemetryTrack

EARTH_RADIUS_M = 6_371_008.8  # mean radius of the Earth in metres (IUGG)
# of speeds whose unit positions show; a knot is 1852 m per hour
_SHOWN_UNITS = {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704, "kn": 1852 / 3600, "cm/s": 0.01}
MPS_PER_UNIT = _SHOWN_UNITS | {"mm/s": 0.001, "ft/s": 0.3048}
# Time between positions for a speed: at 1 Hz, noise is 0.3 m/s; in 5 s, the chord of a curve of 10
# deg/s is 3 % short.
_MIN_STEP_S, _MAX_STEP_S = 0.9, 5.0
# standard deviation of such speeds; assumed, with the rounding of times to 0.01 s
_POSITION_SPEED_SIGMA_MPS = 0.5
# of the part that comes from rounded positions, for which the time between them is chosen
_ROUNDED_SIGMA_MPS = 1.0
MOVING_MPS = 3.0  # speed above which a sample is moving: the noise of positions is small against it


def has_position(latitude_deg: FloatArray, longitude_deg: FloatArray) -> BoolArray:
    """(N,) whether there is a position; 0, 0 comes from receivers without a fix."""
    is_known = np.isfinite(latitude_deg) & np.isfinite(longitude_deg)
    return is_known & ((np.abs(latitude_deg) > 1e-6) | (np.abs(longitude_deg) > 1e-6))


def steps_m(latitude_deg: FloatArray, longitude_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N - 1, ...) northward and eastward distance from each position to the next, on a sphere, for
    short steps.
    """
    lat_rad, lon_rad = np.radians(latitude_deg), np.radians(longitude_deg)
    east_rad = np.remainder(np.diff(lon_rad, axis=0) + np.pi, 2 * np.pi) - np.pi
    middle_rad = (lat_rad[1:] + lat_rad[:-1]) / 2
    return np.diff(lat_rad, axis=0) * EARTH_RADIUS_M, east_rad * np.cos(middle_rad) * EARTH_RADIUS_M


def thinned(time_s: FloatArray, min_step_s: float = _MIN_STEP_S) -> list[int]:
    """Indices of samples at least `min_step_s` apart, in the order of increasing times."""
    kept: list[int] = []
    for index in np.argsort(time_s, kind="stable").tolist():
        if not kept or time_s[index] - time_s[kept[-1]] >= min_step_s:
            kept.append(index)
    return kept


def rounding_m(latitude_deg: FloatArray, longitude_deg: FloatArray) -> float:
    """Unit in the last place of positions, m, from decimals of degrees or of minutes; 0 = finer
    than a centimetre.
    """
    values = np.concatenate([latitude_deg, longitude_deg])
    for decimals in range(8):
        for parts in (10.0**decimals, 6 * 10.0**decimals):
            if np.allclose(values * parts, np.rint(values * parts), rtol=0, atol=1e-4):
                return math.radians(1 / parts) * EARTH_RADIUS_M
    return 0.0


def speed_from_positions(
    time_s: FloatArray,
    latitude_deg: FloatArray,
    longitude_deg: FloatArray,
    utc_s: FloatArray,
    *,
    source: str = "",
    clock: Clock = "video",
) -> TelemetryTrack | None:
    """Telemetry with the speed and course between two positions, at the middle of the step.

    `time_s` (N,) are times by the clock `clock`, `utc_s` (N,) dates and times in seconds since
    1970, NaN = unknown. Rounded positions are compared over longer steps, and the standard
    deviation contains the remaining error of their rounding. None = fewer than two positions.
    """
    is_known = has_position(latitude_deg, longitude_deg) & np.isfinite(time_s)
    known = np.flatnonzero(is_known & (np.abs(latitude_deg) <= 90) & (np.abs(longitude_deg) <= 360))
    known = known[np.argsort(time_s[known], kind="stable")]
    known = known[_is_new(time_s[known], latitude_deg[known], longitude_deg[known])]
    if len(known) < 2:
        return None
    t = time_s[known]
    pair_sigma_m = math.sqrt(2 / 12) * rounding_m(latitude_deg[known], longitude_deg[known])
    min_step_s = float(np.clip(pair_sigma_m / _ROUNDED_SIGMA_MPS, _MIN_STEP_S, _MAX_STEP_S))
    start = np.array(thinned(t))
    end = np.searchsorted(t, t[start] + min(min_step_s, float(t[-1] - t[0])) - 1e-6)
    start, end = start[end < len(t)], end[end < len(t)]
    if not len(start) or not (end > start).all():
        return None
    ends = np.stack([known[start], known[end]])
    north_m, east_m = (steps[0] for steps in steps_m(latitude_deg[ends], longitude_deg[ends]))
    step_s = t[end] - t[start]
    return TelemetryTrack(
        time_s=(t[start] + t[end]) / 2,
        speed_mps=np.hypot(north_m, east_m) / step_s,
        course_rad=np.where(
            np.hypot(north_m, east_m) > 0, np.arctan2(east_m, north_m) % (2 * np.pi), np.nan
        ),
        latitude_deg=latitude_deg[ends].mean(axis=0),
        longitude_deg=longitude_deg[ends[0]],
        utc_s=utc_s[ends].mean(axis=0),
        source=source,
        clock=clock,
        speed_sigma_mps=math.hypot(
            _POSITION_SPEED_SIGMA_MPS, pair_sigma_m / float(np.median(step_s))
        ),
        has_own_speed=False,
    )


def _is_new(time_s: FloatArray, latitude_deg: FloatArray, longitude_deg: FloatArray) -> BoolArray:
    """(N,) whether a position in the order of time is not merely repeated until the next fix, as in
    tables at 10 Hz.

    Fixes come as often as positions change in the median. A position that is held for longer than
    two of these times belongs to a car at rest.
    """
    changes = np.concatenate([[True], (np.diff(latitude_deg) != 0) | (np.diff(longitude_deg) != 0)])
    if changes.sum() < 3:
        return np.ones(len(time_s), np.bool_)
    first = np.flatnonzero(changes)
    fix_s = float(np.median(np.diff(time_s[first])))
    held_s = time_s - time_s[np.repeat(first, np.diff(first, append=len(time_s)))]
    return np.asarray(changes | (held_s > 2 * fix_s))


class SpeedRatio(NamedTuple):
    """Speeds from positions divided by stated speeds, for the samples of a moving car."""

    median: float  # NaN = too few samples
    scatter: float  # median relative deviation from it
    n_moving: int  # number of samples


def speed_ratio(
    positions: TelemetryTrack | None, time_s: FloatArray, stated: FloatArray, n_min: int
) -> SpeedRatio:
    """Comparison of speeds from positions with (N,) stated speeds, with at least `n_min`
    samples.
    """
    known = np.flatnonzero(np.isfinite(time_s) & np.isfinite(stated))
    if positions is None or not len(known):
        return SpeedRatio(math.nan, math.nan, 0)
    known = known[np.argsort(time_s[known], kind="stable")]
    stated = np.interp(positions.time_s, time_s[known], stated[known], left=0.0, right=0.0)
    is_moving = (positions.speed_mps > MOVING_MPS) & (stated > 0)
    n_moving = int(is_moving.sum())
    if len(known) < n_min or n_moving < n_min:
        return SpeedRatio(math.nan, math.nan, n_moving)
    ratios = positions.speed_mps[is_moving] / stated[is_moving]
    median = float(np.median(ratios))
    return SpeedRatio(median, float(np.median(np.abs(ratios / median - 1))), n_moving)


def unit_of_ratio(ratio: float, tolerance: float, stated: str = "m/s") -> str | None:
    """The unit of speeds that are taken as `stated` and are `ratio` times too small; None = no unit
    fits.

    The ratio may differ by the fraction `tolerance`. Units differ by 13 %.
    """
    ratio *= MPS_PER_UNIT[stated]
    unit = min(_SHOWN_UNITS, key=lambda name: abs(math.log(_SHOWN_UNITS[name] / ratio)))
    return unit if abs(MPS_PER_UNIT[unit] / ratio - 1) <= tolerance else None
