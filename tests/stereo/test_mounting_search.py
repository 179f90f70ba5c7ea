"""MountingSearch in a street without end, by cameras that look in all directions."""

import math

import numpy as np
import pytest

from tests.stereo.streets import CAMERA, street
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.self_calibration.mounting_search import MIN_ASIDE_S, PAIR_S, MountingSearch

N_ASIDE = round(MIN_ASIDE_S / PAIR_S) + 1


def searched(mounting, n, *, speed_mps=8.0, yaw_rad_s=0.0):
    search, x_m, z_m = MountingSearch(CAMERA), 0.0, 0.0
    for k in range(n):
        heading_rad = yaw_rad_s * PAIR_S * k
        search.add(street(mounting, z_m, heading_rad, x_m), PAIR_S * k)
        x_m += speed_mps * PAIR_S * math.sin(heading_rad)
        z_m += speed_mps * PAIR_S * math.cos(heading_rad)
    return search


@pytest.mark.slow
@pytest.mark.parametrize("yaw_deg", [-58.0, 90.0, 120.0])
def test_cameras_that_look_aside_are_found(yaw_deg):
    search = searched(Mounting(yaw_deg=yaw_deg, pitch_deg=3.0), N_ASIDE)
    found = search.mounting
    assert found is not None
    assert found.yaw_deg == pytest.approx(yaw_deg, abs=2 * found.sigma_deg)
    assert 1.0 < found.sigma_deg < 3.0


@pytest.mark.slow
def test_a_camera_to_the_rear_is_found_with_its_pitch():
    search = searched(Mounting(yaw_deg=180.0, pitch_deg=3.0), N_ASIDE)
    found = search.mounting
    assert found is not None
    assert abs(found.yaw_deg) == pytest.approx(180.0, abs=2 * found.sigma_deg)
    assert found.pitch_deg == pytest.approx(3.0, abs=2 * found.sigma_deg)


@pytest.mark.parametrize("yaw_rad_s", [0.0, 0.15])
def test_cameras_that_look_ahead_are_not_aside(yaw_rad_s):
    search = searched(Mounting(yaw_deg=4.0, pitch_deg=3.0), 22, yaw_rad_s=yaw_rad_s)
    found = search.mounting
    assert found is not None
    assert found.yaw_deg == pytest.approx(4.0, abs=3.0)
    assert found.pitch_deg == pytest.approx(3.0, abs=2 * found.sigma_deg)
    assert found.is_ahead


def test_images_that_show_no_motion_claim_nothing():
    assert searched(Mounting(yaw_deg=-58.0), 22, speed_mps=0.0).mounting is None
    plain = MountingSearch(CAMERA)
    for k in range(22):
        plain.add(np.full((270, 480), 90, np.uint8), PAIR_S * k)
    assert plain.mounting is None


@pytest.mark.slow
def test_motion_shows_a_camera_aside_after_some_seconds():
    assert searched(Mounting(yaw_deg=-58.0), N_ASIDE - 4).mounting is None


@pytest.mark.slow
def test_a_lorry_before_a_camera_at_rest_does_not_turn_the_camera():
    """It fills three quarters of the view for 3 s; then the car drives on for 5 s."""
    search, mounting = MountingSearch(CAMERA), Mounting(pitch_deg=3.0)
    side = street(Mounting(yaw_deg=90.0), 0.0)
    for k in range(80):
        image = street(mounting, 8.0 * PAIR_S * max(k - 30, 0)).copy()
        if k < 30:
            image[:200, 60:420] = np.roll(side, 6 * k, axis=1)[:200, 60:420]
        search.add(image, PAIR_S * k)
        assert search.mounting is None or search.mounting.is_ahead
