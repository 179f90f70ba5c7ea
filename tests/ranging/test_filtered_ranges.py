import numpy as np
import pytest

from track_range.ranging.filtering.distance_filter import time_to_collision


def test_time_to_collision_by_hand():
    ttc_s, sigma_s = time_to_collision(
        np.array([30.0, 30.0, 30.0, 30.0]),
        np.array([-10.0, -0.2, 5.0, np.nan]),
        variances=np.array([[9.0], [0.0], [1.0]]) * np.ones(4),
    )
    assert ttc_s == pytest.approx([3.0, np.nan, np.nan, np.nan], nan_ok=True)
    assert sigma_s == pytest.approx(
        [3 * np.sqrt(0.1**2 + 0.1**2), np.nan, np.nan, np.nan], nan_ok=True
    )
