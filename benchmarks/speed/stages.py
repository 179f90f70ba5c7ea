"""Time and calls of each stage of a frame, and time of parts of them on their own."""

from __future__ import annotations

import tempfile
from argparse import Namespace
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.harness import Figures, in_new_process, option, workload
from benchmarks.inputs.dense_traffic import FPS, SPEED_MPS, DenseTraffic, one_camera
from benchmarks.inputs.drives import REAL_DATA
from benchmarks.speed import parts
from benchmarks.speed.stage_counts import StageProbe, cost_of_array_s, cost_of_call_s
from track_range.detection.detections import Detections
from track_range.detection.lanes.lines import NO_BOXES, LaneLines
from track_range.foundation.arrays import FloatArray, Image
from track_range.pipeline.frame_pipeline import FramePipeline
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import Ranger
from track_range.recording.cameras.auto_alignment import given_alignment
from track_range.recording.cameras.calibration import calibration_of
from track_range.recording.pairs.aligner import ONE_BY_ONE, PairAligner
from track_range.results.formats.run_info import RunInfo
from track_range.results.table import RunRows
from track_range.results.writers import DEFAULT_WRITERS, OpenWriters
from track_range.run.box_source import BoxSource
from track_range.run.build import SpeedInput, open_pipeline
from track_range.run.options.settings import PipelineOptions
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.speed.ego_speed import EgoSpeed
from track_range.tracking.tracks import Tracks
from track_range.views.overlay.annotator import Overlay

WITHIN: dict[str, tuple[str, ...]] = {
    "flow of the background": ("foundation.sparse_flow:BackgroundFlow.add BackgroundFlow.tracked",),
    "camera motion, tracker": ("tracking.camera_motion:CameraMotion.update",),
    "appearance": ("tracking.appearance.embeddings:ColourLayout.embed",),
    "odometry, road": ("stereo.odometry.ground_odometry:GroundOdometry.update",),
    "odometry, pair": ("stereo.odometry.stereo_odometry:StereoOdometry.update",),
    "repeated images, cuts": ("stereo.odometry.image_times:ImageTimes.update",),
    "rows": ("results.table:RunTable.append",),
    "events": ("results.events.finder:EventFinder.update",),
    "writers": ("results.writers:OpenWriters.write",),
    "overlay": ("views.overlay.annotator:Overlay.draw",),
}
"""Functions that are stages of their own here, as in `processor_time.STEPS`."""

N_FIRST, N_COUNTED = 30, 10  # frames before the timed ones, and frames whose calls are counted
_PARTS = {"methods": parts.methods_ms, "detection": parts.detectors_ms, "writers": parts.formats}


@workload(
    option(
        "--parts",
        default=("frame",),
        choices=("frame", *_PARTS),
        help="all stages of a frame, ranging methods without images, detectors, result formats",
    ),
    option("--tracks", default=(6, 15, 50), help="numbers of tracks"),
    option("--cameras", default=(1, 2), choices=(1, 2), help="numbers of cameras"),
    option("--input", default=("boxes", "images"), choices=("boxes", "images"), help="input"),
    option("--frames", type=int, help="number of timed frames; default: usual for each part"),
    option("--rounds", default=3, help="rounds of detectors and formats"),
    option("--threads", default=(1, 2), help="numbers of threads of detectors"),
    option("--models", default=parts.MODELS, help="ONNX files of detectors"),
    option(
        "--video",
        default=REAL_DATA / "kitti_stereo/0003/left.mp4",
        help="video with the images for detectors",
    ),
)
def stages(options: Namespace) -> Figures:
    """Processor time in ms, calls and operations of arrays of each stage per frame, and the share
    of the interpreter: both times the cost of one.

    Boxes are given: they are those of a simulated drive, whose images are rendered or black.
    """
    figures: Figures = {}
    for part in options.parts:
        if part != "frame":
            figures[part] = _PARTS[part](options)
            continue
        costs_us = {"call": 1e6 * cost_of_call_s(), "array operation": 1e6 * cost_of_array_s()}
        figures["cost_us"] = costs_us
        for n_tracks in options.tracks:
            figures |= in_new_process(_of_traffic, n_tracks, options)
    return figures


