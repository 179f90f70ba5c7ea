r"""GroundOdometry: speed of one camera in units of its height above the road, and the horizon, one
frame after another.

The road is resampled on a grid of X and Z as seen from above, in the previous frame and in this one,
with the rotation between them removed. Driving s metres then shifts the picture along Z:

    now(X, Z - s) = before(X, Z)        pixel of (X, Z): pi(R C [X, h, Z])

C is the rotation from a level frame, which looks along the direction of travel, to the camera's
frame; R is the rotation from frame to frame (`ImageMotion`). A car drives parallel to the road, so
the horizon of the road ahead has the row of the epipole. `RoadHorizon` filters this row. A camera
that looks ahead shows the lane of the car; one that looks aside shows strips beside it, each in a
picture.

The pictures are divided into strips. The shift is the maximum of their mean normalised correlation;
strips under boxes of road users or without texture do not count. The speed is unknown if the
maximum is low or not unique. A horizon in a wrong row makes distant parts of the road shift more,
or less, than near parts: if the horizon is taken to be d rad too low, a point at distance Z seems
to be at Z + d Z^2 / h, and a shift s with its middle at Z becomes s (1 + 2 Z d / h). So the slope
of the shifts over the distances measures the horizon, whatever the height. If the roll is taken to be
r rad too large, so that the road seems too high on the right, it becomes s (1 + (2 Z d - X r) / h).

An error of the camera height is an equal relative error of the speed. The road is taken to be plane
up to 15 m.
"""

import math
from collections import deque
from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32, Image, check_shape
from track_range.foundation.sparse_flow import DETECTION_INTERVAL_S, BackgroundFlow, small_grey
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.ego_motion import CameraStep, EgoMotion
from track_range.stereo.odometry.image_motion import ImageMotion, ImageMotionEstimator
from track_range.stereo.odometry.road_horizon import RoadHorizon, RoadView
from track_range.stereo.odometry.scene_depth import SceneDepth
from track_range.stereo.odometry.speed_filter import SpeedFilter
from track_range.stereo.odometry.travel_direction import TravelDirection

# The picture from above, and the search of the shift:
_HALF_WIDTH_M = 1.5  # half the width of the picture
_NEAREST_M = 4.5  # nearest road in the picture, if the image shows it
_FARTHEST_M = 15.0  # farthest road in the picture, if it is long enough
# length of the picture to aim at, and of the road that a pixel may cover in it
_MIN_LENGTH_M, _MAX_PIXEL_M = 8.0, 0.25
_STEP_X_M, _STEP_Z_M = 0.15, 0.1  # size of a cell of the picture
# Lanes beside the vehicle, for cameras that do not show the road ahead: nearest and farthest edges,
# width, shortest one, and number. The nearest lanes are the most likely ones to be road, and in the
# plane under the wheels; if the height is assumed too small, a third one reaches a wall.
_BESIDE_M, _BESIDE_WIDTH_M, _MIN_BESIDE_M, _MOST_BESIDE = (0.5, 8.0), 1.5, 3.0, 2
# Strips beside the vehicle that agree, for a measurement: parts of a car that no box covers are
# nearer than the road and faster.
_MIN_BESIDE_STRIPS = 6
# standard deviation of their height against the road under the wheels: kerbs are 0.1 to 0.15 m high
_RAISED_M = 0.07
# all Z of pictures, from far to near
_ALL_Z = np.arange(40.0, -40.0, -_STEP_Z_M)
# samples per cell in both directions, of which a cell has the mean: cells near the camera have many
# pixels, of which a single one would be aliased, so that shifts are drawn to whole cells
_N_SAMPLES = 3
_STRIP_M = 2.0  # length of a strip
_N_STRIP = round(_STRIP_M / _STEP_Z_M)  # cells of it
_MIN_DEVIATION2 = 1.0  # smallest sum of squared deviations of a strip that is compared
# distance of the middle of the picture, at which its plane has the slope of the road
_PICTURE_M = 9.0
_MAX_SPEED_MPS = 45.0
# Road travelled between two frames up to which they are compared with one another, and not each with
# the next: above it, the pictures of the road have too little in common (on a motorway, the speed was
# known in 50 and not 70 % of the frames).
_MAX_RARE_M = 1.45
# longest time between the pictures, and the road travelled in it, beyond one frame: a slow camera
# moves by a fraction of a cell from frame to frame
_MAX_SPAN_S, _MAX_SPAN_M = 0.3, 0.5
# smallest standard deviation of a strip in grey levels; below it there is only noise
_MIN_STRIP_GREY = 1.0
_MAX_MASKED_FRACTION = 0.05  # largest fraction of a strip under boxes of road users
# smallest mean correlation of a reliable shift; right ones have 0.63 or more on recordings, wrong
# ones of parked cars beside a camera 0.3 to 0.5
_MIN_CORRELATION = 0.5
_MIN_UNIQUENESS = 0.05  # smallest difference of it from the second best maximum
_MIN_UNIQUE_M = 0.35  # shifts nearer than this to the maximum belong to it
_SHIFT_SIGMA_M = 0.01  # standard deviation of a shift; assumed, a tenth of a cell
# Relative error of all speeds, from a road that is not plane and the camera height; the errors on
# simulated drives, seeds 0-9, then have a standard deviation of 0.6 in units of their sigma.
_SCALE_SIGMA = 0.03

