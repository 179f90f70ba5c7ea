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

from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.ranging.size_models.prior import NODE_RANGE, Floats32, ShapeTables
from track_range.ranging.size_models.shared_ground import (
    GroundContacts,
    GroundFromOthers,
    GroundPrior,
)
from track_range.ranging.size_models.size_model import BoxExtents

IMPOSSIBLE = -1e9  # log probability of a body type that a box cannot have
# variance of the log width of a box truncated at a side: the width carries no information
_UNSEEN_VARIANCE = 1e4

# smallest |V| as a fraction of v_h v_w: in single precision, that of a box whose height and width
# depend on a single size may be 0 or less
_MIN_DET = 1e-6
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


class SizeMixture(NamedTuple):
    """Log distance by size: a mixture of T Gaussians for each of N boxes."""

    mean: FloatArray  # (N, T) means of log d, d in metres
    variance: FloatArray  # (N, T) variances of log d
    weight: FloatArray  # (N, T) weights, which sum to 1 per box
    # (N,) part of the variance of log d that comes from the noise of the box
    frame_variance: FloatArray
    log_contact_ratio: FloatArray  # (N,) log of the distance divided by the nearest ground point's
    body: IntArray  # (N, T) index of each Gaussian's body type among the M possible ones
    # (N,) smallest squared deviation from a body type, plus 2 log (best weight / its weight)
    chi2: FloatArray


class _Terms(NamedTuple):
    """The Gaussians of x = log d - log_m for N boxes, M body types and K yaw bins; arrays of all of
    them are in single precision.

    With slopes s of the log size at the node, V = S + R and the prior x ~ N(x0, 1 / p0), the log
    size relative to the node is e = s x + N(0, V). Completing the square gives one Gaussian for x:

        precision   p = g's + p0,                   g = V^-1 s
        mean        x = (g'e + p0 x0) / p
        weight      log w - (e'V^-1 e - p x^2 + p0 x0^2 + log(p |V| / p0)) / 2
    """

    log_m: FloatArray  # (N, M)
    log_prior: Floats32  # (N, M, K) log w
    log_weight: Floats32  # (N, M, K)
    x: Floats32  # (N, M, K)
    det: Floats32  # (N, M, K) |V|
    p_det: Floats32  # (N, M, K) p |V|
    g_det: Floats32  # (2, N, M, K) g |V| of log height and log width
    chi2: Floats32  # (N, M, K) e'V^-1 e - p x^2
    prior_chi2: FloatArray  # (N, M) p0 x0^2
    log_contact_ratio: Floats32  # (N, M, K)


def mixture_by_size(
    tables: ShapeTables, boxes: BoxExtents, body: IntArray, log_fraction: FloatArray
) -> SizeMixture:
    """Log distance of N boxes from their size, without the bottom edge.

    `body` (N, M) are the possible body types of each box, `log_fraction` (N, M) their log
    probabilities; `IMPOSSIBLE` = excluded.
    """
    terms = _all_terms(tables, boxes, body, log_fraction)
    n, m, n_yaws = terms.log_weight.shape
    n_all = m * n_yaws
    best = columns_of_largest(terms.log_weight.reshape(n, n_all), N_TERMS)
    # (N, T) places of the most likely Gaussians in arrays (N, M, K), and in arrays (N, M)
    term = best + np.arange(0, n * n_all, n_all)[:, None]
    pair = term // n_yaws

    def of_best(values: Floats32) -> FloatArray:
        return values.take(term).astype(np.float64)

    weight = of_best(terms.log_weight)
    weight -= np.maximum.reduce(weight, axis=1, keepdims=True)
    np.exp(weight, out=weight)
    weight /= np.add.reduce(weight, axis=1, keepdims=True)
    p_det, (g_h, g_w) = of_best(terms.p_det), terms.g_det
    noise_h, noise_w = boxes.noise_variance.T[::-1, :, None]
    by_noise = of_best(g_h) ** 2 * noise_h + of_best(g_w) ** 2 * noise_w
    log_best = np.maximum.reduce(terms.log_prior.reshape(n, n_all), axis=1)[:, None]
    chi2 = of_best(terms.chi2) + terms.prior_chi2.take(pair)
    chi2 += 2.0 * (log_best - of_best(terms.log_prior))
    return SizeMixture(
        mean=of_best(terms.x) + terms.log_m.take(pair),
        variance=of_best(terms.det) / p_det,
        weight=weight,
        frame_variance=np.vecdot(weight, by_noise / (p_det * p_det)),
        log_contact_ratio=np.vecdot(weight, of_best(terms.log_contact_ratio)),
        body=best // n_yaws,
        chi2=np.minimum.reduce(chi2, axis=1),
    )


