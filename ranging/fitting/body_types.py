"""Fit of body types, the components of a mixture of Gaussians over the sizes of a class, to labelled objects.

Few objects of a body type are labelled, so that the types are fitted by maximum a posteriori expectation maximisation
(Dempster, Laird and Rubin 1977), with the sizes of production models as the prior: they count as `_STANDARD_OBJECTS`
objects of each type. With the weights w_i of the objects and n_0 standard objects:

    r_ib     ~  fraction_b N(x_i; mean_b, covariance_b)                              sum_b r_ib = 1
    fraction_b  =  (n_0 fraction_b0 + sum_i w_i r_ib) / (n_0 + sum_i w_i)
    mean_b   =  (n_0 mean_b0 + sum_i w_i r_ib x_i) / (n_0 + sum_i w_i r_ib)
    cov_b    =  weighted scatter about mean_b, of the objects and of the standard objects

x = log (height, width, length).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import multivariate_normal

from track_range.foundation.arrays import FloatArray
from track_range.ranging.size_models.prior import BodyType

_STANDARD_OBJECTS = 4.0  # weight of the standard sizes of a body type, as a number of objects
_N_ITERATIONS = 30  # iterations of expectation maximisation; a dozen suffice for some tens of objects
_CORRELATION = 0.3  # correlation between any two log sizes of the objects of one body type
_MAX_CORRELATION = 0.95  # largest absolute correlation in a curve file


@dataclass(frozen=True, slots=True)
class StandardBody:
    """Sizes of production models of one body type."""

    fraction: float  # probability of the type within its class
    hwl_m: tuple[float, float, float]  # height, width (without mirrors) and length in metres
    log_sigma: tuple[float, float, float]  # relative standard deviations of the sizes
    source: str  # models that the sizes are those of

    @property
    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Mean (3,) and covariance (3, 3) of the log sizes."""
        correlation = np.full((3, 3), _CORRELATION) + (1 - _CORRELATION) * np.identity(3)
        return np.log(self.hwl_m), correlation * np.outer(self.log_sigma, self.log_sigma)


STANDARD_BODIES: Mapping[str, Mapping[str, StandardBody]] = {
    "van": {
        "small": StandardBody(
            0.5, (1.85, 1.78, 4.35), (0.05, 0.05, 0.08), "VW Caddy, Renault Kangoo, Citroen Berlingo"
        ),
        "flat roof": StandardBody(0.25, (1.97, 1.92, 4.90), (0.05, 0.04, 0.07), "VW T5, Mercedes Vito, Renault Trafic"),
        "high roof": StandardBody(0.2, (2.50, 2.02, 5.75), (0.08, 0.05, 0.10), "Mercedes Sprinter, Ford Transit"),
        "box body": StandardBody(0.05, (3.00, 2.20, 6.50), (0.10, 0.08, 0.15), "lorries of 3.5 t with a box"),
    },
    "truck": {
        "light": StandardBody(0.15, (2.70, 2.15, 6.00), (0.10, 0.08, 0.15), "lorries of 3.5 t with a box or platform"),
        "heavy": StandardBody(0.85, (3.50, 2.50, 9.50), (0.12, 0.06, 0.30), "lorries of 7.5-40 t, at most 4 m high"),
    },
}
"""Sizes of production models by class and body type."""


def fit_body_types(name: str, log_size: FloatArray, weight: FloatArray) -> tuple[BodyType, ...]:
    """Body types of a class, fitted to M objects; empty for a class without body types.

    `log_size` (M, 3) is log height, width and length, `weight` (M,) the number of objects that each counts as.
    """
    standard = STANDARD_BODIES.get(name)
    if standard is None:
        return ()
    n_0 = _STANDARD_OBJECTS
    prior_fraction = np.array([body.fraction for body in standard.values()])
    prior_mean, prior_covariance = (
        np.array(part) for part in zip(*(b.moments for b in standard.values()), strict=True)
    )
    fraction, mean, covariance = prior_fraction, prior_mean, prior_covariance
    for _ in range(_N_ITERATIONS):
        log_density = [multivariate_normal(mean[b], covariance[b]).logpdf(log_size) for b in range(len(fraction))]
        log_r = np.log(fraction)[:, None] + np.reshape(log_density, (len(fraction), -1))
        r = np.exp(log_r - log_r.max(axis=0))
        r *= weight / r.sum(axis=0)
        n = r.sum(axis=1)[:, None]
        fraction = (n_0 * prior_fraction + n[:, 0]) / (n_0 + n.sum())
        mean = (n_0 * prior_mean + r @ log_size) / (n_0 + n)
        covariance = np.stack([_scatter(r[b], log_size - mean[b]) for b in range(len(fraction))])
        covariance += n_0 * (prior_covariance + _outer(prior_mean - mean))
        covariance /= (n_0 + n)[:, :, None]
    return tuple(_body(*row) for row in zip(standard, fraction, mean, covariance, strict=True))


def _scatter(weight: FloatArray, residual: FloatArray) -> FloatArray:
    return np.asarray((residual * weight[:, None]).T @ residual)


def _outer(residual: FloatArray) -> FloatArray:
    return np.asarray(residual[:, :, None] * residual[:, None, :])


def _body(name: str, fraction: float, mean: FloatArray, covariance: FloatArray) -> BodyType:
    sigma = np.sqrt(np.diag(covariance))
    correlation = np.clip(covariance / np.outer(sigma, sigma), -_MAX_CORRELATION, _MAX_CORRELATION)
    height, width, length = np.exp(mean).round(3).tolist()
    of_height, of_width, of_length = sigma.round(4).tolist()
    hw, hl, wl = correlation[[0, 0, 1], [1, 2, 2]].round(3).tolist()
    return BodyType(
        name=name,
        share=round(float(fraction), 4),
        hwl_m=(height, width, length),
        log_sigma=(of_height, of_width, of_length),
        correlation=(hw, hl, wl),
    )
