"""Doubt about baseline, focal length, speed and camera height, from drawn drives of road users of
known sizes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.lanes.lines import LaneLine, LaneLines
from track_range.ranging.cameras.causes import ScaleDoubt
from track_range.ranging.cameras.evidence import SeenFrame
from track_range.ranging.cameras.scale_check import ScaleCheck
from track_range.ranging.cameras.scale_evidence import SizeEvidence, speed_ratio_sigma
from track_range.ranging.cameras.unknowns import Unknown, camera_priors
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.measurement.rig_scale import CALIBRATED
from track_range.ranging.methods.ground_plane import GroundSettings
from track_range.ranging.methods.lane_width import LaneWidth
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.odometry.ego_motion import Ego, EgoMotion
from track_range.stereo.odometry.road_horizon import RoadView
from track_range.stereo.speed.given_speed import GivenSpeed
from track_range.tracking.tracks import Tracks

CAMERA = PinholeCamera(1000.0, 1000.0, 640.0, 360.0, 1280, 720)
OF_RIG = {Unknown.BASELINE: 1.0, Unknown.FOCAL: 1.0}
CAR = ROAD_CLASSES.index("car")
ROAD_HEIGHT_M = 1.5  # with which the motion of the road is measured


def check_of(
    rig=1.0,
    *,
    seed=0,
    n=4,
    sizes=None,
    true_height_m=1.5,
    seconds=5.0,
    has_road=True,
    true_mps=math.nan,
    speed=None,
    focal=1.0,
    lane_m=None,
    is_steady=True,
    height_m=None,
    lane=None,
    baseline_sigma=0.0,
):
    """The check after a drive with `n` cars; baseline, speed and focal length are wrong by `rig`,
    `speed` and `focal`.

    All distances by size are `sizes` times as long as they should be; None = drawn.
    """
    rng = np.random.default_rng(seed)
    priors = camera_priors(
        CAMERA.fx_px,
        baseline_m=None if rig is None else 0.5,
        baseline_sigma=baseline_sigma,
        height_m=height_m,
    )
    check = ScaleCheck(CAMERA, priors, lane=lane, road_height_m=ROAD_HEIGHT_M)
    true_m, own = rng.uniform(10, 40, n), np.exp(rng.normal(0, 0.08, n))
    common = math.exp(rng.normal(0, 0.05)) if sizes is None else sizes
    x_px = rng.uniform(300, 1000, n)
    lanes = LaneLines()
    if lane_m is not None:
        slopes = (-lane_m / 2 / true_height_m, lane_m / 2 / true_height_m)
        lines = [
            LaneLine(np.array([640 - slope * 360, slope, 0.0]), np.eye(3), 400.0, 700.0)
            for slope in slopes
        ]
        lanes = LaneLines(*lines)
    given_speed = GivenSpeed()
    for k in range(round(10 * seconds)):
        bottom = 360 + 1000 * (true_height_m / true_m + rng.normal(0, 0.002))
        boxes = np.stack(
            [x_px - 600 / true_m, bottom - 1500 / true_m, x_px + 600 / true_m, bottom], axis=1
        )
        ids = np.arange(1, n + 1)
        tracks = Tracks(ids, boxes, np.full(n, CAR), np.ones(n), np.ones(n, np.bool_))
        # angles below the horizon do not change with the focal length here: the height by size is
        # divided by it
        by_size = true_m * common * own * np.exp(rng.normal(0, 0.03, n))
        stereo = None
        if rig is not None:
            distance_m = true_m * rig * np.exp(rng.normal(0, 0.01, n))
            stereo = Ranges(ids, distance_m, 0.02 * distance_m)
        has_speed = math.isfinite(true_mps)
        by_pair = None
        if rig is not None and has_speed:
            by_pair = EgoMotion(
                true_mps * rig * focal * (1.0 if is_steady else rng.uniform(0.3, 1.0)), 0.2
            )
        by_road = EgoMotion(
            true_mps * focal * ROAD_HEIGHT_M / true_height_m * math.exp(rng.normal(0, 0.02)), 0.2
        )
        by_road = by_road if has_speed and has_road else None
        given = None if speed is None else EgoMotion(true_mps * speed, 0.2)
        if given is not None:
            given_speed.update(0.1 * k, given, by_pair or by_road or EgoMotion(), (0.0, 1.0))
        ego = Ego(
            motion=EgoMotion(),
            road=RoadView(horizon=0.0, horizon_variance=1e-6) if has_road else None,
            by_pair=by_pair,
            by_road=by_road,
            given=given,
            speed_ratio=given_speed.shown_ratio,
        )
        sizes_m = Ranges(ids, by_size, 0.1 * by_size)
        check.update(SeenFrame(tracks, sizes_m, stereo, ego, 0.1 * k, lanes))
    return check


def causes(doubt):
    return [cause for cause, _ in doubt.causes]


@pytest.mark.parametrize("factor", [0.1, 0.39, 0.5, 0.6, 1.7, 2.0, 2.54, 10.0])
def test_wrong_baselines_are_found(factor):
    for seed in range(5):
        doubt = check_of(factor, seed=seed).doubt
        assert doubt is not None
        assert causes(doubt) == ["baseline"]
        assert abs(math.log(doubt.factor / factor)) < 3 * doubt.sigma
        assert doubt.sigma < 0.15


@pytest.mark.parametrize("sizes", [0.9, 1.0, 1.12])
def test_right_scales_are_not_doubted(sizes):
    """Cars of other countries, and a camera in a lorry, in a low car or on a robot."""
    for height_m in (0.4, 1.1, 1.5, 2.6):
        for seed in range(3):
            assert (
                check_of(1.0, seed=seed, sizes=sizes, true_height_m=height_m, true_mps=12.0).doubt
                is None
            )
            assert (
                check_of(
                    None, seed=seed, sizes=sizes, true_height_m=height_m, true_mps=12.0, speed=1
                ).doubt
                is None
            )


def test_few_of_many_right_rigs_are_doubted():
    doubts = [
        check_of(1.0, seed=seed, n=6, seconds=2.0, true_mps=12.0).doubt for seed in range(100)
    ]
    assert sum(doubt is not None for doubt in doubts) <= 1


@pytest.mark.parametrize("factor", [0.83, 1.2])
def test_a_given_height_and_a_given_speed_find_small_errors(factor):
    for seed in range(5):
        without = check_of(factor, seed=seed, sizes=1.0, true_mps=12.0)
        by_height = check_of(factor, seed=seed, true_mps=12.0, height_m=1.5)
        by_speed = check_of(factor, seed=seed, true_mps=12.0, speed=1.0)
        assert without.doubt is None
        assert without.agreement.sigma > 0.07
        for check in (by_height, by_speed):
            assert check.agreement.sigma < 0.06
            assert "baseline" in causes(check.doubt)
            assert dict(check.doubt.causes)["baseline"] == pytest.approx(factor, rel=0.12)


@pytest.mark.parametrize(
    ("factor", "text"), [(3.6, "km/h read as m/s"), (1 / 1.609, "miles per hour read as km/h")]
)
def test_speeds_in_another_unit_are_told_from_wrong_rigs(factor, text):
    for rig in (1.0, None):
        doubt = check_of(rig, true_mps=12.0, speed=factor).doubt
        assert causes(doubt)[0] == "speed"
        assert rig is None or causes(doubt) == ["speed"]
        assert doubt.factor == pytest.approx(factor, rel=0.15)
        assert text in doubt.sentence(None)


def test_no_camera_is_higher_than_vehicles():
    """Without a second road user, a speed in km/h would show a height of 5.4 m; lorries have cameras
    at 3 m, and a height that is given is believed."""
    alone = {"n": 1, "true_mps": 12.0}
    doubt = check_of(None, speed=3.6, **alone).doubt
    assert causes(doubt)[0] == "speed"
    assert doubt.factor == pytest.approx(3.6, rel=0.1)
    assert check_of(None, speed=1.0, true_height_m=3.0, **alone).doubt is None
    assert check_of(None, speed=1.0, true_height_m=6.0, height_m=6.0, **alone).doubt is None


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_matrices_of_another_image_size_are_found_by_a_given_speed(factor):
    """The speed over the motion of the road gives a height that road users do not confirm."""
    doubt = check_of(None, true_mps=12.0, speed=1.0, focal=factor).doubt
    assert "focal length" in causes(doubt)
    assert dict(doubt.causes)["focal length"] == pytest.approx(factor, rel=0.25)


def test_a_wrong_height_is_not_a_wrong_rig():
    doubt = check_of(1.0, n=6, true_mps=12.0, speed=1.0, true_height_m=1.5, height_m=2.2).doubt
    assert causes(doubt) == ["camera height"]
    assert doubt.factor == pytest.approx(2.2 / 1.5, rel=0.08)


def test_speeds_of_no_car():
    """160 m/s: even without a second road user's size, no rig can be right."""
    doubt = check_of(1.0, n=1, true_mps=160.0, has_road=False).doubt
    assert doubt.factor > 2.0
    assert "baseline" in causes(doubt)
    assert check_of(1.0, n=2, true_mps=40.0, has_road=False).doubt is None
    # unrelated images
    assert check_of(1.0, n=1, true_mps=160.0, is_steady=False, has_road=False).doubt is None


