"""Evaluation of the events of runs: warnings against contacts or what happens, or events against
labelled events.

Hits, misses, false alarms, leads and the objects of warnings are defined in `scores` and, of what
happens, in `occurrences`. Where the tracks of the run and labelled boxes with closing speeds are
known, the errors of the closing speeds are added, by class.
"""

import math
import re
from collections.abc import Collection, Container, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.classes import road_class_of
from track_range.detection.formats.label_formats import is_blank
from track_range.evaluation.events.occurrences import (
    BY_OCCURRENCES,
    OCCURRENCE_COLUMNS,
    Occurrence,
    end_of,
    occurrence_scores,
    read_occurrences,
)
from track_range.evaluation.events.scores import (
    CONTACT_COLUMNS,
    Contact,
    contact_scores,
    event_scores,
    is_warning,
    known_from_s,
    objects_by_boxes,
    objects_by_time,
    pooled,
    read_boxes,
    read_contacts,
)
from track_range.evaluation.events.settings import NOTHING_HAPPENS, EventEvaluationSettings
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

    Of several drives, the sections of all together and the results of each. Raises EventFileError,
    OutputError, LabelFileError: a file cannot be read.
    """
    n_runs = len(settings.events)
    truths = settings.truth * n_runs if settings.truth == NOTHING_HAPPENS else settings.truth
    drives = [
        _evaluate_drive(settings, events, truth)
        for events, truth in zip(settings.events, truths, strict=True)
    ]
    if n_runs == 1:
        return drives[0]
    notes = [f"{drive['events']}: {note}" for drive in drives for note in drive["notes"]]
    return {**pooled(drives), "drives": drives, "notes": notes}


def _evaluate_drive(settings: EventEvaluationSettings, given: Path, truth: Path) -> dict[str, Any]:
    """Results of one drive, from its events or the folder of its run, and its truth."""
    folder = given if given.is_dir() else given.parent
    kind = "nothing" if truth in NOTHING_HAPPENS else _kind_of_truth(truth)
    drive = _Drive(folder, truth.parent)
    all_events = read_events(
        given / EVENTS_FILE if given.is_dir() else given,
        needed=NEEDED_COLUMNS if kind == "events" else (*NEEDED_COLUMNS, "warning_s"),
    )
    occurrences = read_occurrences(truth) if kind == "occurrences" else ()
    rows = drive.rows(settings.tracks)
    drive.hours = drive.processed_hours(rows)
    events = drive.cut(all_events, settings.until_s, occurrences)
    if settings.hours is not None:
        drive.hours = settings.hours
    if kind == "events":
        figures = _against_events(drive, events, read_events(truth), settings.until_s)
    elif kind == "contacts":
        figures = _against_contacts(settings, drive, events, rows, read_contacts(truth))
    else:
        figures = _against_occurrences(drive, events, occurrences)
    if kind != "events" and rows and not np.isfinite(rows["contact_probability"]).any():
        drive.notes.append(
            "The run has no probability of contact in any row, so that it could not warn: that "
            "there is no false alarm shows nothing."
        )
    drive.note_on_later(events)
    return {**figures, "events": str(given), "truth": str(truth), "notes": drive.notes}


def _against_events(
    drive: "_Drive", events: Sequence[Event], labelled: Sequence[Event], until_s: float | None
) -> dict[str, Any]:
    if until_s is not None:
        labelled = [event for event in labelled if event.start_s < until_s]
    hours = drive.known_hours([*events, *labelled], ())
    protocol = "labelled events of the same kind and class, at most 1 s apart"
    return {**event_scores(events, labelled, hours=hours), "protocol": protocol}


def _against_occurrences(
    drive: "_Drive", events: Sequence[Event], occurrences: Sequence[Occurrence]
) -> dict[str, Any]:
    hours = drive.known_hours(events, [one.nearest_s for one in occurrences])
    warnings = [event for event in events if is_warning(event)]
    part_s = (drive.starts_s, drive.ends_s)
    scores = occurrence_scores(warnings, occurrences, part_s=part_s, hours=hours)
    outside = f"Rows not wholly between {part_s[0]:.1f} and {part_s[1]:.1f} s, not evaluated"
    counts = {
        outside: sum(row["outcome"] == "not_evaluated" for row in scores["occurrences"]),
        "Warnings that fit several rows, which have no boxes, so that the best outcome counts": (
            scores["overall"]["ambiguous"]
        ),
        "Warnings on a row with an earlier one, which do not count, maybe on another object": (
            scores["overall"]["repeated"]
        ),
    }
    drive.notes += [f"{fact}: {n}." for fact, n in counts.items() if n]
    return {**scores, "protocol": BY_OCCURRENCES}


def _against_contacts(
    settings: EventEvaluationSettings,
    drive: "_Drive",
    events: Sequence[Event],
    rows: Rows | None,
    contacts: Sequence[Contact],
) -> dict[str, Any]:
    hours = drive.known_hours(events, [contact.contact_s for contact in contacts])
    boxes = drive.boxes(settings.boxes)
    closing = {}
    if rows is None or boxes is None:
        objects, protocol = objects_by_time(events, contacts), BY_TIME
        drive.notes.append(
            "Warnings are assigned to contacts by number, class and time, because "
            f"{'the tracks of the run are' if rows is None else 'labels of the objects are'} "
            f"missing ({'--tracks' if rows is None else '--boxes'})."
        )
    else:
        objects, protocol = objects_by_boxes(events, rows, boxes), BY_BOXES
        closing = {"closing": closing_errors(rows, boxes, drive.vans())}
        missing = sorted({contact.object_id for contact in contacts} - set(boxes.track_id.tolist()))
        if missing:
            drive.notes.append(
                f"{counted(len(missing), 'object')} with a contact, such as {missing[0]}, "
                f"{'has' if len(missing) == 1 else 'have'} no labelled boxes; check that the "
                "labels belong to this drive."
            )
    warned = {i for event, i in zip(events, objects, strict=True) if is_warning(event)}
    seen = drive.seen(contacts, warned)
    scores = contact_scores(events, objects, seen, hours=hours, min_lead_s=settings.min_lead_s)
    return {**scores, "protocol": protocol, "min_lead_s": settings.min_lead_s, **closing}


def _kind_of_truth(path: Path) -> str:
    """What a file of ground truth contains: contacts, events or occurrences."""
    if path.suffix.lower() == ".parquet":
        return "events"
    layouts = (
        ("contacts", CONTACT_COLUMNS),
        ("what happens", OCCURRENCE_COLUMNS),
        ("events", NEEDED_COLUMNS),
    )
    expected = ", or ".join(f"{what} with the columns {','.join(names)}" for what, names in layouts)
    line = first_line(path, EventFileError, expected).lower()
    names = {name.strip() for name in re.split("[,;\t]", line)}
    if names & {"contact_s", "object_id"}:
        return "contacts"
    if "kind" in names:
        return "events"
    if names & {"first_visible_s", "nearest_s", "conflict_s", "warning"}:
        return "occurrences"
    raise EventFileError(f"{path}: expected {expected}, found none of them.")


@dataclass(slots=True)
class _Drive:
    """Files in the folder of the events and in the folder of their ground truth (`labels`), and the
    evaluated part of the drive.
    """

    folder: Path
    labels: Path
    notes: list[str] = field(default_factory=list)  # for the user
    starts_s: float = 0.0  # time of the first processed frame
    # end of the processed part of the video, from summary.json; inf = unknown
    ends_s: float = math.inf
    # time after which there are no events: `ends_s`, or that of the last row
    last_s: float = math.inf
    hours: float | None = None  # duration of the evaluated part; None = unknown

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
        beside = [self.labels / name for name in BOX_FILES]
        chosen = path or next(
            (file for file in beside if file.is_file() and not is_blank(file, "labels")), None
        )
        return None if chosen is None else read_boxes(chosen)

    def vans(self) -> set[int]:
        """Numbers of the vans of a simulated drive, which truth.csv lists as cars."""
        file = self.labels / "truth.txt"
        if not file.is_file() or is_blank(file, "labels"):
            return set()
        labels = read_boxes(file)
        return set(labels.track_id[labels.kitti_type == "van"].tolist())

    def processed_hours(self, rows: Rows | None) -> float | None:
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

    def cut(
        self,
        events: Sequence[Event],
        until_s: float | None,
        occurrences: Sequence[Occurrence],
    ) -> list[Event]:
        """The events of the part that ends at a given time, None = at the first cut of the
        recording, if it is cut.
        """
        reason = "--until"
        if until_s is None:
            until_s = end_of(occurrences)
            reason = "a row without a class; --until gives another end"
        if until_s >= self.last_s or math.isinf(until_s):
            if reason == "--until" and until_s > self.last_s:
                self.notes.append(
                    f"--until {until_s:g} is after the end of the video at {self.last_s:.2f} s, so "
                    "that all of it is evaluated."
                )
            return list(events)
        before = [event for event in events if known_from_s(event) < until_s]
        self.notes.append(
            f"The evaluated part ends at {until_s:.2f} s ({reason}); "
            f"{counted(len(events) - len(before), 'later event')} not evaluated."
        )
        if self.hours is not None and math.isfinite(self.last_s):
            self.hours -= (self.last_s - until_s) / 3600
        self.ends_s = self.last_s = until_s
        return before

    def note_on_later(self, events: Sequence[Event]) -> None:
        """A note on events after the end of the video."""
        n_beyond = sum(event.start_s > self.last_s + 1.0 for event in events)
        if n_beyond:
            self.notes.append(
                f"{n_beyond} of {len(events)} events start after the end of the video at "
                f"{self.last_s:.1f} s; check that the events belong to this video."
            )

    def known_hours(self, events: Sequence[Event], times_s: Sequence[float]) -> float | None:
        """The duration; where it is unknown, the time of the last event or contact as the smallest
        possible one, with a note. None if there is none.
        """
        if self.hours is not None:
            return self.hours
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
