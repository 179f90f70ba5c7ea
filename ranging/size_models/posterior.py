"""Posterior of the log distance of a box from its size and its bottom edge, given the size priors
of its class.

    p(log d | box)  ~  p(log d)  sum_k w_k N(log h, log w; m_k(log d), S_k + R)  p(bottom | log d)

The sum is over yaw bins and body types k with prior weight w_k; m_k and S_k are mean and covariance
of the log box size, R the noise and systematic errors of the box. m_k is linear in log d about a
node of the `ShapeTables`, so that without the bottom edge log d is a mixture of Gaussians. The
likelihood of the bottom edge is not linear, so the product of prior and likelihood is evaluated on
a grid of log d.

The reported distance has the smallest expected relative error: it is the median under p(log d) / d.
Sigma is half the width of the central 68 %, or half the distance to the farther end of the central
95 % if it is larger: a second body type widens sigma if it is likely enough.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.ranging.size_models.prior import NODE_RANGE, ShapeTables
from track_range.ranging.size_models.shared_ground import (
    GroundContacts,
    GroundFromOthers,
    GroundPrior,
)
from track_range.ranging.size_models.size_model import BoxExtents

IMPOSSIBLE = -1e9  # log probability of a body type that a box cannot have
# variance of the log width of a box truncated at a side: the width carries no information
_UNSEEN_VARIANCE = 1e4

N_TERMS = 24  # number of Gaussians per box: the most likely yaw bins and body types
_N_GRID = 37  # number of points of the grid of log distance
_GRID_SIGMAS = 4.5  # half width of the grid in standard deviations of the distance by size
# (G,) grid points in standard deviations
_STEPS = np.linspace(-_GRID_SIGMAS, _GRID_SIGMAS, _N_GRID)

_TRAPEZOIDS = (np.triu(np.ones((_N_GRID, _N_GRID))) + np.triu(np.ones((_N_GRID, _N_GRID)), k=1)) / 2
_TRAPEZOIDS[0] -= 0.5
"""(G, G) trapezoidal rule: `density @ _TRAPEZOIDS` is the integral from the first grid point to
each point."""

_NOT_ON_THE_ROAD = 0.003  # likelihood per unit of tangent of a bottom edge on a bridge or balcony
# (weight, scale) of Gaussians: Student's t with 2 d.o.f.
_T_COMPONENTS = ((0.5, 0.8), (0.35, 2.0), (0.15, 5.0))

_Float32 = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class SizeMixture:
    """Log distance by size: a mixture of K Gaussians for each of N boxes."""

    mean: FloatArray  # (N, K) means of log d, d in metres
    variance: FloatArray  # (N, K) variances of log d
    weight: FloatArray  # (N, K) weights, which sum to 1 per box
    # (N,) part of the variance of log d that comes from the noise of the box
    frame_variance: FloatArray
    log_contact_ratio: FloatArray  # (N,) log of the distance divided by the nearest ground point's
    body: IntArray  # (N, K) index of each Gaussian's body type among the M possible ones
    # (N,) smallest squared deviation from a body type, plus 2 log (best weight / its weight)
    chi2: FloatArray


def mixture_by_size(
    tables: ShapeTables, boxes: BoxExtents, body: IntArray, log_fraction: FloatArray
) -> SizeMixture:
    """Log distance of N boxes from their size, without the bottom edge.

    `body` (M, N) are the possible body types of each box, `log_fraction` (M, N) their log
    probabilities; `IMPOSSIBLE` = excluded.
    """
    packed, n = _packed_terms(tables, boxes, body, log_fraction), len(boxes)
    n_all = packed.shape[1]
    n_terms = min(N_TERMS, n_all)
    best = np.argpartition(-_Terms._make(packed).log_weight.T, n_terms - 1, axis=1)[:, :n_terms]
    index = best * n + np.arange(n)[:, None]
    terms = _Terms._make(packed.reshape(len(packed), -1).take(index, axis=1).astype(np.float64))
    weight = np.exp(terms.log_weight - terms.log_weight.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    return SizeMixture(
        mean=terms.mean,
        variance=terms.variance,
        weight=weight,
        frame_variance=np.vecdot(weight, terms.noise_variance),
        log_contact_ratio=np.vecdot(weight, terms.log_contact_ratio),
        body=(np.arange(n_all) % len(body)).take(best),
        chi2=terms.chi2.min(axis=1),
    )


def log_evidence(
    tables: ShapeTables, boxes: BoxExtents, body: IntArray, log_fraction: FloatArray
) -> FloatArray:
    """(N,) log likelihood of log height and log width of N boxes, up to a constant per box;
    arguments as above.
    """
    log_weight = _Terms._make(_packed_terms(tables, boxes, body, log_fraction)).log_weight.astype(
        np.float64
    )
    largest = log_weight.max(axis=0)
    return np.asarray(largest + np.log(np.exp(log_weight - largest).sum(axis=0)))


class _Terms(NamedTuple):
    """Gaussians of log d, arrays of equal shape: the rows of one packed array, so that one `take`
    selects the best.
    """

    log_weight: FloatArray
    mean: FloatArray
    variance: FloatArray
    noise_variance: FloatArray  # part of the variance due to box noise
    log_contact_ratio: FloatArray
    chi2: FloatArray


def _packed_terms(
    tables: ShapeTables, boxes: BoxExtents, body: IntArray, log_fraction: FloatArray
) -> _Float32:
    """(6, K * M, N) the `_Terms` of all Gaussians of N boxes.

    With x = log d - log_m, slopes s of the log size at the node, V = S + R and prior x ~ N(x0, 1 /
    p0), the log size relative to the node is e = s x + N(0, V). Completing the square gives one
    Gaussian for x:

        precision   p = g's + p0,                   g = V^-1 s
        mean        x = (g'e + p0 x0) / p
        weight      log w - (e'V^-1 e + p0 x0^2 - p x^2 + log(p |V| / p0)) / 2

    For V = [v_h b; b v_w], in the code (a, c) = (v_h, v_w) / |V| and b / |V| are the entries of
    V^-1 = [c -b; -b a]. Arrays are (K, M, N), for K yaw bins, or broadcastable to this shape;
    arrays derived from the nodes are in single precision.
    """
    log_hw = np.log(boxes.wh_over_f.T[::-1])
    log_height, mean_log_m, precision = tables.typical.take(body, axis=1)
    guess = log_height - log_hw[0]
    inside = np.minimum(np.maximum(guess, NODE_RANGE[0]), NODE_RANGE[1])
    bearing_step, log_step, nodes = tables.at(body, np.abs(boxes.bearing), inside)
    # outside the nodes, size is inversely proportional to distance
    scaled = log_hw[:, None] + (guess - inside)
    noise = boxes.noise_variance.T[::-1]
    errors = noise + boxes.systematic_sigma.T[::-1] ** 2
    errors[1] += np.where(boxes.uses_width, 0.0, _UNSEEN_VARIANCE)
    log_m = guess - log_step

    x0, p0 = (mean_log_m - log_m).astype(np.float32), precision.astype(np.float32)
    R = errors.astype(np.float32)[:, None, None]
    e = (
        scaled.astype(np.float32)[:, None]
        - nodes.log_hw
        - bearing_step.astype(np.float32) * nodes.per_bearing
    )
    s, b, (e_h, e_w) = nodes.per_log_m, nodes.covariance, e
    V = nodes.variance + R
    det = V[0] * V[1] - b * b  # |V|
    scale = 1.0 / det
    V *= scale
    (a, c), b = V, b * scale
    g = V[::-1] * s
    g -= b * s[::-1]
    gs, ge = g * s, g * e
    p = gs[0] + gs[1] + p0
    inverse = 1.0 / p
    h = ge[0] + ge[1] + x0 * p0
    x = h * inverse
    chi2 = (c * e_h - 2 * b * e_w) * e_h + a * e_w * e_w + x0 * x0 * p0 - h * x
    log_weight = nodes.log_weight + log_fraction.astype(np.float32)
    g *= g
    g *= noise.astype(np.float32)[:, None, None]
    packed = np.empty((len(_Terms._fields), *b.shape), np.float32)
    terms = _Terms._make(packed)
    np.subtract(log_weight, 0.5 * (chi2 + np.log(p * det / p0)), out=terms.log_weight)
    np.add(log_m.astype(np.float32), x, out=terms.mean)
    terms.variance[:] = inverse
    np.multiply(g[0] + g[1], inverse * inverse, out=terms.noise_variance)
    terms.log_contact_ratio[:] = nodes.log_contact_ratio
    np.add(chi2, 2.0 * (log_weight.max(axis=(0, 1)) - log_weight), out=terms.chi2)
    return packed.reshape(len(packed), -1, len(boxes))


@dataclass(frozen=True, slots=True)
class LogGrid:
    """Densities of the log distance of N boxes on grids of G points."""

    log_m: FloatArray  # (N, G) grid points, evenly spaced per box
    density: FloatArray  # (N, G) density, scaled to the maximum 1 per box
    by_term: _Float32  # (K, N, G) densities of the Gaussians by size, without further evidence

    def times(self, likelihood: FloatArray) -> LogGrid:
        """The product with the likelihood (N, G) of further evidence."""
        density = self.density * likelihood
        density /= np.maximum(density.max(axis=1, keepdims=True), 1e-300)
        return LogGrid(self.log_m, density, self.by_term)

    def quantiles(self, levels: FloatArray, *, is_relative: bool = False) -> FloatArray:
        """(L, N) log distance at the quantiles `levels` (L,), 0..1, of the density, or of density /
        d.
        """
        first = self.log_m[:, :1]
        weight = self.density * np.exp(first - self.log_m) if is_relative else self.density
        cumulative = weight @ _TRAPEZOIDS
        n, n_grid = cumulative.shape
        target = cumulative[:, -1:] * levels
        before = np.maximum((cumulative[:, None] >= target[:, :, None]).argmax(axis=2) - 1, 0)
        index = before + np.arange(0, n * n_grid, n_grid)[:, None]
        low, high = cumulative.take(index), cumulative.take(index + 1)
        fraction = (target - low) / np.maximum(high - low, 1e-300)
        return np.asarray((first + (before + fraction) * (self.log_m[:, 1:2] - first)).T)


def on_grid(mixture: SizeMixture) -> LogGrid:
    """Density of the mixture on a grid around its mean."""
    mean = np.vecdot(mixture.weight, mixture.mean)
    variance = np.vecdot(mixture.weight, mixture.variance + (mixture.mean - mean[:, None]) ** 2)
    log_m = mean[:, None] + np.sqrt(variance)[:, None] * _STEPS
    peak = mixture.weight / np.sqrt(mixture.variance)
    # Single precision: the exponentials dominate the run time, and take half as long.
    terms = log_m.astype(np.float32) - mixture.mean.T.astype(np.float32)[:, :, None]
    terms *= terms
    terms *= (-0.5 / mixture.variance.T).astype(np.float32)[:, :, None]
    np.exp(terms, out=terms)
    terms *= peak.T.astype(np.float32)[:, :, None]
    density = terms.sum(axis=0).astype(np.float64)
    density /= density.max(axis=1, keepdims=True)
    return LogGrid(log_m, density, terms)


def ground_likelihood(
    log_m: FloatArray,
    log_contact_ratio: FloatArray,
    *,
    contacts: GroundContacts,
    ground: GroundFromOthers,
    prior: GroundPrior,
    roughness: float,
) -> FloatArray:
    """(N, G) likelihood of the bottom edges at the log distances `log_m` (N, G), given the `ground`
    from other objects.

    `log_contact_ratio` (N,) is the log of the ratio of the distance to the distance of the nearest
    point on the ground. Objects that are not on the ground have the likelihood 1.
    """
    inverse_depth = np.exp(log_contact_ratio[:, None] - log_m)
    residual2 = (
        (contacts.bottom - ground.horizon)[:, None] - ground.height_m[:, None] * inverse_depth
    ) ** 2
    edge_variance = contacts.edge_sigma[:, None] ** 2 + roughness * prior.rough_variance(
        inverse_depth, contacts.bearing[:, None]
    )
    variance = ground.variance[:, None] + edge_variance
    likelihood = _contact_likelihood(
        residual2, variance, prior, roughness * inverse_depth * inverse_depth
    )
    # a Student's t prior of the horizon, instead of a Gaussian estimate
    alone = ground.is_prior_only
    if alone.any():
        near, residual2 = inverse_depth[alone], residual2[alone]
        variance = edge_variance[alone] + (prior.camera_height_sigma_m * near) ** 2
        likelihood[alone] = 0.0
        for weight, scale in _T_COMPONENTS:
            total = variance + (scale * prior.horizon_sigma) ** 2
            likelihood[alone] += weight * _contact_likelihood(
                residual2, total, prior, roughness * near * near
            )
    likelihood += _NOT_ON_THE_ROAD
    likelihood[~contacts.is_on_ground] = 1.0
    return likelihood


def _contact_likelihood(
    residual2: FloatArray, variance: FloatArray, prior: GroundPrior, per_height2: FloatArray
) -> FloatArray:
    """Likelihood of squared residuals of contact points at the height of the road and at other
    heights (kerbs).

    `variance` excludes the height of the contact points, whose variance is multiplied by
    `per_height2`.
    """
    half = -0.5 * residual2
    smooth, rough = (
        variance + prior.kerb_m[0] ** 2 * per_height2,
        variance + prior.kerb_m[1] ** 2 * per_height2,
    )
    on_the_road = (1 - prior.rough_share) * np.exp(half / smooth) / np.sqrt(smooth)
    return np.asarray(on_the_road + prior.rough_share * np.exp(half / rough) / np.sqrt(rough))
