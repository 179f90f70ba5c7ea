"""EgoStage: the motion of the camera and the road, from given speeds and from the images."""

import math
from dataclasses import dataclass, field, replace
from typing import Any

from track_range.foundation.arrays import FloatArray
from track_range.ranging.measurement.focal_scale import EXACT, FocalScale
from track_range.ranging.size_models.drive_scale import DriveScale
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.mounting import Mounting, looks_ahead
from track_range.stereo.odometry.ego_motion import (
    PREDICTED_NOISE,
    Ego,
    EgoMotion,
    PairOdometry,
)
from track_range.stereo.odometry.ground_odometry import GroundOdometry
from track_range.stereo.odometry.image_motion import ImageMotionEstimator
from track_range.stereo.odometry.speed_filter import MAX_PREDICTED_S
from track_range.stereo.speed.ego_speed import EgoSpeed
from track_range.stereo.speed.given_speed import GivenSpeed

# of the speed of the road with a height that is not given, for notes
_BY_SIZES = "with an estimated height of the camera"
AT_REST = EgoMotion(0.0, 0.0, 0.0, is_still=True)  # of a camera that stands still
_SLOPES = 0.06  # of the speed by the motion of the road, by slopes, which last for some seconds


@dataclass(slots=True, kw_only=True)
class EgoStage:
    """Measures `Ego` frame by frame; None = that source is off."""

    speed: EgoSpeed | None = None  # of the camera, from telemetry or a setting
    pair_odometry: PairOdometry | None = None  # by the static scene in both images
    # whether the motion by `pair_odometry` is used; if not, it only follows the right camera
    uses_pair_speed: bool = True
    road_motion: GroundOdometry | None = None  # horizon of the road, and yaw rate and speed
    uses_road_speed: bool = False  # whether the speed of `road_motion` is used
    # whether its scale is that of a given height; if not, it comes from the sizes of road users
    has_given_height: bool = False
    # relative standard deviation of a given speed over the measured one, before the drive
    speed_ratio_sigma: float = 1.0
    image_motion: ImageMotionEstimator | None = None  # yaw rate without `road_motion`
    # of the camera in the vehicle whose speed is given; None = it is that along the axis
    mounting: Mounting | None = None
    given_speed: GivenSpeed = field(default_factory=GivenSpeed)  # against that of the images
    # time and motion of the last frame that showed anything, and of the last one with a speed
    _last: tuple[float, EgoMotion] = (math.nan, EgoMotion())
    _known: tuple[float, EgoMotion] = (math.nan, EgoMotion())

    @property
    def speed_source(self) -> str | None:
        """Name of the odometry whose speed is used; None = a given speed, or none."""
        if self.speed is not None:
            return None
        if self.pair_odometry is not None and self.uses_pair_speed:
            return self.pair_odometry.source
        if self.road_motion is not None and self.uses_road_speed:
            source = self.road_motion.source
            return source if self.has_given_height else f"{source}, {_BY_SIZES}"
        return None

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        of_pair = () if self.pair_odometry is None else self.pair_odometry.notes
        of_road = () if self.road_motion is None else self.road_motion.notes
        return (*of_pair, *of_road, *self.given_speed.notes)

    def update(
        self,
        frame: Frame,
        xyxy_px: FloatArray,
        known: EgoMotion | None = None,
        *,
        trusts_given: bool = True,
        scale: DriveScale | None = None,
        has_sure_time: bool = True,
        height_m: tuple[float, float] | None = None,
    ) -> Ego:
        """The motion to the next frame, in order; the boxes (N, 4) belong to road users, which are
        not static.

        `known` is a speed of the camera that is known for this frame only; None = as the stage
        measures it. A given speed is used if it is trusted. `scale` corrects what the pair and the
        road measure, and stretches what is given, None = of given cameras; `height_m` is the height
        of the camera by the drive and its standard deviation, None = as assumed. A given speed is
        not compared with speeds of an unsure time.
        """
        by_road = None if self.road_motion is None else self.road_motion.update(frame, xyxy_px)
        by_pair = None if self.pair_odometry is None else self.pair_odometry.update(frame, xyxy_px)
        if not self.uses_pair_speed:
            by_pair = None
        scale = scale or DriveScale()
        motion = None if by_pair is None else scale.rig.corrected_motion(by_pair)
        is_by_sizes, travel = False, self._of_travel(by_road)
        if motion is None and self.uses_road_speed and travel is not None:
            motion = scale.road.corrected_motion(travel)
            is_by_sizes = not self.has_given_height
        if motion is None:
            motion = EgoMotion(yaw_rad_s=self._yaw_rad_s(frame, xyxy_px))
        self._last = frame.time_s, motion
        given = self._given(frame.time_s, known)
        used = given
        if given is not None:
            # speeds by strips beside the vehicle are no check of a given one
            is_checked = has_sure_time and looks_ahead(self.mounting)
            shown = (by_pair, by_road) if is_checked else (None, None)
            used = self._weighed(frame.time_s, given, *shown, scale, known)
            used = scale.focal.stretched(self._of_camera(used, motion.yaw_rad_s))
        ego = Ego(
            motion=self._continued(frame.time_s, motion, used, trusts_given=trusts_given),
            by_pair=by_pair,
            by_road=by_road,
            given=given,
            speed_ratio=None if given is None else self.given_speed.shown_ratio,
            trusts_given=trusts_given,
        )
        if self.pair_odometry is not None:
            ego = replace(
                ego,
                right_camera=self.pair_odometry.right_camera,
                focal_change=self.pair_odometry.focal_change,
            )
        road = self.road_motion
        if road is None or not road.has_horizon:
            return ego
        view = road.view
        if height_m is not None:
            view = replace(view.scaled(height_m[0] / road.height_m), height_m=height_m)
        # static objects that are triangulated with a scale by sizes would repeat the sizes
        is_given = used is not None and trusts_given
        is_measured = is_given or not (is_by_sizes or ego.motion.is_predicted)
        step = road.step(ego.motion if is_measured else EgoMotion())
        return replace(ego, road=view, step=step)

    def _weighed(
        self,
        time_s: float,
        given: EgoMotion,
        by_pair: EgoMotion | None,
        by_road: EgoMotion | None,
        scale: DriveScale,
        known: EgoMotion | None,
    ) -> EgoMotion:
        """The given speed beside the measured one, whose scale has an error."""
        log_ratio, sigma = -scale.focal.log_factor, self.speed_ratio_sigma
        if self.pair_odometry is not None and self.uses_pair_speed:
            measured = by_pair
            log_ratio -= scale.rig.log_factor
            sigma = min(sigma + scale.rig.sigma, 1.0)
        else:
            measured = None if by_road is None else _of_real_road(by_road)
        table = self.speed if known is None else None
        ratio = log_ratio, sigma
        return self.given_speed.update(time_s, given, measured or EgoMotion(), ratio, table=table)

    def predicted(
        self,
        time_s: float,
        known: EgoMotion | None = None,
        *,
        trusts_given: bool = True,
        focal: FocalScale = EXACT,
    ) -> Ego:
        """The motion at a time whose image shows nothing new: that of the last frame, with a
        growing error, for a short time; `focal` stretches what is given.
        """
        last_s, last = self._last
        yaw_rad_s = last.yaw_rad_s if time_s - last_s <= MAX_PREDICTED_S else math.nan
        motion = EgoMotion(yaw_rad_s=yaw_rad_s, is_still=last.is_still)
        given = self._given(time_s, known)
        used = None
        if given is not None:
            used = focal.stretched(self._of_camera(given, last.yaw_rad_s))
        motion = self._continued(time_s, motion, used, trusts_given=trusts_given)
        return Ego(motion=motion, given=given, trusts_given=trusts_given)

    def _continued(
        self, time_s: float, motion: EgoMotion, given: EgoMotion | None, *, trusts_given: bool
    ) -> EgoMotion:
        """The motion, with a given speed if it is known in this frame, and trusted; without any
        speed, with the last known one for a short time.
        """
        if given is not None and trusts_given and math.isfinite(given.speed_mps):
            motion = replace(given, yaw_rad_s=motion.yaw_rad_s, is_still=motion.is_still)
        if math.isfinite(motion.speed_mps):
            if not motion.is_predicted:
                self._known = time_s, motion
            return motion
        known_s, known = self._known
        is_doubted = math.isfinite(known.stretch) and not trusts_given
        if is_doubted or not time_s - known_s <= MAX_PREDICTED_S:  # also without a known speed
            return motion
        grown_mps = PREDICTED_NOISE * math.sqrt(time_s - known_s)
        return replace(
            known,
            speed_sigma_mps=math.hypot(known.speed_sigma_mps, grown_mps),
            yaw_rad_s=motion.yaw_rad_s,
            is_still=motion.is_still,
            is_predicted=True,
        )

    def _of_camera(self, vehicle: EgoMotion, yaw_rad_s: float) -> EgoMotion:
        """The motion of the camera, of that of its vehicle along x, which turns with a yaw rate."""
        if self.mounting is None:
            return vehicle
        velocity_mps = self.mounting.velocity_mps(vehicle.speed_mps, yaw_rad_s)
        return _in_camera(vehicle, velocity_mps, self.mounting.travel_from_camera[2], self.mounting)

    def _of_travel(self, by_road: EgoMotion | None) -> EgoMotion | None:
        """The motion of the camera, of that by the road along the direction of travel."""
        if by_road is None or self.road_motion is None or self.mounting is None:
            return by_road
        travel = self.road_motion.travel
        return _in_camera(by_road, travel * by_road.speed_mps, travel, self.mounting)

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


