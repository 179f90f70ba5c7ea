"""Figures of a fleet from its results, in a local folder or an object store, also while the fleet
is running.

Missing or damaged parts are named, and the figures cover the rest.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import islice
from typing import Any, NamedTuple

from track_range.fleet.errors import FleetError
from track_range.fleet.output import data_set
from track_range.fleet.output.state import FleetState, read_state, state_text
from track_range.fleet.report import clip_figures
from track_range.fleet.report.clip_figures import ClipColumns
from track_range.fleet.report.track_figures import (
    EDGES_M,
    N_RANKED,
    Figures,
    TrackFigures,
    needed_columns,
    track_figures,
)
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.location import Location
from track_range.foundation.files.input_files import shortened
from track_range.foundation.files.numeric_text import number
from track_range.foundation.files.structured_text import parse_json
from track_range.results.events.event import (
    CLIPS_FOLDER,
    EVENT_KINDS,
    Event,
    clip_name,
    severity_key,
)
from track_range.results.events.files import EventFileError, events_in_parquet, rounded_values

_N_READERS = 8  # files that are read at a time; each clip takes memory for its rows meanwhile
_MAX_PROBLEMS = 10  # largest number of damaged or missing files that are named
_LINKED_FILES = ("overlay.mp4", "report.html")  # files of a clip to which the page links


class ClipEvent(NamedTuple):
    """An event of a clip; `number` is its row number in its file, from 1."""

    clip: str
    number: int
    event: Event

    def row(self, start_utc_s: float) -> Figures:
        """Clip, number, the columns of events.csv, and Unix time of the peak (of the start:
        `start_utc_s`).
        """
        utc_s = start_utc_s + self.event.peak_s
        values = {"clip": self.clip, "number": self.number, **rounded_values(self.event)}
        return {**values, "utc_s": utc_s if math.isfinite(utc_s) else None}


@dataclass(slots=True)
class EventFigures:
    """Events of one or more clips by kind, events with a collision warning, and the most severe
    events.
    """

    n_by_kind: Counter[str] = field(default_factory=Counter)
    n_warnings: int = 0
    worst: list[ClipEvent] = field(default_factory=list)

    @classmethod
    def of(cls, clip: str, events: Sequence[Event]) -> EventFigures:
        """Figures of a clip."""
        return cls(
            Counter(event.kind for event in events),
            sum(math.isfinite(event.warning_s) for event in events),
            _worst(ClipEvent(clip, i + 1, event) for i, event in enumerate(events)),
        )

    def add(self, other: EventFigures) -> None:
        """Add the figures of other clips."""
        self.n_by_kind.update(other.n_by_kind)
        self.n_warnings += other.n_warnings
        self.worst = _worst([*self.worst, *other.worst])

    def by_kind(self, hours: float) -> list[Figures]:
        """Number of events, and per hour of video (None: too short), of the kinds that occur."""
        counts = {kind: self.n_by_kind[kind] for kind in EVENT_KINDS if self.n_by_kind[kind]}
        is_long = hours >= clip_figures.MIN_H
        return [
            {"kind": kind, "events": n, "per_hour": n / hours if is_long else None}
            for kind, n in counts.items()
        ]


def _worst(events: Iterable[ClipEvent]) -> list[ClipEvent]:
    return heapq.nsmallest(
        N_RANKED, events, key=lambda item: (severity_key(item.event), item.clip, item.number)
    )


def event_video(row: Mapping[str, Any]) -> str:
    """Name of the video of an event among the files of its clip, if the video was written."""
    return f"{CLIPS_FOLDER}/{clip_name(row['number'], row['kind'], row['track_id'])}"


@dataclass(frozen=True, slots=True)
class FleetFigures:
    """Figures of a fleet and, by name, the data for links to the ranked clips."""

    figures: Figures  # as in the JSON file (docs/how-to/fleet.md)
    files: Mapping[str, tuple[str, ...]]  # published files
    starts_s: Mapping[str, float]  # time of the first frame of the overlay


def fleet_figures(
    out: Location,
    group: str | None = None,
    progress: Callable[[int, int | None], None] = lambda _done, _total: None,
) -> FleetFigures:
    """Figures of the fleet with the results `out`.

    `group`: column of clips.parquet that groups the calibration drift; None = the vehicle, if there
    is one. `progress` is called with the number of the clips that were read, and of all clips.
    Raises FleetError: there is no fleet; StorageError: the storage cannot be read.
    """
    state = read_state(out)
    clips, problems = _clips(out)
    if state is None and not len(clips):
        content = (
            f"only a damaged {data_set.CLIPS_FILE}" if problems else "neither fleet.json nor clips"
        )
        raise FleetError(
            f"{out}: expected the results of `track-range fleet run`, found {content}."
        )
    done, failed = clips.with_status("done"), clips.with_status("failed")
    tracks, events, faults = _rows(out, done, progress)
    problems += faults
    column = clip_figures.group_column(clips, group)
    if group is not None and column is None:
        problems.append(
            f"clips.parquet: expected a column {shortened(group)} for --by; all clips "
            "are one group."
        )
    starts_utc_s = dict(zip(done.texts("clip"), done.utc_s("start_utc").tolist(), strict=True))
    ranked = [item.row(starts_utc_s.get(item.clip, math.nan)) for item in events.worst]
    work = clip_figures.work_figures(done)
    total = max(state.total if state is not None else 0, len(done) + len(failed))
    figures = {
        "out": str(out),
        "written_utc": datetime.now(UTC).strftime("%Y-%m-%d %H:%M"),
        "state": state_text(state),
        "problems": problems,
        "clips": {
            "total": total,
            "done": len(done),
            "failed": len(failed),
            "left": total - len(done) - len(failed),
        },
        **work,
        "clips_per_hour": None if state is None else state.clips_per_hour,
        "tracks": sum(tracks.n_tracks.values()),
        "rows": tracks.n_rows,
        "classes": _classes(tracks, work["video_h"]),
        "hours": _hours(tracks, done),
        "coverage": _coverage(tracks),
        "event_kinds": events.by_kind(work["video_h"]),
        "warnings": events.n_warnings,
        "events": ranked,
        "closest": tracks.closest,
        "collisions": tracks.collisions,
        "errors": clip_figures.error_figures(done),
        "drift_by": column,
        "drift": clip_figures.drift_figures(done, column),
        "failures": clip_figures.failure_figures(failed),
        "notes": clip_figures.note_figures(done),
        "stages_ms": clip_figures.stage_figures(done),
        "nodes": clip_figures.node_figures(done),
    }
    files = {row["clip"]: [*_LINKED_FILES] for row in (*tracks.closest, *tracks.collisions)}
    for row in ranked:
        files.setdefault(row["clip"], [*_LINKED_FILES]).append(event_video(row))
    published = {name: _published(out, name, names) for name, names in sorted(files.items())}
    return FleetFigures(figures, published, _starts_s(done, set(files), state))


def _clips(out: Location) -> tuple[ClipColumns, list[str]]:
    """The clips with results, and sentences on a damaged file."""
    try:
        return ClipColumns(data_set.read_clips(out)), []
    except FleetError as error:
        reason = str(error).partition("; ")[0].removesuffix(".")
        problem = f"{reason}; only the clips in the journal are in this report."
        return ClipColumns(data_set.read_journal(out)), [problem]


def _published(out: Location, clip: str, names: Sequence[str]) -> tuple[str, ...]:
    """Those of the files of a clip that exist, as far as the storage can be reached."""
    published: list[str] = []
    with suppress(StorageError):
        folder = data_set.runs_location(out, clip)
        for name in names:
            if folder.child(name).exists():
                published.append(name)
    return tuple(published)


def _rows(
    out: Location,
    done: ClipColumns,
    progress: Callable[[int, int | None], None],
) -> tuple[TrackFigures, EventFigures, list[str]]:
    """Figures of the rows and events of all complete clips, and sentences on their damaged
    files.
    """
    tracks, events, faults = TrackFigures(), EventFigures(), list[str]()
    clips = zip(done.texts("clip"), done.numbers("events").tolist(), strict=True)
    with ThreadPoolExecutor(_N_READERS) as threads:
        futures = [threads.submit(_read_clip, out, *clip) for clip in islice(clips, 4 * _N_READERS)]
        for i in range(len(done)):
            clip_tracks, clip_events, clip_faults = futures.pop(0).result()
            futures += [threads.submit(_read_clip, out, *clip) for clip in islice(clips, 1)]
            tracks.add(clip_tracks)
            events.add(clip_events)
            faults += clip_faults
            progress(i + 1, len(done))
    n_more = len(faults) - _MAX_PROBLEMS
    if n_more > 0:
        more = f"{n_more} more files of tracks or events are missing or damaged."
        faults = [*faults[:_MAX_PROBLEMS], more]
    return tracks, events, faults


def _read_clip(
    out: Location, name: str, n_events: float
) -> tuple[TrackFigures, EventFigures, list[str]]:
    """Figures of a clip's rows and events, and sentences on its files; NaN events: unknown number,
    without a file.
    """
    from pyarrow import ArrowException
    from pyarrow.parquet import ParquetFile

    tracks, events, faults = TrackFigures(), EventFigures(), []
    for location, content in (
        (data_set.tracks_location(out, name), "rows"),
        (data_set.events_location(out, name), "events"),
    ):
        if content == "events" and not n_events > 0:
            continue
        try:
            system, path = location.arrow()
            with system.open_input_file(path) as stream:
                if content == "events":
                    events = EventFigures.of(name, events_in_parquet(stream, location))
                else:
                    with ParquetFile(stream) as file:
                        tracks = track_figures(
                            name, file.read(columns=needed_columns(file.schema_arrow.names))
                        )
        except FileNotFoundError:
            listed = "the clip as done" if content == "rows" else "events of the clip"
            faults.append(f"{location}: the file is missing; clips.parquet lists {listed}.")
        except EventFileError as error:
            faults.append(str(error))
        except (ArrowException, OSError, ValueError, LookupError, MemoryError) as error:
            reason = shortened(" ".join(str(error).split()), 100)
            faults.append(
                f"{location}: expected the {content} of a clip, found a damaged file ({reason})."
            )
    return tracks, events, faults


def _classes(tracks: TrackFigures, hours: float) -> list[Figures]:
    return [
        {
            "class": name,
            "tracks": n,
            "per_hour": n / hours if hours >= clip_figures.MIN_H else None,
            "mean_visible_s": tracks.visible_s[name] / n,
        }
        for name, n in tracks.n_tracks.most_common()
    ]


def _hours(tracks: TrackFigures, done: ClipColumns) -> list[Figures]:
    """Hours of video and tracks by class for each hour of the day (UTC; None = unknown)."""
    video_s = clip_figures.video_s_by_hour(done)
    hours = sorted(
        {*video_s, *(hour for hour, _ in tracks.n_by_hour)},
        key=lambda hour: 24 if hour is None else hour,
    )
    return [
        {
            "hour_utc": hour,
            "video_h": video_s.get(hour, 0.0) / 3600,
            "tracks": {name: tracks.n_by_hour[hour, name] for name in tracks.n_tracks},
        }
        for hour in hours
    ]


def _coverage(tracks: TrackFigures) -> list[Figures]:
    """Coverage of each method in each distance band that has boxes; methods without any distance
    are left out.
    """
    methods = sorted(
        {method for method, _ in tracks.n_measured}, key=lambda name: (name.endswith("_kf"), name)
    )
    return [
        {
            "method": method,
            "from_m": EDGES_M[band],
            "to_m": EDGES_M[band + 1] if band + 2 < len(EDGES_M) else None,
            "boxes": tracks.n_boxes[band],
            "coverage": tracks.n_measured[method, band] / tracks.n_boxes[band],
        }
        for method in methods
        for band in sorted(tracks.n_boxes)
    ]


def _starts_s(done: ClipColumns, names: set[str], state: FleetState | None) -> dict[str, float]:
    """Values of --start-s of clips: the clip's value, else the value for all clips."""
    run = state.options.get("run") if state is not None else None
    shared = run.get("start_s") if isinstance(run, dict) else None
    starts_s = {}
    for name, inputs in zip(done.texts("clip"), done.texts("inputs"), strict=True):
        if name in names:
            try:
                own = parse_json(inputs, data_set.CLIPS_FILE, FleetError, "the inputs of a clip")[
                    "settings"
                ]["start_s"]
            except (FleetError, LookupError, TypeError):
                own = None
            starts_s[name] = next(
                filter(math.isfinite, (number(str(own)), number(str(shared)))), 0.0
            )
    return starts_s
