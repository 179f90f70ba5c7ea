"""How far a box's object is, given what is known of its class: Bayes over log distance, by size and by the ground.

    p(log d | box)  ~  p(log d)  sum_k w_k N(log h, log w; node_k(log d), S_k + noise)  p(bottom | log d)

Every turn k is linear in log d about a node of the `ShapeTables`, so by size alone log d is a mixture of Gaussians. The
bottom edge is not linear, so the mixture and its likelihood meet on a grid of log d around each box.

The distance given is the one with the smallest expected relative error: the median under p(log d) / d. Sigma is half
the width of the middle 68 %: a kind that is possible but unlikely (a van sold as a car) does not widen it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.size_models.prior import NODE_RANGE, ShapeTables
from track_range.ranging.size_models.shared_ground import GroundPrior, Stand, seen_by_others
from track_range.ranging.size_models.size_model import BoxExtents

NO_CHANCE = -1e9  # log weight of the turns of a kind that a box cannot be of
_UNSEEN = 1e4  # variance of the log width of a box that is cut off at a side
_MOST_NOISE = np.array([np.inf, 1.0], np.float32).reshape(2, 1, 1, 1)  # a width that is not seen is no noise
N_TERMS = 9  # turns kept per box: the likeliest
_N_GRID = 37
_REACH = 4.5  # of the grid, in sigma by size
_STEPS = np.linspace(-_REACH, _REACH, _N_GRID)[:, None]
_TRAPEZES = (np.tri(_N_GRID) + np.tri(_N_GRID, k=-1)) / 2  # this @ density = its integral from the first point on
_TRAPEZES[:, 0] -= 0.5
_NOT_ON_THE_ROAD = 0.003
"""Likelihood, per unit of tangent, of a bottom edge that stands on another ground: a bridge, a balcony."""

_WIDE_HORIZONS = ((0.5, 0.8), (0.35, 2.0), (0.15, 5.0))  # (weight, scale): Gaussians that make up Student's t

_Single = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class SizeMixture:
    """Log distance by size: a mixture of Gaussians per box.

    Attributes:
        mean: (K, N) of log metres.
        variance: (K, N).
        weight: (K, N), summing to 1 per box.
        frame_variance: (N,) part of the variance that is the box's own noise.
        nearer: (N,) log(distance / nearest point on the ground).
    """

    mean: FloatArray
    variance: FloatArray
    weight: FloatArray
    frame_variance: FloatArray
    nearer: FloatArray

    @property
    def moments(self) -> tuple[FloatArray, FloatArray]:
        """(N,) mean and standard deviation of log metres."""
        mean = (self.weight * self.mean).sum(axis=0)
        variance = (self.weight * (self.variance + (self.mean - mean) ** 2)).sum(axis=0)
        return mean, np.sqrt(variance)


def mixture_by_size(tables: ShapeTables, boxes: BoxExtents, kinds: IntArray, log_shares: FloatArray) -> SizeMixture:
    """What the sizes of boxes say.

    Args:
        tables: of all classes.
        boxes: N.
        kinds: (M, N) size classes that each box may be of,
        log_shares: (M, N) and how likely; `NO_CHANCE` = not at all.
    """
    terms = _terms(tables, boxes, kinds, log_shares)
    best = np.argpartition(-terms[0], N_TERMS, axis=0)[:N_TERMS]
    places = best * len(boxes) + np.arange(len(boxes))
    log_weight, mean, variance, by_noise, nearer = terms.reshape(5, -1).take(places, axis=1).astype(np.float64)
    weight = np.exp(log_weight - log_weight.max(axis=0))
    weight /= weight.sum(axis=0)
    return SizeMixture(mean, variance, weight, (weight * by_noise).sum(axis=0), (weight * nearer).sum(axis=0))


@dataclass(frozen=True, slots=True)
class _AtNodes:
    """Boxes at the nodes nearest to them, in single precision: (K, M, N) for K turns and M kinds, or broadcast to that.

    Attributes:
        nodes: (11, K, M, N), see `ShapeTables.at`.
        log_m: the nodes' log distance,
        away: what is expected of log distance before looking, from there,
        trust: and 1 / variance of that.
        error: (2, K, M, N) log height and width beyond the node's.
        noise: (2, 1, 1, N) variances of what is measured of them.
    """

    nodes: _Single
    log_m: _Single
    away: _Single
    trust: _Single
    error: _Single
    noise: _Single


def _at_nodes(tables: ShapeTables, boxes: BoxExtents, kinds: IntArray) -> _AtNodes:
    log_hw = np.log(boxes.wh_over_f.T[::-1])
    log_height, mean_log_m, trust = tables.typical.take(kinds, axis=1)
    guess = log_height - log_hw[0]
    inside = np.minimum(np.maximum(guess, NODE_RANGE[0]), NODE_RANGE[1])
    off, step, nodes = tables.at(kinds, np.abs(boxes.bearing), inside)
    seen = log_hw[:, None] + (guess - inside)  # beyond the nodes half the size is twice the distance
    noise = boxes.log_variance.T[::-1]
    noise[1] += np.where(boxes.uses_width, 0.0, _UNSEEN)
    log_m = guess - step
    return _AtNodes(
        nodes=nodes,
        log_m=_single(log_m),
        away=_single(mean_log_m - log_m),
        trust=_single(trust),
        error=_single(seen)[:, None] - nodes[:2] - _single(off) * nodes[4:6],
        noise=_single(noise)[:, None, None],
    )


def _terms(tables: ShapeTables, boxes: BoxExtents, kinds: IntArray, log_shares: FloatArray) -> _Single:
    """(5, all turns of all kinds, N): log weight, mean, variance, variance by the box's noise, nearer.

    With x = log d - node, the node's values and slopes s: log size = value + s x + error, error ~ N(0, S + noise), and
    x ~ N(away, sigma^2): one Gaussian for x, by completing the square. a, c are the diagonal of (S + noise)^-1 turned
    round, -b is what is beside it, and g = (S + noise)^-1 s.
    """
    at = _at_nodes(tables, boxes, kinds)
    away, trust, s, (b, nearer, log_weight) = at.away, at.trust, at.nodes[2:4], at.nodes[8:]
    variance = at.nodes[6:8] + at.noise
    scale = 1.0 / (variance[0] * variance[1] - b * b)
    variance *= scale
    b = b * scale
    g = variance[::-1] * s - b * s[::-1]
    gs, ge = g * s, g * at.error
    precision = gs[0] + gs[1] + trust
    shift = (ge[0] + ge[1] + away * trust) / precision
    (a, c), (e_h, e_w) = variance, at.error
    misfit = (c * e_h - 2 * b * e_w) * e_h + a * e_w * e_w + away * away * trust - precision * shift * shift
    by_noise = g * g * np.minimum(at.noise, _MOST_NOISE)
    terms = np.empty((5, *b.shape), np.float32)
    terms[0] = log_weight - 0.5 * (misfit + np.log(precision / (scale * trust)))
    terms[0] += log_shares
    terms[1] = at.log_m + shift
    terms[2] = 1.0 / precision
    terms[3] = (by_noise[0] + by_noise[1]) / (precision * precision)
    terms[4] = nearer
    return terms.reshape(5, -1, len(boxes))


def _single(values: FloatArray) -> _Single:
    return values.astype(np.float32)


@dataclass(frozen=True, slots=True)
class LogGrid:
    """Densities of log distance.

    Attributes:
        log_m: (G, N) evenly spaced.
        density: (G, N), largest value 1.
    """

    log_m: FloatArray
    density: FloatArray

    def times(self, likelihood: FloatArray) -> LogGrid:
        """With (G, N) likelihoods of more evidence."""
        density = self.density * likelihood
        return LogGrid(self.log_m, density / np.maximum(density.max(axis=0), 1e-300))

    def quantiles(self, levels: FloatArray, *, is_relative: BoolArray | None = None) -> FloatArray:
        """(L, N) log metres at (L, 1) levels of the density; where `is_relative` (L, 1), of the density over d."""
        weight = self.density[None]
        if is_relative is not None:
            weight = weight * np.where(is_relative[:, None], np.exp(self.log_m[0] - self.log_m), 1.0)
        cumulated = _TRAPEZES @ weight  # one for all levels, or one each
        n_each, n = cumulated[0].size, cumulated.shape[2]
        wanted = levels * cumulated[:, -1]
        before = np.maximum((cumulated >= wanted[:, None]).argmax(axis=1) - 1, 0)
        places = before * n + np.arange(n) + n_each * np.arange(len(cumulated))[:, None]
        low, high = cumulated.take(places), cumulated.take(places + n)
        share = (wanted - low) / np.maximum(high - low, 1e-300)
        return np.asarray(self.log_m[0] + (before + share) * (self.log_m[1] - self.log_m[0]))


def on_grid(mixture: SizeMixture) -> LogGrid:
    """The mixture's density around its mean."""
    mean, sigma = mixture.moments
    log_m = mean + sigma * _STEPS
    height = mixture.weight / np.sqrt(mixture.variance)
    # in single precision, which takes half the time: exponentials are what costs
    terms = _single(log_m) - _single(mixture.mean)[:, None]
    terms *= terms
    terms *= _single(-0.5 / mixture.variance)[:, None]
    np.exp(terms, out=terms)
    terms *= _single(height)[:, None]
    density = terms.sum(axis=0).astype(np.float64)
    return LogGrid(log_m, density / density.max(axis=0))


