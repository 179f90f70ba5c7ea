"""Evidence of the scale of a drive: sizes and contact points of road users, speeds, and lanes."""

import math
from collections import deque

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.track_state import TrackState
from track_range.ranging.cameras.common_errors import (
    OFFSET_SIGMA_PX,
    common_errors,
    common_scale,
)
from track_range.ranging.cameras.evidence import Evidence, SeenFrame
from track_range.ranging.cameras.posterior import posterior
from track_range.ranging.cameras.unknowns import USUAL_HEIGHT_M, CameraPriors, Sum, Unknown
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.ground_plane import GroundSettings
from track_range.ranging.methods.lane_width import LaneWidth
from track_range.ranging.size_models.shared_sizes import CLASS_SIGMA, shared_variance
from track_range.ranging.size_models.size_model import SIZE_CLASSES, surface_offset_m
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.odometry.camera_height import CameraHeight

# of the scale of stereo odometry with a right rig, and of the motion of the road
_ODOMETRY_SIGMA, _ROAD_SIGMA = 0.01, 0.02
_GIVEN_SPEED = "the given speed"  # name of its evidence
# of which unknowns the sum is what speeds by stereo odometry are too large by, over given ones, and
# what heights by given speeds and the motion of the road are
_BY_PAIR: Sum = {
    Unknown.BASELINE: 1.0,
    Unknown.FOCAL: 1.0,
    Unknown.SPEED: -1.0,
    Unknown.FRAME_RATE: 1.0,
}
_BY_ROAD: Sum = {
    Unknown.HEIGHT: 1.0,
    Unknown.FOCAL: -1.0,
    Unknown.SPEED: 1.0,
    Unknown.FRAME_RATE: -1.0,
}
# The bound of a height that is not given: vehicles are at most 4 m high, and cameras not higher.
HIGHEST = Evidence(
    "the height of vehicles", {Unknown.HEIGHT: -1.0}, math.log(USUAL_HEIGHT_M / 4.0), 0.1
)
_LANE_SIGMA = 0.1  # of the opening of lane lines, in addition to the width of the lane
_MAX_LANE_CHI2 = 4.0  # a wrong lane, or a road of unusual lanes, excludes nothing alone
# speed that vehicles hardly exceed, and the sigma of its logarithm
MAX_MPS, _MAX_MPS_SIGMA = 45.0, 0.15
# frames of a speed, and its largest change: odometry of unrelated images is not steady
_N_STEADY, _STEADY = 8, 1.3
_MAX_RESIDUAL_PX = 0.3  # common error of disparities up to which it is not estimated here
# of distances by size and of heights that are evidence, relative
_MAX_SIZE_SIGMA, _MAX_HEIGHT_SIGMA = 0.25, 0.2
_PITCH_RAD = 0.004  # of the horizon from image motion: what is new in every frame
_MAX_OF_HORIZON = 0.3  # largest relative error of a height by the horizon
# of heights, of all contact points of a drive, relative: the crown of streets with slopes of 2 %,
# lower edges of a detector's boxes
_CONTACT_SIGMA = 0.04
_MIN_FRAMES, _MIN_OBJECTS, _MIN_LANES = 3, 2, 10
_MAX_OBJECTS, _MAX_VALUES = 300, 600  # largest numbers that are kept
# lights and signs vary too much
_IS_EVIDENCE = np.array([not name.startswith("traffic") for name in SIZE_CLASSES])