def _of_traffic(n_tracks: int, options: Namespace) -> Figures:
    """Tables for one number of tracks."""
    cv2.setNumThreads(1)
    n_frames = N_FIRST + (options.frames or 60) + N_COUNTED
    drive = DenseTraffic.of(n_tracks)
    images = list(drive.frames(n_frames)) if "images" in options.input else []
    figures: Figures = {}
    for n_cameras in options.cameras:
        for kind in options.input:
            frames = images if kind == "images" else list(drive.blank_frames(n_frames))
            if n_cameras == 1:
                frames = [one_camera(frame) for frame in frames]
            name = f"{n_tracks} tracks, {n_cameras} camera{'s' * (n_cameras > 1)}, {kind}"
            figures[name] = stage_figures(drive, frames, has_images=kind == "images")
    return figures


def stage_figures(
    drive: DenseTraffic, frames: list[Frame], *, has_images: bool
) -> dict[str, dict[str, float]]:
    """Figures of each stage of the pipeline and of the output of a run."""
    probe = StageProbe()
    is_pair = frames[0].right is not None
    detections = [drive.detections(frame) for frame in frames]
    overlay, rows = Overlay(camera=drive.renderer.rig.left), RunRows(fps=FPS)
    n_counted = 0
    with ExitStack() as stack:
        stack.enter_context(probe.wrapped(WITHIN))
        pipeline = _pipeline(drive.renderer.rig, detections, is_pair=is_pair, has_images=has_images)
        pipeline.clock = probe
        stack.callback(pipeline.close)
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        info = RunInfo(camera=drive.renderer.rig.left, rig=None, fps=FPS, settings={})
        writers = stack.enter_context(OpenWriters(DEFAULT_WRITERS, info, folder))
        for frame in frames:
            is_counted = frame.index >= len(frames) - N_COUNTED
            with probe.frame(counts=is_counted):
                result = pipeline.step(pipeline.detected(frame))
                writers.write(result)
                rows.add(result)
                overlay.draw(result)
            n_counted += is_counted
            if frame.index == N_FIRST:
                probe.times_s.clear()
        writers.close({"notes": []})
    return probe.figures(n_counted)


def _pipeline(
    rig: StereoRig, detections: Sequence[Detections], *, is_pair: bool, has_images: bool
) -> FramePipeline:
    """The pipeline of a run with boxes that are given; without images, lane lines, the speed of
    the camera and distances of the pair are given, too.
    """
    calibration = calibration_of(
        rig if is_pair else rig.left, ((rig.left.width_px, rig.left.height_px),) * (1 + is_pair)
    )
    if is_pair:
        given = given_alignment("off", rig)
        calibration = PairAligner(calibration, ONE_BY_ONE, given).calibration
    boxes = BoxSource(
        detect=lambda frame: detections[frame.index],
        candidates=lambda frame: detections[frame.index],
        description={},
        notes=tuple,
    )
    speed = EgoSpeed(np.array([-np.inf]), np.array([SPEED_MPS]), "drive")
    pipeline = open_pipeline(
        PipelineOptions(sgbm=False),
        calibration,
        boxes,
        speed=SpeedInput(None if has_images else speed),
    )
    if not has_images:
        pipeline.detection.lane_finder = _GivenLanes()
        rangers = dict(pipeline.ranging.rangers)
        if is_pair:
            rangers["stereo"] = _GivenStereo()
        pipeline.ranging = replace(pipeline.ranging, rangers=rangers)
    return pipeline


class _GivenLanes:
    """Lines of a straight lane in all images."""

    notes: tuple[str, ...] = ()

    def find(self, image: Image, time_s: float, boxes_px: FloatArray = NO_BOXES) -> LaneLines:
        """The lines."""
        return parts.lane_lines()


class _GivenStereo(Ranger):
    """Distances of a pair for boxes on a plane road."""

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Random distances near the true ones."""
        return parts.stereo_of_boxes(tracks, frame.index)
