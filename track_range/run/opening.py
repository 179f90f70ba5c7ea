"""Opens the inputs of a run: recording, boxes, ground truth, speed, and the pipeline for them."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console

from track_range.calibration.drive.drive_video import DriveVideo
from track_range.calibration.drive.known_metres import KnownMeasurements, known_metres
from track_range.calibration.drive.pre_pass import PrePass
from track_range.calibration.drive.shown_fixed_parts import shown_fixed_parts
from track_range.calibration.drive.shown_mounting import with_mounting
from track_range.detection.detector import ObjectDetector
from track_range.detection.yolo.detector import YoloDetector
from track_range.foundation.background import beside_steps
from track_range.foundation.progress import StepProgress
from track_range.pipeline.frame_pipeline import FramePipeline
from track_range.ranging.cameras.known_distances import KnownDistance, KnownDistances
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.size_models.region import Region, region_at
from track_range.ranging.size_models.size_model import SizeModel
from track_range.ranging.truth.truth import Truth, read_truth
from track_range.recording.recording import Recording
from track_range.recording.speed_source import AUTO, OFF, SpeedSource, open_speed
from track_range.recording.telemetry.tracks.positions import has_position
from track_range.recording.telemetry.tracks.track import TelemetryTrack
from track_range.results.counts.places import check_inside, parsed_places
from track_range.results.progress_note import LOADING
from track_range.run.box_source import (
    BoxSource,
    boxes_of,
    open_box_source,
    outside_regions,
    remembered,
)
from track_range.run.build import SpeedInput, open_input, open_pipeline, warm_up
from track_range.run.options.opened import DetectorOptions
from track_range.run.options.settings import RunSettings
from track_range.run.progress import step_progress
from track_range.run.ready_model import ready_model
from track_range.stereo.geometry.mounting import looks_ahead
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.speed.ego_speed import EgoSpeed
from track_range.tracking.registry import ObjectTracker


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenedRun:
    """The opened inputs of a run."""

    settings: RunSettings
    recording: Recording
    box_source: BoxSource
    truth: Truth | None  # None = not given
    speed: SpeedSource
    region: Region
    pipeline: FramePipeline
    opening_s: float  # time for opening the videos, without the estimation of the alignment


def open_run(
    settings: RunSettings,
    *,
    detector: ObjectDetector | None,
    tracker: ObjectTracker | None,
    rig: StereoRig | None,
    open_detector: Callable[[Path, DetectorOptions], YoloDetector],
    console: Console,
    report: Callable[[str], None],
    boxes: Callable[[BoxSource], BoxSource],
) -> OpenedRun:
    """The opened inputs of a run; an unusable input raises its error.

    `detector`, `tracker` and `rig` replace the settings' choices; `report` is called with the name
    of each task of the opening; `boxes` returns the source that is used in place of the detector.
    """

    def progress(task: str) -> AbstractContextManager[Callable[[int, int | None], None]]:
        report(task)
        return step_progress(console, task)

    # cars of one region show the focal length better than of any
    shapes = load_curves(settings.curves, "europe")
    start_s = time.perf_counter()
    recording = open_input(settings, progress, rig)
    alignment = recording.calibration.alignment
    opening_s = time.perf_counter() - start_s - (alignment.estimation_s if alignment else 0.0)
    with ExitStack() as on_error:
        on_error.callback(recording.close)
        places = parsed_places(settings.count_line, settings.zone)
        check_inside(places, recording.calibration.rectifier.recorded_size_px)
        report(LOADING)
        box_source = _box_source(settings, recording, detector, open_detector, console, boxes)
        again = partial(open_input, settings, rig=rig)
        recording = _with_mounting(recording, settings, again)
        mounting = recording.opened.view_mounting(settings.mounting)
        setting = OFF if settings.static_camera else settings.ego_speed
        speed = open_speed(setting, recording, mounting, settings.speed_signal)
        if detector is None:  # an object may depend on the order of the frames
            # the pre-pass knows cameras that look ahead
            given = speed.ego if looks_ahead(mounting) else None
            recording, box_source = _with_estimate(
                recording, settings, box_source, shapes, progress, given
            )
        if box_source.fixed_parts is not None:
            box_source = replace(box_source, fixed_parts=shown_fixed_parts(recording, again))
        calibration = recording.calibration
        truth = _truth(settings, recording)
        region = settings.region or _region_of(speed.track)
        # frames at the pace of a camera do not wait, and are not the same in another run
        is_live = recording.live is not None or settings.realtime
        if is_live:
            warm_up(settings, is_pair=calibration.rig is not None)
        pipeline = open_pipeline(
            settings,
            calibration,
            box_source,
            region=region,
            tracker=tracker,
            speed=SpeedInput(speed.ego, settings.ego_speed == AUTO),
            needs_candidates=settings.anonymize,
            background=beside_steps() if is_live else None,
        )
        _use_known_distances(settings, pipeline, calibration.rig)
        on_error.pop_all()
    return OpenedRun(
        settings=settings,
        recording=recording,
        box_source=box_source,
        truth=truth,
        speed=speed,
        region=region,
        pipeline=pipeline,
        opening_s=opening_s,
    )


def _use_known_distances(
    settings: RunSettings, pipeline: FramePipeline, rig: StereoRig | None
) -> None:
    """The known distances as evidence of the posterior of a pair without a calibration."""
    check = pipeline.doubting.check
    if check is not None and rig is not None and rig.is_assumed:
        check.use(_known_distances(settings))


def _truth(settings: RunSettings, recording: Recording) -> Truth | None:
    """The ground truth of the settings, whose clock is known; None = not given."""
    if settings.truth is None:
        return None
    calibration = recording.calibration
    shift_m, choices = calibration.left_from_reference_m, settings.truth_choices
    truth = read_truth(settings.truth, calibration.camera, shift_m, choices)
    if truth.targets is not None:
        truth.targets.check_clock(has_utc=recording.utc is not None)
    return truth


def _box_source(
    settings: RunSettings,
    recording: Recording,
    detector: ObjectDetector | None,
    open_detector: Callable[[Path, DetectorOptions], YoloDetector],
    console: Console,
    boxes: Callable[[BoxSource], BoxSource],
) -> BoxSource:
    """The boxes of a detector, None = as the settings choose, outside of ignored regions."""
    if detector is None:
        models = partial(ready_model, console=console)
        source = open_box_source(settings, recording, models, open_detector)
    else:
        source = boxes_of(detector)
    if settings.static_camera:  # nothing moves but the road users
        source = replace(source, fixed_parts=None)
    return outside_regions(boxes(source), settings.ignore, recording.calibration)


def _with_mounting(
    recording: Recording, settings: RunSettings, reopen: Callable[[], Recording]
) -> Recording:
    """The recording with the mounting that the motion of a drive shows, if it is one."""
    if settings.static_camera:
        return recording
    return with_mounting(recording, settings.mounting, reopen)


def _with_estimate(
    recording: Recording,
    settings: RunSettings,
    boxes: BoxSource,
    shapes: SizeModel,
    progress: StepProgress,
    speed: EgoSpeed | None,
) -> tuple[Recording, BoxSource]:
    """The recording with its unknown focal length and distortion estimated from its images, unless
    it is live, and the source of its boxes.
    """
    if not recording.calibration.guesses or recording.live is not None:
        return recording, boxes
    known = KnownMeasurements(objects=known_metres(settings.known_distance, (), ()))
    detect, remaining = remembered(boxes)
    pre_pass = PrePass(detect=detect, sizes=shapes, known=known, progress=progress)
    estimate = pre_pass.camera_of([DriveVideo.of_recording(recording, speed)]).estimate
    # rectified and undistorted images are others; all candidates belong to the latest detection
    is_same = recording.pair is None and not estimate.distortion and not settings.anonymize
    return recording.with_camera(estimate), remaining if is_same else boxes


def _known_distances(settings: RunSettings) -> KnownDistances:
    """The known distances of the settings as evidence of the scale of a pair."""
    return KnownDistances(
        [
            KnownDistance(one.time_s, one.xyxy_px, one.distance_m)
            for one in known_metres(settings.known_distance, (), ())
        ]
    )


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
