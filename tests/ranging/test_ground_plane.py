from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.detection.classes import ROAD_CLASSES
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.ground_plane import GroundPlane, GroundRanger, GroundSettings
from track_range.ranging.size_models.drive_scale import DriveScale, ScaleEvidence
from track_range.ranging.size_models.size_model import surface_offset_m
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.road_horizon import RoadView, curvature_fraction
from track_range.tracking.tracks import Tracks

F_PX, CY_PX, HEIGHT_M = 700.0, 180.0, 1.65
CAMERA = PinholeCamera(F_PX, F_PX, 600.0, CY_PX, 1200, 370)
IMAGE = np.zeros((370, 1200, 3), np.uint8)
CAR, PERSON, LIGHT = (ROAD_CLASSES.index(name) for name in ("car", "person", "traffic light"))
SMOOTH = GroundSettings(
    height_m=HEIGHT_M, height_sigma_m=0.02, kerb_m=0.0, box_sigma_px=0.1, road_sigma_rad=0.0005
)


def cars_at(distance_m, *, horizon_px=CY_PX, height_m=HEIGHT_M, size_error=0.0, sigma=0.06):
    """Cars seen from behind on a plane, and their distances by size, with an error of
    `size_error`."""
    distance_m = np.asarray(distance_m, float)
    n = len(distance_m)
    bottom = horizon_px + F_PX * height_m / distance_m
    half, high = 0.5 * F_PX * 1.7 / distance_m, F_PX * 1.5 / distance_m
    boxes = np.stack([600 - half, bottom - high, 600 + half, bottom], axis=1)
    tracks = Tracks(np.arange(1, n + 1), boxes, np.full(n, CAR), np.ones(n), np.ones(n, bool))
    by_size_m = distance_m * (1 + np.broadcast_to(size_error, n))
    return tracks, Ranges(tracks.track_id, by_size_m, sigma * by_size_m)


def at(time_s, index=0):
    return Frame(index, time_s, IMAGE, None)


def test_car_on_the_plane_by_hand():
    """f H / (y - horizon) = 700 1.65 / 57.75 = 20 m; 3 cm of it are between contact point and
    surface."""
    plane = GroundPlane(CAMERA, SMOOTH)
    tracks, by_size = cars_at([20.0, 40.0, 60.0])
    assert tracks.xyxy_px[0, 3] - CY_PX == pytest.approx(57.75)
    ranges = plane.measure(tracks, by_size, at(0.0))
    assert ranges.distance_m == pytest.approx([20.0, 40.0, 60.0], rel=0.01)
    assert (np.diff(ranges.sigma_m / ranges.distance_m) > 0).all()  # fewer pixels below the horizon


def test_own_size_does_not_affect_the_distance():
    """A car 30 % larger than its class is measured with the horizon from the other cars."""
    tracks, wrong = cars_at([20.0, 30.0, 45.0, 60.0], size_error=[-0.3, 0.0, 0.0, 0.0])
    _, right = cars_at([20.0, 30.0, 45.0, 60.0])
    measured = [
        GroundPlane(CAMERA, SMOOTH).measure(tracks, sizes, at(0.0)).distance_m
        for sizes in (wrong, right)
    ]
    assert measured[0][0] == pytest.approx(measured[1][0], rel=1e-6)
    assert measured[0][1] != pytest.approx(measured[1][1], rel=1e-6)


@pytest.mark.parametrize("horizon_px", [150.0, 180.0, 205.0])
def test_horizon_from_sizes(horizon_px):
    plane = GroundPlane(CAMERA, SMOOTH)
    before = plane.horizon
    for k in range(20):
        tracks, by_size = cars_at(np.array([15.0, 30.0, 45.0, 60.0]), horizon_px=horizon_px)
        ranges = plane.measure(tracks, by_size, at(0.1 * k, k))
    assert plane.horizon.y_px == pytest.approx(horizon_px, abs=2.0)
    assert plane.horizon.sigma_px < 0.5 * before.sigma_px
    assert ranges.distance_m == pytest.approx([15.0, 30.0, 45.0, 60.0], rel=0.06)


