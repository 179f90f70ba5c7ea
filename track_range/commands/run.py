"""The main job: a video in; tracks.csv, mot.txt, overlay, summary and report out."""

from __future__ import annotations

import platform
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console

from ranging.size_curve import load_curves
from ranging.truth import Truth, read_truth
from track_range.box_source import BoxSource, open_box_source
from track_range.commands.progress import frame_progress, step_progress
from track_range.commands.ready_model import ready_model
from track_range.config import RunSettings, save_settings
from track_range.interrupts import deaf_to_interrupts, termination_as_interrupt
from track_range.overlap import short_switch_interval
from track_range.pipeline import Pipeline
from track_range.result_video import ResultVideo, VideoFormat
from track_range.results import ResultRows, read_tracks_csv
from track_range.run_pipeline import learnt_scale, open_pipeline, pictures
from track_range.source import Source, open_source
from track_range.summary import (
    TRUTH_PROTOCOL,
    matched_truth,
    range_scores,
    stage_times_ms,
    track_scores,
    write_summary,
)
from track_range.tables import summary_tables
from track_range.written import clear_results, make_folder

_LIBRARIES = ("track-range", "numpy", "opencv-python-headless", "onnxruntime", "av", "scipy")


class RunStoppedError(Exception):
    """The user ended a run early, by Ctrl-C or a polite kill; its finished part is safe."""


@dataclass(slots=True, kw_only=True)
class _Run:
    """One run: what it was given, and what came of it.

    Attributes:
        frame_index: the frames finished.
        wall_s: time for them, from opening the videos to the last byte of the last one; not for loading the network,
            nor for the look through the first frames that tells the alignment (`alignment.look_s`).
        stopped_by: what ended the run early, told again once the finished part is safe.
    """

    settings: RunSettings
    boxes: BoxSource
    source: Source
    truth: Truth | None
    pipeline: Pipeline
    frame_index: list[int] = field(default_factory=list)
    methods: set[str] = field(default_factory=set)
    wall_s: float = 0.0
    stopped_by: BaseException | None = None

    @property
    def notes(self) -> list[str]:
        """Sentences for the user on all inputs."""
        stopped = [f"Stopped early, after {len(self.frame_index)} frames."] if self.stopped_by else []
        return [*self.boxes.notes(), *self.source.notes, *stopped, *self._strangers(), *self._scale()]

    def _scale(self) -> list[str]:
        """What a pair without a rig has taught of itself."""
        scale = learnt_scale(self.pipeline, self.source.uncalibrated) if self.frame_index else None
        if scale is None:
            return []
        return [
            f"Uncalibrated: with a focal length of {scale.focal_px:.0f} px the sizes of {scale.n_tracks} tracks say a "
            f"baseline of {scale.baseline_m:.2f} m; all distances are good to about {100 * scale.relative_sigma:.0f} %."
        ]

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


def run(settings: RunSettings, console: Console) -> Path:
    """Do the whole job, print the tables, and return the folder of the results.

    A run that is interrupted, or that an input fails in the middle of, finishes its files first.

    Raises:
        RunStoppedError: the user stopped it.
        Exception: the error of an input that cannot be used, one of `track_range.cli.USER_ERRORS`.
    """
    with termination_as_interrupt():
        try:
            return _run(settings, console)
        except KeyboardInterrupt:
            raise RunStoppedError("stopped by the user before any frame was finished.") from None


def _run(settings: RunSettings, console: Console) -> Path:
    curves = load_curves(settings.curves)
    began_s = time.perf_counter()
    source = open_source(settings, partial(step_progress, console))
    opened_s = time.perf_counter() - began_s  # the first pair is decoded by now
    opened_s -= source.alignment.look_s if source.alignment else 0.0
    with closing(source.frames):
        boxes = open_box_source(settings, source.rectified_boxes, lambda word: ready_model(word, console))
        truth = read_truth(settings.truth, source.camera, source.left_from_reference_m) if settings.truth else None
        pipeline = open_pipeline(settings, source, boxes, curves)
        this = _Run(settings=settings, boxes=boxes, source=source, truth=truth, pipeline=pipeline)
        folder = settings.out_dir
        make_folder(folder)
        clear_results(folder, keep=_input_files(settings))
        told = this.notes
        _tell_notes(console, told)
        save_settings(settings, folder / "settings.yaml", found=_found(this))
        _work(this, folder, console)
        this.wall_s += opened_s
    with deaf_to_interrupts():
        columns = read_tracks_csv(folder / "tracks.csv")
        summary = _summary(this, columns)
        _tell_notes(console, [note for note in this.notes if note not in told])
        _tell_tables(console, summary)  # before they are written: a full disk may be why the run ended
        _keep(this, summary, columns, folder)
    _tell_files(console, settings, folder)
    if isinstance(this.stopped_by, KeyboardInterrupt):
        raise RunStoppedError("stopped by the user; what was finished is kept.")
    if this.stopped_by is not None:
        raise this.stopped_by
    return folder


def _tell_tables(console: Console, summary: dict[str, Any]) -> None:
    with _nobody_may_listen():
        for table in summary_tables(summary):
            console.print(table)


