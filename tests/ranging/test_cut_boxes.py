"""Boxes cut by the left or right image border: hand-worked geometry, a passing car, and KITTI's
labels."""

import math

import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.video_labels.kitti import read_kitti
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.filtering.cut_boxes import CutBoxes, SideState
from track_range.ranging.filtering.distance_filter import DistanceFilters
from track_range.ranging.filtering.observation import Observation
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.truth.reference_distance import surface_distance_m
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.tracking.tracks import Tracks

CAMERA = PinholeCamera(500.0, 500.0, 500.0, 200.0, 1001, 401)  # bearings -1 to 1


def boxes(left, right, *, name="car", observed=True):
    """Tracks with boxes from the bearing `left` to `right`, 40 px high."""
    xyxy_px = np.array([[500 + 500 * left, 180, 500 + 500 * right, 220]])
    return Tracks(
        np.array([1]),
        xyxy_px,
        np.array([ROAD_CLASSES.index(name)]),
        np.ones(1),
        np.array([observed]),
    )


def test_ratio_of_a_side_along_the_axis():
    # A side 3 m to the left: 5 m away in the middle of the box (-0.6), 15 m at its free edge
    # (-0.2).
    cut = CutBoxes.of(boxes(-1.0, -0.2), CAMERA)
    assert cut.is_cut[0]
    assert 5 / (1 - cut.q[0]) == pytest.approx(15)
    assert CutBoxes.of(boxes(0.2, 1.0), CAMERA).q == pytest.approx(cut.q)


@pytest.mark.parametrize(
    ("left", "right", "observed", "is_cut", "q"),
    [
        (-0.8, -0.2, True, False, 0.6),  # whole
        (-1.0, -0.2, False, False, 2 / 3),  # predicted
        (-1.0, 1.0, True, False, 0.0),  # cut on both sides: no edge is free
        # the free edge is beyond the axis: the ray meets the near end
        (-1.0, 0.1, True, True, 0.0),
        (-0.2, 1.0, True, True, 0.0),
    ],
)
def test_which_boxes_are_cut(left, right, observed, is_cut, q):
    cut = CutBoxes.of(boxes(left, right, observed=observed), CAMERA)
    assert cut.is_cut[0] == is_cut
    assert cut.q[0] == pytest.approx(q)


def of_m(value):
    return np.array([[float(value)]])


def test_prediction_of_a_slide_by_hand():
    # Side 3 m to the left, far end from 15 to 12 m in 0.3 s: the free edge goes from -0.2 to -0.25,
    # the middle of the box from -0.6 to -0.625, where the side is 3 / 0.625 = 4.8 m away.
    before = CutBoxes.of(boxes(-1.0, -0.2), CAMERA)
    cut = CutBoxes(
        before.is_cut,
        np.array([1 - 0.25 / 0.625]),
        np.zeros(1),
        np.array([20.0]),
        np.array([-0.625]),
    )
    side = SideState(of_m(1), of_m(0), of_m(0), of_m(1e-12))
    state = ConstantVelocity(of_m(5), of_m(-10), of_m(0.01), of_m(0), of_m(0.04))
    predicted, _, _ = side.predict(state, before.q, cut, of_m(0.3), noise=0.0)
    assert predicted.x[0, 0] == pytest.approx(4.8)
    assert predicted.v[0, 0] == -10
    # Variances: z_f = 3 d with 0.09, plus 0.3^2 0.04 by the speed; d = 0.4 z_f. The turn of k adds
    # about 1 m^2.
    assert predicted.P_xx[0, 0] == pytest.approx(
        0.4**2 * (0.09 + 0.0036) + (12 * 0.6 * 0.25) ** 2 * 0.3, rel=1e-6
    )
    assert predicted.P_xv[0, 0] == pytest.approx(0.4 * 0.3 * 0.04)


def test_near_end_is_predicted_as_without_a_cut():
    # The side's far end would be 20 m behind the near one: a car is shorter, so that the ray meets
    # its near end.
    cut = CutBoxes.of(boxes(-1.0, -0.1), CAMERA)
    side = SideState(of_m(1), of_m(0), of_m(0), of_m(0.04))
    state = ConstantVelocity(of_m(5), of_m(-10), of_m(0.01), of_m(0), of_m(0.04))
    predicted, _, edge_variance = side.predict(state, cut.q, cut, of_m(0.1), noise=1.0)
    expected = state.predict(of_m(0.1), q=1.0)
    np.testing.assert_allclose(predicted.columns, expected.columns)
    assert edge_variance == 0


