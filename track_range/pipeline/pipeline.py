r"""The pipeline of a run: yields one result per frame; reading, inference and writing overlap in threads.

    reading thread -> lanes thread --> detection thread -> caller's thread -------------------> FrameResult
    decode            lane lines,      network, boxes      track, measure, fuse, filter
                      network's input  \---> background work of rangers ---/

`Pipeline.run` starts the threads; `Pipeline.result` lists the steps for one frame.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import numpy as np

from track_range.detection.detections import Detections
from track_range.detection.lanes.lines import LaneFinder, LaneLines
from track_range.foundation.arrays import FloatArray
from track_range.foundation.prefetch import prefetch
from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.stage_clock import StageClock
from track_range.ranging.ego_speed import EgoSpeed
from track_range.ranging.filtering.collision_course import passing_offsets
from track_range.ranging.filtering.distance_filter import DistanceFilters
from track_range.ranging.filtering.filtered_ranges import FilteredRanges
from track_range.ranging.filtering.lateral_motion import LateralFilters
from track_range.ranging.fusion.fusion import Fusion
from track_range.ranging.method import checked_ranges
from track_range.ranging.ranger import Ranger
from track_range.ranging.ranges import Ranges
from track_range.ranging.registry import methods
from track_range.ranging.warning.collision_warning import CollisionWarning
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.camera_height import CameraHeight
from track_range.stereo.odometry.ego_motion import EgoMotion, Odometry
from track_range.stereo.odometry.ground_odometry import GroundOdometry
from track_range.stereo.odometry.image_motion import ImageMotionEstimator
from track_range.tracking.registry import checked_tracks
from track_range.tracking.tracker import Tracker
from track_range.tracking.tracks import Tracks

FUSED_NOISE_SHARE = 0.35
"""Initial fraction of the fused sigma that is independent between frames, for the distance filter."""

_LANE_INTERVAL_S = 0.09
"""Minimum time in seconds between two detections of lane lines; lanes change slowly, and detection is expensive."""

_T = TypeVar("_T")

Detect = Callable[[], Detections]
"""Returns the boxes of a frame that was prepared."""


def noise_shares() -> dict[str, float]:
    """Initial fraction of sigma that is independent between frames, for each distance that is filtered over time.

    The filters adapt it to their innovations. Fusion uses the declared error sources of the methods instead.
    """
    filtered = {method.name: method.noise_share for method in methods() if method.is_filtered}
    return {**filtered, "fused": FUSED_NOISE_SHARE}


@dataclass(frozen=True, slots=True)
class QueueDepths:
    """Number of frames by which each thread may run ahead of the next one.

    Attributes:
        read: decoded frames that wait for the lane detector.
        lanes: frames with lane lines, in the network's input, that wait for the network.
        detected: frames with boxes that wait for the caller.
    """

    read: int = 4
    lanes: int = 2
    detected: int = 2


LIVE_DEPTHS = QueueDepths(read=1, lanes=1, detected=1)
"""Queue depths for cameras, as short as possible to reduce latency."""


@dataclass(slots=True, kw_only=True)
class Pipeline:
    """Stages of a run and their state.

    Attributes:
        camera: the left camera, undistorted.
        detect: returns the boxes of a frame.
        tracker: assigns identities to boxes.
        prepare: does what `detect` does before the network runs, and returns a function that does the rest; called in
            another thread. None = `detect` does all.
        candidates: returns all boxes of the frame of the latest detection; None = not needed.
        rangers: ranging methods by name, in the order of execution (`registry.create_rangers`).
        lane_finder: detects the lines of the ego lane; None = off.
        ego_speed: speed of the camera from telemetry or a setting; None = unknown.
        odometry: measures the motion of the camera, where `ego_speed` is None; None = off.
        road_motion: measures the horizon of the road and the yaw rate of the camera; None = off.
        camera_height: measures the camera height from a known speed; None = it is known, or no speed is.
        image_motion: yaw rate of the camera, for the path of the ego vehicle, without `road_motion`; None = unknown.
        warning: collision warning; None = neither warnings nor times to collision, since the vehicle does not drive
            along the camera's axis.
        shared_sigma: relative error shared by all methods, from an uncalibrated focal length.
        depths: queue depths of the threads.
        notes: messages for the user about the parts of the pipeline.
        clock: time spent in each stage.
    """

    camera: PinholeCamera
    detect: Callable[[Frame], Detections]
    tracker: Tracker
    rangers: Mapping[str, Ranger]
    prepare: Callable[[Frame], Detect] | None = None
    candidates: Callable[[Frame], Detections] | None = None
    lane_finder: LaneFinder | None = None
    ego_speed: EgoSpeed | None = None
    odometry: Odometry | None = None
    road_motion: GroundOdometry | None = None
    camera_height: CameraHeight | None = None
    image_motion: ImageMotionEstimator | None = None
    warning: CollisionWarning | None = field(default_factory=CollisionWarning)
    shared_sigma: float = 0.0
    depths: QueueDepths = field(default_factory=QueueDepths)
    notes: tuple[str, ...] = ()
    clock: StageClock = field(default_factory=StageClock)
    _fusion: Fusion = field(default_factory=Fusion)
    _filters: DistanceFilters = field(default_factory=lambda: DistanceFilters(noise_shares()))
    _reads: dict[str, tuple[str, ...]] = field(
        default_factory=lambda: {method.name: method.reads for method in methods()}
    )
    _lanes: LaneLines | None = None
    _lateral: LateralFilters = field(init=False)

    def __post_init__(self) -> None:
        self._lateral = LateralFilters(self.camera)

    def run(self, frames: Iterable[Frame]) -> Generator[FrameResult, None, None]:
        """Results of the frames in order; closing the generator ends the threads."""
        with ExitStack() as stack:
            # closed in reverse order: the last thread first, so that no thread reads from a closed video; rangers last
            stack.callback(self._close_rangers)

            def in_thread(items: Iterable[_T], depth: int, name: str, *, low_priority: bool) -> Iterable[_T]:
                thread = prefetch(items, depth=depth, low_priority=low_priority, name=name)
                return stack.enter_context(closing(thread))

            depth = self.depths.read
            if self.lane_finder is not None:
                frames, depth = in_thread(frames, depth, "read", low_priority=True), self.depths.lanes
            prepared = in_thread(self._prepared(frames), depth, "prepare", low_priority=True)
            for frame, lanes, detections, candidates in in_thread(
                self._with_detections(prepared), self.depths.detected, "detect", low_priority=False
            ):
                yield self.result(frame, lanes, detections, candidates)

    def result(
        self, frame: Frame, lanes: LaneLines | None, detections: Detections, candidates: Detections | None = None
    ) -> FrameResult:
        """Result of one frame from its lane lines and boxes; frames must be passed in order."""
        tracks = self._tracks(frame, detections)
        ego = self._ego_motion(frame, detections)
        self._update_motion(frame, ego)
        ranges = self._ranges(frame, lanes, tracks)
        ego_mps, yaw_rad_s = ego.speed_mps, ego.yaw_rad_s
        with self.clock.stage("fuse"):
            motion = self._fused_motion(frame, tracks, ranges, ego)
            own_mps = motion.state.v + ego_mps if math.isfinite(ego_mps) else 0.0
            lateral = self._lateral.update(
                tracks,
                motion.ranges.distance_m,
                frame.time_s,
                distance_sigma_m=np.sqrt(motion.state.P_xx),
                yaw_rad_s=yaw_rad_s,
                own_mps=own_mps,
            )
            return FrameResult(
                frame=frame,
                tracks=tracks,
                ranges=self._with_shared_error(ranges),
                closing_mps=-motion.rate_mps,
                closing_sigma_mps=motion.rate_sigma_mps,
                ttc_s=motion.ttc_s if self.warning is not None else np.full(len(tracks), np.nan),
                ttc_sigma_s=motion.ttc_sigma_s,
                xyz_m=self._points_m(tracks, ranges["fused"].distance_m),
                disparity=next(
                    (ranger.disparity for ranger in self.rangers.values() if ranger.disparity is not None), None
                ),
                lanes=lanes,
                misses=passing_offsets(lateral, motion.ttc_s),
                warnings=None
                if self.warning is None
                else self.warning.update(tracks, motion, lateral, frame.time_s, ego_mps=ego_mps, yaw_rad_s=yaw_rad_s),
                candidates=candidates,
                ego_mps=ego_mps,
                ego_sigma_mps=ego.speed_sigma_mps,
            )

    def _prepared(self, frames: Iterable[Frame]) -> Iterator[tuple[Frame, LaneLines | None, Detect]]:
        """Frames in the network's input, with the lane lines, which are detected about ten times per second.

        The last lane lines are used in between.
        """
        lanes, due_s = None, -math.inf
        for frame in frames:
            if self.lane_finder is not None and frame.time_s >= due_s:
                with self.clock.stage("lanes"):
                    lanes = self.lane_finder.find(frame.left, frame.time_s)
                due_s = frame.time_s + _LANE_INTERVAL_S
            start_s = time.thread_time()
            detect = partial(self.detect, frame) if self.prepare is None else self.prepare(frame)
            self.clock.add("detect", time.thread_time() - start_s)
            yield frame, lanes, detect

    def _with_detections(
        self, frames: Iterable[tuple[Frame, LaneLines | None, Detect]]
    ) -> Iterator[tuple[Frame, LaneLines | None, Detections, Detections | None]]:
        """Frames with their boxes; rangers that work in the background are started before the detector."""
        for frame, lanes, detect in frames:
            for ranger in self.rangers.values():
                ranger.start(frame)
            with self.clock.stage("detect"):
                detections = detect()
                candidates = None if self.candidates is None else self.candidates(frame)
            yield frame, lanes, detections, candidates

    def _tracks(self, frame: Frame, detections: Detections) -> Tracks:
        with self.clock.stage("track"):
            return checked_tracks(self.tracker, self.tracker.update(detections, frame.time_s, frame.left))

    def _ranges(self, frame: Frame, lanes: LaneLines | None, tracks: Tracks) -> dict[str, Ranges]:
        """Distances of the tracks by method.

        Raises:
            MethodError: a ranger of another package did not return ranges of these tracks.
        """
        ranges: dict[str, Ranges] = {}
        for name, ranger in self.rangers.items():
            others = {other: ranges[other] for other in self._reads.get(name, ()) if other in ranges}
            with self.clock.stage(name):
                if lanes is not None and lanes is not self._lanes:
                    ranger.update_lanes(lanes)
                ranges[name] = checked_ranges(name, ranger.measure_with(tracks, frame, others), tracks)
        self._lanes = lanes
        return ranges

    def _ego_motion(self, frame: Frame, detections: Detections) -> EgoMotion:
        """Speed and yaw rate of the camera, NaN = unknown."""
        if self.road_motion is not None:
            with self.clock.stage("motion"):
                self.road_motion.update(frame, detections.xyxy_px)
        if self.odometry is not None:
            with self.clock.stage("motion"):
                return self.odometry.update(frame, detections.xyxy_px)
        speed, yaw_rad_s = self.ego_speed, self._yaw_rad_s(frame, detections)
        if speed is None:
            return EgoMotion(yaw_rad_s=yaw_rad_s)
        return EgoMotion(speed.at(frame.time_s), speed.sigma_at(frame.time_s), yaw_rad_s)

    def _update_motion(self, frame: Frame, ego: EgoMotion) -> None:
        """Pass the road and the motion of the camera that the images show to the rangers."""
        if self.road_motion is None or not self.road_motion.has_horizon:
            return
        step, road = self.road_motion.step(ego), self.road_motion.view
        if self.camera_height is not None:
            self.camera_height.update(frame.time_s, ego, self.road_motion.ego)
            if (height_m := self.camera_height.height_m) is not None:
                road = replace(road.scaled(height_m[0] / self.road_motion.height_m), height_m=height_m)
        for ranger in self.rangers.values():
            ranger.update_road(road)
            if step is not None:
                ranger.update_motion(step)

    def _yaw_rad_s(self, frame: Frame, detections: Detections) -> float:
        """Yaw rate of the camera, positive = to the right; NaN = unknown."""
        if self.road_motion is not None:
            return self.road_motion.motion.yaw_rad_s
        if self.image_motion is None:
            return math.nan
        with self.clock.stage("motion"):
            return self.image_motion.update(frame.left, frame.time_s, detections.xyxy_px).yaw_rad_s

    def _fused_motion(self, frame: Frame, tracks: Tracks, ranges: dict[str, Ranges], ego: EgoMotion) -> FilteredRanges:
        """Filtered fused distance and speed of the tracks; adds the fused and filtered distances to `ranges`."""
        fused = self._fusion.fuse(ranges, tracks.track_id, frame.time_s)
        ranges["fused"] = fused.ranges
        filtered = self._filters.update(
            ranges,
            frame.time_s,
            conditions={"fused": fused.condition},
            ego_speed_mps=ego.speed_mps,
            ego_sigma_mps=ego.speed_sigma_mps,
        )
        ranges |= {f"{name}_kf": state.ranges for name, state in filtered.items()}
        motion = filtered["fused"]
        if not self.shared_sigma:
            return motion
        # A scale error affects speeds by the same factor, but not times to collision.
        rate_sigma_mps = np.hypot(motion.rate_sigma_mps, self.shared_sigma * motion.rate_mps)
        return replace(motion, rate_sigma_mps=rate_sigma_mps)

    def _with_shared_error(self, ranges: Mapping[str, Ranges]) -> Mapping[str, Ranges]:
        """Ranges with sigma increased by the shared error, which neither fusion nor filtering reduces."""
        if not self.shared_sigma:
            return ranges
        return {
            name: replace(measured, sigma_m=np.hypot(measured.sigma_m, self.shared_sigma * measured.distance_m))
            for name, measured in ranges.items()
        }

    def _points_m(self, tracks: Tracks, distance_m: FloatArray) -> FloatArray:
        """(N, 3) points in metres at the given depths on the rays through the box centres."""
        centre_px = (tracks.xyxy_px[:, :2] + tracks.xyxy_px[:, 2:]) / 2
        return self.camera.rays(centre_px) * distance_m[:, None]

    def _close_rangers(self) -> None:
        for name, ranger in self.rangers.items():
            ranger.close()
            self.clock.add(name, ranger.background_s)