def _tell_files(console: Console, settings: RunSettings, folder: Path) -> None:
    videos = "".join(f"{name}.mp4, " for name in ("overlay", "disparity") if getattr(settings, name))
    names = f"{videos}report.html, tracks.csv, mot.txt, summary.json, settings.yaml"
    with _nobody_may_listen():
        console.print(f"Results in {folder}: {names}", highlight=False, markup=False, soft_wrap=True)


@contextmanager
def _nobody_may_listen() -> Iterator[None]:
    """A closed pipe, a full disk or a terminal without sigma ends the telling, not the run."""
    with suppress(OSError, UnicodeError, SystemExit):  # SystemExit is what Rich makes of a closed pipe
        yield


def _input_files(settings: RunSettings) -> list[Path]:
    """Every file that the run reads."""
    named = (
        *(settings.stereo or ()),
        settings.mono,
        settings.rig,
        settings.detections,
        settings.truth,
        settings.curves,
        settings.reid,
    )
    words = (settings.detector, settings.names, settings.align)
    return [*(path for path in named if path is not None), *(Path(word) for word in words if word is not None)]


def _work(this: _Run, folder: Path, console: Console) -> None:
    """Run every frame through the pipeline and write it."""
    began_s = time.perf_counter()
    clock = this.pipeline.clock
    try:
        with ExitStack() as stack:
            stack.enter_context(short_switch_interval())
            rows = stack.enter_context(ResultRows(folder))
            form = VideoFormat(this.source.size_px, this.source.fps)
            videos = [
                stack.enter_context(ResultVideo(folder / f"{name}.mp4", draw, form=form, clock=clock))
                for name, draw in pictures(this.settings, this.source).items()
            ]
            results = this.pipeline.run(this.source.frames)
            stack.callback(results.close)
            advance = stack.enter_context(frame_progress(console, this.source.n_frames))
            for result in results:
                with clock.stage("write"):
                    rows.write(result)
                for video in videos:
                    video.write(result)
                this.frame_index.append(result.frame.index)
                this.methods.update(result.ranges)
                advance()
    except (KeyboardInterrupt, Exception) as error:
        if not this.frame_index:
            raise
        this.stopped_by = error
    this.wall_s = time.perf_counter() - began_s
    clock.busy_s["read"] = this.source.busy_s


def _summary(this: _Run, columns: dict[str, npt.NDArray[Any]]) -> dict[str, Any]:
    """What was measured, from the rows that were written."""
    n_frames = len(this.frame_index)
    return {
        "frames": n_frames,
        "wall_s": round(this.wall_s, 3),
        "frames_per_s": round(n_frames / this.wall_s, 3) if this.wall_s > 0 else None,
        "stages_ms": stage_times_ms(this.pipeline.clock.busy_s, n_frames),
        **range_scores(columns, this.truth, tuple(this.methods)),
        "tracks": track_scores(columns, this.truth, np.array(this.frame_index, np.int64)),
        **_geometry(this),
        "truth": TRUTH_PROTOCOL if this.truth is not None else None,
        "notes": this.notes,
        "inputs": _inputs(this.settings),
        "files": {name: f"{name}.mp4" for name in pictures(this.settings, this.source)},
        "versions": _versions(),
    }


def _geometry(this: _Run) -> dict[str, Any]:
    """Where metres come from."""
    source = this.source
    scale = learnt_scale(this.pipeline, source.uncalibrated)
    return {
        "calibration": source.calibration,
        **({"learnt_scale": asdict(scale)} if scale else {}),
        **({"alignment": source.alignment.summary()} if source.alignment else {}),
    }


def _keep(this: _Run, summary: dict[str, Any], columns: dict[str, npt.NDArray[Any]], folder: Path) -> None:
    """Write summary.json and report.html."""
    from track_range.report import write_report  # matplotlib takes half a second to load, and only the end needs it

    write_summary(folder / "summary.json", summary)
    if this.truth is not None:
        columns["truth_m"] = matched_truth(columns, this.truth)[1]
    write_report(folder / "report.html", summary, columns)


def _inputs(settings: RunSettings) -> dict[str, Any]:
    shown = settings.model_dump(mode="json", exclude_none=True)
    if settings.stereo is not None:
        shown["left"], shown["right"] = shown["stereo"]
    wanted = ("left", "right", "mono", "rig", "focal_px", "detector", "detections", "curves", "truth")
    return {key: shown[key] for key in wanted if key in shown}


def _found(this: _Run) -> dict[str, Any]:
    """What the run saw of its inputs, for settings.yaml."""
    source = this.source
    camera = source.camera
    return {
        **this.boxes.found,
        "rig": str(source.rig_path) if source.rig_path else None,
        "focal_px": camera.fx_px,
        "principal_point_px": [camera.cx_px, camera.cy_px],
        "baseline_m": source.rig.baseline_m if source.rig else None,
        "image_size_px": list(source.size_px),
        "fps": source.fps,
        "versions": _versions(),
    }


def _versions() -> dict[str, str]:
    return {"python": platform.python_version(), **{name: version(name) for name in _LIBRARIES}}


def _tell_notes(console: Console, notes: Sequence[str]) -> None:
    with _nobody_may_listen():
        for note in notes:
            console.print(f"- {note}", style="dim", highlight=False, markup=False)
