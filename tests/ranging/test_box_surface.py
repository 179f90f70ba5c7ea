import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.ranging.truth.reference_distance import surface_distance_m

SIZE = np.array([[1.5, 1.6, 4.0]])  # height, width, length


def surface(ray, location, yaw, size=SIZE):
    return surface_distance_m(
        np.array([ray]), np.array([location]), size_hwl_m=size, rotation_y_rad=np.array([yaw])
    )[0]


def test_car_straight_ahead_by_hand():
    # length along the ray
    assert surface([0, 0, 1.0], [0, 0.75, 20.0], -np.pi / 2) == pytest.approx(18.0)
    assert surface([0, 0, 1.0], [0, 0.75, 20.0], 0.0) == pytest.approx(19.2)  # width along the ray
    assert np.isnan(surface([0.3, 0, 1.0], [0, 0.75, 20.0], 0.0))  # the ray misses the car
    assert np.isnan(surface([0, 0, 1.0], [0, 0.75, -20.0], 0.0))  # behind the camera
    assert np.isnan(surface([0, 0, 1.0], [0, 0.75, 0.0], 0.0))  # the camera is inside


@settings(deadline=None)
@given(st.floats(-np.pi, np.pi), st.floats(-10, 10), st.floats(8, 80), st.integers(0, 1000))
def test_equals_ray_marching(yaw, x, z, seed):
    location = np.array([x, 1.6, z])
    aim = location - [0, 0.75, 0] + np.random.default_rng(seed).uniform(-0.6, 0.6, 3)
    ray = aim / aim[2]
    depths = np.linspace(0.1, 100, 20001)
    offset = ray * depths[:, None] - location
    along = np.cos(yaw) * offset[:, 0] - np.sin(yaw) * offset[:, 2]
    across = np.sin(yaw) * offset[:, 0] + np.cos(yaw) * offset[:, 2]
    inside = (
        (abs(along) <= 2.0) & (abs(across) <= 0.8) & (offset[:, 1] <= 0) & (offset[:, 1] >= -1.5)
    )
    measured = surface(ray, location, yaw)
    if inside.sum() > 4:  # the step is 5 mm, so shorter intersections at corners are not resolved
        assert measured == pytest.approx(depths[inside][0], abs=0.01)
