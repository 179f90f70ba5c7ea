"""Options of `track-range evaluate events`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from track_range.foundation.schemas.options import Options, option

# shortest time from a warning to the contact for a hit, s: a reaction time of a driver
MIN_LEAD_S = 0.8


class EventEvaluationSettings(Options):
    """Events and their ground truth."""

    events: Annotated[
        Path,
        option(
            "Events of a run: events.csv or events.parquet, or the folder of the run.",
            metavar="FILE|DIR",
        ),
    ]
    truth: Annotated[
        Path,
        option(
            "Contacts with the columns object_id,class,contact_s, such as contacts.csv of "
            "`track-range simulate`, or labelled events with the columns of events.csv."
        ),
    ]
    tracks: Annotated[
        Path | None,
        option(
            "Tracks of the run (default: tracks.csv or tracks.parquet in the folder of the events)."
        ),
    ] = None
    boxes: Annotated[
        Path | None,
        option(
            "Labels of the objects in every frame, with the ids of the contacts: a CSV with the "
            "columns of truth.csv, KITTI, COCO, CVAT or YOLO (default: truth.csv or truth.txt in "
            "the folder of the contacts)."
        ),
    ] = None
    hours: Annotated[
        float | None,
        option(
            "Duration of the video in hours, for the rate of false alarms (default: from "
            "summary.json or the tracks in the folder of the events).",
            metavar="H",
            gt=0,
            le=1e6,
        ),
    ] = None
    min_lead_s: Annotated[
        float,
        option(
            "Minimum time in seconds from a warning to the contact, for the warning to count as a "
            "hit.",
            flag="--min-lead",
            metavar="S",
            ge=0,
            le=60,
        ),
    ] = MIN_LEAD_S
