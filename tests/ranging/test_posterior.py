"""The Gaussians of log distance by size, against the equations in double precision."""

from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.size_models.posterior import (
    N_TERMS,
    columns_of_largest,
    mixture_by_size,
)
from track_range.ranging.size_models.prior import ShapeTables
from track_range.ranging.size_models.size_model import BoxExtents

PRIORS = cast(CuboidSizes, load_curves()).priors
TABLES = ShapeTables({name: PRIORS[name] for name in ("person", "van")})
VANS = np.flatnonzero(np.array(TABLES.class_name) == "van")


def boxes(n: int, *, uses_width: bool = True) -> BoxExtents:
    rng = np.random.default_rng(n)
    distance_m = rng.uniform(12.0, 60.0, n)
    return BoxExtents(
        wh_over_f=np.stack([2.2 / distance_m, 2.0 / distance_m], axis=1),
        bearing=rng.uniform(-0.3, 0.3, n),
        bottom=1.6 / distance_m,
        size_class=np.zeros(n, np.int64),
        uses_width=np.full(n, uses_width),
        uses_bottom=np.ones(n, np.bool_),
        edge_sigma=np.full((n, 2), 1.5 / 720),
        systematic_sigma=np.full((n, 2), 0.02),
    )


def gaussians(of: BoxExtents, i: int, log_fraction: np.ndarray) -> np.ndarray:
    """(types x yaws, 3) log weight, mean and variance of the Gaussians of box i."""
    rows = []
    log_w, log_h = np.log(of.wh_over_f[i])
    noise = 2 * (of.edge_sigma[i] / of.wh_over_f[i]) ** 2 + of.systematic_sigma[i] ** 2
    R = np.diag([noise[1], noise[0] + (0.0 if of.uses_width[i] else 1e4)])
    for column, body in enumerate(VANS.tolist()):
        log_height, mean_log_m, p0 = TABLES.typical[:, body]
        guess = log_height - log_h
        off, step, nodes = TABLES.at(
            np.array([[body]]), np.abs(of.bearing[i : i + 1]), np.array([[guess]])
        )
        log_m = guess - step[0, 0]
        for k in range(TABLES.log_weight.shape[1]):
            s, value = (part[:, 0, 0, k].astype(float) for part in nodes.slopes_and_sizes)
            e = np.array([log_h, log_w]) - value - off[0] * nodes.per_bearing[:, 0, 0, k]
            variance, b = nodes.variance[:, 0, 0, k], float(nodes.covariance[0, 0, k])
            V = np.array([[variance[0], b], [b, variance[1]]]) + R
            g, x0 = np.linalg.solve(V, s), mean_log_m - log_m
            p = g @ s + p0
            x = (g @ e + p0 * x0) / p
            chi2 = e @ np.linalg.solve(V, e) + p0 * x0**2 - p * x**2
            log_weight = TABLES.log_weight[body, k] + log_fraction[i, column]
            log_weight -= (chi2 + np.log(p * np.linalg.det(V) / p0)) / 2
            rows.append((log_weight, log_m + x, 1 / p))
    return np.array(rows)


@pytest.mark.parametrize("uses_width", [True, False])
def test_gaussians_are_those_of_the_equations(uses_width: bool) -> None:
    of = boxes(7, uses_width=uses_width)
    body = np.broadcast_to(VANS, (7, len(VANS)))
    log_fraction = np.log(np.random.default_rng(0).dirichlet(np.ones(len(VANS)), 7))
    mixture = mixture_by_size(TABLES, of, body, log_fraction)
    for i in range(7):
        expected = gaussians(of, i, log_fraction)
        best = np.argsort(expected[:, 0])[-N_TERMS:]
        weight = np.exp(expected[best, 0] - expected[best, 0].max())
        weight /= weight.sum()
        # the least likely terms may differ
        np.testing.assert_allclose(mixture.weight[i], weight, atol=1e-4)
        mean, variance = weight @ expected[best, 1], weight @ expected[best, 2]
        assert mixture.weight[i] @ mixture.mean[i] == pytest.approx(mean, abs=1e-5)
        assert mixture.weight[i] @ mixture.variance[i] == pytest.approx(variance, rel=1e-4)


def test_noise_of_the_box_is_a_part_of_the_variance() -> None:
    of = boxes(5)
    body, none = np.broadcast_to(VANS, (5, len(VANS))), np.zeros((5, len(VANS)))
    quiet = replace(of, edge_sigma=of.edge_sigma * 1e-3)
    noisy = mixture_by_size(TABLES, of, body, none)
    assert (noisy.frame_variance > 0).all()
    total = np.vecdot(noisy.weight, noisy.variance)
    assert (noisy.frame_variance < total).all()
    assert mixture_by_size(TABLES, quiet, body, none).frame_variance == pytest.approx(0, abs=1e-8)


def test_sizes_that_depend_on_one_another() -> None:
    """Height and width of the objects, and of boxes without noise, have a correlation of almost 1."""
    van = replace(
        PRIORS["van"],
        log_sigma=(3.0, 3.0, 3.0),
        correlation=(0.9999999,) * 3,
        scatter=(1e-4, 1e-4),
        bodies=(),
    )
    of = boxes(6)
    exact = replace(of, edge_sigma=np.zeros((6, 2)), systematic_sigma=np.zeros((6, 2)))
    mixture = mixture_by_size(
        ShapeTables({"van": van}), exact, np.zeros((6, 1), np.int64), np.zeros((6, 1))
    )
    assert np.isfinite(mixture.mean).all()
    assert (mixture.variance > 0).all()
    np.testing.assert_allclose(mixture.weight.sum(axis=1), 1.0)


@pytest.mark.parametrize(("n", "n_largest"), [(1, 3), (16, 24), (160, 24), (256, 5)])
def test_columns_of_the_largest_values(n: int, n_largest: int) -> None:
    values = np.random.default_rng(n).normal(-20.0, 15.0, (50, n)).astype(np.float32)
    values[0, 0] = -1e9
    columns = columns_of_largest(values, n_largest)
    chosen = np.take_along_axis(values, columns, axis=1)
    expected = np.sort(values, axis=1)[:, -n_largest:]
    assert chosen.shape == expected.shape
    np.testing.assert_allclose(chosen, expected, rtol=1e-4)
    assert all(len(set(row)) == len(row) for row in columns.tolist())
