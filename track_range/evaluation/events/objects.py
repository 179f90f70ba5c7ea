"""Objects of events: which object of the ground truth the track of an event is.

With the tracks of the run and labelled boxes, the object is the one that the track overlaps most often (IoU at
least `MIN_IOU`) from `MARGIN_S` before the event to its end; none if it overlaps no object in at least `MIN_FRACTION`
of these frames. Without them, a warning belongs to a contact of the same class group and number; if none has the number
of the contact, to those of the same class group whose contact is at most `WINDOW_S` after the warning.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from track_range.detection.boxes import iou
from track_range.detection.formats.label_formats import read_labels
from track_range.detection.formats.video_labels.csv_labels import has_label_columns, read_csv_labels
from track_range.evaluation.events.scores import Contact, are_same_class, is_warning
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.results.columns import Columns, boxes_px
from track_range.results.events.event import Event

MIN_IOU = 0.3
"""Smallest overlap of a track with its object: boxes that the image border cuts, near a contact, fit badly."""

MARGIN_S = 1.0  # time before the start of an event for which its track is compared, s

MIN_FRACTION = 0.2
"""Smallest fraction of frames in which a track overlaps its object: objects that are largely hidden have no label."""

WINDOW_S, SAME_ID_WINDOW_S = 10.0, 30.0
"""Longest time from a warning to a contact of its class, and of its number too, where tracks or boxes are missing."""


@dataclass(frozen=True, slots=True)
class LabelledBoxes:
    """Boxes of the ground truth, one row per object and frame."""

    frame: IntArray  # (N,) frame number from 0
    object_id: IntArray  # (N,) identity; -1 = none
    class_name: npt.NDArray[np.str_]  # (N,) class in the file, in lower case
    xyxy_px: FloatArray  # (N, 4) box
    distance_m: FloatArray  # (N,) true distance; NaN = unknown, or less than half of the object is visible
    closing_mps: FloatArray  # (N,) true closing speed; NaN = unknown


def read_boxes(path: Path) -> LabelledBoxes:
    """Boxes of a file of labels in any format, in rectified pixels; `LabelFileError` if it cannot be read."""
    if path.is_file() and has_label_columns(path):
        labels = read_csv_labels(path)
        distance_m = np.where(labels.visible_share >= 0.5, labels.distance_m, np.nan)
        ids, names, closing_mps = labels.track_id, labels.class_name, labels.closing_mps
        return LabelledBoxes(labels.frame, ids, names, labels.xyxy_px, distance_m, closing_mps)
    table = read_labels(path, expected="labels of the objects")
    unknown = np.full(len(table), np.nan)
    return LabelledBoxes(table.frame, table.track_id, table.class_name, table.xyxy_px, table.distance_m, unknown)


def objects_by_boxes(events: Sequence[Event], columns: Columns, boxes: LabelledBoxes) -> list[int | None]:
    """Identity of the object of each event, from the boxes of its track in the rows of the run; None = none."""
    xyxy_px = boxes_px(columns)
    order = np.argsort(boxes.frame, kind="stable")
    frames = boxes.frame[order]
    objects: list[int | None] = []
    for event in events:
        is_near = (columns["time_s"] >= event.start_s - MARGIN_S) & (columns["time_s"] <= event.end_s)
        rows = np.flatnonzero((columns["track_id"] == event.track_id) & is_near)
        votes: Counter[int] = Counter()
        for row in rows.tolist():
            first, last = np.searchsorted(frames, [columns["frame"][row], columns["frame"][row] + 1]).tolist()
            labels = order[first:last]
            labels = labels[boxes.object_id[labels] >= 0]
            if len(labels):
                overlap = iou(xyxy_px[row : row + 1], boxes.xyxy_px[labels])[0]
                if overlap.max() >= MIN_IOU:
                    votes[int(boxes.object_id[labels[overlap.argmax()]])] += 1
        best = votes.most_common(1)
        objects.append(best[0][0] if best and best[0][1] >= MIN_FRACTION * len(rows) else None)
    return objects


def objects_by_time(events: Sequence[Event], contacts: Sequence[Contact]) -> list[int | None]:
    """Identity of the object of each event, from numbers, classes and times alone; None = none."""
    objects: list[int | None] = [None] * len(events)
    for contact in sorted(contacts, key=lambda contact: contact.contact_s):
        near = [i for i, event in enumerate(events) if objects[i] is None and _may_belong(event, contact, WINDOW_S)]
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
    return event.start_s - MARGIN_S <= contact.contact_s and contact.contact_s - event.warning_s <= window_s