def columns_of_largest(values: Floats32, n_largest: int) -> IntArray:
    """(N, L) columns of the largest values (N, K) of each row, in ascending order; values that agree
    in 23 bits less those of the number of a column count as equal.

    The last bits of the values are replaced by the number of their column: NumPy sorts values four
    times as fast as it finds the order of values.
    """
    n_columns = values.shape[1]
    mask = (1 << (n_columns - 1).bit_length()) - 1
    numbered = (values.view(np.int32) & ~mask) | np.arange(n_columns, dtype=np.int32)
    largest = np.sort(numbered.view(np.float32), axis=1)[:, max(n_columns - n_largest, 0) :]
    return np.asarray(largest.view(np.int32) & mask, np.int64)


def log_evidence(
    tables: ShapeTables, boxes: BoxExtents, body: IntArray, log_fraction: FloatArray
) -> FloatArray:
    """(N,) log likelihood of log height and log width of N boxes, up to a constant per box;
    arguments as above.
    """
    terms = _all_terms(tables, boxes, body, log_fraction)
    log_weight = terms.log_weight.reshape(len(boxes), -1).astype(np.float64)
    largest = log_weight.max(axis=1)
    return np.asarray(largest + np.log(np.exp(log_weight - largest[:, None]).sum(axis=1)))


def _all_terms(
    tables: ShapeTables, boxes: BoxExtents, body: IntArray, log_fraction: FloatArray
) -> _Terms:
    """The Gaussians of N boxes; arguments as of `mixture_by_size`.

    For V = [v_h b; b v_w], |V| V^-1 = [v_w -b; -b v_h]: multiples of |V| save divisions.
    """
    log_hw = np.log(boxes.wh_over_f.T[::-1])
    log_height, mean_log_m, p0 = tables.typical.take(body, axis=1)
    guess = log_height - log_hw[0][:, None]
    inside = np.minimum(np.maximum(guess, NODE_RANGE[0]), NODE_RANGE[1])
    bearing_step, log_step, nodes = tables.at(body, np.abs(boxes.bearing), inside)
    # outside the nodes, size is inversely proportional to distance
    scaled = log_hw[:, :, None] + (guess - inside)
    errors = boxes.noise_variance.T[::-1] + boxes.systematic_sigma.T[::-1] ** 2
    errors[1] += np.where(boxes.uses_width, 0.0, _UNSEEN_VARIANCE)
    log_m = guess - log_step
    x0 = mean_log_m - log_m
    prior_chi2 = p0 * x0 * x0

    # s and e share an array (2, 2, N, M, K): both are multiplied by V^-1
    s_e, b = nodes.slopes_and_sizes, nodes.covariance
    e = s_e[1]
    np.subtract(_single(scaled), e, out=e)
    e -= _single(bearing_step[:, None]) * nodes.per_bearing
    V = nodes.variance
    V += _single(errors[:, :, None])
    product = V[0] * V[1]
    det = np.maximum(product - b * b, _MIN_DET * product)
    times_V = s_e * V[::-1] - s_e[:, ::-1] * b  # |V| V^-1 (s, e)
    g_det = times_V[0]
    g_s, g_e = s_e * g_det
    e_e = e * times_V[1]
    p_det = np.maximum(g_s[0] + g_s[1], 0.0) + _single(p0) * det
    p_x_det = g_e[0] + g_e[1] + _single(p0 * x0) * det
    x = p_x_det / p_det
    chi2 = (e_e[0] + e_e[1] - p_x_det * x) / det
    log_prior = tables.log_weight.take(body, axis=0) + _single(log_fraction)
    log_weight = np.log(p_det)
    log_weight += chi2
    log_weight *= -0.5
    log_weight += log_prior
    log_weight += _single(0.5 * (np.log(p0) - prior_chi2))
    return _Terms(
        log_m=log_m,
        log_prior=log_prior,
        log_weight=log_weight,
        x=x,
        det=det,
        p_det=p_det,
        g_det=g_det,
        chi2=chi2,
        prior_chi2=prior_chi2,
        log_contact_ratio=nodes.log_contact_ratio,
    )


