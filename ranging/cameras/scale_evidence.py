"""Evidence of the scale of a drive: sizes and contact points of road users, speeds, and lanes."""

import math
from collections import deque

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.track_state import TrackState
from track_range.ranging.cameras.evidence import Evidence, SeenFrame
from track_range.ranging.cameras.unknowns import Unknown
from track_range.ranging.methods.lane_width import LaneWidth
from track_range.ranging.size_models.size_model import SIZE_CLASSES, surface_offset_m
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.camera_height import CameraHeight

_ODOMETRY_SIGMA = 0.01  # of the scale of stereo odometry with a right rig
_LANE_SIGMA = 0.1  # of the opening of lane lines, in addition to the width of the lane
_MAX_LANE_CHI2 = 4.0  # a wrong lane, or a road of unusual lanes, excludes nothing alone
# speed that vehicles hardly exceed, and the sigma of its logarithm
MAX_MPS, _MAX_MPS_SIGMA = 45.0, 0.15
# frames of a speed, and its largest change: odometry of unrelated images is not steady
_N_STEADY, _STEADY = 8, 1.3
# fraction of objects with a mismatch or a wrong class, and their sigma
_OUTLIER, _OUTLIER_SIGMA = 0.1, 1.0
_MIN_OBJECT_SIGMA = 0.06  # of an object: its frames do not average out
# of sizes that objects have in common, and its largest fraction
_SHARED_VARIANCE, _MAX_SHARED = 0.07**2, 0.4
# of distances by size and of heights that are evidence, relative
_MAX_SIZE_SIGMA, _MAX_HEIGHT_SIGMA = 0.25, 0.2
_MIN_FRAMES, _MIN_OBJECTS, _MIN_LANES = 3, 2, 10
_MAX_OBJECTS, _MAX_VALUES = 300, 600  # largest numbers that are kept
# lights and signs vary too much
_IS_EVIDENCE = np.array([not name.startswith("traffic") for name in SIZE_CLASSES])
_STEP = 0.02
_LOG = np.arange(-3.2, 3.2 + _STEP / 2, _STEP)  # (G,) grid of what objects have in common


class SizeEvidence:
    """Distances by the rig, and heights of the camera over contact points, against distances by
    size.
    """

    def __init__(
        self, camera: PinholeCamera, height_m: float, *, min_frames: int = _MIN_FRAMES
    ) -> None:
        """`height_m` is the assumed height of the camera above the road; a road user is evidence
        after `min_frames`.
        """
        self._camera, self._log_height = camera, math.log(height_m)
        self._min_frames = min_frames
        # number of frames, mean, mean variance of g - a, the same of h + a
        self._objects = TrackState(np.zeros(6))

    @property
    def n_objects(self) -> int:
        """Number of road users that are evidence."""
        return int((self._objects.known[[0, 3]] >= self._min_frames).any(axis=0).sum())

    def add(self, seen: SeenFrame) -> None:
        """Add a frame."""
        tracks, by_size, stereo, road = seen.tracks, seen.by_size, seen.by_rig, seen.ego.road
        with np.errstate(invalid="ignore", divide="ignore"):
            size_sigma = by_size.sigma_m / by_size.distance_m
            is_used = (
                tracks.observed & _IS_EVIDENCE[tracks.class_id] & (size_sigma < _MAX_SIZE_SIGMA)
            )
            size_variance = size_sigma**2 - np.minimum(
                _SHARED_VARIANCE, _MAX_SHARED * size_sigma**2
            )
            r, r_variance, q, q_variance = np.full((4, len(tracks)), np.nan)
            if stereo is not None:
                r = np.log(stereo.distance_m / by_size.distance_m)
                r_variance = size_variance + (stereo.sigma_m / stereo.distance_m) ** 2
            if road is not None:
                x = (tracks.xyxy_px[:, 0] + tracks.xyxy_px[:, 2]) / 2
                horizon = road.horizon + road.slope * (x - self._camera.cx_px) / self._camera.fx_px
                below = (tracks.xyxy_px[:, 3] - self._camera.cy_px) / self._camera.fy_px - horizon
                offset_m = surface_offset_m(tracks.xyxy_px, tracks.class_id, has_visible_boxes=True)
                q = np.log(below * (by_size.distance_m - offset_m))
                angle_variance = road.horizon_variance + 0.004**2 + (1.5 / self._camera.fy_px) ** 2
                q_variance = angle_variance / below**2 + size_variance
        has_height = is_used & np.isfinite(q) & (q_variance < _MAX_HEIGHT_SIGMA**2)
        new = np.array([is_used & np.isfinite(r), r, r_variance, has_height, q, q_variance])
        state = self._objects.get(tracks.track_id)
        for rows in (slice(0, 3), slice(3, 6)):
            n, *values = new[rows]
            state[rows][0] += n
            gain = n / np.maximum(state[rows][0], 1.0)
            for mean, value in zip(state[rows][1:], values, strict=True):
                mean += gain * (np.where(n > 0, value, 0.0) - mean)
        stays = np.arange(self._objects.known.shape[1]) < _MAX_OBJECTS
        self._objects.put(tracks.track_id, state, keep_known=stays)

    @property
    def evidence(self) -> list[Evidence]:
        """The evidence of all frames so far."""
        evidence = []
        n, r, r_variance, n_q, q, q_variance = self._objects.known
        has_rig, has_height = n >= self._min_frames, n_q >= self._min_frames
        if has_rig.sum() >= _MIN_OBJECTS:
            name = f"the sizes of {has_rig.sum()} road users"
            of = {Unknown.BASELINE: 1.0, Unknown.SIZES: -1.0}
            evidence.append(Evidence(name, of, *_common(r[has_rig], r_variance[has_rig])))
        if has_height.sum() >= _MIN_OBJECTS:
            height = _common(q[has_height] - self._log_height, q_variance[has_height])
            of = {Unknown.HEIGHT: 1.0, Unknown.SIZES: 1.0}
            evidence.append(Evidence("where road users touch the road", of, *height))
        return evidence


