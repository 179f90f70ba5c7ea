"""RunOutput: files of a run. Rows, events and videos grow during the run; summary and report are
written at its end.
"""

from __future__ import annotations

import os
import time
import weakref
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from track_range.foundation.errors import UserError, call_all
from track_range.foundation.files import output_files
from track_range.foundation.files.folder_lock import FolderLock
from track_range.pipeline.frame_result import FrameResult
from track_range.recording.telemetry.tracks.track import TELEMETRY_FILE, write_positions
from track_range.results.counts.files import CROSSINGS_FILE, CROSSINGS_PARQUET, write_crossings
from track_range.results.events.event import CLIPS_FOLDER, Event, with_clip_files
from track_range.results.events.files import EventFiles, event_values
from track_range.results.formats.poses_file import read_poses
from track_range.results.progress_note import OPENING, PROCESSING, PROGRESS_FILE, ProgressNote
from track_range.results.rows.rows import Rows
from track_range.results.writers import OpenWriters, create_writers, result_names
from track_range.run.options.paths import input_files
from track_range.run.options.settings import RunSettings
from track_range.run.options.settings_file import (
    absolute_settings,
    check_replaceable,
    save_settings,
)
from track_range.run.pictures import pictures
from track_range.run.session import RunSession
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.rig_yaml import save_rig
from track_range.views.report.page import write_report
from track_range.views.tables import markdown
from track_range.views.videos.event_clips import remove_clips, write_clips
from track_range.views.videos.result_video import ResultVideo

_NOTE_INTERVAL_S = 1.0  # minimum time between two notes on the number of frames


