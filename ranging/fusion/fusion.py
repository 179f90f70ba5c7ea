"""Fusion: one distance from any number of methods, weighted by covariance, with the biases learnt per track.

    z_i = log d + k_i u_i + n_i         for method i, with z_i the logarithm of its distance

The relative sigma of a method has a systematic part k, which a track keeps (a tall car stays a tall car; a rig that is
askew stays askew), and an independent part n, which is new in every frame. u, of variance 1, is the error of a method
about this very track in units of k. One method cannot show it, but differences between methods do: stereo gives mono
the true size of the track while it matches, and mono goes on with it where stereo fails. It is a Kalman filter whose
state is log d, unknown at the start of each frame, and u (M,) with covariance C, which returns slowly to its prior C0.
With K = diag(k), N = cov(n), 1 = (1, ..., 1)' and y = z - K u:

    A = K C K + N,    w = A^-1 1 / (1' A^-1 1)                  generalised least squares
    log d = w' y,     var = w' A w
    P = A^-1 - A^-1 1 1' A^-1 / (1' A^-1 1)                     information of the differences between methods
    chi^2 = y' P y,   t_i^2 = (P y)_i^2 / P_ii                  of all, and of method i against all others
    u' = u + T C K P y,   C' = C - T B - B T + T B T,   B = C K P K C

of the valid methods. For two, with S = A_ii - 2 A_ij + A_jj, that is w_j = (A_ii - A_ij) / S and
chi^2 = t^2 = (y_i - y_j)^2 / S. C0 and N come from the error sources that the methods declare (`error_model`).

A weight w_i < 0 is an extrapolation from one method through another that shares its errors. Between methods that share
most of their variance it would be as good as the declared correlations are: there the weight is 0. T = diag(t) is 1,
but 0 for scale references (Schmidt's filter: other methods have no independent scale to compare them with, and a match
can be wrong in one frame by more than any bias). Where methods contradict each other by more than their sigmas allow,
sigma is widened (Birge's ratio, chi^2 per degree of freedom), T is smaller, the learnt biases become less certain, and
a method may be left out (`outliers`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from track_range.foundation.arrays import BoolArray, IntArray
from track_range.foundation.track_state import TrackState
from track_range.ranging import registry
from track_range.ranging.fusion.error_model import ErrorModel
from track_range.ranging.fusion.estimation import Estimate, Measurements, TrackBiases, least_squares
from track_range.ranging.fusion.outliers import CONTRADICTION, TRUSTED_FRAMES, inconsistent_with_size, outliers
from track_range.ranging.method import RangingMethod
from track_range.ranging.ranges import Ranges

_MEMORY_LOG = 5.0
"""Biases have lost a share 1/e after the distance changed by a factor e^5: the errors of mono along KITTI's labelled
tracks have lost 16 % of their variance after a factor of e, and nothing over time alone."""

_MEMORY_S = 60.0
"""Biases have lost a share 1/e after so long."""

_MAX_GAP_S = 3.0
"""A track that is absent for longer is forgotten."""

_MAX_AGREEMENTS = 2 * TRUSTED_FRAMES
"""Frames of agreement that are counted at most; a contradiction takes two away."""

_DOUBT = 0.5
"""Variance that u gains in a frame of contradiction."""

_MAX_BIAS_SIGMA = 2.5
"""A frame in which sizes and matching differ by more, in their sigmas, teaches nothing: that is no object's size, but a
match on another object, or a box that another object cuts."""

_REFERENCE_S = 0.5
"""For so long after the last measurement of a scale reference the scale counts as its scale."""

_KNOWN_BIAS_VARIANCE = 0.3
"""The scale counts as the reference's while u of a method that goes by size is known as well as this."""


class ScaleSource(IntEnum):
    """Where the scale of a fused distance comes from."""

    ASSUMED = 0
    """Sizes of classes, the camera's height, the width of the lane."""
    REFERENCE = 1
    """A scale reference, such as a calibrated pair: now, or learnt from it by other methods."""


@dataclass(frozen=True, slots=True)
class Fused:
    """Fused ranges of a frame.

    Attributes:
        ranges: distance and sigma, NaN = no method measured.
        scale_source: (N,) `ScaleSource` of each distance.
        n_conflicts: (N,) count of frames, so far, in which methods contradicted each other and the track's past did not
            decide.
    """

    ranges: Ranges
    scale_source: IntArray
    n_conflicts: IntArray

    @property
    def condition(self) -> IntArray:
        """(N,) one number for how each distance came about: a step where it changes is no motion."""
        return np.asarray(len(ScaleSource) * self.n_conflicts + self.scale_source)


