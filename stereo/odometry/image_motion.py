r"""ImageMotion: rotation of one camera and expansion of the image between two frames; the scale
remains unknown.

A static point has the ray p before and p' now, and moves on its epipolar line:

    p'^T [t]x R p = 0        R, t: rotation and direction of the translation, now from before

Both are fitted to corners outside the boxes of road users by Gauss-Newton on the Sampson distance
with Tukey weights (Hartley and Zisserman, 2004, section 11.4.3). Yaw and a sideways t move distant
points alike. Near points separate them, but their surroundings deform as they approach, which
increases errors of the flow: their weight is lower, and t is a random walk, so that its last
estimate is the prior of the next one. Corners on edges are left out: a lane line in a curve stays
in its place in the image, as if the road did not turn. With the rotation removed, points move by
p' - R p = g (t - t_z R p), with the motion g in units of the depth; the expansion is the median of
g per second, the speed over a typical depth.

A camera may look in any direction: its mounting gives the axes of travel (right, down, forward) in
which rates and the direction of travel are stated, and in which the prior of the direction is.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, Image, check_shape
from track_range.foundation.robust_statistics import MAD_TO_SIGMA, median_of
from track_range.foundation.sparse_flow import BackgroundFlow, isotropy
from track_range.stereo.geometry.camera import PinholeCamera

# residual, in standard deviations, above which the weight is 0 (95 % efficiency with normal noise)
_TUKEY = 4.685
_N_ROUNDS = 8  # of Gauss-Newton, at most
# squared length of a step that ends them, in standard deviations, from this round on
_SMALL_STEP2 = 0.01
_FEWEST_ROUNDS = 4
# the first ones, for the rotation alone, which a wrong direction cannot mislead
_N_ROTATION_ROUNDS = 3
_ROUNDS_OF_NOISE = (1, 3, 5)  # rounds that update the noise of the points, with the rotation so far
# standard deviation of the direction of travel at the start, and the largest one
_DIRECTION_SIGMA_RAD = 0.05
# Random walk of the direction of travel in the camera's frame, rad per square root of a second: a
# car that enters a curve of 50 m slips by 0.03 rad at a camera 1.5 m in front of its rear axle, and
# brakes and bumps pitch it as much.
_DIRECTION_DRIFT_RAD = 0.03
# Standard deviation of the flow, as a fraction of the part that the translation causes; residuals
# on simulated drives, seeds 0-9, grow by 0.02 to 0.05 of it.
_FLOW_NOISE = 0.03
# Standard deviation of the common error of the flow of distant points, small pixels, which does not
# average out; the errors of yaw on simulated drives, seeds 0-9, then have a standard deviation of 1
# in units of their sigma.
_BIAS_PX = 0.06
# Corners, and limits of plausible motions, in pixels of the small image:
_N_FEATURES = 200  # largest number of corners
_MIN_QUALITY = 0.003  # minimum quality of a corner, as a fraction of the best corner's
_MIN_ISOTROPY = 0.1  # minimum ratio of the eigenvalues of a corner's structure tensor
_NOISE_PX = 0.1  # standard deviation of a tracked corner
_MAX_COST = 9.0  # of one point, in the cost of a fit
_MAX_RESIDUAL_PX = 0.5  # largest distance of a static point from its epipolar line
_MIN_FEATURES = 16  # minimum number of static points
_MIN_STATIC_FRACTION = 0.4  # minimum fraction of static points among the tracked ones
# of a camera at rest: largest median motion of the static points, and the largest one of nearly all
# of them. Clouds and hills stay in place in a drive, and may be most of the corners; near points
# move by more.
_MAX_STILL_PX, _MAX_NEAR_PX, _STILL_FRACTION = 0.1, 0.5, 0.9
# tangent below the horizon from which the ground is near, 25 m for a camera at 1.5 m, and the least
# number of its points
_NEAR_SLOPE, _MIN_NEAR = 0.06, 5
_YAW_GAIN = 0.5  # weight of one change of the yaw rate in its mean
_MAX_GAP_S = 0.6  # longest time between two frames
# smallest part of a unit translation along the axis of travel; a smaller one is no usual motion
_MIN_FORWARD = 0.5
# smallest motion of a point by a translation of its depth, at which the growth is measured
_MIN_RADIUS = 0.03
# v x = sum of v_k _SKEW[k], the matrices of the cross products with the axes
_SKEW = np.array(
    [
        [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]],
        [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]],
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
    ]
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageMotion:
    """Motion between a frame and the previous one; rates are NaN where the motion is unknown."""

    time_s: float  # time of the frame
    dt_s: float = math.nan  # time since the previous frame; NaN for the first one
    yaw_rad_s: float = math.nan  # rate of the heading, positive = to the right
    yaw_sigma_rad_s: float = math.nan  # its standard deviation
    pitch_rad_s: float = math.nan  # pitch rate, positive = upwards
    roll_rad_s: float = math.nan  # roll rate, positive = clockwise as the driver sees it
    # median translation per second in units of the depth, positive = forwards
    expansion_hz: float = math.nan
    expansion_sigma_hz: float = math.nan  # its standard deviation
    # slopes of the direction of travel to the right of and below the axis of travel, NaN = unknown
    travel: tuple[float, float] = (math.nan, math.nan)
    is_still: bool = False  # whether the camera is at rest; False if unknown
    # whether near points show it: distant ones stay in place in motion, too
    is_near_still: bool = False

    @property
    def is_known(self) -> bool:
        """Whether the motion was measured."""
        return math.isfinite(self.yaw_rad_s)

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) rotation `now_from_before` of the static scene, against which the camera turns, in
        the axes of travel.
        """
        turn = np.array([-self.pitch_rad_s, -self.yaw_rad_s, -self.roll_rad_s]) * self.dt_s
        return np.asarray(cv2.Rodrigues(turn)[0], np.float64)


