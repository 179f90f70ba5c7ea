"""Generalised least squares estimate of log distances from one frame's measurements and the biases
of its tracks.

Arrays are over M methods and N tracks, tracks last. Symbols are defined in the docstring of
`fusion`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.fusion.error_model import ErrorModel
from track_range.ranging.measurement.ranges import Ranges

_TINY = 1e-300  # lower bound of divisors that are 0 for tracks without a measurement


@dataclass(frozen=True, slots=True)
class Measurements:
    """Ranges of N tracks in one frame by M methods, as logarithms."""

    z: FloatArray  # (M, N) log distance; 0 = not measured
    # (M, N) standard deviation of z, equal to the relative one of the distance; 0 = not measured
    sigma: FloatArray
    valid: BoolArray  # (M, N) whether the track is measured

    @classmethod
    def of(
        cls, by_method: Mapping[str, Ranges], model: ErrorModel, track_id: IntArray
    ) -> Measurements:
        """Measurements of the model's methods; a method that is missing in `by_method` has not
        measured any track.
        """
        unmeasured = np.full(len(track_id), np.nan)
        missing = Ranges(track_id, unmeasured, unmeasured)
        methods = [by_method.get(name, missing) for name in model.names]
        distance_m = np.array([ranges.distance_m for ranges in methods])
        sigma_m = np.array([ranges.sigma_m for ranges in methods])
        valid = (distance_m > 0) & (distance_m < np.inf) & (sigma_m > 0)
        distance_m = np.where(valid, distance_m, 1.0)
        return cls(np.log(distance_m), np.where(valid, sigma_m, 0.0) / distance_m, valid)

    def only(self, valid: BoolArray) -> Measurements:
        """The measurements selected by the mask `valid` (M, N)."""
        return Measurements(self.z * valid, self.sigma * valid, valid)

    def of_tracks(self, tracks: IntArray) -> Measurements:
        """The measurements of the tracks with the indices `tracks`."""
        return Measurements(self.z[:, tracks], self.sigma[:, tracks], self.valid[:, tracks])


@dataclass(frozen=True, slots=True)
class TrackBiases:
    """State of fusion for N tracks: biases of the methods, and the last estimate."""

    u: FloatArray  # (M, N) bias of each method, in units of the systematic part of its sigma
    C: FloatArray  # (M, M, N) covariance of u
    log_m: FloatArray  # (N,) log distance at the last measurement; NaN = never measured
    variance: FloatArray  # (N,) variance of `log_m`; NaN = never measured
    time_s: FloatArray  # (N,) time of the last measurement; NaN = never measured
    # (N,) frames in which methods agreed, minus 2 for each with a conflict; limited
    n_agreements: FloatArray
    n_conflicts: FloatArray  # (N,) frames with a conflict that the track's history did not resolve
    reference_s: FloatArray  # (N,) time of the last measurement of a scale reference; NaN = never

    @classmethod
    def from_columns(cls, columns: FloatArray, m: int) -> TrackBiases:
        """Biases of `m` methods from `columns` (m + m m + 6, N), the inverse of `to_columns`."""
        return cls(columns[:m], columns[m : m + m * m].reshape(m, m, -1), *columns[m + m * m :])

    def to_columns(self) -> FloatArray:
        """(M + M M + 6, N) all attributes, one column per track."""
        m, n = self.u.shape
        columns = np.empty((m + m * m + 6, n))
        columns[:m], columns[m : m + m * m] = self.u, self.C.reshape(m * m, n)
        columns[m + m * m :] = (
            self.log_m,
            self.variance,
            self.time_s,
            self.n_agreements,
            self.n_conflicts,
            self.reference_s,
        )
        return columns

    @staticmethod
    def initial_column(model: ErrorModel) -> FloatArray:
        """(M + M M + 6,) column of a new track: u = 0, C = C0."""
        others = [np.nan, np.nan, np.nan, 0.0, 0.0, np.nan]
        return np.concatenate(
            [np.zeros(len(model.names)), model.systematic_correlation.ravel(), others]
        )

    def of_tracks(self, tracks: IntArray) -> TrackBiases:
        """The biases of the tracks with the indices `tracks`."""
        return TrackBiases(*(getattr(self, field.name)[..., tracks] for field in fields(self)))

    @property
    def u_variance(self) -> FloatArray:
        """(M, N) variance of u, the diagonal of C."""
        return self.C.reshape(len(self.u) ** 2, self.u.shape[1])[:: len(self.u) + 1]

    def decayed(self, fraction: FloatArray, model: ErrorModel) -> TrackBiases:
        """Biases decayed towards the prior: u multiplied by `fraction` (N,), C moved towards C0."""
        C0 = model.systematic_correlation[:, :, None]
        return self.with_biases(self.u * fraction, C0 + (self.C - C0) * (fraction * fraction))

    def with_biases(self, u: FloatArray, C: FloatArray) -> TrackBiases:
        """The state with other biases."""
        return replace(self, u=u, C=C)


@dataclass(frozen=True, slots=True)
class Estimate:
    """Log distances from one frame's measurements, given the biases; entries without a measurement
    are 0.
    """

    log_m: FloatArray  # (N,) log distance
    variance: FloatArray  # (N,) variance of `log_m`; undefined for tracks without a measurement
    k: FloatArray  # (M, N) systematic part of sigma
    y: FloatArray  # (M, N) measurements minus their biases
    A: FloatArray  # (M, M, N) covariance of y
    P: FloatArray  # (M, M, N) information of the differences between the valid methods
    residual: FloatArray  # (M, N) P y
    # (N,) largest t_i^2: squared deviation of a method from all others, in units of its variance
    t2: FloatArray
    chi2_per_dof: FloatArray  # (N,) chi^2 of the differences per degree of freedom
    n_valid: IntArray  # (N,) number of valid methods


def least_squares(used: Measurements, track: TrackBiases, model: ErrorModel) -> Estimate:
    """Estimate of log d by generalised least squares over the valid methods, with their
    residuals.
    """
    k = used.sigma * model.systematic
    y = used.z - k * track.u
    A = (
        used.sigma[:, None]
        * used.sigma
        * (model.systematic_covariance * track.C + model.independent_covariance)
    )
    n_valid = np.add.reduce(used.valid, axis=0, dtype=np.int64)

    A_inv = _inverse(A, used.valid)
    A_inv_1 = np.add.reduce(A_inv, axis=1) * used.valid  # A^-1 1
    information = np.maximum(np.add.reduce(A_inv_1), _TINY)  # 1' A^-1 1
    w, variance = A_inv_1 / information, 1.0 / information
    P = A_inv - A_inv_1[:, None] * w
    one, other = used.valid[model.similar]
    if (one & other).any():
        w = _without_extrapolation(w, A, used.valid, model.similar)
        variance = np.einsum("in,ijn,jn->n", w, A, w)
    log_m = np.add.reduce(w * y)

    difference = (y - log_m) * used.valid  # P 1 = 0, so P y = P (y - log d), from smaller numbers
    residual = np.add.reduce(P * difference, axis=1)
    m, n = residual.shape
    own = P.reshape(m * m, n)[:: m + 1]  # P_ii
    t2 = (residual * residual / np.maximum(own, _TINY)).max(axis=0)
    chi2_per_dof = np.add.reduce(difference * residual) / np.maximum(n_valid - 1, 1)
    return Estimate(log_m, variance, k, y, A, P, residual, t2, chi2_per_dof, n_valid)


def _without_extrapolation(
    w: FloatArray, A: FloatArray, valid: BoolArray, similar: IntArray
) -> FloatArray:
    """(M, N) least-squares weights after similar methods with negative weights were removed one by
    one.

    `A` (M, M, N) is the covariance of the measurements, `similar` (2, K) are pairs of methods that
    share most errors.
    """
    w, valid = w.copy(), valid.copy()
    while True:
        similar_w = np.zeros_like(w)
        for i, j in similar.T.tolist():
            both = valid[i] & valid[j]
            similar_w[i], similar_w[j] = (
                np.where(both, w[i], similar_w[i]),
                np.where(both, w[j], similar_w[j]),
            )
        worst = similar_w.min(axis=0, initial=0.0)
        columns = np.flatnonzero(worst < 0)
        if not len(columns):
            return w
        valid[:, columns] &= similar_w[:, columns] > worst[columns]
        part = valid[:, columns]
        A_inv_1 = _inverse(A[:, :, columns] * part * part[:, None], part).sum(axis=1) * part
        w[:, columns] = A_inv_1 / A_inv_1.sum(axis=0)


def _inverse(A: FloatArray, valid: BoolArray) -> FloatArray:
    """(M, M, N) inverses of covariances A, which are 0 outside their valid parts; the identity is
    inserted there.
    """
    complete = A.transpose(2, 0, 1).copy()
    complete.reshape(-1, len(A) ** 2)[:, :: len(A) + 1] += ~valid.T
    return np.asarray(np.linalg.inv(complete).transpose(1, 2, 0), np.float64)
