"""FramePipeline: from the boxes of a frame to its result; `step` lists the stages in their
order.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from track_range.foundation.errors import named_errors
from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.stages import (
    Detected,
    DetectionStage,
    EgoStage,
    FusionStage,
    RangingStage,
)
from track_range.pipeline.throughput import StageClock
from track_range.ranging.doubt.scale_check import ScaleCheck
from track_range.ranging.doubt.scale_doubt import Cause, ScaleDoubt, causes_of
from track_range.ranging.registry import methods
from track_range.ranging.size_models.drive_scale import DriveScale
from track_range.ranging.warning.collision_warning import CollisionWarning
from track_range.ranging.warning.safety import SafetyMonitor, lane_edges_m
from track_range.ranging.world.ego_path import EgoPath
from track_range.ranging.world.object_motion import ObjectMotions
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.tracking.registry import ObjectTracker, TrackerError, checked_tracks

_GIVEN_SPEED: frozenset[Cause] = frozenset({"speed"})
_OF_ODOMETRY: frozenset[Cause] = frozenset({"baseline", "focal length", "camera height"})


@dataclass(slots=True, kw_only=True)
class FramePipeline:
    """The stages of a drive and their state."""

    camera: PinholeCamera  # the left camera, undistorted
    detection: DetectionStage  # boxes and lane lines of a frame
    tracker: ObjectTracker  # assigns identities to boxes
    ranging: RangingStage  # the ranging methods
    ego: EgoStage = field(default_factory=EgoStage)  # motion of the camera and the road
    # from the frames so far; used with the next one
    scale: DriveScale = field(default_factory=DriveScale)
    # collision warning; None = neither warnings nor times to collision, since the vehicle does not
    # drive along the camera's axis
    warning: CollisionWarning | None = field(default_factory=CollisionWarning)
    scale_check: ScaleCheck | None = None  # of what was given; None = off
    has_visible_boxes: bool = False  # as in `MethodContext`
    shared_sigma: float = 0.0  # relative error shared by all methods, from the calibration
    notes: tuple[str, ...] = ()  # messages for the user about the parts of the pipeline
    clock: StageClock = field(default_factory=StageClock)  # time spent in each stage
    _path: EgoPath = field(default_factory=EgoPath, init=False)
    _motions: ObjectMotions = field(default_factory=ObjectMotions, init=False)
    _safety: SafetyMonitor = field(init=False)
    _fusion: FusionStage = field(init=False)
    # what scales the distances of each method
    _causes: dict[str, frozenset[Cause]] = field(init=False)

    def __post_init__(self) -> None:
        self._fusion = FusionStage(self.camera, has_visible_boxes=self.has_visible_boxes)
        self._safety = SafetyMonitor(None if self.warning is None else self.warning.settings)
        has_rig = self.scale_check is not None and self.scale_check.baseline_m is not None
        self._causes = {
            method.name: causes_of(
                [source.name for source in method.error_sources], has_rig=has_rig
            )
            for method in methods()
        }
        self._causes["fused"] = causes_of(["baseline"] if has_rig else ["horizon"], has_rig=has_rig)

    def detected(self, frame: Frame) -> Detected:
        """The frame with its boxes and lane lines, in the calling thread."""
        prepared = self.detection.prepared(frame, self.clock)
        self.ranging.start(frame)
        return self.detection.detected(prepared, self.clock)

    def step(self, detected: Detected, known_ego: EgoMotion | None = None) -> FrameResult:
        """Result of one frame; frames must be passed in order.

        `known_ego` is a speed of the camera that is known for this frame; None = as the ego stage
        measures it.
        """
        frame, lanes, detections, candidates = detected
        clock = self.clock
        tracker = (
            f"{type(self.tracker).__module__}:{type(self.tracker).__qualname__}, frame "
            f"{frame.index}"
        )
        with (
            clock.stage("track"),
            named_errors(type(self.tracker).__module__, tracker, TrackerError),
        ):
            tracks = checked_tracks(
                self.tracker, self.tracker.update(detections, frame.time_s, frame.left)
            )
        ego = self.ego.update(frame, detections.xyxy_px, clock, known_ego)
        ranges, evidence = self.ranging.measure(tracks, frame, lanes, ego, self.scale, clock)
        with clock.stage("fuse"):
            by_size = next((item.by_size for item in evidence if item.by_size is not None), None)
            if self.scale_check is not None and by_size is not None:
                self.scale_check.update(
                    tracks,
                    by_size,
                    ranges.get("stereo"),
                    time_s=frame.time_s,
                    road=ego.road,
                    lanes=lanes,
                    by_pair=ego.by_pair,
                    by_road=None if self.ego.road_motion is None else self.ego.road_motion.ego,
                    given=ego.given,
                )
            doubt = self.scale_doubt
            self.ego.trusts_speed = doubt is None or [cause for cause, _ in doubt.causes] != [
                "speed"
            ]
            self.scale = DriveScale() if doubt else self.scale.after(evidence, frame.time_s)
            motion, lateral = self._fusion.update(frame, tracks, ranges, ego.motion)
            ego_mps, yaw_rad_s = ego.motion.speed_mps, ego.motion.yaw_rad_s
            ego_sigma_mps = ego.motion.speed_sigma_mps
            if doubt is not None and ego.given is None:  # odometry has the scale of the cameras
                ego_sigma_mps = math.hypot(ego_sigma_mps, doubt.sigma_of(_OF_ODOMETRY) * ego_mps)
            # neither fusion nor filtering reduces what methods have in common; times to collision
            # do not contain it
            unused = frozenset[Cause]() if self.ego.trusts_speed else _GIVEN_SPEED
            in_doubt = {
                name: 0.0 if doubt is None else doubt.sigma_of(of - unused)
                for name, of in self._causes.items()
            }
            for name, measured in ranges.items():
                method = name.removesuffix("_kf")
                shared = math.hypot(self.shared_sigma, in_doubt[method])
                if shared:
                    sigma_m = np.hypot(measured.sigma_m, shared * measured.distance_m)
                    ranges[name] = replace(measured, sigma_m=sigma_m)
                if method == "fused":
                    rate_sigma_mps = np.hypot(motion.rate_sigma_mps, shared * motion.rate_mps)
            moved = replace(ego.motion, speed_sigma_mps=ego_sigma_mps)
            pose = self._path.update(frame.time_s, moved)
            in_world = self._motions.update(
                tracks.track_id,
                tracks.class_id,
                replace(motion, ranges=ranges["fused_kf"]),
                lateral,
                frame.time_s,
                ego=moved,
                pose=pose,
            )
            warnings = safety = None
            if self.warning is not None:
                warnings = self.warning.update(
                    tracks,
                    motion,
                    lateral,
                    frame.time_s,
                    ego_mps=ego_mps,
                    yaw_rad_s=yaw_rad_s,
                    ranges=ranges["fused"],
                )
                if doubt is not None:
                    warnings = replace(warnings, active=np.zeros_like(warnings.active))
                safety = self._safety.update(
                    tracks.track_id,
                    tracks.class_id,
                    frame.time_s,
                    distance_m=motion.ranges.distance_m,
                    closing_mps=-motion.rate_mps,
                    closing_sigma_mps=rate_sigma_mps,
                    ego_mps=ego_mps,
                    warnings=warnings,
                    lane_edges_m=lane_edges_m(lanes, self.camera),
                )
            centre_px = (tracks.xyxy_px[:, :2] + tracks.xyxy_px[:, 2:]) / 2
            return FrameResult(
                frame=frame,
                tracks=tracks,
                ranges=ranges,
                closing_mps=-motion.rate_mps,
                closing_sigma_mps=rate_sigma_mps,
                ttc_s=motion.ttc_s if self.warning is not None else np.full(len(tracks), np.nan),
                ttc_sigma_s=motion.ttc_sigma_s,
                xyz_m=self.camera.rays(centre_px) * ranges["fused"].distance_m[:, None],
                disparity=self.ranging.disparity,
                lanes=lanes,
                warnings=warnings,
                candidates=candidates,
                ego_mps=ego_mps,
                ego_sigma_mps=ego_sigma_mps,
                scale_doubt=doubt,
                motion=in_world,
                ego_pose=pose,
                safety=safety,
            )

    @property
    def scale_doubt(self) -> ScaleDoubt | None:
        """The contradiction between the given values and the drive so far; None if no contradiction
        was found.
        """
        return None if self.scale_check is None else self.scale_check.doubt

    def close(self) -> None:
        """End the threads of the stages; no frame follows."""
        self.ranging.close(self.clock)