def passing(x_m, *, heading_deg=0.0, knows_cuts=True):
    """Whether a car of 4.2 m by 1.7 m that passes at 6 m/s is cut, and its closing speed with
    sigma, by frame."""
    rng = np.random.default_rng(3)
    filters, found = DistanceFilters({"a": 0.5}), []
    heading = math.radians(heading_deg)
    for i in range(80):
        z_m = 9.0 - 0.05 * i * 6.0
        along, across = (
            (math.sin(heading), math.cos(heading)),
            (math.cos(heading), -math.sin(heading)),
        )
        x, z = (
            np.array([x_m, z_m])
            + np.array([[2.1], [2.1], [-2.1], [-2.1]]) * along
            + np.array([[0.85], [-0.85], [0.85], [-0.85]]) * across
        ).T  # corners
        bearings = x / np.maximum(z, 0.5)
        edges = np.clip([bearings.min(), bearings.max()], -1, 1)
        if edges[1] - edges[0] < 0.05:
            break
        ray = np.array([[edges.mean(), 0.0, 1.0]])
        centre, size = np.array([[x_m, 1.0, z_m]]), np.array([[2.0, 1.7, 4.2]])
        true_m = surface_distance_m(
            ray, centre, size_hwl_m=size, rotation_y_rad=np.array([heading - math.pi / 2])
        )[0]
        tracks = boxes(*edges)
        measured = Ranges(
            tracks.track_id,
            np.array([true_m * (1 + 0.005 * rng.normal())]),
            np.array([true_m * 0.01]),
        )
        cut = CutBoxes.of(tracks, CAMERA)
        filtered = filters.update(
            {"a": measured},
            0.05 * i,
            observation=Observation(cut=cut if knows_cuts else None),
            ego=EgoMotion(6.0),
        )["a"]
        found.append((bool(cut.is_cut[0]), -filtered.rate_mps[0], filtered.rate_sigma_mps[0]))
    return np.array(found)


@pytest.mark.parametrize(
    ("x_m", "heading_deg"), [(-2.5, 0.0), (-3.5, 0.0), (-3.0, 3.0), (-3.0, -5.0)]
)
def test_closing_speed_of_a_car_that_is_passed(x_m, heading_deg):
    is_cut, closing_mps, sigma_mps = passing(x_m, heading_deg=heading_deg).T
    cut = is_cut > 0
    assert cut.sum() > 10
    assert np.mean(np.isfinite(closing_mps[cut])) > 0.5
    error_mps, sigma_mps = (
        part[cut & np.isfinite(closing_mps)] for part in (np.abs(closing_mps - 6.0), sigma_mps)
    )
    assert np.median(error_mps) < 1.0
    assert np.mean(error_mps < 2 * sigma_mps) > 0.85
    assert 0.1 < np.median(sigma_mps) < 1.5
    _, without_mps, _ = passing(x_m, heading_deg=heading_deg, knows_cuts=False).T
    assert np.nanmedian(np.abs(without_mps - 6.0)[cut]) > 2.0


def border_errors(labels, camera, shift_m):
    """Errors of the closing speed of cars at the border in sigmas, by surface distances with 1 % of
    noise.

    True is the slope of the centre's z over half a second before and after.
    """
    rng, step_s, found = np.random.default_rng(4), 0.1036, []
    labels = labels.select((labels.kitti_type == "Car") & labels.has_3d_box)
    location_m = labels.location_m + shift_m
    middle = (labels.xyxy_px[:, :2] + labels.xyxy_px[:, 2:]) / 2
    size = {"size_hwl_m": labels.size_hwl_m, "rotation_y_rad": labels.rotation_y_rad}
    true_m = surface_distance_m(camera.rays(middle), location_m, **size)
    distance_m, filters = (
        true_m * (1 + 0.01 * rng.normal(size=len(true_m))),
        DistanceFilters({"a": 0.5}),
    )
    for frame in range(labels.frame.max() + 1):
        rows = np.flatnonzero(labels.frame == frame)
        ids, n = labels.track_id[rows] + 1, len(rows)
        tracks = Tracks(
            ids,
            labels.xyxy_px[rows],
            np.full(n, ROAD_CLASSES.index("car")),
            np.ones(n),
            np.ones(n, bool),
        )
        measured = Ranges(ids, distance_m[rows], 0.02 * distance_m[rows])
        observation = Observation(cut=CutBoxes.of(tracks, camera))
        filtered = filters.update({"a": measured}, frame * step_s, observation=observation)["a"]
        for row, rate, sigma in zip(rows, filtered.rate_mps, filtered.rate_sigma_mps, strict=True):
            near = (labels.track_id == labels.track_id[row]) & (np.abs(labels.frame - frame) <= 5)
            x1, _, x2, _ = labels.xyxy_px[row]
            if (x1 < 1.5 or x2 > camera.width_px - 2.5) and near.sum() >= 6:
                slope = np.polyfit(labels.frame[near] * step_s, location_m[near, 2], 1)[0]
                found.append((rate - slope, sigma))
    return np.array(found).T


@pytest.mark.real
def test_closing_speed_at_the_border_on_kitti(shared_data):
    folder = shared_data / "kitti_labels" / "label_02"
    if not folder.is_dir():
        pytest.skip(f"real data not here: no folder {folder}")
    camera = PinholeCamera(721.5377, 721.5377, 609.5593, 172.854, 1242, 375)
    parts = [
        border_errors(read_kitti(folder / f"{n}.txt"), camera, np.array([0.06, 0, 0.003]))
        for n in ("0001", "0009")
    ]
    error_mps, sigma_mps = np.concatenate(parts, axis=1)
    is_known = np.isfinite(error_mps)
    assert len(error_mps) > 600
    assert 0.8 < is_known.mean() < 1.0
    assert np.median(np.abs(error_mps[is_known])) < 0.5
    assert 0.88 < np.mean(np.abs(error_mps) < 2 * sigma_mps, where=is_known) < 0.999
    assert 0.2 < np.median(sigma_mps[is_known]) < 1.5
