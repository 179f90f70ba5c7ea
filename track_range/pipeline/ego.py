"""EgoStage: the motion of the camera and the road, from given speeds and from the images."""

import math
from dataclasses import dataclass, replace

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.camera_height import CameraHeight
from track_range.stereo.odometry.ego_motion import Ego, EgoMotion, Odometry
from track_range.stereo.odometry.ego_speed import EgoSpeed
from track_range.stereo.odometry.ground_odometry import GroundOdometry
from track_range.stereo.odometry.image_motion import ImageMotionEstimator
from track_range.stereo.odometry.road_horizon import RoadView


@dataclass(slots=True, kw_only=True)
class EgoStage:
    """Measures `Ego` frame by frame; None = that source is off."""

    speed: EgoSpeed | None = None  # of the camera, from telemetry or a setting
    pair_odometry: Odometry | None = None  # by the static scene in both images
    road_motion: GroundOdometry | None = None  # horizon of the road, and yaw rate and speed
    # whether the speed of `road_motion` is used: the height of the camera is known
    has_road_scale: bool = False
    camera_height: CameraHeight | None = None  # from a known speed, where it is not given
    image_motion: ImageMotionEstimator | None = None  # yaw rate without `road_motion`

    @property
    def speed_source(self) -> str | None:
        """Name of the odometry whose speed is used; None = a given speed, or none."""
        if self.speed is not None:
            return None
        if self.pair_odometry is not None:
            return self.pair_odometry.source
        if self.road_motion is not None and self.has_road_scale:
            return self.road_motion.source
        return None

    def update(
        self,
        frame: Frame,
        xyxy_px: FloatArray,
        known: EgoMotion | None = None,
        *,
        trusts_given: bool = True,
    ) -> Ego:
        """The motion to the next frame, in order; the boxes (N, 4) belong to road users, which are
        not static.

        `known` is a speed of the camera that is known for this frame only; None = as the stage
        measures it. A given speed is used if it is trusted.
        """
        given = self._given(frame.time_s) if known is None else known
        by_road = None if self.road_motion is None else self.road_motion.update(frame, xyxy_px)
        by_pair = None if self.pair_odometry is None else self.pair_odometry.update(frame, xyxy_px)
        motion = by_pair
        if motion is None and self.has_road_scale:
            motion = by_road
        if motion is None:
            motion = EgoMotion(yaw_rad_s=self._yaw_rad_s(frame, xyxy_px))
        if given is not None and trusts_given:
            motion = replace(given, yaw_rad_s=motion.yaw_rad_s, is_still=motion.is_still)
        ego = Ego(
            motion=motion,
            by_pair=by_pair,
            by_road=by_road,
            given=given,
            trusts_given=trusts_given,
        )
        if self.road_motion is None or not self.road_motion.has_horizon:
            return ego
        road = self._road_view(self.road_motion, ego, frame.time_s)
        return replace(ego, road=road, step=self.road_motion.step(motion))

    def _road_view(self, road: GroundOdometry, ego: Ego, time_s: float) -> RoadView:
        """The road in metres; in units of the assumed camera height until the speed shows the
        height.
        """
        is_in_doubt = ego.given is not None and not ego.trusts_given
        if self.camera_height is None or is_in_doubt:
            return road.view
        self.camera_height.update(time_s, ego.motion, road.ego)
        height_m = self.camera_height.height_m
        if height_m is None:
            return road.view
        return replace(road.view.scaled(height_m[0] / road.height_m), height_m=height_m)

    def _given(self, time_s: float) -> EgoMotion | None:
        if self.speed is None:
            return None
        return EgoMotion(self.speed.at(time_s), self.speed.sigma_at(time_s))

    def _yaw_rad_s(self, frame: Frame, xyxy_px: FloatArray) -> float:
        """Yaw rate of the camera, NaN = unknown."""
        if self.road_motion is not None:
            return self.road_motion.motion.yaw_rad_s
        if self.image_motion is not None:
            return self.image_motion.update(frame.left, frame.time_s, xyxy_px).yaw_rad_s
        return math.nan
