r"""CameraPosterior: the unknowns of the cameras by all evidence together.

Unknowns, as logarithms of factors: the error g of the rig (its baseline), a of all distances by
size, h of the camera's height over the expected one, f of the focal length and u of the given
speed.

    log d_stereo - log d_size of the road users                      = g - a        own sizes, wrong matches
    log height of the camera over their contact points by size       = h + a
    log height by stereo odometry over the motion of the road        = g + h
    log height by the given speed over the motion of the road        = h - f + u    one camera
    log speed by stereo odometry - log given speed                   = g + f - u
    log height by the usual width of the lane, from its lines        = h
    log focal length - log f by the shapes of vehicles' boxes        = f
    log of an impossible speed by stereo odometry over the largest   < g + f

Every unknown has a prior: for a, the deviation of the region; for h, a usual or the given height;
for g, f and u, the precision of calibrations and receivers. Because all unknowns are estimated
together, a scale learnt from one of them cannot correct another in circles. A usual height and a
usual lane have heavy tails, and alone exclude nothing: there are lorries and robots.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.ranging.cameras.evidence import Evidence
from track_range.ranging.cameras.unknowns import CameraPriors, Unknown

FREE_SIGMA = 3.0  # of a mistake
_TAILS = 4.0  # largest chi-squared of a usual value


@dataclass(frozen=True, slots=True)
class CameraPosterior:
    """The unknowns (U,) that fit the evidence best, their covariance, and chi-squared."""

    unknowns: tuple[Unknown, ...]
    mean: FloatArray  # (U,)
    covariance: FloatArray  # (U, U)
    chi2: float

    def estimate(self, unknown: Unknown) -> tuple[float, float]:
        """Mean and standard deviation of an unknown."""
        k = self.unknowns.index(unknown)
        return float(self.mean[k]), math.sqrt(self.covariance[k, k])

    def correction(self, coefficients: Mapping[Unknown, float]) -> float:
        """Mean of a sum of unknowns."""
        return float(self._row(coefficients) @ self.mean)

    def sigma_of(self, coefficients: Mapping[Unknown, float]) -> float:
        """Standard deviation of a sum of unknowns."""
        row = self._row(coefficients)
        return math.sqrt(row @ self.covariance @ row)

    def _row(self, coefficients: Mapping[Unknown, float]) -> FloatArray:
        return np.array([coefficients.get(unknown, 0.0) for unknown in self.unknowns])


def posterior(
    priors: CameraPriors, evidence: Sequence[Evidence], *, bounds: Sequence[Evidence] = ()
) -> CameraPosterior:
    """The posterior of the unknowns; a usual value or evidence that may be wrong adds a cost.

    A bound is evidence that counts only if the unknowns would be below its value.
    """
    fits = []
    for (of_priors, price), (items, other_price) in itertools.product(
        _priors(priors), _kept(evidence)
    ):
        solution = _solved(of_priors, items)
        broken = [item for item in bounds if item.value > solution.correction(item.of)]
        if broken:
            solution = _solved(of_priors, [*items, *broken])
        fits.append(replace(solution, chi2=solution.chi2 + price + other_price))
    return min(fits, key=lambda solution: solution.chi2)


def _priors(priors: CameraPriors) -> list[tuple[CameraPriors, float]]:
    """The priors with usual and with unusual values, and the cost of each choice."""
    choices: list[tuple[CameraPriors, float]] = [(priors, 0.0)]
    for unknown, prior in priors.items():
        if prior.kind == "usual":
            unusual = {unknown: replace(prior, sigma=FREE_SIGMA)}
            choices += [({**chosen, **unusual}, cost + _TAILS) for chosen, cost in choices]
    return choices


def _kept(evidence: Sequence[Evidence]) -> list[tuple[list[Evidence], float]]:
    """The evidence with and without each part that may be wrong, and the cost of each choice."""
    choices: list[tuple[list[Evidence], float]] = [(list(evidence), 0.0)]
    for item in evidence:
        if math.isfinite(item.max_chi2):
            choices += [
                ([kept for kept in chosen if kept is not item], cost + item.max_chi2)
                for chosen, cost in choices
            ]
    return choices


def _solved(priors: CameraPriors, evidence: Sequence[Evidence]) -> CameraPosterior:
    unknowns = tuple(priors)
    sigma = np.array([prior.sigma for prior in priors.values()] + [item.sigma for item in evidence])
    of = [[item.of.get(unknown, 0.0) for unknown in unknowns] for item in evidence]
    A = np.array([*np.eye(len(unknowns)), *of]) / sigma[:, None]
    b = np.array([*np.zeros(len(unknowns)), *(item.value for item in evidence)]) / sigma
    P = np.linalg.inv(A.T @ A)
    x = P @ (A.T @ b)
    residual = A @ x - b
    return CameraPosterior(unknowns, x, P, float(residual @ residual))
