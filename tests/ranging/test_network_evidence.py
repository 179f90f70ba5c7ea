"""A depth network in the posterior of the cameras: found, said and corrected, without circles."""

import math

import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.ranging.cameras.evidence import SeenFrame
from track_range.ranging.cameras.posterior import posterior
from track_range.ranging.cameras.scale_check import ScaleCheck
from track_range.ranging.cameras.unknowns import NetworkFactor, Prior, Unknown, camera_priors
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.size_models.network_scale import (
    NetworkDistances,
    NetworkErrors,
    NetworkScale,
)
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.ego_motion import Ego, EgoMotion
from track_range.tracking.tracks import Tracks

CAMERA = PinholeCamera(1000.0, 1000.0, 640.0, 360.0, 1280, 720)
CAR = ROAD_CLASSES.index("car")


def checked(networks, *, rig=None, n=12, seconds=3.0, seed=0):
    """The check after a drive with `n` cars, that networks measure by these functions; a given
    baseline is `rig` times the true one."""
    rng = np.random.default_rng(seed)
    baseline_m = None if rig is None else 0.5
    check = ScaleCheck(CAMERA, camera_priors(CAMERA.fx_px, baseline_m=baseline_m))
    true_m, ids = np.exp(rng.uniform(math.log(8), math.log(50), n)), np.arange(n)
    own, x_px = np.exp(rng.normal(0, 0.08, n)), rng.uniform(300, 1000, n)
    boxes = np.stack([x_px, 360 - 0 * x_px, x_px + 1800 / true_m, 360 + 1500 / true_m], axis=1)
    tracks = Tracks(ids, boxes, np.full(n, CAR), np.ones(n), np.ones(n, np.bool_))
    for k in range(round(10 * seconds)):
        size_m = true_m * own
        by_size = Ranges(ids, size_m, 0.12 * size_m, 0.1 * size_m)
        by_rig = None if rig is None else Ranges(ids, rig * true_m, 0.02 * rig * true_m)
        by_network = {}
        for name, network in networks.items():
            seen_m = network(true_m, rng)
            ranges = Ranges(ids, seen_m, 0.02 * seen_m)
            by_network[name] = NetworkDistances(ranges, NetworkErrors(), tracks.class_id)
        ego = Ego(motion=EgoMotion())
        check.update(SeenFrame(tracks, by_size, by_rig, ego, 0.1 * k, by_network=by_network))
    return check


def short(true_m, rng):
    return 0.7 * true_m


def constant(true_m, rng):
    return np.full(len(true_m), 20.0)


def test_prior_of_a_drive_is_that_of_the_scale_before_it():
    name = NetworkFactor("depth")
    prior = posterior({name: Prior(NetworkErrors().drive_sigma, "usual")}, [])
    sigma = prior.sigma_of({name: 1.0})
    assert sigma == pytest.approx(NetworkScale().sigma, abs=0.01)
    assert sigma == pytest.approx(NetworkErrors().drive_sigma_before, abs=0.01)


@pytest.mark.parametrize("rig", [None, 1.0])
def test_network_that_is_short_is_found_said_and_corrected(rig):
    check = checked({"depth": short}, rig=rig)
    scale = check.network_scales["depth"]
    assert abs(scale.log_factor - math.log(0.7)) < 2 * scale.sigma
    assert scale.sigma < (0.11 if rig is None else 0.07)
    ranges = scale.corrected(
        Ranges(np.zeros(1), np.array([14.0]), np.array([0.2])), np.array([CAR])
    )
    assert abs(ranges.distance_m[0] - 20.0) < 2 * ranges.sigma_m[0]
    (note,) = (note for note in check.notes if "depth network" in note)
    assert "corrected" in note
    section = check.summary()["depth_networks"]["depth"]
    assert section["reference"] == ("size" if rig is None else "rig")
    assert section["n_tracks"] == 12
    assert section["factor"] == pytest.approx(math.exp(scale.log_factor), abs=1e-3)


