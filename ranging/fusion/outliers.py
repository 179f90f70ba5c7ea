"""Rejection of measurements that are inconsistent with others of the same track.

Every rule returns a mask (M, N), True = rejected. Rules depend on the error sources that methods declare, not on names.

On a new track, a matching method that differs from all size methods by more than a factor of 2.5 is rejected: within a
class sizes vary less, and even a half-occluded object appears no smaller than half its size, while a match on an
occluder or on the background can be anywhere. But if a contact-point method, which does not depend on the class,
agrees with matching, the size methods are rejected instead: the class is wrong.

When methods are in conflict, rejected are, in this order: methods far from the track's previous distance, if at least
as many are near it; of three or more methods, the one without which all others agree; methods that depend on the lane
width, if they contradict the size methods (the lines may be those of another lane), or the size methods if a method
that depends on the horizon is nearer to the lane methods.
"""

from __future__ import annotations

import math

import numpy as np

from track_range.foundation.arrays import BoolArray
from track_range.ranging.fusion.error_model import ErrorModel
from track_range.ranging.fusion.estimation import Estimate, Measurements, TrackBiases, least_squares

CONFLICT_T2 = 9.0  # value of t^2 above which methods are in conflict: 3 standard deviations
TRUSTED_FRAMES = 5  # number of frames in agreement after which the history of a track decides which method is wrong
_LOG_MAX_SIZE_RATIO = math.log(2.5)  # largest plausible difference between matching and size methods
_OUTLIER_SIGMA = 3.0  # deviation from history or another method: above an outlier, below in agreement
_MAX_SPEED_MPS = 20.0  # largest rate of change of distances, for the prediction from the last frame
_SAME_ERRORS = 0.5  # correlation of systematic errors above which two methods do not confirm each other


def inconsistent_with_size(
    measured: Measurements, usable: BoolArray, track: TrackBiases, model: ErrorModel
) -> BoolArray:
    """(M, N) matching, or size, methods of new tracks that imply an implausible object size for the class.

    `measured` has all measurements: also methods that are not `usable` (M, N) may confirm others.
    """
    rejected = np.zeros_like(usable)
    is_new = usable[model.matching] & (track.n_agreements < TRUSTED_FRAMES)
    if not is_new.any():
        return rejected
    z, sigma, has_size = measured.z, measured.sigma, usable[model.size]
    ratio = np.abs(z[model.matching, None] - z[model.size])
    is_apart = is_new & has_size.any(axis=0) & ((ratio > _LOG_MAX_SIZE_RATIO) | ~has_size).all(axis=1)
    for j, tracks in zip(model.matching.tolist(), is_apart, strict=True):
        if tracks.any():
            difference = np.abs(z[model.contact] - z[j])
            agrees = difference < _OUTLIER_SIGMA * np.hypot(sigma[model.contact], sigma[j])
            agrees &= measured.valid[model.contact]
            from_size = np.where(has_size, np.abs(z[model.contact, None] - z[model.size]), np.inf).min(axis=1)
            is_wrong_class = (agrees & (difference < from_size)).any(axis=0)
            rejected[j] |= tracks & ~is_wrong_class
            rejected[model.size] |= has_size & tracks & is_wrong_class
    return rejected


def outliers(
    used: Measurements,
    measured: Measurements,
    estimate: Estimate,
    track: TrackBiases,
    model: ErrorModel,
    *,
    in_conflict: BoolArray,
    time_s: float,
) -> BoolArray:
    """(M, N) outliers among the `used` methods of tracks that are `in_conflict` (N,), by their `estimate`.

    `measured` has all measurements: also methods that are not used may confirm others.
    """
    rejected = in_conflict & _far_from_history(used, estimate, track, model, time_s)
    unresolved = np.flatnonzero(in_conflict & ~rejected.any(axis=0) & (estimate.n_valid > 2))
    if len(unresolved):
        rejected[:, unresolved] = _outvoted(used.of_tracks(unresolved), track.of_tracks(unresolved), model)
    in_conflict = in_conflict & ~rejected.any(axis=0)
    if not in_conflict.any():
        return rejected
    return rejected | _wrong_lane(used, measured, estimate, model, in_conflict)


def _far_from_history(
    used: Measurements, estimate: Estimate, track: TrackBiases, model: ErrorModel, time_s: float
) -> BoolArray:
    """(M, N) methods far from the previous distance of a trusted track, if at least as many methods are near it."""
    n = used.sigma * model.independent
    moved = _MAX_SPEED_MPS * (time_s - track.time_s) / np.exp(track.log_m)
    variance = estimate.k**2 * track.u_variance + n * n + track.variance + moved * moved
    deviation = np.abs(estimate.y - track.log_m) / np.sqrt(variance)  # NaN for a new track
    is_near, is_far = used.valid & (deviation < _OUTLIER_SIGMA), used.valid & (deviation > _OUTLIER_SIGMA)
    n_near = is_near.sum(axis=0)
    decides = (track.n_agreements >= TRUSTED_FRAMES) & (n_near > 0) & (n_near >= is_far.sum(axis=0))
    return np.asarray(is_far & decides)


def _outvoted(used: Measurements, track: TrackBiases, model: ErrorModel) -> BoolArray:
    """(M, N) the one method of three or more without which all others agree, two of them with independent errors."""
    is_independent = model.systematic_correlation < _SAME_ERRORS
    t2_without = np.full(used.valid.shape, np.inf)
    for i in np.flatnonzero(used.valid.any(axis=1)).tolist():
        others = used.valid.copy()
        others[i] = False
        confirmed = (others[:, None] & others & is_independent[:, :, None]).any(axis=(0, 1))
        t2 = least_squares(used.only(others), track, model).t2
        t2_without[i] = np.where(used.valid[i] & confirmed, t2, np.inf)
    best = t2_without.min(axis=0)
    return np.asarray((t2_without == best) & (best <= CONFLICT_T2))


def _wrong_lane(
    used: Measurements, measured: Measurements, estimate: Estimate, model: ErrorModel, in_conflict: BoolArray
) -> BoolArray:
    """(M, N) lane-width methods that contradict size methods, or the size methods if the horizon supports the lane.

    The lines may be those of another lane, an error that is not part of sigma.
    """
    rejected = np.zeros_like(used.valid)
    y, A, z = estimate.y, estimate.A, measured.z
    for lane in model.lane.tolist():
        for size in model.size.tolist():
            S = A[lane, lane] - 2 * A[lane, size] + A[size, size]
            contradicts = (y[lane] - y[size]) ** 2 > CONFLICT_T2 * S
            contradicts &= in_conflict & used.valid[lane] & used.valid[size]
            is_nearer = np.abs(z[lane] - z[model.horizon]) < np.abs(z[size] - z[model.horizon])
            supports_lane = (measured.valid[model.horizon] & is_nearer).any(axis=0)
            rejected[size] |= contradicts & supports_lane
            rejected[lane] |= contradicts & ~supports_lane
    return rejected