class ImageMotionEstimator:
    """Measures the motion of one camera without distortion, one frame after another.

    An approximate focal length suffices for correlations. Other estimators of the same stream may
    use the same `flow` of the background; None = a separate one.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        *,
        flow: BackgroundFlow | None = None,
        travel_from_camera: FloatArray | None = None,
    ) -> None:
        """`travel_from_camera` (3, 3) are the axes of travel, right, down and forward, in the
        camera's; None = the camera looks along the drive.
        """
        self._camera = camera
        self._flow = flow or BackgroundFlow()
        self._travel_from_camera = np.eye(3) if travel_from_camera is None else travel_from_camera
        self._last = ImageMotion(time_s=math.nan)
        self._yaw_slope = 0.0  # change of the yaw rate per second
        self._direction = -self._travel_from_camera[2]
        self._direction_variance = np.full(2, _DIRECTION_SIGMA_RAD**2)

    def expect_travel(self, row: float, variance: float) -> None:
        """Combine the direction of travel with its expected row in the next frame, from the horizon
        of the road.

        `row` is the tangent of the direction below the axis of travel.
        """
        along = self._travel_from_camera @ self._direction
        forward = along[2]
        if abs(forward) < _MIN_FORWARD:
            return
        fraction = self._direction_variance[1] / (self._direction_variance[1] + variance)
        along = along / forward
        along[1] += fraction * (row - along[1])
        along *= math.copysign(1.0, forward) / np.linalg.norm(along)
        self._direction = along @ self._travel_from_camera
        self._direction_variance = self._direction_variance * [1.0, 1.0 - fraction]

    def update(self, image: Image, time_s: float, xyxy_px: FloatArray | None = None) -> ImageMotion:
        """Motion since the previous frame, which must be earlier; unknown for the first frame and
        after a gap. Frames are compared when the flow has new corners, at most 17 times per second:
        between, it is the motion of the last one, with the yaw rate that is expected in the frame.

        The image is (H, W, 3) BGR or (H, W) grey, of the size of the camera; `xyxy_px` (N, 4) are
        boxes of road users, which are not static; None = no boxes are known.
        """
        image_hw = self._camera.height_px, self._camera.width_px
        check_shape("image", image[:, :, 0] if image.ndim == 3 else image, image_hw)
        boxes = np.zeros((0, 4)) if xyxy_px is None else xyxy_px
        check_shape("xyxy_px", boxes, (None, 4))
        self._flow.add(image, boxes, time_s)
        last = self._last
        if self._flow.is_between:
            yaw_rad_s = last.yaw_rad_s + self._yaw_slope * (time_s - last.time_s)
            return replace(last, yaw_rad_s=yaw_rad_s)
        self._last = self._compared(time_s)
        slope = (self._last.yaw_rad_s - last.yaw_rad_s) / self._last.dt_s
        self._yaw_slope += _YAW_GAIN * (slope - self._yaw_slope)
        if not math.isfinite(self._yaw_slope):
            self._yaw_slope = 0.0
        return self._last

    def _compared(self, time_s: float) -> ImageMotion:
        """Motion to a frame of the flow with new corners, since the one before it."""
        first, last_s = self._flow.detection_before, self._last.time_s
        dt_s = time_s - last_s
        if first is None or first.time_s != last_s or not 0 < dt_s <= _MAX_GAP_S:
            return ImageMotion(time_s=time_s)
        before, now, focal_px = tracked_rays(self._flow, self._camera)
        if len(before) < _MIN_FEATURES:
            return ImageMotion(time_s=time_s, dt_s=dt_s)
        return self._motion(before, now, focal_px, time_s, dt_s)

    def _motion(
        self, before: FloatArray, now: FloatArray, focal_px: float, time_s: float, dt_s: float
    ) -> ImageMotion:
        """Motion from rays (N, 3) of corners before and now."""
        self._direction_variance = np.minimum(
            self._direction_variance + _DIRECTION_DRIFT_RAD**2 * dt_s, _DIRECTION_SIGMA_RAD**2
        )
        fit = fit_epipolar(
            before,
            now,
            direction=self._direction,
            direction_variance=self._direction_variance,
            travel_from_camera=self._travel_from_camera,
            focal_px=focal_px,
        )
        if fit.is_static.sum() < max(_MIN_FEATURES, _MIN_STATIC_FRACTION * len(before)):
            return ImageMotion(time_s=time_s, dt_s=dt_s)
        turned = _turned(before, np.asarray(cv2.Rodrigues(fit.rotation)[0], np.float64))
        motion_px = focal_px * np.linalg.norm((now - turned)[fit.is_static], axis=1)
        is_in_place = bool(median_of(motion_px) <= _MAX_STILL_PX)
        is_still = is_in_place and bool((motion_px <= _MAX_NEAR_PX).mean() >= _STILL_FRACTION)
        x, y, backward = (self._travel_from_camera @ fit.direction).tolist()
        travel = math.nan, math.nan
        if not is_in_place:  # few points that move show no direction: they may be a vehicle
            self._direction, self._direction_variance = fit.direction, fit.direction_variance
            if abs(backward) >= _MIN_FORWARD:
                travel = x / backward, y / backward
        growth, growth_sigma = _growth(turned[fit.is_static], now[fit.is_static], fit.direction)
        down = self._travel_from_camera[1]
        yaw_sigma = math.sqrt(float(down @ fit.rotation_covariance @ down))
        # the camera turns against the scene
        pitch, yaw, roll = (self._travel_from_camera @ fit.rotation / -dt_s).tolist()
        return ImageMotion(
            time_s=time_s,
            dt_s=dt_s,
            yaw_rad_s=yaw,
            yaw_sigma_rad_s=math.hypot(yaw_sigma, _BIAS_PX / focal_px) / dt_s,
            pitch_rad_s=pitch,
            roll_rad_s=roll,
            expansion_hz=0.0 if is_still else math.copysign(growth, -backward) / dt_s,
            expansion_sigma_hz=growth_sigma / dt_s,
            travel=travel,
            is_still=is_still,
            is_near_still=is_still and self._n_near(before[fit.is_static]) >= _MIN_NEAR,
        )

    def _n_near(self, rays: FloatArray) -> int:
        """Number of rays (N, 3) to near places of the ground."""
        right, down, forward = self._travel_from_camera @ np.vstack([rays, self._direction]).T
        slope = down / np.hypot(right, forward)
        # the direction of the translation of the scene is against that of travel
        return int((slope[:-1] + slope[-1] > _NEAR_SLOPE).sum())


@dataclass(frozen=True, slots=True)
class EpipolarFit:
    """Rotation and direction of travel between two frames."""

    rotation: FloatArray  # (3,) rotation vector `now_from_before`, rad
    rotation_covariance: FloatArray  # (3, 3) its covariance
    # (3,) unit vector t of the translation `now_from_before`; (0, 0, -1) = straight ahead
    direction: FloatArray
    direction_variance: FloatArray  # (2,) variances to the right of and below the axis of travel
    is_static: BoolArray  # (N,) whether a point is near its epipolar line
    cost: float  # mean of the squares of the residuals in standard deviations, each at most 9
    moved: float  # median motion of the points by the translation, rad


def fit_epipolar(
    before: FloatArray,
    now: FloatArray,
    *,
    direction: FloatArray,
    direction_variance: FloatArray,
    travel_from_camera: FloatArray,
    focal_px: float,
) -> EpipolarFit:
    """Rotation and direction of the translation from rays (N, 3) with z = 1 of the same points in
    both frames.

    The iteration starts from `direction` (3,), the expected unit translation; `direction_variance`
    (2,) is of its x and y in the axes of travel, `focal_px` the focal length of the tracked image.
    """
    noise = _NOISE_PX / focal_px
    rays = _RayPairs.of(before, now)
    flow = median_of(rays.now[:2] - rays.before[:2])
    # across the motion of a point on the axis, which the translation causes
    x, y = (flow - direction[:2] * (direction[:2] @ flow)).tolist()
    rotation, t = np.asarray(cv2.Rodrigues(np.array([-y, x, 0.0]))[0], np.float64), direction
    sigma = np.full(len(now), noise)
    for k in range(_N_ROUNDS):
        n = 3 if k < _N_ROTATION_ROUNDS else 5
        if k == 0 or n == 5:
            tangents = _tangents(t)
            forms = _forms(t, tangents[: n - 3])
        if k in _ROUNDS_OF_NOISE:
            moved2 = ((rays.now - rays.turned(rotation)) ** 2).sum(axis=0)
            sigma = np.sqrt(noise**2 + _FLOW_NOISE**2 * moved2)
        if k == 0 or k in _ROUNDS_OF_NOISE:
            per_sigma = 1.0 / (sigma * rays.scale(rotation, t))
        # Sampson distances in standard deviations, and their derivatives
        distances = (forms @ rotation).reshape(-1, 9) @ rays.products * per_sigma
        residual, jacobian = distances[0], distances[1:]
        size = np.abs(residual)
        # a tenth of the time of numpy's median for so few values
        median = np.sort(size)[len(size) // 2]
        spread = max(MAD_TO_SIGMA * float(median), 1.0)
        weight = ((1.0 - np.minimum(size / (_TUKEY * spread), 1.0) ** 2) / spread) ** 2
        weighted = jacobian * weight
        information, gradient = weighted @ jacobian.T, weighted @ residual
        if n == 5:
            across = (tangents @ travel_from_camera.T)[:, :2]
            pull = across / direction_variance
            information[3:, 3:] += pull @ across.T
            gradient[3:] += pull @ (travel_from_camera @ (t - direction))[:2]
        regular = information.copy()  # it is singular if too few points have weight
        regular.flat[:: n + 1] += 1e-9 * regular.trace()
        step = -cv2.solve(regular, gradient[:, None])[1][:, 0]
        rotation = np.asarray(cv2.Rodrigues(step[:3])[0] @ rotation, np.float64)
        if n == 5:
            t = t + step[3:] @ tangents
            t = t / math.sqrt(t @ t)
        # the squared length of the step, in standard deviations
        if k >= _FEWEST_ROUNDS and -float(step @ gradient) < _SMALL_STEP2:
            break
    essential = (_forms(t, tangents[:0])[:1] @ rotation).reshape(9)
    residual = essential @ rays.products / rays.scale(rotation, t)
    covariance = np.linalg.inv(information)
    # The epipolar lines of t and -t are the same, but the points move as by one of them.
    flow = rays.now - rays.turned(rotation)  # (t - p' t_z) / z for a point at depth z
    is_backward = median_of(t @ flow - (rays.now * flow).sum(axis=0) * t[2]) < 0
    return EpipolarFit(
        rotation=np.asarray(cv2.Rodrigues(rotation)[0], np.float64).reshape(3),
        rotation_covariance=np.asarray(covariance[:3, :3], np.float64),
        direction=-t if is_backward else t,
        direction_variance=np.asarray(np.diag(across.T @ covariance[3:, 3:] @ across), np.float64),
        is_static=np.asarray(np.abs(residual) <= _MAX_RESIDUAL_PX / focal_px),
        cost=float(np.minimum((residual / sigma) ** 2, _MAX_COST).mean()),
        moved=float(median_of(np.sqrt((flow**2).sum(axis=0)))),
    )


def tracked_rays(
    flow: BackgroundFlow, camera: PinholeCamera
) -> tuple[FloatArray, FloatArray, float]:
    """Rays (N, 3) of corners, without those on edges, in the last two frames of a flow in which
    corners are detected, and the focal length of its small image.
    """
    corners, points = flow.since_detection(_N_FEATURES, _MIN_QUALITY)
    before = flow.detection_before
    if flow.now is None or before is None or not len(corners):
        return np.zeros((0, 3)), np.zeros((0, 3)), camera.fx_px
    is_corner = isotropy(before.small, corners) >= _MIN_ISOTROPY
    factor = 1 << flow.now.n_halved
    rays_before, rays_now = (
        camera.rays(factor * tracked[is_corner].astype(np.float64) + (factor - 1) / 2)
        for tracked in (corners, points)
    )
    return rays_before, rays_now, camera.fx_px / factor


def _turned(rays: FloatArray, rotation: FloatArray) -> FloatArray:
    """Rays (N, 3) after a rotation (3, 3), scaled to z = 1."""
    turned = rays @ rotation.T
    return np.asarray(turned / turned[:, 2:])


class _RayPairs(NamedTuple):
    """Rays of N points before and now as columns with z = 1."""

    both: FloatArray  # (6, N) before, then now
    products: FloatArray  # (9, N) of the components now and before: p'^T M p = vec(M) . products

    @classmethod
    def of(cls, before: FloatArray, now: FloatArray) -> "_RayPairs":
        """Pairs from rays (N, 3)."""
        both = np.concatenate([before, now], axis=1).T.copy()
        return cls(both, (both[3:, None] * both[:3]).reshape(9, -1))

    @property
    def before(self) -> FloatArray:
        """(3, N) rays before."""
        return self.both[:3]

    @property
    def now(self) -> FloatArray:
        """(3, N) rays now."""
        return self.both[3:]

    def turned(self, rotation: FloatArray) -> FloatArray:
        """(3, N) rays before after a rotation (3, 3), scaled to z = 1."""
        turned = rotation @ self.both[:3]
        return np.asarray(turned / turned[2])

    def scale(self, rotation: FloatArray, t: FloatArray) -> FloatArray:
        """(N,) lengths of the gradients of p'^T [t]x R p, by which it becomes the Sampson
        distance.
        """
        T = (t @ _SKEW.reshape(3, 9)).reshape(3, 3)
        gradients = np.zeros((4, 6))
        gradients[:2, :3], gradients[2:, 3:] = T[:2] @ rotation, T[:2]
        return np.asarray(np.sqrt(((gradients @ self.both) ** 2).sum(axis=0)) + 1e-9)


def _forms(t: FloatArray, tangents: FloatArray) -> FloatArray:
    """(4 + K, 3, 3) matrices M of p'^T M R p: [t]x, and its derivatives [t]x [dw]x by the rotation
    [dw]x R and [dt]x along the tangents (K, 3) of t.
    """
    turns = np.concatenate([t[None], tangents]) @ _SKEW.reshape(3, 9)
    T, *by_t = turns.reshape(-1, 3, 3)
    return np.array([T, *(T @ _SKEW), *by_t])


def _tangents(t: FloatArray) -> FloatArray:
    """(2, 3) unit vectors across t (3,) and each other."""
    x, y, z = t.tolist()
    first = (-z, 0.0, x) if abs(y) < 0.9 else (0.0, z, -y)
    across = np.array(first) / math.hypot(*first)
    a, b, c = across.tolist()
    return np.array([across, (y * c - z * b, z * a - x * c, x * b - y * a)])


def _growth(turned: FloatArray, now: FloatArray, direction: FloatArray) -> tuple[float, float]:
    """Median motion of static points in units of the depth, and its standard deviation."""
    moved = direction[:2] - turned[:, :2] * direction[2]
    radius2 = (moved**2).sum(axis=1)
    is_far = radius2 >= _MIN_RADIUS**2
    if not is_far.any():
        return math.nan, math.nan
    growth = ((now - turned)[:, :2] * moved).sum(axis=1)[is_far] / radius2[is_far]
    median = median_of(growth)
    spread = MAD_TO_SIGMA * float(median_of(np.abs(growth - median)))
    return float(median), 1.25 * spread / math.sqrt(len(growth))
