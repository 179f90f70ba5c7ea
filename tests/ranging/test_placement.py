"""Placement: points and velocities with covariances, in the axes of the camera and of the vehicle."""

import math
from dataclasses import replace

import numpy as np
import pytest

from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.filtering.lateral_motion import LateralMotion
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.size_models.class_sizes import ClassSizes
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.world.placement import Placement, Placements, point_covariance
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.odometry.ego_motion import EgoMotion

RAYS = np.array([[0.2, 0.1, 1.0], [-0.3, 0.05, 1.0]])
DIRECTION = np.array([[0.002, 0.001], [0.003, 0.002]])
DISTANCE_M, SIGMA_M = np.array([20.0, 40.0]), np.array([0.5, 3.0])


def placed(placements=None, *, time_s=0.0, observed=(True, True), ego=None, rays=RAYS):
    n = len(rays)
    state = ConstantVelocity(*(np.full(n, value) for value in (1.0, -1.5, 0.04, 0.0, 0.25)))
    lateral = LateralMotion(state, np.ones(n), np.ones(n, np.bool_), np.zeros(n, np.bool_))
    ids = np.arange(n)
    return (placements or Placements()).update(
        ids,
        np.array(observed),
        time_s,
        rays=rays,
        direction_sigma=DIRECTION,
        filtered=Ranges(ids, DISTANCE_M, SIGMA_M),
        lateral=lateral,
        ego=ego or EgoMotion(),
    )


def test_covariances_are_those_of_sampled_rays_and_distances():
    rng, n = np.random.default_rng(3), 400_000
    rays = RAYS[0] + np.column_stack([rng.normal(0, DIRECTION[0], (n, 2)), np.zeros(n)])
    sampled = np.cov((rays * rng.normal(DISTANCE_M[0], SIGMA_M[0], (n, 1))).T)
    states = placed().in_camera(SIGMA_M, (np.zeros(2), np.ones(2)))
    np.testing.assert_allclose(states.covariance_m2[0], sampled, rtol=0.02, atol=2e-3)
    assert sampled[0, 2] > 0.04  # x is to the right, and grows with the distance


def test_covariances_of_measured_points_have_the_sigmas_of_their_axes():
    xyz_m, xy_sigma_m = RAYS * 30.0, np.array([[0.3, 0.2], [0.7, 0.3]])
    sigma_m = np.array([1.0, 2.0])
    covariance = point_covariance(xyz_m, xy_sigma_m, sigma_m)
    sigmas = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    np.testing.assert_allclose(sigmas, np.column_stack([xy_sigma_m, sigma_m]))
    assert (np.linalg.eigvalsh(covariance) > -1e-12).all()


def test_the_relative_velocity_contains_the_motion_of_the_camera():
    ego = EgoMotion(yaw_rad_s=0.1, right_mps=2.0)
    states = placed(ego=ego).in_camera(SIGMA_M, (np.array([-3.0, 1.0]), np.array([0.4, 0.4])))
    np.testing.assert_allclose(states.velocity_mps[:, 0], -1.5 - 2.0 - 0.1 * DISTANCE_M)
    np.testing.assert_allclose(states.velocity_mps[:, 2], [-3.0, 1.0])
    V = states.velocity_covariance_m2ps2
    np.testing.assert_allclose(V[:, 2, 2], 0.16)
    np.testing.assert_allclose(V[:, 0, 2] / V[:, 2, 2], RAYS[:, 0])
    assert (np.linalg.eigvalsh(V) > 0).all()


def test_vehicle_axes_are_turned_and_moved():
    """A camera 1.5 m ahead of the reference point, 0.5 m to the right, that looks to the left."""
    mounting = Mounting(yaw_deg=90.0, x_m=1.5, y_m=-0.5, z_m=1.2, sigma_deg=0.0)
    placement = placed(Placements(mounting))
    in_camera = placement.in_camera(SIGMA_M, (np.array([-3.0, 1.0]), np.ones(2)))
    in_vehicle = in_camera.turned(mounting)
    x, y, z = in_camera.position_m.T
    np.testing.assert_allclose(
        in_vehicle.position_m, np.column_stack([1.5 + x, z - 0.5, 1.2 - y]), atol=1e-12
    )
    np.testing.assert_allclose(placement.vehicle_m, in_vehicle.position_m)
    right, down, forward = in_camera.velocity_mps.T
    np.testing.assert_allclose(
        in_vehicle.velocity_mps, np.column_stack([right, forward, -down]), atol=1e-12
    )
    np.testing.assert_allclose(in_vehicle.covariance_m2[:, 1, 1], SIGMA_M**2)
    turned = in_camera.turned(replace(mounting, sigma_deg=math.degrees(0.01)))
    grown = np.diagonal(turned.covariance_m2 - in_vehicle.covariance_m2, axis1=1, axis2=2)
    distance2 = (in_camera.position_m**2).sum(axis=1)
    np.testing.assert_allclose(grown.sum(axis=1), 2 * 0.01**2 * distance2)


def test_without_a_mounting_the_vehicle_is_unknown_and_without_a_height_its_z():
    placement = placed()
    states = placement.in_camera(SIGMA_M, (np.zeros(2), np.ones(2)))
    assert np.isnan(placement.vehicle_m).all()
    assert np.isnan(states.turned(None).position_m).all()
    assert np.isnan(states.turned(None).covariance_m2).all()
    known = states.turned(Mounting(x_m=1.0))
    assert np.isfinite(known.position_m[:, :2]).all()
    assert np.isnan(known.position_m[:, 2]).all()


def test_ages_and_times_since_the_last_detection():
    placements = Placements()
    placed(placements, time_s=1.0)
    placed(placements, time_s=1.2, observed=(True, False))
    now = placed(placements, time_s=1.5, observed=(True, False))
    np.testing.assert_allclose(now.age_s, 0.5)
    np.testing.assert_allclose(now.unobserved_s, [0.0, 0.5])
    later = placed(placements, time_s=60.0)
    assert later.age_s.tolist() == [59.0] * 2  # tracks with the same number go on


def test_sizes_are_those_of_the_size_model():
    sizes = ClassSizes.of(load_curves())
    height_m, width_m, length_m = np.exp(sizes.log_hwl[2])  # cars
    assert 4.0 < length_m < 4.8
    assert 1.6 < width_m < 1.9
    assert 1.4 < height_m < 2.0
    assert (np.diagonal(sizes.covariance[2]) < 0.2**2).all()
    assert np.isnan(ClassSizes.of(object()).log_hwl).all()


@pytest.mark.parametrize("n", [0, 1])
def test_unknown_placements_have_their_shapes(n):
    nan = np.full(n, np.nan)
    states = Placement.unknown(n).in_camera(nan, (nan, nan))
    assert states.turned(Mounting()).covariance_m2.shape == (n, 3, 3)
