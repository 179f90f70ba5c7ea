"""Models of the motion of objects: static, calm and agile ones, with made-up distances."""

import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.ranging.filtering.cut_boxes import CutBoxes
from track_range.ranging.filtering.distance_filter import DistanceFilters
from track_range.ranging.filtering.motion_models import InteractingModels, mean_of
from track_range.ranging.filtering.observation import Observation
from track_range.ranging.measurement.ranges import Ranges
from track_range.stereo.odometry.ego_motion import EgoMotion

CAR, PERSON, STEP_S, EGO_MPS = ROAD_CLASSES.index("car"), ROAD_CLASSES.index("person"), 0.1, 10.0
STRAIGHT = EgoMotion(EGO_MPS)


def filtered(
    own_mps,
    *,
    size_error=0.0,
    size_sigma=0.08,
    noise=0.02,
    steps=25,
    seed=1,
    filters=None,
    ego=STRAIGHT,
    **observed,
):
    """Filtered ranges of objects with these own speeds, 50 m away at the end; sizes are known to
    `size_sigma`."""
    own_mps, rng = np.asarray(own_mps, float), np.random.default_rng(seed)
    ids = rng.integers(1, 10**9, len(own_mps))
    filters = filters or DistanceFilters({"a": 0.6})
    start_s = rng.uniform(0, 1e6)
    for k in range(steps):
        true_m = 50 + (own_mps - EGO_MPS) * STEP_S * (k + 1 - steps)
        z = true_m * (1 + size_error) * np.exp(noise * rng.normal(size=len(ids)))
        measured = Ranges(ids, z, np.hypot(noise, size_sigma) * z, size_sigma * z)
        observation = Observation(**{"class_id": np.full(len(ids), CAR), **observed})
        result = filters.update(
            {"a": measured}, start_s + k * STEP_S, observation=observation, ego=ego
        )["a"]
    return result


def test_closing_speed_of_a_static_object_is_that_of_the_ego_vehicle():
    """A parked car that is 8 % larger than assumed: its rate is 8 % too large, but not its closing
    speed."""
    static = filtered([0.0] * 20, size_error=0.08)
    assert -static.rate_mps == pytest.approx(np.full(20, EGO_MPS), abs=0.35)
    assert np.median(np.abs(static.rate_mps + EGO_MPS)) < 0.12
    assert 0.15 < np.median(static.rate_sigma_mps) < 0.5
    assert static.ttc_s == pytest.approx(np.full(20, 50.0 / EGO_MPS), rel=0.12)
    unknown = filtered([0.0] * 20, size_error=0.08, ego=EgoMotion())
    assert 0.4 < np.median(-unknown.rate_mps) - EGO_MPS < 1.2
    assert (unknown.rate_sigma_mps > 0.8).all()


def test_moving_objects_are_not_static():
    moving = filtered([6.0, 14.0, -8.0, 5.0])
    assert -moving.rate_mps == pytest.approx([4.0, -4.0, 18.0, 5.0], abs=1.8)
    assert (moving.rate_sigma_mps > 0.3).all()


def test_objects_that_move_across_are_not_static():
    across = filtered([0.0] * 5, size_error=0.08, may_be_static=np.zeros(5, np.bool_))
    assert (across.rate_sigma_mps > 0.8).all()
    assert 0.3 < np.median(-across.rate_mps) - EGO_MPS < 1.2


def in_a_turn(*, size_sigma):
    """Places at 50 m at which static objects come nearer with 12 and 7 m/s, since the camera turns
    by 0.2 rad/s, and their filtered ranges."""
    speeds, no, none = np.array([12.0, 7.0]), np.zeros(2, np.bool_), np.zeros(2)
    bearing = (EGO_MPS - speeds) / (0.2 * 50.0)
    cut = CutBoxes(is_cut=no, q=none, q_sigma=none, length_m=none + 4.0, bearing=bearing)
    ego = EgoMotion(EGO_MPS, yaw_rad_s=0.2)
    return speeds, filtered(
        EGO_MPS - speeds, ego=ego, cut=cut, steps=8, noise=0.005, size_sigma=size_sigma
    )


@pytest.mark.parametrize("size_sigma", [0.0, 0.08])
def test_static_objects_in_a_turn(size_sigma):
    speeds, result = in_a_turn(size_sigma=size_sigma)
    assert -result.rate_mps == pytest.approx(speeds, abs=0.3)
    assert (result.static > 0.8).all()


def test_sigma_of_static_objects_in_a_turn():
    """Errors of sizes change in turns, by 2 * 0.08^2 * 0.2 of d^2 per second: over the 0.7 s of the
    frames, this looks like a speed with the standard deviation 0.0506 d sqrt(1 / 0.7 s), 3.3 and
    3.2 m/s at mean distances of 54.2 and 52.5 m. The object has this speed if it is not static;
    without errors of sizes, sigma is small."""
    _, exact = in_a_turn(size_sigma=0.0)
    assert (exact.rate_sigma_mps < 0.6).all()
    _, result = in_a_turn(size_sigma=0.08)
    expected_mps = np.sqrt(1 - result.static) * np.array([3.28, 3.17])
    assert result.rate_sigma_mps == pytest.approx(expected_mps, rel=0.1)


