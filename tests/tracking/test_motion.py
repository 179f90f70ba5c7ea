from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings, strategies as st
from scipy.stats import chi2

from track_range.detection.boxes import xyxy_from_cxcywh
from track_range.tracking.motion import (
    BoxFilters,
    MotionNoise,
    compensate_camera_motion,
    cxcywh,
    gating_distance,
    initiate,
    predict,
    smoothed,
    transformed,
    update,
)

NOISE = MotionNoise()


def step(
    filters: BoxFilters, dt_s: float, xyxy_px: np.ndarray, noise: MotionNoise = NOISE
) -> BoxFilters:
    return update(predict(filters, dt_s, noise), xyxy_px, noise, np.ones(len(filters), np.bool_))[0]


def covariance(filters: BoxFilters) -> np.ndarray:
    """(N, 3) P_xx, P_xv, P_vv."""
    return filters.P.T


HALF_PX = np.array([20.0, 40.0])
BOX = np.array([[100.0, 50.0, 140.0, 130.0]])  # centre 120, 90; 40 x 80


def oracle(box_cxcywh: np.ndarray, noise: MotionNoise) -> KalmanFilter:
    """One 8-dimensional filter for a whole box: value and rate of cx, cy, w, h in turn."""
    filter8 = KalmanFilter(dim_x=8, dim_z=4)
    filter8.x = np.stack([box_cxcywh, np.zeros(4)], axis=1).reshape(8, 1)
    height = box_cxcywh[3]
    filter8.P = np.kron(
        np.eye(4), np.diag([(noise.measured * height) ** 2, (noise.first_rate * height) ** 2])
    )
    filter8.H = np.kron(np.eye(4), [[1.0, 0.0]])
    return filter8


def oracle_step(
    filter8: KalmanFilter, dt_s: float, height_px: float, z: np.ndarray, noise: MotionNoise
) -> None:
    s2 = height_px**2
    white = np.array([[dt_s**3 / 3, dt_s**2 / 2], [dt_s**2 / 2, dt_s]])
    Q = s2 * (noise.acceleration**2 * white + noise.drift**2 * np.array([[dt_s, 0], [0, 0]]))
    filter8.predict(F=np.kron(np.eye(4), [[1.0, dt_s], [0.0, 1.0]]), Q=np.kron(np.eye(4), Q))
    filter8.update(z.reshape(4, 1), R=np.eye(4) * (noise.measured**2 * s2))


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_equals_filterpy_on_random_sequences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    noise = MotionNoise(
        measured=0.04, drift=0.2, acceleration=1.5, first_rate=2.0, person_size_rate=1.0
    )
    boxes = np.concatenate([rng.uniform(0, 500, (3, 2)), rng.uniform(20, 200, (3, 2))], axis=1)
    xyxy = np.concatenate(
        [boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2], axis=1
    )
    filters, oracles = initiate(xyxy, noise), [oracle(box, noise) for box in boxes]
    for _ in range(6):
        dt_s = rng.uniform(0.01, 0.3)
        moved = boxes + rng.normal(0, 5, (3, 4))
        xyxy = np.concatenate(
            [moved[:, :2] - moved[:, 2:] / 2, moved[:, :2] + moved[:, 2:] / 2], axis=1
        )
        filters = step(filters, dt_s, xyxy, noise)
        for filter8, old, new in zip(oracles, boxes, moved, strict=True):
            oracle_step(filter8, dt_s, old[3], new, noise)
        boxes = moved
    for i, filter8 in enumerate(oracles):
        x = np.stack([filters.x[i], filters.v[i]], axis=1)
        np.testing.assert_allclose(x.reshape(8), filter8.x.reshape(8), rtol=1e-8, atol=1e-8)
        var, cov, var_rate = covariance(filters)[i]
        P = np.kron(np.eye(4), [[var, cov], [cov, var_rate]])  # four coordinates, one covariance
        np.testing.assert_allclose(P, filter8.P, rtol=1e-8, atol=1e-8)


@given(first_s=st.floats(0.001, 1.0), second_s=st.floats(0.001, 1.0))
@settings(deadline=None)
def test_two_predictions_equal_one_long_one(first_s: float, second_s: float) -> None:
    start = step(initiate(BOX, NOISE), 0.1, BOX + np.array([4.0, 1.0, 6.0, 3.0]))
    twice = predict(predict(start, first_s, NOISE), second_s, NOISE)
    once = predict(start, first_s + second_s, NOISE)
    np.testing.assert_allclose(twice.x, once.x, rtol=1e-9)
    np.testing.assert_allclose(covariance(twice), covariance(once), rtol=1e-9)


