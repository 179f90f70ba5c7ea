"""Motion over ground: speeds, headings and states of made-up tracks, and of KITTI's labels with
known poses."""

import math

import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.filtering.distance_filter import FilteredRanges
from track_range.ranging.filtering.lateral_motion import LateralMotion
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import MOTION_STATES, ObjectMotions, over_ground
from track_range.stereo.odometry.ego_motion import EgoMotion

CAR, PERSON = ROAD_CLASSES.index("car"), ROAD_CLASSES.index("person")
EGO_MPS = 10.0


def motion_of(rate_mps, *, distance_m=20.0, sigma_m=0.5, rate_sigma_mps=0.3, static=None):
    """Filtered distances with these rates; objects within 0.5 m/s of the ego speed are static, if
    not given."""
    v = np.asarray(rate_mps, np.float64)
    full = np.full_like
    state = ConstantVelocity(
        full(v, distance_m), v, full(v, 0.05), full(v, 0.0), full(v, rate_sigma_mps**2)
    )
    ranges = Ranges(np.arange(len(v)), state.x, full(v, sigma_m))
    static = np.where(np.abs(v + EGO_MPS) < 0.5, 0.97, 0.0) if static is None else full(v, static)
    nan = full(v, np.nan)
    return FilteredRanges(
        ranges, v, full(v, rate_sigma_mps), nan, nan, state, np.zeros_like(v), static
    )


def lateral_of(right_mps, *, x_m=1.0, sigma_mps=0.2):
    u = np.asarray(right_mps, np.float64)
    state = ConstantVelocity(*(np.full_like(u, x) for x in (x_m, 0.0, 0.01, 0.0, sigma_mps**2)))
    moved = ConstantVelocity(state.x, u, state.P_xx, state.P_xv, state.P_vv)
    return LateralMotion(
        moved,
        np.full_like(u, 0.9),
        is_current=np.ones(u.shape, np.bool_),
        is_cut=np.zeros(u.shape, np.bool_),
    )


def ground_of(rate_mps, right_mps, class_id=CAR, ego_mps=EGO_MPS, **options):
    classes = np.full(len(rate_mps), class_id)
    motion = motion_of(rate_mps, **options)
    return over_ground(motion, lateral_of(right_mps), classes, EgoMotion(ego_mps, 0.05))


def test_speed_is_the_rate_plus_the_ego_speed():
    ground = ground_of([-2.0, -25.0, 0.0], [0.0, 0.0, 5.0])
    assert ground.speed_mps == pytest.approx([8.0, 15.0, math.hypot(10.0, 5.0)], rel=1e-3)
    assert np.abs(ground.heading_rad) == pytest.approx(
        [0.0, math.pi, math.atan2(5.0, 10.0)], abs=1e-9
    )
    assert ground.heading_rad[2] < 0  # to the right
    assert (ground.moving > 0.99).all()
    s = math.sqrt(0.5**2 - 0.05) / 20  # systematic, relative
    assert ground.sigma_mps[:2] == pytest.approx(
        [math.sqrt(0.09 + (s * v) ** 2 + 0.05**2) for v in (2.0, 25.0)], rel=0.02
    )


def test_rotation_of_the_camera_is_no_speed():
    """In a turn to the right with 0.2 rad/s, a parked car 10 m to the right comes nearer 2 m/s more
    slowly."""
    motion, lateral = motion_of([-8.0]), lateral_of([0.0], x_m=10.0)
    turning, straight = EgoMotion(EGO_MPS, 0.05, 0.2), EgoMotion(EGO_MPS, 0.05)
    assert over_ground(motion, lateral, np.array([CAR]), turning).speed_mps[0] < 0.1
    assert over_ground(motion, lateral, np.array([CAR]), straight).speed_mps[0] > 1.5


def test_an_object_at_rest_has_almost_no_speed():
    ground = ground_of([-10.01, -9.99], [0.05, -0.1])
    assert (ground.speed_mps < 0.15).all()
    assert (ground.moving < 0.2).all()
    assert np.isnan(ground.heading_rad).all()


