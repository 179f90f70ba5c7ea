"""Measurements of one frame, biases of its tracks, and the generalised least squares estimate from both.

Arrays are over M methods and N tracks, tracks last; the symbols are those of `fusion`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.fusion.error_model import ErrorModel
from track_range.ranging.ranges import Ranges

_TINY = 1e-300


@dataclass(frozen=True, slots=True)
class Measurements:
    """The ranges of one frame.

    Attributes:
        z: (M, N) log distance, 0 where there is none.
        sigma: (M, N) its standard deviation, which is the relative one of the distance; 0 where there is none.
        valid: (M, N) whether there is a measurement.
    """

    z: FloatArray
    sigma: FloatArray
    valid: BoolArray

    @classmethod
    def of(cls, by_method: Mapping[str, Ranges], model: ErrorModel, track_id: IntArray) -> Measurements:
        """Those of the model's methods; a method that is missing has measured nothing."""
        distance_m, sigma_m = np.full((2, len(model.names), len(track_id)), np.nan)
        for i, name in enumerate(model.names):
            if name in by_method:
                distance_m[i], sigma_m[i] = by_method[name].distance_m, by_method[name].sigma_m
        valid = np.isfinite(distance_m) & (distance_m > 0) & (sigma_m > 0)
        distance_m = np.where(valid, distance_m, 1.0)
        return cls(np.log(distance_m), np.where(valid, sigma_m, 0.0) / distance_m, valid)

    def only(self, valid: BoolArray) -> Measurements:
        """Only those where `valid` (M, N) holds."""
        return Measurements(self.z * valid, self.sigma * valid, valid)

    def of_tracks(self, tracks: IntArray) -> Measurements:
        """Of the tracks with these indices only."""
        return Measurements(self.z[:, tracks], self.sigma[:, tracks], self.valid[:, tracks])


@dataclass(frozen=True, slots=True)
class TrackBiases:
    """What fusion remembers of each track.

    Attributes:
        u: (M, N) bias of each method, in units of the systematic part of its sigma.
        C: (M, M, N) covariance of u.
        log_m: (N,) log distance when the track was last measured; NaN = never.
        variance: (N,) variance of `log_m`; NaN = never measured.
        time_s: (N,) time of the last measurement; NaN = never.
        n_agreements: (N,) frames in which methods agreed, less two for each in which they did not; within limits.
        n_conflicts: (N,) frames in which methods contradicted each other and the track's past did not decide.
        reference_s: (N,) time of the last measurement of a scale reference; NaN = never.
    """

    u: FloatArray
    C: FloatArray
    log_m: FloatArray
    variance: FloatArray
    time_s: FloatArray
    n_agreements: FloatArray
    n_conflicts: FloatArray
    reference_s: FloatArray

    @classmethod
    def from_columns(cls, columns: FloatArray, m: int) -> TrackBiases:
        """Biases of `m` methods from columns (m + m m + 6, N)."""
        return cls(columns[:m], columns[m : m + m * m].reshape(m, m, -1), *columns[m + m * m :])

    @staticmethod
    def times_s(columns: FloatArray) -> FloatArray:
        """(N,) `time_s` of such columns."""
        return np.asarray(columns[-4])

    def to_columns(self) -> FloatArray:
        """The columns (M + M M + 6, N)."""
        others = [self.log_m, self.variance, self.time_s, self.n_agreements, self.n_conflicts, self.reference_s]
        return np.concatenate([self.u, self.C.reshape(len(self.u) ** 2, self.u.shape[1]), others])

    @staticmethod
    def initial_column(model: ErrorModel) -> FloatArray:
        """(M + M M + 6,) column of a new track: u = 0 with the covariance C0."""
        others = [np.nan, np.nan, np.nan, 0.0, 0.0, np.nan]
        return np.concatenate([np.zeros(len(model.names)), model.systematic_correlation.ravel(), others])

    def of_tracks(self, tracks: IntArray) -> TrackBiases:
        """Of the tracks with these indices only."""
        return TrackBiases(*(getattr(self, field.name)[..., tracks] for field in fields(self)))

    @property
    def u_variance(self) -> FloatArray:
        """(M, N) variance of u, the diagonal of C."""
        return self.C.reshape(len(self.u) ** 2, self.u.shape[1])[:: len(self.u) + 1]

    def decayed(self, share: FloatArray, model: ErrorModel) -> TrackBiases:
        """With u moved towards 0 and C towards C0; `share` (N,) of u is left."""
        C0 = model.systematic_correlation[:, :, None]
        return replace(self, u=self.u * share, C=C0 + (self.C - C0) * (share * share))


