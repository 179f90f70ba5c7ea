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

from detection.detections import FloatArray, IntArray
from ranging.measured_boxes import MeasuredBoxes
from ranging.shared_ground import GroundPrior, Stand, seen_by_others
from ranging.size_prior import NODE_RANGE, ShapeTables

NO_CHANCE = -1e9  # log weight of the turns of a kind that a box cannot be of
_UNSEEN = 1e4  # variance of the log width of a box that is cut off at a side
N_TERMS = 9  # turns kept per box: the likeliest
_N_GRID = 37
_REACH = 4.5  # of the grid, in sigma by size
_STEPS = np.linspace(-_REACH, _REACH, _N_GRID)[:, None]
_TRAPEZES = (np.tri(_N_GRID) + np.tri(_N_GRID, k=-1)) / 2  # this @ density = its integral from the first point on
_TRAPEZES[:, 0] -= 0.5
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


def mixture_by_size(tables: ShapeTables, boxes: MeasuredBoxes, kinds: IntArray, log_shares: FloatArray) -> SizeMixture:
    """What the sizes of boxes say.

    Args:
        tables: of all classes.
        boxes: N.
        kinds: (M, N) size classes that each box may be of,
        log_shares: (M, N) and how likely; `NO_CHANCE` = not at all.
    """
    terms = _terms(tables, boxes, kinds, log_shares)
    best = np.argpartition(-terms[0], N_TERMS, axis=0)[:N_TERMS]
    log_weight, mean, variance, by_noise, nearer = terms[:, best, np.arange(len(boxes))].astype(np.float64)
    weight = np.exp(log_weight - log_weight.max(axis=0))
    weight /= weight.sum(axis=0)
    return SizeMixture(mean, variance, weight, (weight * by_noise).sum(axis=0), (weight * nearer).sum(axis=0))


def _terms(tables: ShapeTables, boxes: MeasuredBoxes, kinds: IntArray, log_shares: FloatArray) -> _Single:
    """(5, all turns of all kinds, N): log weight, mean, variance, variance by the box's noise, nearer.

    With x = log d - node, the node's values and slopes s: log size = value + s x + error, error ~ N(0, S + noise), and
    x ~ N(away, sigma^2): one Gaussian for x, by completing the square. In single precision, which takes half the time.
    """
    n_kinds, n = kinds.shape
    kind = kinds.reshape(-1)
    noise_w = boxes.log_variance[:, 0] + np.where(boxes.uses_width, 0.0, _UNSEEN)
    measured = np.stack([*np.log(boxes.wh_over_f).T, noise_w, boxes.log_variance[:, 1], np.abs(boxes.bearing)])
    log_w, log_h, noise_w, noise_h, bearing = np.concatenate([measured] * n_kinds, axis=1)
    guess = tables.log_height[kind] - log_h
    beyond = guess - guess.clip(*NODE_RANGE)  # of the nodes: there, half the size is twice the distance
    off, step, nodes = tables.at(kind, bearing, guess - beyond)
    mean_log_m, trust = tables.log_distance[:, kind]
    node_log = guess - step
    columns = [log_h + beyond, log_w + beyond, noise_h, noise_w, off, node_log, mean_log_m - node_log, trust]
    log_h, log_w, noise_h, noise_w, off, node_log, away, trust = np.stack(columns).astype(np.float32)
    h, w, s_h, s_w, b_h, b_w, a, c, b, nearer, log_weight = nodes
    e_h, e_w = log_h - h - off * b_h, log_w - w - off * b_w
    a, c = a + noise_h, c + noise_w
    scale = 1.0 / (a * c - b * b)
    a, b, c = a * scale, b * scale, c * scale
    g_h, g_w = c * s_h - b * s_w, a * s_w - b * s_h
    precision = g_h * s_h + g_w * s_w + trust
    shift = (g_h * e_h + g_w * e_w + away * trust) / precision
    misfit = (c * e_h - 2 * b * e_w) * e_h + a * e_w * e_w + away * away * trust - precision * shift * shift
    terms = np.empty((5, *nodes.shape[1:]), np.float32)
    terms[0] = log_weight - 0.5 * (misfit + np.log(precision / (scale * trust)))
    terms[0] += log_shares.reshape(-1)
    terms[1] = node_log + shift
    terms[2] = 1.0 / precision
    terms[3] = (g_h * g_h * noise_h + g_w * g_w * np.minimum(noise_w, 1.0)) / (precision * precision)
    terms[4] = nearer
    return terms.reshape(5, -1, n)


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

    def quantiles(self, *levels: float, tilt: float = 0.0) -> FloatArray:
        """(levels, N) log metres of the density times d^-tilt."""
        weight = self.density * np.exp(-tilt * (self.log_m - self.log_m[0])) if tilt else self.density
        cumulated = _TRAPEZES @ weight
        wanted = np.multiply.outer(np.array(levels), cumulated[-1])
        box = np.arange(weight.shape[1])
        after = (cumulated >= wanted[:, None]).argmax(axis=1).clip(1)
        low, high = cumulated[after - 1, box], cumulated[after, box]
        share = (wanted - low) / np.maximum(high - low, 1e-300)
        return np.asarray(self.log_m[0] + (after - 1 + share) * (self.log_m[1] - self.log_m[0]))


def on_grid(mixture: SizeMixture) -> LogGrid:
    """The mixture's density around its mean."""
    mean, sigma = mixture.moments
    log_m = mean + sigma * _STEPS
    height = mixture.weight / np.sqrt(mixture.variance)
    columns = np.stack([height, mixture.mean, -0.5 / mixture.variance])
    height, middle, precision = columns.astype(np.float32)[:, :, None]  # half the time: exponentials are what costs
    away = log_m.astype(np.float32) - middle
    density = (height * np.exp(away * away * precision)).sum(axis=0).astype(np.float64)
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
    return np.where(stand.tells, likelihood, 1.0)


def _rough(residual2: FloatArray, variance: FloatArray, nearness: FloatArray, prior: GroundPrior) -> FloatArray:
    """Likelihood on a road that is smooth for most and rough for some."""
    smooth, rough = (
        share * np.exp(-0.5 * residual2 / spread) / np.sqrt(spread)
        for share, spread in (
            (1 - prior.rough_share, variance + (prior.kerb_m[0] * nearness) ** 2),
            (prior.rough_share, variance + (prior.kerb_m[1] * nearness) ** 2),
        )
    )
    return np.asarray(smooth + rough)