@dataclass(slots=True, kw_only=True)
class StandingCamera(EgoStage):
    """The motion of a camera that stands still, which asks nothing."""

    def update(self, frame: Frame, xyxy_px: FloatArray, *_: Any, **__: Any) -> Ego:
        """No motion."""
        del frame, xyxy_px
        return Ego(motion=AT_REST)

    def predicted(self, time_s: float, *_: Any, **__: Any) -> Ego:
        """No motion."""
        del time_s
        return Ego(motion=AT_REST)


def _in_camera(
    along: EgoMotion, velocity_mps: FloatArray, travel: FloatArray, mounting: Mounting
) -> EgoMotion:
    """A motion along the drive as one of the camera with a velocity (3,) along its axes; `travel`
    (3,) is the direction of the drive. An error of the angles moves the camera across its motion.
    """
    right_mps, _, forward_mps = velocity_mps.tolist()
    right, _, forward = (along.speed_sigma_mps * travel).tolist()
    angle = math.radians(mounting.sigma_deg)
    return replace(
        along,
        speed_mps=forward_mps,
        speed_sigma_mps=math.hypot(forward, angle * right_mps),
        right_mps=right_mps,
        right_sigma_mps=math.hypot(right, angle * forward_mps),
    )


def _of_real_road(by_road: EgoMotion) -> EgoMotion:
    """A speed by the motion of the road with the error of roads that are not plane."""
    sigma_mps = math.hypot(by_road.speed_sigma_mps, _SLOPES * by_road.speed_mps)
    return replace(by_road, speed_sigma_mps=sigma_mps)
