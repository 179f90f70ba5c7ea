"""Figures of a fleet from its results, in a local folder or an object store; of a run in progress as well.

Parts that are missing or damaged are named, and the figures are those of the rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeVar

from track_range.fleet.errors import FleetError
from track_range.fleet.output.data_set import (
    CLIPS_FILE,
    RUNS,
    events_location,
    partition,
    read_clips,
    read_journal,
    tracks_location,
)
from track_range.fleet.output.state import FleetState, read_state
from track_range.fleet.output.status import state_text
from track_range.fleet.report import clip_figures
from track_range.fleet.report.clip_columns import ClipColumns
from track_range.fleet.report.clip_figures import Figures
from track_range.fleet.report.event_figures import EventFigures, ranked_rows
from track_range.fleet.report.track_figures import (
    EDGES_M,
    TrackFigures,
    needed_columns,
    track_figures,
)
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.location import Location
from track_range.foundation.files.input_files import shortened
from track_range.foundation.files.numeric_text import number
from track_range.foundation.files.structured_text import parse_json
from track_range.results.events.files import EventFileError, events_in_parquet

if TYPE_CHECKING:
    import pyarrow as pa

_Item = TypeVar("_Item")

_N_READERS = 8
"""Files that are read at a time; each clip takes memory for its rows meanwhile."""

_MAX_PROBLEMS = 10
"""Largest number of damaged or missing files that are named."""

LINKED_FILES = ("overlay.mp4", "report.html")
"""Files of a clip to which the page links."""


@dataclass(frozen=True, slots=True)
class FleetFigures:
    """Figures of a fleet.

    Attributes:
        figures: as in the JSON file; see docs/fleet.md.
        files: published files of the ranked clips, by name of the clip.
        starts_s: time of the first frame of the ranked clips' overlays, by name of the clip.
    """

    figures: Figures
    files: Mapping[str, tuple[str, ...]]
    starts_s: Mapping[str, float]


def fleet_figures(
    out: Location, group: str | None = None, progress: Callable[[int, int | None], None] = lambda _done, _total: None
) -> FleetFigures:
    """Figures of the fleet in a folder or an object store.

    Args:
        out: its results.
        group: column of clips.parquet that groups the calibration drift; None = the vehicle, if there is one.
        progress: called with the number of the clips that were read, and of all.

    Raises:
        FleetError: there is no fleet.
        StorageError: the storage cannot be read.
    """
    problems: list[str] = []
    state = read_state(out)
    clips = ClipColumns(_clips(out, problems))
    if state is None and not len(clips):
        content = f"only a damaged {CLIPS_FILE}" if problems else "neither fleet.json nor clips"
        raise FleetError(f"{out}: expected the results of `track-range fleet run`, found {content}.")
    done = clips.done
    tracks, events = _rows(out, done, problems, progress)
    starts_utc_s = dict(zip(done.texts("clip"), done.utc_s("start_utc").tolist(), strict=True))
    column = clip_figures.group_column(clips, group)
    if group is not None and column is None:
        problems.append(f"clips.parquet: expected a column {shortened(group)} for --by; all clips are one group.")
    figures = {
        "out": str(out),
        "written_utc": datetime.now(UTC).strftime("%Y-%m-%d %H:%M"),
        "state": state_text(state),
        "problems": problems,
        "clips": _clip_counts(clips, done, state),
        **clip_figures.work_figures(done),
        "clips_per_hour": _clips_per_hour(state),
        "tracks": sum(tracks.n_tracks.values()),
        "rows": tracks.n_rows,
        "classes": _classes(tracks, done),
        "hours": _hours(tracks, done),
        "coverage": _coverage(tracks),
        "event_kinds": events.by_kind(clip_figures.work_figures(done)["video_h"]),
        "warnings": events.n_warnings,
        "events": ranked_rows(events.worst, starts_utc_s),
        "closest": [asdict(item) for item in tracks.closest],
        "collisions": [asdict(item) for item in tracks.collisions],
        "errors": clip_figures.error_figures(done),
        "drift_by": column,
        "drift": clip_figures.drift_figures(done, column),
        "failures": clip_figures.failure_figures(clips.failed),
        "notes": clip_figures.note_figures(done),
        "stages_ms": clip_figures.stage_figures(done),
        "nodes": clip_figures.node_figures(done),
    }
    ranked = [*(item.clip for item in (*tracks.closest, *tracks.collisions)), *(item.clip for item in events.worst)]
    files = {name: list(LINKED_FILES) for name in ranked}
    for item in events.worst:
        files[item.clip].append(item.video)
    return FleetFigures(figures, _published(out, files), _starts_s(done, set(files), state))


def _clips(out: Location, problems: list[str]) -> pa.Table:
    try:
        return read_clips(out)
    except FleetError as error:
        reason = str(error).partition("; ")[0].removesuffix(".")
        problems.append(f"{reason}; only the clips in the journal are in this report.")
        return read_journal(out)


def _rows(
    out: Location, done: ClipColumns, problems: list[str], progress: Callable[[int, int | None], None]
) -> tuple[TrackFigures, EventFigures]:
    """Figures of the rows and events of all complete clips; problems with their files are added to `problems`."""
    tracks, events, n_problems = TrackFigures(), EventFigures(), 0
    clips = list(zip(done.texts("clip"), done.numbers("events").tolist(), strict=True))
    with ThreadPoolExecutor(_N_READERS) as threads:
        for i, (of_tracks, of_events, more) in enumerate(_mapped(threads, lambda clip: _of_clip(out, *clip), clips)):
            tracks.add(of_tracks)
            events.add(of_events)
            for problem in more:
                n_problems += 1
                if n_problems <= _MAX_PROBLEMS:
                    problems.append(problem)
            progress(i + 1, len(clips))
    if n_problems > _MAX_PROBLEMS:
        problems.append(f"{n_problems - _MAX_PROBLEMS} more files of tracks or events are missing or damaged.")
    return tracks, events


def _mapped(threads: ThreadPoolExecutor, function: Callable[[_Item], Any], items: list[_Item]) -> Iterator[Any]:
    """Results of a function in the order of the items, a few of them in advance."""
    remaining = iter(items)
    futures = [threads.submit(function, item) for item in islice(remaining, 4 * _N_READERS)]
    while futures:
        result = futures.pop(0).result()
        futures += [threads.submit(function, item) for item in islice(remaining, 1)]
        yield result


def _of_clip(out: Location, name: str, n_events: float) -> tuple[TrackFigures, EventFigures, list[str]]:
    """Figures of the rows and events of a clip, and the problems with its files in one sentence each.

    Args:
        out: results of the fleet.
        name: name of the clip.
        n_events: number of its events; NaN = unknown, and without a file.
    """
    tracks, problem = _tracks_of_clip(out, name)
    events, other_problem = _events_of_clip(out, name) if n_events > 0 else (EventFigures(), "")
    return tracks, events, [text for text in (problem, other_problem) if text]


def _events_of_clip(out: Location, name: str) -> tuple[EventFigures, str]:
    """Figures of the events of a clip, and the problem with its file in one sentence; "" = none."""
    location = events_location(out, name)
    try:
        system, path = location.arrow()
        with system.open_input_file(path) as stream:
            return EventFigures.of(name, events_in_parquet(stream, location)), ""
    except FileNotFoundError:
        return EventFigures(), f"{location}: the file is missing; clips.parquet lists events of the clip."
    except EventFileError as error:
        return EventFigures(), str(error)
    except OSError as error:
        return EventFigures(), f"{location}: expected the events of a clip, found a damaged file ({_reason(error)})."


def _tracks_of_clip(out: Location, name: str) -> tuple[TrackFigures, str]:
    """Figures of the rows of a clip, and the problem with its file in one sentence; "" = none."""
    from pyarrow import ArrowException
    from pyarrow.parquet import ParquetFile

    location = tracks_location(out, name)
    try:
        system, path = location.arrow()
        with system.open_input_file(path) as stream, ParquetFile(stream) as file:
            return track_figures(name, file.read(columns=needed_columns(file.schema_arrow.names))), ""
    except FileNotFoundError:
        return TrackFigures(), f"{location}: the file is missing; clips.parquet lists the clip as done."
    except (ArrowException, OSError, ValueError, LookupError, MemoryError) as error:
        return TrackFigures(), f"{location}: expected the rows of a clip, found a damaged file ({_reason(error)})."


def _reason(error: Exception) -> str:
    return shortened(" ".join(str(error).split()), 100)


def _clip_counts(clips: ClipColumns, done: ClipColumns, state: FleetState | None) -> Figures:
    n_failed = len(clips.failed)
    total = max(state.total if state is not None else 0, len(done) + n_failed)
    return {"total": total, "done": len(done), "failed": n_failed, "left": total - len(done) - n_failed}


def _clips_per_hour(state: FleetState | None) -> float | None:
    """Rate of the last run; None if it completed no clip, or is unknown."""
    if state is None or not state.done or state.heartbeat_s <= state.started_s:
        return None
    return 3600 * state.done / (state.heartbeat_s - state.started_s)


def _classes(tracks: TrackFigures, done: ClipColumns) -> list[Figures]:
    """Tracks by class, most frequent first."""
    hours = clip_figures.work_figures(done)["video_h"]
    return [
        {
            "class": name,
            "tracks": n,
            "per_hour": n / hours if hours else None,
            "mean_visible_s": tracks.visible_s[name] / n,
        }
        for name, n in tracks.n_tracks.most_common()
    ]


def _hours(tracks: TrackFigures, done: ClipColumns) -> list[Figures]:
    """Hours of video and tracks by class for each hour of the day (UTC; None = unknown)."""
    video_s = clip_figures.video_s_by_hour(done)
    hours = sorted({*video_s, *(hour for hour, _ in tracks.n_by_hour)}, key=lambda hour: 24 if hour is None else hour)
    return [
        {
            "hour_utc": hour,
            "video_h": video_s.get(hour, 0.0) / 3600,
            "tracks": {name: tracks.n_by_hour[hour, name] for name in tracks.n_tracks},
        }
        for hour in hours
    ]


def _coverage(tracks: TrackFigures) -> list[Figures]:
    """Coverage of each method in each distance band that has boxes; methods without any distance are left out."""
    methods = sorted({method for method, _ in tracks.n_measured}, key=lambda name: (name.endswith("_kf"), name))
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


def _published(out: Location, files: Mapping[str, Sequence[str]]) -> dict[str, tuple[str, ...]]:
    """Those of the files of clips that exist."""
    return {name: tuple(_existing(out.child(RUNS, partition(name)), names)) for name, names in sorted(files.items())}


def _existing(folder: Location, names: Sequence[str]) -> Iterator[str]:
    for name in names:
        try:
            if folder.child(name).exists():
                yield name
        except StorageError:
            return


def _starts_s(done: ClipColumns, names: set[str], state: FleetState | None) -> dict[str, float]:
    """Values of --start-s of clips: that of the clip, else that of all clips."""
    run = state.options.get("run") if state is not None else None
    shared = run.get("start_s") if isinstance(run, dict) else None
    starts_s = {}
    for name, inputs in zip(done.texts("clip"), done.texts("inputs"), strict=True):
        if name in names:
            starts_s[name] = next(filter(math.isfinite, (_start_s(inputs), number(str(shared)))), 0.0)
    return starts_s


def _start_s(inputs: str) -> float:
    """Value of --start-s in the column `inputs` of a clip; NaN = none."""
    try:
        content = parse_json(inputs, "clips.parquet", FleetError, "the inputs of a clip")
        return number(str(content["settings"]["start_s"]))
    except (FleetError, LookupError, TypeError):
        return math.nan
