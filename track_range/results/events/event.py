"""Event: something that happened on a drive; the settings of its detection, and the name of its
clip.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal, get_args

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

_CLIP_NAME = re.compile(rf"\d{{2,}}-(?:{'|'.join(EVENT_KINDS)})-\d+\.mp4", re.ASCII)


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Something that happened on a drive; times are seconds from the first frame, NaN = unknown or
    none.
    """

    kind: EventKind  # one of `EVENT_KINDS`
    start_s: float  # time at which it started
    peak_s: float  # time of its most critical frame
    end_s: float  # time at which it ended
    warning_s: float  # time of the collision warning; NaN = no warning
    frame: int  # number of the most critical frame
    track_id: int  # identity of the object at the peak
    class_name: str  # road class of the object
    min_distance_m: float  # smallest distance of the object
    min_distance_sigma_m: float  # standard deviation of that distance
    min_ttc_s: float  # smallest time to collision with the front, `SafetyMeasures.ttc_front_s`
    closing_mps: float  # largest closing speed
    ego_mps: float  # speed of the ego vehicle at the peak
    probability: float  # largest probability of contact, 0..1
    reason: str  # what happened in one sentence
    headway_s: float  # smallest headway, gap / ego speed
    # 1 = what the distances follow from contradicted the drive at the peak; 0 = not
    scale_in_doubt: int = 0
    gap_m: float = math.nan  # smallest distance from the front of the ego vehicle
    drac_mps2: float = math.nan  # largest required deceleration
    mdrac_mps2: float = math.nan  # the same after the reaction time
    tet_s: float = math.nan  # time exposed below `TTC_LIMIT_S`
    tit_s2: float = math.nan  # integral below it
    pet_s: float = math.nan  # post-encroachment time of paths that cross
    peak_distance_m: float = math.nan  # the state in the most critical frame
    peak_closing_mps: float = math.nan
    peak_ttc_s: float = math.nan
    peak_headway_s: float = math.nan
    peak_probability: float = math.nan


# of events.csv, in order; `class` is `Event.class_name`, the others are its attributes
EVENT_COLUMNS = (
    *("kind", "start_s", "peak_s", "end_s", "warning_s", "frame", "track_id", "class"),
    *(
        "min_distance_m",
        "min_distance_sigma_m",
        "min_ttc_s",
        "closing_mps",
        "ego_mps",
        "probability",
        "reason",
    ),
    "headway_s",
    "scale_in_doubt",
    *("gap_m", "drac_mps2", "mdrac_mps2", "tet_s", "tit_s2", "pet_s"),
    *("peak_distance_m", "peak_closing_mps", "peak_ttc_s", "peak_headway_s", "peak_probability"),
)


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
    near_miss_ttc_s: float = 1.0  # time to collision below which an avoided contact is a near miss
    near_miss_probability: float = 0.5  # smallest probability of contact of a near miss
    # smallest gap that is left after a near miss; a smaller one may be a contact
    near_miss_gap_m: float = 0.5


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


def clip_name(number: int, kind: str, track_id: int) -> str:
    """File name of the clip of the event in row `number` of events.csv, counted from 1:
    "02-cut_in-17.mp4".
    """
    return f"{number:02}-{kind}-{track_id}.mp4"


def is_clip_name(name: str) -> bool:
    """Whether a file name belongs to a clip."""
    return _CLIP_NAME.fullmatch(name) is not None