def ground_likelihood(log_m: FloatArray, nearer: FloatArray, *, stand: Stand, prior: GroundPrior) -> FloatArray:
    """(G, N) how well bottom edges go with the distances of a grid, by what the others tell of the road.

    Args:
        log_m: (G, N) the grid.
        nearer: (N,) log(distance / nearest point on the ground).
        stand: where the objects seem to stand by size; 1 for those that do not tell.
        prior: of the road.
    """
    ground = seen_by_others(stand, prior)
    nearness = np.exp(nearer - log_m)
    residual2 = (stand.bottom - ground.horizon - ground.height_m * nearness) ** 2
    edge = stand.edge_sigma**2
    likelihood = _rough(residual2, ground.variance + edge, nearness, prior)
    alone = ground.is_alone  # the prior's horizon alone, with its long tails
    if alone.any():
        height = edge[alone] + (prior.camera_height_sigma_m * nearness[:, alone]) ** 2
        likelihood[:, alone] = sum(
            weight * _rough(residual2[:, alone], height + (scale * prior.horizon_sigma) ** 2, nearness[:, alone], prior)
            for weight, scale in _WIDE_HORIZONS
        )
    return np.where(stand.tells, likelihood + _NOT_ON_THE_ROAD, 1.0)


def _rough(residual2: FloatArray, variance: FloatArray, nearness: FloatArray, prior: GroundPrior) -> FloatArray:
    """Likelihood on a road that is smooth for most and rough for some."""
    half, squared = -0.5 * residual2, nearness * nearness
    smooth, rough = (
        share * np.exp(half / spread) / np.sqrt(spread)
        for share, spread in (
            (1 - prior.rough_share, variance + prior.kerb_m[0] ** 2 * squared),
            (prior.rough_share, variance + prior.kerb_m[1] ** 2 * squared),
        )
    )
    return np.asarray(smooth + rough)
