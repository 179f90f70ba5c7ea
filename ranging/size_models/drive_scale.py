r"""DriveScale: error of the distances by size that all objects of a drive share, and its
uncertainty.

    log d_i - log s_i = a + c_k + e_i + w_i u + n_it
                                d_i: reference distance of object i, s_i: its distance by size

a is common to all classes (focal length, detector), c_k to the objects of class k (cars differ
between streets and countries), e_i belongs to the object, n_it to the frame. a and c_k have normal
priors; e_i has the systematic sigma of the distance by size without the part that a drive shares.
Each track is one measurement: the average of its frames by information, in which errors are
correlated over `_CORRELATED_S`. u is a lasting error of the references, as of the horizon, which
near and far objects separate from the scale. The estimate is the posterior mean over all tracks (ridge
regression) with Cauchy weights, since vans are detected as cars and contact points are hidden.

Distances by size are multiplied by exp(a + c_k). Their sigma contains the variance of the bias
instead of its prior variance. This variance shrinks with evidence, first from other classes, then
from the class. A reference that is not used elsewhere (`ScaleEvidence.corrects_tracks`) also
corrects its own track, by the posterior mean of a + c_k + e_i.

A scale is a value: the evidence of frame t gives the scale of frame t + 1 (`DriveScale.after`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.measurement.focal_scale import EXACT, FocalScale
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.measurement.rig_scale import CALIBRATED, RigScale
from track_range.ranging.size_models.network_scale import NetworkScale
from track_range.ranging.size_models.shared_sizes import (
    CLASS_SIGMA,
    DRIVE_VARIANCE,
    KNOWN_REGION_SIGMA,
    shared_variance,
)
from track_range.ranging.size_models.size_model import SIZE_CLASSES

# time over which the errors of a track's frames are correlated: pitch, and boxes of a detector
_CORRELATED_S = 0.5
_MEMORY_S = 180.0  # time constant with which tracks are forgotten: streets change
_OWN_S = 5.0  # time for which a track without references stays corrected by its own ones
_MAX_TRACKS = 400  # largest number of tracks; more do not change the estimate
# of reweighting, and scale of the weights 1 / (1 + (residual / scale)^2) in sigmas
_N_ROUNDS, _CAUCHY_SIGMA = 3, 2.0
# largest difference of log distance that is evidence; larger ones are mistakes
_MAX_LOG_RATIO = 0.5


# information of the priors of a, of c_k and of the lasting error of the references
_PRIOR = np.diag([KNOWN_REGION_SIGMA**-2, *[CLASS_SIGMA**-2] * len(SIZE_CLASSES), 1.0])


class BiasOfClass(NamedTuple):
    """Bias of a class: log of the factor of its distances, and its standard deviation."""

    log_factor: float
    sigma: float


@dataclass(frozen=True, slots=True)
class ScaleEvidence:
    """Evidence of the scale of a drive by one method in one frame, for N tracks."""

    class_id: IntArray  # (N,) classes of the tracks
    # distances by size before their correction; None = the method has none
    by_size: Ranges | None = None
    # distances with a known scale, NaN = none; None = the method has none
    reference: Ranges | None = None
    # relative standard deviation of an error that all references share
    reference_sigma: float = 0.0
    # (N,) relative standard deviations of what one lasting error, as of a horizon, makes of each
    # reference; a part of their sigmas; None = there is none
    common_sigma: FloatArray | None = None
    corrects_tracks: bool = False  # whether the tracks are corrected by their own references, too

    def of_rig(self, rig: RigScale) -> ScaleEvidence:
        """The evidence with references that a pair measured, corrected by its scale."""
        if self.reference is None:
            return self
        reference_sigma = math.hypot(self.reference_sigma, rig.sigma)
        return replace(
            self, reference=rig.corrected(self.reference), reference_sigma=reference_sigma
        )


class _Tracks(NamedTuple):
    """Averages of the tracks with evidence, (K,) each."""

    track_id: IntArray
    class_id: IntArray
    information: FloatArray
    weighted_ratio: FloatArray
    own_variance: FloatArray
    time_s: FloatArray
    weighted_common: FloatArray  # effects of the error that references of all tracks share


class _Corrections(NamedTuple):
    """References that correct their own tracks, (K,) each: information, weighted log ratio, latest
    time.
    """

    track_id: IntArray
    information: FloatArray
    weighted_ratio: FloatArray
    time_s: FloatArray

    def of(self, track_id: IntArray) -> tuple[FloatArray, FloatArray]:
        """(N,) information and weighted log ratio of tracks; 0 = none."""
        row, is_known = _rows(track_id, self.track_id)
        if not len(self.track_id):
            return np.zeros(len(track_id)), np.zeros(len(track_id))
        return np.where(is_known, self.information[row], 0.0), np.where(
            is_known, self.weighted_ratio[row], 0.0
        )

    def after(
        self,
        track_id: IntArray,
        information: FloatArray,
        ratio: FloatArray,
        *,
        limit: FloatArray,
        time_s: float,
    ) -> _Corrections:
        """The references after those of a frame, with log ratios (N,) and their information, of which
        a track has no more than the limit (N,).
        """
        before, weighted_before = self.of(track_id)
        total = before + information
        stays = np.minimum(1.0, limit / total)
        is_present = (self.track_id[:, None] == track_id).any(axis=1)
        kept = ((time_s - self.time_s < _OWN_S) & ~is_present).nonzero()[0]
        weighted = stays * (weighted_before + information * ratio)
        new = (track_id, stays * total, weighted, np.full(len(track_id), time_s))
        return _Corrections._make(
            np.concatenate([a, b[kept]]) for a, b in zip(new, self, strict=True)
        )


_NO_IDS = np.zeros(0, np.int64)


@dataclass(frozen=True, slots=True)
class DriveScale:
    """Scale of one drive, from the evidence so far: of the pair, of the focal length, and the bias
    of the distances by size; `DriveScale()` has no evidence.
    """

    rig: RigScale = CALIBRATED  # of all that the pair measures
    road: RigScale = CALIBRATED  # of speeds by the motion of the road
    focal: FocalScale = EXACT  # of all depths, which results are corrected by
    # of depth networks, by the name of their method; absent = as before a drive
    network: Mapping[str, NetworkScale] = field(default_factory=dict)

    # (K,) posterior mean of a + c_k of the classes `SIZE_CLASSES`
    log_factor: FloatArray = field(default_factory=lambda: np.zeros(len(SIZE_CLASSES)))
    # (K,) its variance
    variance: FloatArray = field(default_factory=lambda: np.full(len(SIZE_CLASSES), DRIVE_VARIANCE))
    _tracks: _Tracks = field(default_factory=lambda: _Tracks(_NO_IDS, _NO_IDS, *np.zeros((5, 0))))
    _corrections: _Corrections = field(
        default_factory=lambda: _Corrections(_NO_IDS, *np.zeros((3, 0)))
    )
    # of evidence by references that do not correct their tracks; that do
    _last_s: tuple[float, float] = (0.0, 0.0)

    @property
    def n_tracks(self) -> int:
        """Number of tracks with evidence."""
        return len(self._tracks.track_id)

    def bias_of(self, name: str) -> BiasOfClass:
        """The bias of a size class."""
        k = SIZE_CLASSES.index(name)
        return BiasOfClass(float(self.log_factor[k]), float(np.sqrt(self.variance[k])))

    def corrected(self, by_size: Ranges, class_id: IntArray) -> Ranges:
        """N distances by size corrected by the bias of their classes (N,)."""
        if not self.n_tracks:
            return by_size
        log_factor = self.log_factor[class_id]
        with np.errstate(invalid="ignore", divide="ignore"):
            variance = (by_size.sigma_m / by_size.distance_m) ** 2
            systematic = _systematic_variance(by_size)
        shared = shared_variance(systematic)
        explained = shared * (1.0 - self.variance[class_id] / DRIVE_VARIANCE)
        remaining = systematic - explained
        information, weighted_ratio = self._corrections.of(by_size.track_id)
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
        if not self.n_tracks:
            return of_drive
        row, is_known = _rows(by_size.track_id, self._tracks.track_id)
        information, weighted_ratio = (
            self._tracks.information[row],
            self._tracks.weighted_ratio[row],
        )
        systematic = _systematic_variance(of_drive)
        gain = np.where(is_known, systematic * information / (1.0 + systematic * information), 0.0)
        log_factor = self.log_factor[class_id]
        mean = weighted_ratio / information
        return Ranges(
            by_size.track_id,
            by_size.distance_m * np.exp(log_factor + gain * (mean - log_factor)),
            of_drive.sigma_m * by_size.distance_m / of_drive.distance_m,
        )

    def after(self, evidence: Iterable[ScaleEvidence], time_s: float) -> DriveScale:
        """The scale after the evidence of all methods in one frame.

        References are compared with the distances by size of the same frame, in the order of the
        methods.
        """
        scale, by_size = self, None
        for item in evidence:
            by_size = by_size if item.by_size is None else item.by_size
            if by_size is not None and item.reference is not None:
                scale = scale._after(item, by_size, item.reference, time_s)
        return scale

    def _after(
        self, item: ScaleEvidence, by_size: Ranges, reference: Ranges, time_s: float
    ) -> DriveScale:
        step_s = min(max(time_s - self._last_s[item.corrects_tracks], 0.0), _CORRELATED_S)
        last_s = (self._last_s[0], time_s) if item.corrects_tracks else (time_s, self._last_s[1])
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = np.log(reference.distance_m / by_size.distance_m)
            size_variance, systematic = (
                (by_size.sigma_m / by_size.distance_m) ** 2,
                _systematic_variance(by_size),
            )
            common = np.zeros(len(ratio)) if item.common_sigma is None else item.common_sigma
            reference_variance = (reference.sigma_m / reference.distance_m) ** 2
            noise = reference_variance - common**2 + size_variance - systematic
        rows = (np.abs(ratio) < _MAX_LOG_RATIO).nonzero()[0]  # False for NaN
        if step_s == 0.0 or not len(rows):
            return replace(self, _last_s=last_s)
        ids, added = by_size.track_id[rows], step_s / _CORRELATED_S / noise[rows]
        own = systematic[rows] - shared_variance(systematic[rows])
        of_frame = added, added * ratio[rows], own, np.full(len(rows), time_s), added * common[rows]
        frame = _Tracks(ids, item.class_id[rows], *of_frame)
        tracks, corrections = _averaged(self._tracks, frame), self._corrections
        log_factor, variance = self._solved(tracks, time_s, item.reference_sigma)
        if item.corrects_tracks:
            added = step_s / _CORRELATED_S / (noise[rows] + item.reference_sigma**2)
            limit = 1.0 / reference_variance[rows]  # errors of a track's references last
            corrections = corrections.after(ids, added, ratio[rows], limit=limit, time_s=time_s)
        return replace(
            self,
            log_factor=log_factor,
            variance=variance,
            _tracks=tracks,
            _corrections=corrections,
            _last_s=last_s,
        )

    def _solved(
        self, tracks: _Tracks, time_s: float, reference_sigma: float
    ) -> tuple[FloatArray, FloatArray]:
        """(K,) posterior means of a + c_k, and their variances."""
        m = tracks.weighted_ratio / tracks.information
        variance = tracks.own_variance + 1.0 / tracks.information
        fresh = np.exp((tracks.time_s - time_s) / _MEMORY_S)
        A = np.zeros((len(m), len(_PRIOR)))
        A[:, 0], A[:, -1] = 1.0, tracks.weighted_common / tracks.information
        A[np.arange(len(m)), 1 + tracks.class_id] = 1.0
        of_horizon = 0.0
        log_factor = self.log_factor
        for _ in range(_N_ROUNDS):
            residual2 = (m - log_factor[tracks.class_id] - A[:, -1] * of_horizon) ** 2 / (
                variance + self.variance[tracks.class_id]
            )
            weight = fresh / variance / (1.0 + residual2 / _CAUCHY_SIGMA**2)
            covariance = np.linalg.inv(_PRIOR + (A.T * weight) @ A)
            beta = covariance @ (A.T @ (weight * m))
            log_factor, of_horizon = beta[0] + beta[1:-1], beta[-1]
        class_variance = covariance[0, 0] + 2 * covariance[0, 1:-1] + covariance.diagonal()[1:-1]
        return log_factor, np.minimum(class_variance + reference_sigma**2, DRIVE_VARIANCE)

    def summary(self) -> dict[str, Any]:
        """Bias and sigma in per cent and number of tracks, by class with evidence."""
        counts = np.bincount(self._tracks.class_id, minlength=len(SIZE_CLASSES))
        return {
            name: {
                "bias_pct": float(100 * np.expm1(-self.log_factor[k])),
                "sigma_pct": float(100 * np.sqrt(self.variance[k])),
                "n_tracks": int(counts[k]),
            }
            for k, name in enumerate(SIZE_CLASSES)
            if counts[k]
        }


NO_EVIDENCE = DriveScale()


def _averaged(known: _Tracks, frame: _Tracks) -> _Tracks:
    is_new = ~_rows(frame.track_id, known.track_id)[1]
    nothing = np.zeros(len(frame.track_id))
    added = frame._replace(information=nothing, weighted_ratio=nothing, weighted_common=nothing)
    tracks = _Tracks._make(
        np.concatenate([a, b[is_new]]) for a, b in zip(known, added, strict=True)
    )
    row, _ = _rows(frame.track_id, tracks.track_id)
    tracks.information[row] += frame.information
    tracks.weighted_ratio[row] += frame.weighted_ratio
    tracks.weighted_common[row] += frame.weighted_common
    for column in ("class_id", "own_variance", "time_s"):
        getattr(tracks, column)[row] = getattr(frame, column)
    return _Tracks._make(column[-_MAX_TRACKS:] for column in tracks)


def _rows(track_id: IntArray, known: IntArray) -> tuple[IntArray, BoolArray]:
    """(N,) row of each track in `known` (K,), 0 for an unknown track, and whether the track is
    known.
    """
    if not len(known):
        return np.zeros(len(track_id), np.int64), np.zeros(len(track_id), np.bool_)
    is_same = track_id[:, None] == known
    return np.asarray(is_same.argmax(axis=1)), np.asarray(is_same.any(axis=1))


def _systematic_variance(by_size: Ranges) -> FloatArray:
    """(N,) relative systematic variance of distances by size; the entire variance if its parts are
    unknown.
    """
    sigma_m = by_size.sigma_m if by_size.sigma_systematic_m is None else by_size.sigma_systematic_m
    return np.asarray((sigma_m / by_size.distance_m) ** 2)
