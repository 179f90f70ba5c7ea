r"""CameraPosterior: the unknowns of the cameras by all evidence together.

Unknowns, as logarithms of factors: the error g of the rig (its baseline), a of all distances by
size, h of the camera's height over the expected one, f of the focal length, u of the given speed,
c of the frame rate, and n of the depths of a network at the assumed focal length.

    log d_stereo - log d_size of the road users                      = g - a
    log height of the camera over their contact points by size       = h + a
    log height by stereo odometry over the motion of the road        = g + h
    log height by the given speed over the motion of the road        = h - f - c + u    one camera
    log speed by stereo odometry - log given speed                   = g + f + c - u
    log height by the usual width of the lane, from its lines        = h
    log d_network - log d_size of the road users, of each network    = n - a        without a pair
    log d_network - log d_stereo                                     = n - g
    log focal length - log f by the shapes of vehicles' boxes        = f
    log of an impossible speed by stereo odometry over the largest   < g + f + c
    log of the height of the highest vehicles over the assumed one   > h

Every unknown has a prior: for a, the deviation of the region; for h, a usual or the given height;
for g, f and u, the precision of calibrations and receivers. Because all unknowns are estimated
together, a scale learnt from one of them cannot correct another in circles.

Bayesian model averaging: one hypothesis is that all given values are right; in each other one, a
given value is a mistake, with a wide prior or at a known factor (`unknowns.mistakes`). A usual
height has heavy tails, and so have the widths of lanes: there are lorries and robots. Each
hypothesis is a linear model with normal errors, whose probability is its marginal likelihood

    log p(H | data) = log p(H) - chi2 / 2 + (log det P - log det P0) / 2 + const.

with the covariances P0 before and P after the evidence. Sigmas are those of the mixture: a mistake
widens them in proportion to how probable it is, and there is no threshold.

A curve of the focal length (`Prior.curve`) is its prior instead of a normal one. Its narrow parts
are normal, so that each is one more equation, and every hypothesis becomes as many components as
the curve has probable parts.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import logsumexp, ndtr

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.cameras.evidence import Evidence
from track_range.ranging.cameras.unknowns import (
    AnyUnknown,
    CameraPriors,
    PriorPart,
    Sum,
    Unknown,
    mistakes,
    unusual,
)

_SIGMAS = {sigmas: 2 * float(ndtr(sigmas)) - 1 for sigmas in (2.0, 1.0)}
"""Probability of errors within 2 sigma and within 1 sigma."""

_MAX_ERROR, _PRECISION = 20.0, 1e-9  # largest relative error that sigma can have; that of sigma
# parts of a curve, and the smallest log weight of a component relative to the largest one
_N_PARTS, _MIN_LOG_WEIGHT = 24, -10.0


class _Hypothesis(NamedTuple):
    """Normal distributions instead of the usual prior of some unknowns."""

    cause: Unknown | None  # the given value that is a mistake; None = all are right
    parts: Mapping[AnyUnknown, PriorPart]
    left_out: frozenset[int] = frozenset()  # indices of evidence that is wrong
    log_weight: float = 0.0


class LogEstimate(NamedTuple):
    """Mean and standard deviation of an unknown or of a sum of unknowns."""

    mean: float
    sigma: float


@dataclass(frozen=True, slots=True)
class CameraPosterior:
    """The unknowns (U,) by C hypotheses."""

    unknowns: tuple[AnyUnknown, ...]
    cause: tuple[Unknown | None, ...]  # (C,) the given value that is a mistake; None = none is
    weight: FloatArray  # (C,) probability
    mean: FloatArray  # (C, U)
    covariance: FloatArray  # (C, U, U)

    def probability(self, cause: Unknown | None) -> float:
        """Probability that this given value is a mistake; None = that all are right."""
        return float(self.weight[self._rows(cause)].sum())

    def estimate(self, of: Sum, cause: Unknown | None = None) -> LogEstimate:
        """A sum of unknowns with these coefficients, if this given value is a mistake; None = if
        all are right.
        """
        rows = self._rows(cause)
        mean, variance = (value[rows] for value in self._sum(of))
        weight = self.weight[rows] / self.weight[rows].sum()
        total = float(weight @ mean)
        return LogEstimate(total, math.sqrt(weight @ (variance + (mean - total) ** 2)))

    def correction(self, of: Sum) -> float:
        """Mean of a sum of unknowns over all hypotheses."""
        return float(self.weight @ self._sum(of)[0])

    def sigma_of(self, of: Sum, corrected: float = 0.0) -> float:
        """Relative standard deviation of what is too large by a sum of unknowns, and was corrected
        for this logarithm.

        It is such that errors are within 1 and 2 sigma as often as those of a normal distribution:
        rare hypotheses of large errors do not widen it, and probable ones are covered.
        """
        log_factor, variance = self._sum(of)
        if not variance.any():
            return 0.0
        factor = np.exp(corrected - log_factor)  # true over reported
        return _covering(self.weight, 1.0 - factor, factor * np.sqrt(variance))

    def error_of(self, of: Sum, corrected: float) -> float:
        """The same of a sum itself, which is not a logarithm, instead of the standard deviation."""
        mean, variance = self._sum(of)
        return _covering(self.weight, mean - corrected, np.sqrt(variance))

    def log_density(self, of: Sum, values: FloatArray) -> FloatArray:
        """(G,) log probability density of a sum of unknowns over all hypotheses, at values (G,)."""
        mean, variance = self._sum(of)
        log_p = -0.5 * (values[:, None] - mean) ** 2 / variance
        return np.asarray(logsumexp(log_p, axis=1, b=self.weight / np.sqrt(variance)))

    def covariance_of(self, a: Sum, b: Sum) -> float:
        """Covariance of two sums of unknowns over all hypotheses."""
        (mean_a, _), (mean_b, _) = self._sum(a), self._sum(b)
        within = np.einsum("u,cuv,v->c", self._row(a), self.covariance, self._row(b))
        between = (mean_a - self.weight @ mean_a) * (mean_b - self.weight @ mean_b)
        return float(self.weight @ (within + between))

    def _rows(self, cause: Unknown | None) -> list[int]:
        return [k for k, other in enumerate(self.cause) if other is cause]

    def _row(self, of: Sum) -> FloatArray:
        return np.array([of.get(unknown, 0.0) for unknown in self.unknowns])

    def _sum(self, of: Sum) -> tuple[FloatArray, FloatArray]:
        """(C,) mean and variance of a sum of unknowns."""
        row = self._row(of)
        return self.mean @ row, np.einsum("u,cuv,v->c", row, self.covariance, row)


def _covering(weight: FloatArray, error: FloatArray, sigma: FloatArray) -> float:
    """The standard deviation that covers normal errors of mean `error` and `sigma` (C,) with the
    probabilities `weight`.
    """

    def excess(reach: float, probability: float) -> float:
        """How much more probable errors up to `reach` are."""
        within = ndtr((reach - error) / sigma) - ndtr((-reach - error) / sigma)
        return float(within @ weight) - probability

    rms = math.sqrt(weight @ (error * error + sigma * sigma))
    sigmas = []
    for n_sigmas, probability in _SIGMAS.items():
        # by Chebyshev's inequality, no error distribution reaches farther
        most = min(1.01 * rms / math.sqrt(1.0 - probability), _MAX_ERROR)
        reach = most
        if excess(most, probability) > 0:
            reach = brentq(excess, 0.0, most, (probability,), _PRECISION, _PRECISION)
        sigmas.append(reach / n_sigmas)
    return max(sigmas)


def posterior(
    priors: CameraPriors, evidence: Sequence[Evidence], *, bounds: Sequence[Evidence] = ()
) -> CameraPosterior:
    """The posterior of the unknowns; a bound is evidence that counts only where the unknowns would
    be below its value.
    """
    unknowns, items = tuple(priors), [*evidence, *bounds]
    named = {unknown for item in items for unknown in item.of}
    hypotheses = _hypotheses(priors, evidence, named)
    usual = [prior.part for prior in priors.values()]
    parts = [
        [one.parts.get(unknown, part) for unknown, part in zip(unknowns, usual, strict=True)]
        for one in hypotheses
    ]
    of_priors = np.reshape(parts, (len(hypotheses), len(unknowns), 3))
    mean0, sigma0 = of_priors[:, :, 1], of_priors[:, :, 2]  # (C, U)
    A = np.array([[item.of.get(unknown, 0.0) for unknown in unknowns] for item in items])
    A = A.reshape(len(items), len(unknowns))
    value, sigma = (
        np.array([getattr(item, name) for item in items]) for name in ("value", "sigma")
    )
    used = np.array(
        [[k not in one.left_out for k in range(len(items))] for one in hypotheses], np.bool_
    )
    free = used.copy()
    free[:, len(evidence) :] = False
    x, *_ = _solved(mean0, sigma0, A, value, sigma, free)
    used[:, len(evidence) :] &= (x @ A.T < value)[:, len(evidence) :]
    x, P, log_p = _solved(mean0, sigma0, A, value, sigma, used)
    log_p = log_p + [one.log_weight for one in hypotheses]
    cause = np.arange(len(hypotheses))
    for k, prior in enumerate(priors.values()):
        if prior.curve is not None:
            p, mean, sigma = prior.curve.parts(_N_PARTS)
            parts_of_curve = np.log(p), math.log(prior.value) - mean, sigma
            cause, log_p, x, P = _along_curve(k, *parts_of_curve, log_p, x, P)
    weight = np.exp(log_p - log_p.max())
    causes = tuple(hypotheses[k].cause for k in cause.tolist())
    return CameraPosterior(unknowns, causes, weight / weight.sum(), x, P)


def _along_curve(
    k: int,
    log_part: FloatArray,
    value: FloatArray,
    sigma: FloatArray,
    log_p: FloatArray,
    x: FloatArray,
    P: FloatArray,
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Hypotheses (C,) after unknown `k` is within one of the parts (K,) of a curve: for each
    component (N,) its hypothesis, log weight, mean and covariance.
    """
    variance = P[:, k, k, None] + sigma**2  # (C, K)
    error = value - x[:, k, None]
    log_weight = log_p[:, None] + log_part - 0.5 * (error**2 / variance + np.log(variance))
    c, j = np.nonzero(log_weight > log_weight.max() + _MIN_LOG_WEIGHT)
    gain = P[c, :, k] / variance[c, j, None]  # (N, U)
    mean = x[c] + gain * error[c, j, None]
    covariance = P[c] - np.einsum("nu,nv->nuv", gain, P[c, :, k])
    return c, log_weight[c, j], mean, covariance


