"""Runs of the complete pipeline on the boxes of a real drive, with an empty image.

The tracker returns the true identities. The yaw rate, and where a run measures them from images the
horizon of the road and the speed in units of the camera height, are those of the drive with usual
errors; lane lines are not seen. All other stages are those of a run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from benchmarks.boxes.box_run import YAW_SIGMA_RAD_S, NoClock
from benchmarks.boxes.road_view import RoadView
from benchmarks.boxes.view_scores import RunScores, ScoredRows
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.pipeline.detecting import Detected
from track_range.pipeline.frame_pipeline import FramePipeline
from track_range.pipeline.frame_result import FrameResult
from track_range.recording.cameras.calibration import calibration_of
from track_range.run.box_source import BoxSource
from track_range.run.build import SpeedInput, open_pipeline
from track_range.run.options.settings import PipelineOptions
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.stereo.odometry.ground_odometry import GroundOdometry
from track_range.stereo.odometry.image_motion import ImageMotion, ImageMotionEstimator
from track_range.stereo.odometry.road_horizon import RoadView as RoadGeometry
from track_range.stereo.speed.ego_speed import EgoSpeed
from track_range.tracking.tracks import Tracks

SCORE = 0.9  # confidence of all boxes
EDGE_SIGMA_PX = 0.7  # standard deviation of each edge of the boxes, independent in each frame
# Errors of the pitch and of the roll of the road against the vehicle, as measured on simulated drives:
# with a time constant, and constant ones; a camera that looks aside sees the roll as its pitch
_PITCH_RAD, _ROLL_RAD, _HORIZON_S = (0.003, 0.0015), (0.006, 0.0075), 1.0
_CURVATURE_PER_M = 0.0003  # standard deviation of the curvature of the road, which is not measured
STILL_MPS = 0.05  # speed below which the camera is at rest
_SPEED_ERROR = 0.03  # relative standard deviation of the speed by the motion of the road, constant


class _TrueTracks:
    """A tracker that returns the boxes of the current frame with their identities."""

    def __init__(self) -> None:
        self.current = Tracks.empty()

    def update(self, detections: Detections, time_s: float, image: Image | None) -> Tracks:
        return self.current


class _YawRate(ImageMotionEstimator):
    """The yaw rate of a drive, with noise."""

    def __init__(self, view: RoadView, seed: int) -> None:
        super().__init__(view.camera)
        noise = np.random.default_rng([seed, 33]).normal(0, YAW_SIGMA_RAD_S, len(view.times_s))
        self._times_s, self._rates_rad_s = view.times_s, view.yaw_rate_rad_s + noise

    def update(self, image: Image, time_s: float, xyxy_px: FloatArray | None = None) -> ImageMotion:
        """The motion at a time of the drive."""
        rate_rad_s = float(np.interp(time_s, self._times_s, self._rates_rad_s))
        return ImageMotion(time_s=time_s, yaw_rad_s=rate_rad_s, yaw_sigma_rad_s=YAW_SIGMA_RAD_S)


class _RoadOfDrive(GroundOdometry):
    """The horizon of the plane under the wheels, and the speed in units of the camera height, with
    errors; both as if measured from images.
    """

    def __init__(self, view: RoadView, height_m: float, image_motion: _YawRate, seed: int) -> None:
        axes = view.mounting.travel_from_camera
        super().__init__(view.camera, height_m, travel_from_camera=axes)
        rng = np.random.default_rng([seed, 35])
        times_s, n = view.times_s, len(view.times_s)
        stays = float(np.exp(-np.diff(times_s).mean() / _HORIZON_S))
        yaw_rad = np.radians(view.mounting.yaw_deg)
        parts = np.array([np.cos(yaw_rad), np.sin(yaw_rad)])[:, None] * (_PITCH_RAD, _ROLL_RAD)
        changing_rad, constant_rad = np.hypot(*parts)
        error = np.zeros(n)
        for k, noise in enumerate(rng.normal(0, changing_rad, n)):
            error[k] = stays * error[k - 1] + np.sqrt(1 - stays**2) * noise
        self._errors_rad = error + rng.normal(0, constant_rad)
        self._horizon_variance = float(changing_rad**2 + constant_rad**2)
        in_heights = height_m / (view.mounting.z_m or height_m)
        self._speeds_mps = view.speed_mps * in_heights * (1 + rng.normal(0, _SPEED_ERROR))
        self._up = view.mounting.vehicle_from_camera.T @ np.array([0.0, 0.0, 1.0])
        self._right = view.mounting.vehicle_from_camera.T @ np.array([0.0, -1.0, 0.0])
        self._times_s, self._motion_of = times_s, image_motion

    @property
    def view(self) -> RoadGeometry:
        """The road in the last frame."""
        across, down, along = self._up
        error_rad = float(np.interp(self.motion.time_s, self._times_s, self._errors_rad))
        return RoadGeometry(
            horizon=-along / down + error_rad,
            horizon_variance=self._horizon_variance,
            slope=-across / down,
            across=(float(self._right[0]), float(self._right[2])),
            curvature_variance=_CURVATURE_PER_M**2,
        )

    def update(self, frame: Frame, xyxy_px: FloatArray) -> EgoMotion:
        """Motion since the previous frame."""
        self.motion = self._motion_of.update(frame.left, frame.time_s)
        self.has_horizon = True
        speed_mps = float(np.interp(frame.time_s, self._times_s, self._speeds_mps))
        sigma_mps = max(_SPEED_ERROR * abs(speed_mps), 0.05)
        is_still = abs(speed_mps) < STILL_MPS
        return EgoMotion(speed_mps, sigma_mps, self.motion.yaw_rad_s, is_still)

    def step(self, ego: EgoMotion) -> None:
        """Unknown: it needs the flow of points."""


def run_view(
    view: RoadView,
    *,
    has_speed: bool = True,
    min_share: float = 0.5,
    seed: int = 0,
    **options: Any,
) -> RunScores:
    """The scores of a view, of objects of which `min_share` is visible; `options` are those of
    `PipelineOptions`, and `has_speed` says whether the speed of the vehicle is given.
    """
    calibration = calibration_of(view.camera, ((view.camera.width_px, view.camera.height_px),))
    source = BoxSource(
        detect=lambda frame: Detections.empty(),
        candidates=lambda frame: Detections.empty(),
        description={},
        notes=tuple,
    )
    settings = PipelineOptions(lanes="off", **options)
    tracker = _TrueTracks()
    speed = EgoSpeed(view.times_s, view.speed_mps, "vehicle") if has_speed else None
    stages = open_pipeline(
        settings,
        calibration,
        source,
        region=settings.region or "unknown",
        tracker=tracker,
        speed=SpeedInput(speed),
    )
    stages.clock = NoClock()
    yaw_rate = _YawRate(view, seed)
    stages.ego.image_motion = yaw_rate
    if stages.ego.road_motion is not None:
        height_m = stages.ego.road_motion.height_m
        stages.ego.road_motion = _RoadOfDrive(view, height_m, yaw_rate, seed)
    results = list(_results(stages, tracker, view, seed))
    stages.close()
    rows = _scored(view, results, min_share)
    notes = stages.doubting.notes()
    return RunScores.of_run(rows, results, path_m=view.path_m, ego_mps=view.axial_mps, notes=notes)


def _results(
    stages: FramePipeline, tracker: _TrueTracks, view: RoadView, seed: int
) -> Iterator[FrameResult]:
    rng = np.random.default_rng([seed, 34])
    image = np.zeros((view.camera.height_px, view.camera.width_px, 3), np.uint8)
    edge = np.array([view.camera.width_px - 1, view.camera.height_px - 1] * 2, np.float64)
    for index, time_s in enumerate(view.times_s.tolist()):
        rows = np.flatnonzero(view.rows.frame == index)
        exact_px = view.rows.xyxy_px[rows]
        noisy_px = np.clip(exact_px + rng.normal(0, EDGE_SIGMA_PX, exact_px.shape), 0, edge)
        is_at_border = (exact_px <= 0) | (exact_px >= edge)
        boxes = np.where(is_at_border, exact_px, noisy_px)
        class_id = _class_ids(view, rows)
        score, n = np.full(len(rows), SCORE), len(rows)
        tracker.current = Tracks(
            view.rows.track_id[rows], boxes, class_id, score, np.ones(n, np.bool_)
        )
        detections = Detections(boxes, score, class_id, np.zeros((n, 0), np.float32))
        yield stages.step(Detected(Frame(index, time_s, image, None), None, detections))


def _class_ids(view: RoadView, rows: IntArray) -> IntArray:
    names = view.rows.class_name[rows].tolist()
    return np.array([ROAD_CLASSES.index(name) for name in names], np.int64)


def _scored(view: RoadView, results: Sequence[FrameResult], min_share: float) -> ScoredRows:
    rows, n = view.rows, len(view.rows.frame)
    names = {name for result in results for name in result.ranges}
    ranges = {name: (np.full(n, np.nan), np.full(n, np.nan)) for name in names}
    speed_mps, sigma_mps, state = np.full((3, n), np.nan)
    for index, result in enumerate(results):
        at = np.flatnonzero(rows.frame == index)
        if not np.array_equal(rows.track_id[at], result.tracks.track_id):
            raise ValueError(f"frame {index}: expected the boxes of the view as tracks")
        for name, part in result.ranges.items():
            ranges[name][0][at], ranges[name][1][at] = part.distance_m, part.sigma_m
        motion = result.motion
        speed_mps[at], sigma_mps[at] = motion.speed_mps, motion.speed_sigma_mps
        state[at] = motion.state
    is_visible = rows.visible_share >= min_share
    return ScoredRows(
        track_id=rows.track_id,
        class_name=rows.class_name,
        true_m=np.where(is_visible & ~rows.is_cut, rows.true_m, np.nan),
        has_motion=is_visible,
        velocity_mps=rows.velocity_mps,
        ranges=ranges,
        speed_mps=speed_mps,
        speed_sigma_mps=sigma_mps,
        state=state,
    )