class SizeEvidence:
    """Distances by the rig, and heights of the camera over contact points, against distances by
    size.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        height_m: float,
        *,
        rig: StereoRig | None = None,
    ) -> None:
        """`height_m` is the assumed height of the camera above the road; without the rig of a pair,
        its disparities have no common error.
        """
        self._camera, self._rig = camera, rig
        self._ground = GroundSettings()
        self._log_height = math.log(height_m)
        # number of frames, mean of g - a, its mean variance, mean inverse disparity; number of
        # frames, mean of h + a, its mean variance, mean effect of the horizon's error; class
        self._objects = TrackState(np.zeros(9))
        self.residual_px = 0.0  # common error of the disparities, by the alignment

    @property
    def n_objects(self) -> int:
        """Number of road users that are evidence."""
        return int((self._objects.known[[0, 4]] >= self._min_frames).any(axis=0).sum())

    @property
    def _min_frames(self) -> int:
        """Number of frames after which a road user is evidence: one where much is not known, as of
        single pairs.
        """
        is_assumed = self._rig is not None and self._rig.is_assumed
        return 1 if is_assumed or self.has_offset else _MIN_FRAMES

    @property
    def has_offset(self) -> bool:
        """Whether the disparities may have an offset that distances by size show."""
        return self.residual_px > _MAX_RESIDUAL_PX

    def add(self, seen: SeenFrame) -> None:
        """Add a frame."""
        tracks, by_size, stereo, road = seen.tracks, seen.by_size, seen.by_rig, seen.ego.road
        if self._rig is not None:
            known = seen.alignment or self._rig.alignment or self._rig.unaligned
            self.residual_px = known.residual_px
        with np.errstate(invalid="ignore", divide="ignore"):
            size_sigma = by_size.sigma_m / by_size.distance_m
            is_used = (
                tracks.observed & _IS_EVIDENCE[tracks.class_id] & (size_sigma < _MAX_SIZE_SIGMA)
            )
            size_variance = size_sigma**2 - shared_variance(size_sigma**2)
            r, r_variance, inverse_px, q, q_variance, q_common = np.full((6, len(tracks)), np.nan)
            if stereo is not None:
                r = np.log(stereo.distance_m / by_size.distance_m)
                inverse_px = self._inverse_px(stereo)
                common = self.residual_px * inverse_px
                stereo_variance = (stereo.sigma_m / stereo.distance_m) ** 2 - common**2
                r_variance = size_variance + np.maximum(stereo_variance, 0.0)
            if road is not None:
                x = (tracks.xyxy_px[:, 0] + tracks.xyxy_px[:, 2]) / 2
                bearing = (x - self._camera.cx_px) / self._camera.fx_px
                horizon = road.horizon + road.slope * bearing
                below = (tracks.xyxy_px[:, 3] - self._camera.cy_px) / self._camera.fy_px - horizon
                offset_m = surface_offset_m(tracks.xyxy_px, tracks.class_id, has_visible_boxes=True)
                contact_m = by_size.distance_m - offset_m
                q = np.log(below * contact_m)
                q_common = math.sqrt(road.horizon_variance + self._ground.road_sigma_rad**2) / below
                own = math.hypot(_PITCH_RAD, self._ground.box_sigma_px / self._camera.fy_px) / below
                right, ahead = road.across
                across_m = contact_m * (ahead + right * bearing)
                place = self._ground.place_sigma_m(across_m) / (below * contact_m)
                q_variance = own**2 + place**2 + size_variance
        has_rig = is_used & np.isfinite(r) & np.isfinite(inverse_px)
        is_near = (q_variance < _MAX_HEIGHT_SIGMA**2) & (q_common < _MAX_OF_HORIZON)
        has_height = is_used & np.isfinite(q) & is_near
        new = np.array([has_rig, r, r_variance, inverse_px, has_height, q, q_variance, q_common])
        state = self._objects.get(tracks.track_id)
        # (2, 4, N): by the rig and by contact points, each a number of frames and three means
        before, added = state[:8].reshape(2, 4, -1), new.reshape(2, 4, -1)
        n = added[:, :1]
        before[:, :1] += n
        values = np.where(n > 0, added[:, 1:], 0.0)
        before[:, 1:] += n / np.maximum(before[:, :1], 1.0) * (values - before[:, 1:])
        state[8] = tracks.class_id
        stays = np.arange(self._objects.known.shape[1]) < _MAX_OBJECTS
        self._objects.put(tracks.track_id, state, keep_known=stays)

    def _inverse_px(self, stereo: Ranges) -> FloatArray:
        """(N,) inverse disparities; 0 without a rig."""
        if self._rig is None:
            return 0.0 * stereo.distance_m
        return stereo.distance_m / (self._rig.left.fx_px * self._rig.baseline_m)

    @property
    def evidence(self) -> list[Evidence]:
        """The evidence of all frames so far."""
        n, r, r_variance, inverse_px, n_q, q, q_variance, q_common, class_id = self._objects.known
        evidence = []
        shown = np.flatnonzero(n >= self._min_frames)
        if len(shown) >= _MIN_OBJECTS:
            name = f"the sizes of {len(shown)} road users"
            values = r[shown], r_variance[shown], inverse_px[shown], class_id[shown]
            if self.has_offset:
                evidence += _with_offset(name, *values)
            else:
                variance = values[1] + (self.residual_px * values[2]) ** 2
                of: Sum = {Unknown.BASELINE: 1.0, Unknown.SIZES: -1.0}
                evidence += _by_class(name, of, values[0], variance, values[3])
        shown = np.flatnonzero(n_q >= self._min_frames)
        if len(shown) >= _MIN_OBJECTS:
            heights = q[shown] - self._log_height, q_variance[shown], q_common[shown]
            evidence.append(_of_contacts(*heights, class_id[shown]))
        return evidence


def _by_class(
    name: str,
    of: Sum,
    value: FloatArray,
    variance: FloatArray,
    class_id: FloatArray,
) -> list[Evidence]:
    """The evidence of each class of objects (K,), which has an error of its own."""
    evidence = []
    for k in np.unique(class_id):
        mean, sigma = common_scale(value[class_id == k], variance[class_id == k])
        evidence.append(Evidence(name, of, mean, math.hypot(sigma, CLASS_SIGMA)))
    return evidence


def _of_contacts(
    value: FloatArray, variance: FloatArray, of_horizon: FloatArray, class_id: IntArray
) -> Evidence:
    """The evidence of heights over the contact points of objects (K,), which the lasting error of
    the horizon changes by `of_horizon` (K,), relative standard deviations.
    """
    shared_variance = CLASS_SIGMA**2 / len(np.unique(class_id)) + _CONTACT_SIGMA**2
    # an offset with the standard deviation that `common_errors` takes, in units of it
    inverse = of_horizon / OFFSET_SIGMA_PX
    errors = common_errors(value, variance, inverse, shared_variance=shared_variance)
    sigma = math.sqrt(np.linalg.inv(errors.information)[0, 0])
    of: Sum = {Unknown.HEIGHT: 1.0, Unknown.SIZES: 1.0}
    return Evidence("the points where road users touch the road", of, float(errors.mean[0]), sigma)


def _with_offset(
    name: str,
    value: FloatArray,
    variance: FloatArray,
    inverse_px: FloatArray,
    class_id: FloatArray,
) -> list[Evidence]:
    """The evidence of objects (K,) whose disparities have an unknown offset."""
    class_variance = CLASS_SIGMA**2 / len(np.unique(class_id))
    errors = common_errors(value, variance, inverse_px, shared_variance=class_variance)
    rig, sizes, offset = Unknown.BASELINE, Unknown.SIZES, Unknown.OFFSET
    return [
        Evidence(name, {rig: scale, sizes: -scale, offset: of_offset}, result, 1.0)
        for scale, of_offset, result in errors.equations()
    ]


class SpeedEvidence:
    """Speeds by stereo odometry, by the motion of the road, and as given, against one another."""

    def __init__(self, height_m: float, road_height_m: float) -> None:
        """`height_m` is the assumed height of the camera above the road, `road_height_m` the one
        with which the motion of the road is measured.
        """
        self._log_height = math.log(height_m)
        self._pair_height = CameraHeight(road_height_m)
        self._log_road_height = math.log(road_height_m)
        # logarithm of given over measured speed, its standard deviation, and whether the road
        # measured it
        self._given: tuple[float, float, bool] | None = None
        self._given_sigmas: deque[float] = deque(maxlen=_MAX_VALUES)
        self._speeds_mps: deque[float] = deque(maxlen=_N_STEADY)
        self._max_mps = 1.0

    def add(self, seen: SeenFrame) -> None:
        """Add a frame."""
        ego, time_s = seen.ego, seen.time_s
        by_pair, by_road, given = ego.by_pair, ego.by_road, ego.given
        if by_pair is not None:
            self._speeds_mps.append(by_pair.speed_mps)
            low_mps, high_mps = min(self._speeds_mps), max(self._speeds_mps)
            is_known = len(self._speeds_mps) == _N_STEADY and math.isfinite(sum(self._speeds_mps))
            if is_known and high_mps < _STEADY * low_mps:
                self._max_mps = max(self._max_mps, low_mps)
            if by_road is not None:
                self._pair_height.update(time_s, by_pair, by_road)
        if given is not None and math.isfinite(given.speed_mps):
            self._given_sigmas.append(given.speed_sigma_mps / max(abs(given.speed_mps), 0.1))
        if ego.speed_ratio is not None:
            self._given = *ego.speed_ratio, by_pair is None

    @property
    def evidence(self) -> list[Evidence]:
        """The evidence of all frames so far."""
        evidence = []
        if (measured := self._pair_height.height_m) is not None:
            value = math.log(measured[0]) - self._log_height
            of: Sum = {Unknown.BASELINE: 1.0, Unknown.HEIGHT: 1.0}
            sigma = measured[1] / measured[0]
            evidence.append(Evidence("the motion of the road", of, value, sigma))
        if self._given is not None:
            evidence.append(self._of_given(*self._given))
        return evidence

    def _of_given(self, log_ratio: float, sigma: float, by_road: bool) -> Evidence:
        """The ratio of the given to the measured speed."""
        given_sigma = float(np.median(self._given_sigmas)) if self._given_sigmas else 0.0
        if by_road:
            value = log_ratio + self._log_road_height - self._log_height
            return height_by_speed(value, math.hypot(sigma, given_sigma))
        sigma = math.hypot(sigma, given_sigma, _ODOMETRY_SIGMA)
        return Evidence(_GIVEN_SPEED, _BY_PAIR, -log_ratio, sigma)

    @property
    def bounds(self) -> list[Evidence]:
        """The largest speed by stereo odometry, if no vehicle is as fast."""
        if self._max_mps <= MAX_MPS:
            return []
        log_factor = math.log(self._max_mps / MAX_MPS)
        of: Sum = {Unknown.BASELINE: 1.0, Unknown.FOCAL: 1.0, Unknown.FRAME_RATE: 1.0}
        return [Evidence("the speed of the camera", of, log_factor, _MAX_MPS_SIGMA)]


def height_by_speed(value: float, sigma: float) -> Evidence:
    """The height of a camera by its given speed and the motion of the road, which has the scale of
    this height: the logarithm of the height over the assumed one, at the assumed focal length.
    """
    return Evidence(_GIVEN_SPEED, _BY_ROAD, value, math.hypot(sigma, _ROAD_SIGMA))


def speed_ratio_sigma(priors: CameraPriors) -> float:
    """Relative standard deviation of a given speed over that by the images before a drive, beside
    the unknowns that the drive has to show.
    """
    of, sigma = (_BY_ROAD, _ROAD_SIGMA)
    if Unknown.BASELINE in priors:
        of, sigma = (_BY_PAIR, _ODOMETRY_SIGMA)
    known = {k: v for k, v in of.items() if k in priors and priors[k].kind != "unknown"}
    return math.hypot(posterior(priors, []).sigma_of(known), sigma)


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
        of: Sum = {Unknown.HEIGHT: 1.0}
        return [Evidence("the lane lines", of, value, sigma, _MAX_LANE_CHI2)]
