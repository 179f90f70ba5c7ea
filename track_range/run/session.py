"""RunSession: opened inputs of a run, the rows and events of its finished frames, its notes and its
summary.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from track_range.calibration.road.from_road import focal_from_video
from track_range.detection.detector import ObjectDetector
from track_range.detection.yolo.detector import YoloDetector
from track_range.foundation.errors import RunStoppedError, UserError
from track_range.foundation.files.input_files import counted
from track_range.foundation.installed import conflicts, installed_versions
from track_range.foundation.progress import StepProgress
from track_range.foundation.schemas.schema_version import SCHEMA_VERSION
from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.threads import LIVE_DEPTHS, run_in_threads
from track_range.pipeline.throughput import FrameMeter, PacedFrames
from track_range.ranging.registry import origins
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.size_models.region import Region, region_at
from track_range.ranging.size_models.size_model import SizeModel
from track_range.ranging.truth.truth import read_truth
from track_range.recording.speed_source import AUTO, open_speed
from track_range.recording.telemetry.tracks.positions import has_position
from track_range.recording.telemetry.tracks.track import TelemetryTrack
from track_range.recording.video.address import LiveAddress
from track_range.results.approaches import closest_approaches
from track_range.results.events.finder import EventFinder
from track_range.results.formats.provenance import Provenance, settings_hash
from track_range.results.formats.run_info import RunInfo
from track_range.results.progress_note import LOADING
from track_range.results.rows.rows import Rows
from track_range.results.summary import (
    events_section,
    frame_spans,
    matched_truth,
    range_scores,
    stage_times_ms,
    track_scores,
    with_truth,
)
from track_range.results.table import RunRows
from track_range.run.box_source import boxes_of, open_box_source, outside_regions
from track_range.run.build import open_input, open_pipeline
from track_range.run.findings import Findings, still_boxes_note
from track_range.run.options.anonymity import ANONYMIZED, without_folders, without_paths
from track_range.run.options.opened import DetectorOptions
from track_range.run.options.option_notes import assumed_rate, unused_options
from track_range.run.options.paths import input_files
from track_range.run.options.settings import RunSettings
from track_range.run.options.settings_file import absolute_settings
from track_range.run.pictures import missing_outputs
from track_range.run.progress import step_progress
from track_range.run.ready_model import ready_model
from track_range.stereo.geometry.rig import StereoRig
from track_range.tracking.evaluation.frame_shift import frame_shift_note
from track_range.tracking.registry import ObjectTracker

_LIBRARIES = ("track-range", "numpy", "opencv-python-headless", "onnxruntime", "av", "scipy")
_INPUTS = ("left", "right", "mono", "rig", "focal_px", "detector", "detections", "curves", "truth")
_NO_POSITIONS = "--keep-gps: the recording has no telemetry with positions that can be used."


class RunSession:
    """Opened inputs of a run, and the results of its finished frames; an unusable input raises its
    error.

    `detector`, `tracker` and `rig` replace the settings' choices; `report` is called with the name
    of each task of the opening.
    """

    def __init__(
        self,
        settings: RunSettings,
        *,
        detector: ObjectDetector | None,
        tracker: ObjectTracker | None,
        rig: StereoRig | None,
        open_detector: Callable[[Path, DetectorOptions], YoloDetector],
        console: Console,
        report: Callable[[str], None],
    ) -> None:
        def progress(task: str) -> AbstractContextManager[Callable[[int, int | None], None]]:
            report(task)
            return step_progress(console, task)

        self.settings = settings
        self._stopped_by: BaseException | None = None  # error that ended the run early
        # on the frame numbers of labels, known at the end of the run
        self.frame_notes: tuple[str, ...] = ()
        # cars of one region show the focal length better than of any
        shapes = load_curves(settings.curves, "europe")
        start_s = time.perf_counter()
        self.recording = open_input(settings, progress, rig)
        alignment = self.recording.calibration.alignment
        self._wall_s = (
            time.perf_counter() - start_s - (alignment.estimation_s if alignment else 0.0)
        )
        with ExitStack() as on_error:
            on_error.callback(self.recording.close)
            report(LOADING)
            if detector is None:
                models = partial(ready_model, console=console)
                boxes = open_box_source(settings, self.recording, models, open_detector)
            else:
                boxes = boxes_of(detector)
            uncalibrated = self.recording.calibration
            self.box_source = outside_regions(boxes, settings.ignore, uncalibrated)
            if detector is None:  # an object may depend on the order of the frames
                self._estimate_focal_length(shapes, progress)
            calibration, path = self.recording.calibration, settings.truth
            shift_m = calibration.left_from_reference_m
            self.truth = None if path is None else read_truth(path, calibration.camera, shift_m)
            self.speed = open_speed(
                settings.ego_speed,
                self.recording,
                start_s=settings.start_s,
                duration_s=settings.duration_s,
                folder_fps=settings.folder_fps,
            )
            self.region = settings.region or _region_of(self.speed.track)
            self.pipeline = open_pipeline(
                settings,
                calibration,
                self.box_source,
                region=self.region,
                tracker=tracker,
                ego_speed=self.speed.ego,
                measures_speed=settings.ego_speed == AUTO,
                needs_candidates=settings.anonymize,
            )
            on_error.pop_all()
        self.rows = RunRows(fps=self.recording.fps, finder=EventFinder(settings.event_settings))
        self._paced = self._paced_frames()
        self.meter = FrameMeter(self.recording.live or self._paced, every=settings.every)
        self.findings = Findings()

    def _paced_frames(self) -> PacedFrames | None:
        """The frames at the pace of a camera, if the settings ask for it."""
        recording = self.recording
        if not self.settings.realtime or recording.live is not None:
            return None
        fps = recording.fps or self.settings.folder_fps
        return PacedFrames(recording.frames, 1 / fps)

    def _estimate_focal_length(self, size_model: SizeModel, progress: StepProgress) -> None:
        """Estimate the unknown focal length of a recording that is not live from the boxes in its
        first seconds.
        """
        recording, settings, video = self.recording, self.settings, self.recording.videos[0].path
        guesses = recording.calibration.guesses
        if not guesses or recording.live is not None or isinstance(video, LiveAddress):
            return
        with progress("estimating the focal length") as advance:
            posterior = focal_from_video(
                video,
                guesses,
                self.box_source.detect,
                size_model,
                span_s=(settings.start_s, settings.duration_s),
                folder_fps=settings.folder_fps,
                advance=advance,
            )
        self.recording = recording.with_focal_length(posterior.as_guess(guesses))

    @contextmanager
    def results(self) -> Generator[Generator[FrameResult, None, None], None, None]:
        """Context with the results of all frames, anonymized if requested; its end stops the
        threads.
        """
        frames, paced = self.recording.frames, self._paced
        is_live = self.recording.live is not None or paced is not None
        depths = LIVE_DEPTHS if is_live else None
        with ExitStack() as stack:
            results = run_in_threads(
                self.pipeline, frames if paced is None else iter(paced), depths
            )
            stack.enter_context(closing(results))
            if paced is not None:
                stack.callback(paced.stop)
            if not self.settings.anonymize:
                yield results
                return
            from track_range.views.anonymization.look_ahead import LIVE, OFFLINE, anonymized_results

            with closing(anonymized_results(results, LIVE if is_live else OFFLINE)) as anonymized:
                yield anonymized

    @property
    def provenance(self) -> Provenance:
        """Origin of the results."""
        return Provenance.of_inputs(
            self.detected(), settings_hash(absolute_settings(self.settings), origins())
        )

    def info(self, overlay: Path | None) -> RunInfo:
        """Properties of the run for result writers."""
        recording = self.recording
        return RunInfo(
            camera=recording.camera,
            rig=recording.rig,
            fps=recording.fps,
            settings=absolute_settings(self.settings),
            start_utc_s=None if recording.utc is None else recording.utc.start_s,
            provenance=self.provenance,
            notes=tuple(self.notes),
            overlay=overlay,
            recorded_boxes=recording.calibration.rectifier.recorded_boxes,
        )

    def detected(self) -> dict[str, Any]:
        """Section `found` of settings.yaml: properties of the opened inputs."""
        recording, camera = self.recording, self.recording.camera
        rig = recording.calibration.path
        return {
            **self.box_source.description,
            "rig": None if rig is None else rig.name if self.settings.anonymize else str(rig),
            "calibration": recording.calibration.kind,
            "focal_px": camera.fx_px,
            "focal_y_px": camera.fy_px,
            "principal_point_px": [camera.cx_px, camera.cy_px],
            "baseline_m": recording.rig.baseline_m if recording.rig else None,
            "image_size_px": list(recording.size_px),
            "fps": recording.fps,
            "utc": None if recording.utc is None else recording.utc.summary(),
            "versions": _versions(),
        }

    @property
    def inputs(self) -> dict[str, Any]:
        """Names of the inputs, for summary.json."""
        shown = self.settings.model_dump(mode="json", exclude_none=True)
        if self.settings.stereo is not None:
            shown["left"], shown["right"] = shown["stereo"]
        inputs = {key: shown[key] for key in _INPUTS if key in shown}
        return without_folders(inputs) if self.settings.anonymize else inputs

    @property
    def notes(self) -> list[str]:
        """Messages for the user so far; more may follow during the run."""
        settings, pipeline, n_frames = self.settings, self.pipeline, len(self.rows)
        finder, odometry = pipeline.detection.lane_finder, pipeline.ego.speed_source
        lanes = () if finder is None else finder.notes
        expected_s = settings.start_s + (self.recording.n_frames or 0) / self.recording.fps
        speed = self.speed.note(self.rows.last_s if n_frames else expected_s)
        boxes = self.box_source.notes()
        notes = [
            *([ANONYMIZED] if settings.anonymize else []),
            *boxes,
            *conflicts(),
            *(self.truth.notes if self.truth is not None else ()),
            *self.recording.notes,
            *assumed_rate(settings, self.recording),
            *self.speed.notes,
            *([_NO_POSITIONS] if settings.keep_gps and self.speed.track is None else []),
            *missing_outputs(settings, self.recording),
            *unused_options(settings),
            *([] if self._stopped_by is None else [self._stop_note(self._stopped_by)]),
            *self.frame_notes,
            *(pipeline.ranging.notes() if n_frames else ()),
            *(pipeline.doubting.notes() if n_frames else ()),
            # networks that fall back from the same device have the same note
            *(note for note in pipeline.notes if note not in (*boxes, *lanes)),
            *lanes,
            *([speed] if speed else []),
            *([] if odometry is None else [self._odometry_note(odometry)]),
            *self.meter.notes,
        ]
        if not settings.anonymize:
            return notes
        rig = self.recording.calibration.path
        rigs = [] if rig is None else [rig]
        paths = [*input_files(settings), *rigs, *self.speed.files]
        return [without_paths(note, paths) for note in notes]

    def _stop_note(self, error: BaseException) -> str:
        stopped = f"The run was stopped early, after {counted(len(self.rows), 'frame')}"
        is_asked = isinstance(error, RunStoppedError | GeneratorExit | KeyboardInterrupt)
        if is_asked or self.settings.anonymize:  # a cause may name folders
            return f"{stopped}."
        return (
            f"{stopped}: "
            f"{error if isinstance(error, UserError) else f'{type(error).__name__}: {error}'}"
        )

    def _odometry_note(self, source: str) -> str:
        n_frames, n_known = len(self.rows), int(np.isfinite(self.rows.ego_mps).sum())
        part = f", but only in {n_known} of {n_frames} frames" if 2 * n_known < n_frames else ""
        return f"The ego speed comes from {source}{part}; --ego-speed off ignores it."

    def _notes_on_frames(self, columns: Rows) -> tuple[str, ...]:
        """Notes on files of boxes or labels whose frame numbers do not fit the video."""
        processed = np.array(self.rows.frame_index, np.int64)
        if not len(processed):
            return ()
        first, last = processed.min(), processed.max()
        is_whole = self._stopped_by is None and self.settings.duration_s is None
        labelled = {"--detections": self.box_source.frames}
        labelled |= {} if self.truth is None else {"--truth": self.truth.frame}
        labelled = {option: frames for option, frames in labelled.items() if len(frames)}
        missed = [
            f"{option} has boxes for frames {frames.min()} to {frames.max()}, but none for the "
            f"frames of the video, {first} to {last}: check that the boxes belong to this video, "
            "and whether their frame numbers start at 0."
            for option, frames in labelled.items()
            if not np.isin(frames, processed).any()
        ]
        beyond = [
            f"{option} has boxes up to frame {frames.max()}, but the last frame of the video is "
            f"{last}; later boxes are ignored."
            for option, frames in labelled.items()
            if is_whole and frames.min() <= last < frames.max()
        ]
        if self.truth is None:
            return (*missed, *beyond)
        labels = self.truth.select(self.truth.class_id >= 0)
        frame = columns["frame"]
        shift = frame_shift_note("--truth", labels.frame, labels.xyxy_px, frame, columns.boxes_px)
        return (*missed, *beyond, *shift)

    def end(self, processing_s: float, stopped_by: BaseException | None) -> None:
        """End the processing after `processing_s`, early if an error stopped it.

        The time of the run is that for opening the videos and processing all frames, without
        loading the network and without the estimation of the alignment.
        """
        self._wall_s += processing_s
        self._stopped_by = stopped_by

    def finish(self, videos: Mapping[str, str]) -> tuple[dict[str, Any], Rows]:
        """Content of summary.json, and the rows with the ground truth; `videos`: file names by
        video ("overlay").
        """
        rows, recording, pipeline = self.rows, self.recording, self.pipeline
        calibration = recording.calibration
        rows.finish()
        columns, n_frames = rows.table.to_rows(), len(rows)
        matched = None if self.truth is None else matched_truth(columns, self.truth)
        detect = None if self.box_source.prepare is None else self.box_source.detect
        self.frame_notes = (
            *self._notes_on_frames(columns),
            *self.findings.notes(detect, recording.rig),
        )
        self.frame_notes += still_boxes_note(columns, calibration)
        busy_s = {**pipeline.clock.busy_s, "read": recording.busy_s}
        summary = {
            "frames": n_frames,
            **frame_spans(np.array(rows.frame_index, np.int64), self.settings.every or 1),
            "starts_s": round(rows.starts_s, 6),
            "utc": None if recording.utc is None else recording.utc.summary(),
            "ego_speed": self.speed.summary(np.array(rows.ego_mps), pipeline.ego.speed_source),
            "wall_s": round(self._wall_s, 3),
            "frames_per_s": round(n_frames / self._wall_s, 3) if self._wall_s > 0 else None,
            "stages_ms": stage_times_ms(busy_s, n_frames),
            **self.meter.summary(),
            **range_scores(columns, matched, rows.methods),
            "tracks": track_scores(columns, self.truth, np.array(rows.frame_index, np.int64)),
            "closest_approaches": closest_approaches(columns),
            "events": events_section(rows.events, rows.seconds),
            "calibration": calibration.kind,
            "focal_px": recording.camera.fx_px,
            "focal_sigma": round(calibration.focal_sigma, 4),
            "region": self.region,
            "baseline_m": recording.rig.baseline_m if recording.rig else None,
            **pipeline.doubting.summary(),
            **({"alignment": calibration.alignment.summary()} if calibration.alignment else {}),
            **({} if recording.sync is None else recording.sync.summary()),
            **({"drive_bias": pipeline.scale.summary()} if pipeline.scale.n_tracks else {}),
            **pipeline.ranging.summary(),
            "truth": self.truth.protocol if self.truth is not None else None,
            "notes": self.notes,
            "inputs": self.inputs,
            "files": dict(videos),
            "versions": _versions(),
            "schema_version": SCHEMA_VERSION,
            "settings_hash": self.provenance.settings_hash,
        }
        return summary, columns if matched is None else with_truth(columns, matched)


@cache
def _versions() -> dict[str, str]:
    libraries = [item for name in _LIBRARIES for item in installed_versions(name).items()]
    return {"python": platform.python_version(), **dict(libraries)}


def _region_of(track: TelemetryTrack | None) -> Region:
    if track is None:
        return "unknown"
    is_known = has_position(track.latitude_deg, track.longitude_deg)
    if not is_known.any():
        return "unknown"
    return region_at(
        float(np.median(track.latitude_deg[is_known])),
        float(np.median(track.longitude_deg[is_known])),
    )
