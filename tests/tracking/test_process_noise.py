from __future__ import annotations

import numpy as np
import pytest

from track_range.tracking.process_noise import ProcessNoiseScale, ProcessNoiseSettings

HALF_PX = np.array([20.0, 40.0])


def learnt(before, now, *, n=1, **settings) -> float:
    level = ProcessNoiseScale(ProcessNoiseSettings(**settings))
    for _ in range(n):
        level.update(np.array(before, float), np.array(now, float))
    return level.value


def test_innovations_to_and_fro_calm_it_and_steady_ones_stir_it() -> None:
    # one track, equal and opposite innovations: correlation -1, so a factor of exp(-0.03)
    assert learnt([[1.0, 0.0]], [[-1.0, 0.0]]) == pytest.approx(np.exp(-0.03))
    assert learnt([[1.0, 0.0]], [[1.0, 0.0]], highest=5.0, n=2) == 5.0
    calm = ProcessNoiseScale(ProcessNoiseSettings())
    for _ in range(20):
        calm.update(np.array([[1.0, 0.5]]), np.array([[-1.0, -0.5]]))
    low = calm.value
    calm.update(np.array([[1.0, 0.5]]), np.array([[1.0, 0.5]]))
    assert calm.value == pytest.approx(low * np.exp(0.03))


def test_across_says_nothing() -> None:
    assert learnt([[1.0, 0.0]], [[0.0, 1.0]], n=5) == 1.0


def test_ten_tracks_count_ten_times_and_more_do_not() -> None:
    ten, thirty = (learnt([[1.0, 0.0]] * n, [[-1.0, 0.0]] * n) for n in (10, 30))
    assert ten == thirty == pytest.approx(np.exp(-0.3))


def test_one_wrong_box_does_not_speak_for_the_stream() -> None:
    steady, wrong = [[1.0, 0.0]] * 9, [[100.0, 0.0]]
    value = learnt(steady + wrong, [[-1.0, 0.0]] * 9 + [[-100.0, 0.0]])
    assert value == pytest.approx(np.exp(-0.3))  # cut to 2 sigmas, it is one voice of ten


def test_limits_and_nobody_to_listen_to() -> None:
    assert learnt([[2.0, 0.0]] * 10, [[-2.0, 0.0]] * 10, n=100) == 0.01
    assert learnt(np.zeros((0, 2)), np.zeros((0, 2)), n=3) == 1.0
    assert learnt([[1.0, 0.0]], [[-1.0, 0.0]], rate=0.0, n=9) == 1.0


@pytest.mark.parametrize(("true_noise", "low", "high"), [(0.02, 0.0, 0.2), (1.0, 0.6, 1.0)])
def test_it_finds_the_noise_of_the_stream(true_noise: float, low: float, high: float) -> None:
    """Boxes that walk with a share of the filters' own noise: the level ends near it, from either side."""
    from track_range.tracking.motion import MotionNoise, initiate, predict, update

    rng, noise, dt_s, n, height = np.random.default_rng(1), MotionNoise(), 0.1, 12, 80.0
    value, rate = np.zeros((n, 2)), rng.normal(0, 20, (n, 2))

    def box() -> np.ndarray:
        seen = value + rng.normal(0, noise.measured * height, (n, 2)) + 500.0
        return np.concatenate([seen - HALF_PX, seen + HALF_PX], axis=1)

    level, filters, before = ProcessNoiseScale(ProcessNoiseSettings()), initiate(box(), noise), None
    for _ in range(300):
        push = rng.normal(0, 1, (n, 2)) * np.sqrt(true_noise)
        value = value + rate * dt_s + rng.normal(0, 1, (n, 2)) * noise.drift * height * np.sqrt(true_noise * dt_s)
        rate = rate + noise.acceleration * height * dt_s**0.5 * push
        filters = predict(filters, dt_s, noise, noise_scale=level.value)
        z = box()
        filters, innovation = update(filters, z, noise)
        now = innovation[:, :2]
        if before is not None:
            level.update(before, now)
        before = now
    assert low < level.value <= high
