r"""RelativeFit: scale and shift of a network whose inverse depths are right up to both, by other
methods' distances.

    q_i = s / d_i + t + s e_i / d_i        q_i: the network's value at object i, d_i: its distance
                                           e_i: relative error of both, with variance r^2 + sigma_i^2

s and t are the least-squares solution of all objects of the last seconds, with Cauchy weights,
since networks of this kind choose other ones in every image. The spread of the residuals beyond the
reference's errors is r, the network's own error.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from track_range.foundation.arrays import FloatArray

_MEMORY_S = 1.0  # time over which scale and shift change
_CORRELATED_S = 0.5  # over which the errors of an object are the same
_N_ROUNDS, _CAUCHY_SIGMA = 3, 2.0  # of reweighting; scale of the weights in sigmas
_OWN_SIGMA, _N_OBJECTS_BEFORE = 0.1, 4.0  # r before a drive, and its weight in objects
_MIN_OBJECTS, _MAX_OBJECTS = 3, 400
_MIN_RATIO = 1.3  # of the farthest and the nearest reference, without which the shift is not known
_USELESS = 1.0  # relative sigma above which an object is not measured


@dataclass(slots=True)
class RelativeFit:
    """Scale and shift of a drive; the state belongs to the instance."""

    # (4, K) values q, inverse distances, relative variances of the references, times
    _seen: FloatArray = field(default_factory=lambda: np.zeros((4, 0)))
    _own_sigma: float = _OWN_SIGMA  # r
    # means of s and t, and their covariance; None = not known
    _fit: tuple[FloatArray, FloatArray] | None = None

    @property
    def is_used(self) -> bool:
        """Whether any references were seen."""
        return bool(self._seen.size)

    def update(
        self, q: FloatArray, distance_m: FloatArray, sigma_m: FloatArray, time_s: float
    ) -> None:
        """Take the references of a frame into account: values, distances and sigmas (N,), NaN =
        none.
        """
        known = np.isfinite(q) & np.isfinite(distance_m) & (sigma_m < 0.25 * distance_m)
        d, times = distance_m[known], np.full(int(known.sum()), time_s)
        new = np.array([q[known], 1.0 / d, (sigma_m[known] / d) ** 2, times])
        recent = self._seen[:, time_s - self._seen[3] < 3 * _MEMORY_S]
        self._seen = np.concatenate([new, recent], axis=1)[:, :_MAX_OBJECTS]
        values, inverse, variance, seen_s = self._seen
        is_now = time_s - seen_s < _CORRELATED_S
        ratio = inverse.max(initial=0.0) / inverse.min(initial=np.inf)
        if is_now.sum() < _MIN_OBJECTS or ratio < _MIN_RATIO:
            self._fit = None
            return
        A = np.stack([inverse, np.ones(len(inverse))], axis=1)
        # objects are seen about as often as there are frames within the correlation
        n_frames = max(len(np.unique(seen_s[is_now])), 1)
        age = np.exp((seen_s - time_s) / _MEMORY_S) / n_frames
        robust, scale = np.ones(len(values)), 1.0
        for _ in range(_N_ROUNDS):
            total = (variance + self._own_sigma**2) * inverse**2
            information = age * robust / total
            inv = np.linalg.pinv((A.T * information) @ A)
            x = inv @ (A.T @ (information * values))
            scale = max(float(x[0]), 1e-9)
            residual2 = ((values - A @ x) / (scale * inverse)) ** 2
            robust = 1.0 / (1.0 + residual2 / (variance + self._own_sigma**2) / _CAUCHY_SIGMA**2)
            share = age * robust
            own = _N_OBJECTS_BEFORE * _OWN_SIGMA**2 + (share * (residual2 - variance)).sum()
            own /= _N_OBJECTS_BEFORE + share.sum()
            self._own_sigma = math.sqrt(max(own, 0.02**2))
        self._fit = (x, inv * scale**2) if x[0] > 0 else None

    def distances(self, q: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N,) distances and their sigmas in m of values with sigmas (N,); NaN = not known."""
        if self._fit is None:
            return np.full(len(q), np.nan), np.full(len(q), np.nan)
        (s, t), P = self._fit
        inverse = (q - t) / s
        inverse = np.where(inverse > 0, inverse, np.nan)
        variance = (P[0, 0] * inverse**2 + 2 * P[0, 1] * inverse + P[1, 1] + sigma**2) / s**2
        relative = np.sqrt(variance / inverse**2 + self._own_sigma**2)
        distance_m = np.where(relative < _USELESS, 1.0 / inverse, np.nan)
        return distance_m, relative * distance_m