@dataclass(frozen=True, slots=True)
class Estimate:
    """Log distance from one frame's measurements, given the biases; 0 in M and N where there is no measurement.

    Attributes:
        log_m: (N,) log distance.
        variance: (N,) its variance; meaningless where no method measured.
        k: (M, N) systematic part of sigma.
        y: (M, N) measurements without their biases.
        A: (M, M, N) covariance of y.
        P: (M, M, N) information of the differences between methods, of those that measured.
        residual: (M, N) P y.
        t2: (N,) largest squared deviation of a method from all others, in units of its variance.
        chi2_per_dof: (N,) chi^2 of the differences per degree of freedom.
        n_valid: (N,) how many methods measured.
    """

    log_m: FloatArray
    variance: FloatArray
    k: FloatArray
    y: FloatArray
    A: FloatArray
    P: FloatArray
    residual: FloatArray
    t2: FloatArray
    chi2_per_dof: FloatArray
    n_valid: IntArray


def least_squares(used: Measurements, track: TrackBiases, model: ErrorModel) -> Estimate:
    """Log d by generalised least squares over the valid methods, and by how much they differ."""
    k = used.sigma * model.systematic
    y = used.z - k * track.u
    A = used.sigma[:, None] * used.sigma * (model.systematic_covariance * track.C + model.independent_covariance)
    n_valid = used.valid.sum(axis=0)

    information = _inverse(A, used.valid)
    of_one = information.sum(axis=1) * used.valid  # A^-1 1
    total = np.maximum(of_one.sum(axis=0), _TINY)  # 1' A^-1 1
    w, variance = of_one / total, 1.0 / total
    P = information - of_one[:, None] * w
    if any((used.valid[i] & used.valid[j]).any() for i, j in model.similar):
        w = _without_extrapolation(w, A, used.valid, model.similar)
        variance = np.einsum("in,ijn,jn->n", w, A, w)
    log_m = (w * y).sum(axis=0)

    distance = (y - log_m) * used.valid  # P 1 = 0: the same P y, from smaller numbers
    residual = (P * distance).sum(axis=1)
    t2 = (residual * residual / np.maximum(np.einsum("iin->in", P), _TINY)).max(axis=0)
    chi2_per_dof = (distance * residual).sum(axis=0) / np.maximum(n_valid - 1, 1)
    return Estimate(log_m, variance, k, y, A, P, residual, t2, chi2_per_dof, n_valid)


def _without_extrapolation(
    w: FloatArray, A: FloatArray, valid: BoolArray, similar: Sequence[tuple[int, int]]
) -> FloatArray:
    """The weights of least squares without negative ones between similar methods, which leave one by one.

    Args:
        w: (M, N) weights of the valid methods.
        A: (M, M, N) covariance of the measurements.
        valid: (M, N) which there are.
        similar: pairs of methods that share most of their errors.
    """
    w, valid = w.copy(), valid.copy()
    while True:
        similar_w = np.zeros_like(w)
        for i, j in similar:
            both = valid[i] & valid[j]
            similar_w[i], similar_w[j] = np.where(both, w[i], similar_w[i]), np.where(both, w[j], similar_w[j])
        worst = similar_w.min(axis=0, initial=0.0)
        columns = np.flatnonzero(worst < 0)
        if not len(columns):
            return w
        valid[:, columns] &= similar_w[:, columns] > worst[columns]
        part = valid[:, columns]
        of_one = _inverse(A[:, :, columns] * part * part[:, None], part).sum(axis=1) * part
        w[:, columns] = of_one / of_one.sum(axis=0)


def _inverse(A: FloatArray, valid: BoolArray) -> FloatArray:
    """(M, M, N) inverses of the valid parts of covariances A, which are 0 outside of them; 1 on the diagonal there."""
    complete = A.transpose(2, 0, 1).copy()
    complete.reshape(-1, len(A) ** 2)[:, :: len(A) + 1] += ~valid.T
    return np.asarray(np.linalg.inv(complete).transpose(1, 2, 0), np.float64)
