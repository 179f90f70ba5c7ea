"""Hits, misses, false alarms and lead times of warnings and events.

A warning is an event of one of `WARNING_KINDS` with a `warning_s`, and its lead is the time from
`warning_s` to the contact.

    hit           contact with a warning on its object at least `min_lead_s` before it, with the lead of the first
    miss          contact without one; a later warning is too late
    false alarm   warning on an object that has no contact

An object with several contacts: a warning belongs to the next contact after the warning, or to the
last contact. Each contact counts for one kind: the kind of its first warning in time; a miss counts
for the kind of its first late warning, else for the kind that its class leads to expect (person:
pedestrian_on_path, others: forward_collision). So the counts of the kinds add up to the overall
counts.

Labelled events are matched to events of the same kind and class one to one, so that as many as
possible match, if they overlap in time or are at most `TOLERANCE_S` apart. The lead is the time
from `warning_s` (without a warning from `start_s`) to `peak_s` of the labelled event.

The object of an event: with the tracks of the run and labelled boxes, the object that its track
overlaps most often (IoU at least `MIN_IOU`) from `MARGIN_S` before the event to its end; none if it
overlaps no object in at least `MIN_FRACTION` of these frames. Without tracks or labels, a warning
belongs to a contact of the same class group and number; if no warning has the number of the
contact, to contacts of the same class group whose contact is at most `WINDOW_S` after the warning.
"""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from track_range.detection.boxes import iou
from track_range.detection.classes import ROAD_CLASSES, road_class_of
from track_range.detection.formats.label_formats import read_labels
from track_range.detection.formats.video_labels.csv_labels import has_label_columns, read_csv_labels
from track_range.evaluation.events.settings import MIN_LEAD_S
from track_range.foundation.arrays import BoolArray
from track_range.foundation.files.csv_tables import CsvTable, read_csv_table
from track_range.foundation.poisson import rate_interval
from track_range.ranging.truth.truth import Truth
from track_range.results.events.event import EVENT_KINDS, WARNING_KINDS, Event, EventKind
from track_range.results.events.files import EventFileError
from track_range.results.rows.rows import Rows

CONTACT_COLUMNS = ("object_id", "class", "contact_s")

_LIMITS = {
    "object_id": (0.0, 2.0**53, "an integer from 0"),
    "contact_s": (0.0, 1e9, "a time in seconds from 0"),
}
"""Smallest and largest value of each column of numbers, and the expected value for messages."""


@dataclass(frozen=True, slots=True)
class Contact:
    """A contact that happens, or would happen without braking, with an object of a road class."""

    object_id: int
    class_name: str
    contact_s: float  # from the first frame


def read_contacts(path: Path) -> tuple[Contact, ...]:
    """Contacts of a contacts.csv, in its order; EventFileError if it cannot be read or lacks a
    valid value.
    """
    table = read_csv_table(
        path, EventFileError, f"contacts with the columns {','.join(CONTACT_COLUMNS)}", exact=True
    )
    table.require(CONTACT_COLUMNS)
    numbers = {}
    for name, (low, high, expected) in _LIMITS.items():
        values = table.numbers(name)
        is_valid = (values >= low) & (values <= high)
        if name == "object_id":
            is_valid &= values.round() == values
        table.check(name, is_valid, expected)
        numbers[name] = values.tolist()
    classes = road_classes(table, ROAD_CLASSES)
    rows = zip(numbers["object_id"], classes, numbers["contact_s"], strict=True)
    return tuple(Contact(int(object_id), name, contact_s) for object_id, name, contact_s in rows)


def road_classes(
    table: CsvTable, allowed: Sequence[str], *, is_blank_allowed: BoolArray | bool = False
) -> list[str]:
    """Road classes of the column `class`, "" where it may be blank and is; the table's error for
    one that is not allowed.
    """
    classes = [road_class_of(name) or "" for name in table.texts("class")]
    is_valid = np.isin(classes, allowed) | is_blank_allowed
    table.check("class", is_valid, f"one of the classes {', '.join(allowed)}")
    return classes


