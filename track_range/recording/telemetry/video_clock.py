"""on_video_clock: telemetry with its times in seconds from the first frame of a video file.

times of the video                      directly
UTC or local time, video with UTC       the difference of the clocks; where no time fits, whole time zones are tried,
                                        unless the user states the time of the video
UTC or local time, video without        from the start of the video, if both have the same length
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.recording.telemetry.sidecars.time_texts import DAY_S
from track_range.recording.telemetry.tracks.track import TelemetryError, TelemetryTrack
from track_range.recording.video.utc import UtcStart
from track_range.recording.video.video import VideoPart
from track_range.stereo.speed.ego_speed import MAX_GAP_S

ZONES_H = (  # differences between local times and UTC in use, hours
    *(float(hours) for hours in range(-12, 15)),
    *(-9.5, -3.5, -2.5, 3.5, 4.5, 5.5, 5.75, 6.5, 8.75, 9.5, 10.5, 12.75, 13.75),
)

# standard deviation of the times of GPS samples within a video, s: receivers lag by 0.2 to 1 s
_VIDEO_SIGMA_S = 0.5
# standard deviation of the difference between two clocks that state whole seconds, s
_CLOCK_SIGMA_S = 1.0
_MIN_NAMED = 0.1  # smallest fraction of a video that telemetry which the user names must cover
_MIN_COVERED = 0.5  # smallest fraction of a video that telemetry of another time zone must cover
# largest difference in s between the starts of a video and of telemetry that was recorded with it
_START_S = 5.0
# largest difference of equal lengths, and fraction of the length
_EQUAL_LENGTH_S, _EQUAL_LENGTH_FRACTION = 3.0, 0.05


def on_video_clock(track: TelemetryTrack, part: VideoPart) -> tuple[TelemetryTrack, float]:
    """A track in the order of time with the times of a video, and the standard deviation of its
    offset in s.

    `start_s` of the video file is not used. A TelemetryError means that the times do not fit the
    video, or cannot be matched.
    """
    if track.clock == "video":
        return track, _VIDEO_SIGMA_S
    if part.utc is None:
        return _started_together(track, part.duration_s), _CLOCK_SIGMA_S
    if track.time_s[-1] < 2 * DAY_S:  # times of the day, without a date
        days = round((part.utc.start_s - float(track.time_s[0])) / DAY_S)
        track = replace(track, time_s=track.time_s + days * DAY_S)
    starts_s = _possible_starts_s(part.utc, part.duration_s)
    is_local = track.clock == "local" or part.utc.is_local
    fits = [] if is_local else _fits(track.time_s, [0.0], starts_s, part.duration_s, 0.0)
    if is_local or not (fits or part.utc.is_stated):
        zones_s = [3600.0 * hours for hours in sorted(ZONES_H, key=abs)]
        fits = _fits(track.time_s, zones_s, starts_s, part.duration_s, _MIN_COVERED)
    if not fits:
        raise TelemetryError(_no_overlap(track, part.utc.start_s, part.duration_s))
    together = [fit for fit in fits if abs(float(track.time_s[0]) + fit[0] - fit[1]) <= _START_S]
    if len(together or fits) > 1:
        if track.clock == "local":
            raise TelemetryError(
                "its local times fit the video in several time zones; cut it to the time of the "
                "video, or convert its times to UTC."
            )
        raise TelemetryError(
            "the start of the video is not known well enough to match the times; give the time of "
            "the first frame with --start-utc."
        )
    zone_s, start_s = (together or fits)[0]
    notes = track.notes
    if zone_s and not is_local:
        hours = f"{zone_s / 3600:+g} h"
        notes += (f"its times differ from the video's times by a time zone; {hours} are added.",)
    time_s = track.time_s + zone_s - start_s
    return replace(track, time_s=time_s, clock="video", notes=notes), _CLOCK_SIGMA_S


def _started_together(track: TelemetryTrack, duration_s: float) -> TelemetryTrack:
    """A track as long as a video without a date, from its start; TelemetryError: it is not."""
    length_s = float(track.time_s[-1] - track.time_s[0])
    tolerance_s = max(_EQUAL_LENGTH_S, _EQUAL_LENGTH_FRACTION * duration_s)
    is_known = bool(duration_s) and math.isfinite(length_s)
    if not is_known or abs(length_s - duration_s) > tolerance_s:
        raise TelemetryError(
            "the video states no date and time that could be matched with its times; give the "
            "time of the first frame with --start-utc."
        )
    note = (
        "the video states no date and time; it is as long as the telemetry, so both are taken "
        "to start together."
    )
    time_s = track.time_s - track.time_s[0]
    return replace(track, time_s=time_s, clock="video", notes=(*track.notes, note))


def _possible_starts_s(utc: UtcStart, duration_s: float) -> list[float]:
    """The start that a video states; of an uncertain one also the start if it is the end: some
    recorders state the end without saying so.
    """
    is_uncertain = (utc.uncertainty_s or 0.0) > max(2.0, 0.5 * duration_s)
    if not utc.is_local and duration_s > 0 and is_uncertain:
        return [utc.start_s, utc.start_s - duration_s]
    return [utc.start_s]


def _fits(
    time_s: FloatArray,
    zones_s: Sequence[float],
    starts_s: Sequence[float],
    duration_s: float,
    least: float,
) -> list[tuple[float, float]]:
    """Zones and starts, s, with which the times cover the video by `least`, or at all (0)."""
    fits = []
    for zone_s in zones_s:
        for start_s in starts_s:
            fraction = covered(time_s + zone_s - start_s, duration_s)
            if fraction > 0 and fraction >= least:
                fits.append((zone_s, start_s))
    return fits


def _no_overlap(track: TelemetryTrack, start_s: float, duration_s: float) -> str:
    zones_s = [3600.0 * hours for hours in ZONES_H]
    fits = _fits(track.time_s, zones_s, [start_s], duration_s, 0.0)
    advice = ": another day, or another drive."
    if fits:
        local = _text(start_s - fits[0][0])
        advice = f"; if the time of the video is local, give --start-utc as {local}."
    times = f"{_text(float(track.time_s[0]))} to {_text(float(track.time_s[-1]))}"
    return f"its times, {times}, do not overlap the video, which starts {_text(start_s)}{advice}"


def check_covered(time_s: FloatArray, length_s: float, source: str) -> None:
    """Raise TelemetryError, which names the source, if samples that the user names do not belong to
    the video.

    They must cover a tenth of its length, 0 = unknown; (N,) times in s from its first frame.
    """
    overlap_s = min(float(time_s[-1]), length_s) - max(float(time_s[0]), 0.0)
    fraction = max(overlap_s, 0.0) / length_s if length_s else 1.0
    if fraction < _MIN_NAMED:
        raise TelemetryError(
            f"{source}: expected the times of the video, 0 to {length_s:.1f} s, found "
            f"{time_s[0]:.1f} to {time_s[-1]:.1f} s, which cover {fraction:.0%} of the video; give "
            "the file of this drive, or --start-utc."
        )


def covered(time_s: FloatArray, duration_s: float) -> float:
    """Fraction of a video of this length that (N,) samples in the order of time cover, s from its
    first frame.
    """
    end_s = max(duration_s, 1.0)
    inner = np.concatenate([[0.0], time_s[(time_s > 0) & (time_s < end_s)], [end_s]])
    before = bool((time_s <= 0).any()) and -float(time_s[time_s <= 0].max()) <= MAX_GAP_S
    after = (
        bool((time_s >= end_s).any()) and float(time_s[time_s >= end_s].min()) - end_s <= MAX_GAP_S
    )
    gaps_s = np.diff(inner)
    is_covered = gaps_s <= MAX_GAP_S
    if len(inner) == 2:
        inside = bool((time_s <= 0).any()) and bool((time_s >= end_s).any())
        return float(inside and before and after)
    is_covered[0] &= before or inner[1] <= MAX_GAP_S
    return float(gaps_s[is_covered].sum() / end_s)


def _text(utc_s: float) -> str:
    try:
        return datetime.fromtimestamp(utc_s, UTC).strftime("%Y-%m-%d %H:%M:%S")
    except (ValueError, OverflowError, OSError):
        return "at an unknown time"
