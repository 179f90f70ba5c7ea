import numpy as np
import pytest

from track_range.ranging.filtering.distance_filter import NoiseScale

ALL = np.ones((1, 20), bool)


def learnt(true_variance, *, declared=1.0, predicted=0.3, frames=100):
    rng, scale = np.random.default_rng(6), NoiseScale()
    for _ in range(frames):
        squared = rng.normal(0, np.sqrt(predicted + true_variance), (1, 20)) ** 2
        scale.learn(
            squared,
            np.full((1, 20), predicted),
            noise=scale.factor * np.full((1, 20), declared),
            use=ALL,
        )
    return scale.factor.item()


@pytest.mark.parametrize("true_variance", [0.2, 1.0, 4.0])
def test_ratio_of_true_to_declared_variance(true_variance):
    assert learnt(true_variance) == pytest.approx(true_variance, rel=0.2)


def test_starts_at_the_declared_noise():
    scale = NoiseScale()
    assert scale.factor == 1.0
    scale.learn(np.full((1, 3), 9.0), np.zeros((1, 3)), noise=np.ones((1, 3)), use=ALL[:, :3])
    assert scale.factor.item() == pytest.approx(
        (30 * 0.5 ** (3 / 300) + 27) / (30 * 0.5 ** (3 / 300) + 3)
    )


def test_limits_and_outliers():
    assert learnt(1e-6, predicted=1e-6, frames=400) == pytest.approx(0.04)
    assert learnt(1e4, frames=400) == pytest.approx(16.0)
    scale = NoiseScale()
    scale.learn(np.array([[1e9]]), np.zeros((1, 1)), noise=np.ones((1, 1)), use=ALL[:, :1])
    assert scale.factor < 1.3


def test_unused_innovations_change_nothing():
    scale = NoiseScale()
    unknown = np.full((1, 20), np.nan)
    scale.learn(unknown, unknown, noise=unknown, use=~ALL)
    assert scale.factor == 1.0


def test_methods_are_separate():
    squared = np.array([[9.0, 9.0, 9.0], [4.0, np.nan, 0.1]])
    use = np.array([[True, True, True], [True, False, False]])
    both, first, second = NoiseScale(2), NoiseScale(), NoiseScale()
    both.learn(squared, np.zeros((2, 3)), noise=np.ones((2, 3)), use=use)
    first.learn(squared[:1], np.zeros((1, 3)), noise=np.ones((1, 3)), use=use[:1])
    second.learn(squared[1:, :1], np.zeros((1, 1)), noise=np.ones((1, 1)), use=use[1:, :1])
    assert both.factor[:, 0] == pytest.approx([first.factor.item(), second.factor.item()])
    assert first.factor > second.factor > 1.0
