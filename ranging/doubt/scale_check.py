r"""ScaleCheck: whether the given scales agree with everything in a drive that has a scale.

Unknowns, as logarithms of factors: the error g of the rig (its baseline), a of all distances by
size, h of the camera's height over the expected one, f of the focal length and u of the given
speed.

    log d_stereo - log d_size of the road users                      = g - a        own sizes, wrong matches
    log height of the camera over their contact points by size       = h + a
    log height by stereo odometry over the motion of the road        = g + h
    log height by the given speed over the motion of the road        = h - f + u    one camera
    log speed by stereo odometry - log given speed                   = g + f - u
    log height by the usual width of the lane, from its lines        = h
    log focal length - log f by the shapes of vehicles' boxes        = f
    log of an impossible speed by stereo odometry over the largest   < g + f

Every unknown has a prior: for a, the deviation of the region; for h, a usual or the given height;
for g, f and u, the precision of calibrations and receivers. Because all unknowns are estimated
together, a scale learnt from one of them cannot correct another in circles. One hypothesis is that
all priors hold; in each other hypothesis, one unknown is a mistake and has no prior. The scale is
in doubt if such a hypothesis fits better by `_DOUBTFUL`, the 3 sigma of one free parameter; all
hypotheses that fit nearly as well are named, weighed by how common such a mistake is
(`prior_cost`). A usual height and a usual lane have heavy tails, and alone exclude nothing: there
are lorries and robots.
"""

import itertools
import math
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from track_range.detection.lanes.lines import LaneLines
from track_range.foundation.arrays import FloatArray
from track_range.foundation.track_state import TrackState
from track_range.ranging.doubt.scale_doubt import (
    SHOWN_SIGMA,
    Agreement,
    Cause,
    Evidence,
    ScaleDoubt,
    prior_cost,
)
from track_range.ranging.fitting.camera.focal_evidence import FocalPosterior, focal_posterior
from track_range.ranging.fitting.camera.measurements import SceneBoxes, unhidden
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.lane_width import LaneWidth
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.ranging.size_models.region import Region
from track_range.ranging.size_models.size_model import SIZE_CLASSES, SizeModel, surface_offset_m
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.focal_guess import FocalGuess
from track_range.stereo.odometry.camera_height import CameraHeight
from track_range.stereo.odometry.ego_motion import Ego
from track_range.stereo.odometry.road_horizon import RoadView
from track_range.tracking.tracks import Tracks

_VIEW_INTERVAL_S = 1.5  # between two views of a vehicle: those of successive frames are alike
# times of measurements after the first frame, and until their results are used
_TIMES_S, _DELAY_S = (8.0, 40.0), 1.5
_NO_GUESS = 3.0  # standard deviation of the guess at which only the shapes count
# of sigma: the errors on 11 drives of KITTI's labels, 24 s each, are 1.09 sigma (rms)
_INFLATION = 1.15


class ShapeCheck:
    """Focal length by the shapes of vehicles (`focal_evidence`), measured at a few moments of a
    drive.

    A measurement takes about 0.7 s, in a thread; its result is used at a fixed time, so that runs
    are reproducible.
    """

    def __init__(self, camera: PinholeCamera, sizes: CuboidSizes) -> None:
        self._camera, self._sizes = camera, sizes
        self._views: list[SceneBoxes] = []
        self._view_due_s, self._times_s, self._first_s = -math.inf, list(_TIMES_S), math.nan
        self._future: Future[FocalPosterior] | None = None
        # log of the focal length over that by shapes; None = not measured
        self.evidence: Evidence | None = None

    def add(self, tracks: Tracks, time_s: float) -> None:
        """Add a frame."""
        self._first_s = time_s if math.isnan(self._first_s) else self._first_s
        if not self._times_s:
            return
        due_s = self._first_s + self._times_s[0]
        if self._future is not None and time_s >= due_s + _DELAY_S:
            posterior, self._future = self._future.result(), None
            del self._times_s[0]
            focal_px, sigma = posterior.guess
            if posterior.n_tracks:
                error = math.log(self._camera.fx_px / focal_px)
                self.evidence = Evidence(
                    posterior.shapes, (0, 0, 0, 1, 0), error, _INFLATION * sigma
                )
            return
        if time_s >= self._view_due_s:
            self._view_due_s = time_s + _VIEW_INTERVAL_S
            rows = np.flatnonzero(tracks.observed & unhidden(tracks.xyxy_px))
            self._views.append(
                SceneBoxes(tracks.xyxy_px[rows], tracks.class_id[rows], tracks.track_id[rows])
            )
        if self._future is None and time_s >= due_s:
            boxes, guess = (
                SceneBoxes.joined(self._views),
                FocalGuess(self._camera.fx_px, _NO_GUESS, ""),
            )
            thread = ThreadPoolExecutor(1, thread_name_prefix="shapes")
            self._future = thread.submit(
                focal_posterior, [guess], boxes, self._camera.size_px, self._sizes
            )
            thread.shutdown(wait=False)