# sections `overall` and `by_kind`, and lists of single results, as in the JSON file
Scores = dict[str, Any]
# largest time between a labelled event and one that matches it, s: labels are set by hand
TOLERANCE_S = 1.0

_COUNTS = ("hits", "misses", "false_alarms")
_FURTHER_COUNTS = ("late", "tolerated", "repeated", "ambiguous")  # of `occurrences`
_NO_MATCH = 1e9  # cost of a pair that does not match
_GROUPS = {  # group by road class; the others are separate
    **dict.fromkeys(("bicycle", "motorcycle"), "two-wheeler"),
    **dict.fromkeys(("car", "bus", "truck"), "vehicle"),
}


def is_warning(event: Event) -> bool:
    """Whether an event is a collision warning."""
    return event.kind in WARNING_KINDS and math.isfinite(event.warning_s)


def known_from_s(event: Event) -> float:
    """Time from which a driver knows of an event: its warning, or its start without one."""
    return event.warning_s if math.isfinite(event.warning_s) else event.start_s


def contact_scores(
    events: Sequence[Event],
    object_ids: Sequence[int | None],
    contacts: Sequence[Contact],
    *,
    hours: float | None,
    min_lead_s: float = MIN_LEAD_S,
) -> Scores:
    """Scores of collision warnings against all contacts of a drive of `hours`; None = unknown.

    Events that are not warnings are ignored. `object_ids` are the identities of the objects of the
    N events; None = none, or unknown. `min_lead_s` is the shortest lead of a hit.
    """
    on_contact: dict[int, list[Event]] = {}
    false_alarms = []
    for event, object_id in zip(events, object_ids, strict=True):
        if is_warning(event):
            index = _contact_of(event, object_id, contacts)
            if index is None:
                false_alarms.append(event)
            else:
                on_contact.setdefault(index, []).append(event)
    rows = [
        _contact_row(contact, on_contact.get(i, []), min_lead_s)
        for i, contact in enumerate(contacts)
    ]
    results = [(row["kind"], "hits" if row["is_hit"] else "misses", row["lead_s"]) for row in rows]
    results += [(event.kind, "false_alarms", None) for event in false_alarms]
    false_warnings = [
        {
            "kind": event.kind,
            "warning_s": rounded(event.warning_s),
            "track_id": event.track_id,
            "class": event.class_name,
        }
        for event in false_alarms
    ]
    return {
        **sections_of(results, WARNING_KINDS, hours),
        "contacts": rows,
        "false_warnings": false_warnings,
    }


def _contact_of(event: Event, object_id: int | None, contacts: Sequence[Contact]) -> int | None:
    """Index of the contact that a warning belongs to; None = its object has no contact."""
    by_time = sorted(
        (row.contact_s, i) for i, row in enumerate(contacts) if row.object_id == object_id
    )
    if not by_time:
        return None
    after = [i for contact_s, i in by_time if contact_s >= event.warning_s]
    return after[0] if after else max(by_time, key=lambda row: row[0])[1]


def _contact_row(contact: Contact, warnings: Sequence[Event], min_lead_s: float) -> dict[str, Any]:
    """Result of a contact: its columns, and `is_hit`, `kind`, `lead_s` of the first warning (None =
    no warning).
    """
    first = min(warnings, key=lambda event: event.warning_s, default=None)
    lead_s = None if first is None else rounded(contact.contact_s - first.warning_s)
    return {
        "object_id": contact.object_id,
        "class": contact.class_name,
        "contact_s": contact.contact_s,
        "is_hit": lead_s is not None and lead_s >= min_lead_s,
        "kind": expected_kind(contact.class_name) if first is None else first.kind,
        "lead_s": lead_s,
    }


def expected_kind(class_name: str) -> EventKind:
    """Kind of a warning that an object of a class should cause."""
    return "pedestrian_on_path" if class_name == "person" else "forward_collision"


