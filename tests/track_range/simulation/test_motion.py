"""Tests of distances and speeds, worked by hand and against numerical integration."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.simulation.world.motion import LaneChange, speed_at_mps, travelled_m


def test_distance_of_a_speed_ramp():
    changes = ((1.0, 10.0), (3.0, 20.0))
    # 1 s at 10 m/s, 2 s at 15 m/s on average, 1 s at 20 m/s
    assert travelled_m(changes, 4.0) == pytest.approx(10 + 30 + 20)
    assert travelled_m(changes, 2.0) == pytest.approx(10 + 12.5)
    assert travelled_m(changes, -2.0) == pytest.approx(-20)
    assert speed_at_mps(changes, 2.0) == pytest.approx(15.0)


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(-5, 25), st.floats(0, 40)),
        min_size=1,
        max_size=6,
        unique_by=lambda pair: pair[0],
    ),
    st.floats(-4, 20),
)
def test_distance_is_the_integral_of_the_speed(changes, until_s):
    changes = tuple(sorted(changes))
    times = np.linspace(0, until_s, 40_001)
    speeds = np.interp(times, *zip(*changes, strict=True))
    assert travelled_m(changes, until_s) == pytest.approx(
        float(np.trapezoid(speeds, times)), abs=0.02
    )


def test_lane_change():
    change = LaneChange(2.0, 4.0, -3.5)
    assert [change.moved_m(time_s) for time_s in (0.0, 2.0, 3.0, 4.0, 9.0)] == pytest.approx(
        [0, 0, -1.75, -3.5, -3.5]
    )
