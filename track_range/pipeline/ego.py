"""EgoStage: the motion of the camera and the road, from given speeds and from the images."""

import math
from dataclasses import dataclass, replace

from track_range.foundation.arrays import FloatArray
from track_range.ranging.measurement.rig_scale import CALIBRATED, RigScale
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.camera_height import CameraHeight
from track_range.stereo.odometry.ego_motion import (
    Ego,
    EgoMotion,
    PairOdometry,
    predicted_sigma_mps,
)
from track_range.stereo.odometry.ego_speed import EgoSpeed
from track_range.stereo.odometry.ground_odometry import GroundOdometry
from track_range.stereo.odometry.image_motion import ImageMotionEstimator
from track_range.stereo.odometry.road_horizon import RoadView

# longest time without a measurement for which a measured speed is predicted
_MAX_PREDICTED_S = 1.0


@dataclass(slots=True, kw_only=True)
class EgoStage:
    """Measures `Ego` frame by frame; None = that source is off."""

    speed: EgoSpeed | None = None  # of the camera, from telemetry or a setting
    pair_odometry: PairOdometry | None = None  # by the static scene in both images
    road_motion: GroundOdometry | None = None  # horizon of the road, and yaw rate and speed
    # whether the speed of `road_motion` is used: the height of the camera is known
    has_road_scale: bool = False
    camera_height: CameraHeight | None = None  # from a known speed, where it is not given
    image_motion: ImageMotionEstimator | None = None  # yaw rate without `road_motion`
    # motion in the last frame that was measured, and its time
    _last: tuple[float, EgoMotion] = (math.nan, EgoMotion())

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

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        return () if self.pair_odometry is None else self.pair_odometry.notes

    def update(
        self,
        frame: Frame,
        xyxy_px: FloatArray,
        known: EgoMotion | None = None,
        *,
        trusts_given: bool = True,
        rig_scale: RigScale = CALIBRATED,
    ) -> Ego:
        """The motion to the next frame, in order; the boxes (N, 4) belong to road users, which are
        not static.

        `known` is a speed of the camera that is known for this frame only; None = as the stage
        measures it. A given speed is used if it is trusted. `rig_scale` corrects what the pair
        measures.
        """
        by_road = None if self.road_motion is None else self.road_motion.update(frame, xyxy_px)
        by_pair = None if self.pair_odometry is None else self.pair_odometry.update(frame, xyxy_px)
        motion = None if by_pair is None else rig_scale.corrected_motion(by_pair)
        if motion is None and self.has_road_scale:
            motion = by_road
        if motion is None:
            motion = EgoMotion(yaw_rad_s=self._yaw_rad_s(frame, xyxy_px))
        self._last = frame.time_s, motion
        given = self._given(frame.time_s, known)
        ego = replace(
            self._ego(motion, given, trusts_given=trusts_given),
            by_pair=by_pair,
            by_road=by_road,
            right_camera=None if self.pair_odometry is None else self.pair_odometry.right_camera,
        )
        if self.road_motion is None or not self.road_motion.has_horizon:
            return ego
        road = self._road_view(self.road_motion, ego, frame.time_s)
        return replace(ego, road=road, step=self.road_motion.step(ego.motion))

    def predicted(
        self, time_s: float, known: EgoMotion | None = None, *, trusts_given: bool = True
    ) -> Ego:
        """The motion at a time whose image shows nothing new: that of the last frame, with a
        growing error, for a short time.
        """
        last_s, last = self._last
        motion = EgoMotion(is_still=last.is_still)
        if time_s - last_s <= _MAX_PREDICTED_S:
            grown_mps = predicted_sigma_mps(time_s - last_s)
            sigma_mps = math.hypot(last.speed_sigma_mps, grown_mps)
            motion = replace(last, speed_sigma_mps=sigma_mps, is_predicted=True)
        return self._ego(motion, self._given(time_s, known), trusts_given=trusts_given)

    @staticmethod
    def _ego(motion: EgoMotion, given: EgoMotion | None, *, trusts_given: bool) -> Ego:
        """The measured motion, with the given speed if there is one and it is trusted."""
        if given is not None and trusts_given:
            motion = replace(given, yaw_rad_s=motion.yaw_rad_s, is_still=motion.is_still)
        return Ego(motion=motion, given=given, trusts_given=trusts_given)

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

    def _given(self, time_s: float, known: EgoMotion | None) -> EgoMotion | None:
        if known is not None or self.speed is None:
            return known
        return EgoMotion(self.speed.at(time_s), self.speed.sigma_at(time_s))

    def _yaw_rad_s(self, frame: Frame, xyxy_px: FloatArray) -> float:
        """Yaw rate of the camera, NaN = unknown."""
        if self.road_motion is not None:
            return self.road_motion.motion.yaw_rad_s
        if self.image_motion is not None:
            return self.image_motion.update(frame.left, frame.time_s, xyxy_px).yaw_rad_s
        return math.nan
