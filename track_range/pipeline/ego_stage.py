"""EgoStage: motion of the camera and the road in one frame, from telemetry or from the images."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import NamedTuple

from track_range.foundation.arrays import FloatArray
from track_range.pipeline.stage_clock import StageClock
from track_range.ranging.ego_speed import EgoSpeed
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.camera_height import CameraHeight
from track_range.stereo.odometry.ego_motion import CameraStep, EgoMotion, Odometry
from track_range.stereo.odometry.ground_odometry import GroundOdometry
from track_range.stereo.odometry.image_motion import ImageMotionEstimator
from track_range.stereo.odometry.road_horizon import RoadView


class Ego(NamedTuple):
    """What a frame shows of the camera's own motion."""

    motion: EgoMotion  # speed and yaw rate, NaN = unknown
    road: RoadView | None = None  # the road in the frame, lengths in metres; None = unknown
    step: CameraStep | None = None  # motion of the camera since the previous frame; None = unknown


@dataclass(slots=True, kw_only=True)
class EgoStage:
    """Measures `Ego` frame by frame."""

    speed: EgoSpeed | None = None  # speed of the camera from telemetry or a setting; None = unknown
    odometry: Odometry | None = None  # measures the motion of the camera, where `speed` is None; None = off
    # measures the horizon of the road and the yaw rate of the camera; None = off
    road_motion: GroundOdometry | None = None
    # measures the camera height from a known speed; None = it is known, or no speed is
    camera_height: CameraHeight | None = None
    # yaw rate of the camera, for the path of the ego vehicle, without `road_motion`; None = unknown
    image_motion: ImageMotionEstimator | None = None

    def update(self, frame: Frame, xyxy_px: FloatArray, clock: StageClock, known: EgoMotion | None = None) -> Ego:
        """The motion to the next frame; frames must be passed in order.

        Args:
            frame: the images.
            xyxy_px: (N, 4) boxes of road users, which are not static.
            clock: takes the time of what is measured from the images.
            known: speed of the camera that is known for this frame only; None = as the stage measures it.
        """
        uses_images = not (self.road_motion is None and self.odometry is None and self.image_motion is None)
        with clock.stage("motion") if uses_images else nullcontext():
            if self.road_motion is not None:
                self.road_motion.update(frame, xyxy_px)
            motion = self._motion(frame, xyxy_px, known)
        road = self.road_motion
        if road is None or not road.has_horizon:
            return Ego(motion)
        view = road.view
        if self.camera_height is not None:
            self.camera_height.update(frame.time_s, motion, road.ego)
            if (height_m := self.camera_height.height_m) is not None:
                view = replace(view.scaled(height_m[0] / road.height_m), height_m=height_m)
        return Ego(motion, view, road.step(motion))

    def _motion(self, frame: Frame, xyxy_px: FloatArray, known: EgoMotion | None) -> EgoMotion:
        """Speed and yaw rate of the camera, NaN = unknown."""
        if self.odometry is not None:
            measured = self.odometry.update(frame, xyxy_px)
            if known is None:
                return measured
            return replace(known, yaw_rad_s=measured.yaw_rad_s, is_still=measured.is_still)
        motion = known or EgoMotion()
        if known is None and self.speed is not None:
            motion = EgoMotion(self.speed.at(frame.time_s), self.speed.sigma_at(frame.time_s))
        if self.road_motion is not None:
            return replace(motion, yaw_rad_s=self.road_motion.motion.yaw_rad_s)
        if self.image_motion is not None:
            yaw_rad_s = self.image_motion.update(frame.left, frame.time_s, xyxy_px).yaw_rad_s
            return replace(motion, yaw_rad_s=yaw_rad_s)
        return motion
