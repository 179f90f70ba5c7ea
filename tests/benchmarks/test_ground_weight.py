"""Test of the horizon that the benchmark `ground_weight` takes from poses."""

import numpy as np
import pytest

from benchmarks.accuracy.cameras.ground_weight import STEP_S, _road_views


@pytest.mark.parametrize("up_rad", [-0.03, 0.0, 0.02])
def test_horizon_of_a_tilted_camera(tmp_path, up_rad):
    """A camera that looks up by an angle sees the road's horizon below its axis by its tangent."""
    cos, sin = np.cos(up_rad), np.sin(up_rad)
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])
    places_m = np.outer(10.0 * STEP_S * np.arange(80), [0.0, 0.0, 1.0])
    rows = [np.column_stack([rotation, place_m]).ravel() for place_m in places_m]
    np.savetxt(tmp_path / "0000.txt", rows)
    views = list(_road_views(tmp_path / "0000.txt", np.random.default_rng(0)))
    assert len(views) == 80
    assert views[-1].horizon == pytest.approx(np.tan(up_rad), abs=0.003)
    assert 0 < views[-1].horizon_variance < 0.003**2
    assert views[0].horizon_variance > 0.02**2