def test_rate_estimate_at_10_and_30_hz() -> None:
    rates = []
    for hz in (10, 30):
        filters = initiate(BOX, NOISE)
        for i in range(1, 2 * hz + 1):
            filters = step(filters, 1 / hz, BOX + 60.0 * i / hz * np.array([1, 0, 1, 0]))
        rates.append(filters.v[0, 0])
    assert rates[0] == pytest.approx(60.0, abs=2.0)
    assert rates[1] == pytest.approx(60.0, abs=2.0)


def test_prediction_grows_uncertain() -> None:
    later = predict(initiate(BOX, NOISE), 0.5, NOISE)
    np.testing.assert_allclose(later.xyxy_px, BOX)
    # 80 px high: (0.05 * 80)^2 + (1.9 * 80 * 0.5)^2 + 80^2 * (0.27^2 * 0.5 + 0.5^3 / 3)
    assert later.P[0, 0] == pytest.approx(16.0 + 5776.0 + 6400 * (0.03645 + 0.125 / 3))


def test_predicted_box_has_at_least_one_pixel() -> None:
    filters = initiate(BOX, NOISE)
    shrinking = np.array([filters.x, [[0.0, 0.0, -500.0, -500.0]]])
    gone = predict(replace(filters, state=shrinking), 1.0, NOISE)
    np.testing.assert_allclose(gone.xyxy_px, [[119.5, 89.5, 120.5, 90.5]])


def test_gating_distance_by_hand() -> None:
    filters = predict(initiate(BOX, NOISE), 0.1, NOISE)
    z = np.array([[110.0, 44.0, 152.0, 140.0], [100.0, 50.0, 140.0, 130.0]])
    S = np.eye(4) * (filters.P[0, 0] + (0.05 * 80) ** 2)
    innovation = np.array([131.0 - 120.0, 92.0 - 90.0, 42.0 - 40.0, 96.0 - 80.0])
    expected = innovation @ np.linalg.inv(S) @ innovation
    np.testing.assert_allclose(gating_distance(filters, z, NOISE), [[expected, 0.0]])


def test_gating_distance_is_chi_square() -> None:
    rng = np.random.default_rng(7)
    filters = predict(initiate(BOX, NOISE), 0.1, NOISE)
    sigma = np.sqrt(filters.P[0, 0] + (0.05 * 80) ** 2)
    cxcywh = filters.x[0] + rng.normal(0, 1, (4000, 4)) * sigma
    xyxy = np.concatenate(
        [cxcywh[:, :2] - cxcywh[:, 2:] / 2, cxcywh[:, :2] + cxcywh[:, 2:] / 2], axis=1
    )
    distance = gating_distance(filters, xyxy, NOISE)[0]
    for fraction in (0.5, 0.9, 0.99):
        assert np.mean(distance <= chi2.ppf(fraction, df=4)) == pytest.approx(fraction, abs=0.02)


def test_rows_are_independent_of_each_other() -> None:
    two = initiate(np.concatenate([BOX, BOX + 200.0]), NOISE)
    moved = step(two, 0.1, np.concatenate([BOX + 3.0, BOX + 190.0]))
    alone = step(initiate(BOX + 200.0, NOISE), 0.1, BOX + 190.0)
    np.testing.assert_array_equal(moved.select(np.array([1])).x, alone.x)
    again = moved.select(np.array([True, False])).concatenate(alone)
    np.testing.assert_array_equal(covariance(again), covariance(moved))


def test_no_tracks() -> None:
    none = predict(initiate(np.zeros((0, 4)), NOISE), 0.1, NOISE)
    assert len(none) == 0
    assert none.xyxy_px.shape == (0, 4)
    assert gating_distance(none, BOX, NOISE).shape == (0, 1)


def test_inputs_are_not_modified() -> None:
    filters = initiate(BOX, NOISE)
    x, P = filters.x.copy(), covariance(filters)
    step(filters, 0.1, BOX + 5.0)
    np.testing.assert_array_equal(filters.x, x)
    np.testing.assert_array_equal(covariance(filters), P)


