"""Event: something that happened on a drive; the settings of its detection, and the name of its
clip.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Literal, get_args

from track_range.foundation.schemas.validation import check_numbers

EventKind = Literal[
    "forward_collision",
    "close_following",
    "hard_approach",
    "cut_in",
    "pedestrian_on_path",
    "near_miss",
]

# kinds of events, in the order of the documentation
EVENT_KINDS: tuple[EventKind, ...] = get_args(EventKind)

WARNING_KINDS: tuple[EventKind, ...] = ("forward_collision", "cut_in", "pedestrian_on_path")
"""Kinds of events that can contain a collision warning."""

CLIPS_FOLDER = "clips"  # folder of the clips of events in that of a run
# time before the start and after the end of an event that its clip and its scenario have, s
_BEFORE_S, _AFTER_S = 3.0, 2.0
_MAX_CLIP_S = 30.0  # of a clip; that of a longer event has two thirds before the peak

_CLIP_NAME = re.compile(rf"\d{{2,}}-(?:{'|'.join(EVENT_KINDS)})-\d+\.mp4", re.ASCII)


@dataclass(frozen=True, slots=True)
class EventNumber:
    """A column of numbers: unit, limits of plausible values, decimals in events.csv."""

    unit: str
    low: float
    high: float
    decimals: int = 3
    is_integer: bool = False


_TIME = {"column": EventNumber("s", 0.0, 1e9)}  # 30 years of video
_TIME_INTEGRAL = {"column": EventNumber("s2", 0.0, 1e9)}
_SPEED = {"column": EventNumber("m/s", -1e4, 1e4)}
_DECELERATION = {"column": EventNumber("m/s2", 0.0, 1e6)}
_DISTANCE = {"column": EventNumber("m", 0.0, 1e6)}
_PROBABILITY = {"column": EventNumber("", 0.0, 1.0, decimals=4)}
_NUMBER = {"column": EventNumber("", 0, 1e9, is_integer=True)}
_IDENTITY = {"column": EventNumber("", 0, 2.0**53, is_integer=True)}
_FLAG = {"column": EventNumber("", 0, 1, is_integer=True)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Something that happened on a drive; times are seconds from the first frame, NaN = unknown or
    none.

    The attributes are the columns of events.csv, in this order; `class_name` is the column `class`.
    """

    kind: EventKind  # one of `EVENT_KINDS`
    start_s: float = field(metadata=_TIME)  # time at which it started
    peak_s: float = field(metadata=_TIME)  # time of its most critical frame
    end_s: float = field(metadata=_TIME)  # time at which it ended
    warning_s: float = field(metadata=_TIME)  # time of the collision warning; NaN = no warning
    frame: int = field(metadata=_NUMBER)  # number of the most critical frame
    track_id: int = field(metadata=_IDENTITY)  # identity of the object at the peak
    class_name: str  # road class of the object
    min_distance_m: float = field(metadata=_DISTANCE)  # smallest distance of the object
    min_distance_sigma_m: float = field(metadata=_DISTANCE)  # standard deviation of that distance
    # smallest time to collision with the front, `SafetyMeasures.ttc_front_s`
    min_ttc_s: float = field(metadata=_TIME)
    closing_mps: float = field(metadata=_SPEED)  # largest closing speed
    ego_mps: float = field(metadata=_SPEED)  # speed of the ego vehicle at the peak
    probability: float = field(metadata=_PROBABILITY)  # largest probability of contact, 0..1
    reason: str  # what was measured and predicted, in words
    headway_s: float = field(metadata=_TIME)  # smallest headway, gap / ego speed
    # 1 = what the distances follow from contradicted the drive at the peak; 0 = not
    scale_in_doubt: int = field(default=0, metadata=_FLAG)
    # smallest distance from the front of the ego vehicle
    gap_m: float = field(default=math.nan, metadata=_DISTANCE)
    # largest required deceleration
    drac_mps2: float = field(default=math.nan, metadata=_DECELERATION)
    # the same after the reaction time
    mdrac_mps2: float = field(default=math.nan, metadata=_DECELERATION)
    tet_s: float = field(default=math.nan, metadata=_TIME)  # time exposed below `TTC_LIMIT_S`
    tit_s2: float = field(default=math.nan, metadata=_TIME_INTEGRAL)  # integral below it
    # post-encroachment time of paths that cross
    pet_s: float = field(default=math.nan, metadata=_TIME)
    # the state in the most critical frame
    peak_distance_m: float = field(default=math.nan, metadata=_DISTANCE)
    peak_closing_mps: float = field(default=math.nan, metadata=_SPEED)
    peak_ttc_s: float = field(default=math.nan, metadata=_TIME)
    peak_headway_s: float = field(default=math.nan, metadata=_TIME)
    peak_probability: float = field(default=math.nan, metadata=_PROBABILITY)
    peak_distance_sigma_m: float = field(default=math.nan, metadata=_DISTANCE)
    clip_file: str = ""  # its video, relative to the folder of the results; "" = none