def test_camera_height_from_near_and_far_objects():
    plane = GroundPlane(CAMERA, GroundSettings(box_sigma_px=0.1, kerb_m=0.0, pitch_sigma_rad=0.001))
    assert plane.horizon.height_m == pytest.approx(1.5)
    for k in range(20):
        plane.measure(
            *cars_at([6.0, 8.0, 12.0, 30.0, 50.0, 80.0], height_m=1.2, sigma=0.03), at(0.1 * k, k)
        )
    assert plane.horizon.height_m == pytest.approx(1.2, abs=0.1)


def test_measurements_decay():
    plane = GroundPlane(CAMERA, SMOOTH)
    sigma_px = [plane.horizon.sigma_px]
    plane.measure(*cars_at([30.0, 45.0, 60.0]), at(0.0))
    sigma_px.append(plane.horizon.sigma_px)
    plane.measure(Tracks.empty(), Ranges.unmeasured(np.zeros(0, np.int64)), at(2.0, 1))
    sigma_px.append(plane.horizon.sigma_px)
    plane.measure(Tracks.empty(), Ranges.unmeasured(np.zeros(0, np.int64)), at(60.0, 2))
    sigma_px.append(plane.horizon.sigma_px)
    # the angle of the mounting stays known
    assert sigma_px[1] < sigma_px[2] < sigma_px[3] < 0.5 * sigma_px[0]
    plane.measure(Tracks.empty(), Ranges.unmeasured(np.zeros(0, np.int64)), at(1200.0, 3))
    assert plane.horizon.sigma_px == pytest.approx(sigma_px[0], rel=0.02)


def test_horizon_from_lane_lines():
    plane = GroundPlane(CAMERA, SMOOTH)
    plane.add_horizon(200.0, 1.0)
    assert plane.horizon.y_px == pytest.approx(200.0, abs=3.0)
    # a single car, no other objects
    tracks, by_size = cars_at([25.0], horizon_px=200.0, size_error=0.2)
    with_lanes = plane.measure(tracks, by_size, at(0.0))
    without = GroundPlane(CAMERA, SMOOTH).measure(tracks, by_size, at(0.0))
    assert with_lanes.distance_m == pytest.approx([25.0], rel=0.08)
    assert not (with_lanes.sigma_m[0] >= without.sigma_m[0])
    other = GroundPlane(CAMERA, SMOOTH)
    for y_px in (200.0, 160.0):  # a new horizon replaces the previous one
        other.add_horizon(y_px, 1.0)
    assert other.horizon.y_px == pytest.approx(160.0, abs=3.0)


def test_unmeasurable_boxes_are_nan():
    tracks, by_size = cars_at([20.0, 30.0, 40.0, 50.0, 60.0])
    boxes = tracks.xyxy_px.copy()
    boxes[1, [1, 3]] = [60.0, 120.0]  # above the horizon
    boxes[2, 3] = 369.5  # cut by the lower image border
    changed = Tracks(
        tracks.track_id,
        boxes,
        np.array([LIGHT, CAR, CAR, CAR, CAR]),
        tracks.score,
        np.array([True, True, True, False, True]),
    )
    ranges = GroundPlane(CAMERA, SMOOTH).measure(changed, by_size, at(0.0)).distance_m
    assert np.isnan(ranges).tolist() == [True, True, True, True, False]


def test_outlier_has_little_effect_on_the_horizon():
    """A car on a bridge, 40 px too high, among five on the road."""
    tracks, by_size = cars_at([20.0, 30.0, 40.0, 50.0, 60.0])
    boxes = tracks.xyxy_px.copy()
    boxes[4, [1, 3]] -= 40.0
    with_outlier = Tracks(tracks.track_id, boxes, tracks.class_id, tracks.score, tracks.observed)
    plane = GroundPlane(CAMERA, SMOOTH)
    for k in range(10):
        ranges = plane.measure(with_outlier, by_size, at(0.1 * k, k))
    assert abs(plane.horizon.y_px - CY_PX) < 5.0
    assert ranges.distance_m[:3] == pytest.approx([20.0, 30.0, 40.0], rel=0.2)


