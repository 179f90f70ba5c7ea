import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from track_range.ranging.evaluation.paper_filter import PaperFilter
from track_range.ranging.ranges import Ranges


def measured(ids, distance_m):
    return Ranges(np.array(ids), np.array(distance_m, float), np.ones(len(ids)))


def test_by_hand():
    paper = PaperFilter()
    first = paper.update(measured([1], [20.0]), 0.0, ego_speed_mps=10.0)
    assert (first.ranges.distance_m[0], first.ranges.sigma_m[0]) == pytest.approx((20.0, np.sqrt(0.1)))
    assert np.isnan(first.rate_mps[0])
    second = paper.update(measured([1], [20.0]), 0.1, ego_speed_mps=10.0)
    # Predicted 19 +- sqrt(0.2), gain 2/3.
    assert second.ranges.distance_m[0] == pytest.approx(19 + 2 / 3)
    assert second.ranges.sigma_m[0] == pytest.approx(np.sqrt(0.2 / 3))
    assert second.rate_mps[0] == pytest.approx(-10 / 3)
    assert second.ttc_s[0] == pytest.approx((19 + 2 / 3) / (10 / 3))


def test_equals_filterpy_and_does_not_know_the_ego_speed_unless_told():
    rng, paper = np.random.default_rng(7), PaperFilter()
    oracle = KalmanFilter(dim_x=1, dim_z=1, dim_u=1)
    oracle.F = oracle.H = np.eye(1)
    oracle.Q, oracle.R, oracle.B = 0.1 * np.eye(1), 0.1 * np.eye(1), -0.2 * np.eye(1)
    for step in range(20):
        z, speed_mps = 50 - step + rng.normal(), np.nan if step % 5 == 4 else 5.0
        result = paper.update(measured([3], [z]), 0.2 * step, ego_speed_mps=speed_mps)
        if step == 0:
            oracle.x, oracle.P = np.array([[z]]), 0.1 * np.eye(1)
        else:
            oracle.predict(u=np.array([[np.nan_to_num(speed_mps)]]))
            oracle.update(z)
        assert result.ranges.distance_m[0] == pytest.approx(oracle.x[0, 0])
        assert result.ranges.sigma_m[0] == pytest.approx(np.sqrt(oracle.P[0, 0]))


def test_tracks_come_go_and_are_forgotten_after_a_second():
    paper = PaperFilter()
    paper.update(measured([1, 2], [30.0, 40.0]), 0.0)
    assert paper.update(measured([2], [np.nan]), 0.5, ego_speed_mps=4.0).ranges.distance_m == pytest.approx([38.0])
    late = paper.update(measured([1, 2], [np.nan, 50.0]), 1.2)
    assert np.isnan(late.ranges.distance_m[0])
    assert np.isnan(late.ranges.sigma_m[0])
    assert late.ranges.distance_m[1] == 50.0
