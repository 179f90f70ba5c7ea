"""The errors of a depth network in a drive: its factor, how it changes with the distance, and the
distances that follow."""

import math

import numpy as np
import pytest

from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.size_models.network_cells import CellAverages
from track_range.ranging.size_models.network_scale import (
    NetworkErrors,
    NetworkScale,
    network_scale,
)
from track_range.ranging.size_models.size_model import SIZE_CLASSES

CAR, PERSON = SIZE_CLASSES.index("car"), SIZE_CLASSES.index("person")


def drive(network, *, n=24, seed=0, size_sigma=0.1, track_sigma=0.05, noise=0.03, errors=None):
    """The scale by `n` cars at 6 to 70 m, of which the network gives network(distance)."""
    rng = np.random.default_rng(seed)
    ids, cars = np.arange(n), np.full(n, CAR)
    true_m = np.exp(rng.uniform(math.log(6), math.log(70), n))
    of_size, of_track = np.exp(rng.normal(0, size_sigma, n)), rng.normal(0, track_sigma, n)
    averages = CellAverages()
    for _ in range(8):
        seen_m = network(true_m) * np.exp(of_track + rng.normal(0, noise, n))
        log_m = np.log(true_m * of_size)
        variance = np.full(n, size_sigma**2)
        averages.add(np.array([log_m, np.log(seen_m) - log_m, variance, 0 * log_m]), ids, cars)
    return network_scale(averages.cells, errors or NetworkErrors(), by_size=True)


def at(scale, network_m, class_id=CAR):
    """Corrected distance of one object, and its relative sigma."""
    value_m = np.array([float(network_m)])
    raw = Ranges(np.array([1]), value_m, 0.02 * value_m)
    ranges = scale.corrected(raw, np.array([class_id]))
    assert (ranges.sigma_systematic_m <= ranges.sigma_m).all() or np.isnan(ranges.sigma_m[0])
    return float(ranges.distance_m[0]), float(ranges.sigma_m[0] / ranges.distance_m[0])


@pytest.mark.parametrize("factor", [0.3, 0.6, 0.7, 1.0, 1.5])
def test_factor_of_a_drive_is_found_and_corrected(factor):
    scale = drive(lambda d: factor * d)
    assert abs(scale.of_reference.mean - math.log(factor)) < 2 * scale.of_reference.sigma
    assert scale.of_reference.sigma < 0.12
    assert scale.slope.mean == pytest.approx(1.0, abs=0.1)
    assert scale.reach_m == math.inf
    for true_m in (10.0, 25.0, 50.0):
        distance_m, sigma = at(scale, factor * true_m)
        assert abs(distance_m / true_m - 1) < 2 * sigma
        assert sigma < 0.25


def test_before_a_drive_sigma_is_that_of_networks():
    distance_m, sigma = at(NetworkScale(), 20.0)
    assert distance_m == pytest.approx(20.0, rel=0.25)
    assert 0.3 < sigma < 0.8
    known = NetworkErrors(factor=0.5, drive_sigma=0.02, class_sigma=0.01, track_sigma=0.02)
    distance_m, sigma = at(NetworkScale(known, known.log_factor, known.drive_sigma), 10.0)
    assert distance_m == pytest.approx(20.0, rel=0.25)


@pytest.mark.parametrize("n", [4, 24])
def test_constant_network_measures_nothing(n):
    scale = drive(lambda d: 20.0 + 0.0 * d, n=n)
    assert abs(scale.slope.mean) < 2 * scale.slope.sigma + 0.05
    _, sigma = at(scale, 20.0)
    assert math.isnan(sigma) or sigma > 0.6


def test_network_that_saturates_is_precise_below_its_limit_only():
    scale = drive(lambda d: np.minimum(d, 40.0), n=40)
    assert 20 < scale.reach_m < 60
    near_m, near_sigma = at(scale, 15.0)
    assert near_m == pytest.approx(15.0, rel=0.2)
    assert near_sigma < 0.25
    far_m, far_sigma = at(scale, 40.0)
    assert far_sigma > 0.35
    for true_m in (40.0, 60.0, 90.0):
        assert abs(math.log(far_m / true_m)) < 2 * far_sigma


def test_compressed_distances_are_stretched():
    scale = drive(lambda d: 20 * (d / 20) ** 0.6, n=40)
    assert scale.slope.mean == pytest.approx(0.6, abs=0.12)
    for true_m in (8.0, 20.0, 55.0):
        distance_m, sigma = at(scale, 20 * (true_m / 20) ** 0.6)
        assert abs(math.log(distance_m / true_m)) < 2 * sigma


def test_noise_and_track_errors_are_measured():
    calm, flickering = drive(lambda d: d, noise=0.02), drive(lambda d: d, noise=0.25)
    assert flickering.noise_sigma == pytest.approx(0.25, rel=0.2)
    assert calm.noise_sigma < 0.05
    _, sigma = at(flickering, 20.0)
    assert sigma > 0.25
    rough = drive(lambda d: d, track_sigma=0.3, n=40)
    assert rough.track_sigma == pytest.approx(0.3, rel=0.35)


def test_errors_in_a_few_references_do_not_move_the_factor():
    def with_mismatches(d):
        return np.where(np.arange(len(d)) % 10 == 3, 3.0, 0.7) * d

    scale = drive(with_mismatches, n=40)
    assert scale.of_reference.mean == pytest.approx(math.log(0.7), abs=0.15)


def test_coverage_over_many_drives():
    within = []
    for seed in range(30):
        factor = math.exp(np.random.default_rng(seed).normal(0, 0.3))
        scale = drive(lambda d, factor=factor: factor * d, seed=seed, n=8)
        within.append(abs(scale.of_reference.mean - math.log(factor)) < scale.of_reference.sigma)
    assert 0.6 < np.mean(within) <= 1.0


def test_classes_of_measured_errors():
    errors = NetworkErrors(class_factors={"person": 0.8}, class_sigma=0.02)
    car, person = (at(NetworkScale(errors), 16.0, k)[0] for k in (CAR, PERSON))
    assert person / car == pytest.approx(1 / 0.8, rel=0.1)
    assert errors.class_variances[CAR] > 5 * errors.class_variances[PERSON]