def test_sigma_adapts_to_the_road():
    """Bottom edges with a scatter of 8 px (rough road) and without: the learnt pitch sigma
    differs."""
    sigma = {}
    for scatter_px in (0.0, 8.0):
        rng = np.random.default_rng(3)
        plane = GroundPlane(
            CAMERA, GroundSettings(height_m=HEIGHT_M, height_sigma_m=0.02, box_sigma_px=0.5)
        )
        for k in range(150):
            tracks, by_size = cars_at([15.0, 20.0, 30.0, 40.0, 50.0, 60.0])
            boxes = tracks.xyxy_px + np.array([0, 1, 0, 1]) * rng.normal(0, scatter_px, (6, 1))
            moved = Tracks(tracks.track_id, boxes, tracks.class_id, tracks.score, tracks.observed)
            ranges = plane.measure(moved, by_size, at(0.1 * k, k))
        sigma[scatter_px] = ranges.sigma_m[0]
    assert sigma[0.0] < 0.6 * sigma[8.0]


def test_sigma_is_calibrated_on_a_simulated_road():
    """Size errors of 6 %, constant per track; kerbs of 10 cm, pitch of 4 px, slopes of 5 px, box
    noise of 1 px."""
    rng = np.random.default_rng(5)
    in_sigmas = []
    for _ in range(60):
        plane = GroundPlane(CAMERA, GroundSettings.of_known_height(HEIGHT_M))
        true_m, kerb_m, wrong = (
            rng.uniform(10, 50, 6),
            rng.normal(0, 0.1, 6),
            rng.normal(0, 0.06, 6),
        )
        horizon_px, slope_px = CY_PX + rng.normal(0, 10), rng.normal(0, 5, 6)
        for k in range(20):
            tracks, by_size = cars_at(
                true_m, horizon_px=horizon_px + rng.normal(0, 4), size_error=wrong
            )
            boxes = (
                tracks.xyxy_px
                + rng.normal(0, 1, (6, 4))
                - np.array([0, 1, 0, 1]) * (F_PX * kerb_m / true_m + slope_px)[:, None]
            )
            moved = Tracks(tracks.track_id, boxes, tracks.class_id, tracks.score, tracks.observed)
            ranges = plane.measure(moved, by_size, at(0.1 * k, k))
            in_sigmas.append(np.abs(ranges.distance_m - true_m) / ranges.sigma_m)
    deviation = np.concatenate(in_sigmas)
    deviation = deviation[np.isfinite(deviation)]
    assert 0.60 < (deviation <= 1).mean() < 0.85
    assert 0.92 < (deviation <= 2).mean() < 0.999


@settings(deadline=None, max_examples=60)
@given(
    st.lists(
        st.tuples(st.floats(0, 1190), st.floats(0, 360), st.floats(2, 400), st.floats(2, 400)),
        max_size=12,
    )
)
def test_any_boxes_give_positive_distances_or_nan(boxes):
    xyxy_px = np.array([[x, y, x + w, y + h] for x, y, w, h in boxes]).reshape(-1, 4)
    n = len(xyxy_px)
    tracks = Tracks(np.arange(1, n + 1), xyxy_px, np.arange(n) % 8, np.ones(n), np.ones(n, bool))
    by_size_m = 900.0 / np.maximum(xyxy_px[:, 3] - xyxy_px[:, 1], 1.0)
    plane = GroundPlane(CAMERA)
    for k in range(3):
        ranges = plane.measure(
            tracks, Ranges(tracks.track_id, by_size_m, 0.1 * by_size_m), at(0.1 * k, k)
        )
        known = np.isfinite(ranges.distance_m)
        assert (np.isfinite(ranges.sigma_m) == known).all()
        assert (ranges.distance_m[known] > 0).all()
        assert (ranges.sigma_m[known] > 0).all()


def test_offset_from_contact_point_to_surface():
    boxes = np.array([[0, 0, 100, 100], [0, 0, 300, 100], [0, 0, 40, 100.0]])
    assert surface_offset_m(boxes, np.array([CAR, CAR, PERSON])) == pytest.approx(
        [0.03, 0.45, 0.05]
    )


