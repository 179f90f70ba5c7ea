"""Fit of log-linear curves: height of the objects, and error on other drives."""

import numpy as np
import pytest

from tests.ranging.made_up_boxes import made_up_boxes
from track_range.ranging.fitting.curve_fit import fit_curves, leave_one_out_error
from track_range.ranging.size_models.curve import CurveError, load_curves, save_curves


def world(n=400, n_sequences=4, seed=0):
    """Cars of 1.5 m height, with a standard deviation of 5 % between sequences."""
    rng = np.random.default_rng(seed)
    sequence = np.arange(n) % n_sequences
    distance_m = rng.uniform(8, 80, n)
    height_m = 1.5 * (1 + 0.05 * np.array([1, -1, 1, -1])[sequence])
    sizes = np.stack([1.7 / distance_m, height_m / distance_m], axis=1) * np.exp(
        rng.normal(0, 0.01, (n, 2))
    )
    return made_up_boxes("car", sizes, rng.uniform(-0.5, 0.5, n), distance_m, sequence=sequence)


def test_fit_recovers_height_and_sigma():
    samples = world()
    curve = fit_curves(samples, source="made up").height_only["car"]
    assert np.exp(curve.intercept) == pytest.approx(1.5, rel=0.03)
    assert curve.per_log_height == pytest.approx(-1.0, abs=0.02)
    assert 0.04 < curve.sigma_relative < 0.09  # between sequences; within them it is 1 %
    error = leave_one_out_error(samples, use_width=False)
    assert np.sqrt((error**2).mean()) == pytest.approx(curve.sigma_relative, rel=0.01)


def test_fit_to_a_single_view_can_be_loaded(tmp_path):
    """A truck seen from one side: only the width determines the distance."""
    distance_m = np.linspace(20, 21, 150)
    sizes = np.stack([2.5 / distance_m, 3.0 / 20 * np.ones(150)], axis=1)
    samples = made_up_boxes(
        "truck", sizes, np.zeros(150), distance_m, sequence=np.zeros(150, np.int64)
    )
    save_curves(fit_curves(samples, source=""), tmp_path / "c.json")
    assert load_curves(tmp_path / "c.json").whole["truck"].per_log_height <= -0.1


def test_single_sequence_has_a_minimum_sigma():
    samples = world()
    one = samples.select(samples.sequence == 0)
    assert fit_curves(one, source="").whole["car"].sigma_relative == 0.03


def test_too_few_samples_are_refused():
    with pytest.raises(CurveError, match=r"at least 100 .*car 12"):
        fit_curves(world(12), source="")
