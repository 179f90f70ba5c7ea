"""usable: telemetry without implausible samples, or the reason for which a track is not used at
all.
"""

import math
from dataclasses import replace

import numpy as np

from track_range.recording.telemetry.tracks.positions import (
    MOVING_MPS,
    MPS_PER_UNIT,
    has_position,
    speed_from_positions,
    speed_ratio,
    steps_m,
    thinned,
    unit_of_ratio,
)
from track_range.recording.telemetry.tracks.track import TelemetryError, TelemetryTrack
from track_range.stereo.speed.ego_speed import MAX_SPEED_MPS

_MAX_ACCELERATION_MPS2 = 15.0  # of a car over a second; emergency braking reaches 11
# of wild samples up to which they are omitted; with more, the track is not used
_MAX_FRACTION = 0.1

_MAX_CLOCK_STEP_S, _MAX_BACKWARD_S = 30.0, 2.0
"""Largest change between the receiver's clock, which may lack 18 leap seconds at first, and the
time in the video, and largest step back of a clock; receivers repeat a second now and then."""

# gaps of whole hours are jumps of the clock; one pause in 600 is like that
_HOUR_S, _HOUR_TOLERANCE_S = 3600.0, 3.0

MIN_STABLE_S, _MIN_STABLE_FRACTION = 10.0, 0.9
"""Shortest time with a fix, and smallest fraction of samples with a fix, after which a clock that
was wrong before the fix is no reason to doubt later samples."""

# 2008; receivers without a date state 1980, 2000 or 2004, or 1024 weeks ago
_FIRST_DATE_S = 1_199_145_600.0

_MIN_LOSSES, _MIN_FIX_FRACTION = 5, 0.6
"""Number of losses of the fix from which speeds are doubted if fewer samples have a fix. Assumed:
the one known recording of a parked car with false speeds has 22 losses in 3 minutes and a fraction
of 0.38."""

_MIN_COMPARED, _UNIT_TOLERANCE, _MAX_DEVIATION = 10, 0.05, 0.12
"""Number of steps that are compared with positions; relative difference up to which they confirm a
unit, and the largest difference of a vehicle's own speed, as of a speedometer, which becomes less
certain. Units differ by 13 %."""

_NO_SPEED = -99.0  # in any unit; no vehicle reverses so fast
# largest median relative deviation of single steps where the positions decide on the unit
_MAX_SCATTER = 0.3


def usable(track: TelemetryTrack) -> TelemetryTrack:
    """The track in the order of time, without wild samples and speeds that mark a missing fix,
    which become NaN.

    A clock that is set when the receiver gets its first fix does not matter if the fix then lasts
    (`MIN_STABLE_S`). Raises TelemetryError for no fix, wild positions or speeds, or a clock that
    jumps.
    """
    track = _without_marks(track)
    if not len(track) or not np.isfinite(track.speed_mps).any():
        raise TelemetryError("the receiver had no fix.")
    try:
        _check_clock(track)
    except TelemetryError:
        warm = _after_cold_start(track)
        if warm is None:
            raise
        _check_clock(warm)
        track = warm
    # of several with the same time, one with a speed
    order = np.lexsort((np.isnan(track.speed_mps), track.time_s))
    track = track.selected(order[np.concatenate([[True], np.diff(track.time_s[order]) > 0])])
    _check_losses(track)
    _check_positions(track)
    track = with_unit(track)
    return _without_wild_speeds(track)


def _without_marks(track: TelemetryTrack) -> TelemetryTrack:
    """The track with NaN for negative speeds that mark a missing one: -1, as in iOS, if the only
    negative speed, and numbers at which no vehicle reverses.
    """
    stated = track.speed_mps / MPS_PER_UNIT[track.unit or "m/s"]
    is_mark = stated <= _NO_SPEED
    if np.allclose(stated[(stated < 0) & ~is_mark], -1.0):
        is_mark |= stated < 0
    if not is_mark.any():
        return track
    note = (
        f"its {int(is_mark.sum())} speeds of {float(stated[is_mark][0]):g} mark a missing speed "
        "and are not used."
    )
    speed_mps = np.where(is_mark, np.nan, track.speed_mps)
    return replace(track, speed_mps=speed_mps, notes=(*track.notes, note))


