"""The direction of travel beside the principal point, by hand-worked angles at f = 700 px."""

import math

import pytest

from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.travel_direction import TravelDirection

CAMERA = PinholeCamera(700.0, 700.0, 620.0, 188.0, 1240, 376)


def notes_after(
    seconds: float, side_rad: float, yaw_rad_s: float = 0.0, *, has_mounting: bool = False
) -> tuple[str, ...]:
    direction = TravelDirection(CAMERA, has_mounting=has_mounting)
    for _ in range(round(10 * seconds)):
        direction.add(0.1, side_rad, yaw_rad_s)
    return direction.notes


def test_a_direction_to_the_left_is_noted_with_its_pixels():
    # 0.0886 rad = 5.08 degrees, 62 px at 700 px
    (note,) = notes_after(2.0, -0.0886)
    assert "5.1 degrees to the left" in note
    assert "principal point is 62 px too far to the right" in note


def test_a_mounting_is_named_as_the_cause():
    (note,) = notes_after(2.0, -0.0886, has_mounting=True)
    assert "5.1 degrees to the left of the direction of travel by its mounting" in note
    assert "turned further to the right" in note
    assert "px" not in note


@pytest.mark.parametrize(
    ("seconds", "side_rad", "yaw_rad_s"),
    [(1.0, 0.09, 0.0), (9.0, 0.04, 0.0), (9.0, 0.09, 0.1), (9.0, math.nan, 0.0)],
    ids=["short", "small", "turn", "unknown"],
)
def test_what_is_no_clear_direction_is_not_noted(seconds, side_rad, yaw_rad_s):
    assert notes_after(seconds, side_rad, yaw_rad_s) == ()


def test_the_direction_is_the_mean_over_time():
    direction = TravelDirection(CAMERA)
    direction.add(0.1, 0.0, 0.0)
    direction.add(0.3, 0.08, 0.0)
    assert direction.side_rad == pytest.approx(0.06)


def test_a_cut_to_another_camera_is_no_direction():
    """5 s ahead, then 2.5 s of a rear camera that looks 22 degrees aside: 7.5 in the mean."""
    direction = TravelDirection(CAMERA)
    for k in range(75):
        direction.add(0.1, 0.005 if k < 50 else 0.38, 0.0)
    assert direction.side_rad == pytest.approx(0.13)
    assert not direction.notes