def test_networks_do_not_move_the_cameras():
    """One that is short neither changes nor confirms sizes, baseline or height."""
    for rig in (None, 1.0):
        with_one, without = (checked(networks, rig=rig) for networks in ({"depth": short}, {}))
        for unknown in (Unknown.SIZES, Unknown.HEIGHT, *([Unknown.BASELINE] if rig else [])):
            of = {unknown: 1.0}
            for value in ("correction", "sigma_of"):
                before, after = (getattr(c.cameras, value)(of) for c in (without, with_one))
                assert after == pytest.approx(before, abs=1e-12)
        assert "depth" not in with_one.agreement.evidence
        assert without.summary().keys() | {"depth_networks"} == with_one.summary().keys()


def test_wrong_rig_stays_in_doubt_beside_a_network_that_follows_it():
    check = checked({"depth": lambda true_m, rng: 0.4 * true_m}, rig=0.4)
    assert check.doubt is not None
    assert [str(cause) for cause in check.doubt.cause_names] == ["baseline"]


def test_several_networks_have_factors_of_their_own():
    def flickering(true_m, rng):
        return 1.2 * true_m * rng.uniform(0.7, 1.4)

    check = checked({"depth-a": short, "depth-b": flickering, "depth-c": constant})
    a, b, c = (check.network_scales[f"depth-{letter}"] for letter in "abc")
    assert a.log_factor == pytest.approx(math.log(0.7), abs=0.15)
    assert b.log_factor == pytest.approx(math.log(1.2), abs=0.2)
    assert b.noise_sigma == pytest.approx(0.2, rel=0.35)
    assert abs(c.slope.mean) < 0.15
    assert {"depth-a", "depth-b", "depth-c"} == check.summary()["depth_networks"].keys()
    codes = [note.code for note in check.notes if "depth network" in note]
    assert codes == ["depth-network-corrected"] * 2 + ["depth-network-says-little"]


def at(scale, network_m):
    """Corrected distance of a car, and its relative sigma."""
    raw = Ranges(np.zeros(1, np.int64), np.array([network_m]), np.array([0.02 * network_m]))
    ranges = scale.corrected(raw, np.array([CAR]))
    return float(ranges.distance_m[0]), float(ranges.sigma_m[0] / ranges.distance_m[0])


def test_networks_do_not_move_each_other():
    alone = checked({"depth-a": short}).network_scales["depth-a"]
    beside = checked({"depth-a": short, "depth-b": lambda true_m, rng: 1.4 * true_m})
    assert beside.network_scales["depth-a"].log_factor == pytest.approx(alone.log_factor, abs=1e-9)
    assert beside.network_scales["depth-a"].sigma == pytest.approx(alone.sigma, abs=1e-9)


@pytest.mark.parametrize("rig", [None, 1.0])
@pytest.mark.parametrize("seed", [0, 1])  # a car at 25 m, at 22 m
def test_one_road_user_that_contradicts_a_network_widens_sigma(rig, seed):
    """It may be short, or say 8.5 m of every car."""
    check = checked({"depth": lambda true_m, rng: 0 * true_m + 8.5}, rig=rig, n=1, seed=seed)
    scale = check.network_scales["depth"]
    assert scale.n_tracks == 1
    assert scale.slope.sigma > 0.2
    distance_m, sigma = at(scale, 8.5)
    for true_m in (12.0, 25.0, 50.0):
        assert math.isnan(sigma) or abs(math.log(distance_m / true_m)) < 2 * sigma


def test_one_road_user_tells_the_factor_of_a_network():
    for factor in (0.7, 1.0):
        check = checked({"depth": lambda true_m, rng, factor=factor: factor * true_m}, n=1)
        distance_m, sigma = at(check.network_scales["depth"], 25.0 * factor)
        assert abs(distance_m / 25.0 - 1) < min(2 * sigma, 0.2)
        assert sigma < 0.55


def test_network_without_road_users_is_unchecked():
    check = checked({"depth": short}, n=0)
    scale = check.network_scales["depth"]
    assert scale.log_factor == 0.0
    assert scale.sigma > 0.25
    assert any("cannot be checked" in note for note in check.notes)