_RIG, _SIZES, _HEIGHT, _FOCAL, _SPEED = range(5)  # unknowns
_CAUSES: dict[int, Cause] = {
    _RIG: "baseline",
    _FOCAL: "focal length",
    _SPEED: "speed",
    _HEIGHT: "camera height",
}
# of calibrations, and of the scale of receivers
_RIG_SIGMA, _FOCAL_SIGMA, _SPEED_SIGMA = 0.025, 0.02, 0.015
# if the region is known, and if it is not
_SIZES_SIGMA: dict[bool, float] = {True: 0.07, False: 0.085}
_HEIGHT_M, _HEIGHT_SIGMA = 1.45, 0.22  # usual height of cameras behind a windscreen
_GIVEN_SIGMA = 0.03  # of a given height
_KNOWN_FOCAL = 0.05  # largest sigma of a focal length that was not itself estimated from shapes
_ODOMETRY_SIGMA = 0.01  # of the scale of stereo odometry with a right rig
_LANE_SIGMA = 0.1  # of the opening of lane lines, in addition to the width of the lane
_FREE_SIGMA = 3.0  # of a mistake
# speed that vehicles hardly exceed, and the sigma of its logarithm
_MAX_MPS, _MAX_MPS_SIGMA = 45.0, 0.15
# frames of a speed, and its largest change: odometry of unrelated images is not steady
_N_STEADY, _STEADY = 8, 1.3
_DOUBTFUL, _RESOLVED = 9.0, 4.0  # differences of chi-squared at which a doubt starts and ends
_NEARLY = 4.0  # largest difference between causes that both fit
_TAILS = 4.0  # largest chi-squared of a usual height and of a usual lane
# fraction of objects with a mismatch or a wrong class, and their sigma
_OUTLIER, _OUTLIER_SIGMA = 0.1, 1.0
_MIN_OBJECT_SIGMA = 0.06  # of an object: its frames do not average out
# of sizes that objects have in common, and its largest fraction
_SHARED_VARIANCE, _MAX_SHARED = 0.07**2, 0.4
# of distances by size and of heights that are evidence, relative
_MAX_SIZE_SIGMA, _MAX_HEIGHT_SIGMA = 0.25, 0.2
_MIN_FRAMES, _MIN_OBJECTS, _MIN_LANES = 3, 2, 10
_INTERVAL_S = 0.5  # between two evaluations
_MAX_OBJECTS, _MAX_VALUES = 300, 600  # largest numbers that are kept
# lights and signs vary too much
_IS_EVIDENCE = np.array([not name.startswith("traffic") for name in SIZE_CLASSES])
_LANE = "the lane lines"
_EFFECT = (
    "Until the doubt is resolved, the sigmas of affected distances cover both scales, and no alarm "
    "is given."
)
_STEP = 0.02
_LOG = np.arange(-3.2, 3.2 + _STEP / 2, _STEP)  # (G,) grid of what objects have in common


class _Solution(NamedTuple):
    """The unknowns (5,) that fit the evidence best, their covariance, and chi-squared."""

    chi2: float
    x: FloatArray
    P: FloatArray


