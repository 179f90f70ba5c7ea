"""RunSession: state of a run in progress: opened inputs, finished frames, notes and summary."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from track_range.foundation.arrays import IntArray
from track_range.pipeline.frame_pipeline import FramePipeline
from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.throughput import FrameMeter
from track_range.ranging.evaluation.truth import Truth
from track_range.recording.recording import Recording
from track_range.recording.telemetry.speed_source import SpeedSource
from track_range.results.columns import Columns
from track_range.results.events.event import Event
from track_range.results.events.finder import EventFinder
from track_range.results.events.summary import events_section
from track_range.results.provenance import Provenance, settings_hash
from track_range.results.summary import range_scores, stage_times_ms, track_scores
from track_range.results.table import RunTable
from track_range.results.truth import MatchedTruth, boxes_px
from track_range.results.writers import RunInfo
from track_range.run.box_source import BoxSource
from track_range.run.pictures import missing_outputs, pictures
from track_range.run.settings import RunSettings, absolute_settings, input_files, unused_options, without_folders
from track_range.tracking.evaluation.frame_shift import frame_shift_note

_LIBRARIES = ("track-range", "numpy", "opencv-python-headless", "onnxruntime", "av", "scipy")
_INPUTS = ("left", "right", "mono", "rig", "focal_px", "detector", "detections", "curves", "truth")


_NO_POSITIONS = "--keep-gps: the recording has no telemetry with positions that can be used."
"""Note of a run with --keep-gps without positions."""

ANONYMIZED = (
    "Anonymized: the heads of detected or tracked people and riders and the number plates of such vehicles are covered "
    "in all images of the results. What is not detected is not covered: check the videos before you share them."
)
"""Note of a run with --anonymize."""


@dataclass(slots=True, kw_only=True)
class RunSession:
    """State of a run in progress.

    Attributes:
        settings: settings of the run.
        boxes: source of the detections.
        source: the opened recording.
        truth: ground truth; None = not given.
        pipeline: stages of the run.
        speed: ego speed and its origin.
        meter: rate and latency of the results.
        table: rows of the finished frames.
        finder: finds the events in them.
        events: events that have ended; after `finish_events` all events, in the order of their starts.
        has_all_events: whether `finish_events` was called.
        frame_index: numbers of the finished frames.
        ego_mps: ego speed at the finished frames, NaN = unknown.
        methods: names of the distances that were measured in any finished frame.
        starts_s: time of the first finished frame.
        last_s: time of the last finished frame.
        wall_s: wall-clock seconds for opening the videos and processing all frames, without loading the network and
            without the estimation of the alignment (`alignment.look_s`).
        opened_s: seconds for opening the videos.
        stopped_by: error that ended the run early; None = not stopped.
        frame_notes: messages for the user about the frame numbers of labels, known at the end of the run.
    """

    settings: RunSettings
    boxes: BoxSource
    source: Recording
    truth: Truth | None
    pipeline: FramePipeline
    speed: SpeedSource
    meter: FrameMeter
    table: RunTable = field(default_factory=RunTable)
    finder: EventFinder
    events: tuple[Event, ...] = ()
    has_all_events: bool = False
    frame_index: list[int] = field(default_factory=list)
    ego_mps: list[float] = field(default_factory=list)
    methods: set[str] = field(default_factory=set)
    starts_s: float = 0.0
    last_s: float = 0.0
    wall_s: float = 0.0
    opened_s: float = 0.0
    stopped_by: BaseException | None = None
    frame_notes: tuple[str, ...] = ()

    def add(self, result: FrameResult) -> tuple[Event, ...]:
        """Add a finished frame, and return the events that ended before it.

        Raises:
            OutputError: its rows cannot be stored.
        """
        ended = self.finder.update(result)
        self.table.append(result)
        self.events += ended
        self.last_s = result.time_s
        if not self.frame_index:
            self.starts_s = self.last_s
        self.frame_index.append(result.index)
        self.ego_mps.append(result.ego_mps)
        self.methods.update(result.ranges)
        return ended

    def finish_events(self) -> None:
        """End the search for events after the last frame: `events` then contains those in progress as well.

        A second call does nothing.
        """
        if not self.has_all_events:
            self.events, self.has_all_events = self.finder.finish(), True

    @property
    def seconds(self) -> float:
        """Duration of the finished frames in seconds, that of the last one included."""
        if not self.frame_index:
            return 0.0
        return self.last_s - self.starts_s + (1 / self.source.fps if self.source.fps else 0.0)

    @property
    def info(self) -> RunInfo:
        """Information about the run for result writers."""
        return RunInfo(
            camera=self.source.camera,
            rig=self.source.rig,
            fps=self.source.fps,
            settings=absolute_settings(self.settings),
            start_utc_s=None if self.source.utc is None else self.source.utc.start_s,
            provenance=self.provenance,
            notes=tuple(self.notes),
            recorded_boxes=self.source.calibration.rectifier.recorded_boxes,
        )

    @property
    def provenance(self) -> Provenance:
        """Origin of the results, for the result files."""
        return Provenance.of_inputs(self.detected(), settings_hash(absolute_settings(self.settings)))

    @property
    def notes(self) -> list[str]:
        """Messages for the user so far; more may follow during the run."""
        has_results = bool(self.frame_index)
        finder, ego = self.pipeline.detection.lane_finder, self.pipeline.ego.speed
        odometry = self.pipeline.ego.odometry
        lanes = () if finder is None else finder.notes
        speed = ego.note(self.last_s) if ego is not None and has_results else None
        boxes = self.boxes.notes()
        notes = [
            *([ANONYMIZED] if self.settings.anonymize else []),
            *boxes,
            *(self.truth.notes if self.truth is not None else ()),
            *self.source.notes,
            *self.speed.notes,
            *([_NO_POSITIONS] if self.settings.keep_gps and self.speed.track is None else []),
            *missing_outputs(self.settings, self.source),
            *unused_options(self.settings),
            *([f"Stopped early, after {len(self.frame_index)} frames."] if self.stopped_by else []),
            *self._frame_mismatch_notes(),
            *self.frame_notes,
            *(self.pipeline.ranging.notes() if has_results else ()),
            # networks that fall back from the same device have the same note
            *(note for note in self.pipeline.notes if note not in (*boxes, *lanes)),
            *lanes,
            *([] if speed is None else [speed]),
            *([] if odometry is None else [f"Ego speed from {odometry.source}; --ego-speed off ignores it."]),
            *self.meter.notes,
        ]
        return [self._without_paths(note) for note in notes] if self.settings.anonymize else notes

    def _without_paths(self, note: str) -> str:
        """A note with the names of the input files instead of their paths, and without the home folder."""
        rig = self.source.calibration.path
        for path in [*input_files(self.settings), *([] if rig is None else [rig]), *self.speed.files]:
            for text in (os.path.realpath(path), str(path)):
                note = note.replace(text, path.name) if os.sep in text else note
        return note.replace(str(Path.home()), "~")

    def _frame_mismatch_notes(self) -> list[str]:
        """Notes on files of boxes or labels without any frame number of the video."""
        processed = np.array(self.frame_index, np.int64)
        return [
            f"{option} has boxes for frames {frames.min()} to {frames.max()}, but none for the frames of the video, "
            f"{processed.min()} to {processed.max()}: check that it belongs to this video and how it counts frames."
            for option, frames in self._labelled_frames().items()
            if len(frames) and len(processed) and not np.isin(frames, processed).any()
        ]

    def _labelled_frames(self) -> dict[str, IntArray]:
        """Frame numbers of the files of boxes or labels, by option."""
        frames_of = {"--detections": self.boxes.frames}
        return frames_of if self.truth is None else {**frames_of, "--truth": self.truth.frame}

    def _frame_notes(self, columns: Columns) -> tuple[str, ...]:
        """Notes on labels beyond the end of the video, and on ground truth whose frames are off by one."""
        last = max(self.frame_index, default=-1)
        is_whole = self.stopped_by is None and self.settings.duration_s is None and last >= 0
        beyond = [
            f"{option} has boxes up to frame {frames.max()}, but the last frame of the video is {last}; boxes "
            "beyond it are ignored."
            for option, frames in self._labelled_frames().items()
            if is_whole and len(frames) and frames.min() <= last < frames.max()
        ]
        if self.truth is None:
            return tuple(beyond)
        labels = self.truth.select(self.truth.class_id >= 0)
        frame = columns["frame"].astype(np.int64)
        shift = frame_shift_note("--truth", labels.frame, labels.xyxy_px, frame, boxes_px(columns))
        return (*beyond, *shift)

    def summary(self, columns: Columns, matched: MatchedTruth | None) -> dict[str, Any]:
        """Content of summary.json.

        Args:
            columns: rows of the finished frames, `table.to_columns()`.
            matched: ground truth of the rows; None = not given.
        """
        source, calibration, pipeline = self.source, self.source.calibration, self.pipeline
        n_frames = len(self.frame_index)
        self.frame_notes = self._frame_notes(columns)
        return {
            "frames": n_frames,
            "starts_s": round(self.starts_s, 6),
            "utc": None if source.utc is None else source.utc.summary(),
            "ego_speed": self.speed.summary(
                np.array(self.ego_mps), None if pipeline.ego.odometry is None else pipeline.ego.odometry.source
            ),
            "wall_s": round(self.wall_s, 3),
            "frames_per_s": round(n_frames / self.wall_s, 3) if self.wall_s > 0 else None,
            "stages_ms": stage_times_ms(pipeline.clock.busy_s, n_frames),
            **range_scores(columns, matched, self.methods),
            "tracks": track_scores(columns, self.truth, np.array(self.frame_index, np.int64)),
            "events": events_section(self.events, self.seconds),
            "calibration": calibration.kind,
            "focal_px": source.camera.fx_px,
            "focal_sigma": round(calibration.focal_sigma, 4),
            "baseline_m": source.rig.baseline_m if source.rig else None,
            **({"alignment": calibration.alignment.summary()} if calibration.alignment else {}),
            **({"drive_bias": pipeline.scale.summary()} if pipeline.scale.n_tracks else {}),
            **pipeline.ranging.summary(),
            "truth": self.truth.protocol if self.truth is not None else None,
            "notes": self.notes,
            "inputs": self.inputs,
            "files": {name: f"{name}.mp4" for name in pictures(self.settings, source)},
            "versions": _versions(),
            **self.provenance.section(),
        }

    @property
    def inputs(self) -> dict[str, Any]:
        """Names of the inputs, for summary.json."""
        shown = self.settings.model_dump(mode="json", exclude_none=True)
        if self.settings.stereo is not None:
            shown["left"], shown["right"] = shown["stereo"]
        inputs = {key: shown[key] for key in _INPUTS if key in shown}
        return without_folders(inputs) if self.settings.anonymize else inputs

    def detected(self) -> dict[str, Any]:
        """Section `found` of settings.yaml: properties of the opened inputs."""
        source, camera = self.source, self.source.camera
        rig = source.calibration.path
        return {
            **self.boxes.description,
            "rig": None if rig is None else rig.name if self.settings.anonymize else str(rig),
            "calibration": source.calibration.kind,
            "focal_px": camera.fx_px,
            "focal_y_px": camera.fy_px,
            "principal_point_px": [camera.cx_px, camera.cy_px],
            "baseline_m": source.rig.baseline_m if source.rig else None,
            "image_size_px": list(source.size_px),
            "fps": source.fps,
            "utc": None if source.utc is None else source.utc.summary(),
            "versions": _versions(),
        }


def _versions() -> dict[str, str]:
    return {"python": platform.python_version(), **{name: _version_of(name) for name in _LIBRARIES}}


_version_of = cache(version)
