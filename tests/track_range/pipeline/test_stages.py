"""The stages of a frame, one by one: what each returns is all that the next ones see."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.stereo import streets
from tests.support.results.frame_results import frame_result
from track_range.pipeline.alarming import AlarmStage
from track_range.pipeline.clock import StageClock
from track_range.pipeline.doubting import DoubtStage
from track_range.pipeline.ego import EgoStage
from track_range.pipeline.filtering import Approach, Filtered, FilterStage, reported
from track_range.pipeline.ranging import FrameRanges, RangingStage
from track_range.pipeline.world import WorldStage
from track_range.ranging.cameras.causes import ScaleDoubt
from track_range.ranging.cameras.doubt import Doubt, errors_of
from track_range.ranging.cameras.evidence import Evidence
from track_range.ranging.cameras.posterior import posterior
from track_range.ranging.cameras.scale_check import ScaleCheck
from track_range.ranging.cameras.unknowns import Prior, Unknown, camera_priors
from track_range.ranging.fusion.fusion import Fusion
from track_range.ranging.measurement.focal_scale import FocalScale
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.measurement.rig_scale import RigScale
from track_range.ranging.methods.method import Measured, Ranger
from track_range.ranging.size_models.drive_scale import DriveScale, ScaleEvidence
from track_range.ranging.warning.collision_warning import CollisionWarning
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.odometry.ego_motion import Ego, EgoMotion
from track_range.stereo.odometry.ground_odometry import GroundOdometry
from track_range.stereo.right_camera.correction import RightCamera
from track_range.stereo.speed.ego_speed import EgoSpeed
from track_range.tracking.tracks import Tracks

CAMERA = PinholeCamera(100.0, 100.0, 49.5, 39.5, 100, 80)
IMAGE = np.zeros((80, 100, 3), np.uint8)
IDS = np.array([1, 2])
CARS = Tracks(
    IDS,
    np.array([[40.0, 40.0, 60.0, 60.0], [70.0, 40.0, 80.0, 50.0]]),
    np.array([2, 2]),
    np.ones(2),
    np.ones(2, np.bool_),
)
NO_BOXES = np.zeros((0, 4))


def cars_at(*distance_m):
    """The cars, 1.5 m high, with boxes as at these distances."""
    half_px = 50.0 * 1.5 / np.array(distance_m)
    middle_px = CARS.xyxy_px.reshape(2, 2, 2).mean(axis=1)
    boxes = np.concatenate([middle_px - half_px[:, None], middle_px + half_px[:, None]], axis=1)
    return replace(CARS, xyxy_px=boxes)


KNOWN = EgoMotion(12.0, 0.2)
NO_SIGMA = dict.fromkeys(("mono", "fused"), 0.0)


def frame(time_s: float = 0.0) -> Frame:
    return Frame(round(10 * time_s), time_s, IMAGE, None)


def ranges(*distances_m: float, sigma: float = 0.02) -> Ranges:
    distance_m = np.array(distances_m)
    return Ranges(IDS, distance_m, sigma * distance_m)


def measured(**by_method: Ranges) -> FrameRanges:
    evidence = ScaleEvidence(CARS.class_id, by_size=ranges(20.0, 30.0))
    return FrameRanges(by_method, (evidence,))


# -- Ego


def test_given_speed_is_used_while_it_is_trusted():
    stage = EgoStage(speed=EgoSpeed(np.array([0.0, 0.5]), np.array([12.0, 12.0]), "a file"))
    trusted = stage.update(frame(), NO_BOXES)
    doubted = stage.update(frame(0.1), NO_BOXES, trusts_given=False)
    assert (trusted.motion.speed_mps, trusted.trusts_given) == (12.0, True)
    assert math.isnan(doubted.motion.speed_mps)
    assert doubted.given is not None
    assert (doubted.given.speed_mps, doubted.trusts_given) == (12.0, False)


def test_speed_known_for_a_frame_replaces_the_source():
    stage = EgoStage(speed=EgoSpeed(np.array([0.0, 0.5]), np.array([12.0, 12.0]), "a file"))
    ego = stage.update(frame(), NO_BOXES, EgoMotion(5.0, 0.1))
    assert (ego.motion.speed_mps, ego.motion.speed_sigma_mps) == (5.0, 0.1)


def test_source_of_the_speed_is_named_unless_it_is_given():
    assert EgoStage().speed_source is None
    given = EgoSpeed(np.array([0.0]), np.array([1.0]), "a file")
    assert EgoStage(speed=given).speed_source is None


# -- Ranges


class FixedRanger(Ranger):
    """A method that always measures the same."""

    def __init__(self, fixed: Ranges) -> None:
        self.fixed = fixed

    def measure(self, tracks, frame):
        return self.fixed


def test_distances_with_the_scale_of_the_rig_are_corrected_and_kept_for_the_evidence():
    by_rig, by_size = ranges(20.0, 30.0), ranges(21.0, 31.0)
    stage = RangingStage({"mono": FixedRanger(by_size), "stereo": FixedRanger(by_rig)})
    scale = DriveScale(rig=RigScale(math.log(2.0), 0.1))
    of_frame = stage.measure(CARS, frame(), None, Ego(motion=EgoMotion()), scale, StageClock())
    assert of_frame.by_rig is by_rig
    assert of_frame.ranges["mono"] is by_size
    of_next = of_frame.at_scale(DriveScale(rig=RigScale(math.log(4.0), 0.1)))
    np.testing.assert_allclose(of_next.ranges["stereo"].distance_m, [5.0, 7.5])
    assert of_frame.at_scale(scale) is of_frame
    back = of_next.at_scale(scale)
    np.testing.assert_allclose(back.ranges["stereo"].distance_m, [10.0, 15.0])
    np.testing.assert_allclose(of_frame.ranges["stereo"].distance_m, [10.0, 15.0])
    one_camera = RangingStage({"mono": FixedRanger(by_size)})
    alone = one_camera.measure(
        CARS, frame(), None, Ego(motion=EgoMotion()), DriveScale(), StageClock()
    )
    assert alone.by_rig is None


class Witness(FixedRanger):
    """A method that always measures the same, and takes it as the scale of the drive."""

    def measure_at_scale(self, tracks, frame, others, scale):
        return Measured(self.fixed, ScaleEvidence(tracks.class_id, by_size=self.fixed))


def test_methods_that_are_only_shown_are_corrected_and_show_nothing_to_the_others():
    by_rig, by_size = ranges(20.0, 30.0), ranges(21.0, 31.0)
    rangers = {"mono": Witness(by_size), "stereo": FixedRanger(by_rig)}
    scale = DriveScale(rig=RigScale(math.log(2.0), 0.1))
    frames = {}
    for shown_only in (frozenset(), frozenset(rangers)):
        stage = RangingStage(rangers, shown_only)
        given = (CARS, frame(), None, Ego(motion=EgoMotion()), scale, StageClock())
        frames[shown_only] = stage.measure(*given)
    usual, shown = frames.values()
    assert (usual.by_size, usual.by_rig, {*usual.to_fuse}) == (by_size, by_rig, {"mono", "stereo"})
    assert (shown.by_size, shown.by_rig, {*shown.to_fuse}) == (None, None, set())
    np.testing.assert_allclose(shown.ranges["stereo"].distance_m, [10.0, 15.0])
    next_scale = DriveScale(rig=RigScale(math.log(4.0), 0.1))
    np.testing.assert_allclose(shown.at_scale(next_scale).ranges["stereo"].distance_m, [5.0, 7.5])


class Reader(FixedRanger):
    """A method that always measures the same, and keeps what it read."""

    def measure_at_scale(self, tracks, frame, others, scale):
        self.read = {*others}
        return Measured(self.fixed)


@pytest.mark.parametrize(
    ("shown_only", "read"),
    [((), {"mono", "stereo"}), (("stereo",), {"mono"}), (("depth", "stereo"), {"mono", "stereo"})],
)
def test_fused_methods_do_not_read_those_that_are_only_shown(shown_only, read):
    by_size = ranges(21.0, 31.0)
    rangers = {"mono": FixedRanger(by_size), "stereo": FixedRanger(by_size)}
    rangers["depth"] = Reader(by_size)
    reads = {"depth": ("stereo", "mono")}
    stage = RangingStage(rangers, frozenset(shown_only), reads)
    stage.measure(CARS, frame(), None, Ego(motion=EgoMotion()), DriveScale(), StageClock())
    assert rangers["depth"].read == read


def test_widened_by_an_independent_error():
    plain = ranges(20.0, np.nan, sigma=0.03)
    wide = plain.widened(0.04)
    np.testing.assert_allclose(wide.sigma_m, [0.05 * 20.0, np.nan])
    assert plain.widened(0.0) is plain


# -- Doubt


def doubt_of(priors, evidence=(), scale=None):
    return Doubt.of(posterior(priors, evidence), errors_of(priors), scale)


def test_doubt_is_returned_with_a_scale_without_evidence():
    n = 30
    ids, true_m = np.arange(n), np.linspace(10.0, 40.0, n)
    boxes = np.tile([40.0, 40.0, 60.0, 60.0], (n, 1))
    tracks = Tracks(ids, boxes, np.full(n, 2), np.ones(n), np.ones(n, np.bool_))
    by_size = Ranges(ids, true_m, 0.1 * true_m)
    by_rig = Ranges(ids, 2.0 * true_m, 0.04 * true_m)  # the baseline is twice the true one
    evidence = ScaleEvidence(tracks.class_id, by_size=by_size, reference=by_rig)
    frame_ranges = FrameRanges({"mono": by_size, "stereo": by_rig}, (evidence,), {"stereo": by_rig})
    priors = camera_priors(CAMERA.fx_px, baseline_m=0.5, scale_sigma=0.03)
    stage, scale = DoubtStage(priors, ScaleCheck(CAMERA, priors)), DriveScale()
    doubts = []
    for k in range(20):
        ego = Ego(motion=EgoMotion())
        doubt, scale = stage.update(tracks, frame_ranges, ego, None, scale, frame(0.1 * k))
        doubts.append(doubt)
    assert doubts[0].scale is None
    assert doubts[0].shared_sigma["stereo"] == pytest.approx(0.03, rel=0.1)
    assert doubt.scale is not None
    assert doubt.scale.cause_names == ["baseline"]
    assert scale.n_tracks == 0
    # half the distance is possible, so that sigma is half the distance at least
    assert 0.5 < doubt.shared_sigma["stereo"] < 0.6
    assert doubt.shared_sigma["mono"] < 0.01
    assert "baseline" in stage.notes()[0]


@pytest.mark.parametrize("given", [{"baseline_m": 0.5}, {"height_m": 1.5}, {}])
def test_distances_by_size_have_the_error_of_the_focal_length_alone(given):
    # contact points and the horizon are a part of their evidence, and the road is not their scale
    errors = errors_of(camera_priors(CAMERA.fx_px, **given))
    assert errors["mono"] == ({Unknown.FOCAL: 1.0},)
    assert Unknown.FOCAL in errors["ground"][0]
    assert errors["ground"] != errors["mono"]


def test_speed_alone_in_doubt_is_not_used_and_widens_no_distance():
    by_height = Evidence("a known height", {Unknown.HEIGHT: 1.0}, 0.0, 0.01)
    by_speed = Evidence(
        "the given speed",
        {Unknown.HEIGHT: 1.0, Unknown.FOCAL: -1.0, Unknown.SPEED: 1.0},
        math.log(3.6),
        0.02,
    )
    scale = ScaleDoubt(3.6, 0.1, 3, ((Unknown.SPEED, 3.6),), "")
    priors = camera_priors(CAMERA.fx_px)
    used = doubt_of(priors, [by_height, by_speed])
    doubt = doubt_of(priors, [by_height, by_speed], scale)
    assert not doubt.trusts_speed
    assert used.shared_sigma["ground"] > 0.7
    assert doubt.shared_sigma["ground"] < 0.05
    # 3.6 times too fast: the true speed is less than a third of the given one
    assert doubt.given_sigma == pytest.approx(1 - 1 / 3.6, abs=0.05)


def test_speeds_have_the_errors_of_their_scale():
    doubt = Doubt(odometry_sigma=0.3, given_sigma=0.1)
    odometry = doubt.widened(Ego(motion=KNOWN), KNOWN)
    assert odometry.speed_sigma_mps == pytest.approx(math.hypot(0.2, 0.3 * 12.0))
    given = doubt.widened(Ego(motion=KNOWN, given=KNOWN, trusts_given=True), KNOWN)
    assert given.speed_sigma_mps == pytest.approx(math.hypot(0.2, 0.1 * 12.0))
    assert Doubt().widened(Ego(motion=KNOWN), KNOWN) == KNOWN


# -- Filters, world, alarms


def filtered(
    mounting: Mounting | None = None, ego: EgoMotion = KNOWN
) -> tuple[FrameRanges, Filtered, Doubt]:
    stage, fusion = FilterStage(CAMERA, mounting=mounting), Fusion()
    for k in range(15):
        frame_ranges = measured(mono=ranges(20.0 - k, 30.0))
        fused = fusion.fuse(frame_ranges.ranges, IDS, 0.1 * k)
        motion = stage.update(CARS, frame_ranges, fused, ego, 0.1 * k)
    return frame_ranges, fused, motion


def test_boxes_of_unconfirmed_tracks_show_the_lateral_speed_once_they_are_confirmed():
    """Both cars are seen for 0.5 s, the second one without being confirmed."""
    sigma_mps = {}
    for shown in (None, CARS.select([1])):
        stage, fusion = FilterStage(CAMERA), Fusion()
        for k in range(6):
            tracks = CARS.select([0] if k < 5 else [0, 1])
            distance_m = np.array([20.0 - k, 30.0 - k])[: len(tracks)]
            frame_ranges = measured(mono=Ranges(tracks.track_id, distance_m, 0.02 * distance_m))
            fused = fusion.fuse(frame_ranges.ranges, tracks.track_id, 0.1 * k)
            moved = stage.update(
                tracks,
                frame_ranges,
                fused,
                KNOWN,
                0.1 * k,
                unconfirmed=shown if k < 5 else None,
            )
            assert len(moved.lateral.state.x) == len(tracks)
        sigma_mps[shown is None] = np.sqrt(moved.lateral.state.P_vv)
    assert sigma_mps[True][1] == pytest.approx(5.0)
    assert 0.2 < sigma_mps[False][1] < 2.0
    assert sigma_mps[False][0] == sigma_mps[True][0]


def test_filters_ignore_an_ego_speed_that_is_less_certain_than_the_rates_that_they_report():
    sure, unsure, unknown = (
        filtered(ego=ego)[2].fused for ego in (KNOWN, EgoMotion(12.0, 1.6), EgoMotion())
    )
    np.testing.assert_array_equal(unsure.rate_mps, unknown.rate_mps)
    assert np.isfinite(unsure.rate_mps).all()
    assert (sure.rate_mps != unknown.rate_mps).all()


def test_all_distances_are_reported_with_their_shared_errors():
    frame_ranges, fused, motion = filtered()
    shared = doubt_of({Unknown.FOCAL: Prior(0.1)})
    wide = reported(frame_ranges, fused, motion, shared)
    plain = reported(frame_ranges, fused, motion, doubt_of({}))
    assert list(wide) == ["mono", "fused", "mono_kf", "fused_kf"]
    for name, one in plain.items():
        np.testing.assert_allclose(
            wide[name].sigma_m, np.hypot(one.sigma_m, 0.1 * one.distance_m), rtol=1e-6
        )


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_a_wrong_focal_length_stretches_all_stages_alike(factor):
    """What a camera with the right focal length gives, after the correction."""
    results = []
    for f in (1.0, factor):
        camera = CAMERA.with_focal_length(100.0 * f)
        focal = FocalScale(math.log(f))
        stage, world, ego = FilterStage(camera), WorldStage(camera), EgoStage()
        fusion = Fusion()
        for k in range(15):
            frame_ranges = measured(mono=ranges(f * (20.0 - k), 30.0 * f))
            fused = fusion.fuse(frame_ranges.ranges, IDS, 0.1 * k)
            scale = DriveScale(focal=focal)
            shown = ego.update(frame(0.1 * k), NO_BOXES, KNOWN, scale=scale)
            # turns are measured in pixels
            motion = replace(shown.motion, yaw_rad_s=0.2 / f)
            cars = cars_at(20.0 - k, 30.0)
            moved = stage.update(cars, frame_ranges, fused, motion, 0.1 * k).corrected(focal)
            distances = reported(frame_ranges, fused, moved, Doubt(shared_sigma=NO_SIGMA), focal)
            true = focal.corrected_motion(motion)
            placed = world.update(cars, moved, distances, true, 0.1 * k, focal)
        results.append((true, moved, distances, placed))
    (true, moved, distances, placed), (true_f, moved_f, distances_f, placed_f) = results
    assert true_f.speed_mps == pytest.approx(true.speed_mps) == KNOWN.speed_mps
    assert true_f.yaw_rad_s == pytest.approx(true.yaw_rad_s)
    for name, one in distances.items():
        np.testing.assert_allclose(distances_f[name].distance_m, one.distance_m, rtol=0.01)
    np.testing.assert_allclose(moved_f.fused.rate_mps, moved.fused.rate_mps, atol=0.02)
    np.testing.assert_allclose(moved_f.fused.ttc_s, moved.fused.ttc_s, rtol=0.01)
    np.testing.assert_allclose(moved_f.lateral.state.x, moved.lateral.state.x, rtol=0.05)
    np.testing.assert_allclose(placed_f.xyz_m, placed.xyz_m, rtol=1e-6)


def test_a_new_focal_length_does_not_change_closing_speeds():
    """A car that comes nearer by 3 m/s, 15 % of the given speed: the correction starts at 4 s."""
    stage, ego, fusion = FilterStage(CAMERA), EgoStage(), Fusion()
    closing_mps = []
    for k in range(60):
        focal = FocalScale(math.log(1.15)) if k >= 40 else FocalScale()
        frame_ranges = measured(mono=ranges(*np.full(2, 1.15 * (40.0 - 0.3 * k))))
        fused = fusion.fuse(frame_ranges.ranges, IDS, 0.1 * k)
        given = EgoMotion(20.0, 0.2)
        shown = ego.update(frame(0.1 * k), NO_BOXES, given, scale=DriveScale(focal=focal))
        cars = cars_at(*[40.0 - 0.3 * k] * 2)
        moved = stage.update(cars, frame_ranges, fused, shown.motion, 0.1 * k)
        closing_mps.append(-moved.fused.rate_mps[0])
    np.testing.assert_allclose(closing_mps[35:], 1.15 * 3.0, atol=0.3)


def test_view_to_the_side_has_closing_speeds_but_no_times_to_collision():
    _, _, ahead = filtered()
    _, _, aside = filtered(Mounting(yaw_deg=-58.0))
    np.testing.assert_array_equal(aside.fused.rate_mps, ahead.fused.rate_mps)
    assert np.isfinite(Approach.of(ahead, 0.0).ttc_s[0])
    assert np.isnan(Approach.of(aside, 0.0).ttc_s).all()


def test_alarms_of_a_run_without_warnings_are_empty():
    frame_ranges, fused, motion = filtered()
    approach = Approach.of(motion, 0.0)
    stage = AlarmStage(CAMERA, None)
    alarms = stage.update(CARS, fused.ranges, motion, approach, KNOWN, Doubt(), None, 0.0)
    assert not alarms.has_warnings
    assert not alarms.has_safety
    assert not alarms.warnings.active.any()
    assert np.isnan(alarms.safety.gap_m).all()
    result = frame_result(frame(), CARS, dict(frame_ranges.ranges))
    assert result.warnings.probability.shape == (2,)
    assert result.scale_doubt is None


def test_no_alarm_is_active_while_the_scale_is_in_doubt():
    doubtful = Doubt(ScaleDoubt(2.0, 0.1, 3, ((Unknown.BASELINE, 2.0),), ""))
    is_active = {}
    for doubt in (Doubt(), doubtful):
        stage, filters, fusion = (
            AlarmStage(CAMERA, CollisionWarning()),
            FilterStage(CAMERA),
            Fusion(),
        )
        active = np.zeros(2, np.bool_)
        for k in range(25):
            frame_ranges = measured(mono=ranges(30.0 - k, 60.0, sigma=0.01))
            fused = fusion.fuse(frame_ranges.ranges, IDS, 0.1 * k)
            cars = cars_at(30.0 - k, 60.0)
            motion = filters.update(cars, frame_ranges, fused, KNOWN, 0.1 * k)
            approach = Approach.of(motion, 0.0)
            alarms = stage.update(cars, fused.ranges, motion, approach, KNOWN, doubt, None, 0.1 * k)
            active |= alarms.warnings.active
        is_active[doubt.scale is None] = active.tolist()
    assert is_active == {True: [True, False], False: [False, False]}


def test_an_error_that_all_distances_share_hides_no_time_to_collision():
    """As of a camera without a calibration: it is one of the closing speed, and of no time."""
    found = []
    for shared_sigma in (0.0, 0.6):
        stage, filters, fusion = (
            AlarmStage(CAMERA, CollisionWarning()),
            FilterStage(CAMERA),
            Fusion(),
        )
        for k in range(15):
            frame_ranges = measured(mono=ranges(30.0 - k, 60.0, sigma=0.1))
            fused = fusion.fuse(frame_ranges.ranges, IDS, 0.1 * k)
            cars = cars_at(30.0 - k, 60.0)
            motion = filters.update(cars, frame_ranges, fused, KNOWN, 0.1 * k)
            approach = Approach.of(motion, shared_sigma)
            alarms = stage.update(
                cars, fused.ranges, motion, approach, KNOWN, Doubt(), None, 0.1 * k
            )
        found.append(alarms.safety.ttc_front_s[0])
    assert found[0] == found[1] == pytest.approx((16.0 - 1.5) / 10.0, abs=0.1)


def test_positions_are_on_the_rays_of_the_boxes():
    frame_ranges, fused, motion = filtered()
    doubt = doubt_of({})
    distances = reported(frame_ranges, fused, motion, doubt)
    world = WorldStage(CAMERA).update(CARS, motion, distances, KNOWN, 0.0)
    x_m = (50.0 - CAMERA.cx_px) / CAMERA.fx_px * fused.ranges.distance_m[0]
    np.testing.assert_allclose(world.xyz_m[0], [x_m, 0.105 * 6.0, 6.0], rtol=1e-9)
    # 6 m away, principal point and box off by 2 px at 100 px focal length: beside the error by z
    sure = WorldStage(CAMERA).update(CARS, motion, distances, KNOWN, 0.0).xy_sigma_m[0]
    sigma = WorldStage(CAMERA, centre_sigma_px=2.0).update(CARS, motion, distances, KNOWN, 0.0)
    np.testing.assert_allclose(sigma.xy_sigma_m[0] ** 2 - sure**2, (6.0 * 2.0 / CAMERA.fx_px) ** 2)
    assert np.all(sure > np.abs(world.xyz_m[0, :2]) / 6.0 * distances["fused"].sigma_m[0])
    assert world.ego_pose.x_m == 0.0


def test_world_positions_of_a_camera_that_looks_aside_are_on_the_rays():
    """The side of a vehicle that it sees is nearer than the centre, whose motion is filtered."""
    mounting = Mounting(yaw_deg=-58.0)
    frame_ranges, fused, motion = filtered(mounting)
    distances = reported(frame_ranges, fused, motion, doubt_of({}))
    stage = WorldStage(CAMERA, mounting=mounting)
    world = stage.update(CARS, motion, distances, KNOWN, 0.0)
    distance_m = motion.fused.state.x
    x_m = (np.array([50.0, 75.0]) - CAMERA.cx_px) / CAMERA.fx_px * distance_m
    np.testing.assert_allclose(world.motion.world_x_m, distance_m)
    np.testing.assert_allclose(world.motion.world_y_m, -x_m)  # y of the map is to the left
    assert abs(motion.lateral.state.x[1] - x_m[1]) > 0.1


def test_speed_of_a_repeated_image_is_predicted_for_a_second():
    stage = EgoStage(pair_odometry=_SteadyOdometry())
    stage.update(frame(1.0), NO_BOXES)
    soon, late = (stage.predicted(1.0 + since_s).motion for since_s in (0.25, 1.1))
    assert (soon.speed_mps, soon.yaw_rad_s, soon.is_predicted) == (9.0, 0.1, True)
    # 2.5 m/s per root of a second
    assert soon.speed_sigma_mps == pytest.approx(math.hypot(0.1, 1.25))
    assert math.isnan(late.speed_mps)
    assert math.isnan(late.yaw_rad_s)


def test_speed_that_is_not_measured_is_predicted_for_a_second():
    stage = EgoStage(pair_odometry=_LosingOdometry())
    known, soon, late = (stage.update(frame(t), NO_BOXES).motion for t in (1.0, 1.25, 2.1))
    assert not known.is_predicted
    assert (soon.speed_mps, soon.yaw_rad_s, soon.is_predicted) == (9.0, 0.2, True)
    assert soon.speed_sigma_mps == pytest.approx(math.hypot(0.1, 1.25))
    assert math.isnan(late.speed_mps)
    assert late.yaw_rad_s == 0.2
    # a repeated image counts from the last measurement, too
    stage.update(frame(1.0), NO_BOXES)
    stage.update(frame(1.2), NO_BOXES)
    again = stage.predicted(1.25).motion
    assert again.speed_sigma_mps == pytest.approx(math.hypot(0.1, 1.25))


def test_given_speed_with_a_gap_is_predicted_and_a_measured_one_replaces_it():
    given = EgoSpeed(np.array([0.0, 1.0, 9.0]), np.array([12.0, 12.0, 12.0]), "a file")
    alone = EgoStage(speed=given)
    soon, late = (alone.update(frame(t), NO_BOXES).motion for t in (1.0, 1.2))
    assert (late.speed_mps, late.is_predicted) == (soon.speed_mps, True)
    assert math.isnan(alone.update(frame(2.5), NO_BOXES).motion.speed_mps)
    pair = EgoStage(speed=given, pair_odometry=_SteadyOdometry())
    motion = pair.update(frame(5.0), NO_BOXES).motion
    assert (motion.speed_mps, motion.is_predicted) == (9.0, False)


def test_pair_whose_speed_is_not_used_still_follows_the_right_camera():
    odometry = _SteadyOdometry()
    odometry.right_camera = RightCamera(CAMERA)
    stage = EgoStage(pair_odometry=odometry, uses_pair_speed=False)
    ego = stage.update(frame(1.0), NO_BOXES)
    assert ego.right_camera == odometry.right_camera
    assert ego.by_pair is None
    assert math.isnan(ego.motion.speed_mps)
    assert stage.speed_source is None


def test_given_speed_of_a_repeated_image_is_that_of_its_time():
    stage = EgoStage(speed=EgoSpeed(np.array([0.0, 2.0]), np.array([10.0, 14.0]), "a file"))
    stage.update(frame(0.0), NO_BOXES)
    assert stage.predicted(1.5).motion.speed_mps == pytest.approx(13.0)
    assert stage.predicted(1.5, EgoMotion(5.0, 0.1)).motion.speed_mps == 5.0


def test_speed_by_the_road_has_the_scale_of_the_drive_and_triangulates_nothing():
    """8 m/s by a height of 1.8 m, where the drive shows 2.16 m within 10 %."""
    mounting = Mounting(pitch_deg=5.0)
    road = GroundOdometry(
        streets.CAMERA, streets.HEIGHT_M, travel_from_camera=mounting.travel_from_camera
    )
    stage = EgoStage(road_motion=road, uses_road_speed=True)
    scale = DriveScale(road=RigScale(-math.log(1.2), 0.1))
    ego = Ego(motion=EgoMotion())
    for k in range(8):
        image = streets.street(mounting, 0.8 * k)
        ego = stage.update(Frame(k, 0.1 * k, image, None), NO_BOXES, scale=scale)
    assert ego.by_road is not None
    assert ego.by_road.speed_mps == pytest.approx(8.0, rel=0.03)
    assert ego.motion.speed_mps == pytest.approx(1.2 * ego.by_road.speed_mps)
    assert ego.motion.scale == pytest.approx(1.2)
    own_mps = 1.2 * ego.by_road.speed_sigma_mps
    lasting_mps = 0.1 * ego.motion.speed_mps
    assert ego.motion.speed_sigma_mps == pytest.approx(math.hypot(own_mps, lasting_mps))
    assert ego.motion.noise_mps == pytest.approx(1.2 * ego.by_road.noise_mps)
    assert stage.speed_source is not None
    assert stage.speed_source.endswith("with an estimated height of the camera")
    assert ego.step is None


class _SteadyOdometry:
    source = "steady odometry"
    right_camera = None
    move = None
    focal_change = 0.0
    notes = ()

    def update(self, frame: Frame, xyxy_px: np.ndarray) -> EgoMotion:
        return EgoMotion(9.0, 0.1, 0.1)


class _LosingOdometry(_SteadyOdometry):
    """A pair that shows no speed from 1 s on, and a yaw rate."""

    def update(self, frame, xyxy_px):
        known = super().update(frame, xyxy_px)
        return known if frame.time_s <= 1.0 else EgoMotion(yaw_rad_s=0.2)


def test_given_speed_of_the_vehicle_is_turned_to_the_axes_of_the_camera():
    speed = EgoSpeed(np.array([0.0, 2.0]), np.array([10.0, 10.0]), "a file", speed_sigma_mps=0.2)
    mounting = Mounting(yaw_deg=-60.0, x_m=2.0, sigma_deg=1.0)
    motion = EgoStage(speed=speed, mounting=mounting).update(frame(), NO_BOXES).motion
    assert (motion.speed_mps, motion.right_mps) == pytest.approx((5.0, -8.660), abs=1e-3)
    # 1 degree of the angle moves it across: 0.0175 x 8.66 = 0.151, 0.0175 x 5 = 0.087
    assert motion.speed_sigma_mps == pytest.approx(math.hypot(0.1, 0.151), abs=1e-3)
    assert motion.right_sigma_mps == pytest.approx(math.hypot(0.173, 0.087), abs=1e-3)


def test_camera_away_from_the_reference_point_moves_in_turns():
    stage = EgoStage(
        speed=EgoSpeed(np.array([-np.inf]), np.array([9.0]), "a number"),
        pair_odometry=_SteadyOdometry(),
        mounting=Mounting(x_m=2.0, y_m=1.0),
    )
    motion = stage.update(frame(), NO_BOXES).motion
    # 0.1 rad/s to the right, 2 m in front and 1 m to the left of the reference point
    assert (motion.speed_mps, motion.right_mps) == pytest.approx((9.1, 0.2))


def test_motion_of_the_road_aside_is_turned_to_the_axes_of_the_camera():
    """8 m/s along the street; the camera looks 58 degrees to its right."""
    mounting = Mounting(yaw_deg=-58.0, pitch_deg=5.0)
    stage = EgoStage(
        road_motion=GroundOdometry(
            streets.CAMERA, streets.HEIGHT_M, travel_from_camera=mounting.travel_from_camera
        ),
        uses_road_speed=True,
        has_given_height=True,
        mounting=mounting,
    )
    ego = Ego(motion=EgoMotion())
    for k in range(8):
        image = streets.street(mounting, 0.8 * k)
        ego = stage.update(Frame(k, 0.1 * k, image, None), NO_BOXES)
    true = 8 * np.array([-0.848, 0.528])
    assert (ego.motion.right_mps, ego.motion.speed_mps) == pytest.approx(true, abs=0.35)
    assert ego.step is not None
    assert ego.step.travelled_m == pytest.approx(0.8, rel=0.03)
    assert ego.step.travel @ mounting.travel_from_camera[2] > 0.999
    assert ego.motion.right_sigma_mps > ego.motion.speed_sigma_mps > 0.1
    assert ego.road is not None
    assert ego.road.horizon == pytest.approx(-math.tan(math.radians(5.0)), abs=0.01)