class RunOutput:
    """Files of a run, from the opening of its inputs to its end: `start`, `write` for each frame,
    `finish`.

    The folder is locked, and contains progress.json and, unless the folder has the file of an
    earlier run, settings.yaml. Results of an earlier run remain until `start`, so that a run with
    unusable inputs does not remove them; such a run also removes what it created. As a context
    manager, it closes what `finish` did not, and removes progress.json and the lock. Without a
    folder, nothing is written. A `rig` that was not read from a file is written to rig.yaml, which
    settings.yaml then names.

    FolderLockError: another run is writing to the folder; OutputError: the folder or a file cannot
    be written to, or is an input; WriterError: one of the result writers cannot be used.
    """

    def __init__(
        self, settings: RunSettings, folder: Path | None, rig: StereoRig | None = None
    ) -> None:
        self.folder, self._settings, self._rig = folder, settings, rig
        self.replaces = False  # whether the folder has results of an earlier run
        self.videos: Mapping[str, str] = {}  # file names by video ("overlay", "disparity")
        self.files: tuple[Path, ...] = ()  # all files that the run writes
        self._open, self._videos_open = ExitStack(), ExitStack()
        self._temporary: list[Path] = []
        undo = ExitStack()
        # also of a run that is dropped
        self._close = weakref.finalize(self, _close, undo, os.getpid())
        if folder is not None:
            try:
                self._note = self._prepare(folder, undo)
            except BaseException:
                self.close()
                raise

    def _prepare(self, folder: Path, undo: ExitStack) -> ProgressNote:
        """Check and lock the folder before any work is done, and write the first note to it."""
        settings = self._settings
        create_writers(settings.write)
        tables = [settings.table] if settings.table is not None else []
        output_files.check_outputs(
            tables, [*input_files(settings), *(folder / name for name in result_names())]
        )
        self._new_folders = [path for path in (folder, *folder.parents) if not path.exists()]
        undo.callback(_remove, self._new_folders)
        output_files.make_folder(folder)
        undo.callback(FolderLock(folder).release)
        undo.callback(_remove, self._temporary)
        existing = sorted(name for name in result_names() if (folder / name).exists())
        # without results, the files are of a run that was killed while it opened its inputs
        self.replaces = "settings.yaml" in existing and existing != [PROGRESS_FILE, "settings.yaml"]
        if self.replaces:
            check_replaceable(settings, folder)
        else:
            self._temporary.append(folder / "settings.yaml")
            save_settings(settings, folder / "settings.yaml")
        self._temporary.append(folder / PROGRESS_FILE)
        note = ProgressNote(
            OPENING, os.getpid(), datetime.now().astimezone().isoformat(" ", "seconds")
        )
        note.write(folder)
        return note

    def report(self, state: str) -> None:
        """Change the state in progress.json."""
        if self.folder is not None:
            self._note = replace(self._note, state=state)
            self._note.write(self.folder)

    def start(self, session: RunSession, *, has_videos: bool = True) -> None:
        """Remove the files of an earlier run from the folder, and open the files of this run, whose
        inputs are usable.

        No videos are written without `has_videos`, if the images are no longer available. A file
        that cannot be written raises OutputError, VideoError or WriterError.
        """
        if self.folder is None:
            return
        settings, folder = self._settings, self.folder
        self._session, self._clock, self._n_frames = session, session.opened.pipeline.clock, 0
        # from now on, the folder and its files are kept at the end, except progress.json
        names = result_names()
        inputs = [*input_files(settings), *session.opened.speed.files]
        output_files.clear_results(
            folder, [name for name in names if name != PROGRESS_FILE], except_for=inputs
        )
        remove_clips(folder / CLIPS_FOLDER)
        # temporary files `.PID.NAME` of runs that were killed (see `atomic_files`)
        _remove(
            [path for path in folder.glob(".[0-9]*.*") if path.name.lstrip(".0123456789") in names]
        )
        self._new_folders.clear()
        self._temporary[:] = [folder / PROGRESS_FILE]
        self.report(PROCESSING)
        self._noted_s = time.monotonic()
        if self._rig is not None:
            save_rig(self._rig, folder / "rig.yaml")
            settings = settings.model_copy(update={"rig": folder / "rig.yaml"})
        save_settings(
            settings,
            folder / "settings.yaml",
            detected=session.origin.detected(),
            file_hashes=session.origin.inputs_read.hashes,
        )
        recording = session.recording
        drawn = pictures(settings, recording, session.meter.captions) if has_videos else {}
        self.videos = {name: f"{name}.mp4" for name in drawn}
        info = session.origin.info(
            folder / self.videos["overlay"] if "overlay" in drawn else None, session.notes
        )
        info = replace(info, events=lambda: [event_values(one) for one in session.rows.events])
        self._metadata = info.provenance.metadata()
        self._events = self._open.enter_context(EventFiles(folder, self._metadata))
        self._writers = self._open.enter_context(OpenWriters(settings.write, info, folder))
        self._open.enter_context(self._videos_open)
        self._videos = [
            self._videos_open.enter_context(
                ResultVideo(
                    folder / self.videos[name],
                    draw,
                    size_px=size_px,
                    fps=recording.fps,
                    clock=self._clock,
                )
            )
            for name, (draw, size_px) in drawn.items()
        ]
        rows = (*self._events.files, *self._writers.files)
        positions = (
            () if not settings.keep_gps or session.opened.speed.track is None else (TELEMETRY_FILE,)
        )
        rigs = () if self._rig is None else ("rig.yaml",)
        names = (
            *self.videos.values(),
            "report.html",
            *rows,
            *((CROSSINGS_FILE, CROSSINGS_PARQUET) if session.rows.counter.places else ()),
            *positions,
            *rigs,
            "summary.json",
            "settings.yaml",
        )
        self.files = tuple(folder / name for name in names)

    def write(
        self,
        result: FrameResult,
        record: Callable[[FrameResult], Sequence[Event]] = lambda _result: (),
    ) -> None:
        """Write the rows of a frame, pass it to the threads that write the videos, and write the
        events that ended.

        The rows are written only if the videos of the earlier frames did not fail; if the rows of
        one file fail, or `record`, the rows of the other files are removed. `record` adds the frame
        to the rows of the run, and returns the events that ended. The first OutputError or
        VideoError of this or an earlier frame is raised.
        """
        if self.folder is None:
            record(result)
            return
        for video in self._videos:
            video.wait()
        for video in self._videos:
            if video.precedes_rows:
                video.write(result)
        try:
            with self._clock.stage("write"):
                self._writers.write(result)
        except UserError:
            for video in self._videos:
                video.raise_error()
            raise
        for video in self._videos:
            if not video.precedes_rows:
                video.write(result)
        self._n_frames += 1
        now_s = time.monotonic()
        if now_s - self._noted_s >= _NOTE_INTERVAL_S:
            self._noted_s = now_s
            with suppress(output_files.OutputError):  # the note is not a result
                replace(self._note, frames=self._n_frames).write(self.folder)
        try:
            ended = record(result)
        except BaseException:
            self._writers.discard_last()
            raise
        with self._clock.stage("write"):
            self._events.add(ended)

    def finish_videos(self) -> None:
        """Draw and encode the queued frames, and close the videos; VideoError if a video failed."""
        self._videos_open.close()

    def finish(self, summary: Mapping[str, Any], recorded: Rows) -> None:
        """Write summary.json, report.html, the events and the Markdown tables, and close the files
        of the rows.

        If a file cannot be written, the other files are still written, and the first OutputError is
        raised. `recorded`: rows of the run, with the ground truth if there is one.
        """
        if self.folder is None:
            return
        settings, folder, rows, track = (
            self._settings,
            self.folder,
            self._session.rows,
            self._session.opened.speed.track,
        )
        clips = folder / CLIPS_FOLDER if settings.clips else None
        shown = {
            key: value
            for key, value in absolute_settings(settings).items()
            if value not in ([], {})
        }
        report, poses = {**summary, "settings": shown}, read_poses(folder)
        steps: list[Callable[[], object]] = []
        if clips is not None and "overlay" in self.videos:
            steps.append(partial(self._cut_clips, folder / self.videos["overlay"], clips))
            self.files += (clips,) if rows.events else ()
        steps += [
            lambda: self._events.finish(rows.events),  # with the names of their clips
            partial(output_files.write_json, folder / "summary.json", summary),
            partial(
                write_report,
                folder / "report.html",
                report,
                recorded,
                rows.events,
                clips=clips,
                poses=poses,
            ),
            partial(self._writers.close, summary),
            *(
                [partial(write_crossings, folder, rows.counter.crossings, self._metadata)]
                if rows.counter.places
                else []
            ),
        ]
        if settings.keep_gps and track is not None:
            times = {"first_s": rows.starts_s, "last_s": rows.last_s}
            steps.append(partial(write_positions, folder / TELEMETRY_FILE, track, **times))
        if settings.table is not None:
            steps.append(partial(output_files.write_text, settings.table, markdown(summary)))
        call_all(steps)
        # a drive whose positions are not known has no road
        self.files = tuple(file for file in self.files if file.exists())

    def _cut_clips(self, overlay: Path, clips: Path) -> None:
        """Write the clips of the events, which know them afterwards."""
        rows = self._session.rows
        written = write_clips(overlay, rows.events, clips, starts_s=rows.starts_s)
        rows.events = with_clip_files(rows.events, {path.name for path in written})

    def close(self) -> None:
        """Remove the note and the lock and, without `start`, all created files; a second call does
        nothing.
        """
        self._close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        try:
            self._open.close()
        except UserError:
            if error is None:  # the first error is the one to report
                raise
        finally:
            self.close()


def _close(undo: ExitStack, pid: int) -> None:
    if os.getpid() == pid:  # not in a forked process
        undo.close()


def _remove(paths: Sequence[Path]) -> None:
    """Remove files and empty folders, as far as possible."""
    for path in paths:
        with suppress(OSError):
            if path.is_dir():
                path.rmdir()
            else:
                path.unlink()
