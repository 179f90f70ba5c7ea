r"""GroundOdometry: speed of one camera in units of its height above the road, and the horizon, one
frame after another.

The road ahead is resampled on a grid of X and Z as seen from above, in the previous frame and in
this one, with the rotation between them removed. Driving s metres then shifts the picture along Z:

    now(X, Z - s) = before(X, Z)        pixel of (X, Z): pi(R C [X, h, Z])

C is the rotation from a level frame, which looks along the direction of travel, to the camera's
frame; R is the rotation from frame to frame (`ImageMotion`). A car drives parallel to the road, so
the horizon has the row of the epipole. `RoadHorizon` filters this row.

The picture is divided into strips. The shift is the maximum of their mean normalised correlation;
strips under boxes of road users or without texture do not count. The speed is unknown if the
maximum is low or not unique. A horizon in a wrong row makes distant parts of the road shift more,
or less, than near parts: if the horizon is taken to be d rad too low, a point at distance Z seems
to be at Z + d Z^2 / h, and a shift s with its middle at Z becomes s (1 + 2 Z d / h). So the slope
of the shifts over the distances measures the horizon, whatever the height.

An error of the camera height is an equal relative error of the speed. The road is taken to be plane
up to 15 m.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, FloatArray32, Image, check_shape
from track_range.foundation.sparse_flow import BackgroundFlow, small_grey
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.ego_motion import CameraStep, EgoMotion
from track_range.stereo.odometry.image_motion import ImageMotion, ImageMotionEstimator
from track_range.stereo.odometry.road_horizon import RoadHorizon, RoadView
from track_range.stereo.odometry.speed_filter import SpeedFilter
from track_range.stereo.odometry.travel_direction import TravelDirection

# The picture from above, and the search of the shift:
_HALF_WIDTH_M = 1.5  # half the width of the picture
_NEAREST_M = 4.5  # nearest road in the picture, if the image shows it
_FARTHEST_M = 15.0  # farthest road in the picture, if it is long enough
# length of the picture to aim at, and of the road that a pixel may cover in it
_MIN_LENGTH_M, _MAX_PIXEL_M = 8.0, 0.25
_STEP_X_M, _STEP_Z_M = 0.15, 0.1  # size of a cell of the picture
_STRIP_M = 2.0  # length of a strip
# distance of the middle of the picture, at which its plane has the slope of the road
_PICTURE_M = 9.0
_MAX_SPEED_MPS = 45.0
# smallest standard deviation of a strip in grey levels; below it there is only noise
_MIN_STRIP_GREY = 1.0
_MAX_MASKED_FRACTION = 0.05  # largest fraction of a strip under boxes of road users
_MIN_CORRELATION = 0.25  # smallest mean correlation of a reliable shift
_MIN_UNIQUENESS = 0.05  # smallest difference of it from the second best maximum
_MIN_UNIQUE_M = 0.35  # shifts nearer than this to the maximum belong to it
_SHIFT_SIGMA_M = 0.02  # standard deviation of a shift; assumed, a fifth of a cell
# Relative error of all speeds, from a road that is not plane and the camera height; the errors on
# simulated drives, seeds 0-9, then have a standard deviation of 0.6 in units of their sigma.
_SCALE_SIGMA = 0.03

# The horizon from the shifts of the strips:
_MIN_STRIPS = 4  # minimum number of strips for a measurement
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
_SURE_RAD = 0.004  # standard deviation of the horizon below which the epipole is expected there
# deviation from it: a camera at 10 m/s moves up and down on the springs by 0.04 m/s
_TRAVEL_SIGMA_RAD = 0.004
_TRAVEL_TIME_S = 1.0  # time constant with which the direction to the side follows the epipole
_UNKNOWN_SIGMA = 0.03  # relative standard deviation of a speed without one
_TYPICAL_MPS = 10.0  # speed for the curvature of the road until the first speed is known


class GroundOdometry:
    """Measures the speed of one camera without distortion, and the horizon; the state belongs to
    the instance.

    A wrong `height_m` of the camera above the road only scales the lengths. Other estimators of the
    same stream may use the same `flow` of the background; None = a separate one.
    """

    source = "the motion of the road in the images"

    def __init__(
        self, camera: PinholeCamera, height_m: float, *, flow: BackgroundFlow | None = None
    ) -> None:
        self._camera, self.height_m = camera, height_m
        self._flow = flow or BackgroundFlow()
        self._image_motion = ImageMotionEstimator(camera, flow=self._flow)
        self._filter = SpeedFilter()
        self._horizon = RoadHorizon()
        self._side, self._direction = math.nan, TravelDirection(camera)
        self._speed_mps = _TYPICAL_MPS
        self._before: Image | None = None
        self._boxes_before: FloatArray = np.zeros((0, 4))
        self._last = math.nan, EgoMotion()
        self.motion = ImageMotion(time_s=math.nan)  # between the last two frames
        self.has_horizon = False  # whether the horizon was measured so far

    @property
    def ego(self) -> EgoMotion:
        """Motion in the last frame, as `update` returned it."""
        return self._last[1]

    @property
    def view(self) -> RoadView:
        """The road in the last frame; lengths are in units of the camera height of this
        instance.
        """
        return self._horizon.view

    def update(self, frame: Frame, xyxy_px: FloatArray) -> EgoMotion:
        """Motion since the previous frame, with boxes (N, 4) of road users; NaN where it is not
        reliable.

        A second call for the same frame returns the same motion.
        """
        check_shape("xyxy_px", xyxy_px, (None, 4))
        if frame.time_s == self._last[0]:
            return self._last[1]
        self.motion = motion = self._image_motion.update(frame.left, frame.time_s, xyxy_px)
        now = self._flow.now
        before, self._before = self._before, small_grey(frame.left, 0) if now is None else now.grey
        boxes_before, self._boxes_before = self._boxes_before, xyxy_px
        if math.isnan(motion.dt_s) or before is None:
            self._side, ego = math.nan, EgoMotion()
        else:
            ego = self._moved(motion, before, self._before, (boxes_before, xyxy_px))
        self._last = frame.time_s, ego
        return ego

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        return self._direction.notes

    def step(self, ego: EgoMotion) -> CameraStep | None:
        """Motion of the camera to the last frame, with the speed of `ego`; None = unknown, or at
        rest.
        """
        motion, now = self.motion, self._flow.now
        is_known = motion.is_known and not motion.is_still and math.isfinite(ego.speed_mps)
        if not is_known or now is None or math.isnan(self._side) or ego.speed_mps <= 0:
            return None
        has_sigma = math.isfinite(ego.speed_sigma_mps)
        return CameraStep(
            time_s=motion.time_s,
            dt_s=motion.dt_s,
            rotation=motion.rotation,
            rotation_sigma_rad=motion.yaw_sigma_rad_s * motion.dt_s,
            travel=np.array([self._side, self.view.horizon]),
            travelled_m=ego.speed_mps * motion.dt_s,
            travelled_sigma=ego.speed_sigma_mps / ego.speed_mps if has_sigma else _UNKNOWN_SIGMA,
            now=now,
        )

    def _moved(
        self, motion: ImageMotion, before: Image, now: Image, boxes: tuple[FloatArray, FloatArray]
    ) -> EgoMotion:
        """The filtered speed; moves the horizon on to this frame."""
        dt_s = motion.dt_s
        is_moving = motion.is_known and not motion.is_still
        # direction of travel: slopes to the right and down
        side = (motion.epipole_px[0] - self._camera.cx_px) / self._camera.fx_px
        row = (motion.epipole_px[1] - self._camera.cy_px) / self._camera.fy_px
        if is_moving and math.isfinite(side):
            self._follow_side(side, dt_s)
            self._direction.add(dt_s, side, motion.yaw_rad_s)
        shift_m = 0.0 if motion.is_still else math.nan
        if is_moving and math.isfinite(self._side):
            shift_m = self._shift_m(motion, before, now, boxes)
        independent_mps = _SHIFT_SIGMA_M / dt_s
        common_mps = _SCALE_SIGMA * abs(shift_m / dt_s)
        speed = self._filter.update(
            motion.time_s, dt_s, shift_m / dt_s, independent_mps, common_mps
        )
        if math.isfinite(speed[0]):
            self._speed_mps = speed[0]
        pitch_rad, roll_rad = motion.pitch_rad_s * dt_s, motion.roll_rad_s * dt_s
        self._horizon.predict(
            dt_s, pitch_rad=pitch_rad, roll_rad=roll_rad, travelled_m=self._speed_mps * dt_s
        )
        if is_moving:
            self._measure_horizon(row)
        return EgoMotion(*speed, motion.yaw_rad_s, motion.is_still)

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
        if math.isfinite(row):
            self._horizon.measure(row, _EPIPOLE_SIGMA_RAD**2)
            self.has_horizon = True
        view = self._horizon.view
        if view.horizon_variance < _SURE_RAD**2:
            self._image_motion.expect_travel(
                view.horizon, view.horizon_variance + _TRAVEL_SIGMA_RAD**2
            )

    def _shift_m(
        self, motion: ImageMotion, before: Image, now: Image, boxes: tuple[FloatArray, FloatArray]
    ) -> float:
        """Distance travelled; NaN = not reliable. The shifts of the strips first correct the
        horizon.
        """
        view, camera = self._horizon.view, self._camera
        horizon = view.horizon - view.curvature_per_m * _PICTURE_M / 2
        lowest = (camera.height_px - 2 - camera.cy_px) / camera.fy_px
        sharp_m = math.sqrt(_MAX_PIXEL_M * camera.fy_px * self.height_m)
        nearest_m = max(
            _NEAREST_M * min(sharp_m / _FARTHEST_M, 1.0), self.height_m / (lowest - horizon)
        )
        farthest_m = min(max(_FARTHEST_M, nearest_m + _MIN_LENGTH_M), sharp_m)
        if not 0 < nearest_m < farthest_m - 2 * _STRIP_M:
            return math.nan
        # the road at all cells in both images, from far to near
        level = cv2.Rodrigues(np.array([-horizon, self._side, 0.0]))[0]
        Z = np.arange(farthest_m, nearest_m, -_STEP_Z_M)
        X = np.arange(-_HALF_WIDTH_M, _HALF_WIDTH_M, _STEP_X_M)
        road = np.stack(
            [np.tile(X, len(Z)), np.full(len(X) * len(Z), self.height_m), np.repeat(Z, len(X))],
            axis=1,
        )
        before_px = camera.project(road @ level.T)
        now_px = camera.project(road @ (motion.rotation @ level).T)
        hw = len(Z), len(X)
        masked_fraction = (
            np.maximum(_inside(before_px, boxes[0]), _inside(now_px, boxes[1]))
            .reshape(hw)
            .mean(axis=1)
        )
        pictures = _sampled(before, before_px, hw), _sampled(now, now_px, hw)
        nearer_m, scores = _strip_correlations(*pictures, masked_fraction, motion.dt_s)
        distance_m = farthest_m - nearer_m
        best = _best_shift(scores)
        if best is None or (len(scores) < _MIN_STRIPS and math.isnan(self._last[1].speed_mps)):
            return math.nan  # two strips only confirm a speed
        shift_m, shifts_m = _STEP_Z_M * best, _STEP_Z_M * _peaks_near(scores, round(best))
        slope = horizon_error(shift_m, distance_m - shift_m / 2, shifts_m, self.height_m)
        if slope is None:
            return shift_m
        ahead_m = slope.distance_m + shift_m  # the camera follows the curve, too
        is_consistent = self._horizon.measure(
            horizon - slope.error,
            slope.variance,
            ahead_m=ahead_m,
            frames=min(slope.distance_m / shift_m - 0.5, _MAX_FRAMES),
            max_sigma=_OUTLIER_SIGMA,
        )
        if not is_consistent:
            return math.nan
        self.has_horizon = True
        view = self._horizon.view
        error = horizon - view.horizon + view.curvature_per_m * ahead_m / 2
        return shift_m * (1 - 2 * slope.distance_m * error / self.height_m)


def _strip_correlations(
    before: FloatArray32, now: FloatArray32, masked_fraction: FloatArray, dt_s: float
) -> tuple[FloatArray, FloatArray]:
    """(K,) distance of usable strips of two pictures from the pictures' far end, in m, and (K, M)
    their correlations.

    NaN = outside the picture.
    """
    n_strip = round(_STRIP_M / _STEP_Z_M)
    n_shifts = min(round(_MAX_SPEED_MPS * dt_s / _STEP_Z_M), len(before) - n_strip) + 1
    nearer_m, scores = [], []
    for top in range(0, len(before) - n_strip + 1, n_strip // 2):
        strip = before[top : top + n_strip]
        if (
            masked_fraction[top : top + n_strip].mean() > _MAX_MASKED_FRACTION
            or strip.std() < _MIN_STRIP_GREY
        ):
            continue
        score = np.full(n_shifts, np.nan)
        known = cv2.matchTemplate(now[top:], strip, cv2.TM_CCOEFF_NORMED)[:n_shifts, 0]
        score[: len(known)] = known
        nearer_m.append(_STEP_Z_M * (top + (n_strip - 1) / 2))
        scores.append(score)
    return np.array(nearer_m), np.array(scores)


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


class HorizonError(NamedTuple):
    """Error of the assumed horizon: how much too low it is, as a tangent; its variance; mean
    distance of the strips.
    """

    error: float
    variance: float
    distance_m: float


def horizon_error(
    shift_m: float, distance_m: FloatArray, shifts_m: FloatArray, height_m: float
) -> HorizonError | None:
    """Error of the horizon from the slope of the shifts over the distances; None = too few strips.

    `shift_m` is the common shift of the strips, `distance_m` (K,) the distances of their centres in
    the middle of the shift, `shifts_m` (K,) the shift of each, NaN = unknown, and `height_m` the
    camera's height above the road.
    """
    is_known = np.isfinite(shifts_m)
    if is_known.sum() < _MIN_STRIPS or shift_m <= 0:
        return None
    mean_m = float(distance_m[is_known].mean())
    centred = distance_m[is_known] - mean_m
    spread = float(centred @ centred)
    slope = float(centred @ shifts_m[is_known]) / spread
    to_rad = height_m / (2 * shift_m)
    return HorizonError(
        slope * to_rad, (to_rad * _STRIP_SIGMA_M) ** 2 / spread + _STRIPS_SIGMA_RAD**2, mean_m
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


def _sampled(image: Image, points_px: FloatArray, hw: tuple[int, int]) -> FloatArray32:
    """(H, W) grey levels at points (H * W, 2); the edge is repeated outside the image."""
    maps = points_px.astype(np.float32).reshape(*hw, 2)
    sampled = cv2.remap(
        image, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(sampled, np.float32)


def _inside(points_px: FloatArray, xyxy_px: FloatArray) -> FloatArray:
    """(N,) 1.0 for points (N, 2) inside a box, else 0.0."""
    inside = np.zeros(len(points_px), np.bool_)
    x, y = points_px.T
    for x1, y1, x2, y2 in xyxy_px.tolist():
        inside |= (x >= x1) & (x <= x2) & (y >= y1) & (y <= y2)
    return inside.astype(np.float64)
