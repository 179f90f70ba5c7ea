"""Run: detection, tracking and ranging of one recording, frame by frame; `track-range run` is built
on it.

    open      recording, calibration, detector, tracker, methods, ground truth
    iterate   one FrameResult per frame; rows are collected, and written if there is an output folder
    finish    results of the whole run (`summary`), summary.json and report.html

Files are written only if `out=` or `write()` gives a folder.
"""

from __future__ import annotations

import html
import inspect
import time
import weakref
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing, suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, Unpack, cast

from rich.console import Console

from track_range.foundation.arrays import Image
from track_range.foundation.errors import ConfigError, UserError
from track_range.foundation.files.input_files import counted, real_path
from track_range.foundation.schemas.keywords import KeywordsInErrors
from track_range.pipeline.frame_result import FrameResult
from track_range.results.replay import frames_of_rows
from track_range.run.box_source import BoxSource, class_name
from track_range.run.interrupts import defer_interrupts, ignore_interrupts
from track_range.run.opening import open_run
from track_range.run.options.opened import open_detector
from track_range.run.options.paths import network_files
from track_range.run.options.precedence import settings_from
from track_range.run.options.python_keywords import options_and_objects
from track_range.run.options.settings import RunSettings
from track_range.run.output import RunOutput
from track_range.run.pictures import overlay_picture
from track_range.run.progress import frame_progress
from track_range.run.session import RunSession
from track_range.views.report.outcome import class_grid, html_table, user_grid
from track_range.views.videos.result_video import Draw

_MOST_SHOWN = 10  # road users in the representation in notebooks, the nearest ones

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

    from track_range.detection.detector import ObjectDetector
    from track_range.recording.cameras.auto_alignment import PairAlignment
    from track_range.results.events.event import Event
    from track_range.run.option_types import RunKeywords
    from track_range.run.options.opened import OpenedDetectors
    from track_range.stereo.geometry.camera import PinholeCamera
    from track_range.stereo.geometry.rig import StereoRig
    from track_range.tracking.registry import ObjectTracker


