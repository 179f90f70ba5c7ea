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

from detection.detections import FloatArray, IntArray
from ranging.measured_boxes import MeasuredBoxes
from ranging.shared_ground import GroundPrior, Stand, seen_by_others
from ranging.size_prior import NODE_RANGE, ShapeTables

_NO_CHANCE = -1e9  # log weight of the turns of a kind that a box cannot be of
_UNSEEN = 1e4  # variance of the log width of a box that is cut off at a side
N_TERMS = 10  # turns kept per box: the likeliest
_N_GRID = 41
_REACH = 4.5  # of the grid, in sigma by size
_WIDE_HORIZONS = ((0.5, 0.8), (0.35, 2.0), (0.15, 5.0))  # (weight, scale): Gaussians that make up Student's t


@dataclass(frozen=True, slots=True)
class SizeMixture:
    """Log distance by size: a mixture of Gaussians per box.

    Attributes:
        mean: (N, K) of log metres.
        variance: (N, K).
        weight: (N, K), summing to 1 per box.
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
        mean = (self.weight * self.mean).sum(axis=1)
        variance = (self.weight * (self.variance + (self.mean - mean[:, None]) ** 2)).sum(axis=1)
        return mean, np.sqrt(variance)


def mixture_by_size(tables: ShapeTables, boxes: MeasuredBoxes, kinds: IntArray, shares: FloatArray) -> SizeMixture:
    """What the sizes of boxes say.

    Args:
        tables: of all classes.
        boxes: N.
        kinds: (N, M) size classes that each box may be of,
        shares: (N, M) and how likely; 0 = not at all.
    """
    box, member = np.nonzero(shares > 0)
    found = _terms(tables, boxes.select(box), kinds[box, member], shares[box, member])
    terms = np.full((*found.shape[::2], *kinds.shape), _NO_CHANCE).transpose(0, 2, 3, 1)
    terms[:, box, member] = found
    terms = terms.reshape(len(found), len(boxes), -1)
    best = np.argpartition(-terms[0], N_TERMS, axis=1)[:, :N_TERMS]
    log_weight, mean, variance, by_noise, nearer = terms[:, np.arange(len(boxes))[:, None], best]
    weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    return SizeMixture(mean, variance, weight, (weight * by_noise).sum(axis=1), (weight * nearer).sum(axis=1))


def _terms(tables: ShapeTables, boxes: MeasuredBoxes, kind: IntArray, share: FloatArray) -> FloatArray:
    """(5, N, K) of one kind's turns: log weight, mean, variance, variance by the box's noise, nearer.

    With x = log d - node, the node's values and slopes s: log size = value + s x + error, error ~ N(0, S + noise), and
    x ~ N(away, sigma^2): one Gaussian for x, by completing the square.
    """
    noise_w, noise_h = boxes.log_variance.T
    noise_w = (noise_w + np.where(boxes.uses_width, 0.0, _UNSEEN))[:, None]
    noise_h = noise_h[:, None]
    log_w, log_h = np.log(boxes.wh_over_f).T
    guess = tables.log_height[kind] - log_h
    beyond = guess - np.clip(guess, *NODE_RANGE)  # of the nodes: there, half the size is twice the distance
    log_w, log_h = log_w + beyond, log_h + beyond
    off, step, (h, w, s_h, s_w, b_h, b_w, a, b, c, nearer) = tables.at(kind, np.abs(boxes.bearing), guess - beyond)
    node_log = (guess - step)[:, None]
    e_h, e_w = log_h[:, None] - h - off[:, None] * b_h, log_w[:, None] - w - off[:, None] * b_w
    a, c = a + noise_h, c + noise_w
    determinant = a * c - b * b
    g_h, g_w = (c * s_h - b * s_w) / determinant, (a * s_w - b * s_h) / determinant
    mean_log_m, sigma = tables.log_distance[kind].T[:, :, None]
    away = mean_log_m - node_log
    precision = g_h * s_h + g_w * s_w + sigma**-2
    shift = (g_h * e_h + g_w * e_w + away * sigma**-2) / precision
    misfit = (c * e_h**2 - 2 * b * e_h * e_w + a * e_w**2) / determinant + (away / sigma) ** 2 - precision * shift**2
    prior = tables.log_turn_weight[kind] + np.log(share)[:, None] - np.log(sigma)
    by_noise = (g_h**2 * noise_h + g_w**2 * np.minimum(noise_w, 1.0)) / precision**2
    log_weight = prior - 0.5 * (misfit + np.log(determinant * precision))
    return np.stack([log_weight, node_log + shift, 1.0 / precision, by_noise, nearer])


@dataclass(frozen=True, slots=True)
class LogGrid:
    """Densities of log distance.

    Attributes:
        log_m: (N, G) evenly spaced.
        density: (N, G), largest value 1.
    """

    log_m: FloatArray
    density: FloatArray

    def times(self, likelihood: FloatArray) -> LogGrid:
        """With (N, G) likelihoods of more evidence."""
        density = self.density * likelihood
        return LogGrid(self.log_m, density / np.maximum(density.max(axis=1, keepdims=True), 1e-300))

    def quantiles(self, *levels: float, tilt: float = 0.0) -> FloatArray:
        """(levels, N) log metres of the density times d^-tilt."""
        weight = self.density * np.exp(-tilt * (self.log_m - self.log_m[:, :1])) if tilt else self.density
        cumulated = np.zeros_like(weight)
        np.cumsum((weight[:, 1:] + weight[:, :-1]) / 2, axis=1, out=cumulated[:, 1:])
        wanted = np.multiply.outer(np.array(levels), cumulated[:, -1])
        row = np.arange(len(weight))
        after = (cumulated < wanted[:, :, None]).sum(axis=2).clip(1, weight.shape[1] - 1)
        low, high = cumulated[row, after - 1], cumulated[row, after]
        share = (wanted - low) / np.maximum(high - low, 1e-300)
        step = self.log_m[:, 1] - self.log_m[:, 0]
        return np.asarray(self.log_m[:, 0] + (after - 1 + share) * step)


def on_grid(mixture: SizeMixture) -> LogGrid:
    """The mixture's density around its mean."""
    mean, sigma = mixture.moments
    log_m = mean[:, None] + sigma[:, None] * np.linspace(-_REACH, _REACH, _N_GRID)
    height = mixture.weight / np.sqrt(mixture.variance)
    away = (log_m[:, :, None] - mixture.mean[:, None, :]) ** 2
    density = (height[:, None, :] * np.exp(-0.5 * away / mixture.variance[:, None, :])).sum(axis=2)
    return LogGrid(log_m, density / density.max(axis=1, keepdims=True))


