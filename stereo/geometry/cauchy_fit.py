"""cauchy_fit: linear least squares with Cauchy weights, for points of which some are wrong."""

from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.robust_statistics import mad_sigma


class CauchyFit(NamedTuple):
    """A linear fit with Cauchy weights."""

    solution: FloatArray  # (P,)
    covariance: FloatArray  # (P, P)
    residual: FloatArray  # (N,) values minus fitted ones


def cauchy_fit(
    design: FloatArray,
    values: FloatArray,
    *,
    least_scale: float,
    n_rounds: int = 4,
) -> CauchyFit:
    """The parameters (P,) with which a design (N, P) explains values (N,), some of which are wrong.

    Iteratively reweighted least squares, from equal weights: a residual of two standard deviations
    has half the weight. The standard deviation is that of the residuals (MAD), at least
    `least_scale`.
    """
    terms = np.ascontiguousarray(design.T)  # (P, N)
    weighted = terms
    ridge = 1e-6 * len(values) * np.eye(len(terms))
    for _ in range(n_rounds):
        information = weighted @ terms.T + ridge
        solution = cv2.solve(information, (weighted @ values)[:, None])[1][:, 0]
        residual = values - solution @ terms
        scale = max(mad_sigma(residual), least_scale)
        weighted = terms / (1 + (residual / (2 * scale)) ** 2)
    covariance = np.asarray(np.linalg.inv(information) * scale**2, np.float64)
    return CauchyFit(np.asarray(solution, np.float64), covariance, residual)
