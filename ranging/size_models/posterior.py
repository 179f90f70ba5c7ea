"""Posterior of the log distance of a box from its size and its bottom edge, given the size priors of its class.

    p(log d | box)  ~  p(log d)  sum_k w_k N(log h, log w; m_k(log d), S_k + R)  p(bottom | log d)

The sum is over yaw bins and size classes k with prior weight w_k; m_k and S_k are mean and covariance of the log box
size, R the noise of the box. m_k is linear in log d about a node of the `ShapeTables`, so that without the bottom edge
log d is a mixture of Gaussians. The likelihood of the bottom edge is not linear, so the product of both is evaluated on
a grid of log d.

The reported distance has the smallest expected relative error: it is the median under p(log d) / d. Sigma is half the
width of the central 68 %, which a possible but unlikely class (a van detected as a car) does not widen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.size_models.prior import NODE_RANGE, ShapeTables
from track_range.ranging.size_models.shared_ground import GroundContacts, GroundPrior, ground_from_others
from track_range.ranging.size_models.size_model import BoxExtents

IMPOSSIBLE = -1e9
"""Log probability of a size class that a box cannot have."""

_UNSEEN_VARIANCE = 1e4
"""Variance of the log width of a box truncated at a side: the width carries no information."""

_MAX_NOISE = np.array([np.inf, 1.0], np.float32).reshape(2, 1, 1, 1)
"""Largest variance of log height and log width that counts as noise of the box, without `_UNSEEN_VARIANCE`."""

N_TERMS = 9
"""Number of Gaussians per box: the most likely yaw bins and classes."""

_N_GRID = 37
"""Number of points of the grid of log distance."""

_GRID_SIGMAS = 4.5
"""Half width of the grid in standard deviations of the distance by size."""

_STEPS = np.linspace(-_GRID_SIGMAS, _GRID_SIGMAS, _N_GRID)[:, None]
"""(G, 1) grid points in standard deviations."""

_TRAPEZOIDS = (np.tri(_N_GRID) + np.tri(_N_GRID, k=-1)) / 2
_TRAPEZOIDS[:, 0] -= 0.5
"""(G, G) trapezoidal rule: `_TRAPEZOIDS @ density` is the integral from the first grid point to each one."""

_NOT_ON_THE_ROAD = 0.003
"""Likelihood, per unit of tangent, of a bottom edge that is not on the road but on a bridge or balcony."""

_T_COMPONENTS = ((0.5, 0.8), (0.35, 2.0), (0.15, 5.0))
"""(weight, scale) of Gaussians that approximate Student's t with 2 degrees of freedom."""