def ground_likelihood(log_m: FloatArray, nearer: FloatArray, *, stand: Stand, prior: GroundPrior) -> FloatArray:
    """(N, G) how well bottom edges go with the distances of a grid, by what the others tell of the road.

    Args:
        log_m: (N, G) the grid.
        nearer: (N,) log(distance / nearest point on the ground).
        stand: where the objects seem to stand by size; 1 for those that do not tell.
        prior: of the road.
    """
    ground = seen_by_others(stand, prior)
    nearness = np.exp(nearer[:, None] - log_m)
    residual2 = (stand.bottom[:, None] - ground.horizon[:, None] - ground.height_m[:, None] * nearness) ** 2
    edge = (stand.edge_sigma**2)[:, None]
    likelihood = _rough(residual2, ground.variance[:, None] + edge, nearness, prior)
    alone = ground.is_alone  # the prior's horizon alone, with its long tails
    if alone.any():
        height = edge[alone] + (prior.camera_height_sigma_m * nearness[alone]) ** 2
        likelihood[alone] = sum(
            weight * _rough(residual2[alone], height + (scale * prior.horizon_sigma) ** 2, nearness[alone], prior)
            for weight, scale in _WIDE_HORIZONS
        )
    return np.where(stand.tells[:, None], likelihood, 1.0)


def _rough(residual2: FloatArray, variance: FloatArray, nearness: FloatArray, prior: GroundPrior) -> FloatArray:
    """Likelihood on a road that is smooth for most and rough for some."""
    likelihood = np.zeros_like(residual2)
    for share, kerb_m in zip((1 - prior.rough_share, prior.rough_share), prior.kerb_m, strict=True):
        spread = variance + (kerb_m * nearness) ** 2
        likelihood += share * np.exp(-0.5 * residual2 / spread) / np.sqrt(spread)
    return likelihood