EVENT_COLUMNS = tuple("class" if one.name == "class_name" else one.name for one in fields(Event))

EVENT_NUMBERS: Mapping[str, EventNumber] = {  # all other columns are texts
    one.name: one.metadata["column"] for one in fields(Event) if one.metadata
}


@dataclass(frozen=True, slots=True, kw_only=True)
class EventSettings:
    """Thresholds of the events; definitions, not fitted."""

    # longest interruption of an event; tracks of one object with a shorter gap are merged
    max_gap_s: float = 1.0
    close_headway_s: float = 1.0  # headway below which following is close
    min_following_s: float = 1.0  # shortest duration of close following
    # smallest ego speed of close following and cut-ins; below, traffic is dense
    min_ego_mps: float = 5.0
    cut_in_headway_s: float = 1.0  # headway below which a vehicle that enters the ego path cuts in
    cut_in_s: float = 4.0  # time after which a vehicle that has entered the path no longer cuts in
    # deceleration needed to avoid a contact above which an approach is hard
    hard_approach_mps2: float = 4.0
    # shortest hard approach or near miss; shorter ones are errors of single frames
    min_critical_s: float = 0.2
    near_miss_ttc_s: float = 1.0  # time to collision below which a predicted contact is a near miss
    near_miss_probability: float = 0.5  # smallest probability of contact of a near miss
    # smallest last gap of a near miss on the path; a smaller one may be a contact
    near_miss_gap_m: float = 0.5

    def __post_init__(self) -> None:
        check_numbers(self)


def probability_words(probability: float) -> str:
    """A probability of contact in per cent; over 99 % without a figure, since none is certain."""
    return "over 99 %" if probability > 0.99 else f"{100 * probability:.0f} %"


def severity_key(event: Event) -> tuple[bool, float, float, float, float]:
    """Sort key of events, the most severe first.

    Events with a collision warning come first; then the larger probability of contact, the shorter
    time to collision, the smaller distance, and the earlier peak. Unknown values come last.
    """
    return (
        math.isnan(event.warning_s),
        0.0 if math.isnan(event.probability) else -event.probability,
        math.inf if math.isnan(event.min_ttc_s) else event.min_ttc_s,
        math.inf if math.isnan(event.min_distance_m) else event.min_distance_m,
        event.peak_s,
    )


def clip_interval_s(event: Event) -> tuple[float, float]:
    """Start and end of an event's clip in seconds from the start of the video; the video may be
    shorter.
    """
    start_s, end_s = event.start_s - _BEFORE_S, event.end_s + _AFTER_S
    if end_s - start_s > _MAX_CLIP_S:
        start_s = min(max(event.peak_s - 2 * _MAX_CLIP_S / 3, start_s), end_s - _MAX_CLIP_S)
        end_s = start_s + _MAX_CLIP_S
    return start_s, end_s


def clip_name(number: int, kind: str, track_id: int) -> str:
    """File name of the clip of the event in row `number` of events.csv, counted from 1:
    "02-cut_in-17.mp4".
    """
    return f"{number:02}-{kind}-{track_id}.mp4"


def with_clip_files(
    events: Sequence[Event], names: Collection[str], folder: str = CLIPS_FOLDER
) -> tuple[Event, ...]:
    """All events of a run with their clips, if these are among the names of files in a folder."""
    clips = [clip_name(i + 1, event.kind, event.track_id) for i, event in enumerate(events)]
    return tuple(
        replace(event, clip_file=f"{folder}/{name}" if name in names else "")
        for event, name in zip(events, clips, strict=True)
    )


def is_clip_name(name: str) -> bool:
    """Whether a file name belongs to a clip."""
    return _CLIP_NAME.fullmatch(name) is not None