def test_ranger_estimates_the_horizon_from_mono():
    ranger = GroundRanger(CAMERA, GroundSettings.of_known_height(HEIGHT_M))
    tracks, by_size = cars_at([20.0, 40.0, 60.0], horizon_px=CY_PX + 20.0)
    alone = ranger.measure(tracks, at(0.0))
    assert ranger.plane.horizon.y_px == pytest.approx(CY_PX, abs=1e-6)
    ranges = ranger.measure_with(tracks, at(0.0), {"mono": by_size})
    assert ranger.plane.horizon.y_px == pytest.approx(CY_PX + 20.0, abs=5.0)
    error = [np.abs(result.distance_m / [20.0, 40.0, 60.0] - 1)[0] for result in (alone, ranges)]
    assert error[1] < error[0] < 0.6


def road_view(horizon_px=CY_PX, sigma_px=0.5, **fields):
    return RoadView(
        horizon=(horizon_px - CY_PX) / F_PX, horizon_variance=(sigma_px / F_PX) ** 2, **fields
    )


def test_horizon_of_image_motion_replaces_sizes():
    """All cars are 20 % larger than their class, and the distances are right."""
    tracks, by_size = cars_at([12.0, 20.0, 30.0, 40.0], horizon_px=200.0, size_error=-0.17)
    ranger = GroundRanger(CAMERA, SMOOTH, is_reference=True)
    for k in range(10):
        ranger.update_road(road_view(200.0))
        ranges = ranger.measure_with(tracks, at(0.1 * k, k), {"mono": by_size})
    assert ranges.distance_m == pytest.approx([12.0, 20.0, 30.0, 40.0], rel=0.02)
    assert not ranges.is_fallback
    without = GroundRanger(CAMERA, SMOOTH).measure_with(tracks, at(0.0), {"mono": by_size})
    assert without.is_fallback
    assert np.abs(without.distance_m / [12.0, 20.0, 30.0, 40.0] - 1).max() > 0.05


@pytest.mark.parametrize("curvature_per_m", [-3e-4, 3e-4])
def test_contact_points_on_a_curved_road(curvature_per_m):
    """By hand: y = y0 + f H / d - f k share(d) d / 2."""
    distance_m = np.array([15.0, 30.0, 45.0])
    tracks, by_size = cars_at(distance_m)
    raised_px = F_PX * curvature_per_m * curvature_fraction(distance_m) * distance_m / 2
    boxes = tracks.xyxy_px - raised_px[:, None] * [0.0, 1.0, 0.0, 1.0]
    raised = Tracks(tracks.track_id, boxes, tracks.class_id, tracks.score, tracks.observed)
    plane = GroundPlane(CAMERA, SMOOTH)
    plane.update_road(
        road_view(curvature_per_m=curvature_per_m, curvature_variance=1e-10), bias_sigma=0.06
    )
    assert plane.measure_alone(raised, at(0.0)).distance_m == pytest.approx(distance_m, rel=0.01)
    assert plane.measure(raised, by_size, at(0.0)).distance_m == pytest.approx(distance_m, rel=0.02)


def test_slope_of_the_horizon():
    """A car 300 px to the right of the middle, where the horizon is 300 * 0.02 = 6 px lower."""
    tracks, _ = cars_at([20.0])
    boxes = tracks.xyxy_px + np.array([300.0, 6.0, 300.0, 6.0])
    moved = Tracks(tracks.track_id, boxes, tracks.class_id, tracks.score, tracks.observed)
    plane = GroundPlane(CAMERA, SMOOTH)
    plane.update_road(road_view(slope=0.02), bias_sigma=0.06)
    assert plane.measure_alone(moved, at(0.0)).distance_m == pytest.approx([20.0], rel=0.02)


def test_scale_of_the_drive_is_measured_by_image_motion():
    scale = DriveScale()
    ranger = GroundRanger(CAMERA, SMOOTH, is_reference=True)
    for k in range(30):
        tracks, by_size = cars_at(np.linspace(10.0, 40.0, 12), size_error=-0.09)
        ranger.update_road(road_view())
        mono = {"mono": scale.corrected(by_size, tracks.class_id)}
        evidence = ranger.measure_at_scale(tracks, at(0.1 * k, k), mono, scale).evidence
        scale = scale.after([ScaleEvidence(tracks.class_id, by_size), evidence], 0.1 * k)
    assert scale.bias_of("car").log_factor == pytest.approx(-np.log(0.91), abs=0.02)
    without_height = GroundRanger(CAMERA)
    without_height.update_road(road_view())
    assert (
        without_height.measure_at_scale(tracks, at(0.0), {"mono": by_size}, DriveScale()).evidence
        is None
    )