def event_scores(
    events: Sequence[Event], labelled: Sequence[Event], *, hours: float | None
) -> Scores:
    """Scores of events against labelled events of a video of `hours`; None = unknown."""
    cost = np.array([[_cost(event, label) for event in events] for label in labelled]).reshape(
        len(labelled), len(events)
    )
    rows, columns = linear_sum_assignment(cost)
    is_match = cost[rows, columns] < _NO_MATCH
    matched = dict(zip(rows[is_match].tolist(), columns[is_match].tolist(), strict=True))
    results: list[tuple[str, str, float | None]] = []
    for index, label in enumerate(labelled):
        if index in matched:
            event = events[matched[index]]
            results.append((label.kind, "hits", rounded(label.peak_s - known_from_s(event))))
        else:
            results.append((label.kind, "misses", None))
    used = set(matched.values())
    results += [
        (event.kind, "false_alarms", None)
        for index, event in enumerate(events)
        if index not in used
    ]
    return sections_of(results, EVENT_KINDS, hours)


def _cost(event: Event, label: Event) -> float:
    """Time between two events in s, plus a small part of the time between their peaks."""
    gap_s = max(event.start_s - label.end_s, label.start_s - event.end_s, 0.0)
    if (
        event.kind != label.kind
        or gap_s > TOLERANCE_S
        or not are_same_class(event.class_name, label.class_name)
    ):
        return _NO_MATCH
    return gap_s + 1e-3 * min(abs(event.peak_s - label.peak_s), 1e3)


def are_same_class(one: str, other: str) -> bool:
    """Whether two objects may be one: detectors confuse vehicles, and riders with two-wheelers; ""
    = unknown class.
    """
    groups = {
        _GROUPS.get(road_class_of(name) or name.lower(), name.lower())
        for name in (one, other)
        if name
    }
    return len(groups) < 2


def sections_of(
    results: Iterable[tuple[str, str, float | None]], kinds: Sequence[str], hours: float | None
) -> Scores:
    """Sections of the results; each result has a kind, the name of a count, and the lead of a
    hit.
    """
    results = list(results)

    def section(chosen: Sequence[tuple[str, str, float | None]]) -> dict[str, Any]:
        counts = {name: sum(count == name for _, count, _ in chosen) for name in _COUNTS}
        leads_s = [lead_s for _, count, lead_s in chosen if count == "hits" and lead_s is not None]
        return {**counts, **rates_of(counts["false_alarms"], hours), "lead_s": leads_s}

    by_kind = {kind: section([result for result in results if result[0] == kind]) for kind in kinds}
    return {"overall": section(results), "by_kind": by_kind}


def rates_of(n_false_alarms: int, hours: float | None) -> dict[str, Any]:
    """Hours, and the false alarms per hour with the 95 % interval of their rate; None = unknown."""
    if not hours:
        return {
            "hours": hours,
            "false_alarms_per_hour": None,
            "false_alarms_per_hour_95": None,
        }
    interval = rate_interval(n_false_alarms, hours)
    return {
        "hours": round(hours, 6),
        "false_alarms_per_hour": round(n_false_alarms / hours, 4),
        "false_alarms_per_hour_95": [round(limit, 4) for limit in interval],
    }


def pooled(drives: Sequence[Scores]) -> Scores:
    """Sections of several drives together: sums, and the leads of all; the hours are unknown if
    those of a drive are.
    """
    kinds = dict.fromkeys(kind for drive in drives for kind in drive["by_kind"])
    by_kind = {
        kind: _pooled([drive["by_kind"][kind] for drive in drives if kind in drive["by_kind"]])
        for kind in kinds
    }
    return {"overall": _pooled([drive["overall"] for drive in drives]), "by_kind": by_kind}