def test_innovations_are_standard_normal() -> None:
    """Boxes that move by the filter's model: innovations have variance 1, and their sum is
    chi-square distributed."""
    rng, dt_s, n = np.random.default_rng(3), 0.1, 300
    noise = MotionNoise(measured=0.05, drift=0.1, acceleration=0.5, first_rate=0.5)
    height = 80.0
    value, rate = np.zeros((n, 2)), rng.normal(0, noise.first_rate * height, (n, 2))

    def box(at: np.ndarray) -> np.ndarray:
        measured = at + rng.normal(0, noise.measured * height, (n, 2)) + 500.0
        return np.concatenate([measured - HALF_PX, measured + HALF_PX], axis=1)

    filters = initiate(box(value), noise)
    innovations = []
    half = 0.5 * noise.acceleration * height * dt_s**1.5
    for _ in range(30):
        w1, w2 = rng.normal(0, 1, (2, n, 2))  # integrated white noise of the acceleration
        value = (
            value
            + rate * dt_s
            + half * (w1 + w2 / np.sqrt(3))
            + rng.normal(0, 0.1 * height * 0.1**0.5, (n, 2))
        )
        rate = rate + noise.acceleration * height * dt_s**0.5 * w1
        filters = predict(filters, dt_s, noise)
        filters, innovation = update(filters, box(value), noise, np.zeros(len(filters), np.bool_))
        innovations.append(innovation[:, :2])
    squared = np.sum(np.square(innovations), axis=2).ravel()
    for fraction in (0.5, 0.9, 0.99):
        assert np.mean(squared <= chi2.ppf(fraction, df=2)) == pytest.approx(fraction, abs=0.015)


def test_noise_scale_increases_variance() -> None:
    low, high = (
        predict(initiate(BOX, NOISE), 0.1, NOISE, noise_scale=scale) for scale in (0.1, 1.0)
    )
    assert low.P[0, 0] < high.P[0, 0]
    assert low.position_sigma[0] == pytest.approx(np.sqrt(low.P[0, 0]) / 80.0)


def test_camera_motion_of_filters() -> None:
    """A quarter turn about the origin, twice as large, 10 px to the right."""
    state = np.array([[[120.0, 90.0, 40.0, 80.0]], [[3.0, 3.0, 3.0, 3.0]]])
    filters = BoxFilters(state, np.ones((3, 1)), np.array([80.0]))
    later = compensate_camera_motion(filters, np.array([[0.0, -2.0, 10.0], [2.0, 0.0, 0.0]]))
    np.testing.assert_allclose(later.x, [[-170.0, 240.0, 80.0, 160.0]])
    np.testing.assert_allclose(later.v, [[-6.0, 6.0, 6.0, 6.0]])
    np.testing.assert_allclose(covariance(later), [[4.0, 4.0, 4.0]])
    np.testing.assert_allclose(later.position_sigma, filters.position_sigma)


def test_camera_motion_of_past_boxes() -> None:
    now_from_before = np.array([[0.0, -2.0, 10.0], [2.0, 0.0, 0.0]])
    past = np.array(
        [[[np.nan] * 4, [120.0, 90.0, 40.0, 80.0]], [[0.0, 0.0, 2.0, 4.0], [1.0, 0.0, 2.0, 4.0]]]
    )
    expected = [
        [[np.nan] * 4, [-170.0, 240.0, 80.0, 160.0]],
        [[10.0, 0.0, 4.0, 8.0], [10.0, 2.0, 4.0, 8.0]],
    ]
    moved = transformed(xyxy_from_cxcywh(past), now_from_before)
    np.testing.assert_allclose(cxcywh(moved), expected, atol=1e-12)


def test_rates_of_persons_sizes_have_a_lower_gain() -> None:
    predicted = predict(initiate(BOX.repeat(2, axis=0), NOISE), 0.1, NOISE)
    grown = np.array([[102.0, 54.0, 148.0, 142.0]] * 2)  # cx + 5, cy + 8, w + 6, h + 8
    updated, _ = update(predicted, grown, NOISE, np.array([False, True]))
    np.testing.assert_allclose(updated.v[1], updated.v[0] * [1.0, 1.0, 0.2, 0.2])
    np.testing.assert_array_equal(updated.x[1], updated.x[0])
    np.testing.assert_allclose(updated.v[0] / [5.0, 8.0, 6.0, 8.0], updated.v[0, 0] / 5.0)


def test_smoothed_box_has_the_filters_size_and_a_third_of_its_shift() -> None:
    x = np.array([[120.0, 90.0, 40.0, 80.0]])
    detected = np.array([[108.0, 50.0, 144.0, 142.0]])  # centre 126, 96; 36 x 92
    # centre 124, 94; 40 x 80
    np.testing.assert_allclose(smoothed(x, detected), [[104.0, 54.0, 144.0, 134.0]])