_Float32 = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class SizeMixture:
    """Log distance by size: a mixture of K Gaussians for each of N boxes.

    Attributes:
        mean: (K, N) means of log d, d in metres.
        variance: (K, N) variances of log d.
        weight: (K, N) weights, which sum to 1 per box.
        frame_variance: (N,) part of the variance of log d that comes from the noise of the box.
        log_contact_ratio: (N,) log of the distance divided by that of the nearest point on the ground.
    """

    mean: FloatArray
    variance: FloatArray
    weight: FloatArray
    frame_variance: FloatArray
    log_contact_ratio: FloatArray

    @property
    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of log d, (N,) each."""
        mean = (self.weight * self.mean).sum(axis=0)
        variance = (self.weight * (self.variance + (self.mean - mean) ** 2)).sum(axis=0)
        return mean, np.sqrt(variance)


def mixture_by_size(tables: ShapeTables, boxes: BoxExtents, size_class: IntArray, log_share: FloatArray) -> SizeMixture:
    """Log distance of N boxes from their size, without the bottom edge.

    Args:
        tables: shape tables of all classes.
        boxes: N boxes.
        size_class: (M, N) possible size classes of each box.
        log_share: (M, N) log probability of each size class; `IMPOSSIBLE` = excluded.
    """
    terms = _terms(tables, boxes, size_class, log_share)
    best = np.argpartition(-terms[0], N_TERMS, axis=0)[:N_TERMS]
    index = best * len(boxes) + np.arange(len(boxes))
    log_weight, mean, variance, noise_variance, log_contact_ratio = (
        terms.reshape(5, -1).take(index, axis=1).astype(np.float64)
    )
    weight = np.exp(log_weight - log_weight.max(axis=0))
    weight /= weight.sum(axis=0)
    return SizeMixture(
        mean, variance, weight, (weight * noise_variance).sum(axis=0), (weight * log_contact_ratio).sum(axis=0)
    )


def log_evidence(tables: ShapeTables, boxes: BoxExtents, size_class: IntArray, log_share: FloatArray) -> FloatArray:
    """(N,) log likelihood of log height and log width of N boxes, up to a constant per box; arguments as above."""
    log_weight = _terms(tables, boxes, size_class, log_share)[0].astype(np.float64)
    largest = log_weight.max(axis=0)
    return np.asarray(largest + np.log(np.exp(log_weight - largest).sum(axis=0)))


@dataclass(frozen=True, slots=True)
class _AtNodes:
    """N boxes relative to their nearest nodes, in single precision.

    Arrays are (K, M, N), for K yaw bins and M classes, or broadcastable to that.

    Attributes:
        nodes: (11, K, M, N) node values (`ShapeTables.at`).
        log_m: log distance of the node.
        x0: prior mean of x = log d - log_m.
        p0: prior precision (1 / variance) of x.
        e: (2, K, M, N) log height and log width minus those of the node.
        R: (2, 1, 1, N) noise variances of log height and log width.
    """

    nodes: _Float32
    log_m: _Float32
    x0: _Float32
    p0: _Float32
    e: _Float32
    R: _Float32


def _at_nodes(tables: ShapeTables, boxes: BoxExtents, size_class: IntArray) -> _AtNodes:
    log_hw = np.log(boxes.wh_over_f.T[::-1])
    log_height, mean_log_m, p0 = tables.typical.take(size_class, axis=1)
    guess = log_height - log_hw[0]
    inside = np.minimum(np.maximum(guess, NODE_RANGE[0]), NODE_RANGE[1])
    bearing_step, log_step, nodes = tables.at(size_class, np.abs(boxes.bearing), inside)
    scaled = log_hw[:, None] + (guess - inside)  # outside the nodes, size is inversely proportional to distance
    R = boxes.log_variance.T[::-1]
    R[1] += np.where(boxes.uses_width, 0.0, _UNSEEN_VARIANCE)
    log_m = guess - log_step
    return _AtNodes(
        nodes=nodes,
        log_m=_float32(log_m),
        x0=_float32(mean_log_m - log_m),
        p0=_float32(p0),
        e=_float32(scaled)[:, None] - nodes[:2] - _float32(bearing_step) * nodes[4:6],
        R=_float32(R)[:, None, None],
    )


def _terms(tables: ShapeTables, boxes: BoxExtents, size_class: IntArray, log_share: FloatArray) -> _Float32:
    """(5, K M, N) log weight, mean, variance, variance due to box noise, and log contact ratio of all K M Gaussians.

    With x = log d - log_m, slopes s of the log size at the node, V = S + R and prior x ~ N(x0, 1 / p0), the log size
    relative to the node is e = s x + N(0, V). Completing the square gives one Gaussian for x:

        precision   p = g's + p0,                   g = V^-1 s
        mean        x = (g'e + p0 x0) / p
        weight      log w - (e'V^-1 e + p0 x0^2 - p x^2 + log(p |V| / p0)) / 2

    For V = [v_h b; b v_w], in the code (a, c) = (v_h, v_w) / |V| and b / |V| are the entries of V^-1 = [c -b; -b a].
    """
    at = _at_nodes(tables, boxes, size_class)
    x0, p0, s, (b, log_contact_ratio, log_weight) = at.x0, at.p0, at.nodes[2:4], at.nodes[8:]
    V = at.nodes[6:8] + at.R
    scale = 1.0 / (V[0] * V[1] - b * b)  # 1 / |V|
    V *= scale
    b = b * scale
    g = V[::-1] * s - b * s[::-1]
    gs, ge = g * s, g * at.e
    p = gs[0] + gs[1] + p0
    x = (ge[0] + ge[1] + x0 * p0) / p
    (a, c), (e_h, e_w) = V, at.e
    chi2 = (c * e_h - 2 * b * e_w) * e_h + a * e_w * e_w + x0 * x0 * p0 - p * x * x
    noise_variance = g * g * np.minimum(at.R, _MAX_NOISE)
    terms = np.empty((5, *b.shape), np.float32)
    terms[0] = log_weight - 0.5 * (chi2 + np.log(p / (scale * p0)))
    terms[0] += log_share
    terms[1] = at.log_m + x
    terms[2] = 1.0 / p
    terms[3] = (noise_variance[0] + noise_variance[1]) / (p * p)
    terms[4] = log_contact_ratio
    return terms.reshape(5, -1, len(boxes))


def _float32(values: FloatArray) -> _Float32:
    return values.astype(np.float32)


@dataclass(frozen=True, slots=True)
class LogGrid:
    """Densities of the log distance of N boxes on grids of G points.

    Attributes:
        log_m: (G, N) grid points, evenly spaced per box.
        density: (G, N) density, scaled to the maximum 1 per box.
    """

    log_m: FloatArray
    density: FloatArray

    def times(self, likelihood: FloatArray) -> LogGrid:
        """The product with the likelihood (G, N) of further evidence."""
        density = self.density * likelihood
        return LogGrid(self.log_m, density / np.maximum(density.max(axis=0), 1e-300))

    def quantiles(self, levels: FloatArray, *, is_relative: BoolArray | None = None) -> FloatArray:
        """(L, N) log distance at the quantiles `levels` (L, 1) of the density, or of density / d if `is_relative`.

        Args:
            levels: (L, 1) quantile levels, 0..1.
            is_relative: (L, 1) whether the quantile is that of density / d; None = all are of the density.
        """
        weight = self.density[None]
        if is_relative is not None:
            weight = weight * np.where(is_relative[:, None], np.exp(self.log_m[0] - self.log_m), 1.0)
        cumulative = _TRAPEZOIDS @ weight  # (1, G, N) or (L, G, N)
        n_per_level, n = cumulative[0].size, cumulative.shape[2]
        target = levels * cumulative[:, -1]
        before = np.maximum((cumulative >= target[:, None]).argmax(axis=1) - 1, 0)
        index = before * n + np.arange(n) + n_per_level * np.arange(len(cumulative))[:, None]
        low, high = cumulative.take(index), cumulative.take(index + n)
        share = (target - low) / np.maximum(high - low, 1e-300)
        return np.asarray(self.log_m[0] + (before + share) * (self.log_m[1] - self.log_m[0]))


def on_grid(mixture: SizeMixture) -> LogGrid:
    """Density of the mixture on a grid around its mean."""
    mean, sigma = mixture.moments
    log_m = mean + sigma * _STEPS
    peak = mixture.weight / np.sqrt(mixture.variance)
    # Single precision: the exponentials dominate the run time, and take half as long.
    terms = _float32(log_m) - _float32(mixture.mean)[:, None]
    terms *= terms
    terms *= _float32(-0.5 / mixture.variance)[:, None]
    np.exp(terms, out=terms)
    terms *= _float32(peak)[:, None]
    density = terms.sum(axis=0).astype(np.float64)
    return LogGrid(log_m, density / density.max(axis=0))


def ground_likelihood(
    log_m: FloatArray, log_contact_ratio: FloatArray, *, contacts: GroundContacts, prior: GroundPrior
) -> FloatArray:
    """(G, N) likelihood of the bottom edges at the distances of a grid, with the ground plane from the other objects.

    Args:
        log_m: (G, N) log distances of the grid.
        log_contact_ratio: (N,) log of the distance divided by that of the nearest point on the ground.
        contacts: contact points of the N objects; the likelihood of those not on the ground is 1.
        prior: prior of the ground plane.
    """
    ground = ground_from_others(contacts, prior)
    nearness = np.exp(log_contact_ratio - log_m)
    residual2 = (contacts.bottom - ground.horizon - ground.height_m * nearness) ** 2
    edge_variance = contacts.edge_sigma**2
    likelihood = _kerb_mixture(residual2, ground.variance + edge_variance, nearness, prior)
    prior_only = ground.is_prior_only  # a Student's t prior of the horizon, instead of a Gaussian estimate
    if prior_only.any():
        variance = edge_variance[prior_only] + (prior.camera_height_sigma_m * nearness[:, prior_only]) ** 2
        likelihood[:, prior_only] = sum(
            weight
            * _kerb_mixture(
                residual2[:, prior_only], variance + (scale * prior.horizon_sigma) ** 2, nearness[:, prior_only], prior
            )
            for weight, scale in _T_COMPONENTS
        )
    return np.where(contacts.is_on_ground, likelihood + _NOT_ON_THE_ROAD, 1.0)


def _kerb_mixture(residual2: FloatArray, variance: FloatArray, nearness: FloatArray, prior: GroundPrior) -> FloatArray:
    """Likelihood of squared residuals for a mixture of contact points at the height of the road and off it (kerbs)."""
    half, squared = -0.5 * residual2, nearness * nearness
    smooth, rough = (
        share * np.exp(half / total) / np.sqrt(total)
        for share, total in (
            (1 - prior.rough_share, variance + prior.kerb_m[0] ** 2 * squared),
            (prior.rough_share, variance + prior.kerb_m[1] ** 2 * squared),
        )
    )
    return np.asarray(smooth + rough)
