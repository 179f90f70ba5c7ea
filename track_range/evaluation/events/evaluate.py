"""Evaluation of the events of a run: warnings against contacts, or events against labelled events.

Hits, misses, false alarms, leads and the objects of warnings are defined in `scores`. Where the
tracks of the run and labelled boxes with closing speeds are known, the errors of the closing speeds
are added, by class.
"""

import math
from collections.abc import Collection, Container, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.classes import road_class_of
from track_range.detection.formats.label_formats import is_blank
from track_range.evaluation.events.scores import (
    CONTACT_COLUMNS,
    Contact,
    contact_scores,
    event_scores,
    is_warning,
    objects_by_boxes,
    objects_by_time,
    read_boxes,
    read_contacts,
)
from track_range.evaluation.events.settings import EventEvaluationSettings
from track_range.foundation.files.input_files import counted, first_line
from track_range.foundation.files.output_files import OutputError
from track_range.foundation.files.structured_text import read_json
from track_range.ranging.truth.errors import match_truth, score_closing
from track_range.ranging.truth.truth import Truth
from track_range.results.events.event import Event
from track_range.results.events.files import (
    EVENTS_FILE,
    NEEDED_COLUMNS,
    EventFileError,
    read_events,
)
from track_range.results.folder import read_run_rows, rows_file
from track_range.results.rows.rows import Rows

# labels of a simulated drive beside its contacts, the first that exists
BOX_FILES = ("truth.csv", "truth.txt")

_MAX_SUMMARY_BYTES = 50_000_000
_MAX_HOURS = 1e6

BY_BOXES = (
    "object of a warning: the labelled object that the warning's track overlaps most often (IoU at "
    "least 0.3)"
)
BY_TIME = (
    "object of a warning: the object of a contact of the same class with the same number, or at "
    "most 10 s after the warning"
)


def evaluate_events(settings: EventEvaluationSettings) -> dict[str, Any]:
    """Results as plain values for JSON; see docs/concepts/events.md for the keys.

    Raises EventFileError, OutputError, LabelFileError: a file cannot be read.
    """
    folder = settings.events if settings.events.is_dir() else settings.events.parent
    path = folder / EVENTS_FILE if settings.events.is_dir() else settings.events
    inputs = _Inputs(folder, settings.truth.parent)
    is_labelled = _is_file_of_events(settings.truth)
    needed = NEEDED_COLUMNS if is_labelled else (*NEEDED_COLUMNS, "warning_s")
    events = read_events(path, needed=needed)
    rows = inputs.rows(settings.tracks)
    hours = inputs.hours(rows)
    hours = hours if settings.hours is None else settings.hours
    if is_labelled:
        labelled = read_events(settings.truth)
        if hours is None:
            hours = inputs.last_hours([*events, *labelled], ())
        scores = event_scores(events, labelled, hours=hours)
        return scores | inputs.facts(
            settings, events, "labelled events of the same kind and class, at most 1 s apart"
        )
    contacts = read_contacts(settings.truth)
    if hours is None:
        hours = inputs.last_hours(events, [contact.contact_s for contact in contacts])
    boxes = inputs.boxes(settings.boxes)
    if rows is None or boxes is None:
        objects, protocol = objects_by_time(events, contacts), BY_TIME
        inputs.notes.append(
            "Warnings are assigned to contacts by number, class and time, because "
            f"{'the tracks of the run are' if rows is None else 'labels of the objects are'} "
            f"missing ({'--tracks' if rows is None else '--boxes'})."
        )
    else:
        objects, protocol = objects_by_boxes(events, rows, boxes), BY_BOXES
        if missing := sorted(
            {contact.object_id for contact in contacts} - set(boxes.track_id.tolist())
        ):
            inputs.notes.append(
                f"{counted(len(missing), 'object')} with a contact, such as {missing[0]}, "
                f"{'has' if len(missing) == 1 else 'have'} no labelled boxes; check that the "
                "labels belong to this drive."
            )
    counted_contacts = inputs.seen(
        contacts, {i for event, i in zip(events, objects, strict=True) if is_warning(event)}
    )
    scores = contact_scores(
        events, objects, counted_contacts, hours=hours, min_lead_s=settings.min_lead_s
    )
    closing = (
        {}
        if rows is None or boxes is None
        else {"closing": closing_errors(rows, boxes, inputs.vans())}
    )
    return {
        **scores,
        **inputs.facts(settings, events, protocol),
        "min_lead_s": settings.min_lead_s,
        **closing,
    }


def _is_file_of_events(path: Path) -> bool:
    """Whether a file of ground truth contains labelled events instead of contacts."""
    if path.suffix.lower() == ".parquet":
        return True
    contacts, events = ",".join(CONTACT_COLUMNS), ",".join(NEEDED_COLUMNS)
    expected = f"contacts with the columns {contacts}, or events with the columns {events}"
    names = [name.strip().lower() for name in first_line(path, EventFileError, expected).split(",")]
    if "contact_s" in names or "object_id" in names:
        return False
    if "kind" not in names:
        raise EventFileError(f"{path}: expected {expected}, found neither.")
    return True