class Run:
    """One pass over one recording, of two cameras with `Run.stereo`, of one with `Run.mono`.

    Iterate it once; afterwards it provides the rows and the summary. `Run(settings)` is for settings
    that were read from a file.

    Example:
        >>> import track_range as tr
        >>> run = tr.Run.mono("dashcam.mp4", focal_px=1150, duration=0.3)
        >>> for frame in run:
        ...     nearest_m = min((t.filtered_m for t in frame.objects if t.filtered_m > 0), default=None)
        >>> run.to_arrow().column_names[:4]
        ['frame', 'time_s', 'track_id', 'class']
        >>> run.summary["calibration"]
        'focal length'

    Attributes:
        settings: settings of the run.
        files: files written by a finished run.
    """

    # `help` begins with the docstring, and not with the constructor, which needs all settings
    __signature__ = inspect.Signature()

    def __init__(
        self,
        settings: RunSettings,
        *,
        detector: ObjectDetector | None = None,
        tracker: ObjectTracker | None = None,
        rig: StereoRig | None = None,
        progress: bool | Console = False,
        opened_detectors: OpenedDetectors | None = None,
        boxes: Callable[[BoxSource], BoxSource] = lambda boxes: boxes,
    ) -> None:
        """Prepare a run; nothing is opened yet.

        Args:
            settings: files are written if `out` is set.
            detector: an object with `detect(image) -> Detections`, instead of the model of the
                settings.
            tracker: an object with `update(detections, time_s, image) -> Tracks`, instead of the
                tracker in the settings.
            rig: models of the cameras, instead of a calibration file.
            progress: whether to show progress bars (also in a notebook), or the Rich console to
                show them on.
            opened_detectors: detectors that are used again instead of being opened for this run.
            boxes: returns the source of boxes that is used in place of the settings' one.

        Raises:
            ConfigError: both a detector and recorded detections are given, or a rig and a focal
                length.
        """
        if rig is not None and settings.focal_px is not None:
            raise ConfigError("give rig or focal_px, not both.")
        if detector is not None and settings.detections is not None:
            raise ConfigError("expected either a detector or detections, got both.")
        # objects are recorded in settings.yaml by their class, as module:Class
        objects = {"detector": detector, "tracker": tracker}
        named = {key: class_name(value) for key, value in objects.items() if value is not None}
        self.settings = settings.model_copy(update=named)
        self._detector, self._tracker, self._rig = detector, tracker, rig
        self._open_detector = opened_detectors or open_detector
        self._boxes = boxes
        self._console = progress if isinstance(progress, Console) else Console(quiet=not progress)
        self._folder: Path | None = settings.out
        self._output = RunOutput(self.settings, None)  # until the inputs are opened
        self._session: RunSession | None = None
        self._frames: weakref.ref[Generator[FrameResult, None, None]] | None = None
        self._is_closed = False
        self._summary: dict[str, Any] | None = None
        self._overlay: Draw | None = None
        self.files: tuple[Path, ...] = ()

    @classmethod
    def stereo(
        cls,
        left: str | Path | Sequence[str | Path],
        right: str | Path | Sequence[str | Path] | None = None,
        **options: Unpack[RunKeywords],
    ) -> Self:
        """A run on the videos, image folders or streams of two cameras.

        Args:
            left: recording of the left camera; a list of files if it consists of several.
            right: recording of the right camera; None = `left` has the images of both, with
                `stereo_layout`, by default "auto", or is a bag, with `topics=("/left", "/right")`.
            options: options of `track-range run`, with underscores: `rig="rig.yaml"`,
                `detector="yolov5n.onnx"`, `align="off"`, `sgbm=False`, `out="results"`. `detector`
                and `tracker` may also be objects with `detect` and `update`, `rig` a `StereoRig`;
                `progress` shows progress bars.

        Raises:
            ConfigError: an option is unknown or invalid, or contradicts another option.
        """
        sides = (left,) if right is None else (left, right)
        return cls._of({"stereo": tuple(_video(side) for side in sides)}, {**options})

    @classmethod
    def mono(cls, video: str | Path | Sequence[str | Path], **options: Unpack[RunKeywords]) -> Self:
        """A run on the video, image folder or stream of one camera; see `stereo` for the options.

        A list contains the files of one recording: `Run.mono(["0001.mp4", "0002.mp4"],
        focal_px=1150)`.

        Raises:
            ConfigError: an option is unknown or invalid, or contradicts another option.
        """
        return cls._of({"mono": _video(video)}, {**options})

    @classmethod
    @KeywordsInErrors(RunSettings)
    def _of(cls, source: Mapping[str, Any], options: Mapping[str, Any]) -> Self:
        values, objects = options_and_objects(RunSettings, options)
        progress = values.pop("progress", False)
        return cls(settings_from({**source, **values}), **objects, progress=progress)

    # -- open
    # -----------------------------------------------------------------------------------------------------

    @KeywordsInErrors(RunSettings)
    def open(self) -> Self:
        """Open all inputs, so that unusable ones are reported before the first frame.

        Raises:
            UserError: an input cannot be used; its class is that of the input, such as VideoError or
                RigError.
        """
        if self._session is None:
            try:
                output = self._output_of_folder()
                # said before the recording is read
                network_files((*self.settings.depth_model, *self.settings.stereo_model))
                opened = open_run(
                    self.settings,
                    detector=self._detector,
                    tracker=self._tracker,
                    rig=self._rig,
                    open_detector=self._open_detector,
                    boxes=self._boxes,
                    console=self._console,
                    report=output.report,
                )
                self._session = RunSession(opened)
            except BaseException:
                self._output.close()
                raise
        return self

    def _output_of_folder(self) -> RunOutput:
        """The output, with its folder locked; `write` may give another folder after the opening."""
        if self._output.folder != self._folder or self._session is None:
            self._output.close()
            self._output = RunOutput(self.settings, self._folder, self._rig)
        return self._output

    def close(self) -> None:
        """End the run: finish its files and close the recording."""
        self._is_closed = True
        frames = self._frames() if self._frames is not None else None
        if frames is not None:
            frames.close()
        if self._session is not None:
            self._session.recording.close()
        self._output.close()

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()

    # -- iterate
    # --------------------------------------------------------------------------------------------------

    def __iter__(self) -> Generator[FrameResult, None, None]:
        """Results of the frames in order, once; leaving the loop early ends the run with the frames
        processed so far.

        Raises:
            RuntimeError: the run was iterated before, or is closed.
        """
        if self._frames is not None:
            raise RuntimeError(
                "expected a run that was not iterated yet; create a new run, or use "
                "its rows (to_arrow)"
            )
        if self._is_closed:
            raise RuntimeError("expected an open run, but it was closed; create a new run")
        frames = self._processed()
        # a weak reference: when the loop drops the generator, the run ends
        self._frames = weakref.ref(frames)
        return frames

    def _processed(self) -> Generator[FrameResult, None, None]:
        """Results of all frames; a run that fails or is stopped after the first frame is finished
        before the error.
        """
        session = self.session
        with KeywordsInErrors(RunSettings):
            with closing(session.recording), self._output_of_folder() as output:
                output.start(session)
                start_s = time.perf_counter()
                stopped_by: BaseException | None = None
                try:
                    with (
                        session.results() as results,
                        frame_progress(self._console, self.n_frames) as advance,
                    ):
                        for result in results:
                            session.meter.add(result)
                            session.findings.add(result)
                            session.visibility.add(result)
                            with defer_interrupts():
                                output.write(result, session.rows.add)
                            advance(session.meter.status)
                            yield result
                    output.finish_videos()
                except (GeneratorExit, KeyboardInterrupt, Exception) as error:
                    if not len(session.rows):
                        raise
                    stopped_by = error
                    with suppress(Exception):  # the first error is the one to report
                        output.finish_videos()
                session.course.end(time.perf_counter() - start_s, stopped_by)
                with ignore_interrupts(), suppress(*(UserError,) if stopped_by else ()):
                    self._finish(output)
            if stopped_by is not None:
                raise stopped_by

    def _finish(self, output: RunOutput) -> None:
        self._summary, columns = self.session.finish(output.videos)
        output.finish(self._summary, columns)
        self.files = output.files

    @KeywordsInErrors(RunSettings)
    def write(self, folder: str | Path) -> Path:
        """Process all frames and write tracks.csv, mot.txt, overlay.mp4, summary.json and the other
        files to `folder`.

        After an iteration all files except the videos are written, from the rows. They do not have
        the poses of the camera: poses.csv, run_gt.osi and run.xosc are then empty.

        Raises:
            OutputError: a file cannot be written.
            RuntimeError: the iteration is still in progress.
        """
        folder = Path(folder)
        if self._frames is None:
            self._folder = folder
            for _ in self:
                pass
            return folder
        if self._summary is None:
            raise RuntimeError(
                "expected a run that is finished or not started: leave its loop or close() it "
                "first, or give out= to write while iterating"
            )
        if self._folder is not None and real_path(folder) == real_path(self._folder):
            return folder  # already written while iterating, including videos
        session, rows = self.session, self.session.rows
        with RunOutput(self.settings, folder) as output:
            output.start(session, has_videos=False)
            table = rows.table.to_rows(is_rounded=False)
            for result in frames_of_rows(
                table,
                rows.frame_index,
                rows.methods,
                session.recording.videos[0].fps,
                mounting=session.origin.mounting,
            ):
                output.write(result)
            self._finish(output)
        return folder

    # -- results
    # --------------------------------------------------------------------------------------------------

    @property
    def session(self) -> RunSession:
        """Opened inputs and state of the run; opens them if necessary."""
        if self._session is None:
            self.open()
        return cast(RunSession, self._session)

    @property
    def replaces_results(self) -> bool:
        """Whether the output folder had results of an earlier run when this run was opened."""
        return self._output.replaces

    @property
    def camera(self) -> PinholeCamera:
        """Camera model of the rectified left frames."""
        return self.session.recording.camera

    @property
    def rig(self) -> StereoRig | None:
        """Rectified stereo rig; None for one camera, or without calibration."""
        return self.session.recording.calibrated_rig

    @property
    def alignment(self) -> PairAlignment | None:
        """The alignment of a calibrated pair, which `Pipeline.stereo(align=...)` takes; None =
        other recordings.
        """
        return self.session.recording.calibration.alignment

    @property
    def uncalibrated_video(self) -> str | None:
        """Name of the one recorded video, if its focal length is not known exactly; None for other
        recordings.
        """
        shown, calibration = (
            self.session.origin.inputs.get("mono"),
            self.session.recording.calibration,
        )
        is_known = calibration.kind == "rig" and not calibration.focal_sigma
        is_live = self.session.recording.live is not None
        return None if is_known or is_live or not isinstance(shown, str) else shown

    @property
    def n_frames(self) -> int | None:
        """Expected number of frames; None = unknown."""
        return self.session.recording.n_frames

    @property
    def notes(self) -> list[str]:
        """Messages for the user so far: assumptions and problems."""
        return self.session.notes

    @property
    def is_finished(self) -> bool:
        """Whether the summary is available: all frames were processed, or the run was stopped after
        some.
        """
        return self._summary is not None

    def draw(self, result: FrameResult) -> Image:
        """Overlay of a frame, (H, W, 3) uint8 BGR; to be called from one thread, in the order of
        the frames.
        """
        if self._overlay is None:
            session = self.session
            self._overlay = overlay_picture(
                session.settings, session.recording, session.meter.captions
            )
        return self._overlay(result)

    @property
    def camera_notes(self) -> list[str]:
        """Messages on an estimated camera: how well it is known, from what, and what would help;
        none with a calibration.
        """
        return list(self.session.recording.calibration.estimate_notes)

    @property
    def summary(self) -> dict[str, Any]:
        """Content of summary.json: errors and coverage of each method, tracks, speed, notes.

        Raises:
            RuntimeError: the run is not finished.
        """
        if self._summary is None:
            raise RuntimeError(
                "expected a finished run: iterate it, close() it, or call write() before summary"
            )
        return self._summary

    @property
    def events(self) -> tuple[Event, ...]:
        """Events so far that have ended; of a finished run all events, in the order of their
        starts.
        """
        return self.session.rows.events

    def to_arrow(self) -> pa.Table:
        """Rows so far, one per track and frame, with the columns of tracks.csv; null = not
        measured.
        """
        return self.session.rows.table.to_arrow()

    def to_pandas(self) -> pd.DataFrame:
        """Rows so far as a pandas data frame; see `to_arrow`.

        Raises:
            ImportError: pandas is not installed.
        """
        return self.to_arrow().to_pandas()

    def _repr_html_(self) -> str:
        """Representation in notebooks: the videos, and the main results of a finished run."""
        source = self.settings.stereo or (self.settings.mono,)
        title = " and ".join(html.escape(str(name)) for name in source)
        if self._summary is None:
            n_frames = 0 if self._session is None else len(self._session.rows)
            return f"<p><b>track-range run</b> of {title}: {n_frames} frames so far</p>"
        users = self._summary["closest_approaches"]
        counts = f"{counted(self._summary['frames'], 'frame')}, {counted(len(users), 'road user')}"
        shown = html_table(class_grid(users)) + html_table(user_grid(users, _MOST_SHOWN))
        return f"<p><b>track-range run</b> of {title}: {counts}</p>{shown}"


def _video(name: str | Path | Sequence[str | Path]) -> str | list[str]:
    return str(name) if isinstance(name, str | Path) else [str(part) for part in name]
