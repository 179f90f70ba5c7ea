import numpy as np
import pytest

from track_range.ranging.evaluation.box_filters import PaperFilter
from track_range.ranging.measurement.ranges import Ranges


def measured(ids, distance_m):
    return Ranges(np.array(ids), np.array(distance_m, float), np.ones(len(ids)))


def test_by_hand():
    paper = PaperFilter()
    first = paper.update(measured([1], [20.0]), 0.0, ego_speed_mps=10.0)
    assert (first.ranges.distance_m[0], first.ranges.sigma_m[0]) == pytest.approx(
        (20.0, np.sqrt(0.1))
    )
    assert np.isnan(first.rate_mps[0])
    second = paper.update(measured([1], [20.0]), 0.1, ego_speed_mps=10.0)
    # Predicted 19 +- sqrt(0.2), gain 2/3.
    assert second.ranges.distance_m[0] == pytest.approx(19 + 2 / 3)
    assert second.ranges.sigma_m[0] == pytest.approx(np.sqrt(0.2 / 3))
    assert second.rate_mps[0] == pytest.approx(-10 / 3)
    assert second.ttc_s[0] == pytest.approx((19 + 2 / 3) / (10 / 3))


def test_equations_of_the_paper():
    """Against the scalar recursion; an unknown ego speed counts as 0."""
    rng, paper = np.random.default_rng(7), PaperFilter()
    d = P = np.nan
    for step in range(20):
        z, speed_mps = 50 - step + rng.normal(), np.nan if step % 5 == 4 else 5.0
        result = paper.update(measured([3], [z]), 0.2 * step, ego_speed_mps=speed_mps)
        if step == 0:
            d, P = z, 0.1
        else:
            d, P = d - np.nan_to_num(speed_mps) * 0.2, P + 0.1
            K = P / (P + 0.1)
            d, P = d + K * (z - d), (1 - K) * P
        assert result.ranges.distance_m[0] == pytest.approx(d)
        assert result.ranges.sigma_m[0] == pytest.approx(np.sqrt(P))


def test_tracks_have_separate_filters():
    both, alone = PaperFilter(), PaperFilter()
    for step in range(5):
        first = both.update(measured([1, 2], [30.0 - step, 80.0 + step]), 0.1 * step)
        second = alone.update(measured([2], [80.0 + step]), 0.1 * step)
    assert first.ranges.distance_m[1] == second.ranges.distance_m[0]
    assert first.ranges.distance_m[0] < 30.0


def test_tracks_restart_after_a_second():
    paper = PaperFilter()
    paper.update(measured([1, 2], [30.0, 40.0]), 0.0)
    assert paper.update(
        measured([2], [np.nan]), 0.5, ego_speed_mps=4.0
    ).ranges.distance_m == pytest.approx([38.0])
    late = paper.update(measured([1, 2], [np.nan, 50.0]), 1.2)
    assert np.isnan(late.ranges.distance_m[0])
    assert np.isnan(late.ranges.sigma_m[0])
    assert late.ranges.distance_m[1] == 50.0
