"""Fusion: one distance from any number of methods, by generalised least squares with biases
estimated per track.

    z_i = log d + k_i u_i + n_i         z_i: log distance of method i

The relative sigma of a method has a systematic part k, constant over a track (the car is larger
than average, the rig is misaligned), and an independent part n, new in every frame. u, with
variance 1, is the bias of a method for the track in units of k. It shows in differences between
methods: while stereo matches a track it calibrates the size that mono assumes, and mono continues
with that size when stereo fails. Without a scale reference no bias is learnt: the errors of ground
and lane change with the distance (horizon, lines), and mono would be corrected by what is not its
own error. The estimator is a Schmidt-Kalman filter: its state is log d, without prior in each
frame, and u (M,) with covariance C, which decays slowly to its prior C0. With K = diag(k), N =
cov(n), 1 = (1, ..., 1)' and y = z - K u, over the valid methods:

    A = K C K + N,    w = A^-1 1 / (1' A^-1 1)                  generalised least squares
    log d = w' y,     var = w' A w
    P = A^-1 - A^-1 1 1' A^-1 / (1' A^-1 1)                     information of the differences between methods
    chi^2 = y' P y,   t_i^2 = (P y)_i^2 / P_ii                  total, and of method i against all others
    u' = u + T C K P y,   C' = C - T B - B T + T B T,   B = C K P K C

For two methods, with S = A_ii - 2 A_ij + A_jj: w_j = (A_ii - A_ij) / S and chi^2 = t^2 = (y_i -
y_j)^2 / S. C0 and N come from the error sources that the methods declare (`error_model`).

A weight w_i < 0 extrapolates from one method through another one with correlated errors. Between
methods that share most of their variance the result would depend on the exact correlation, so such
weights are set to 0. T = diag(t) is the identity, except 0 for scale references: there is no
independent scale to compare them with, and a wrong match can exceed any bias (Schmidt, 1966: a
"considered" bias is part of the covariance, but not estimated). When methods differ by more than
their sigmas allow, sigma is scaled up by the Birge ratio (square root of chi^2 per degree of
freedom), T and the certainty of the biases are reduced, and methods may be rejected, by the error
sources that they declare.

On a new track, a matching method that differs from all size methods by more than a factor of 2.5 is
rejected: within a class sizes vary less, and even a half-occluded object appears no smaller than
half its size, while a match on an occluder or on the background can be anywhere. But if a
contact-point method, which does not depend on the class, agrees with matching, the size methods are
rejected instead: the class is wrong.

When methods are in conflict, these are rejected, in this order: methods far from the track's
previous distance, if at least as many are near it; of three or more methods, the one without which
all others agree; methods that depend on the lane width, if they contradict the size methods (the
lines may belong to another lane), or the size methods if a method that depends on the horizon is
nearer to the lane methods.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from track_range.foundation.arrays import BoolArray, IntArray
from track_range.foundation.track_state import TrackState
from track_range.ranging import registry
from track_range.ranging.fusion.error_model import ErrorModel
from track_range.ranging.fusion.estimation import Estimate, Measurements, TrackBiases, least_squares
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import RangingMethod

_CONFLICT_T2 = 9.0  # value of t^2 above which methods are in conflict: 3 standard deviations
# number of frames in agreement after which the history of a track decides which method is wrong
_TRUSTED_FRAMES = 5
# largest plausible difference between matching and size methods
_LOG_MAX_SIZE_RATIO = math.log(2.5)
# deviation from history or another method: above an outlier, below in agreement
_OUTLIER_SIGMA = 3.0
_MAX_SPEED_MPS = 20.0  # largest rate of change of distances, for the prediction from the last frame
# correlation of systematic errors above which two methods do not confirm each other
_SAME_ERRORS = 0.5
# change of log distance over which biases decay to 1/e; on KITTI mono's lose 16 % of their variance
_MEMORY_LOG = 5.0
# time in s over which biases decay to 1/e; long, since KITTI shows no decay over time alone
_MEMORY_S = 60.0
_MAX_GAP_S = 3.0  # longest absence in s after which the biases of a track are still used
# so that a few conflicts (-2 each) end the trust in a track's history
_MAX_AGREEMENTS = 2 * _TRUSTED_FRAMES
_CONFLICT_VARIANCE = 0.5  # variance added to u in a frame with a conflict
# largest difference in sigmas that biases are learnt from: others are mismatches or hidden boxes
_MAX_BIAS_SIGMA = 2.5
# relative sigma above which a method is not used if another is better: its bias would be too large
_VAGUE_SIGMA = 0.4
_REFERENCE_S = 0.5  # s after a scale reference during which the scale counts as the reference's
# variance of a size method's u below which its scale is the reference's; 1 = not learnt
_KNOWN_BIAS_VARIANCE = 0.3


class ScaleSource(IntEnum):
    """Origin of the scale of a fused distance."""

    ASSUMED = 0  # assumed sizes of classes, camera height or lane width
    # a scale reference, such as a calibrated pair, directly or through biases learnt from it
    REFERENCE = 1


_ASSUMED, _REFERENCE = map(int, ScaleSource)
_N_SOURCES = len(ScaleSource)


@dataclass(frozen=True, slots=True)
class Fused:
    """Fused ranges of N tracks in one frame."""

    ranges: Ranges  # distance and sigma, NaN = no method measured the track
    scale_source: IntArray  # (N,) `ScaleSource` of each distance
    # (N,) frames so far with a conflict that the track's history did not resolve
    n_conflicts: IntArray

    @property
    def condition(self) -> IntArray:
        """(N,) code of `scale_source` and `n_conflicts`; a step in distance at a change of the code
        is not motion.
        """
        return np.asarray(_N_SOURCES * self.n_conflicts + self.scale_source)


class Fusion:
    """Fuses the distances of several methods frame by frame, and estimates the biases of the
    methods per track.

    Example:
        >>> import numpy as np, track_range as tr
        >>> ids = np.array([1])
        >>> by_method = {
        ...     "mono": tr.Ranges(ids, np.array([21.0]), np.array([2.0])),
        ...     "stereo": tr.Ranges(ids, np.array([20.0]), np.array([0.4])),
        ... }
        >>> fused = tr.Fusion().fuse(by_method, ids, time_s=0.0).ranges
        >>> 20.0 < fused.distance_m[0] < 20.2, fused.sigma_m[0] < 0.4
        (np.True_, np.True_)
    """

    def __init__(self, methods: Sequence[RangingMethod] | None = None) -> None:
        """Start without tracks; `methods` are the methods to fuse, None = all registered methods
        but optional ones. Methods that do not fuse are left out.
        """
        listed = registry.methods(()) if methods is None else methods
        self._model = ErrorModel.of([method for method in listed if method.fuses])
        # pairs of methods of which the first is not used where the second measures
        self._superseded = np.argwhere(self._model.superseded_by).tolist()
        self._tracks = TrackState(TrackBiases.initial_column(self._model))

    def fuse(self, by_method: Mapping[str, Ranges], track_id: IntArray, time_s: float) -> Fused:
        """Fused ranges of the tracks (N,) of a frame, in the order of time, from the ranges of each
        method.

        The ranges are in the order of `track_id`; ranges of methods that are not fused are ignored.
        """
        model, m = self._model, len(self._model.names)
        track = TrackBiases.from_columns(self._tracks.get(track_id), m)
        measured = Measurements.of(by_method, model, track_id)
        has_any = measured.valid.any(axis=0)

        # Predict: biases decay to their prior; the decay over a gap is applied at its end.
        elapsed_s = np.fmax(time_s - track.time_s, 0.0) * has_any
        track = track.decayed(np.exp(elapsed_s / -_MEMORY_S), model)

        # Select methods, estimate, reject outliers.
        usable = measured.valid.copy()
        for fallback, other in self._superseded:
            ranges = by_method.get(model.names[fallback])
            if ranges is not None and ranges.is_fallback:
                usable[fallback] &= ~measured.valid[other]
        is_vague = measured.sigma > _VAGUE_SIGMA
        if is_vague.any():
            usable &= ~(is_vague & (usable & ~is_vague).any(axis=0))
        usable &= ~_inconsistent_with_size(measured, usable, track, model)
        used = measured.only(usable)
        estimate = least_squares(used, track, model)
        in_conflict = estimate.t2 > _CONFLICT_T2
        if in_conflict.any():
            rejected = _outliers(
                used, measured, estimate, track, model, in_conflict=in_conflict, time_s=time_s
            )
            if rejected.any():
                used = used.only(used.valid & ~rejected)
                estimate = least_squares(used, track, model)
            in_conflict = rejected.any(axis=0) | (estimate.t2 > _CONFLICT_T2)

        # Update biases and agreement.
        track = _with_biases_learnt(track, used, estimate, model, in_conflict=in_conflict)
        is_unresolved = (estimate.t2 > _CONFLICT_T2) & (track.n_agreements < _TRUSTED_FRAMES)
        change = ((estimate.n_valid > 1) & ~in_conflict) - 2.0 * in_conflict
        moved = np.fmax(np.abs(estimate.log_m - track.log_m), 0.0) * has_any  # 0 for a new track
        track = track.decayed(np.exp(moved / -_MEMORY_LOG), model)
        has_reference = used.valid[model.reference].any(axis=0)
        track = TrackBiases(
            u=track.u,
            C=track.C,
            log_m=np.where(has_any, estimate.log_m, track.log_m),
            variance=np.where(has_any, estimate.variance, track.variance),
            time_s=np.where(has_any, time_s, track.time_s),
            n_agreements=np.minimum(np.maximum(track.n_agreements + change, 0.0), _MAX_AGREEMENTS),
            n_conflicts=track.n_conflicts + is_unresolved,
            reference_s=np.where(has_reference, time_s, track.reference_s),
        )
        known_s = self._tracks.known[m + m * m + 2]  # `time_s` of the columns
        is_recent = time_s - known_s <= _MAX_GAP_S
        self._tracks.put(track_id, track.to_columns(), keep_known=is_recent)

        distance_m = np.where(has_any, np.exp(estimate.log_m), np.nan)
        sigma_m = distance_m * np.sqrt(estimate.variance * np.maximum(1.0, estimate.chi2_per_dof))
        is_reference = (time_s - track.reference_s <= _REFERENCE_S) | (
            track.u_variance[model.size] < _KNOWN_BIAS_VARIANCE
        ).any(axis=0)
        scale_source = np.where(is_reference, _REFERENCE, _ASSUMED)
        return Fused(
            Ranges(track_id, distance_m, sigma_m), scale_source, track.n_conflicts.astype(np.int64)
        )


def _with_biases_learnt(
    track: TrackBiases,
    used: Measurements,
    estimate: Estimate,
    model: ErrorModel,
    *,
    in_conflict: BoolArray,
) -> TrackBiases:
    has_reference = used.valid[model.reference].any(axis=0)
    if not (has_reference | in_conflict).any():
        return track
    size, matching = model.size[:, None], model.matching
    is_apart = np.abs(used.z[size] - used.z[matching]) > _MAX_BIAS_SIGMA * np.hypot(
        used.sigma[size], used.sigma[matching]
    )
    is_implausible = (used.valid[size] & used.valid[matching] & is_apart).any(axis=(0, 1))
    damping = np.sqrt(_CONFLICT_T2 / np.maximum(estimate.t2, _CONFLICT_T2))
    t = model.is_learnt * (damping * ~is_implausible * has_reference)
    CK = track.C * estimate.k
    u = track.u + t * np.add.reduce(CK * estimate.residual, axis=1)
    # (N, M, M) products of matrices; asymmetric rounding errors would grow from frame to frame
    CK = CK.transpose(2, 0, 1)
    B = (CK @ estimate.P.transpose(2, 0, 1) @ CK.transpose(0, 2, 1)).transpose(1, 2, 0)
    B = (B + B.transpose(1, 0, 2)) / 2
    C = track.C - B * (1.0 - (1.0 - t[:, None]) * (1.0 - t))
    if in_conflict.any():
        C0_learnt = model.is_learnt * model.is_learnt.T * model.systematic_correlation
        C += _CONFLICT_VARIANCE * C0_learnt[:, :, None] * in_conflict
    return track.with_biases(u, C)


def _inconsistent_with_size(
    measured: Measurements, usable: BoolArray, track: TrackBiases, model: ErrorModel
) -> BoolArray:
    """(M, N) matching, or size, methods of new tracks that imply an implausible object size for the
    class.

    `measured` has all measurements: methods that are not `usable` (M, N) may also confirm other
    methods.
    """
    rejected = np.zeros_like(usable)
    is_new = usable[model.matching] & (track.n_agreements < _TRUSTED_FRAMES)
    if not is_new.any():
        return rejected
    z, sigma, has_size = measured.z, measured.sigma, usable[model.size]
    ratio = np.abs(z[model.matching, None] - z[model.size])
    is_apart = (
        is_new & has_size.any(axis=0) & ((ratio > _LOG_MAX_SIZE_RATIO) | ~has_size).all(axis=1)
    )
    for j, tracks in zip(model.matching.tolist(), is_apart, strict=True):
        if tracks.any():
            difference = np.abs(z[model.contact] - z[j])
            agrees = difference < _OUTLIER_SIGMA * np.hypot(sigma[model.contact], sigma[j])
            agrees &= measured.valid[model.contact]
            from_size = np.where(
                has_size, np.abs(z[model.contact, None] - z[model.size]), np.inf
            ).min(axis=1)
            is_wrong_class = (agrees & (difference < from_size)).any(axis=0)
            rejected[j] |= tracks & ~is_wrong_class
            rejected[model.size] |= has_size & tracks & is_wrong_class
    return rejected


def _outliers(
    used: Measurements,
    measured: Measurements,
    estimate: Estimate,
    track: TrackBiases,
    model: ErrorModel,
    *,
    in_conflict: BoolArray,
    time_s: float,
) -> BoolArray:
    """(M, N) outliers among the `used` methods of tracks that are `in_conflict` (N,), by their
    `estimate`.

    `measured` has all measurements: methods that are not used may also confirm other methods.
    """
    rejected = in_conflict & _far_from_history(used, estimate, track, model, time_s)
    unresolved = np.flatnonzero(in_conflict & ~rejected.any(axis=0) & (estimate.n_valid > 2))
    if len(unresolved):
        rejected[:, unresolved] = _outvoted(
            used.of_tracks(unresolved), track.of_tracks(unresolved), model
        )
    in_conflict = in_conflict & ~rejected.any(axis=0)
    if not in_conflict.any():
        return rejected
    return rejected | _wrong_lane(used, measured, estimate, model, in_conflict)


def _far_from_history(
    used: Measurements, estimate: Estimate, track: TrackBiases, model: ErrorModel, time_s: float
) -> BoolArray:
    """(M, N) methods far from the previous distance of a trusted track, if at least as many methods
    are near it.
    """
    n = used.sigma * model.independent
    moved = _MAX_SPEED_MPS * (time_s - track.time_s) / np.exp(track.log_m)
    variance = estimate.k**2 * track.u_variance + n * n + track.variance + moved * moved
    deviation = np.abs(estimate.y - track.log_m) / np.sqrt(variance)  # NaN for a new track
    is_near, is_far = (
        used.valid & (deviation < _OUTLIER_SIGMA),
        used.valid & (deviation > _OUTLIER_SIGMA),
    )
    n_near = is_near.sum(axis=0)
    decides = (
        (track.n_agreements >= _TRUSTED_FRAMES) & (n_near > 0) & (n_near >= is_far.sum(axis=0))
    )
    return np.asarray(is_far & decides)


def _outvoted(used: Measurements, track: TrackBiases, model: ErrorModel) -> BoolArray:
    """(M, N) the one method of three or more without which all others agree, two of them with
    independent errors.
    """
    is_independent = model.systematic_correlation < _SAME_ERRORS
    t2_without = np.full(used.valid.shape, np.inf)
    for i in np.flatnonzero(used.valid.any(axis=1)).tolist():
        others = used.valid.copy()
        others[i] = False
        confirmed = (others[:, None] & others & is_independent[:, :, None]).any(axis=(0, 1))
        t2 = least_squares(used.only(others), track, model).t2
        t2_without[i] = np.where(used.valid[i] & confirmed, t2, np.inf)
    best = t2_without.min(axis=0)
    return np.asarray((t2_without == best) & (best <= _CONFLICT_T2))


def _wrong_lane(
    used: Measurements,
    measured: Measurements,
    estimate: Estimate,
    model: ErrorModel,
    in_conflict: BoolArray,
) -> BoolArray:
    """(M, N) lane-width methods that contradict size methods, or the size methods if the horizon
    supports the lane.

    The lines may belong to another lane, an error that is not part of sigma.
    """
    rejected = np.zeros_like(used.valid)
    y, A, z = estimate.y, estimate.A, measured.z
    for lane in model.lane.tolist():
        for size in model.size.tolist():
            S = A[lane, lane] - 2 * A[lane, size] + A[size, size]
            contradicts = (y[lane] - y[size]) ** 2 > _CONFLICT_T2 * S
            contradicts &= in_conflict & used.valid[lane] & used.valid[size]
            is_nearer = np.abs(z[lane] - z[model.horizon]) < np.abs(z[size] - z[model.horizon])
            supports_lane = (measured.valid[model.horizon] & is_nearer).any(axis=0)
            rejected[size] |= contradicts & supports_lane
            rejected[lane] |= contradicts & ~supports_lane
    return rejected
