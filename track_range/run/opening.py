"""Opens the inputs of a run: recording, boxes, ground truth, speed, and the pipeline for them."""

import math
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console

from track_range.calibration.drive.drive_video import DriveVideo, every_step
from track_range.calibration.drive.known_metres import KnownMeasurements, known_metres
from track_range.calibration.drive.pre_pass import PrePass
from track_range.detection.detector import ObjectDetector
from track_range.detection.yolo.detector import YoloDetector
from track_range.foundation.progress import StepProgress
from track_range.pipeline.frame_pipeline import FramePipeline
from track_range.ranging.cameras.known_distances import KnownDistance, KnownDistances
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.size_models.region import Region, region_at
from track_range.ranging.size_models.size_model import SizeModel
from track_range.ranging.truth.truth import Truth, read_truth
from track_range.recording.recording import Recording
from track_range.recording.speed_source import AUTO, SpeedSource, open_speed
from track_range.recording.telemetry.tracks.positions import has_position
from track_range.recording.telemetry.tracks.track import TelemetryTrack
from track_range.results.progress_note import LOADING
from track_range.run.box_source import (
    BoxSource,
    boxes_of,
    open_box_source,
    outside_regions,
    remembered,
)
from track_range.run.build import open_input, open_pipeline
from track_range.run.options.opened import DetectorOptions
from track_range.run.options.settings import RunSettings
from track_range.run.progress import step_progress
from track_range.run.ready_model import ready_model
from track_range.stereo.geometry.mounting import AHEAD_DEG, Mounting, looks_ahead
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.self_calibration.mounting_search import MIN_ASIDE_S, PAIR_S, MountingSearch
from track_range.stereo.speed.ego_speed import EgoSpeed
from track_range.tracking.registry import ObjectTracker

_REAR_DEG = 135.0  # angle from which a camera looks to the rear, or a direction is the opposite one
_SURE_SIGMAS = 3.0  # difference from which the images contradict a mounting
_SEARCHED_S = 30.0  # longest part of a recording in which its mounting is searched


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
) -> OpenedRun:
    """The opened inputs of a run; an unusable input raises its error.

    `detector`, `tracker` and `rig` replace the settings' choices; `report` is called with the name
    of each task of the opening.
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
        report(LOADING)
        if detector is None:
            models = partial(ready_model, console=console)
            boxes = open_box_source(settings, recording, models, open_detector)
        else:
            boxes = boxes_of(detector)
        box_source = outside_regions(boxes, settings.ignore, recording.calibration)
        recording = _with_mounting(recording, settings, rig)
        mounting = recording.opened.view_mounting(settings.mounting)
        speed = open_speed(settings.ego_speed, recording, mounting)
        if detector is None:  # an object may depend on the order of the frames
            # the pre-pass knows cameras that look ahead
            given = speed.ego if looks_ahead(mounting) else None
            recording, box_source = _with_estimate(
                recording, settings, box_source, shapes, progress, given
            )
        calibration, path = recording.calibration, settings.truth
        shift_m = calibration.left_from_reference_m
        truth = None if path is None else read_truth(path, calibration.camera, shift_m)
        region = settings.region or _region_of(speed.track)
        pipeline = open_pipeline(
            settings,
            calibration,
            box_source,
            region=region,
            tracker=tracker,
            ego_speed=speed.ego,
            measures_speed=settings.ego_speed == AUTO,
            needs_candidates=settings.anonymize,
        )
        check, rig = pipeline.doubting.check, calibration.rig
        if check is not None and rig is not None and rig.is_assumed:
            check.use(_known_distances(settings))
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


def _with_mounting(recording: Recording, settings: RunSettings, rig: StereoRig | None) -> Recording:
    """The recording of one camera of unknown mounting with the one that its first images show, if
    it does not look along the drive; a note, if they contradict a mounting that is known.
    """
    calibration, n_frames = recording.calibration, recording.n_frames
    known, view_deg = calibration.view_mounting(settings.mounting), calibration.view.yaw_deg
    is_short = n_frames is not None and n_frames < MIN_ASIDE_S * recording.fps
    if is_short or recording.pair is not None or recording.live is not None:
        return recording
    shown = _shown_mounting(recording, settings, rig)
    if shown is None or (shown.is_ahead if known is None else not _contradicts(shown, known)):
        return recording
    apart_deg = shown.apart_deg(known or Mounting())
    cause = " (or the vehicle reverses)" if apart_deg > _REAR_DEG else ""
    doubt = (
        ""
        if known is None
        else f" Its mounting, which is used, states {_direction(known)}: check it, and its sign "
        "(yaw is positive to the left)."
    )
    yaw_deg = round(shown.turned(-view_deg).yaw_deg)
    note = (
        f"The motion of the images shows that the camera looks {_direction(shown)}{cause}; "
        f"--mount yaw={180 if yaw_deg == -180 else yaw_deg} states it.{doubt}"
    )
    opened = recording.opened
    if known is None:
        opened = replace(opened, mounting=shown, mounting_source="images")
    return replace(recording, opened=replace(opened, file_notes=(*opened.file_notes, note)))


def _shown_mounting(
    recording: Recording, settings: RunSettings, rig: StereoRig | None
) -> Mounting | None:
    """The mounting of the view that the first images of a recording show; None = none."""
    search = MountingSearch(recording.camera, recording.calibration.focal_sigma)
    with closing(open_input(settings, rig=rig)) as again:
        for frame in every_step(PAIR_S, again.frames):
            search.add(frame.left, frame.time_s)
            if search.mounting is not None or frame.time_s > _SEARCHED_S:
                break
    return search.mounting


def _contradicts(shown: Mounting, known: Mounting) -> bool:
    """Whether a mounting is surely and clearly another."""
    return shown.apart_deg(known) > max(
        _SURE_SIGMAS * math.hypot(shown.sigma_deg, known.sigma_deg), AHEAD_DEG
    )


def _direction(mounting: Mounting) -> str:
    degrees, side = abs(round(mounting.yaw_deg)), "left" if mounting.yaw_deg > 0 else "right"
    if degrees == 180:
        return f"to the rear (± {mounting.sigma_deg:.0f} degrees)"
    return f"{degrees} ± {mounting.sigma_deg:.0f} degrees to the {side} of the direction of travel"


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