def test_an_object_that_moved_and_has_no_speed_has_probably_stopped():
    """The variance of u is A = 0.4^2 + 0.05^2 + s^2 100 with s^2 = 0.2 / 400, 0.213; that of moving
    vehicles is 64 more: 0.1 sqrt(64.2 / 0.213) = 1.74 for stopped objects beside 1.
    """
    stopped = ground_of([-10.0], [0.0], rate_sigma_mps=0.4, static=[0.0])
    # across: N(0; 0.08 + 0.09) / N(0; 0.08) = 0.69 for 3/4 of them, and 0.04 for 1/4
    along = 0.75 * 0.686 + 0.25 * 0.035
    assert stopped.moving[0] == pytest.approx(along / (along + 1.74), abs=0.01)
    slow = ground_of([-8.0], [0.0], rate_sigma_mps=0.4, static=[0.0])
    assert slow.moving[0] > 0.99
    # what has stopped does not cross: a slow vehicle that turns still moves along
    turning = ground_of([-9.0], [1.0], rate_sigma_mps=0.4, static=[0.0])
    assert turning.along_mps[0] == pytest.approx(1.0, rel=0.01)


def test_a_walking_person_is_not_at_rest():
    walks, stands = ground_of([-10.0, -10.0], [1.3, 0.05], PERSON).moving
    assert walks > 0.9
    assert stands < 0.4


def test_unknown_ego_speed_and_uncertain_rates_have_no_speed():
    assert np.isnan(ground_of([-2.0], [0.0], ego_mps=math.nan).speed_mps).all()
    assert np.isnan(ground_of([-2.0], [3.0], rate_sigma_mps=4.0).speed_mps).all()


def states_of(rates_mps, rights_mps, *, step_s=0.1, motions=None):
    """State of one car in each frame, None = unknown."""
    motions, states = motions or ObjectMotions(), []
    for i, (rate, right) in enumerate(zip(rates_mps, rights_mps, strict=True)):
        found = motions.update(
            np.array([4]),
            np.array([CAR]),
            motion_of([rate]),
            lateral_of([right]),
            i * step_s,
            ego=EgoMotion(EGO_MPS, 0.05),
            pose=EgoPose(5.0, 0.0, math.pi / 2, np.zeros((3, 3))),
        )
        states.append(None if np.isnan(found.state[0]) else MOTION_STATES[int(found.state[0])])
    return states, found


@pytest.mark.parametrize(
    ("rate_mps", "right_mps", "state"),
    [
        (-10.0, 0.0, "parked"),
        (-2.0, 0.2, "moving"),
        (-20.0, 0.1, "oncoming"),
        (-9.5, -6.0, "crossing"),
    ],
)
def test_states(rate_mps, right_mps, state):
    states, _ = states_of([rate_mps] * 6, [right_mps] * 6)
    assert states == [None] * 3 + [state] * 3


def test_a_state_changes_only_after_a_while():
    """In the doubt between two states none is stated."""
    parked, moving = [-10.0] * 6, [-5.0] * 2
    states, _ = states_of([*parked, *moving, *parked], [0.0] * 14)
    assert states[3:] == [*["parked"] * 3, *[None] * 5, *["parked"] * 3]
    states, _ = states_of([*parked, *moving, *moving], [0.0] * 10)
    assert states[5:] == ["parked", None, None, None, "moving"]


def test_a_direction_between_two_states_is_not_stated():
    angle = np.radians(45.0)
    along, across = 8 * np.cos(angle) - EGO_MPS, 8 * np.sin(angle)
    assert set(states_of([along] * 6, [across] * 6)[0]) == {None}
    assert states_of([along] * 6, [4 * across] * 6)[0][-1] == "crossing"


@pytest.mark.parametrize("axis_rad", [0.0, -1.0])
def test_directions_are_the_fractions_of_the_velocities(axis_rad):
    """Against a sample of velocities of both axes of the camera."""
    mean, sigma = np.array([-1.0, 0.8]), np.array([1.5, 0.7])
    rates_mps = [mean[0] - EGO_MPS]
    motion = motion_of(rates_mps, sigma_m=0.0, rate_sigma_mps=sigma[0], static=[0.0])
    ego, car = EgoMotion(EGO_MPS, 1e-3), np.array([CAR])
    lateral = lateral_of([mean[1]], sigma_mps=sigma[1] / math.sqrt(2.0))
    found = over_ground(motion, lateral, car, ego, axis_rad).states[1:, 0]
    along, right = np.random.default_rng(0).normal(mean, sigma, (100_000, 2)).T
    # three quarters of the objects hardly move across the axis, as the likelihoods say
    B, m, M = sigma[1] ** 2, 0.3, 8.0
    weights = [
        share * math.exp(-(mean[1] ** 2) / 2 / (B + a**2)) / math.sqrt(B + a**2)
        for share, a in ((0.75, m), (0.25, M))
    ]
    expected = np.zeros(3)
    for weight, a in zip(weights, (m, M), strict=True):
        shrink = a**2 / (a**2 + B)
        across = shrink * mean[1] + math.sqrt(shrink) * (right - mean[1])
        forward = math.cos(axis_rad) * along + math.sin(axis_rad) * across
        left = math.sin(axis_rad) * along - math.cos(axis_rad) * across
        ahead, against = (forward > np.abs(left)).mean(), (forward < -np.abs(left)).mean()
        expected += weight * np.array([ahead, against, 1.0 - ahead - against])
    assert found / found.sum() == pytest.approx(expected / sum(weights), abs=0.02)


