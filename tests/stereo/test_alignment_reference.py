"""Alignment from known disparities: by hand, with outliers and groups, and on KITTI's labelled
cars."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st

from track_range.foundation.arrays import FloatArray
from track_range.stereo.alignment.from_reference import fit_reference
from track_range.stereo.evaluation.kitti_2015 import read_pairs
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.matching.patch_matcher import PatchMatcher

CAMERA = PinholeCamera(700.0, 700.0, 600.0, 180.0, 1200, 360)


def fit(measured_px: FloatArray, true_px: FloatArray, **more: npt.NDArray[np.generic]) -> Alignment:
    n = len(measured_px)
    given = {"x_px": np.full(n, 600.0), "groups": np.arange(n), **more}
    return fit_reference(measured_px, true_px, camera=CAMERA, seed=1, **given)


def cars(
    n: int, *, seed: int, curvature_px: float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Measured and true disparities, 0.5 px (and the curvature) apart, and columns; noise grows
    with disparity."""
    rng = np.random.default_rng(seed)
    true_px, x_px = rng.uniform(6.0, 60.0, n), rng.uniform(0.0, 1200.0, n)
    error_px = 0.5 + curvature_px * ((x_px - 600.0) / 600.0) ** 2
    return true_px - error_px + rng.normal(0.0, 0.02 * true_px), true_px, x_px


def test_five_objects_by_hand() -> None:
    # weights 1/10 1/10 1/10 1/20 1/40, sum 0.375: the weighted median is between the second and
    # third error
    measured_px = np.array([10.0, 10.0, 10.0, 20.0, 40.0])
    alignment = fit(measured_px, measured_px + np.array([0.3, 0.4, 0.5, 0.9, 2.0]))
    # cumulated to the middle of each: 0.05 0.15 0.25 0.325 0.3625; half of the sum, 0.1875, is
    # between 0.4 and 0.5
    assert alignment.offset_px == pytest.approx(0.4 + 0.1 * 0.0375 / 0.1)
    assert alignment.curvature_px == 0.0


def test_exact_objects_have_no_residual() -> None:
    measured_px = np.linspace(5.0, 50.0, 20)
    alignment = fit(measured_px, measured_px + 0.5)
    assert alignment.offset_px == pytest.approx(0.5)
    assert alignment.residual_px == pytest.approx(0.0, abs=1e-6)
    assert alignment.offset_sigma_px == pytest.approx(0.0, abs=1e-6)
    assert alignment.source == "20 known distances of 20 scenes or objects"


@settings(deadline=None, max_examples=20)
@given(st.floats(-1.0, 1.0), st.integers(0, 1000))
def test_offset_follows_a_shift_of_the_truth(shift_px: float, seed: int) -> None:
    measured_px, true_px, _ = cars(12, seed=seed)
    before, after = fit(measured_px, true_px), fit(measured_px, true_px + shift_px)
    assert after.offset_px == pytest.approx(before.offset_px + shift_px, abs=1e-9)
    assert after.residual_px == pytest.approx(before.residual_px, abs=1e-6)


def test_mismatches_and_nan_are_ignored() -> None:
    measured_px, true_px, _ = cars(30, seed=3)
    clean = fit(measured_px, true_px)
    extended_px = np.concatenate([measured_px, [np.nan, 70.0, -1.0, 12.0]])
    with_mismatches = fit(extended_px, np.concatenate([true_px, [10.0, 10.0, 10.0, np.nan]]))
    assert with_mismatches == clean


def test_sigma_accounts_for_correlated_groups() -> None:
    """20 scenes of 5 objects with a common error: as uncertain as 20 objects, not as 100."""
    errors = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        groups = np.repeat(np.arange(20), 5)
        true_px = np.full(100, 12.0)
        measured_px = true_px - 0.5 + rng.normal(0.0, 0.3, 20)[groups] + rng.normal(0.0, 0.02, 100)
        alignment = fit(measured_px, true_px, groups=groups)
        errors.append((alignment.offset_px - 0.5) / alignment.offset_sigma_px)
    assert 0.6 < float(np.std(errors)) < 1.5


def test_few_groups_have_a_large_sigma() -> None:
    measured_px, true_px, _ = cars(40, seed=5)
    assert fit(measured_px, true_px, groups=np.zeros(40)).offset_sigma_px > 0.1
    assert fit(measured_px, true_px).offset_sigma_px < 0.1


def test_curvature_needs_many_objects() -> None:
    measured_px, true_px, x_px = cars(400, seed=7, curvature_px=1.5)
    curved = fit(measured_px, true_px, x_px=x_px)
    assert curved.offset_px == pytest.approx(0.5, abs=0.15)
    assert curved.curvature_px == pytest.approx(1.5, abs=4 * curved.curvature_sigma_px)
    assert 0.02 < curved.curvature_sigma_px < 0.4
    few = fit(measured_px[:36], true_px[:36], x_px=x_px[:36])
    assert (few.curvature_px, few.curvature_sigma_px) == (0.0, 0.0)
    uncurved_px, true_px, x_px = cars(400, seed=8)
    assert fit(uncurved_px, true_px, x_px=x_px).curvature_px == 0.0


def test_residual_excludes_the_matchers_sigma() -> None:
    rng = np.random.default_rng(9)
    true_px = np.full(400, 15.0)
    measured_px = true_px - 0.5 + rng.normal(0.0, 0.5, 400)
    total = fit(measured_px, true_px).residual_px
    excess = fit(measured_px, true_px, sigma_px=np.full(400, 0.4)).residual_px
    none = fit(measured_px, true_px, sigma_px=np.full(400, 2.0)).residual_px
    assert total == pytest.approx(0.5, abs=0.06)
    assert excess == pytest.approx(0.3, abs=0.08)
    assert none < 0.06


def test_too_few_objects() -> None:
    with pytest.raises(RigError, match="found 4"):
        fit(np.array([10.0, 11.0, 12.0, 13.0, np.nan]), np.full(5, 12.0))


def test_kitti_cars_read_up_to_half_a_pixel_low(shared_data: Path) -> None:
    rows = []
    for number, pair in enumerate(read_pairs(shared_data / "kitti2015")):
        no_prior_px = np.full(len(pair.true_px), np.nan)
        found_px = (
            PatchMatcher().match(pair.left, pair.right, pair.xyxy_px, no_prior_px).disparity_px
        )
        rows += [
            np.column_stack([found_px, pair.true_px, pair.x_px, np.full(len(found_px), number)])
        ]
        camera = pair.rig.left
    measured_px, true_px, x_px, groups = np.concatenate(rows).T
    alignment = fit_reference(measured_px, true_px, x_px=x_px, camera=camera, groups=groups, seed=0)
    assert 0.2 < alignment.offset_px < 0.6  # dense matching: 0.45, the patch matcher: 0.3
    assert 0.03 < alignment.offset_sigma_px < 0.15
    assert 0.15 < alignment.residual_px < 0.4
    assert alignment.curvature_px == 0.0
