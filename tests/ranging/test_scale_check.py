"""Doubt about the scale of a rig, from drawn drives of road users with known sizes."""

import math

import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.ranging.ranges import Ranges
from track_range.ranging.scale_check import ScaleCheck, ScaleDoubt
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.road_horizon import RoadView
from track_range.tracking.tracks import Tracks

CAMERA = PinholeCamera(1000.0, 1000.0, 640.0, 360.0, 1280, 720)
CAR = ROAD_CLASSES.index("car")


def checked(
    factor, *, seed=0, n=4, sizes=1.0, true_height_m=1.5, seconds=5.0, has_road=True, speed_mps=math.nan, **given
):
    """The finding after a drive with `n` cars, whose rig makes distances `factor` times too long."""
    rng = np.random.default_rng(seed)
    check = ScaleCheck(CAMERA, **given)
    true_m, own = rng.uniform(10, 40, n), np.exp(rng.normal(0, 0.08, n))
    x_px = rng.uniform(300, 1000, n)
    for k in range(round(10 * seconds)):
        bottom = 360 + 1000 * (true_height_m / true_m + rng.normal(0, 0.002))
        boxes = np.stack([x_px - 600 / true_m, bottom - 1500 / true_m, x_px + 600 / true_m, bottom], axis=1)
        ids = np.arange(1, n + 1)
        tracks = Tracks(ids, boxes, np.full(n, CAR), np.ones(n), np.ones(n, np.bool_))
        by_size = true_m * sizes * own * np.exp(rng.normal(0, 0.03, n))
        stereo = true_m * factor * np.exp(rng.normal(0, 0.01, n))
        check.update(
            tracks,
            Ranges(ids, by_size, 0.1 * by_size),
            Ranges(ids, stereo, 0.02 * stereo),
            time_s=0.1 * k,
            road=RoadView(horizon=0.0, horizon_variance=1e-6) if has_road else None,
            speed_mps=speed_mps * factor,
            is_speed_by_stereo=True,
        )
    return check.doubt


@pytest.mark.parametrize("factor", [0.1, 0.39, 0.5, 2.0, 2.54, 10.0])
def test_wrong_scales_are_found(factor):
    for seed in range(5):
        doubt = checked(factor, seed=seed)
        assert doubt is not None
        assert abs(math.log(doubt.factor / factor)) < 3 * doubt.sigma
        assert doubt.sigma < 0.15


@pytest.mark.parametrize("sizes", [0.9, 1.0, 1.12])
def test_right_scales_are_not_doubted(sizes):
    """Cars of other countries, and a camera in a lorry or in a low car."""
    for seed in range(10):
        assert checked(1.0, seed=seed, sizes=sizes) is None
    for height_m in (1.1, 2.6):
        assert checked(1.0, sizes=sizes, true_height_m=height_m) is None


def test_a_given_height_finds_smaller_errors():
    known = {"region": "europe", "factor": 1.5}
    without = [checked(seed=seed, **known) is not None for seed in range(10)]
    given = [checked(seed=seed, height_m=1.5, **known) is not None for seed in range(10)]
    assert sum(given) > 7
    assert sum(without) < 5


def test_speeds_of_no_car():
    """160 m/s: even without a second road user's size, no rig can be right."""
    assert checked(1.0, n=2, speed_mps=160.0, has_road=False).factor > 2.0
    assert checked(1.0, n=2, speed_mps=40.0, has_road=False) is None


def test_one_object_is_not_enough():
    assert checked(2.54, n=1) is None


def test_a_sentence_names_the_causes_that_fit():
    sentence = ScaleDoubt(2.5, 0.06, 4).sentence(0.5)
    for part in ("2.50 times", "± 6 %", "0.5 m would be 0.2 m", "read as inches", "2.5 times as large"):
        assert part in sentence
    assert "feet" not in sentence
    assert "read as" not in ScaleDoubt(0.5, 0.06, 4).sentence(0.2)


@pytest.mark.parametrize("factor", [0.4, 2.5])
def test_sigma_covers_both_scales(factor):
    distance_m = 20.0
    sigma_m = ScaleDoubt(factor, 0.1, 3).shared_sigma * distance_m
    assert 1.0 < sigma_m / abs(distance_m - distance_m / factor) < 1.2
