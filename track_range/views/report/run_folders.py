"""Reports rewritten from the folders of runs, and the comparison of several runs."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from track_range.foundation.files.folder_lock import is_locked
from track_range.foundation.files.input_files import counted, real_path
from track_range.foundation.files.output_files import OutputError, check_outputs
from track_range.results.events.event import CLIPS_FOLDER, Event, with_clip_files
from track_range.results.events.files import (
    EVENTS_FILE,
    EVENTS_PARQUET,
    EventFileError,
    read_events,
    write_event_files,
)
from track_range.results.folder import RunFolder, clip_rows, read_run_folder
from track_range.results.formats.poses_file import read_poses
from track_range.results.writers import result_names
from track_range.views.report.comparison import (
    ComparedRun,
    compared_tracks,
    comparison_grids,
    comparison_notes,
    event_grids,
    paired_grids,
    settings_grid,
)
from track_range.views.report.page import write_comparison, write_report
from track_range.views.tables import Grid
from track_range.views.videos.event_clips import write_clips


@dataclass(frozen=True, slots=True)
class WrittenReport:
    """Result of `report`: the page to open, and for several runs the tables of the comparison."""

    page: Path
    grids: tuple[Grid, ...]
    missing: tuple[str, ...]  # messages about files that are missing in a folder
    notes: tuple[str, ...]  # reasons why the runs may not be comparable
    clips: tuple[Path, ...] = ()


def report(
    folders: Sequence[Path], out: Path | None = None, *, has_clips: bool = False
) -> WrittenReport:
    """Write report.html into the folder of each run and, for several runs, a page that compares
    them.

    OutputError if a folder contains no run, or a page or clip cannot be written or would overwrite
    an input; VideoError if clips are to be cut from an overlay that cannot be read. Duplicate
    folders are ignored. `out` is the page of a single run instead of the one in its folder, or the
    page of the comparison (None = comparison.html in the current folder); with `has_clips` a clip
    of each event is cut from the overlay.
    """
    by_place = {real_path(folder): folder for folder in folders}
    runs = [read_run_folder(folder) for folder in by_place.values()]
    if out is not None:
        _check_inputs_stay(runs, out)
    missing = tuple(
        f"{run.folder}: {sentence}"
        for run in runs
        for sentence in (*run.missing, *restore_events(run))
    )
    clips = tuple(clip for run in runs for clip in _clips(run)) if has_clips else ()
    if len(runs) == 1:
        page = out or runs[0].folder / "report.html"
        _write(page, runs[0])
        return WrittenReport(page, (), missing, (), clips)
    page = out or Path("comparison.html")
    for run in runs:
        _write(run.folder / "report.html", run)
    grids, notes = _compare(runs, page)
    return WrittenReport(page, grids, missing, notes, clips)


def _check_inputs_stay(runs: Sequence[RunFolder], out: Path) -> None:
    """OutputError: a page would overwrite a file that is read."""
    pages = [run.folder / "report.html" for run in runs] if len(runs) > 1 else []
    names = [name for name in result_names() if name != "report.html"]
    check_outputs([*pages, out], (run.folder / name for run in runs for name in names))


def _compare(runs: Sequence[RunFolder], page: Path) -> tuple[tuple[Grid, ...], tuple[str, ...]]:
    """Write the page that compares runs; its tables and notes."""
    names = short_names([run.folder for run in runs])
    compared = [_compared(name, run, page.parent) for name, run in zip(names, runs, strict=True)]
    tracks = compared_tracks(compared)
    write_comparison(page, compared, tracks)
    grids = [pair["grid"] for pair in tracks]
    grids += [
        *event_grids(compared),
        *paired_grids(compared),
        *comparison_grids(compared),
        settings_grid(compared),
    ]
    return tuple(grid for grid in grids if grid.rows), tuple(comparison_notes(compared))


def _clips(run: RunFolder) -> Sequence[Path]:
    """Cut a clip of each event from the overlay of a run, which the events know afterwards; the
    clips.
    """
    starts_s = float(run.summary.get("starts_s") or 0.0)
    folder, table = run.folder / CLIPS_FOLDER, run.folder / EVENTS_PARQUET
    clips = write_clips(run.folder / "overlay.mp4", run.events, folder, starts_s=starts_s)
    # in full precision; that of a clip of a fleet is elsewhere, and a damaged one stays
    with suppress(EventFileError):
        events = read_events(table) if table.is_file() else ()
        if events:
            events = with_clip_files(events, {path.name for path in clips})
            write_event_files(run.folder, events, run.provenance.metadata())
    return clips


def _compared(name: str, run: RunFolder, page_folder: Path) -> ComparedRun:
    overlay = run.summary["files"].get("overlay")
    return ComparedRun(
        name=name,
        summary=run.summary,
        settings=run.settings,
        link=_relative(run.folder / "report.html", page_folder),
        notes=run.missing,
        events=known_events(run),
        rows=run.rows,
        overlay=run.folder / str(overlay) if overlay else None,
    )


def restore_events(run: RunFolder) -> Iterator[str]:
    """Write events.csv and events.parquet of a run that was killed or lacks them; yields a sentence
    about it.

    A run in progress and the folders of a fleet are left alone. OutputError if a file cannot be
    written, or the events.csv of a finished run is damaged.
    """
    if not run.are_events_replayed or is_locked(run.folder) or clip_rows(run.folder) is not None:
        return
    path = run.folder / EVENTS_FILE
    if path.exists() and (run.folder / "summary.json").exists():
        raise OutputError(
            f"{path}: expected the events of the run, found a damaged file; delete it, so that it "
            "is written again from the rows of the tracks."
        )
    write_event_files(run.folder, run.events, run.provenance.metadata())
    yield (
        f"{EVENTS_FILE} and {EVENTS_PARQUET} were written from the tracks: "
        f"{counted(len(run.events), 'event')}."
    )


def _write(path: Path, run: RunFolder) -> None:
    files = run.summary["files"]
    if real_path(path.parent) != real_path(run.folder):  # links are relative to the page
        files = {key: _relative(run.folder / str(name), path.parent) for key, name in files.items()}
    clips = run.folder / CLIPS_FOLDER
    summary = {**run.summary, "files": files}
    write_report(
        path, summary, run.rows, known_events(run), clips=clips, poses=read_poses(run.folder)
    )


def known_events(run: RunFolder) -> tuple[Event, ...] | None:
    """Events of a run; None for a run of a version without events."""
    return (
        run.events if run.events or run.are_events_replayed or run.summary.get("events") else None
    )


def _relative(path: Path, start: Path) -> str:
    return Path(os.path.relpath(real_path(path), real_path(start))).as_posix()


def short_names(folders: Sequence[Path]) -> list[str]:
    """Shortest trailing parts of the paths that are unique."""
    parts = [real_path(folder).parts for folder in folders]
    for n in range(1, max(map(len, parts)) + 1):
        names = ["/".join(path[-n:]) for path in parts]
        if len(set(names)) == len(names):
            return names
    return [str(folder) for folder in folders]