# The horizon from the shifts of the strips:
_MIN_STRIPS = 4  # minimum number of strips for a measurement
_MIN_ROLL_M = 1e-3  # smallest change of the shifts by the roll, m per rad: none in one lane
# largest difference of a strip's shift from the common one: the farthest's, 0.012 rad off, 30 m/s
_MAX_STRIP_CELLS = 6
_MIN_STRIP_CORRELATION = 0.4  # of the strip at its own shift
_STRIP_SIGMA_M = 0.015  # standard deviation of the shift of one strip
# of the horizon by errors that the strips share: 0.0015 to 0.002 on simulated drives
_STRIPS_SIGMA_RAD = 0.0015
# innovation of the horizon in standard deviations above which the shifts are wrong
_OUTLIER_SIGMA = 4.0
_MAX_FRAMES = 50.0  # largest amplification of an error of the rotation, by slow motion

# The direction of travel: Standard deviation of the row of the epipole as a measurement of the
# horizon: 0.002 to 0.005 rad on simulated drives, seeds 0-2, correlated over a second, and the
# camera moves up and down on the springs.
_EPIPOLE_SIGMA_RAD = 0.012
# speed below which errors of the direction of travel grow as 1 / speed: the camera moves up and
# down on the springs as much when a car pulls away or brakes
_FULL_MPS = 10.0
_SURE_RAD = 0.004  # standard deviation of the horizon below which the epipole is expected there
# deviation from it: a camera at 10 m/s moves up and down on the springs by 0.04 m/s
_TRAVEL_SIGMA_RAD = 0.004
_TRAVEL_TIME_S = 1.0  # time constant with which the direction to the side follows the epipole
_MIN_ALONG = 0.7  # cosine between the axis and the drive, of a camera that looks ahead or back
_SLOWEST_MPS = 0.1  # of a camera that is not at rest
_REST_S = 0.5  # time for which near points stay in place, after which an unknown speed is 0
_UNKNOWN_SIGMA = 0.03  # relative standard deviation of a speed without one


def _interval_s(speed_mps: float, frame_s: float) -> float:
    """Shortest time between frames that are compared, at a speed and a time between two frames; NaN
    = unknown.
    """
    if not frame_s > 0:
        return 0.0
    compared_s = frame_s * math.ceil(DETECTION_INTERVAL_S / frame_s)
    is_slow = abs(speed_mps) * compared_s <= _MAX_RARE_M  # False for NaN
    return DETECTION_INTERVAL_S if is_slow else 0.0


