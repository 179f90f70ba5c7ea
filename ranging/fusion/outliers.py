"""Which measurements do not count: those that others of the same track contradict.

Every rule returns (M, N), True = left out. None names a method: they go by the error sources that methods declare.

On a track without much of a past, matching that differs from all sizes by more than a factor of 2.5 is left out. An
object that is partly hidden can look half as large as it is, but none of its class is that much larger or smaller,
while a match on what stands in front of it, or on the background, can be anywhere. But where the foot of the box, which
does not depend on the class, agrees with matching the sizes are left out: the class is wrong.

Where methods contradict each other, in this order: those that are far from where the track has just been, if at least
as many are near; of three or more the one without which all others agree; what depends on the width of the lane if it
contradicts sizes, as the lines may be those of another lane, unless the foot of the box is nearer to it.
"""

from __future__ import annotations

import math

import numpy as np

from track_range.foundation.arrays import BoolArray
from track_range.ranging.fusion.error_model import ErrorModel
from track_range.ranging.fusion.estimation import Estimate, Measurements, TrackBiases, least_squares

CONTRADICTION = 9.0
"""t^2 from which methods contradict each other."""

TRUSTED_FRAMES = 5
"""After so many frames of agreement the track's past decides which method is wrong."""

_LOG_MAX_SIZE_RATIO = math.log(2.5)

_OUTLIER_SIGMA = 3.0
"""Farther from the track's past, or from another method, is an outlier; nearer agrees."""

_MAX_SPEED_MPS = 20.0
"""How fast distances change at most, for the prediction of where a track is."""

_SAME_ERRORS = 0.5
"""Methods whose systematic errors are correlated as much do not confirm each other."""


def inconsistent_with_size(
    measured: Measurements, counts: BoolArray, track: TrackBiases, model: ErrorModel
) -> BoolArray:
    """Matching, or sizes, of new tracks whose object would be too large or too small for its class.

    Args:
        measured: all measurements; those that do not count can still be witnesses.
        counts: (M, N) which count.
        track: the tracks' past.
        model: the methods.
    """
    out = np.zeros_like(counts)
    is_new = counts[model.matching] & (track.n_agreements < TRUSTED_FRAMES)
    if not is_new.any():
        return out
    z, sigma, has_size = measured.z, measured.sigma, counts[model.size]
    ratio = np.abs(z[model.matching, None] - z[model.size])
    is_apart = is_new & has_size.any(axis=0) & ((ratio > _LOG_MAX_SIZE_RATIO) | ~has_size).all(axis=1)
    for j, tracks in zip(model.matching.tolist(), is_apart, strict=True):
        if tracks.any():
            off = np.abs(z[model.contact] - z[j])
            agrees = measured.valid[model.contact] & (off < _OUTLIER_SIGMA * np.hypot(sigma[model.contact], sigma[j]))
            off_size = np.where(has_size, np.abs(z[model.contact, None] - z[model.size]), np.inf).min(axis=1)
            is_wrong_class = (agrees & (off < off_size)).any(axis=0)
            out[j] |= tracks & ~is_wrong_class
            out[model.size] |= has_size & tracks & is_wrong_class
    return out


def outliers(
    used: Measurements,
    measured: Measurements,
    estimate: Estimate,
    track: TrackBiases,
    model: ErrorModel,
    *,
    contradicts: BoolArray,
    time_s: float,
) -> BoolArray:
    """What to leave out where the methods of `used` contradict each other.

    Args:
        used: the methods that count.
        measured: all methods; those that do not count can still be witnesses.
        estimate: of `used`.
        track: the tracks' past.
        model: the methods.
        contradicts: (N,) of which tracks.
        time_s: of the frame.
    """
    out = contradicts & _far_from_past(used, estimate, track, model, time_s)
    undecided = np.flatnonzero(contradicts & ~out.any(axis=0) & (estimate.n_valid > 2))
    if len(undecided):
        out[:, undecided] = _outvoted(used.of_tracks(undecided), track.of_tracks(undecided), model)
    contradicts = contradicts & ~out.any(axis=0)
    return out | _wrong_lane(used, measured, estimate, model, contradicts) if contradicts.any() else out


def _far_from_past(
    used: Measurements, estimate: Estimate, track: TrackBiases, model: ErrorModel, time_s: float
) -> BoolArray:
    """What is far from where a trusted track has just been, where at least as many methods are near."""
    n = used.sigma * model.independent
    moved = _MAX_SPEED_MPS * (time_s - track.time_s) / np.exp(track.log_m)
    variance = estimate.k**2 * track.u_variance + n * n + track.variance + moved * moved
    off = np.abs(estimate.y - track.log_m) / np.sqrt(variance)  # NaN: a new track
    is_near, is_far = used.valid & (off < _OUTLIER_SIGMA), used.valid & (off > _OUTLIER_SIGMA)
    n_near = is_near.sum(axis=0)
    decides = (track.n_agreements >= TRUSTED_FRAMES) & (n_near > 0) & (n_near >= is_far.sum(axis=0))
    return np.asarray(is_far & decides)


def _outvoted(used: Measurements, track: TrackBiases, model: ErrorModel) -> BoolArray:
    """The one method of three or more without which all others agree, two of them for reasons of their own."""
    is_independent = model.systematic_correlation < _SAME_ERRORS
    t2_without = np.full(used.valid.shape, np.inf)
    for i in np.flatnonzero(used.valid.any(axis=1)).tolist():
        others = used.valid.copy()
        others[i] = False
        confirmed = (others[:, None] & others & is_independent[:, :, None]).any(axis=(0, 1))
        t2 = least_squares(used.only(others), track, model).t2
        t2_without[i] = np.where(used.valid[i] & confirmed, t2, np.inf)
    best = t2_without.min(axis=0)
    return np.asarray((t2_without == best) & (best <= CONTRADICTION))


def _wrong_lane(
    used: Measurements, measured: Measurements, estimate: Estimate, model: ErrorModel, contradicts: BoolArray
) -> BoolArray:
    """What depends on the lane's width and contradicts sizes, or the sizes where the foot of the box is nearer to it.

    The lines may be those of another lane, which no sigma accounts for.
    """
    out = np.zeros_like(used.valid)
    y, A, z = estimate.y, estimate.A, measured.z
    for lane in model.lane.tolist():
        for size in model.size.tolist():
            is_apart = (y[lane] - y[size]) ** 2 > CONTRADICTION * (A[lane, lane] - 2 * A[lane, size] + A[size, size])
            is_apart &= contradicts & used.valid[lane] & used.valid[size]
            is_nearer = np.abs(z[lane] - z[model.horizon]) < np.abs(z[size] - z[model.horizon])
            for_lane = (measured.valid[model.horizon] & is_nearer).any(axis=0)
            out[size] |= is_apart & for_lane
            out[lane] |= is_apart & ~for_lane
    return out