def _solved(
    mean0: FloatArray,
    sigma0: FloatArray,
    A: FloatArray,
    value: FloatArray,
    sigma: FloatArray,
    used: BoolArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean (C, U), covariance (C, U, U) and log of the marginal likelihood (C,)."""
    information = used / sigma**2  # (C, M)
    precision = np.einsum("cm,mu,mv->cuv", information, A, A)
    k = np.arange(sigma0.shape[1])
    precision[:, k, k] += sigma0**-2
    P = np.linalg.inv(precision)
    x = np.einsum("cuv,cv->cu", P, mean0 / sigma0**2 + (information * value) @ A)
    chi2 = (((x - mean0) / sigma0) ** 2).sum(axis=1)
    chi2 += (information * (x @ A.T - value) ** 2).sum(axis=1)
    log_volume = -0.5 * np.linalg.slogdet(precision)[1] - np.log(sigma0).sum(axis=1)
    return x, P, log_volume - 0.5 * chi2


def _hypotheses(
    priors: CameraPriors, evidence: Sequence[Evidence], named: set[AnyUnknown]
) -> list[_Hypothesis]:
    """All hypotheses; what no evidence names cannot be told from the others."""
    hypotheses = [_Hypothesis(None, {})]
    for unknown, prior in priors.items():
        if prior.kind == "given" and isinstance(unknown, Unknown) and unknown in named:
            hypotheses += [
                _Hypothesis(unknown, {unknown: part}, log_weight=part.log_weight)
                for part in mistakes(unknown)
            ]
    for unknown, prior in priors.items():
        if prior.kind == "usual":
            part = unusual()
            hypotheses += [
                one._replace(
                    parts={**one.parts, unknown: part}, log_weight=one.log_weight + part.log_weight
                )
                for one in hypotheses
            ]
    for k, item in enumerate(evidence):
        if math.isfinite(item.max_chi2):
            hypotheses += [
                one._replace(
                    left_out=one.left_out | {k}, log_weight=one.log_weight - item.max_chi2 / 2
                )
                for one in hypotheses
            ]
    return hypotheses