def test_sigma_is_true_for_parked_and_moving_objects():
    """Half of the objects are parked, with errors of their sizes of 8 %."""
    rng = np.random.default_rng(3)
    in_sigmas = []
    for seed in range(4):
        own = np.where(rng.random(60) < 0.5, 0.0, rng.normal(6, 5, 60))
        result = filtered(own, size_error=rng.normal(0, 0.06, 60), noise=0.03, steps=20, seed=seed)
        in_sigmas.append((-result.rate_mps - (EGO_MPS - own)) / result.rate_sigma_mps)
    in_sigmas = np.abs(np.concatenate(in_sigmas))
    in_sigmas = in_sigmas[np.isfinite(in_sigmas)]
    assert len(in_sigmas) > 120
    assert 0.6 < np.mean(in_sigmas < 1) < 0.93
    assert 0.92 < np.mean(in_sigmas < 2) < 0.999


def test_a_class_learns_how_it_moves():
    """After 30 s, against a prior of 10 s, the probability that a member of a class is static
    follows what was seen."""
    models = InteractingModels()
    cars, people = np.array([CAR]), np.array([PERSON])
    before = models.prior(cars, True)[0, :, 0]
    assert before == pytest.approx([0.7, 0.15, 0.15])
    assert models.prior(people, True)[0, 0, 0] == pytest.approx(0.2)
    models.count(cars, np.array([[[0.0], [0.0], [1.0]]]), np.full((1, 3, 1), 30.0))
    assert models.prior(cars, True)[0, :, 0] == pytest.approx([7 / 40, 1.5 / 40, 31.5 / 40])
    assert models.prior(people, True)[0, 0, 0] == pytest.approx(0.2)
    assert models.prior(cars, False)[0, :, 0] == pytest.approx([0.0, 1.5 / 33, 31.5 / 33])


def test_probabilities_follow_the_likelihoods():
    """By Bayes' rule; innovations that are not valid change nothing."""
    models = InteractingModels()
    weight, nu, S = (
        np.array(values)[None, :, None]
        for values in ([0.5, 0.3, 0.2], [2.0, 1.0, 0.5], [1.0, 1.0, 4.0])
    )
    expected = [
        0.5 * np.exp(-2.0),
        0.3 * np.exp(-0.5),
        0.2 * np.exp(-0.5 * 0.0625) / 2.0,
    ]
    updated = models.update_probabilities(weight, nu, S, valid=np.array([[[True]]]))
    assert updated[0, :, 0] == pytest.approx(np.array(expected) / np.sum(expected))
    assert models.update_probabilities(weight, nu, S, valid=np.array([[[False]]])) == pytest.approx(
        weight
    )


def test_probabilities_return_to_the_prior():
    models = InteractingModels()
    prior, weight = models.prior(np.array([CAR]), True), np.array([0.0, 1.0, 0.0])[None, :, None]
    soon = models.interact(weight, prior, np.array([4.0]))[0, :, 0]
    assert soon.sum() == pytest.approx(1.0)
    assert 0.02 < soon[0] < 0.04  # 4 of 100 s
    assert soon[2] == pytest.approx(0.5 * (1 - np.exp(-1.0)), abs=0.02)
    late = models.interact(weight, prior, np.array([1e4]))[0, :, 0]
    assert late == pytest.approx(prior[0, :, 0], abs=1e-6)


def test_mean_of_a_mixture():
    x, weight = (np.array(values)[None, :, None] for values in ([-1.0, 3.0], [0.25, 0.75]))
    assert mean_of(x, weight) == pytest.approx(np.array([[2.0]]))


def test_rates_of_long_vehicles_are_less_certain():
    """The sides of a truck that are seen change, so that its distance says less about its speed."""
    moving = {"may_be_static": np.zeros(8, np.bool_), "noise": 0.005}
    car = filtered([6.0] * 8, **moving)
    truck = filtered([6.0] * 8, class_id=np.full(8, ROAD_CLASSES.index("truck")), **moving)
    ratio = np.median(truck.rate_sigma_mps / car.rate_sigma_mps)
    assert 1.1 < ratio < 3.0


def test_errors_of_sizes_change_on_the_way():
    """An error of the size that changes with the distance looks like a speed, which a known size
    cannot."""
    moving = {"may_be_static": np.zeros(8, np.bool_), "noise": 0.005}
    known, unknown = (
        filtered([-4.0] * 8, size_sigma=sigma, **moving).state.P_vv for sigma in (1e-6, 0.08)
    )
    assert 2 < np.median(unknown / known) < 20


@pytest.mark.parametrize("own_mps", [3.0, 6.0])
def test_nothing_changes_to_a_static_model_that_follows_a_moving_object(own_mps):
    result = filtered([own_mps] * 8, steps=120, noise=0.01)
    assert (result.static < 0.02).all()
    assert -result.rate_mps == pytest.approx(np.full(8, EGO_MPS - own_mps), abs=1.0)


def test_accelerations_by_class():
    """Of static models none; without an ego speed, that of the camera adds, but not to those."""
    models = InteractingModels()
    classes = np.array([CAR, PERSON])
    known = models.acceleration_sigma(classes, is_ego_known=True)
    assert known[0].tolist() == [0.0, 0.0]
    assert (known[1] < known[2]).all()
    assert (known[1:, 1] < known[1:, 0]).all()
    unknown = models.acceleration_sigma(classes, is_ego_known=False)
    assert unknown[0].tolist() == [0.0, 0.0]
    assert unknown[1:] == pytest.approx(np.hypot(known[1:], 0.5))
    only = InteractingModels(noises=np.full(8, 0.5), accelerations_mps2=np.zeros((1, 8)))
    assert not only.acceleration_sigma(classes, is_ego_known=False).any()
