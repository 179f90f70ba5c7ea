import math

import numpy as np
import pytest

from track_range.detection.box_errors import UNKNOWN_DETECTOR
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.size_regression import SizeRanger
from track_range.ranging.size_models.drive_scale import DriveScale, ScaleEvidence
from track_range.ranging.size_models.size_model import SIZE_CLASSES
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

CAR, PERSON, TRUCK = (SIZE_CLASSES.index(name) for name in ("car", "person", "truck"))


def sizes(distance_m, ids, sigma=0.07, systematic=0.06):
    return Ranges(ids, distance_m, sigma * distance_m, systematic * distance_m)


def learnt(bias, by_size, class_id, reference, time_s, *, sigma, corrects_tracks=False):
    """The scale after one frame with one reference."""
    of_size = ScaleEvidence(class_id, by_size)
    return bias.after(
        [of_size, ScaleEvidence(class_id, None, reference, sigma, corrects_tracks=corrects_tracks)],
        time_s,
    )


def drive(n_tracks, factor, *, seed=0, n_frames=20, class_id=CAR, own_sigma=0.05, bias=None):
    """The estimator after `n_tracks` tracks that are `factor` times as far as their sizes say."""
    rng = np.random.default_rng(seed)
    bias = bias or DriveScale()
    ids = 100 * class_id + np.arange(n_tracks)
    own = np.exp(own_sigma * rng.normal(size=n_tracks))
    for k in range(n_frames):
        true_m = rng.uniform(10, 40, n_tracks)
        by_size = sizes(true_m / factor / own, ids)
        measured_m = true_m * np.exp(0.04 * rng.normal(size=n_tracks))
        reference = Ranges(ids, measured_m, 0.04 * measured_m)
        bias = learnt(bias, by_size, np.full(n_tracks, class_id), reference, 0.1 * k, sigma=0.015)
    return bias


@pytest.mark.parametrize("log_error", [-0.07, 0.0, 0.07])
def test_errors_of_an_unknown_detector_are_removed_by_evidence(log_error):
    """Boxes that are too low or too high by more than a sigma: covered at first, learnt after
    twelve cars."""
    camera = PinholeCamera(1000.0, 1000.0, 640.0, 360.0, 1280, 720)
    ranger, scale = SizeRanger(camera), DriveScale()
    rng = np.random.default_rng(1)
    n, image = 12, np.zeros((720, 1280, 3), np.uint8)
    height_m = 1.53 * np.exp(0.04 * rng.normal(size=n))
    lateral_m, factor = rng.uniform(-6, 6, n), np.exp(log_error)
    for k in range(30):
        true_m = np.linspace(12, 45, n) + 0.2 * k
        centre_px, bottom_px = 640 + 1000 * lateral_m / true_m, 360 + 1500 / true_m
        half_px, height_px = 500 * factor * 1.63 / true_m, 1000 * factor * height_m / true_m
        boxes = np.stack(
            [centre_px - half_px, bottom_px - height_px, centre_px + half_px, bottom_px], axis=1
        )
        ids = np.arange(1, n + 1)
        tracks = Tracks(ids, boxes, np.full(n, CAR), np.ones(n), np.ones(n, np.bool_))
        reference = ScaleEvidence(tracks.class_id, None, Ranges(ids, true_m, 0.02 * true_m), 0.01)
        measured = ranger.measure_at_scale(tracks, Frame(k, 0.1 * k, image, None), {}, scale)
        error, sigma = (
            np.log(measured.ranges.distance_m / true_m),
            measured.ranges.sigma_m / true_m,
        )
        if k == 0:
            first_error, first_sigma = np.median(error), np.median(sigma)
        scale = scale.after([measured.evidence, reference], 0.1 * k)
    assert abs(first_error) < 2 * first_sigma
    assert abs(np.median(error)) < 0.025
    assert np.median(sigma) < 0.9 * first_sigma
    assert np.mean(np.abs(error) < 2 * sigma) > 0.9
    # The prior of the bias covers the errors of an unknown detector.
    assert DriveScale().bias_of("car").sigma > UNKNOWN_DETECTOR["car"].log_height_sigma


def test_without_evidence_nothing_changes():
    bias, ids = DriveScale(), np.array([1, 2])
    by_size = sizes(np.array([10.0, np.nan]), ids)
    assert bias.corrected(by_size, np.array([CAR, CAR])) is by_size
    assert bias.bias_of("car").log_factor == 0.0
    assert bias.bias_of("car").sigma == pytest.approx(math.hypot(0.026, 0.065))


@pytest.mark.parametrize("factor", [0.92, 1.0, 1.1])
def test_bias_of_a_drive(factor):
    """Within 3 % after 15 tracks, and within its sigma, over several seeds."""
    errors = []
    for seed in range(8):
        bias = drive(15, factor, seed=seed).bias_of("car")
        errors.append((bias.log_factor - np.log(factor)) / bias.sigma)
        assert bias.log_factor == pytest.approx(np.log(factor), abs=0.04)
    assert 0.2 < np.sqrt(np.mean(np.square(errors))) < 1.7


def test_sigma_shrinks_with_tracks_but_not_below_the_references():
    sigmas = [drive(n, 1.1).bias_of("car").sigma for n in (1, 4, 16, 64)]
    assert (np.diff(sigmas) < 0).all()
    assert sigmas[-1] > 0.015


def test_other_classes_share_a_part():
    bias = drive(30, 1.1)
    person, car = bias.bias_of("person"), bias.bias_of("car")
    assert 0 < person.log_factor < 0.5 * car.log_factor
    assert car.sigma < person.sigma


