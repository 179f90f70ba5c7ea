"""Changes of the believed sizes of objects, which the filters do not take for motion."""

import numpy as np
import pytest

import track_range as tr
from track_range.detection.classes import ROAD_CLASSES
from track_range.ranging.filtering.believed_size import BelievedSizes
from track_range.ranging.filtering.observation import Observation
from track_range.stereo.odometry.ego_motion import EgoMotion

TRUCK = ROAD_CLASSES.index("truck")
NOISE, SIZE = 0.02**2, 0.15**2  # variances of log distance
F_PX = 1000.0


def factors_of(sizes, *, times_s=None, track_id=1):
    """Factor of each frame of one track by one method."""
    believed = BelievedSizes(1)
    times_s = 0.1 * np.arange(len(sizes)) if times_s is None else times_s
    variances = {"independent": np.full((1, 1), NOISE), "systematic": np.full((1, 1), SIZE)}
    return [
        float(believed.update(np.array([track_id]), np.array([[size]]), time_s, **variances)[0, 0])
        for size, time_s in zip(sizes, np.asarray(times_s).tolist(), strict=True)
    ]


def test_motion_of_an_object_of_one_size_changes_no_belief():
    distance_m = np.linspace(60.0, 20.0, 30)
    assert factors_of(distance_m * (3.0 * F_PX / distance_m)) == pytest.approx([1.0] * 30)


def test_a_new_belief_is_followed():
    """A truck of 3 m that turns out to have 3.6 m: all distances so far were too small by 1.2."""
    factors = factors_of([3.0] * 10 + [3.6] * 60)
    assert factors[:10] == pytest.approx([1.0] * 10)
    assert np.prod(factors) == pytest.approx(1.2, rel=0.02)
    assert factors[10] < 1.1  # noise of a single box is no belief


def test_noise_of_the_first_boxes_is_no_change():
    """The belief of the first frame is not better known than that of the second one."""
    assert factors_of([3.0, 3.3], times_s=[0.0, 1e-6])[1] == pytest.approx(1.0, abs=1e-5)
    rng = np.random.default_rng(1)
    factors = factors_of(3.0 * np.exp(rng.normal(0.0, NOISE**0.5, 10)))
    assert np.abs(np.log(factors[:3])).max() < 0.2 * NOISE**0.5
    assert np.abs(np.log(factors)).max() < NOISE**0.5


def test_unknown_sizes_and_long_gaps_change_nothing():
    factors = factors_of([3.0, np.nan, 3.0, 3.6], times_s=[0.0, 0.1, 0.2, 1.3])
    assert factors == [1.0] * 4


def rates_of(distance_m, *, has_sizes):
    """Rates of a truck that stands, as does the camera, by these distances of a constant box."""
    filters, ids = tr.DistanceFilters({"mono": 0.35}), np.array([1])
    rates = []
    for i, z in enumerate(distance_m.tolist()):
        sigma_m = np.array([0.15 * z])
        ranges = tr.Ranges(ids, np.array([z]), sigma_m, np.array([0.148 * z]))
        heights = {"mono": np.array([100.0])} if has_sizes else {}
        observation = Observation(class_id=np.array([TRUCK]), heights_px=heights)
        found = filters.update(
            {"mono": ranges}, 0.1 * i, observation=observation, ego=EgoMotion(0.0, 0.05)
        )
        rates.append(float(found["mono"].state.v[0]))
    return np.array(rates), found["mono"]


def test_a_truck_that_turns_out_larger_does_not_move():
    rng = np.random.default_rng(0)
    belief_m = np.interp(np.arange(40), [8, 18], [50.0, 62.0])
    distance_m = belief_m * np.exp(rng.normal(0.0, 0.015, 40))
    read, _ = rates_of(distance_m, has_sizes=False)
    steady, found = rates_of(distance_m, has_sizes=True)
    assert read[10:].max() > 6.0
    assert np.abs(steady[8:]).max() < 2.5
    assert np.abs(steady[25:]).max() < 0.5
    assert found.static[0] > 0.9
    assert found.ranges.distance_m[0] == pytest.approx(62.0, rel=0.03)