class ScaleCheck:
    """Likelihood of all scales of a drive; the state belongs to the instance."""

    def __init__(
        self,
        camera: PinholeCamera,
        *,
        baseline_m: float | None = None,
        region: Region = "unknown",
        height_m: float | None = None,
        focal_sigma: float = 0.0,
        lane: LaneWidth | None = None,
        sizes: SizeModel | None = None,
        road_height_m: float = _HEIGHT_M,
    ) -> None:
        """Start without evidence, for the left `camera` of a pair with a calibrated baseline; None
        = one camera.

        `height_m` is a given height above the road, None = a usual height; `road_height_m` is the
        height with which the motion of the road is measured. `focal_sigma` is relative, 0 =
        calibrated; `sizes` have the shapes of vehicles, which measure such a focal length. Without
        the usual width of the lane, lane lines are not used.
        """
        self.baseline_m, self._camera, self._lane = baseline_m, camera, lane
        self._height_m = height_m or _HEIGHT_M
        self._has_height = height_m is not None
        height_sigma = _GIVEN_SIGMA if self._has_height else _HEIGHT_SIGMA
        focal_sigma = math.hypot(_FOCAL_SIGMA, focal_sigma)
        sizes_sigma = _SIZES_SIGMA[region != "unknown"]
        self._priors = np.array([_RIG_SIGMA, sizes_sigma, height_sigma, focal_sigma, _SPEED_SIGMA])
        # number of frames, mean, mean variance of g - a, the same of h + a
        self._objects = TrackState(np.zeros(6))
        self._pair_height, self._given_height = (
            CameraHeight(road_height_m),
            CameraHeight(road_height_m),
        )
        # of stereo odometry and the given speed
        self._speed_ratio = CameraHeight(1.0, shared_sigma=_ODOMETRY_SIGMA)
        self._given_sigmas: deque[float] = deque(maxlen=_MAX_VALUES)
        self._log_openings: deque[float] = deque(maxlen=_MAX_VALUES)
        self._shapes = (
            ShapeCheck(camera, sizes)
            if isinstance(sizes, CuboidSizes) and focal_sigma <= _KNOWN_FOCAL
            else None
        )
        self._speeds_mps: deque[float] = deque(maxlen=_N_STEADY)
        self._max_mps = 0.0
        self._due_s = self._since_s = -math.inf
        # starts and ends of former doubts
        self._past_s: deque[tuple[float, float]] = deque(maxlen=_MAX_VALUES)
        self.doubt: ScaleDoubt | None = None  # the latest finding; None = no contradiction
        self.agreement = Agreement(1.0, math.inf, "")

    def update(
        self,
        tracks: Tracks,
        by_size: Ranges,
        by_rig: Ranges | None,
        *,
        ego: Ego,
        lanes: LaneLines | None = None,
        time_s: float,
    ) -> ScaleDoubt | None:
        """The contradiction after a frame, None = none was found: from distances by size (without
        the correction of the drive's scale) and with the scale of the rig, of its tracks.

        The speed of the camera comes from stereo odometry, from the motion of the road with the
        height `road_height_m`, and from the user.
        """
        self._add(tracks, by_size, by_rig, ego.road)
        if self._shapes is not None:
            self._shapes.add(tracks, time_s)
        if lanes is not None:
            self._add_lanes(lanes)
        self._add_speeds(ego, time_s)
        if time_s >= self._due_s:
            self._due_s = time_s + _INTERVAL_S
            self._evaluate(time_s)
        return self.doubt

    def _add_lanes(self, lanes: LaneLines) -> None:
        if lanes.left is None or lanes.right is None:
            return
        opening = float((lanes.right.coefficients - lanes.left.coefficients)[1])
        if opening > 0:
            self._log_openings.append(math.log(opening * self._camera.fy_px / self._camera.fx_px))

    def _add_speeds(self, ego: Ego, time_s: float) -> None:
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
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        spans = ", ".join(f"{start:.1f} to {end:.1f} s" for start, end in self._past_s)
        past = (
            (
                f"The scale was in doubt from {spans}: during this time, sigmas are wider and no "
                "alarms are given.",
            )
            if spans
            else ()
        )
        if self.doubt is not None:
            return (*past, f"{self.doubt.sentence(self.baseline_m)} {_EFFECT}")
        return past if self.baseline_m is None else (*past, self.agreement.sentence)

    def summary(self) -> dict[str, Any]:
        """Sections of summary.json."""
        sections: dict[str, Any] = {}
        if self.doubt is not None:
            sections["scale_doubt"] = {**self.doubt._asdict(), "causes": dict(self.doubt.causes)}
        if self.baseline_m is not None:
            _, sigma, evidence = self.agreement
            sections["baseline_check"] = {
                "sigma": sigma if sigma <= SHOWN_SIGMA else None,
                "evidence": evidence,
            }
        return sections

    def _add(
        self, tracks: Tracks, by_size: Ranges, stereo: Ranges | None, road: RoadView | None
    ) -> None:
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

    def _evidence(self) -> tuple[list[Evidence], int]:
        """All evidence so far, and the number of its road users."""
        evidence, expected = [], math.log(self._height_m)
        n, r, r_variance, n_q, q, q_variance = self._objects.known
        is_known, has_height = n >= _MIN_FRAMES, n_q >= _MIN_FRAMES
        n_objects = int((is_known | has_height).sum())
        if is_known.sum() >= _MIN_OBJECTS:
            sizes = _common(r[is_known], r_variance[is_known])
            evidence.append(
                Evidence(f"the sizes of {is_known.sum()} road users", (1, -1, 0, 0, 0), *sizes)
            )
        if has_height.sum() >= _MIN_OBJECTS:
            contacts = _common(q[has_height] - expected, q_variance[has_height])
            evidence.append(Evidence("where road users touch the road", (0, 1, 1, 0, 0), *contacts))
        given_sigma = float(np.median(self._given_sigmas)) if self._given_sigmas else 0.0
        for name, of, ratio, other_sigma in (
            ("the motion of the road", (1, 0, 1, 0, 0), self._pair_height, 0.0),
            ("the given speed", (0, 0, 1, -1, 1), self._given_height, given_sigma),
            ("the given speed", (1, 0, 0, 1, -1), self._speed_ratio, given_sigma),
        ):
            if (measured := ratio.height_m) is not None:
                base = 0.0 if ratio is self._speed_ratio else expected
                sigma = math.hypot(measured[1] / measured[0], other_sigma)
                evidence.append(Evidence(name, of, math.log(measured[0]) - base, sigma))
        if self._lane is not None and len(self._log_openings) >= _MIN_LANES:
            height = math.log(self._lane.width_m) - float(np.median(self._log_openings)) - expected
            evidence.append(
                Evidence(_LANE, (0, 0, 1, 0, 0), height, math.hypot(self._lane.sigma, _LANE_SIGMA))
            )
        if self._shapes is not None and (shapes := self._shapes.evidence) is not None:
            evidence.append(shapes)
        return evidence, n_objects

    def _evaluate(self, time_s: float) -> None:
        before, self.doubt = self.doubt, self._evaluated()
        if before is None and self.doubt is not None:
            self._since_s = time_s
        elif before is not None and self.doubt is None:
            self._past_s.append((self._since_s, time_s))

    def _evaluated(self) -> ScaleDoubt | None:
        evidence, n_objects = self._evidence()
        if not evidence and self._max_mps <= _MAX_MPS:
            return None
        height = f"{'the given' if self._has_height else 'a usual'} height of the camera"
        *first, last = dict.fromkeys((*(item.name for item in evidence), height))
        names = f"{', '.join(first)} and {last}" if first else last
        right, fits = self._fitted(evidence, self._priors), []
        for unknown, cause in _CAUSES.items():
            priors = self._priors.copy()
            priors[unknown] = _FREE_SIGMA
            chi2, x, P = self._fitted(evidence, priors)
            sigma = math.sqrt(P[unknown, unknown])
            if unknown == _RIG:
                self.agreement = Agreement(math.exp(x[_RIG]), sigma, names)
            factor = math.exp(x[unknown] if unknown != _HEIGHT else -x[unknown])
            if {
                _RIG: self.baseline_m is not None,
                _HEIGHT: self._has_height,
                _SPEED: bool(self._given_sigmas),
            }.get(unknown, True):
                fits.append((chi2 + prior_cost(cause, factor, sigma), cause, factor, sigma, chi2))
        if right.chi2 - min(chi2 for *_, chi2 in fits) < (
            _DOUBTFUL if self.doubt is None else _RESOLVED
        ):
            return None
        fits.sort()
        least, _, factor, sigma, _ = fits[0]
        near = tuple((cause, value) for cost, cause, value, *_ in fits if cost < least + _NEARLY)
        return ScaleDoubt(factor, sigma, n_objects, near, names)

    def _fitted(self, evidence: list[Evidence], priors: FloatArray) -> _Solution:
        """The best solution, with standard deviations (5,) of the priors; an unusual height or lane
        adds a cost.
        """
        unusual = priors.copy()
        unusual[_HEIGHT] = _FREE_SIGMA
        heights = [(priors, 0.0)] if self._has_height else [(priors, 0.0), (unusual, _TAILS)]
        lanes = [(evidence, 0.0), ([item for item in evidence if item.name != _LANE], _TAILS)]
        fits = []
        for (of_height, price), (used, lane_price) in itertools.product(heights, lanes):
            solution = _solved(used, of_height)
            speed = math.log(max(self._max_mps, 1.0) / _MAX_MPS)
            if speed > solution.x[_RIG] + solution.x[_FOCAL]:
                too_fast = Evidence("", (1, 0, 0, 1, 0), speed, _MAX_MPS_SIGMA)
                solution = _solved([*used, too_fast], of_height)
            fits.append(solution._replace(chi2=solution.chi2 + price + lane_price))
        return min(fits, key=lambda solution: solution.chi2)


def _solved(evidence: list[Evidence], priors: FloatArray) -> _Solution:
    sigma = np.array([*priors, *(item.sigma for item in evidence)])
    A = (
        np.concatenate([np.eye(5), np.reshape([item.of for item in evidence], (-1, 5))])
        / sigma[:, None]
    )
    b = np.array([*np.zeros(5), *(item.value for item in evidence)]) / sigma
    P = np.linalg.inv(A.T @ A)
    x = P @ (A.T @ b)
    residual = A @ x - b
    return _Solution(float(residual @ residual), x, P)


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
