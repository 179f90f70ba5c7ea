"""Events of a run in words, and their data for the script of the page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from track_range.results.events.event import (
    EVENT_KINDS,
    Event,
    clip_name,
    probability_words,
    severity_key,
)

KIND_WORDS: Mapping[str, str] = {
    "forward_collision": "forward collision warning",
    "close_following": "close following",
    "hard_approach": "hard approach",
    "cut_in": "cut-in",
    "pedestrian_on_path": "pedestrian on path",
    "near_miss": "near miss",
}

_LEAST_SHOWN_MPS2 = 0.05  # a smaller required deceleration would be shown as 0.0
MAX_EVENTS = 500  # maximum number of events in a page; the most severe ones of a longer run


def kind_words(kind: str) -> str:
    """A kind of event in words; the name of an unknown kind."""
    return KIND_WORDS.get(kind, kind.replace("_", " "))


def kind_counts(events: Sequence[Event]) -> list[str]:
    """Number of events of each kind that occurs, such as "2 \N{MULTIPLICATION SIGN} near miss"."""
    counts = {kind: sum(event.kind == kind for event in events) for kind in EVENT_KINDS}
    return [f"{n} \N{MULTIPLICATION SIGN} {kind_words(kind)}" for kind, n in counts.items() if n]


def object_words(event: Event) -> str:
    """Class and identity of the object of an event, such as "car 12"."""
    return (
        f"{event.class_name} {event.track_id}"
        if event.track_id > 0
        else event.class_name or "unknown object"
    )


def event_details(event: Event) -> str:
    """Measurements of an event in one line."""
    return " · ".join(measurements(event))


def measurements(event: Event) -> list[str]:
    """Measurements of an event in words: the state at its peak, then extremes; unknown values are
    omitted.

    Events of earlier versions have only extremes.
    """
    smallest_sigma = plus_minus(event.min_distance_sigma_m)
    if math.isfinite(event.peak_distance_m):
        peak_m = f"{event.peak_distance_m:.1f}{plus_minus(event.peak_distance_sigma_m)} m"
        gap_m = f"{event.gap_m:.1f}{smallest_sigma} m"
        state = (
            (event.peak_distance_m, f"at {time_words(event.peak_s)}: {peak_m} from the camera"),
            (event.peak_ttc_s, f"time to contact {event.peak_ttc_s:.1f} s"),
            (event.peak_closing_mps, f"closing {event.peak_closing_mps:.1f} m/s"),
            (event.peak_headway_s, f"headway {event.peak_headway_s:.1f} s"),
            (event.ego_mps, f"ego {3.6 * event.ego_mps:.0f} km/h"),
            (
                event.peak_probability,
                f"predicted contact {probability_words(event.peak_probability)}",
            ),
            (event.gap_m, f"smallest gap from the front bumper {gap_m}"),
            (
                event.drac_mps2 if event.drac_mps2 >= _LEAST_SHOWN_MPS2 else math.nan,
                f"required deceleration up to {event.drac_mps2:.1f} m/s²",
            ),
            (event.pet_s, f"post-encroachment time {event.pet_s:.1f} s"),
        )
        return [text for value, text in state if math.isfinite(value)]
    texts = (
        (event.min_distance_m, f"{event.min_distance_m:.1f}{smallest_sigma} m"),
        (event.min_ttc_s, f"time to contact {event.min_ttc_s:.1f} s"),
        (event.closing_mps, f"closing {event.closing_mps:.1f} m/s"),
        (event.headway_s, f"headway {event.headway_s:.1f} s"),
        (event.ego_mps, f"ego {3.6 * event.ego_mps:.0f} km/h"),
        (event.probability, f"predicted contact {probability_words(event.probability)}"),
    )
    return [text for value, text in texts if math.isfinite(value)]


def plus_minus(sigma_m: float) -> str:
    """A standard deviation after its value; "" = unknown."""
    return f" ± {sigma_words(sigma_m)}" if math.isfinite(sigma_m) else ""


def sigma_words(sigma_m: float) -> str:
    """A standard deviation in m: centimetres below 10 cm, so that a small value is not shown as
    0.0.
    """
    return f"{sigma_m:.1f}" if sigma_m >= 0.095 else f"{max(sigma_m, 0.01):.2f}"


def time_words(time_s: float) -> str:
    """A time of a video: seconds below two minutes, else minutes and seconds, or hours."""
    if time_s < 119.95:
        return f"{time_s:.1f} s"
    minutes, seconds = divmod(round(time_s), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"


def moment_words(time_s: float) -> str:
    """A moment of a video, which is not to be read as a headway or a time to collision."""
    return f"{time_words(time_s)} into the video"


def shown_events(events: Sequence[Event]) -> tuple[Event, ...]:
    """The most severe `MAX_EVENTS` events in the order of their starts."""
    return tuple(
        sorted(sorted(events, key=severity_key)[:MAX_EVENTS], key=lambda event: event.start_s)
    )


def clips_of(
    events: Sequence[Event], shown: Sequence[Event], addresses: Mapping[str, str]
) -> list[str]:
    """Addresses of the clips of shown events, "" = none; `events` are all, in the order of
    events.csv.
    """
    numbers = {id(event): number for number, event in enumerate(events, 1)}
    names = (clip_name(numbers[id(event)], event.kind, event.track_id) for event in shown)
    return [addresses.get(name, "") for name in names]


def event_records(events: Sequence[Event], clips: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Data of events for the page: kind, times in s (`warning_s` None = no warning), texts, and
    addresses of clips.
    """
    return [
        {
            "kind": event.kind,
            "words": kind_words(event.kind),
            "object": object_words(event),
            "time": time_words(event.start_s),
            "warning": time_words(event.warning_s) if math.isfinite(event.warning_s) else "",
            "start_s": round(event.start_s, 3),
            "peak_s": round(event.peak_s if math.isfinite(event.peak_s) else event.start_s, 3),
            "end_s": round(max(event.end_s, event.start_s), 3),
            "warning_s": round(event.warning_s, 3) if math.isfinite(event.warning_s) else None,
            "track_id": event.track_id,
            "details": measurements(event),
            "reason": event.reason,
            "clip": clip,
        }
        for event, clip in zip(events, clips or [""] * len(events), strict=True)
    ]


def hidden_events_note(events: Sequence[Event], shown: Sequence[Event]) -> str:
    """Sentence about events that the page leaves out; "" if it shows all."""
    n_hidden = len(events) - len(shown)
    return (
        f"The {len(shown)} most severe events are listed; {n_hidden} more are in events.csv."
        if n_hidden
        else ""
    )
