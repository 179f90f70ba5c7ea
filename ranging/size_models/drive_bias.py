r"""DriveBias: error of the distances by size that all objects of a drive share, and its uncertainty.

    log d_i - log s_i = a + c_k + e_i + n_it        d_i: reference distance of object i, s_i: its distance by size

a is common to all classes (focal length, detector), c_k to the objects of class k (cars differ between streets and
countries), e_i belongs to the object, n_it to the frame. a and c_k have normal priors; e_i has the systematic sigma of
the distance by size without the part that a drive shares. Each track is one measurement: the average of its frames by
information, in which errors are correlated over `_CORRELATED_S`. The estimate is the posterior mean over all tracks
(ridge regression) with Cauchy weights, since vans are detected as cars and contact points are hidden.

Distances by size are multiplied by exp(a + c_k). Their sigma has the variance of the bias in place of its prior one: it
shrinks as evidence comes, first that of other classes, then that of the class. A reference that is not used elsewhere
(`is_own` of `learn`) also corrects its own track, by the posterior mean of a + c_k + e_i.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.track_state import TrackState
from track_range.ranging.ranges import Ranges
from track_range.ranging.size_models.size_model import SIZE_CLASSES

_COMMON_SIGMA, _CLASS_SIGMA = 0.03, 0.05
"""Standard deviations of a and c_k: together 0.06, as biases of mono on whole KITTI drives are -12 to +9 %."""

_PRIOR_VARIANCE = _COMMON_SIGMA**2 + _CLASS_SIGMA**2

_MAX_SHARED = 0.3
"""Largest share of the systematic variance of a distance by size that the drive is taken to cause."""

_CORRELATED_S = 0.5
"""Time over which the errors of a track's frames are correlated: pitch, and boxes of a detector."""

_MEMORY_S = 180.0
"""Time constant with which tracks are forgotten: streets change."""

_OWN_S = 5.0
"""Time for which a track without references stays corrected by its own ones."""

_MAX_TRACKS = 400
"""Largest number of tracks; more do not change the estimate."""

_N_ROUNDS, _CAUCHY_SIGMA = 3, 2.0
"""Rounds of reweighting, and scale of the weights 1 / (1 + (residual / scale)^2) in standard deviations."""

_MAX_LOG_RATIO = 0.5
"""Largest difference of log distance that is evidence; larger ones are mistakes."""


class _Columns(NamedTuple):
    """Numbers stored per track, (K,) each."""

    information: FloatArray
    weighted_ratio: FloatArray
    own_variance: FloatArray
    time_s: FloatArray


@dataclass(frozen=True, slots=True)
class BiasOfClass:
    """Bias of a class: log of the factor of its distances, and its standard deviation."""

    log_factor: float
    sigma: float