def test_lane_lines_are_ignored_where_image_motion_shows_the_road():
    plane = GroundPlane(CAMERA, SMOOTH)
    plane.update_road(road_view(190.0), bias_sigma=0.06)
    plane.add_horizon(150.0, 1.0)
    assert plane.horizon.y_px == pytest.approx(190.0)


def test_lane_lines_are_ignored_where_the_cars_show_the_horizon():
    """Lines of kerbs and shadows meet 60 px above it; lines that meet near it are used."""
    tracks, by_size = cars_at([10.0, 15.0, 20.0, 30.0, 40.0, 50.0], horizon_px=190.0)
    plane = GroundPlane(CAMERA, SMOOTH)
    plane.measure(tracks, by_size, at(0.0))
    without = plane.horizon
    plane.add_horizon(130.0, 1.0)
    assert plane.horizon == without
    plane.add_horizon(192.0, 1.0)
    assert plane.horizon.sigma_px < 0.95 * without.sigma_px


def test_measured_camera_height():
    """With a height of image motion and a known speed, distances are independent of sizes, which
    are 20 % wrong."""
    tracks, by_size = cars_at([12.0, 20.0, 30.0], height_m=1.3, size_error=-0.17)
    ranger = GroundRanger(CAMERA, replace(SMOOTH, height_m=1.5, height_sigma_m=0.3))
    for k in range(5):
        ranger.update_road(road_view(height_m=(1.3, 0.03)))
        ranges = ranger.measure_with(tracks, at(0.1 * k, k), {"mono": by_size})
    assert not ranges.is_fallback
    assert ranges.distance_m == pytest.approx([12.0, 20.0, 30.0], rel=0.04)
    known = GroundRanger(CAMERA, SMOOTH, is_reference=True)
    known.update_road(road_view(height_m=(1.3, 0.03)))
    assert known.plane.horizon.height_m == pytest.approx(HEIGHT_M)  # a given height stays


def test_tyres_of_a_detected_car_are_behind_its_bumper():
    """The bottom edge is at 20.6 m, the bumper at 20 m; seen from the side, tyres and surface are
    at one depth."""
    tracks, _ = cars_at([20.6])
    plane = GroundPlane(CAMERA, replace(SMOOTH, has_visible_boxes=True))
    plane.update_road(road_view(), bias_sigma=0.06)
    assert plane.measure_alone(tracks, at(0.0)).distance_m == pytest.approx([20.03], abs=0.05)
    side = np.array([[0.0, 0.0, 220.0, 100.0], [0.0, 0.0, 100.0, 100.0]])
    offset_m = surface_offset_m(side, np.array([CAR, CAR]), has_visible_boxes=True)
    assert offset_m == pytest.approx([0.45, 0.03 - 0.6])
    assert surface_offset_m(side[1:], np.array([PERSON]), has_visible_boxes=True) == pytest.approx(
        [0.05]
    )


def test_distances_with_and_without_the_other_objects_at_once():
    """As one after the other, also after a track has left and the lane lines have decayed."""
    planes = [GroundPlane(CAMERA, SMOOTH) for _ in range(2)]
    for k, distance_m in enumerate(([12.0, 20.0, 30.0], [12.0, 20.0], [])):
        tracks, by_size = cars_at(np.array(distance_m), size_error=-0.1)
        for plane in planes:
            plane.update_road(road_view(curvature_per_m=1e-4), bias_sigma=0.06)
        alone = planes[0].measure_alone(tracks, at(0.1 * k))
        of_all = planes[0].measure(tracks, by_size, at(0.1 * k))
        both = planes[1].measure_both(tracks, by_size, at(0.1 * k))
        for ranges, expected in zip(both, (of_all, alone), strict=True):
            np.testing.assert_allclose(ranges.distance_m, expected.distance_m, rtol=1e-12)
            np.testing.assert_allclose(ranges.sigma_m, expected.sigma_m, rtol=1e-12)
            assert not ranges.is_fallback
    assert planes[0].horizon == planes[1].horizon