def _pooled(parts: Sequence[dict[str, Any]]) -> dict[str, Any]:
    names = [*_COUNTS, *(name for name in _FURTHER_COUNTS if any(name in part for part in parts))]
    sums = {name: sum(part.get(name, 0) for part in parts) for name in names}
    hours = [part["hours"] for part in parts]
    total = None if None in hours else sum(hours)
    leads_s = [lead_s for part in parts for lead_s in part["lead_s"]]
    return {**sums, **rates_of(sums["false_alarms"], total), "lead_s": leads_s}


def rounded(value: float) -> float:
    """A value with the four decimals of the JSON files."""
    return round(float(value), 4)


# of a track with its object: boxes that the image border cuts, near a contact, fit badly
MIN_IOU = 0.3
MARGIN_S = 1.0  # time before the start of an event for which its track is compared, s
# of the frames, in which a track overlaps its object: objects that are largely hidden have no label
MIN_FRACTION = 0.2
# from a warning to a contact of its class, and of its number too
WINDOW_S, SAME_ID_WINDOW_S = 10.0, 30.0


def read_boxes(path: Path) -> Truth:
    """Objects of a file of labels in any format, in rectified pixels; `LabelFileError` if it cannot
    be read.

    All objects count, and objects that are less than half visible have no distance.
    """
    if path.is_file() and has_label_columns(path):
        labels = read_csv_labels(path)
        distance_m = np.where(labels.visible_share >= 0.5, labels.distance_m, np.nan)
        columns = (labels.xyxy_px, distance_m, labels.closing_mps)
        return Truth(
            labels.frame, labels.track_id, labels.class_name, np.zeros_like(labels.frame), *columns
        )
    table = read_labels(path, expected="labels of the objects")
    columns = (table.xyxy_px, table.distance_m, np.full(len(table), np.nan))
    return Truth(
        table.frame, table.track_id, table.class_name, np.zeros_like(table.frame), *columns
    )


def objects_by_boxes(events: Sequence[Event], rows: Rows, boxes: Truth) -> list[int | None]:
    """Identity of the object of each event, from the boxes of its track in the rows of the run;
    None = no object.
    """
    xyxy_px, time_s, frame = rows.boxes_px, rows["time_s"], rows["frame"]
    order = np.argsort(boxes.frame, kind="stable")
    frames = boxes.frame[order]
    objects: list[int | None] = []
    for event in events:
        is_near = (time_s >= event.start_s - MARGIN_S) & (time_s <= event.end_s)
        own = np.flatnonzero((rows["track_id"] == event.track_id) & is_near)
        votes: Counter[int] = Counter()
        for row in own.tolist():
            first, last = np.searchsorted(frames, [frame[row], frame[row] + 1]).tolist()
            labels = order[first:last]
            labels = labels[boxes.track_id[labels] >= 0]
            if len(labels):
                overlap = iou(xyxy_px[row : row + 1], boxes.xyxy_px[labels])[0]
                if overlap.max() >= MIN_IOU:
                    votes[int(boxes.track_id[labels[overlap.argmax()]])] += 1
        best = votes.most_common(1)
        objects.append(best[0][0] if best and best[0][1] >= MIN_FRACTION * len(own) else None)
    return objects


def objects_by_time(events: Sequence[Event], contacts: Sequence[Contact]) -> list[int | None]:
    """Identity of the object of each event, from numbers, classes and times alone; None = no
    object.
    """
    objects: list[int | None] = [None] * len(events)
    for contact in sorted(contacts, key=lambda contact: contact.contact_s):
        near = [
            i
            for i, event in enumerate(events)
            if objects[i] is None and _may_belong(event, contact, WINDOW_S)
        ]
        same = [
            i
            for i, event in enumerate(events)
            if event.track_id == contact.object_id and _may_belong(event, contact, SAME_ID_WINDOW_S)
        ]
        for i in same or near:
            objects[i] = contact.object_id
    return objects


def _may_belong(event: Event, contact: Contact, window_s: float) -> bool:
    if not is_warning(event) or not are_same_class(event.class_name, contact.class_name):
        return False
    return (
        event.start_s - MARGIN_S <= contact.contact_s
        and contact.contact_s - event.warning_s <= window_s
    )