@dataclass(slots=True)
class _Inputs:
    """Files in the folder of the events and in the folder of their ground truth (`drive`)."""

    folder: Path
    drive: Path
    notes: list[str] = field(default_factory=list)  # for the user
    starts_s: float = 0.0  # time of the first processed frame
    # end of the processed part of the video, from summary.json; inf = unknown
    ends_s: float = math.inf
    # time after which there are no events: `ends_s`, or that of the last row
    last_s: float = math.inf

    def rows(self, path: Path | None) -> Rows | None:
        """Rows of the run; None without a file, or if the file in the folder of the events cannot
        be read.
        """
        if path is not None:
            return read_run_rows(path, self.notes)
        beside = rows_file(self.folder)
        if beside is None:
            return None
        try:
            return read_run_rows(beside, self.notes)
        except OutputError as error:
            self.notes.append(
                f"The tracks in the folder of the events cannot be read ({str(error).rstrip('.')})."
            )
            return None

    def boxes(self, path: Path | None) -> Truth | None:
        beside = [self.drive / name for name in BOX_FILES]
        chosen = path or next(
            (file for file in beside if file.is_file() and not is_blank(file, "labels")), None
        )
        return None if chosen is None else read_boxes(chosen)

    def vans(self) -> set[int]:
        """Numbers of the vans of a simulated drive, which truth.csv lists as cars."""
        file = self.drive / "truth.txt"
        if not file.is_file() or is_blank(file, "labels"):
            return set()
        labels = read_boxes(file)
        return set(labels.track_id[labels.kitti_type == "van"].tolist())

    def hours(self, rows: Rows | None) -> float | None:
        """Duration of the processed video from summary.json, else from the rows of the tracks; None
        = unknown.
        """
        file = self.folder / "summary.json"
        if file.is_file():
            try:
                summary = read_json(
                    file, OutputError, "the summary of a run", max_bytes=_MAX_SUMMARY_BYTES
                )
            except OutputError as error:
                self.notes.append(
                    f"The duration is taken from the rows of the tracks ({str(error).rstrip('.')})."
                )
            else:
                hours = _number(summary, "events", "hours")
                if hours is not None and 0 < hours < _MAX_HOURS:
                    self.starts_s = _number(summary, "starts_s") or 0.0
                    self.ends_s = self.last_s = self.starts_s + 3600 * hours
                    return hours
        if not rows:
            return None
        time_s = np.unique(rows["time_s"])
        self.last_s = float(time_s[-1])
        step_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
        return (float(time_s[-1] - time_s[0]) + step_s) / 3600 or None

    def seen(self, contacts: Sequence[Contact], warned: Container[int | None]) -> list[Contact]:
        """Contacts in the processed part of the video or with a warning on their object; a note on
        other contacts.
        """
        from_s, to_s = self.starts_s, self.ends_s
        chosen = [
            row for row in contacts if from_s <= row.contact_s <= to_s or row.object_id in warned
        ]
        if len(chosen) < len(contacts):
            self.notes.append(
                f"{len(contacts) - len(chosen)} of {counted(len(contacts), 'contact')} are outside "
                f"the processed part of the video, {from_s:.1f} to {to_s:.1f} s, and are not "
                "evaluated."
            )
        return chosen

    def facts(
        self, settings: EventEvaluationSettings, events: Sequence[Event], protocol: str
    ) -> dict[str, Any]:
        """Files, protocol and notes; a note on events after the end of the video is added."""
        n_beyond = sum(event.start_s > self.last_s + 1.0 for event in events)
        if n_beyond:
            self.notes.append(
                f"{n_beyond} of {len(events)} events start after the end of the video at "
                f"{self.last_s:.1f} s; check that the events belong to this video."
            )
        files = {"events": str(settings.events), "truth": str(settings.truth)}
        return {**files, "protocol": protocol, "notes": self.notes}

    def last_hours(self, events: Sequence[Event], times_s: Sequence[float]) -> float | None:
        """Time of the last event or contact as the smallest possible duration, with a note; None if
        there is none.
        """
        last_s = max([*(event.end_s for event in events), *times_s], default=0.0)
        if last_s <= 0:
            self.notes.append(
                "The duration of the video is unknown, so the rate of false alarms is unknown too; "
                "give --hours."
            )
            return None
        self.notes.append(
            f"The duration of the video is unknown (give --hours); it is at least {last_s:.1f} s, "
            "until the last event or contact, so the rate of false alarms is an upper limit."
        )
        return last_s / 3600


def _number(content: Any, *keys: str) -> float | None:
    """Number below nested keys; None if there is none."""
    for key in keys:
        content = content.get(key) if isinstance(content, dict) else None
    return (
        float(content)
        if isinstance(content, int | float) and not isinstance(content, bool)
        else None
    )


# where closing speeds are scored: nearer, boxes are cut; farther, warnings are rare
NEAREST_M, FARTHEST_M = 10.0, 40.0
# section of buses, trucks and vans, whose rear is far behind their tallest visible edge
TALL = "tall vehicles"

_TALL_CLASSES = ("bus", "truck", "van")


def closing_errors(rows: Rows, boxes: Truth, vans: Collection[int] = ()) -> dict[str, Any]:
    """Errors of the closing speeds of a run by class of the label, and of tall vehicles; figures as
    in `score_closing`.

    `vans` are numbers of objects that are vans, for labels with the class car.
    """
    in_range = (
        (boxes.distance_m >= NEAREST_M)
        & (boxes.distance_m <= FARTHEST_M)
        & np.isfinite(boxes.closing_mps)
    )
    if not in_range.any():
        return {}
    label = match_truth(rows["frame"], rows.boxes_px, boxes)
    true_mps = np.where((label >= 0) & in_range[label], boxes.closing_mps[label], np.nan)
    is_tall = np.isin(boxes.kitti_type, _TALL_CLASSES) | np.isin(boxes.track_id, list(vans))
    classes = np.array([road_class_of(name) or str(name) for name in boxes.kitti_type], np.str_)
    sections = {}
    for name, chosen in [
        *((name, classes == name) for name in np.unique(classes[in_range])),
        (TALL, is_tall),
    ]:
        class_mps = np.where((label >= 0) & chosen[label], true_mps, np.nan)
        score = score_closing(rows["closing_mps"], rows["closing_sigma_mps"], class_mps)
        if score is not None:
            sections[str(name)] = score
    return sections
