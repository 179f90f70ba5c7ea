"""Events of all clips of a fleet that meet a condition, and copies of their videos."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pyarrow as pa

from track_range.fleet.errors import FleetError
from track_range.fleet.output import data_set
from track_range.fleet.output.record import label_columns
from track_range.fleet.report.clip_figures import ClipColumns
from track_range.fleet.report.event_query import event_condition
from track_range.fleet.report.fleet_figures import ClipEvent, event_video
from track_range.fleet.report.track_figures import Figures
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.location import Location
from track_range.foundation.files.atomic_files import atomic_path, writable
from track_range.foundation.files.output_files import OutputError, make_folder
from track_range.results.events.event import Event, severity_key
from track_range.results.events.files import EventFileError, events_in_parquet, events_table

_N_READERS = 8  # files that are read at a time


@dataclass(frozen=True, slots=True)
class ListedEvents:
    """Events of a fleet, the most severe first: clip, number, the columns of events.csv, labels of
    the clip; and sentences on files that are missing or damaged.
    """

    rows: tuple[Figures, ...]
    n_all: int  # number of events of all clips
    problems: tuple[str, ...]


def fleet_events(
    out: str | Path | Location,
    condition: str = "",
    progress: Callable[[int, int | None], None] = lambda _done, _total: None,
) -> ListedEvents:
    """Events of a fleet with the results `out` that meet a condition on their columns and the
    labels of their clips; "" = all.

    Example:
        >>> listed = fleet_events("results", 'kind == "cut-in" and min_ttc_s < 2')  # doctest: +SKIP
        >>> listed.rows[0]["clip_file"]  # doctest: +SKIP
        'runs/clip=0001/clips/02-cut_in-17.mp4'

    Raises EventQueryError: the condition is not understood; FleetError, StorageError: the results
    cannot be read.
    """
    out = Location.of(out)
    clips = data_set.read_clips(out)
    labels = label_columns(clips)
    done = ClipColumns(clips).with_status("done")
    by_clip = {
        clip: {"clip": clip, "start_utc_s": start_s, **dict(zip(labels, texts, strict=True))}
        for clip, start_s, *texts in zip(
            done.texts("clip"), done.utc_s("start_utc"), *map(done.texts, labels), strict=True
        )
    }
    if not by_clip:
        raise FleetError(f"{out}: expected the results of `track-range fleet run`, found no clips.")
    counts = zip(done.texts("clip"), done.numbers("events"), strict=True)
    with_events = [clip for clip, n in counts if n > 0]
    events, problems = list[ClipEvent](), list[str]()
    with ThreadPoolExecutor(_N_READERS) as threads:
        parts = threads.map(partial(_events_of, out), with_events)
        for i, (of_clip, faults) in enumerate(parts):
            events += of_clip
            problems += faults
            progress(i + 1, len(with_events))
    texts = {name: [by_clip[one.clip][name] for one in events] for name in ("clip", *labels)}
    chosen = _meeting([one.event for one in events], texts, condition)
    shown = sorted((events[i] for i in chosen), key=lambda one: severity_key(one.event))
    rows = tuple(
        {
            **{name: by_clip[one.clip][name] for name in labels},
            **one.row(by_clip[one.clip]["start_utc_s"]),
        }
        for one in shown
    )
    return ListedEvents(rows, len(events), tuple(problems))


def _meeting(
    events: Sequence[Event], texts: Mapping[str, Sequence[str]], condition: str
) -> Sequence[int]:
    """Numbers of the events that meet a condition, "" = all; `texts` are further columns."""
    table = events_table(events)
    for name in texts.keys() - set(table.column_names):
        table = table.append_column(name, pa.array(texts[name], pa.string()))
    if not condition.strip():
        return range(len(events))
    is_text = {field.name: pa.types.is_string(field.type) for field in table.schema}
    numbered = table.append_column("", pa.array(range(len(events)), pa.int64()))
    return list(numbered.filter(event_condition(condition, is_text))[""].to_pylist())


def _events_of(out: Location, clip: str) -> tuple[list[ClipEvent], list[str]]:
    """The events of a clip, or a sentence on its file."""
    location = data_set.events_location(out, clip)
    try:
        system, path = location.arrow()
        with system.open_input_file(path) as stream:
            events = events_in_parquet(stream, location)
    except (EventFileError, StorageError) as error:
        return ([], [str(error)])
    except OSError:
        return ([], [f"{location}: the file is missing; clips.parquet lists its events."])
    return ([ClipEvent(clip, i + 1, event) for i, event in enumerate(events)], [])


def copied_videos(out: Location, rows: Sequence[Figures], folder: Path) -> list[str | None]:
    """Copy the videos of events to a folder, as CLIP-NUMBER-KIND-TRACK.mp4, and return their names
    in it; None = the event has none.

    OutputError, StorageError: a video cannot be copied.
    """
    make_folder(folder)
    names: list[str | None] = []
    for row in rows:
        file = data_set.runs_location(out, row["clip"]).descendant(event_video(row))
        name = f"{data_set.encoded(row['clip'])}-{file.name}"
        if not file.exists():
            names.append(None)
            continue
        with writable(folder / name, OutputError), atomic_path(folder / name) as partial_file:
            file.download(partial_file)
        names.append(name)
    return names