def test_probabilities_of_the_states_are_those_of_all_cases():
    ground = ground_of([-10.0, -2.0, -25.0, -9.5], [0.0, 0.2, 0.1, -6.0])
    assert ground.states.sum(axis=0) == pytest.approx(1.0)
    assert ground.states.argmax(axis=0).tolist() == [0, 1, 2, 3]
    assert ground.moving == pytest.approx(1.0 - ground.states[0])


def test_errors_of_size_and_of_the_ego_speed_make_no_car_oncoming():
    """At 20 m/s, a size that is 15 % wrong looks like 3 m/s against the drive."""
    motion = motion_of([-23.0], distance_m=30.0, sigma_m=30.0 * 0.15, static=[0.0])
    car, lateral = np.array([CAR]), lateral_of([0.0])
    exact = motion_of([-23.0], distance_m=30.0, sigma_m=0.3, static=[0.0])
    assert over_ground(exact, lateral, car, EgoMotion(20.0, 0.1)).states[2, 0] > 0.9
    assert over_ground(motion, lateral, car, EgoMotion(20.0, 0.1)).states[2, 0] < 0.8
    assert over_ground(exact, lateral, car, EgoMotion(20.0, 3.0)).states[2, 0] < 0.8


def test_a_predicted_ego_speed_changes_no_state():
    motions = ObjectMotions()
    found = []
    for i in range(60):
        predicted = i >= 10
        ego = EgoMotion(0.0 if predicted else EGO_MPS, 0.1, is_predicted=predicted)
        arguments = (np.array([4]), np.array([CAR]), motion_of([-2.0]), lateral_of([0.1]), 0.1 * i)
        found.append(motions.update(*arguments, ego=ego, pose=EgoPose()))
    assert {MOTION_STATES[int(one.state[0])] for one in found[5:]} == {"moving"}
    before, after = (one.state_probability[0] for one in (found[9], found[-1]))
    # the rest of the probability is forgotten over 20 s, 5 s of them here
    assert after == pytest.approx(0.25 + (before - 0.25) * math.exp(-5.0 / 20.0), abs=1e-3)


def test_world_positions_and_headings_turn_with_the_pose():
    _, found = states_of([-2.0] * 4, [0.0] * 4)  # the ego vehicle looks along y
    assert (found.world_x_m[0], found.world_y_m[0]) == pytest.approx((5.0 + 1.0, 20.0))
    assert found.heading_deg[0] == pytest.approx(90.0)


def test_states_of_a_camera_that_looks_aside_are_relative_to_the_drive():
    """A car that overtakes, seen by a camera that looks 90 degrees to the right, moves to its left."""
    for axis_rad, state in ((-math.pi / 2, "moving"), (math.pi / 2, "oncoming"), (0.0, "crossing")):
        states, _ = states_of([-EGO_MPS] * 6, [-12.0] * 6, motions=ObjectMotions(axis_rad))
        assert states[-1] == state


def test_size_error_of_an_object_at_rest_is_no_speed_across():
    """A camera at 10 m/s to its right sees a car at rest, which is read 5 % too near, move by 0.5 m/s."""
    motion, lateral = motion_of([0.0], sigma_m=1.0, static=[0.97]), lateral_of([0.5])
    ego = EgoMotion(0.0, 0.05, right_mps=10.0, right_sigma_mps=0.3)
    assert over_ground(motion, lateral, np.array([CAR]), ego).moving[0] < 0.1
    straight = EgoMotion(0.0, 0.05)
    without = over_ground(motion, lateral_of([0.5], sigma_mps=0.1), np.array([CAR]), straight)
    assert without.moving[0] > 0.3
