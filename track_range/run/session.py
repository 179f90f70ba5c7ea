"""RunSession: a run in progress: its opened inputs, the frames finished so far, its notes and its summary."""

from __future__ import annotations

import platform
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

import numpy as np

from track_range.overlay.outputs import missing_outputs, pictures
from track_range.ranging.evaluation.truth import Truth
from track_range.results.columns import Columns
from track_range.results.summary import range_scores, stage_times_ms, track_scores
from track_range.results.table import RunTable
from track_range.results.truth import MatchedTruth
from track_range.results.writers import RunInfo
from track_range.run.box_source import BoxSource
from track_range.run.frame_result import FrameResult
from track_range.run.pipeline import Pipeline
from track_range.run.settings import RunSettings, absolute_settings
from track_range.run.throughput import FrameMeter
from track_range.video.recording import Recording

_LIBRARIES = ("track-range", "numpy", "opencv-python-headless", "onnxruntime", "av", "scipy")
_INPUTS = ("left", "right", "mono", "rig", "focal_px", "detector", "detections", "curves", "truth")


@dataclass(slots=True, kw_only=True)
class RunSession:
    """A run in progress.

    Attributes:
        settings, boxes, source, truth, pipeline, meter: its opened inputs and its stages.
        table: rows of the finished frames.
        frame_index: numbers of the finished frames.
        methods: names of the distances that were measured in any of them.
        starts_s: time of the first one.
        last_s: time of the last one.
        wall_s: seconds from opening the videos to the last byte of the last frame; neither loading the network nor the
            estimation of the alignment (`alignment.look_s`) is in it.
        opened_s: seconds for opening the videos.
        stopped_by: what ended the run early.
    """

    settings: RunSettings
    boxes: BoxSource
    source: Recording
    truth: Truth | None
    pipeline: Pipeline
    meter: FrameMeter
    table: RunTable = field(default_factory=RunTable)
    frame_index: list[int] = field(default_factory=list)
    methods: set[str] = field(default_factory=set)
    starts_s: float = 0.0
    last_s: float = 0.0
    wall_s: float = 0.0
    opened_s: float = 0.0
    stopped_by: BaseException | None = None

    def add(self, result: FrameResult) -> None:
        """Add a finished frame.

        Raises:
            OutputError: its rows cannot be stored.
        """
        self.table.append(result)
        self.last_s = result.time_s
        if not self.frame_index:
            self.starts_s = self.last_s
        self.frame_index.append(result.index)
        self.methods.update(result.ranges)

    @property
    def info(self) -> RunInfo:
        """What writers are given."""
        return RunInfo(
            camera=self.source.camera,
            rig=self.source.rig,
            fps=self.source.fps,
            settings=absolute_settings(self.settings),
        )

    @property
    def notes(self) -> list[str]:
        """Sentences for the user; more of them become known while the run goes on."""
        has_results = bool(self.frame_index)
        finder, ego = self.pipeline.lane_finder, self.pipeline.ego_speed
        lanes = () if finder is None else finder.notes
        speed = ego.note(self.last_s) if ego is not None and has_results else None
        boxes = self.boxes.notes()
        return [
            *boxes,
            *self.source.notes,
            *missing_outputs(self.settings, self.source),
            *([f"Stopped early, after {len(self.frame_index)} frames."] if self.stopped_by else []),
            *self._frame_mismatch_notes(),
            *(note for ranger in self.pipeline.rangers.values() if has_results for note in ranger.notes),
            # Networks that all lack the device have the same note; once is enough.
            *(note for note in self.pipeline.notes if note not in (*boxes, *lanes)),
            *lanes,
            *([] if speed is None else [speed]),
            *self.meter.notes,
        ]

    def _frame_mismatch_notes(self) -> list[str]:
        """Notes on files of boxes or labels of which no frame number is one of the video's."""
        given = {"--detections": self.boxes.frames}
        if self.truth is not None:
            given["--truth"] = self.truth.frame
        done = np.array(self.frame_index, np.int64)
        return [
            f"{option} has boxes for frames {frames.min()} to {frames.max()}, but none for those of the video, "
            f"{done.min()} to {done.max()}: is it of another video, or numbered otherwise?"
            for option, frames in given.items()
            if len(frames) and len(done) and not np.isin(frames, done).any()
        ]

    def summary(self, columns: Columns, matched: MatchedTruth | None) -> dict[str, Any]:
        """What summary.json holds.

        Args:
            columns: rows of the finished frames, `table.to_columns()`.
            matched: their truth.
        """
        source, calibration, rangers = self.source, self.source.calibration, self.pipeline.rangers.values()
        n_frames = len(self.frame_index)
        return {
            "frames": n_frames,
            "starts_s": round(self.starts_s, 6),
            "wall_s": round(self.wall_s, 3),
            "frames_per_s": round(n_frames / self.wall_s, 3) if self.wall_s > 0 else None,
            "stages_ms": stage_times_ms(self.pipeline.clock.busy_s, n_frames),
            **range_scores(columns, matched, self.methods),
            "tracks": track_scores(columns, self.truth, np.array(self.frame_index, np.int64)),
            "calibration": calibration.kind,
            "focal_px": source.camera.fx_px,
            "baseline_m": source.rig.baseline_m if source.rig else None,
            **({"alignment": calibration.alignment.summary()} if calibration.alignment else {}),
            **{key: value for ranger in rangers for key, value in ranger.summary().items()},
            "truth": self.truth.protocol if self.truth is not None else None,
            "notes": self.notes,
            "inputs": self._inputs(),
            "files": {name: f"{name}.mp4" for name in pictures(self.settings, source)},
            "versions": _versions(),
        }

    def _inputs(self) -> dict[str, Any]:
        shown = self.settings.model_dump(mode="json", exclude_none=True)
        if self.settings.stereo is not None:
            shown["left"], shown["right"] = shown["stereo"]
        return {key: shown[key] for key in _INPUTS if key in shown}

    def found(self) -> dict[str, Any]:
        """The section `found` of settings.yaml: what was read from the inputs."""
        source, camera = self.source, self.source.camera
        return {
            **self.boxes.found,
            "rig": str(source.calibration.path) if source.calibration.path else None,
            "focal_px": camera.fx_px,
            "focal_y_px": camera.fy_px,
            "principal_point_px": [camera.cx_px, camera.cy_px],
            "baseline_m": source.rig.baseline_m if source.rig else None,
            "image_size_px": list(source.size_px),
            "fps": source.fps,
            "versions": _versions(),
        }


def _versions() -> dict[str, str]:
    return {"python": platform.python_version(), **{name: version(name) for name in _LIBRARIES}}
