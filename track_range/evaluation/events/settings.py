"""Options of `track-range evaluate events`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import model_validator

from track_range.foundation.schemas.options import Options, contradiction, option

# shortest time from a warning to the contact for a hit, s: a reaction time of a driver
MIN_LEAD_S = 0.8
NOTHING_HAPPENS = (Path("none"),)  # the truth of drives in which no warning is right


class EventEvaluationSettings(Options):
    """Events and their ground truth, of one drive or of several."""

    events: Annotated[
        tuple[Path, ...],
        option(
            "Events of a run: events.csv or events.parquet, or the folder of the run. Repeat the "
            "option, and --truth in the same order, for the rates of several drives together.",
            metavar="FILE|DIR",
            is_repeated=True,
            min_length=1,
        ),
    ]
    truth: Annotated[
        tuple[Path, ...],
        option(
            "Contacts with the columns object_id,class,contact_s, such as contacts.csv of "
            "`track-range simulate`; what happens, with the columns "
            "class,first_visible_s,conflict_s,nearest_s,warning; labelled events with the columns "
            "of events.csv; or none: nothing happens in any of the drives, and every warning is a "
            "false alarm.",
            metavar="FILE|none",
            is_repeated=True,
            min_length=1,
        ),
    ]
    until_s: Annotated[
        float | None,
        option(
            "End of the evaluated part in seconds from the first frame, such as a cut to another "
            "camera (default: the end of the run, or the first row without a class of a file of "
            "what happens).",
            flag="--until",
            metavar="S",
            gt=0,
            le=1e9,
        ),
    ] = None
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

    @model_validator(mode="after")
    def _check_drives(self) -> Self:
        """As many files of truth as runs, and no option of one run for several."""
        n_runs, n_truths = len(self.events), len(self.truth)
        if n_truths != n_runs and self.truth != NOTHING_HAPPENS:
            raise contradiction(
                "expected a --truth for each --events, in the same order, or one --truth none, "
                f"got {n_runs} of --events and {n_truths} of --truth",
                ["events", "truth"],
            )
        options = ("tracks", "boxes", "hours", "until_s")
        of_one_run = [name for name in options if getattr(self, name) is not None]
        if n_runs > 1 and of_one_run:
            flag = self.flag(of_one_run[0])
            raise contradiction(
                f"{flag} is of one run, got {n_runs} of --events; leave {flag} out, or evaluate "
                "the runs one by one",
                [of_one_run[0], "events"],
            )
        return self
