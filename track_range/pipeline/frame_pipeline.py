"""FramePipeline: from the boxes of a frame to its result; `step` lists the stages in their order."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.stage_clock import StageClock
from track_range.pipeline.stages import Detected, DetectionStage, EgoStage, RangingStage
from track_range.ranging.filtering.distance_filter import DistanceFilters, FilteredRanges
from track_range.ranging.filtering.lateral_motion import LateralFilters, passing_offsets
from track_range.ranging.fusion.fusion import Fusion
from track_range.ranging.ranges import Ranges
from track_range.ranging.registry import methods
from track_range.ranging.size_models.drive_scale import DriveScale
from track_range.ranging.warning.collision_warning import CollisionWarning
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.tracking.registry import checked_tracks
from track_range.tracking.tracker import ObjectTracker
from track_range.tracking.tracks import Tracks

FUSED_NOISE_FRACTION = 0.35  # initial fraction of the fused sigma that is independent between frames


def noise_fractions() -> dict[str, float]:
    """Initial fraction of sigma that is independent between frames, for each distance that is filtered over time.

    The filters adapt it to their innovations. Fusion uses the declared error sources of the methods instead.
    """
    filtered = {method.name: method.noise_fraction for method in methods() if method.is_filtered}
    return {**filtered, "fused": FUSED_NOISE_FRACTION}


@dataclass(slots=True, kw_only=True)
class FramePipeline:
    """The stages of a drive and their state."""

    camera: PinholeCamera  # the left camera, undistorted
    detection: DetectionStage  # boxes and lane lines of a frame
    tracker: ObjectTracker  # assigns identities to boxes
    ranging: RangingStage  # the ranging methods
    ego: EgoStage = field(default_factory=EgoStage)  # motion of the camera and the road
    scale: DriveScale = field(default_factory=DriveScale)  # from the frames so far; used with the next one
    # collision warning; None = neither warnings nor times to collision, since the vehicle does not drive along the
    # camera's axis
    warning: CollisionWarning | None = field(default_factory=CollisionWarning)
    shared_sigma: float = 0.0  # relative error shared by all methods, from an uncalibrated focal length
    notes: tuple[str, ...] = ()  # messages for the user about the parts of the pipeline
    clock: StageClock = field(default_factory=StageClock)  # time spent in each stage
    _fusion: Fusion = field(default_factory=Fusion)
    _filters: DistanceFilters = field(default_factory=lambda: DistanceFilters(noise_fractions()))
    _lateral: LateralFilters = field(init=False)

    def __post_init__(self) -> None:
        self._lateral = LateralFilters(self.camera)

    def detected(self, frame: Frame) -> Detected:
        """The frame with its boxes and lane lines, in the calling thread."""
        prepared = self.detection.prepared(frame, self.clock)
        self.ranging.start(frame)
        return self.detection.detected(prepared, self.clock)

    def step(self, detected: Detected, known_ego: EgoMotion | None = None) -> FrameResult:
        """Result of one frame; frames must be passed in order.

        `known_ego` is a speed of the camera that is known for this frame; None = as the ego stage measures it.
        """
        frame, lanes, detections, candidates = detected
        clock = self.clock
        with clock.stage("track"):
            tracks = checked_tracks(self.tracker, self.tracker.update(detections, frame.time_s, frame.left))
        ego = self.ego.update(frame, detections.xyxy_px, clock, known_ego)
        ranges, evidence = self.ranging.measure(tracks, frame, lanes, ego, self.scale, clock)
        with clock.stage("fuse"):
            self.scale = self.scale.after(evidence, frame.time_s)
            motion = self._fused_motion(frame, tracks, ranges, ego.motion)
            ego_mps, yaw_rad_s = ego.motion.speed_mps, ego.motion.yaw_rad_s
            lateral = self._lateral.update(
                tracks,
                motion.ranges.distance_m,
                frame.time_s,
                distance_sigma_m=np.sqrt(motion.state.P_xx),
                yaw_rad_s=yaw_rad_s,
                own_mps=motion.state.v + ego_mps if math.isfinite(ego_mps) else 0.0,
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
                disparity=self.ranging.disparity,
                lanes=lanes,
                misses=passing_offsets(lateral, motion.ttc_s),
                warnings=None
                if self.warning is None
                else self.warning.update(tracks, motion, lateral, frame.time_s, ego_mps=ego_mps, yaw_rad_s=yaw_rad_s),
                candidates=candidates,
                ego_mps=ego_mps,
                ego_sigma_mps=ego.motion.speed_sigma_mps,
            )

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

    def close(self) -> None:
        """End the threads of the stages; no frame follows."""
        self.ranging.close(self.clock)