class Fusion:
    """Fuses the methods of a video frame by frame, and learns per track how they differ.

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
        """Start without tracks; `methods` may be fused, None = all registered ones."""
        self._model = ErrorModel.of(registry.methods() if methods is None else methods)
        self._tracks = TrackState(TrackBiases.initial_column(self._model))

    def fuse(self, by_method: Mapping[str, Ranges], track_id: IntArray, time_s: float) -> Fused:
        """The fused ranges of one frame.

        Args:
            by_method: ranges of `track_id`, in its order, by method; those of methods that are not fused are ignored.
            track_id: (N,) tracks of the frame.
            time_s: of the frame, never earlier than the one before.
        """
        model, m = self._model, len(self._model.names)
        track = TrackBiases.from_columns(self._tracks.get(track_id), m)
        measured = Measurements.of(by_method, model, track_id)
        has_any = measured.valid.any(axis=0)

        # Predict: biases return to their prior, over a gap at once when it ends.
        elapsed_s = np.fmax(time_s - track.time_s, 0.0) * has_any
        track = track.decayed(np.exp(elapsed_s / -_MEMORY_S), model)

        # Select the methods that count, and estimate.
        superseded = (model.superseded_by[:, :, None] & measured.valid).any(axis=1)
        counts = measured.valid & ~superseded
        counts &= ~inconsistent_with_size(measured, counts, track, model)
        used = measured.only(counts)
        estimate = least_squares(used, track, model)
        contradicts = estimate.t2 > CONTRADICTION
        if contradicts.any():
            out = outliers(used, measured, estimate, track, model, contradicts=contradicts, time_s=time_s)
            if out.any():
                used = used.only(used.valid & ~out)
                estimate = least_squares(used, track, model)
            contradicts = out.any(axis=0) | (estimate.t2 > CONTRADICTION)

        # Update biases and agreement.
        track = _with_biases_learnt(track, used, estimate, model, contradicts=contradicts)
        is_undecided = (estimate.t2 > CONTRADICTION) & (track.n_agreements < TRUSTED_FRAMES)
        change = ((estimate.n_valid > 1) & ~contradicts) - 2.0 * contradicts
        moved = np.fmax(np.abs(estimate.log_m - track.log_m), 0.0) * has_any  # a new track has not moved
        track = replace(
            track.decayed(np.exp(moved / -_MEMORY_LOG), model),
            log_m=np.where(has_any, estimate.log_m, track.log_m),
            variance=np.where(has_any, estimate.variance, track.variance),
            time_s=np.where(has_any, time_s, track.time_s),
            n_agreements=np.minimum(np.maximum(track.n_agreements + change, 0.0), _MAX_AGREEMENTS),
            n_conflicts=track.n_conflicts + is_undecided,
            reference_s=np.where(used.valid[model.reference].any(axis=0), time_s, track.reference_s),
        )
        is_recent = time_s - TrackBiases.times_s(self._tracks.known) <= _MAX_GAP_S
        self._tracks.put(track_id, track.to_columns(), keep_known=is_recent)

        distance_m = np.where(has_any, np.exp(estimate.log_m), np.nan)
        sigma_m = distance_m * np.sqrt(estimate.variance * np.maximum(1.0, estimate.chi2_per_dof))
        is_reference = (time_s - track.reference_s <= _REFERENCE_S) | (
            track.u_variance[model.size] < _KNOWN_BIAS_VARIANCE
        ).any(axis=0)
        scale_source = np.where(is_reference, int(ScaleSource.REFERENCE), int(ScaleSource.ASSUMED))
        return Fused(Ranges(track_id, distance_m, sigma_m), scale_source, track.n_conflicts.astype(np.int64))


def _with_biases_learnt(
    track: TrackBiases, used: Measurements, estimate: Estimate, model: ErrorModel, *, contradicts: BoolArray
) -> TrackBiases:
    """The tracks with u and C updated by the differences between methods."""
    size, matching = model.size[:, None], model.matching
    is_apart = np.abs(used.z[size] - used.z[matching]) > _MAX_BIAS_SIGMA * np.hypot(
        used.sigma[size], used.sigma[matching]
    )
    is_implausible = (used.valid[size] & used.valid[matching] & is_apart).any(axis=(0, 1))
    caution = np.sqrt(CONTRADICTION / np.maximum(estimate.t2, CONTRADICTION))
    t = model.is_learnt * (caution * ~is_implausible)
    V = track.C * estimate.k  # C K
    B = np.einsum("ajn,bjn->abn", np.einsum("ain,ijn->ajn", V, estimate.P), V)
    B = (B + B.transpose(1, 0, 2)) / 2  # rounding errors that are not symmetric would grow from frame to frame
    u = track.u + t * (V * estimate.residual).sum(axis=1)
    C = track.C - B * (1.0 - (1.0 - t[:, None]) * (1.0 - t))
    if contradicts.any():
        learnt = model.is_learnt * model.is_learnt.T * model.systematic_correlation
        C += _DOUBT * learnt[:, :, None] * contradicts
    return replace(track, u=u, C=C)