def _check_clock(track: TelemetryTrack) -> None:
    dated = np.isfinite(track.utc_s) & (track.utc_s > 0)
    if track.clock == "video":
        jump_s = float(np.abs(np.diff((track.utc_s - track.time_s)[dated])).max(initial=0.0))
        if jump_s > _MAX_CLOCK_STEP_S:
            raise TelemetryError(f"its clock jumps by {_duration(jump_s)}.")
        return
    steps_s = np.diff(track.time_s)
    back_s = -float(steps_s.min(initial=0.0))
    if back_s > _MAX_BACKWARD_S:
        raise TelemetryError(f"its clock jumps back by {_duration(back_s)}.")
    gaps_s = steps_s[steps_s > _HOUR_S / 2]
    hours = np.rint(gaps_s / _HOUR_S)
    is_jump = (hours >= 1) & (np.abs(gaps_s - hours * _HOUR_S) <= _HOUR_TOLERANCE_S)
    if is_jump.any():
        raise TelemetryError(f"its clock jumps by {_duration(float(gaps_s[is_jump][0]))}.")


def _after_cold_start(track: TelemetryTrack) -> TelemetryTrack | None:
    """The track from its first dated sample with a fix on; None = it starts with a fix, or the fix
    is not stable.
    """
    has_fix = np.isfinite(track.speed_mps) & ~(track.utc_s < _FIRST_DATE_S)
    if has_fix[0] or not has_fix.any():
        return None
    first = int(np.argmax(has_fix))
    warm = track.selected(np.arange(len(track)) >= first)
    length_s = float(warm.time_s.max() - warm.time_s[0])
    if length_s < MIN_STABLE_S or has_fix[first:].mean() < _MIN_STABLE_FRACTION:
        return None
    note = (
        f"its first {first} samples, before the receiver had a fix, have a wrong clock and are not "
        "used."
    )
    return replace(warm, notes=(*track.notes, note))


def _check_losses(track: TelemetryTrack) -> None:
    """Raise an error if the receiver keeps losing its fix: such fixes state 100 km/h in parked
    cars.
    """
    has_fix = np.isfinite(track.speed_mps)
    n_losses = int((has_fix[:-1] & ~has_fix[1:]).sum())
    if n_losses >= _MIN_LOSSES and has_fix.mean() < _MIN_FIX_FRACTION:
        raise TelemetryError(
            f"the receiver loses its fix {n_losses} times and has a fix in only "
            f"{has_fix.mean():.0%} of the samples; such speeds are not reliable."
        )


def _duration(seconds: float) -> str:
    return f"{seconds / 3600:.3g} h" if seconds >= _HOUR_S / 2 else f"{seconds:.3g} s"


def _check_positions(track: TelemetryTrack) -> None:
    """Raise an error if many positions are not on the Earth, or the steps between them are too
    fast.
    """
    lat, lon = track.latitude_deg, track.longitude_deg
    known = has_position(lat, lon)
    if not known.any():
        return
    is_outside = known & ((np.abs(lat) > 90) | (np.abs(lon) > 180))
    if is_outside.sum() > _MAX_FRACTION * known.sum():
        raise TelemetryError("its positions are not on the Earth.")
    inside = np.flatnonzero(known & ~is_outside)
    index = inside[thinned(track.time_s[inside])]
    if len(index) < 2:
        return
    north_m, east_m = steps_m(lat[index], lon[index])
    is_fast = np.hypot(north_m, east_m) > MAX_SPEED_MPS * np.diff(track.time_s[index])
    if is_fast.sum() > max(1.0, _MAX_FRACTION * len(is_fast)) or (is_fast.all() and len(is_fast)):
        raise TelemetryError("its positions jump.")