class SpeedEvidence:
    """Speeds by stereo odometry, by the motion of the road, and as given, against one another."""

    def __init__(self, height_m: float, road_height_m: float) -> None:
        """`height_m` is the assumed height of the camera above the road, `road_height_m` the one
        with which the motion of the road is measured.
        """
        self._log_height = math.log(height_m)
        self._pair_height = CameraHeight(road_height_m)
        self._given_height = CameraHeight(road_height_m)
        # of stereo odometry and the given speed
        self._speed_ratio = CameraHeight(1.0, shared_sigma=_ODOMETRY_SIGMA)
        self._given_sigmas: deque[float] = deque(maxlen=_MAX_VALUES)
        self._speeds_mps: deque[float] = deque(maxlen=_N_STEADY)
        self._max_mps = 1.0

    def add(self, seen: SeenFrame) -> None:
        """Add a frame."""
        ego, time_s = seen.ego, seen.time_s
        by_pair, by_road, given = ego.by_pair, ego.by_road, ego.given
        if by_pair is not None:
            self._speeds_mps.append(by_pair.speed_mps)
            low_mps = float(np.min(self._speeds_mps))
            # False for NaN
            if len(self._speeds_mps) == _N_STEADY and np.max(self._speeds_mps) < _STEADY * low_mps:
                self._max_mps = max(self._max_mps, low_mps)
            if by_road is not None:
                self._pair_height.update(time_s, by_pair, by_road)
        if given is not None and math.isfinite(given.speed_mps):
            self._given_sigmas.append(given.speed_sigma_mps / max(abs(given.speed_mps), 0.1))
            if by_pair is not None:
                self._speed_ratio.update(time_s, by_pair, given)
            elif by_road is not None:
                self._given_height.update(time_s, given, by_road)

    @property
    def evidence(self) -> list[Evidence]:
        """The evidence of all frames so far."""
        rig, height, focal, speed = (
            Unknown.BASELINE,
            Unknown.HEIGHT,
            Unknown.FOCAL,
            Unknown.SPEED,
        )
        given_sigma = float(np.median(self._given_sigmas)) if self._given_sigmas else 0.0
        evidence = []
        for name, of, ratio, other_sigma in (
            ("the motion of the road", {rig: 1.0, height: 1.0}, self._pair_height, 0.0),
            (
                "the given speed",
                {height: 1.0, focal: -1.0, speed: 1.0},
                self._given_height,
                given_sigma,
            ),
            (
                "the given speed",
                {rig: 1.0, focal: 1.0, speed: -1.0},
                self._speed_ratio,
                given_sigma,
            ),
        ):
            if (measured := ratio.height_m) is not None:
                base = 0.0 if ratio is self._speed_ratio else self._log_height
                sigma = math.hypot(measured[1] / measured[0], other_sigma)
                evidence.append(Evidence(name, of, math.log(measured[0]) - base, sigma))
        return evidence

    @property
    def bounds(self) -> list[Evidence]:
        """The largest speed by stereo odometry, if no vehicle is as fast."""
        if self._max_mps <= MAX_MPS:
            return []
        log_factor = math.log(self._max_mps / MAX_MPS)
        of = {Unknown.BASELINE: 1.0, Unknown.FOCAL: 1.0}
        return [Evidence("the speed of the camera", of, log_factor, _MAX_MPS_SIGMA)]


class LaneEvidence:
    """Height of the camera by the usual width of a lane, from the opening of its lines."""

    def __init__(self, camera: PinholeCamera, lane: LaneWidth, height_m: float) -> None:
        """`height_m` is the assumed height of the camera above the road."""
        self._aspect, self._lane = camera.fy_px / camera.fx_px, lane
        self._log_height = math.log(height_m)
        self._log_openings: deque[float] = deque(maxlen=_MAX_VALUES)

    def add(self, seen: SeenFrame) -> None:
        """Add a frame."""
        left, right = seen.lanes.left, seen.lanes.right
        if left is None or right is None:
            return
        opening = float((right.coefficients - left.coefficients)[1])
        if opening > 0:
            self._log_openings.append(math.log(opening * self._aspect))

    @property
    def evidence(self) -> list[Evidence]:
        """The evidence of all frames so far."""
        if len(self._log_openings) < _MIN_LANES:
            return []
        log_height = math.log(self._lane.width_m) - float(np.median(self._log_openings))
        sigma = math.hypot(self._lane.sigma, _LANE_SIGMA)
        value = log_height - self._log_height
        of = {Unknown.HEIGHT: 1.0}
        return [Evidence("the lane lines", of, value, sigma, _MAX_LANE_CHI2)]


def _common(value: FloatArray, variance: FloatArray) -> tuple[float, float]:
    """Mean and standard deviation of the common part of the objects (K,), some of which are
    outliers.
    """
    sigma = np.sqrt(variance + _MIN_OBJECT_SIGMA**2)[:, None]
    difference = value[:, None] - _LOG
    near = (1 - _OUTLIER) / sigma * np.exp(-0.5 * (difference / sigma) ** 2)
    far = _OUTLIER / _OUTLIER_SIGMA * np.exp(-0.5 * (difference / _OUTLIER_SIGMA) ** 2)
    log_p = np.log(near + far).sum(axis=0)
    weight = np.exp(log_p - log_p.max())
    weight /= weight.sum()
    mean = float(weight @ _LOG)
    return mean, math.sqrt(float(weight @ (_LOG - mean) ** 2) + _STEP**2 / 12)
