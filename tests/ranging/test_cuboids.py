"""Cuboids in the axes of the camera, the vehicle and the map."""

import math

import numpy as np
import pytest

import track_range as tr
from track_range.ranging.world.cuboids import Cuboids
from track_range.ranging.world.ego_path import EgoPose


def cuboid(**parts):
    """A car 20 m ahead and 2 m to the right, whose front points to the left."""
    values = {
        "lwh_m": [4.5, 1.8, 1.5],
        "lwh_sigma_m": [0.3, 0.1, 0.1],
        "yaw_deg": 90.0,
        "yaw_sigma_deg": 5.0,
        "front_known": True,
        "centre_m": [2.0, 0.8, 20.0],
        "centre_sigma_m": [0.2, 0.1, 1.0],
        "centre_correlation": [0.1, 0.5, 0.2],
        "vehicle_m": [np.nan] * 3,
        "world_m": [np.nan] * 3,
    } | parts
    return Cuboids(**{name: np.array([value]) for name, value in values.items()})


def test_covariances_have_the_sigmas_and_correlations():
    (C,) = cuboid().covariance_m2
    np.testing.assert_allclose(np.sqrt(np.diag(C)), [0.2, 0.1, 1.0])
    assert C[0, 2] == C[2, 0] == pytest.approx(0.5 * 0.2 * 1.0)
    assert (np.linalg.eigvalsh(C) > 0).all()


def test_a_mounting_turns_and_moves_cuboids():
    mounting = tr.Mounting(yaw_deg=30.0, x_m=1.4, y_m=0.2, z_m=1.3, sigma_deg=0.0)
    places = cuboid().in_vehicle(mounting)
    c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
    expected = [1.4 + 20 * c + 2 * s, 0.2 + 20 * s - 2 * c, 1.3 - 0.8]
    np.testing.assert_allclose(places.centre_m, [expected])
    assert places.yaw_deg.item() == pytest.approx(120.0)
    wider = cuboid().in_vehicle(tr.Mounting(sigma_deg=2.0)).covariance_m2[0]
    assert wider[1, 1] == pytest.approx(0.2**2 + math.radians(2.0) ** 2 * (20**2 + 0.8**2))
    assert np.isnan(cuboid().in_vehicle(None).centre_m).all()


def test_the_pose_of_the_camera_places_cuboids_in_the_map():
    sigmas = np.diag([0.3, 0.4, 0.01])
    pose = EgoPose(100.0, 50.0, math.radians(90), sigmas**2)
    places = cuboid().in_world(pose, tr.Mounting(z_m=1.3, sigma_deg=0.0))
    np.testing.assert_allclose(places.centre_m, [[100 + 2.0, 50 + 20.0, 1.3 - 0.8]])
    assert places.yaw_deg.item() == pytest.approx(-180.0)
    C = places.covariance_m2[0]
    # the camera's axis is y: the error of the heading moves what is ahead along x
    assert C[0, 0] == pytest.approx(0.2**2 + 0.3**2 + (0.01 * 20) ** 2)
    assert np.isnan(cuboid().in_world(EgoPose()).centre_m[0, :2]).all()


@pytest.mark.parametrize("n", [0, 2])
def test_unknown_cuboids_have_their_shapes(n):
    unknown = Cuboids.unknown(n)
    assert unknown.covariance_m2.shape == (n, 3, 3)
    assert unknown.in_vehicle(None).centre_m.shape == (n, 3)
    assert not unknown.front_known.any()