def _single(values: FloatArray) -> Floats32:
    """(..., 1) values in single precision, the same for all yaw bins."""
    return values.astype(np.float32)[..., None]


class LogGrid(NamedTuple):
    """Densities of the log distance of N boxes on grids of G points."""

    log_m: FloatArray  # (N, G) grid points, evenly spaced per box
    density: FloatArray  # (N, G) density
    by_term: Floats32  # (T, N, G) densities of the Gaussians by size, without further evidence

    def times(self, likelihood: FloatArray) -> LogGrid:
        """The product with the likelihood (N, G) of further evidence."""
        return self._replace(density=self.density * likelihood)

    def quantiles(self, levels: FloatArray) -> FloatArray:
        """(L, N) log distance at the quantiles `levels` (L,), 0..1, of the density."""
        place = _quantile_places(self.density, levels)
        return np.asarray((self.log_m[:, :1] + place * self._step).T)

    def quantiles_and_relative(self, levels: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(L, N) quantiles of the density, and of density / d."""
        first = self.log_m[:, :1]
        both = np.empty((2, *self.density.shape))
        both[0] = self.density
        np.multiply(self.density, np.exp(first - self.log_m), out=both[1])
        place = _quantile_places(both.reshape(-1, both.shape[2]), levels)
        log_m = first + place.reshape(2, -1, len(levels)) * self._step
        return log_m[0].T, log_m[1].T

    @property
    def _step(self) -> FloatArray:
        """(N, 1) distance of two grid points."""
        return self.log_m[:, 1:2] - self.log_m[:, :1]


def _quantile_places(density: FloatArray, levels: FloatArray) -> FloatArray:
    """(N, L) places of quantiles of densities (N, G), in grid points from the first one."""
    cumulative = density @ _TRAPEZOIDS
    n, n_grid = cumulative.shape
    target = cumulative[:, -1:] * levels
    before = (cumulative[:, None] >= target[:, :, None]).argmax(axis=2) - 1
    np.maximum(before, 0, out=before)
    index = before + np.arange(0, n * n_grid, n_grid)[:, None]
    low, high = cumulative.take(index), cumulative.take(index + 1)
    return np.asarray(before + (target - low) / np.maximum(high - low, 1e-300))


def on_grid(mixture: SizeMixture) -> LogGrid:
    """Density of the mixture on a grid around its mean."""
    mean = np.vecdot(mixture.weight, mixture.mean)
    variance = np.vecdot(mixture.weight, mixture.variance + (mixture.mean - mean[:, None]) ** 2)
    log_m = mean[:, None] + np.sqrt(variance)[:, None] * _STEPS
    # (3, T, N, 1) single precision: the exponentials dominate the run time, and take half as long;
    # contiguous, so that the terms are, too, and their sum takes a quarter of the time
    by_term = np.empty((3, *mixture.mean.T.shape, 1), np.float32)
    by_term[0, :, :, 0] = mixture.mean.T
    by_term[1, :, :, 0] = (-0.5 / mixture.variance).T
    by_term[2, :, :, 0] = (mixture.weight / np.sqrt(mixture.variance)).T
    terms = log_m.astype(np.float32) - by_term[0]
    terms *= terms
    terms *= by_term[1]
    np.exp(terms, out=terms)
    terms *= by_term[2]
    density = np.add.reduce(terms, axis=0).astype(np.float64)
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
