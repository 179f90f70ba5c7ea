"""Output folder of a run: rows and videos are written during the run, the summary and the report at its end."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from track_range.foundation.errors import UserError
from track_range.foundation.files.output_files import check_outputs, clear_results, write_text
from track_range.pipeline.frame_result import FrameResult
from track_range.recording.telemetry.position_file import TELEMETRY_FILE, write_positions
from track_range.results.columns import Columns
from track_range.results.events.clip_names import CLIPS_FOLDER
from track_range.results.events.event import Event
from track_range.results.events.files import EventFiles
from track_range.results.progress_note import PROCESSING, PROGRESS_FILE
from track_range.results.summary import write_summary
from track_range.results.writers import OpenWriters, create_writers, result_names
from track_range.run.pictures import pictures, video_format
from track_range.run.prepared_folder import PreparedFolder
from track_range.run.session import RunSession
from track_range.run.settings import RunSettings, absolute_settings, input_files, save_settings
from track_range.views.event_clips import remove_clips, write_clips
from track_range.views.overlay.result_video import ResultVideo
from track_range.views.report.page import write_report
from track_range.views.report.tables import markdown


def check_folder(settings: RunSettings, folder: Path) -> None:
    """Check, before any work is done, that outputs can be written and do not overwrite inputs.

    Raises:
        OutputError: a file cannot be written, or is an input.
        WriterError: one of the result writers cannot be used.
    """
    create_writers(settings.write)
    tables = [settings.table] if settings.table is not None else []
    check_outputs(tables, [*input_files(settings), *(folder / name for name in result_names())])


class RunFolder:
    """Output files of a run in progress; a context manager that closes what `finish` did not.

    Attributes:
        folder: the output folder.
        videos: file names by video ("overlay", "disparity").
        files: names of all files that the run writes.
    """

    def __init__(self, session: RunSession, prepared: PreparedFolder, *, has_videos: bool = True) -> None:
        """Remove the files of an earlier run from the folder, and open those of this run.

        Args:
            session: the opened run.
            prepared: the output folder.
            has_videos: whether videos are written; False if the images are no longer available.

        Raises:
            OutputError, VideoError, WriterError: a file cannot be written.
        """
        folder = prepared.folder
        self.folder, self._prepared, self._session = folder, prepared, session
        settings, recording, clock = session.settings, session.source, session.pipeline.clock
        earlier = [name for name in result_names() if name != PROGRESS_FILE]
        clear_results(folder, earlier, except_for=[*input_files(settings), *session.speed.files])
        remove_clips(folder / CLIPS_FOLDER)
        prepared.confirm()
        prepared.report(PROCESSING)
        save_settings(settings, folder / "settings.yaml", detected=session.detected())
        self._n_frames = 0
        drawn = pictures(settings, recording, session.meter.captions) if has_videos else {}
        self.videos = {name: f"{name}.mp4" for name in drawn}
        overlay = folder / self.videos["overlay"] if "overlay" in self.videos else None
        info = replace(session.info, overlay=overlay)
        with ExitStack() as opening:
            self._events = opening.enter_context(EventFiles(folder, info.provenance.metadata()))
            self._writers = opening.enter_context(OpenWriters(settings.write, info, folder))
            self._videos_open = opening.enter_context(ExitStack())
            self._videos = [
                self._videos_open.enter_context(
                    ResultVideo(folder / f"{name}.mp4", draw, form=video_format(name, settings, recording), clock=clock)
                )
                for name, draw in drawn.items()
            ]
            self._open = opening.pop_all()
        rows = (*self._events.files, *self._writers.files)
        has_positions = settings.keep_gps and session.speed.track is not None
        positions = (TELEMETRY_FILE,) if has_positions else ()
        self.files = (*self.videos.values(), "report.html", *rows, *positions, "summary.json", "settings.yaml")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        try:
            self._open.__exit__(kind, error, at)
        except UserError:
            if error is None:  # the first error is the one to report
                raise

    def write(self, result: FrameResult) -> None:
        """Write the rows of a frame, and pass it to the threads that write the videos.

        The rows are written only if the videos of the earlier frames did not fail; if the rows of one file fail, those
        of the others are removed.

        Raises:
            OutputError, VideoError: writing failed for this or an earlier frame; the first error, if there are several.
        """
        for video in self._videos:
            video.wait()
        for video in self._videos:
            if video.precedes_rows:
                video.write(result)
        try:
            with self._session.pipeline.clock.stage("write"):
                self._writers.write(result)
        except UserError:
            for video in self._videos:
                video.raise_error()
            raise
        for video in self._videos:
            if not video.precedes_rows:
                video.write(result)
        self._n_frames += 1
        self._prepared.report_frames(self._n_frames)

    def add_events(self, events: Sequence[Event]) -> None:
        """Add events that have ended to events.csv.

        Raises:
            OutputError: they cannot be written.
        """
        with self._session.pipeline.clock.stage("write"):
            self._events.add(events)

    def discard_last(self) -> None:
        """Remove the rows of the last frame."""
        self._writers.discard_last()

    def finish_videos(self) -> None:
        """Draw and encode the queued frames, and close the videos.

        Raises:
            VideoError: writing failed for this or an earlier frame.
        """
        self._videos_open.close()

    def finish(self, summary: Mapping[str, Any], columns: Columns) -> None:
        """Write summary.json, report.html, the events and the Markdown tables, and close the files of the rows.

        If a file cannot be written, the others are.

        Args:
            summary: the results of the run.
            columns: rows of the run, with the ground truth if there is one.

        Raises:
            OutputError: a file cannot be written; the first one, if there are several.
        """
        settings = self._session.settings
        shown = {key: value for key, value in absolute_settings(settings).items() if value not in ([], {})}
        steps: list[Callable[[], object]] = [partial(self._events.finish, self._session.events)]
        if settings.clips and "overlay" in self.videos:
            overlay, clips = self.folder / self.videos["overlay"], self.folder / CLIPS_FOLDER
            steps.append(partial(write_clips, overlay, self._session.events, clips, starts_s=self._session.starts_s))
            self.files += (CLIPS_FOLDER,) if self._session.events else ()
        steps += [
            partial(write_summary, self.folder / "summary.json", summary),
            partial(
                write_report,
                self.folder / "report.html",
                {**summary, "settings": shown},
                columns,
                self._session.events,
                clips=self.folder / CLIPS_FOLDER if settings.clips else None,
            ),
            partial(self._writers.close, summary),
        ]
        if settings.keep_gps and (track := self._session.speed.track) is not None:
            times = {"first_s": self._session.starts_s, "last_s": self._session.last_s}
            steps.append(partial(write_positions, self.folder / TELEMETRY_FILE, track, **times))
        if settings.table is not None:
            steps.append(partial(write_text, settings.table, markdown(summary)))
        errors = []
        for step in steps:
            try:
                step()
            except UserError as error:
                errors.append(error)
        if errors:
            raise errors[0]
