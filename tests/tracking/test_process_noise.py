from __future__ import annotations

import numpy as np
import pytest

from track_range.tracking.motion import ProcessNoiseScale, ProcessNoiseSettings

HALF_PX = np.array([20.0, 40.0])


def estimated(before, now, *, n=1, **settings) -> float:
    scale = ProcessNoiseScale(ProcessNoiseSettings(**settings))
    for _ in range(n):
        scale.update(np.array(before, float), np.array(now, float))
    return scale.value


def test_scale_follows_correlation() -> None:
    # one track, equal and opposite innovations: correlation -1, so a factor of exp(-0.03)
    assert estimated([[1.0, 0.0]], [[-1.0, 0.0]]) == pytest.approx(np.exp(-0.03))
    assert estimated([[1.0, 0.0]], [[1.0, 0.0]], highest=5.0, n=2) == 5.0
    scale = ProcessNoiseScale(ProcessNoiseSettings())
    for _ in range(20):
        scale.update(np.array([[1.0, 0.5]]), np.array([[-1.0, -0.5]]))
    low = scale.value
    scale.update(np.array([[1.0, 0.5]]), np.array([[1.0, 0.5]]))
    assert scale.value == pytest.approx(low * np.exp(0.03))


def test_perpendicular_innovations_do_not_count() -> None:
    assert estimated([[1.0, 0.0]], [[0.0, 1.0]], n=5) == 1.0


def test_at_most_ten_tracks_count() -> None:
    ten, thirty = (estimated([[1.0, 0.0]] * n, [[-1.0, 0.0]] * n) for n in (10, 30))
    assert ten == thirty == pytest.approx(np.exp(-0.3))


def test_outliers_are_clipped() -> None:
    inliers, outlier = [[1.0, 0.0]] * 9, [[100.0, 0.0]]
    value = estimated(inliers + outlier, [[-1.0, 0.0]] * 9 + [[-100.0, 0.0]])
    # clipped to 2 sigmas, it counts as one of ten tracks
    assert value == pytest.approx(np.exp(-0.3))


def test_limits_and_empty_input() -> None:
    assert estimated([[2.0, 0.0]] * 10, [[-2.0, 0.0]] * 10, n=100) == 0.01
    assert estimated(np.zeros((0, 2)), np.zeros((0, 2)), n=3) == 1.0
    assert estimated([[1.0, 0.0]], [[-1.0, 0.0]], rate=0.0, n=9) == 1.0


@pytest.mark.parametrize(("true_noise", "low", "high"), [(0.02, 0.0, 0.2), (1.0, 0.6, 1.0)])
def test_scale_converges_to_true_noise(true_noise: float, low: float, high: float) -> None:
    """Boxes in random motion with a share of the filters' process noise: the scale converges to
    that share."""
    from track_range.tracking.motion import MotionNoise, initiate, predict, update

    rng, noise, dt_s, n, height = np.random.default_rng(1), MotionNoise(), 0.1, 12, 80.0
    value, rate = np.zeros((n, 2)), rng.normal(0, 20, (n, 2))

    def box() -> np.ndarray:
        measured = value + rng.normal(0, noise.measured * height, (n, 2)) + 500.0
        return np.concatenate([measured - HALF_PX, measured + HALF_PX], axis=1)

    scale, filters, before = ProcessNoiseScale(ProcessNoiseSettings()), initiate(box(), noise), None
    for _ in range(300):
        acceleration = rng.normal(0, 1, (n, 2)) * np.sqrt(true_noise)
        value = (
            value
            + rate * dt_s
            + rng.normal(0, 1, (n, 2)) * noise.drift * height * np.sqrt(true_noise * dt_s)
        )
        rate = rate + noise.acceleration * height * dt_s**0.5 * acceleration
        filters = predict(filters, dt_s, noise, noise_scale=scale.value)
        z = box()
        filters, innovation = update(filters, z, noise, np.zeros(len(filters), np.bool_))
        now = innovation[:, :2]
        if before is not None:
            scale.update(before, now)
        before = now
    assert low < scale.value <= high