class GroundOdometry:
    """Measures the speed of one camera without distortion, and the horizon; the state belongs to
    the instance.

    A wrong `height_m` of the camera above the road only scales the lengths. Other estimators of the
    same stream may use the same `flow` of the background; None = a separate one.
    """

    source = "the motion of the road in the images"

    def __init__(
        self,
        camera: PinholeCamera,
        height_m: float,
        *,
        flow: BackgroundFlow | None = None,
        travel_from_camera: FloatArray | None = None,
    ) -> None:
        """`travel_from_camera` (3, 3) are the axes of travel, right, down and forward, in the
        camera's; None = the camera looks along the drive.
        """
        self._camera, self.height_m = camera, height_m
        self._flow = flow or BackgroundFlow()
        self._travel_from_camera = np.eye(3) if travel_from_camera is None else travel_from_camera
        self._image_motion = ImageMotionEstimator(
            camera, flow=self._flow, travel_from_camera=travel_from_camera
        )
        self._filter = SpeedFilter()
        # beside the road, the depth of the scene changes too much
        self._depth = SceneDepth() if abs(self._travel_from_camera[2, 2]) > _MIN_ALONG else None
        self._horizon = RoadHorizon()
        self._side, self._direction = (
            math.nan,
            TravelDirection(camera, has_mounting=travel_from_camera is not None),
        )
        self._speed_mps = _FULL_MPS
        self._past: deque[_Picture] = deque()  # earlier frames, and at the end the last one
        self._span_s = 0.0  # of the last measurement
        self._still_s = 0.0  # time for which near points have been in place
        self._last = math.nan, EgoMotion()
        self._interval_s = DETECTION_INTERVAL_S  # shortest time between frames that are compared
        self.motion = ImageMotion(time_s=math.nan)  # between the last two frames
        self._step: CameraStep | None = None  # to the last frame that was compared
        self.has_horizon = False  # whether the horizon was measured so far

    @property
    def ego(self) -> EgoMotion:
        """Motion in the last frame, as `update` returned it."""
        return self._last[1]

    @property
    def view(self) -> RoadView:
        """The road in the last frame, in the camera's axes; lengths are in units of the camera
        height of this instance.
        """
        since_s = self._last[0] - self.motion.time_s  # 0 in a frame that was compared
        return self._horizon.seen(self._travel_from_camera, since_s)

    def update(self, frame: Frame, xyxy_px: FloatArray) -> EgoMotion:
        """Motion since the previous frame, with boxes (N, 4) of road users; NaN where it is not
        reliable. At speeds of towns, frames are compared at most 17 times per second: between, it
        is the last one.

        A second call for the same frame returns the same motion.
        """
        check_shape("xyxy_px", xyxy_px, (None, 4))
        if frame.time_s == self._last[0]:
            return self._last[1]
        # the first estimator that adds a frame says whether its corners are detected
        self._flow.add(frame.left, xyxy_px, frame.time_s, interval_s=self._interval_s)
        self.motion = motion = self._image_motion.update(frame.left, frame.time_s, xyxy_px)
        if motion.time_s != frame.time_s:  # that of an earlier frame
            return self._between(frame.time_s)
        now = self._flow.now
        grey = small_grey(frame.left, 0) if now is None else now.grey
        if math.isnan(motion.dt_s) or not self._past:
            self._side, ego = math.nan, EgoMotion()
        else:
            ego = self._moved(motion, _Picture(frame.time_s, grey, xyxy_px, motion.rotation.T))
        turned = (one._replace(rotation=motion.rotation @ one.rotation) for one in self._past)
        self._past = deque(turned if motion.is_known else ())
        self._past.append(_Picture(frame.time_s, grey, xyxy_px, np.eye(3)))
        oldest_s = frame.time_s + 0.5 * motion.dt_s - _MAX_SPAN_S  # in the next frame, rounded
        while len(self._past) > 1 and self._past[0].time_s < oldest_s:
            self._past.popleft()
        before_s, self._last = self._last[0], (frame.time_s, ego)
        self._interval_s = _interval_s(ego.speed_mps, frame.time_s - before_s)
        return ego

    def _between(self, time_s: float) -> EgoMotion:
        """The motion in a frame between two that are compared, with the predicted speed."""
        before_s, ego = self._last
        if math.isfinite(ego.speed_mps):
            speed_mps, sigma_mps = self._filter.at(time_s, time_s - before_s)
            ego = replace(ego, speed_mps=speed_mps, speed_sigma_mps=sigma_mps)
        ego = replace(ego, yaw_rad_s=self.motion.yaw_rad_s)
        self._last = time_s, ego
        return ego

    @property
    def travel(self) -> FloatArray:
        """(3,) unit vector of the direction of travel in the camera's axes in the last frame."""
        side = float(np.nan_to_num(self._side))
        travel = np.array([side, self._horizon.view.horizon, 1.0]) @ self._travel_from_camera
        return np.asarray(travel / np.linalg.norm(travel))

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        return self._direction.notes

    def step(self, ego: EgoMotion) -> CameraStep | None:
        """Motion of the camera to the last frame that was compared, with the speed of `ego` in it;
        None = unknown, or at rest.
        """
        if self.motion.time_s == self._last[0]:
            self._step = self._step_to_now(ego)
        return self._step

    def _step_to_now(self, ego: EgoMotion) -> CameraStep | None:
        """Motion of the camera since the frame that was compared before."""
        motion, now, axes, travel = (
            self.motion,
            self._flow.now,
            self._travel_from_camera,
            self.travel,
        )
        is_known = motion.is_known and not motion.is_still and math.isfinite(ego.speed_mps)
        speed_mps = float(travel @ [ego.right_mps, 0.0, ego.speed_mps])
        if not is_known or now is None or math.isnan(self._side) or speed_mps <= 0:
            return None
        sigma_mps = math.hypot(ego.speed_sigma_mps, ego.right_sigma_mps)
        return CameraStep(
            time_s=motion.time_s,
            dt_s=motion.dt_s,
            rotation=axes.T @ motion.rotation @ axes,
            rotation_sigma_rad=motion.yaw_sigma_rad_s * motion.dt_s,
            travel=travel,
            travelled_m=speed_mps * motion.dt_s,
            travelled_sigma=sigma_mps / speed_mps if sigma_mps >= 0 else _UNKNOWN_SIGMA,
            now=now,
        )

    def _moved(self, motion: ImageMotion, now: "_Picture") -> EgoMotion:
        """The filtered speed; moves the horizon on to this frame."""
        dt_s = motion.dt_s
        is_moving = motion.is_known and not motion.is_still
        side, row = motion.travel
        if is_moving and math.isfinite(side):
            self._follow_side(side, dt_s)
            self._direction.add(dt_s, side, motion.yaw_rad_s)
        self._still_s = self._still_s + dt_s if motion.is_near_still else 0.0
        # distant points stay in place in motion, too, and on a road without texture all seem to
        is_sure = self._filter.is_measured or self._still_s >= _REST_S
        shift_m, by_plane = 0.0 if motion.is_still and is_sure else math.nan, 0.0
        before = self._before(motion) if is_moving else self._past[-1]
        if is_moving and math.isfinite(self._side):
            shift_m, by_plane = self._shift_m(before, now, dt_s)
        self._span_s = span_s = motion.time_s - before.time_s
        # successive measurements share most of a long span
        independent_mps = _SHIFT_SIGMA_M / math.sqrt(span_s * dt_s)
        common_mps = math.hypot(_SCALE_SIGMA, by_plane) * abs(shift_m / span_s)
        measured = shift_m / span_s, independent_mps, common_mps
        if is_moving and self._depth is not None:
            measured = self._depth.checked(motion, measured, self._filter)
        speed = self._filter.update(motion.time_s, span_s, *measured)
        if math.isfinite(speed[0]):
            self._speed_mps = speed[0]
        pitch_rad, roll_rad = motion.pitch_rad_s * dt_s, motion.roll_rad_s * dt_s
        self._horizon.predict(
            dt_s, pitch_rad=pitch_rad, roll_rad=roll_rad, travelled_m=self._speed_mps * dt_s
        )
        if is_moving:
            self._measure_horizon(row)
        is_still = self._filter.is_rest(speed, shows_rest=motion.is_still)
        return EgoMotion(
            *speed,
            motion.yaw_rad_s,
            is_still,
            noise_mps=self._filter.noise_mps,
            is_predicted=not self._filter.is_measured,
        )

    def _before(self, motion: ImageMotion) -> "_Picture":
        """The frame whose picture is compared: the earliest one that is near enough."""
        # so that the middle of the span moves forward
        longest_s = self._span_s + 2 * motion.dt_s
        for past in self._past:
            span_s = motion.time_s - past.time_s
            if span_s < longest_s and self._speed_mps * span_s < _MAX_SPAN_M:
                return past
        return self._past[-1]

    def _follow_side(self, side: float, dt_s: float) -> None:
        """Low-pass filter of the direction of travel to the right, with the time constant
        `_TRAVEL_TIME_S`.
        """
        if math.isnan(self._side) or dt_s >= _TRAVEL_TIME_S:
            self._side = side
        else:
            self._side += dt_s / _TRAVEL_TIME_S * (side - self._side)

    def _measure_horizon(self, row: float) -> None:
        """Correct the horizon by the direction of travel down, if it is known; a sure horizon is
        then the expected direction.
        """
        slow = slow_factor(self._speed_mps)
        if math.isfinite(row):
            self._horizon.measure(row, (slow * _EPIPOLE_SIGMA_RAD) ** 2)
            self.has_horizon = True
        view = self._horizon.view
        if view.horizon_variance < _SURE_RAD**2:
            self._image_motion.expect_travel(
                view.horizon, view.horizon_variance + (slow * _TRAVEL_SIGMA_RAD) ** 2
            )

    def _shift_m(self, before: "_Picture", now: "_Picture", dt_s: float) -> tuple[float, float]:
        """Distance travelled from one frame to another, NaN = not reliable, and its relative
        standard deviation by the plane of the road; the last frame was `dt_s` before `now`.

        The shifts of the strips first correct the horizon and the roll.
        """
        view = self._horizon.view
        horizon, roll = view.horizon - view.curvature_per_m * _PICTURE_M / 2, -view.slope
        turn = np.array([-horizon, self._side, -roll])
        level = np.asarray(cv2.Rodrigues(turn)[0], np.float64)
        span_s = now.time_s - before.time_s
        lanes = self._lanes(self._travel_from_camera.T @ level)
        longest = max((len(Z) for _, Z in lanes), default=0)
        n_shifts = min(round(_MAX_SPEED_MPS * span_s / _STEP_Z_M), longest - _N_STRIP) + 1
        strips = [self._strips((before, now), level, lane, n_shifts) for lane in lanes]
        if not strips:
            return math.nan, 0.0
        x_m, z_m, scores = (np.concatenate(parts) for parts in zip(*strips, strict=True))
        best = _best_shift(scores)
        if best is None or (len(scores) < _MIN_STRIPS and math.isnan(self._last[1].speed_mps)):
            return math.nan, 0.0  # two strips only confirm a speed
        shift_m, shifts_m = _STEP_Z_M * best, _STEP_Z_M * _peaks_near(scores, round(best))
        is_beside = np.abs(x_m).max() > _HALF_WIDTH_M
        if is_beside and np.isfinite(shifts_m).sum() < _MIN_BESIDE_STRIPS:
            return math.nan, 0.0
        error = plane_error(shift_m, x_m, z_m - shift_m / 2, shifts_m, self.height_m)
        if error is None:
            return shift_m, self._sigma_by_plane(float(x_m.mean()), float(z_m.mean()))
        ahead_m = error.z_m + shift_m  # the camera follows the curve, too
        # the horizon belongs to the frame before this one, the shifts to the middle of the span
        n_frames = span_s / dt_s
        frames = n_frames * error.z_m / shift_m + n_frames / 2 - 1
        is_consistent = self._horizon.measure(
            horizon + error.by_roll * roll - error.horizon,
            error.variance,
            ahead_m=ahead_m,
            frames=min(frames, _MAX_FRAMES),
            by_roll=error.by_roll,
            max_sigma=_OUTLIER_SIGMA,
        ) and self._horizon.measure_roll(
            roll - error.roll, error.roll_variance, max_sigma=_OUTLIER_SIGMA
        )
        if not is_consistent:
            return math.nan, 0.0
        self.has_horizon = True
        view = self._horizon.view
        too_low = horizon - view.horizon + view.curvature_per_m * ahead_m / 2
        longer = (2 * error.z_m * too_low - error.x_m * (roll + view.slope)) / self.height_m
        return shift_m * (1 - longer), self._sigma_by_plane(error.x_m, error.z_m)

    def _sigma_by_plane(self, x_m: float, z_m: float) -> float:
        """Relative standard deviation of a shift at a place, by the horizon, the roll, and the
        height of the ground outside of the lane of the car.
        """
        by_horizon = 2 * z_m * math.sqrt(self._horizon.view.horizon_variance)
        by_roll = x_m * math.sqrt(self._horizon.roll_variance)
        raised_m = _RAISED_M if abs(x_m) > _HALF_WIDTH_M else 0.0
        return math.hypot(by_horizon, by_roll, raised_m) / self.height_m

    def _lanes(self, level: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """X and Z, from far to near, of the cells of the lanes whose road is measured: that of the
        car, or lanes beside it; `level` (3, 3) turns from the level road to the camera.
        """
        ahead = np.arange(-_HALF_WIDTH_M, _HALF_WIDTH_M, _STEP_X_M)
        Z = self._seen_m(ahead, level, _NEAREST_M)
        if len(Z) * _STEP_Z_M > 2 * _STRIP_M:
            return [(ahead, Z)]
        lanes = []
        for inner_m in np.arange(*_BESIDE_M, _BESIDE_WIDTH_M):
            right = np.arange(inner_m, inner_m + _BESIDE_WIDTH_M, _STEP_X_M)
            lanes += [(X, self._seen_m(X, level, 0.0)) for X in (right, -right)]
        return [lane for lane in lanes if len(lane[1]) * _STEP_Z_M > _MIN_BESIDE_M][:_MOST_BESIDE]

    def _seen_m(self, X: FloatArray, level: FloatArray, from_m: float) -> FloatArray:
        """(K,) Z, from far to near and without gaps, at which the image shows the road at all X
        well.
        """
        camera = self._camera
        edges = _road(X[[0, -1]], _ALL_Z, self.height_m)
        u, v, depth_m = (camera.matrix @ level @ edges).reshape(3, -1, 2)
        depth_m = np.where(depth_m > 0, depth_m, np.nan)
        u, v = u / depth_m, v / depth_m
        is_inside = (u >= 1) & (u <= camera.width_px - 2) & (v >= 1) & (v <= camera.height_px - 2)
        is_seen = is_inside[:, 0] & is_inside[:, 1]
        nearer_m = np.minimum(depth_m[:, 0], depth_m[:, 1])
        sharp_m = math.sqrt(_MAX_PIXEL_M * camera.fy_px * self.height_m)
        is_seen &= (nearer_m <= sharp_m) & (nearer_m >= from_m * min(sharp_m / _FARTHEST_M, 1.0))
        nearest_m = nearer_m[is_seen].min(initial=math.inf)
        is_seen &= nearer_m <= max(_FARTHEST_M, nearest_m + _MIN_LENGTH_M)
        return _ALL_Z[is_seen]

    def _strips(
        self,
        pictures: tuple["_Picture", "_Picture"],
        level: FloatArray,
        lane: tuple[FloatArray, FloatArray],
        n_shifts: int,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(K,) X and Z of the strips of a lane in the first picture, and (K, M) correlations with
        the second one; `level` (3, 3) turns from the level road to the axes of travel in the last
        frame.
        """
        X, Z = lane
        hw = len(Z), len(X)
        road, image_from_cell = _road(X, Z, self.height_m), _road_from_cell(X, Z, self.height_m)
        sampled, masked = [], []
        for picture in pictures:
            image_from_road = (
                self._camera.matrix @ self._travel_from_camera.T @ picture.rotation.T @ level
            )
            sampled.append(_sampled(picture.grey, image_from_road @ image_from_cell, hw))
            masked.append(_are_inside(image_from_road @ road, picture.xyxy_px))
        before, now = sampled
        masked_fraction = np.logical_or(*masked).reshape(hw).mean(axis=1)
        nearer_m, scores = _strip_correlations(before, now, masked_fraction, n_shifts)
        return np.full(len(scores), X.mean()), Z[0] - nearer_m, scores


class _Picture(NamedTuple):
    """A frame: its time, full image and boxes (N, 4), and the rotation (3, 3) of the static scene
    from it to the last frame, in the axes of travel.
    """

    time_s: float
    grey: Image
    xyxy_px: FloatArray
    rotation: FloatArray


def _road(X: FloatArray, Z: FloatArray, height_m: float) -> FloatArray:
    """(3, len(Z) * len(X)) points of the road in the level frame, from far to near."""
    road = np.empty((3, len(Z), len(X)))
    road[0], road[1], road[2] = X, height_m, Z[:, None]
    return road.reshape(3, -1)


def _road_from_cell(X: FloatArray, Z: FloatArray, height_m: float) -> FloatArray:
    """(3, 3) from homogeneous column and row of the cells, which have equal distances, to points of
    the road in the level frame.
    """
    return np.array([[X[1] - X[0], 0.0, X[0]], [0.0, 0.0, height_m], [0.0, Z[1] - Z[0], Z[0]]])


def slow_factor(speed_mps: float) -> float:
    """Factor of the errors of the direction of travel as a measurement of the horizon, 1 or more:
    the camera moves up and down by a few cm/s, which turn the path of a slow car more.
    """
    return max(_FULL_MPS / max(abs(speed_mps), _SLOWEST_MPS), 1.0)


def _strip_correlations(
    before: FloatArray32, now: FloatArray32, masked_fraction: FloatArray, n_shifts: int
) -> tuple[FloatArray, FloatArray]:
    """(K,) distance of usable strips of two pictures from the pictures' far end, in m, and (K, M)
    their correlations.

    NaN = outside the picture.
    """
    top = np.arange(0, len(before) - _N_STRIP + 1, _N_STRIP // 2)
    strips, windows = _windows(before, _N_STRIP // 2), _windows(now)
    strips = strips - strips.mean(axis=1, keepdims=True)
    spread = np.sqrt((strips * strips).sum(axis=1))
    is_used = spread >= _MIN_STRIP_GREY * math.sqrt(strips.shape[1])
    masked = _moved_sums(np.cumsum(masked_fraction))[top]
    is_used &= masked <= _MAX_MASKED_FRACTION * _N_STRIP + 1e-6  # rounding of the sums
    top, strips = top[is_used], strips[is_used] / spread[is_used, None]
    sums, squares = np.cumsum(
        [now.sum(axis=1, dtype=np.float64), (now * now).sum(axis=1, dtype=np.float64)], axis=1
    )
    deviation2 = _moved_sums(squares) - _moved_sums(sums) ** 2 / windows.shape[1]
    likeness = (strips @ windows.T) / np.sqrt(np.maximum(deviation2, _MIN_DEVIATION2))
    nearer = top[:, None] + np.arange(n_shifts)  # first rows of the windows
    last = windows.shape[0] - 1
    number = np.arange(len(top))[:, None]
    scores = likeness.astype(np.float64)[number, np.minimum(nearer, last)]
    scores[nearer > last] = np.nan
    return _STEP_Z_M * (top + (_N_STRIP - 1) / 2), scores


def _windows(picture: npt.NDArray[Any], step: int = 1) -> npt.NDArray[Any]:
    """(K, 20 W) values of the parts of a picture (H, W) that are as long as a strip, `step` rows
    apart.
    """
    width = picture.shape[1]
    parts = sliding_window_view(picture.ravel(), _N_STRIP * width)
    return parts[:: step * width].copy()


def _moved_sums(cumulative: FloatArray) -> FloatArray:
    """(H - 19,) sums over the rows of each part that is as long as a strip, from cumulative sums
    (H,).
    """
    sums = cumulative[_N_STRIP - 1 :].copy()
    sums[1:] -= cumulative[:-_N_STRIP]
    return sums


def _best_shift(scores: FloatArray) -> float | None:
    """Shift of strips with correlations (K, M), in cells; None = not reliable."""
    if len(scores) < 2:
        return None
    count = np.isfinite(scores).sum(axis=0)
    score = np.where(count >= 2, np.nansum(scores, axis=0) / np.maximum(count, 1), -1.0)
    best = int(score.argmax())
    if best in (0, len(score) - 1) or score[best] < _MIN_CORRELATION:
        return None
    n_near = round(_MIN_UNIQUE_M / _STEP_Z_M)
    others = np.concatenate([score[: max(best - n_near, 0)], score[best + n_near :]])
    return (
        None if score[best] - others.max(initial=-1.0) < _MIN_UNIQUENESS else _vertex(score, best)
    )


class PlaneError(NamedTuple):
    """Errors of the assumed plane of the road, as tangents, at the mean of the strips.

    The horizon is `horizon - by_roll * E` too low if the roll is E too large.
    """

    horizon: float
    variance: float
    by_roll: float
    roll: float  # how much too large the roll is
    roll_variance: float  # infinite for strips of one lane
    x_m: float
    z_m: float


def plane_error(
    shift_m: float, x_m: FloatArray, z_m: FloatArray, shifts_m: FloatArray, height_m: float
) -> PlaneError | None:
    """Error of the plane from the slopes of the shifts over the road; None = too few strips.

    `shift_m` is the common shift of the strips, `x_m` and `z_m` (K,) their centres in the middle of
    the shift, `shifts_m` (K,) the shift of each, NaN = unknown, and `height_m` the camera's height
    above the road.
    """
    is_known = np.isfinite(shifts_m)
    if is_known.sum() < _MIN_STRIPS or shift_m <= 0:
        return None
    places = np.stack([z_m, x_m], axis=1)[is_known]
    z_mean, x_mean = places.mean(axis=0).tolist()
    by_tilt = (places - [z_mean, x_mean]) * np.array([2.0, -1.0]) * (shift_m / height_m)
    by_horizon, by_roll = by_tilt.T
    # two independent measurements, the second of the roll alone: by_tilt = Q [[a, b], [0, c]]
    a = math.sqrt(by_horizon @ by_horizon)
    along = by_horizon / a
    b = float(along @ by_roll)
    across = by_roll - b * along
    c = math.sqrt(across @ across)
    known_m = shifts_m[is_known]
    of_horizon, sees_roll = float(along @ known_m), c > _MIN_ROLL_M
    of_roll = float(across @ known_m) / c if sees_roll else 0.0
    return PlaneError(
        horizon=of_horizon / a,
        variance=(_STRIP_SIGMA_M / a) ** 2 + _STRIPS_SIGMA_RAD**2,
        by_roll=b / a,
        roll=of_roll / c if sees_roll else 0.0,
        roll_variance=(_STRIP_SIGMA_M / c) ** 2 + _STRIPS_SIGMA_RAD**2 if sees_roll else math.inf,
        x_m=x_mean,
        z_m=z_mean,
    )


def _peaks_near(scores: FloatArray, cell: int) -> FloatArray:
    """(K,) maxima of the strips' correlations (K, M) near the common maximum, in cells; NaN =
    none.
    """
    start = max(cell - _MAX_STRIP_CELLS, 1)
    peaks = np.full(len(scores), np.nan)
    for i, score in enumerate(scores):
        near = score[start : cell + _MAX_STRIP_CELLS + 1]
        best = start + int(near.argmax())
        is_inside = start < best < start + len(near) - 1
        if is_inside and np.isfinite(near).all() and score[best] >= _MIN_STRIP_CORRELATION:
            peaks[i] = _vertex(score, best)
    return peaks


def _vertex(score: FloatArray, best: int) -> float:
    """Position of the vertex of the parabola through a maximum and its neighbours."""
    low, mid, high = score[best - 1 : best + 2].tolist()
    curvature = low - 2 * mid + high
    return best + (0.5 * (low - high) / curvature if curvature < 0 else 0.0)


def _sampled(image: Image, image_from_cell: FloatArray, hw: tuple[int, int]) -> FloatArray32:
    """(H, W) grey levels of the cells, without their means along Z, by which lane lines and ruts
    look alike at any shift; the edge is repeated outside the image.

    `image_from_cell` (3, 3) leads from homogeneous column and row of a cell to those of the image.
    """
    height, width = _N_SAMPLES * hw[0], _N_SAMPLES * hw[1]
    # the centres of the samples of a cell lie about its own
    place = 0.5 / _N_SAMPLES - 0.5
    scale = 1 / _N_SAMPLES
    cell_from_sample = np.array([[scale, 0.0, place], [0.0, scale, place], [0.0, 0.0, 1.0]])
    sampled = cv2.warpPerspective(
        image,
        image_from_cell @ cell_from_sample,
        (width, height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    means = cv2.resize(sampled.astype(np.float32), hw[::-1], interpolation=cv2.INTER_AREA)
    along = cv2.blur(means, (1, _N_STRIP), borderType=cv2.BORDER_REFLECT)
    return np.asarray(means - along, np.float32)


def _are_inside(points: FloatArray, xyxy_px: FloatArray) -> BoolArray:
    """(N,) whether homogeneous points (3, N) of the image are inside a box."""
    xy_px = points[:2] / points[2]
    low, high = xy_px.min(axis=1), xy_px.max(axis=1)
    meets = (xyxy_px[:, 2:] >= low) & (xyxy_px[:, :2] <= high)
    near = xyxy_px[meets[:, 0] & meets[:, 1]]  # most boxes are beside the road ahead
    are_inside = np.zeros(points.shape[1], np.bool_)
    x, y = xy_px
    for x1, y1, x2, y2 in near.tolist():
        are_inside |= (x >= x1) & (x <= x2) & (y >= y1) & (y <= y2)
    return are_inside
