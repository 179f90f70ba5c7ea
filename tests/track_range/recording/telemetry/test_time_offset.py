import numpy as np
import pytest

from track_range.recording.telemetry.image_evidence import contradiction
from track_range.recording.telemetry.time_offset import MotionSeries, estimated_offset
from track_range.stereo.speed.ego_speed import EgoSpeed

T = np.arange(0.05, 30, 0.1)


def speed_mps(time_s):
    """Stop and go: 10 m/s, a stop from 8 to 12 s, and 12 m/s."""
    return np.interp(time_s, [0, 5, 8, 12, 15, 22, 25], [10, 10, 0, 0, 12, 12, 6])


def course_rad(time_s):
    return 1.2 / (1 + np.exp(-(time_s - 18) / 0.5))


def motion(*, seed=0, speed=speed_mps, has_turn=True):
    """Motion of images with noise and a typical depth that changes by 20 %."""
    rng = np.random.default_rng(seed)
    depth = np.exp(
        np.convolve(rng.normal(0, 0.2, len(T) + 40), np.ones(20) / np.sqrt(20), "same")[: len(T)]
    )
    expansion = speed(T) / (25 * depth) + rng.normal(0, 0.01, len(T))
    yaw = np.gradient(course_rad(T), T) if has_turn else np.zeros(len(T))
    return MotionSeries(
        time_s=T,
        yaw_rad_s=yaw + rng.normal(0, 0.005, len(T)),
        expansion_hz=expansion,
        is_still=speed(T) < 0.01,
    )


@pytest.mark.parametrize("late_s", [-1.5, 0.0, 0.4, 1.0])
@pytest.mark.parametrize("step_s", [1.0, 0.2])
@pytest.mark.parametrize("has_turn", [True, False])
def test_known_shift(late_s, step_s, has_turn):
    at_s = np.arange(-4.0, 34, step_s)
    speeds = np.round(speed_mps(at_s - late_s) * 3.6) / 3.6
    courses = course_rad(at_s - late_s) % (2 * np.pi) if has_turn else np.full(len(at_s), np.nan)
    offset = estimated_offset(motion(has_turn=has_turn), at_s, speeds, courses)
    assert offset.is_certain
    assert offset.offset_s == pytest.approx(late_s, abs=0.25)
    assert abs(offset.offset_s - late_s) < 3 * offset.sigma_s


def test_steady_drive_has_no_certain_offset():
    def steady(time_s):
        return np.full(len(time_s), 10.0)

    at_s = np.arange(0.0, 30)
    offset = estimated_offset(
        motion(speed=steady, has_turn=False), at_s, steady(at_s), np.zeros(30)
    )
    assert not offset.is_certain
    assert offset.sigma_s > 0.5


def test_too_short_for_an_offset():
    assert (
        estimated_offset(motion(), np.array([0.0, 1.0]), np.array([1.0, 2.0]), np.full(2, np.nan))
        is None
    )


def ego(speeds):
    return EgoSpeed(
        np.arange(0.0, 30), np.broadcast_to(np.asarray(speeds, float), (30,)).copy(), "test"
    )


def test_speed_of_a_camera_at_rest_is_a_contradiction():
    def parked(time_s):
        return np.zeros(len(time_s))

    images = motion(speed=parked, has_turn=False)
    assert "camera is at rest" in contradiction(images, ego(33.0))
    assert contradiction(images, ego(0.5)) is None


def test_standing_car_in_moving_images_is_a_contradiction():
    assert "car is at rest" in contradiction(motion(), ego(0.0))
    assert contradiction(motion(), ego(speed_mps(np.arange(0.0, 30)))) is None