def test_a_doubt_that_ends_is_remembered():
    """A rig 2.5 times too long for the first road users; later ones show that these were wrong."""
    check = check_of(2.5, n=2, seconds=2.0)
    assert check.doubt is not None
    rng = np.random.default_rng(1)
    ids = np.arange(10, 40)
    for k in range(20, 40):
        true_m = rng.uniform(10, 40, 30)
        boxes = np.stack(
            [300 + 0 * true_m, 300 + 0 * true_m, 400 + 0 * true_m, 380 + 0 * true_m], axis=1
        )
        tracks = Tracks(ids, boxes, np.full(30, CAR), np.ones(30), np.ones(30, np.bool_))
        by_size, by_rig = (Ranges(ids, true_m, sigma * true_m) for sigma in (0.1, 0.02))
        check.update(SeenFrame(tracks, by_size, by_rig, Ego(motion=EgoMotion()), 0.1 * k))
    assert check.doubt is None
    assert "The scale was in doubt from 0" in check.notes[0]
    assert "agrees with the drive" in check.notes[1]


def test_without_evidence_the_baseline_cannot_be_checked():
    check = check_of(2.54, n=1, has_road=False)
    assert check.doubt is None
    assert "cannot be checked" in check.agreement.sentence
    assert "agrees with the drive within" in check_of(1.0, n=4, sizes=1.0).agreement.sentence
    wrong = check_of(1.25, n=4, sizes=1.0, true_mps=12.0)
    assert wrong.doubt is None
    assert "times what the drive shows" in wrong.agreement.sentence