class DriveBias:
    """Estimator of the bias of distances by size; the state belongs to one drive."""

    def __init__(self) -> None:
        self._ids = np.zeros(0, np.int64)
        self._class_id = np.zeros(0, np.int64)
        self._tracks = _Columns(*np.zeros((4, 0)))
        self._own = TrackState(np.zeros(3))
        """By track: information of the references that correct it, their weighted log ratio, time of the last one."""
        self._by_size: tuple[Ranges, IntArray] | None = None
        self._time_s = 0.0
        self._last_s: dict[str, float] = {}
        self._log_factor = np.zeros(len(SIZE_CLASSES))
        self._variance = np.full(len(SIZE_CLASSES), _PRIOR_VARIANCE)

    @property
    def n_tracks(self) -> int:
        """Number of tracks with evidence."""
        return len(self._ids)

    def of_class(self, name: str) -> BiasOfClass:
        """The bias of a size class."""
        k = SIZE_CLASSES.index(name)
        return BiasOfClass(float(self._log_factor[k]), float(np.sqrt(self._variance[k])))

    def variance(self, class_id: IntArray) -> FloatArray:
        """(N,) variance of the log bias of classes."""
        return np.asarray(self._variance[class_id])

    def corrected(self, by_size: Ranges, class_id: IntArray) -> Ranges:
        """N distances by size corrected by the bias of their classes (N,); they are kept for `learn`."""
        self._by_size = by_size, class_id
        if not len(self._ids):
            return by_size
        log_factor = self._log_factor[class_id]
        with np.errstate(invalid="ignore", divide="ignore"):
            variance = (by_size.sigma_m / by_size.distance_m) ** 2
            systematic = _systematic_variance(by_size)
        explained = np.minimum(_PRIOR_VARIANCE, _MAX_SHARED * systematic)
        explained = explained * (1.0 - self._variance[class_id] / _PRIOR_VARIANCE)
        remaining = systematic - explained
        information, weighted_ratio, _ = self._own.get(by_size.track_id)
        gain = remaining * information / (1.0 + remaining * information)
        mean = weighted_ratio / np.where(information > 0, information, 1.0)
        log_factor = log_factor + gain * (mean - log_factor)
        explained, remaining = explained + gain * remaining, (1.0 - gain) * remaining
        distance_m = by_size.distance_m * np.exp(log_factor)
        sigma_m = distance_m * np.sqrt(variance - explained)
        return Ranges(by_size.track_id, distance_m, sigma_m, distance_m * np.sqrt(remaining))

    def expected(self, by_size: Ranges, class_id: IntArray) -> Ranges:
        """N distances by size corrected by all references of their tracks so far."""
        of_drive = self.corrected(by_size, class_id)
        if not len(self._ids):
            return of_drive
        is_same = by_size.track_id[:, None] == self._ids
        row, is_known = is_same.argmax(axis=1), is_same.any(axis=1)
        information, weighted_ratio = (column[row] for column in self._tracks[:2])
        systematic = _systematic_variance(of_drive)
        gain = np.where(is_known, systematic * information / (1.0 + systematic * information), 0.0)
        log_factor = self._log_factor[class_id]
        mean = weighted_ratio / information
        return Ranges(
            by_size.track_id,
            by_size.distance_m * np.exp(log_factor + gain * (mean - log_factor)),
            of_drive.sigma_m * by_size.distance_m / of_drive.distance_m,
        )

    def learn(self, reference: Ranges, time_s: float, *, shared_sigma: float, is_own: bool = False) -> None:
        """Add the reference distances of the tracks last corrected, NaN = none, and update the bias.

        Args:
            reference: distances of the same N tracks.
            time_s: time of the frame.
            shared_sigma: relative standard deviation of an error that all references share.
            is_own: whether the tracks are corrected by their own references, too.
        """
        key = "own" if is_own else "others"
        step_s = min(max(time_s - self._last_s.get(key, 0.0), 0.0), _CORRELATED_S)
        self._last_s[key] = self._time_s = time_s
        if self._by_size is None or step_s == 0.0:
            return
        by_size, class_id = self._by_size
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = np.log(reference.distance_m / by_size.distance_m)
            size_variance, systematic = (by_size.sigma_m / by_size.distance_m) ** 2, _systematic_variance(by_size)
            noise = (reference.sigma_m / reference.distance_m) ** 2 + size_variance - systematic
        rows = np.flatnonzero(np.abs(ratio) < _MAX_LOG_RATIO)  # False for NaN
        if len(rows):
            own = systematic - np.minimum(_PRIOR_VARIANCE, _MAX_SHARED * systematic)
            self._add(by_size.track_id[rows], class_id[rows], ratio[rows], noise[rows], own[rows], step_s)
            self._solve(shared_sigma)
        if is_own and len(rows):
            ids = by_size.track_id[rows]
            information, weighted_ratio, _ = self._own.get(ids)
            added = step_s / _CORRELATED_S / (noise[rows] + shared_sigma**2)
            limit = 1.0 / ((reference.sigma_m / reference.distance_m)[rows] ** 2)  # errors of a track's references last
            stays = np.minimum(1.0, limit / (information + added))
            self._own.put(
                ids,
                np.array(
                    [
                        stays * (information + added),
                        stays * (weighted_ratio + added * ratio[rows]),
                        np.full(len(rows), time_s),
                    ]
                ),
                keep_known=time_s - self._own.known[2] < _OWN_S,
            )

    def _add(
        self,
        track_id: IntArray,
        class_id: IntArray,
        ratio: FloatArray,
        noise: FloatArray,
        own: FloatArray,
        step_s: float,
    ) -> None:
        """Add one frame of N tracks to their averages."""
        is_same = track_id[:, None] == self._ids
        is_known = is_same.any(axis=1)
        n_new = int((~is_known).sum())
        first = max(0, len(self._ids) + n_new - _MAX_TRACKS)
        self._ids = np.concatenate([self._ids, track_id[~is_known]])
        self._class_id = np.concatenate([self._class_id, class_id[~is_known]])
        columns = np.concatenate([np.array(self._tracks), np.zeros((4, n_new))], axis=1)
        slot = (track_id[:, None] == self._ids).argmax(axis=1)
        information = step_s / _CORRELATED_S / noise
        columns[0, slot] += information
        columns[1, slot] += information * ratio
        columns[2, slot] = own
        columns[3, slot] = self._time_s
        self._class_id[slot] = class_id
        self._tracks = _Columns(*columns[:, first:])
        self._ids, self._class_id = self._ids[first:], self._class_id[first:]

    def _solve(self, shared_sigma: float) -> None:
        """Posterior of a and c_k over all tracks."""
        tracks, n_classes = self._tracks, len(SIZE_CLASSES)
        m = tracks.weighted_ratio / tracks.information
        variance = tracks.own_variance + 1.0 / tracks.information
        fresh = np.exp((tracks.time_s - self._time_s) / _MEMORY_S)
        A = np.zeros((len(m), 1 + n_classes))
        A[:, 0] = 1.0
        A[np.arange(len(m)), 1 + self._class_id] = 1.0
        prior = np.diag([_COMMON_SIGMA**-2, *[_CLASS_SIGMA**-2] * n_classes])
        log_factor = self._log_factor
        for _ in range(_N_ROUNDS):
            residual2 = (m - log_factor[self._class_id]) ** 2 / (variance + self._variance[self._class_id])
            weight = fresh / variance / (1.0 + residual2 / _CAUCHY_SIGMA**2)
            covariance = np.linalg.inv(prior + (A.T * weight) @ A)
            beta = covariance @ (A.T @ (weight * m))
            log_factor = beta[0] + beta[1:]
        self._log_factor = log_factor
        of_class = covariance[0, 0] + 2 * covariance[0, 1:] + np.diag(covariance)[1:]
        self._variance = np.minimum(of_class + shared_sigma**2, _PRIOR_VARIANCE)

    def summary(self) -> dict[str, Any]:
        """Bias and sigma in per cent and number of tracks, by class with evidence."""
        counts = np.bincount(self._class_id, minlength=len(SIZE_CLASSES))
        return {
            name: {
                "bias_pct": float(100 * np.expm1(-self._log_factor[k])),
                "sigma_pct": float(100 * np.sqrt(self._variance[k])),
                "n_tracks": int(counts[k]),
            }
            for k, name in enumerate(SIZE_CLASSES)
            if counts[k]
        }


def _systematic_variance(by_size: Ranges) -> FloatArray:
    """(N,) relative systematic variance of distances by size; all of it if the parts are unknown."""
    sigma_m = by_size.sigma_m if by_size.sigma_systematic_m is None else by_size.sigma_systematic_m
    return np.asarray((sigma_m / by_size.distance_m) ** 2)
