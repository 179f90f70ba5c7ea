"""Differences between the events of two runs of a video, matched by kind, time and place.

Events match if they are of the same kind, if their times overlap within `TIME_TOLERANCE_S`, and if the boxes of their
tracks overlap in the frames that both tracks have (median IoU), or if their distances are similar where there are none.
The pairs with the nearest peaks are matched first.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from track_range.detection.boxes import iou
from track_range.foundation.arrays import FloatArray
from track_range.results.columns import Columns, boxes_px
from track_range.results.events.event import EVENT_KINDS, Event
from track_range.views.report.content.events import event_details, kind_words, object_words, time_words
from track_range.views.report.tables import Cell, Column, Grid, grid_of

TIME_TOLERANCE_S = 0.5
"""Largest gap in s between the times of matching events."""

MIN_IOU = 0.3
"""Smallest median IoU of the boxes of matching events."""

_DISTANCE_FRACTION, _DISTANCE_M = 0.2, 2.0
"""Largest difference of the distances of matching events without common frames: relative, and in metres."""

_CHANGED_S, _CHANGED_SIGMA = 0.2, 1.0
"""Differences that are listed: times in s, and distances in their joint standard deviation."""

_CHANGED_FRACTION = 0.1
"""Relative difference of distances without a standard deviation that is listed."""


@dataclass(frozen=True, slots=True)
class EventDifference:
    """Events of two runs that differ.

    Attributes:
        first: event of the first run; None = only in the second.
        second: event of the second run; None = only in the first.
        changes: what differs between two matching events.
    """

    first: Event | None
    second: Event | None
    changes: tuple[str, ...] = ()

    @property
    def event(self) -> Event:
        """The event of the first run that has one."""
        event = self.first or self.second
        if event is None:
            raise ValueError("a difference without events")
        return event


def event_differences(
    first: Sequence[Event], first_rows: Columns, second: Sequence[Event], second_rows: Columns
) -> list[EventDifference]:
    """Events of two runs that differ, in the order of time; the rows are those of the runs, for the places."""
    pairs = _matches(first, _tracks(first_rows), second, _tracks(second_rows))
    differences = [EventDifference(event, None) for i, event in enumerate(first) if i not in pairs]
    differences += [EventDifference(None, event) for j, event in enumerate(second) if j not in pairs.values()]
    for i, j in pairs.items():
        changes = tuple(_changes(first[i], second[j]))
        differences += [EventDifference(first[i], second[j], changes)] if changes else []
    return sorted(differences, key=lambda difference: difference.event.start_s)


_Boxes = dict[int, dict[int, FloatArray]]
"""Boxes of the tracks of a run by track and frame."""


def _tracks(rows: Columns) -> _Boxes:
    tracks: _Boxes = {}
    if not {"frame", "track_id", "x1_px", "y1_px", "x2_px", "y2_px"} <= rows.keys():
        return tracks
    values = zip(rows["track_id"].tolist(), rows["frame"].tolist(), boxes_px(rows), strict=True)
    for track_id, frame, box in values:
        tracks.setdefault(int(track_id), {})[int(frame)] = box
    return tracks


def _matches(
    first: Sequence[Event], first_boxes: _Boxes, second: Sequence[Event], second_boxes: _Boxes
) -> dict[int, int]:
    """Indices of the matching events of the second run by those of the first."""
    candidates = []
    order = sorted(range(len(second)), key=lambda j: second[j].start_s)
    for i, event in enumerate(first):
        for j in order:
            if second[j].start_s > event.end_s + TIME_TOLERANCE_S:
                break
            if _match(event, second[j]) and _is_same_place(event, first_boxes, second[j], second_boxes):
                candidates.append((abs(event.peak_s - second[j].peak_s), i, j))
    pairs: dict[int, int] = {}
    matched: set[int] = set()
    for _, i, j in sorted(candidates):
        if i not in pairs and j not in matched:
            pairs[i] = j
            matched.add(j)
    return pairs


def _match(a: Event, b: Event) -> bool:
    is_near = a.start_s <= b.end_s + TIME_TOLERANCE_S and b.start_s <= a.end_s + TIME_TOLERANCE_S
    return a.kind == b.kind and is_near


def _is_same_place(a: Event, a_boxes: _Boxes, b: Event, b_boxes: _Boxes) -> bool:
    first, second = a_boxes.get(a.track_id, {}), b_boxes.get(b.track_id, {})
    low, high = sorted((a.frame, b.frame))
    margin = max(10, high - low)
    frames = [frame for frame in first if frame in second and low - margin <= frame <= high + margin]
    if frames:
        overlaps = [float(iou(first[frame][None], second[frame][None])[0, 0]) for frame in frames]
        return float(np.median(overlaps)) >= MIN_IOU
    difference_m = abs(a.min_distance_m - b.min_distance_m)  # NaN = unknown
    largest_m = max(_DISTANCE_M, _DISTANCE_FRACTION * max(a.min_distance_m, b.min_distance_m))
    return not difference_m > largest_m


def _changes(a: Event, b: Event) -> Iterator[str]:
    """What differs between matching events, in words."""
    if a.class_name != b.class_name:
        yield f"class {a.class_name} \N{RIGHTWARDS ARROW} {b.class_name}"
    yield from _changed_time("warning", a.warning_s, b.warning_s, absolute=True)
    yield from _changed_time("start", a.start_s, b.start_s, absolute=True)
    yield from _changed_time("end", a.end_s, b.end_s, absolute=True)
    sigma_m = math.hypot(a.min_distance_sigma_m, b.min_distance_sigma_m)
    tolerance_m = _CHANGED_SIGMA * sigma_m
    if not math.isfinite(tolerance_m):
        tolerance_m = _CHANGED_FRACTION * max(a.min_distance_m, b.min_distance_m)
    if abs(a.min_distance_m - b.min_distance_m) > tolerance_m:
        yield f"smallest distance {a.min_distance_m:.1f} \N{RIGHTWARDS ARROW} {b.min_distance_m:.1f} m"
    yield from _changed_time("time to collision", a.min_ttc_s, b.min_ttc_s, absolute=False)


def _changed_time(name: str, a_s: float, b_s: float, *, absolute: bool) -> Iterator[str]:
    """A difference of times; `absolute`: of times in the video, otherwise of durations."""
    if math.isnan(a_s) and math.isnan(b_s):
        return
    if math.isnan(a_s) or math.isnan(b_s):
        first, second = ("none" if math.isnan(value) else time_words(value) for value in (a_s, b_s))
        yield f"{name} {first} \N{RIGHTWARDS ARROW} {second}"
    elif abs(a_s - b_s) > _CHANGED_S and absolute:
        yield f"{name} {abs(a_s - b_s):.1f} s {'later' if b_s > a_s else 'earlier'}"
    elif abs(a_s - b_s) > _CHANGED_S:
        yield f"{name} {a_s:.1f} \N{RIGHTWARDS ARROW} {b_s:.1f} s"


def difference_grid(
    differences: Sequence[EventDifference], names: tuple[str, str], links: tuple[str | None, str | None]
) -> Grid:
    """One row per differing event: time, with a link to that moment in the report of its run, kind, and difference.

    Args:
        differences: events that differ.
        names: names of the two runs.
        links: addresses of their reports; None = none.
    """
    rows = []
    for difference in differences:
        event, run = difference.event, 0 if difference.first is not None else 1
        link = links[run]
        time = Cell(time_words(event.start_s), link=f"{link}#t={event.start_s:.3f}" if link else "")
        events = [item for item in (difference.first, difference.second) if item is not None]
        objects = " / ".join(dict.fromkeys(object_words(item) for item in events))
        state = "changed" if difference.changes else f"only in {names[run]}"
        details = "; ".join(difference.changes) or event_details(event)
        rows.append((time, Cell(state), Cell(kind_words(event.kind)), Cell(objects), Cell(details)))
    columns = ("time", "difference", "event", "object", "details")
    return Grid(f"Events that differ: {names[0]} and {names[1]}", columns, tuple(rows), has_sentences=True)


def count_grid(names: Sequence[str], events: Sequence[Sequence[Event] | None]) -> Grid:
    """One row per run: number of events of each kind that occurs in a run, and of warnings; unknown ones are empty."""
    kinds = [kind for kind in EVENT_KINDS if any(event.kind == kind for of_run in events for event in of_run or ())]
    columns = [
        Column(
            kind_words(kind),
            [None if of_run is None else sum(event.kind == kind for event in of_run) for of_run in events],
            "{:.0f}",
        )
        for kind in kinds
    ]
    warned = [None if of_run is None else sum(math.isfinite(event.warning_s) for event in of_run) for of_run in events]
    if not kinds:
        return Grid("Number of events", (), ())
    return grid_of("Number of events", "run", list(names), [*columns, Column("with a warning", warned, "{:.0f}")])