def contacts_of(horizon_error, horizon_sigma, *, seed, n=10, true_height_m=1.5, across=(1.0, 0.0)):
    """The evidence of where cars touch the road, with the height taken to be 1.5 m, and a horizon
    that is wrong."""
    rng = np.random.default_rng(seed)
    ids, true_m = np.arange(n), rng.uniform(8, 40, n)
    by_size = true_m * np.exp(rng.normal(0, 0.08, n))
    bottom = 360 + 1000 * true_height_m / (true_m + 0.6)  # a tyre is 0.6 m behind the bumper
    middle = rng.uniform(300, 1000, n)
    half = 600 / true_m
    boxes = np.stack([middle - half, bottom - 1500 / true_m, middle + half, bottom], axis=1)
    tracks = Tracks(ids, boxes, np.full(n, CAR), np.ones(n), np.ones(n, np.bool_))
    road = RoadView(horizon=horizon_error, horizon_variance=horizon_sigma**2, across=across)
    sizes = SizeEvidence(CAMERA, 1.5)
    for k in range(4):
        ego = Ego(motion=EgoMotion(), road=road)
        sizes.add(SeenFrame(tracks, Ranges(ids, by_size, 0.1 * by_size), None, ego, 0.1 * k))
    (item,) = sizes.evidence
    assert item.of == {Unknown.HEIGHT: 1.0, Unknown.SIZES: 1.0}
    return item


