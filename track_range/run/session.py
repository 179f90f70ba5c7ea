"""What a run was given, what came of it, and what summary.json and settings.yaml say of that."""

from __future__ import annotations

import platform
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

import numpy as np

from track_range.overlay.outputs import missing_outputs, pictures
from track_range.ranging.evaluation.truth import Truth
from track_range.results.summary import Columns, MatchedTruth, range_scores, stage_times_ms, track_scores
from track_range.run.box_source import BoxSource
from track_range.run.frame_result import FrameResult
from track_range.run.pipeline import Pipeline
from track_range.run.settings import RunSettings
from track_range.run.throughput import FrameMeter
from track_range.video.recording import Recording

_LIBRARIES = ("track-range", "numpy", "opencv-python-headless", "onnxruntime", "av", "scipy")


@dataclass(slots=True, kw_only=True)
class RunRecord:
    """One run: what it was given, and what came of it.

    Attributes:
        frame_index: the frames finished.
        starts_s: time of the first one.
        last_s: time of the last one.
        wall_s: time for them, from opening the videos to the last byte of the last one; not for loading the network,
            nor for the look through the first frames that tells the alignment (`alignment.look_s`).
        stopped_by: what ended the run early, told again once the finished part is safe.
    """

    settings: RunSettings
    boxes: BoxSource
    source: Recording
    truth: Truth | None
    pipeline: Pipeline
    meter: FrameMeter
    frame_index: list[int] = field(default_factory=list)
    methods: set[str] = field(default_factory=set)
    starts_s: float = 0.0
    last_s: float = 0.0
    wall_s: float = 0.0
    stopped_by: BaseException | None = None

    def count(self, result: FrameResult) -> None:
        """A frame is finished."""
        self.last_s = result.frame.time_s
        if not self.frame_index:
            self.starts_s = self.last_s
        self.frame_index.append(result.frame.index)
        self.methods.update(result.ranges)

    @property
    def notes(self) -> list[str]:
        """Sentences for the user on all inputs."""
        stopped = [f"Stopped early, after {len(self.frame_index)} frames."] if self.stopped_by else []
        return [
            *self.boxes.notes(),
            *self.source.notes,
            *missing_outputs(self.settings, self.source),
            *stopped,
            *self._strangers(),
            *self._measuring(),
            *self._extras(),
        ]

    def _measuring(self) -> list[str]:
        """Notes of the ranging methods, once there are results."""
        return [note for ranger in self.pipeline.rangers.values() for note in ranger.notes] if self.frame_index else []

    def _extras(self) -> list[str]:
        """What the re-identification network, the lane finder and the ego speed have to say."""
        finder, ego = self.pipeline.lane_finder, self.pipeline.ego_speed
        speed = None if ego is None or not self.frame_index else ego.note(self.last_s)
        lanes = () if finder is None else finder.notes
        # Networks that all lack the device say the same; once is enough.
        appearance = [note for note in self.pipeline.notes if note not in (*self.boxes.notes(), *lanes)]
        return [*appearance, *lanes, *(() if speed is None else (speed,)), *self.meter.notes]

    def _strangers(self) -> list[str]:
        """A file of boxes or labels none of whose frames came up: usually another video's, or numbered otherwise."""
        given = {
            "--detections": self.boxes.frames,
            "--truth": self.truth.frame if self.truth else self.boxes.frames[:0],
        }
        done = np.array(self.frame_index, np.int64)
        return [
            f"{option} has boxes for frames {frames.min()} to {frames.max()}, but none for those of the video, "
            f"{done.min()} to {done.max()}: is it of another video, or numbered otherwise?"
            for option, frames in given.items()
            if len(frames) and len(done) and not np.isin(frames, done).any()
        ]


def summary_of(this: RunRecord, columns: Columns, matched: MatchedTruth | None) -> dict[str, Any]:
    """What was measured, from the rows that were written and their truth."""
    n_frames = len(this.frame_index)
    return {
        "frames": n_frames,
        "starts_s": round(this.starts_s, 6),
        "wall_s": round(this.wall_s, 3),
        "frames_per_s": round(n_frames / this.wall_s, 3) if this.wall_s > 0 else None,
        "stages_ms": stage_times_ms(this.pipeline.clock.busy_s, n_frames),
        **range_scores(columns, matched, tuple(this.methods)),
        "tracks": track_scores(columns, this.truth, np.array(this.frame_index, np.int64)),
        **_geometry(this),
        **{key: value for ranger in this.pipeline.rangers.values() for key, value in ranger.summary().items()},
        "truth": this.truth.protocol if this.truth is not None else None,
        "notes": this.notes,
        "inputs": _inputs(this.settings),
        "files": {name: f"{name}.mp4" for name in pictures(this.settings, this.source)},
        "versions": _versions(),
    }


def _geometry(this: RunRecord) -> dict[str, Any]:
    """Where metres come from."""
    source = this.source
    return {
        "calibration": source.calibration.kind,
        "focal_px": source.camera.fx_px,
        "baseline_m": source.rig.baseline_m if source.rig else None,
        **({"alignment": source.calibration.alignment.summary()} if source.calibration.alignment else {}),
    }


def _inputs(settings: RunSettings) -> dict[str, Any]:
    shown = settings.model_dump(mode="json", exclude_none=True)
    if settings.stereo is not None:
        shown["left"], shown["right"] = shown["stereo"]
    wanted = ("left", "right", "mono", "rig", "focal_px", "detector", "detections", "curves", "truth")
    return {key: shown[key] for key in wanted if key in shown}


def found_by(this: RunRecord) -> dict[str, Any]:
    """What the run saw of its inputs, for settings.yaml."""
    source = this.source
    camera = source.camera
    return {
        **this.boxes.found,
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