def test_classes_have_separate_biases():
    bias = drive(30, 1.1)
    bias = drive(30, 1.0, class_id=PERSON, bias=bias)
    assert bias.bias_of("car").log_factor == pytest.approx(np.log(1.1), abs=0.04)
    assert bias.bias_of("person").log_factor == pytest.approx(0.0, abs=0.03)


def test_corrected_ranges_have_less_sigma():
    bias, ids = drive(30, 1.1), np.array([7])
    before = sizes(np.array([20.0]), ids)
    after = bias.corrected(before, np.array([CAR]))
    assert after.distance_m == pytest.approx([22.0], rel=0.03)
    assert after.sigma_m[0] / after.distance_m[0] < before.sigma_m[0] / before.distance_m[0]
    assert after.sigma_systematic_m[0] < after.sigma_m[0]


def test_mistakes_are_no_evidence():
    bias, ids = DriveScale(), np.array([1, 2])
    by_size = sizes(np.array([10.0, 10.0]), ids)
    for time_s in (0.1, 0.2):
        reference = Ranges(ids, np.array([30.0, np.nan]), np.array([1.0, np.nan]))
        bias = learnt(bias, by_size, np.array([CAR, CAR]), reference, time_s, sigma=0.01)
    assert bias.n_tracks == 0


def test_outlying_track_has_little_weight():
    bias = drive(12, 1.0)
    before = bias.bias_of("car").log_factor
    ids = np.array([999])
    for k in range(10):  # a van that was detected as a car
        reference = Ranges(ids, np.array([28.0]), np.array([0.8]))
        bias = learnt(
            bias,
            sizes(np.array([20.0]), ids),
            np.array([CAR]),
            reference,
            2.0 + 0.1 * k,
            sigma=0.015,
        )
    assert bias.bias_of("car").log_factor - before < 0.01


def test_many_tracks_are_forgotten():
    bias, ids = DriveScale(), np.arange(100)
    for k in range(8):
        by_size, reference = (
            sizes(np.full(100, 20.0), ids + 100 * k),
            Ranges(ids, np.full(100, 20.0), np.ones(100)),
        )
        bias = learnt(bias, by_size, np.full(100, CAR), reference, 0.1 * (k + 1), sigma=0.015)
    assert bias.n_tracks == 400


def test_summary_names_classes_with_evidence():
    summary = drive(10, 1.1).summary()
    assert set(summary) == {"car"}
    assert summary["car"]["n_tracks"] == 10
    assert summary["car"]["bias_pct"] == pytest.approx(-9.0, abs=3.0)


def test_own_references_correct_their_track():
    """A van that was detected as a car: 25 % farther than its size says."""
    bias, ids, classes = DriveScale(), np.array([1, 2]), np.array([CAR, CAR])
    for k in range(1, 12):
        by_size = sizes(np.array([16.0, 20.0]), ids)
        reference = Ranges(ids, np.array([20.0, np.nan]), np.array([0.4, np.nan]))
        bias = learnt(bias, by_size, classes, reference, 0.1 * k, sigma=0.02, corrects_tracks=True)
    after = bias.corrected(by_size, classes)
    assert after.distance_m[0] == pytest.approx(20.0, rel=0.05)
    assert after.distance_m[1] < 22.8  # the other track has only the drive's part of the 25 %
    relative = after.sigma_m / after.distance_m
    assert relative[0] < 0.7 * relative[1]
    expected = bias.expected(by_size, classes)
    assert expected.distance_m[0] == pytest.approx(20.0, rel=0.1)


def test_expected_distances_without_evidence_are_those_by_size():
    by_size = sizes(np.array([16.0]), np.array([1]))
    assert DriveScale().expected(by_size, np.array([CAR])).distance_m == pytest.approx([16.0])


def test_a_horizon_that_is_wrong_is_no_scale():
    """References of the ground whose horizon is wrong by one sigma: 1 % too far at 5 m, 8 % at
    40 m, while all sizes are 5 % too small. As independent errors, they would be another scale."""
    distance_m = np.array([5.0, 8.0, 12.0, 18.0, 25.0, 32.0, 40.0])
    ids, class_id = np.arange(len(distance_m)), np.full(len(distance_m), CAR)
    of_horizon = 0.002 * distance_m
    reference_m = distance_m * (1 + of_horizon)
    reference = Ranges(ids, reference_m, np.hypot(0.01, of_horizon) * reference_m)
    by_size = sizes(0.95 * distance_m, ids, sigma=0.03, systematic=0.025)
    learnt_scales = []
    for common_sigma in (None, of_horizon):
        scale = DriveScale()
        for k in range(1, 20):
            of_ground = ScaleEvidence(class_id, None, reference, 0.01, common_sigma)
            scale = scale.after([ScaleEvidence(class_id, by_size), of_ground], 0.1 * k)
        learnt_scales.append(scale.bias_of("car"))
    independent, common = learnt_scales
    assert common.log_factor == pytest.approx(-np.log(0.95), abs=0.015)
    assert independent.log_factor > common.log_factor + 0.005
    assert common.sigma > independent.sigma


def test_a_scale_is_a_value():
    """Evidence makes a new scale; the one before gives what it gave before."""
    before = drive(10, 1.1)
    by_size, classes = sizes(np.array([20.0]), np.array([100 * CAR])), np.array([CAR])
    corrected, tracks = before.corrected(by_size, classes), before.n_tracks
    reference = Ranges(by_size.track_id, np.array([30.0]), np.array([0.1]))
    after = learnt(before, by_size, classes, reference, 9.0, sigma=0.01, corrects_tracks=True)
    assert before.n_tracks == tracks
    assert before.corrected(by_size, classes).distance_m == corrected.distance_m
    assert after.corrected(by_size, classes).distance_m > corrected.distance_m