def test_contact_points_share_the_error_of_the_horizon():
    """Ten cars do not average it out, and the evidence of the height has its sigma."""
    deviations, sigmas = [], []
    for seed, horizon_error in enumerate(np.linspace(-0.025, 0.025, 12)):
        item = contacts_of(horizon_error, 0.015, seed=seed)
        deviations.append(item.value / item.sigma)
        sigmas.append(item.sigma)
    assert 0.5 < np.sqrt(np.mean(np.square(deviations))) < 1.3
    well_known = contacts_of(0.0, 0.001, seed=0)
    # sizes of cars, crowns of streets, ten cars, and the horizon
    assert math.hypot(0.065, 0.04) < well_known.sigma < 0.11
    assert np.median(sigmas) > 1.2 * well_known.sigma
    higher = contacts_of(0.0, 0.001, seed=0, true_height_m=1.8)
    assert higher.value - well_known.value == pytest.approx(math.log(1.2), abs=0.03)


@pytest.mark.parametrize(("factor", "n_doubts"), [(0.84, 3), (1.0, 0), (1.16, 3)])
def test_a_given_speed_shows_a_height_that_is_wrong(factor, n_doubts):
    known = {"height_m": 1.5 * factor, "true_mps": 10.0, "speed": 1.0}
    checks = [check_of(None, seed=seed, n=8, **known) for seed in range(3)]
    doubts = [check.doubt for check in checks if check.doubt is not None]
    assert len(doubts) == n_doubts
    for check in checks:
        assert check.height_agreement.factor == pytest.approx(factor, rel=0.03)
    for doubt in doubts:
        assert doubt.cause_names[0] is Unknown.HEIGHT
        assert doubt.factor == pytest.approx(factor, rel=0.03)


def test_a_height_that_contact_points_hardly_confirm_is_a_note():
    """The sizes of eight cars show the height within 12 %: 1.7 sigma are no doubt, and 0.4 no
    note."""
    wrong = check_of(None, seed=0, n=8, height_m=1.5 * 1.16)
    assert wrong.doubt is None
    (note,) = wrong.notes
    assert note.startswith("The camera height is 1.21 ± 0.14 times what the drive shows, by the")
    assert "no contradiction yet" in note
    assert check_of(None, seed=0, n=8, height_m=1.5).notes == ()


def test_contact_points_beside_the_road_are_rougher():
    """A camera that looks to the side sees at 10 m what lies 10 m beside the road: 0.08 m of kerbs
    and 10 m of a slope of 0.04."""
    settings = GroundSettings()
    assert settings.place_sigma_m(np.array([0.0, 10.0, -20.0])) == pytest.approx(
        [0.08, math.hypot(0.08, 0.4), math.hypot(0.08, 0.8)]
    )
    ahead, aside = (contacts_of(0.0, 0.001, seed=0, across=x) for x in ((1.0, 0.0), (0.95, 0.3)))
    assert aside.sigma > 1.03 * ahead.sigma


def test_lane_lines_measure_the_height_of_the_camera():
    """A lane of 3.5 m; lines of two lanes together do not make a right rig wrong."""
    known = {"true_height_m": 2.2, "true_mps": 12.0, "lane": LaneWidth(3.5, 0.1)}
    without = check_of(1.0, **known).agreement.sigma
    assert check_of(1.0, lane_m=3.5, **known).agreement.sigma < 0.95 * without
    for seed in range(5):
        assert check_of(1.0, lane_m=7.0, seed=seed, **known).doubt is None


