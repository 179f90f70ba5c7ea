"""Bundles of synthetic points: derivatives, the true error within its sigma, and drives without
enough data."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from track_range.foundation.arrays import FloatArray
from track_range.stereo.alignment.bundle_adjustment import (
    CURVATURE,
    OFFSET,
    Bundle,
    Observations,
    fit_bundle,
    linearize,
)
from track_range.stereo.alignment.initial_poses import initial_bundle
from track_range.stereo.alignment.segments import Segment, combine, segment_of
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

CAMERA = PinholeCamera(700.0, 700.0, 600.0, 180.0, 1200, 360)
RIG = StereoRig.rectified(CAMERA, 0.54)
NOISE_PX = 0.15


def drive(
    seed: int,
    *,
    offset_px: float = 0.0,
    curvature_px: float = 0.0,
    step_m: float = 1.0,
    yaw_step_rad: float = 0.003,
    n_points: int = 700,
    n_frames: int = 14,
    fraction_moving: float = 0.0,
    noise_px: float = NOISE_PX,
) -> Observations:
    """A drive through a street of random points; moving points keep their distance from the
    vehicle."""
    rng = np.random.default_rng(seed)
    z_m = rng.uniform(5.0, 90.0, n_points)
    side_m = rng.uniform(3.0, 20.0, n_points) * rng.choice([-1.0, 1.0], n_points)
    world_m = np.column_stack([side_m, rng.uniform(-5.0, 1.6, n_points), z_m])
    is_moving = rng.random(n_points) < fraction_moving
    frames, points, pixels = [], [], []
    for frame in range(n_frames):
        rotation = cv2.Rodrigues(np.array([0.0, -yaw_step_rad * frame, 0.0]))[0]
        camera_m = (
            world_m - [0.0, 0.0, step_m * frame] + is_moving[:, None] * [0.0, 0.0, step_m * frame]
        ) @ rotation.T
        left_px = CAMERA.project(camera_m)
        u = (left_px[:, 0] - CAMERA.cx_px) / 600.0
        disparity_px = CAMERA.fx_px * RIG.baseline_m / camera_m[:, 2]
        right_px = left_px[:, 0] - disparity_px + offset_px + curvature_px * u**2
        with np.errstate(invalid="ignore"):
            inside = (
                (left_px > 0).all(axis=1) & (left_px < [1200, 360]).all(axis=1) & (right_px > 0)
            )
        seen = np.flatnonzero(inside & (camera_m[:, 2] > 4.0))
        frames.append(np.full(len(seen), frame))
        points.append(seen)
        pixels.append(np.column_stack([left_px[seen], right_px[seen]]))
    xyx_px = np.concatenate(pixels)
    return Observations(
        np.concatenate(frames),
        np.concatenate(points),
        xyx_px + rng.normal(0.0, noise_px, xyx_px.shape),
    )


def segment(observed: Observations) -> Segment:
    result = segment_of(observed, RIG)
    assert isinstance(result, Segment), result
    return result


def test_derivatives_equal_finite_differences() -> None:
    rng = np.random.default_rng(1)
    rotation = cv2.Rodrigues(np.array([0.02, -0.05, 0.01]))[0]
    bundle = Bundle(
        np.stack([np.eye(3), rotation]),
        np.array([[0.0, 0.0, 0.0], [0.1, -0.05, -1.2]]),
        np.column_stack([rng.uniform(-0.5, 0.5, (6, 2)), rng.uniform(0.01, 0.1, 6)]),
        np.array([0.3, -0.8, 0.4]),
    )
    seen = Observations(np.ones(6, np.int64), np.arange(6), np.zeros((6, 3)))
    linear = linearize(seen, bundle, RIG)
    small = 1e-6

    def changed(moved: Bundle) -> FloatArray:
        return (linear.residual - linearize(seen, moved, RIG).residual) / small

    for axis in range(3):
        vector = small * np.eye(3)[axis]
        rotated = np.stack([np.eye(3), cv2.Rodrigues(vector)[0] @ rotation])
        assert changed(replace(bundle, rotation=rotated)) == pytest.approx(
            linear.by_pose[:, :, axis], abs=2e-3
        )
        shifted = bundle.translation_m + np.stack([np.zeros(3), vector])
        assert changed(replace(bundle, translation_m=shifted)) == pytest.approx(
            linear.by_pose[:, :, 3 + axis], abs=2e-3
        )
        assert changed(replace(bundle, points=bundle.points + vector)) == pytest.approx(
            linear.by_point[:, :, axis], rel=1e-3, abs=2e-2
        )
    for axis in range(3):
        error_px = bundle.error_px + small * np.eye(3)[axis]
        assert changed(replace(bundle, error_px=error_px)) == pytest.approx(
            linear.by_shared[:, :, axis], abs=1e-6
        )


def test_exact_result_without_noise() -> None:
    initial = initial_bundle(drive(2, offset_px=0.5, curvature_px=1.0, noise_px=0.0), RIG)
    assert initial is not None
    fit = fit_bundle(initial.observed, initial.bundle, RIG)
    assert fit.bundle.error_px == pytest.approx([0.5, 1.0, 0.0], abs=0.01)
    assert fit.bundle.path_m == pytest.approx(13.0, abs=0.01)


@pytest.mark.parametrize("frames", [(5,), (5, 6), (13,)])
def test_frames_without_points_keep_their_poses_and_the_others_are_fitted(
    frames: tuple[int, ...],
) -> None:
    initial = initial_bundle(drive(2, offset_px=0.5), RIG)
    assert initial is not None
    is_kept = ~np.isin(initial.observed.frame, frames)
    fit = fit_bundle(
        Observations(*(part[is_kept] for part in initial.observed)), initial.bundle, RIG
    )
    assert fit.bundle.error_px == pytest.approx([0.5, 0.0, 0.0], abs=0.05)
    assert fit.noise_px == pytest.approx(NOISE_PX, rel=0.1)
    for frame in frames:
        np.testing.assert_array_equal(fit.bundle.rotation[frame], initial.bundle.rotation[frame])
        np.testing.assert_array_equal(
            fit.bundle.translation_m[frame], initial.bundle.translation_m[frame]
        )


@pytest.mark.slow
@pytest.mark.parametrize(("offset_px", "curvature_px"), [(0.0, 0.0), (0.5, 0.0), (-0.3, 1.5)])
def test_known_error_within_two_sigma(offset_px: float, curvature_px: float) -> None:
    estimate = combine(
        [segment(drive(3, offset_px=offset_px, curvature_px=curvature_px))], (OFFSET, CURVATURE)
    )
    assert np.abs(estimate.error_px[:2] - [offset_px, curvature_px]) == pytest.approx(
        [0.0, 0.0], abs=2 * estimate.sigma_px.max()
    )
    assert (estimate.sigma_px[:2] < [0.06, 0.2]).all()
    assert estimate.spread_px < 0.05


@pytest.mark.slow
def test_sigma_matches_errors() -> None:
    """Over ten drives the errors agree with their sigmas, without a bias."""
    normal = []
    for seed in range(10):
        estimate = combine([segment(drive(10 + seed, offset_px=0.5, n_points=400))], (OFFSET,))
        normal.append((estimate.error_px[0] - 0.5) / estimate.sigma_px[0])
    assert 0.3 < float(np.std(normal)) < 1.5
    assert abs(float(np.mean(normal))) < 1.0


def test_combination_of_two_segments() -> None:
    one, other = (
        segment(drive(30, offset_px=0.4, n_points=400)),
        segment(drive(31, offset_px=0.4, n_points=400)),
    )
    alone = [combine([part], (OFFSET,)) for part in (one, other)]
    both = combine([one, other], (OFFSET,))
    low, high = sorted(estimate.error_px[0] for estimate in alone)
    assert low < both.error_px[0] < high
    assert both.sigma_px[0] < max(estimate.sigma_px[0] for estimate in alone)
    assert both.error_px[0] == pytest.approx(0.4, abs=3 * both.sigma_px[0])
    assert (both.error_px[1], both.sigma_px[1]) == (0.0, 0.0)


@pytest.mark.parametrize("fraction_moving", [pytest.param(0.1, marks=pytest.mark.slow), 0.25])
def test_moving_objects_have_no_influence(fraction_moving: float) -> None:
    estimate = combine(
        [segment(drive(4, offset_px=0.5, fraction_moving=fraction_moving))], (OFFSET,)
    )
    assert estimate.error_px[0] == pytest.approx(0.5, abs=0.03)


def test_half_of_the_points_on_vehicles_ahead() -> None:
    """The static scene moves faster than vehicles that keep their distance, also if half of the
    points are on them."""
    estimate = combine([segment(drive(4, offset_px=0.5, fraction_moving=0.5))], (OFFSET,))
    assert estimate.error_px[0] == pytest.approx(0.5, abs=0.05)


def test_scene_that_moves_with_the_vehicle_is_refused() -> None:
    assert isinstance(segment_of(drive(4, fraction_moving=1.0), RIG), str)


@pytest.mark.slow
def test_unmodelled_errors_increase_the_spread() -> None:
    seen = drive(5, offset_px=0.5)
    u = (seen.xyx_px[:, 0] - CAMERA.cx_px) / 600.0
    tilted = seen._replace(
        xyx_px=seen.xyx_px + np.column_stack([0 * u, 0 * u, 0.6 * np.sin(3 * u)])
    )
    plain, with_error = (
        combine([segment(seen)], (OFFSET, CURVATURE)),
        combine([segment(tilted)], (OFFSET, CURVATURE)),
    )
    assert with_error.spread_px > 0.15 > 3 * plain.spread_px
    assert with_error.sigma_px[0] > 2 * plain.sigma_px[0]


@pytest.mark.parametrize(
    ("options", "key_word"),
    [
        ({"step_m": 0.0, "yaw_step_rad": 0.0}, "hardly moves"),
        ({"step_m": 0.0, "yaw_step_rad": 0.02}, "hardly moves"),
        ({"n_points": 60}, "too few points"),
        ({"n_frames": 3}, "too few points"),
    ],
)
def test_drives_without_enough_data(options: dict[str, Any], key_word: str) -> None:
    assert key_word in str(segment_of(drive(6, **options), RIG))


def test_random_points_are_refused() -> None:
    rng = np.random.default_rng(8)
    seen = drive(8)
    lost = seen._replace(xyx_px=rng.uniform(0.0, 360.0, seen.xyx_px.shape))
    assert isinstance(segment_of(lost, RIG), str)
