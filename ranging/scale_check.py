r"""ScaleCheck: whether the scale of a calibrated pair agrees with everything else in a drive that has a scale.

    g   log of the factor by which the rig makes distances too long
    a   log of the error that all distances by size of the drive share                     N(0, sizes^2)
    h   log of the height of the camera                  N(typical or given height), or that of the measured speed

    r_k = log d_stereo - log d_size of object k  =  g - a + e_k                             e_k: its own size
    q_k = log of the height of the camera over the contact point of k by stereo  =  g + h + e'_k
    v_max / exp(g) is a speed of road vehicles,        v: ego speed by stereo odometry

Each object counts once, with the average of its frames; some are matches on another object or have the wrong class, so
that their errors have wide tails. a and h are integrated out, so that they cannot correct the rig in circles. The prior
of g is mostly that of a calibrated rig, and for a small part that of any mistake of the baseline: inches read as
centimetres, squares of another size. The rig is in doubt if the posterior excludes the first. A wrong focal length
changes distances by size and by stereo alike, and is not found.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from track_range.foundation.arrays import FloatArray
from track_range.foundation.track_state import TrackState
from track_range.ranging.ranges import Ranges
from track_range.ranging.region import Region
from track_range.ranging.size_models.size_model import SIZE_CLASSES, surface_offset_m
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.road_horizon import RoadView
from track_range.tracking.tracks import Tracks

_STEP = 0.01  # of the grid of log factors
_LOG = np.arange(-3.2, 3.2 + _STEP / 2, _STEP)  # (G,) log factors g: baselines from 1/25 to 25 times the true one
_RIG_SIGMA = 0.03  # of g of a rig that is calibrated
_MISTAKE = 0.02  # prior probability of a mistake, with any g
_SIZES_SIGMA: dict[bool, float] = {True: 0.07, False: 0.085}  # of a, if the region is known, and if it is not
_HEIGHT_M, _HEIGHT_SIGMA = 1.45, 0.22  # typical height of cameras behind a windscreen, and its relative sigma
_GIVEN_SIGMA = 0.03  # relative sigma of a given or measured height
_WRONG = 0.03  # probability that a given height, or a speed, is itself a mistake
_OUTLIER, _OUTLIER_SIGMA = 0.1, 1.0  # fraction of objects with a mismatch or a wrong class, and their sigma
_MIN_OBJECT_SIGMA = 0.08  # of r_k and q_k: frames of an object do not average out
_MAX_MPS, _MPS_SIGMA = 45.0, 0.15  # speed that vehicles hardly exceed, and the sigma of its logarithm
_MIN_MPS = 3.0  # smallest ego speed that is evidence
_MIN_OBJECTS = 2
_MAX_SIZE_SIGMA, _MAX_HEIGHT_SIGMA = 0.25, 0.2  # of distances by size and of heights that are evidence, relative
_DOUBTFUL = 0.01  # posterior probability of a calibrated rig below which it is in doubt
_INTERVAL_S = 0.5  # between two evaluations
_MAX_OBJECTS = 300
_IS_EVIDENCE = np.array([not name.startswith("traffic") for name in SIZE_CLASSES])  # lights and signs vary too much


class ScaleDoubt(NamedTuple):
    """A rig whose scale contradicts the drive."""

    factor: float  # by which its distances are too long
    sigma: float  # relative standard deviation of the factor
    n_objects: int  # road users that show it

    @property
    def shared_sigma(self) -> float:
        """Relative standard deviation of distances by the rig that covers both: its scale, and that of the drive."""
        return abs(1.0 - 1.0 / self.factor) + self.sigma / self.factor

    def sentence(self, baseline_m: float) -> str:
        """Note for the user, with the causes that fit."""
        fits = [text for factor, text in _CAUSES if abs(math.log(factor / self.factor)) < 2.0 * self.sigma]
        causes = "; ".join((*fits, f"squares of the calibration given {self.factor:.2g} times as large as they were"))
        return (
            f"Scale in doubt: distances of the rig are {self.factor:.2f} times (± {100 * self.sigma:.0f} %) what the "
            f"drive shows, by the sizes of {self.n_objects} road users, the height of the camera and the speed as far "
            f"as they are known: the baseline of {baseline_m:.3g} m would be {baseline_m / self.factor:.3g} m. Causes "
            f"that fit: {causes}. Check the rig; until then the sigmas of stereo, sgbm and fused cover both, and there "
            "are no warnings."
        )


_CAUSES = (
    (2.54, "centimetres read as inches"),
    (1 / 2.54, "inches read as centimetres"),
    (3.281, "feet read as metres"),
    (0.3048, "metres read as feet"),
    (10.0, "millimetres read as centimetres"),
    (0.1, "centimetres read as millimetres"),
)
"""Mistakes by the factor that they multiply distances with."""


_N_ROWS = 6  # of the state of an object: number of frames, mean r, its mean variance, and the same of q


class ScaleCheck:
    """Likelihood of the scale of a rig over the drive; the state belongs to the instance."""

    def __init__(self, camera: PinholeCamera, *, region: Region = "unknown", height_m: float | None = None) -> None:
        """Start without evidence; `camera` is the left one, `height_m` its given height above the road."""
        self._camera = camera
        self._sizes_sigma = _SIZES_SIGMA[region != "unknown"]
        self._height = (_HEIGHT_M, _HEIGHT_SIGMA) if height_m is None else (height_m, _GIVEN_SIGMA)
        self._has_height = height_m is not None
        self._objects = TrackState(np.zeros(_N_ROWS))
        self._max_mps = 0.0
        self._due_s = -math.inf
        self.doubt: ScaleDoubt | None = None  # the latest finding; None = no contradiction

    def update(
        self,
        tracks: Tracks,
        by_size: Ranges,
        stereo: Ranges,
        *,
        time_s: float,
        road: RoadView | None = None,
        speed_mps: float = math.nan,
        is_speed_by_stereo: bool = False,
    ) -> None:
        """Add a frame: distances by size (without the correction of the drive's scale) and by stereo of its tracks.

        `road` is the road in the frame by image motion, with the height of the camera by the ego speed. Of a speed that
        the pair itself measures, the height has the error of the rig, and shows nothing about it.
        """
        self._add(tracks, by_size, stereo, road)
        if is_speed_by_stereo:
            self._max_mps = max(self._max_mps, speed_mps if speed_mps >= _MIN_MPS else 0.0)
        elif road is not None and road.height_m is not None and not self._has_height:
            self._height = road.height_m[0], math.hypot(_GIVEN_SIGMA, road.height_m[1] / road.height_m[0])
        if time_s >= self._due_s:
            self._due_s = time_s + _INTERVAL_S
            self.doubt = self._evaluated()

    def _add(self, tracks: Tracks, by_size: Ranges, stereo: Ranges, road: RoadView | None) -> None:
        with np.errstate(invalid="ignore", divide="ignore"):
            size_sigma, sigma = by_size.sigma_m / by_size.distance_m, stereo.sigma_m / stereo.distance_m
            r = np.log(stereo.distance_m / by_size.distance_m)
            is_used = tracks.observed & _IS_EVIDENCE[tracks.class_id] & (size_sigma < _MAX_SIZE_SIGMA) & np.isfinite(r)
            q, variance = np.full((2, len(tracks)), np.nan)
            if road is not None:
                x = (tracks.xyxy_px[:, 0] + tracks.xyxy_px[:, 2]) / 2
                horizon = road.horizon + road.slope * (x - self._camera.cx_px) / self._camera.fx_px
                below = (tracks.xyxy_px[:, 3] - self._camera.cy_px) / self._camera.fy_px - horizon
                offset_m = surface_offset_m(tracks.xyxy_px, tracks.class_id, has_visible_boxes=True)
                q = np.log(below * (stereo.distance_m - offset_m))
                angle_variance = road.horizon_variance + 0.004**2 + (1.5 / self._camera.fy_px) ** 2
                variance = angle_variance / below**2 + sigma**2
        has_height = is_used & np.isfinite(q) & (variance < _MAX_HEIGHT_SIGMA**2)
        new = np.array([is_used, r, size_sigma**2 + sigma**2, has_height, q, variance])
        state = self._objects.get(tracks.track_id)
        for rows in (slice(0, 3), slice(3, 6)):
            n, *values = new[rows]
            state[rows][0] += n
            gain = n / np.maximum(state[rows][0], 1.0)
            for mean, value in zip(state[rows][1:], values, strict=True):
                mean += gain * (np.where(n > 0, value, 0.0) - mean)
        stays = np.arange(self._objects.known.shape[1]) < _MAX_OBJECTS
        self._objects.put(tracks.track_id, state, keep_known=stays)

    def _evaluated(self) -> ScaleDoubt | None:
        n, r, r_variance, n_q, q, q_variance = self._objects.known
        is_known, has_height = n >= 3, n_q >= 3
        if is_known.sum() < _MIN_OBJECTS:
            return None
        log_p = np.log(_blurred(_joint(r[is_known], r_variance[is_known]), self._sizes_sigma))
        if has_height.sum() >= _MIN_OBJECTS:
            over_height = _joint(q[has_height] - math.log(self._height[0]), q_variance[has_height])
            usual = _blurred(over_height, self._height[1])
            log_p += np.log((1 - _WRONG) * usual / usual.sum() + _WRONG / len(_LOG))
        if self._max_mps:
            excess = (math.log(self._max_mps / _MAX_MPS) - _LOG) / _MPS_SIGMA
            log_p -= 0.5 * np.maximum(excess, 0.0) ** 2
        likelihood = np.exp(log_p - log_p.max())
        right = np.exp(-0.5 * (_LOG / _RIG_SIGMA) ** 2)
        of_right = (1 - _MISTAKE) * float(likelihood @ right) / float(right.sum())
        of_mistake = _MISTAKE * float(likelihood.mean())
        if of_right > _DOUBTFUL * (of_right + of_mistake):
            return None
        weight = likelihood / likelihood.sum()
        mean = float(weight @ _LOG)
        sigma = math.sqrt(float(weight @ (_LOG - mean) ** 2))
        return ScaleDoubt(math.exp(mean), sigma, int(is_known.sum()))


def _joint(value: FloatArray, variance: FloatArray) -> FloatArray:
    """(G,) likelihood that all objects (K,) have the common value of each grid point; its maximum is 1."""
    sigma = np.sqrt(variance + _MIN_OBJECT_SIGMA**2)[:, None]
    difference = value[:, None] - _LOG
    near = (1 - _OUTLIER) / sigma * np.exp(-0.5 * (difference / sigma) ** 2)
    far = _OUTLIER / _OUTLIER_SIGMA * np.exp(-0.5 * (difference / _OUTLIER_SIGMA) ** 2)
    log_p = np.log(near + far).sum(axis=0)
    return np.asarray(np.exp(log_p - log_p.max()))


def _blurred(likelihood: FloatArray, sigma: float) -> FloatArray:
    """(G,) the likelihood of a sum with a normal unknown, which is integrated out."""
    return np.maximum(gaussian_filter1d(likelihood, sigma / _STEP, mode="constant"), 1e-300)