def test_a_sentence_names_the_causes_that_fit():
    sentence = ScaleDoubt(
        2.5, 0.06, 4, ((Unknown.BASELINE, 2.5), (Unknown.SPEED, 1.61)), "sizes"
    ).sentence(0.5, 900.0)
    for part in (
        "2.50 times",
        "± 6 %",
        "0.2 m instead of 0.5 m",
        "read as inches",
        "2.5 times too large",
    ):
        assert part in sentence
    assert "km/h read as miles per hour" in sentence
    assert "feet" not in sentence
    focal = ScaleDoubt(1.2, 0.02, 4, ((Unknown.FOCAL, 1.2),), "a turn").sentence(0.5, 900.0)
    assert "1.20 times (± 2 %) what the drive shows, 750 px instead of 900 px." in focal
    assert "read as" not in ScaleDoubt(0.5, 0.06, 4, ((Unknown.BASELINE, 0.5),), "sizes").sentence(
        0.2
    )


@pytest.mark.parametrize("factor", [0.3, 1.0, 4.0])
def test_assumed_baseline_is_estimated_from_sizes_and_not_doubted(factor):
    """The sigma contains those of the sizes, 8.5 %, of the focal length, 2 %, and of the objects."""
    for seed in range(5):
        check = check_of(factor, seed=seed, baseline_sigma=1.0)
        scale = check.rig_scale
        assert check.doubt is None
        assert abs(scale.log_factor - math.log(factor)) < 2.5 * scale.sigma
        assert math.hypot(0.07, 0.02) < scale.sigma < 0.12
        learnt = check.summary()["learnt_scale"]
        assert learnt["baseline_m"] == pytest.approx(0.5 * math.exp(-scale.log_factor))
        assert learnt["n_tracks"] == 4


def test_given_speed_shows_the_scale_whatever_the_sizes_and_the_focal_length():
    check = check_of(
        2.0, focal=1.03, sizes=1.05, true_mps=15.0, speed=1.0, baseline_sigma=1.0, seconds=10.0
    )
    assert check.rig_scale.log_factor == pytest.approx(math.log(2.0 * 1.03), abs=0.016)
    assert check.rig_scale.sigma < 0.03


def test_speed_in_kmh_does_not_become_the_baseline():
    check = check_of(2.0, true_mps=15.0, speed=3.6, baseline_sigma=1.0, seconds=10.0)
    assert check.doubt is not None
    assert causes(check.doubt)[0] == "speed"
    assert abs(check.rig_scale.log_factor - math.log(2.0)) < 2 * check.rig_scale.sigma


def test_scale_is_not_known_without_evidence():
    assert not check_of(2.0, n=1, baseline_sigma=1.0, has_road=False).rig_scale.is_known
    assert check_of(2.0, n=1).rig_scale.is_known


def pair_check(offset_px, *, residual_px=0.5, is_assumed=False, seed=0, n=40):
    """The check of a single pair with `n` cars, whose disparities are too small by `offset_px`."""
    rng = np.random.default_rng(seed)
    rig = StereoRig.rectified(CAMERA, 0.5)
    rig = replace(rig, baseline_sigma=1.0 if is_assumed else 0.0)
    priors = camera_priors(CAMERA.fx_px, baseline_m=0.5, baseline_sigma=rig.baseline_sigma)
    check = ScaleCheck(CAMERA, priors, rig=rig)
    ids, true_px = np.arange(n), rng.uniform(10.0, 60.0, n)
    measured_px = true_px - offset_px
    by_size = 500.0 / true_px * np.exp(rng.normal(0.03, 0.1, n))
    stereo_m = 500.0 / measured_px
    sigma_m = stereo_m * np.hypot(0.3, residual_px) / measured_px
    boxes = np.tile([600.0, 380.0, 650.0, 420.0], (n, 1))
    tracks = Tracks(ids, boxes, np.full(n, CAR), np.ones(n), np.ones(n, np.bool_))
    seen = SeenFrame(
        tracks,
        Ranges(ids, by_size, 0.12 * by_size),
        Ranges(ids, stereo_m, sigma_m),
        Ego(motion=EgoMotion()),
        0.0,
        alignment=Alignment(residual_px=residual_px),
    )
    check.update(seen)
    return check, check.rig_scale.corrected(seen.by_rig), 500.0 / true_px