def with_unit(track: TelemetryTrack) -> TelemetryTrack:
    """The track with its speeds in the unit that its positions show, which sometimes differs from
    the stated unit.

    Speeds become less certain if their difference is smaller than between units. Without a stated
    unit, and with too few positions of a moving car, they are taken as m/s, with a note if any is
    fast. A TelemetryError means that the speeds contradict the positions in every unit.
    """
    if not track.has_own_speed:
        return track
    positions = speed_from_positions(
        track.time_s,
        track.latitude_deg,
        track.longitude_deg,
        np.full(len(track), np.nan),
        clock=track.clock,
    )
    ratio = speed_ratio(positions, track.time_s, track.speed_mps, _MIN_COMPARED)
    if positions is None or math.isnan(ratio.median):
        if track.unit is not None or not (np.abs(track.speed_mps) > MOVING_MPS).any():
            return track
        note = (
            f"its speeds have no unit and are taken as m/s, since only {ratio.n_moving} positions "
            "of a moving car are known, too few to find the unit."
        )
        return replace(track, notes=(*track.notes, note))
    stated_mps = float(np.nanmedian(np.abs(track.speed_mps)))
    if abs(ratio.median - 1) <= _UNIT_TOLERANCE:
        return track
    if abs(ratio.median - 1) <= _MAX_DEVIATION and track.unit is not None:
        sigma_mps = math.hypot(track.speed_sigma_mps, abs(ratio.median - 1) * stated_mps)
        note = (
            f"its speeds are {abs(1 / ratio.median - 1):.0%} "
            f"{'below' if ratio.median > 1 else 'above'} the speeds of its positions; their "
            f"standard deviation is {sigma_mps:.1f} m/s."
        )
        return replace(track, speed_sigma_mps=sigma_mps, notes=(*track.notes, note))
    stated = track.unit or "m/s"
    unit = unit_of_ratio(ratio.median, _UNIT_TOLERANCE, stated)
    if unit is None or ratio.scatter > _MAX_SCATTER:
        found_mps = ratio.median * stated_mps
        raise TelemetryError(
            f"its speeds, {stated_mps:.3g} m/s in the median, contradict its positions, which show "
            f"{found_mps:.3g} m/s; no other unit explains the difference."
        )
    note = (
        f"its speeds are in {unit} instead of {stated}, as the positions show; they were converted."
    )
    factor = MPS_PER_UNIT[unit] / MPS_PER_UNIT[stated]
    return replace(track, speed_mps=track.speed_mps * factor, unit=unit, notes=(*track.notes, note))


def _without_wild_speeds(track: TelemetryTrack) -> TelemetryTrack:
    """The track with NaN for speeds that are too large; raises TelemetryError if many are, or
    change too fast.
    """
    speed_mps = track.speed_mps
    known = np.isfinite(speed_mps)
    is_wild = known & (np.abs(speed_mps) > MAX_SPEED_MPS)
    if is_wild.sum() > _MAX_FRACTION * known.sum():
        raise TelemetryError(
            f"expected speeds of at most {MAX_SPEED_MPS * 3.6:.0f} km/h, found "
            f"{float(np.nanmax(np.abs(speed_mps))) * 3.6:.4g} km/h; the unit may be wrong."
        )
    speed_mps = np.where(is_wild, np.nan, speed_mps)
    good = np.flatnonzero(np.isfinite(speed_mps))
    index = good[thinned(track.time_s[good])]
    rate = np.abs(np.diff(speed_mps[index])) / np.diff(track.time_s[index])
    if (rate > _MAX_ACCELERATION_MPS2).sum() > max(1.0, _MAX_FRACTION * len(rate)):
        raise TelemetryError("its speeds jump.")
    return replace(track, speed_mps=speed_mps)