@pytest.mark.parametrize("is_assumed", [False, True])
@pytest.mark.parametrize("offset_px", [-4.0, 4.0])
def test_vergence_of_a_single_pair_is_found_by_the_sizes_of_near_and_far_cars(
    offset_px, is_assumed
):
    within, errors = [], []
    for seed in range(20):
        check, ranges, true_m = pair_check(
            offset_px, residual_px=3.0 if is_assumed else 0.5, is_assumed=is_assumed, seed=seed
        )
        assert check.doubt is None
        sigma = check.rig_scale.sigma if is_assumed else check.cameras.sigma_of(OF_RIG)
        sigma_m = np.hypot(ranges.sigma_m, sigma * ranges.distance_m)
        errors.append(np.median(np.abs(ranges.distance_m / true_m - 1)))
        within.append(np.mean(np.abs(ranges.distance_m - true_m) < 2 * sigma_m))
    assert np.median(errors) < 0.08  # about 15 % without the correction
    # a rig is rarely so wrong, which some of these pairs cannot exclude
    assert np.mean(within) > (0.9 if is_assumed else 0.75)


def test_measured_alignment_is_not_corrected_by_sizes():
    check, ranges, true_m = pair_check(0.0, residual_px=0.1)
    assert check.rig_scale == CALIBRATED
    np.testing.assert_allclose(ranges.distance_m, true_m)


def test_disparities_without_an_offset_are_hardly_changed():
    for seed in range(10):
        check, ranges, true_m = pair_check(0.0, seed=seed)
        assert check.rig_scale.offset is not None
        assert abs(check.rig_scale.offset.px) < 1.0
        assert np.median(np.abs(ranges.distance_m / true_m - 1)) < 0.03
        assert check.notes[0].startswith("The baseline")


@pytest.mark.parametrize("height_m", [1.1, 2.0])
def test_height_of_the_camera_by_speeds(height_m):
    """By stereo odometry, and by a given speed; not by sizes alone, nor where it is given."""
    for given in ({}, {"rig": None, "speed": 1.0}):
        shown_m, sigma_m = check_of(true_height_m=height_m, true_mps=12.0, **given).height_m
        assert abs(shown_m - height_m) < 2.5 * sigma_m
        assert sigma_m < 0.05 * height_m
    assert check_of(true_height_m=height_m).height_m is None
    assert check_of(true_height_m=height_m, true_mps=12.0, height_m=height_m).height_m is None


def test_scale_of_speeds_by_the_road_of_one_camera():
    """By the sizes of road users, with their error; a given height is its own scale."""
    errors = []
    for height_m in (1.1, 1.5, 2.0):
        scale = check_of(true_height_m=height_m, rig=None).road_scale
        errors.append((math.log(height_m / ROAD_HEIGHT_M) + scale.log_factor) / scale.sigma)
        assert 0.02 < scale.sigma < 0.15
    assert np.abs(errors).max() < 2.0
    assert check_of(true_height_m=1.5, rig=None, height_m=1.5).road_scale == CALIBRATED
    before = check_of(rig=None, n=0).road_scale
    # a usual height of 1.45 m, seldom another one
    assert before.factor == pytest.approx(1.45 / ROAD_HEIGHT_M)
    assert 0.22 < before.sigma < 0.4


def test_ratio_of_speeds_before_a_drive_by_hand():
    """Errors of baseline, focal length, times, given speed and odometry, or of the height."""
    pair = [0.005, 0.004, 0.001, 0.015, 0.01]
    assert speed_ratio_sigma(camera_priors(800.0, baseline_m=0.5)) == pytest.approx(
        math.hypot(*pair), rel=0.01
    )
    road = [0.03, 0.004, 0.001, 0.015, 0.02]
    assert speed_ratio_sigma(camera_priors(800.0, height_m=1.5)) == pytest.approx(
        math.hypot(*road), rel=0.02
    )
    assert 0.22 < speed_ratio_sigma(camera_priors(800.0)) < 0.4
    # an unknown baseline is estimated, and its sigma is added then
    unknown = camera_priors(800.0, baseline_m=0.5, baseline_sigma=0.6)
    assert speed_ratio_sigma(unknown) < math.hypot(*pair)
