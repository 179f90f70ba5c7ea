"""Surrogate measures of safety: hand-worked numbers, objects beside the path, lanes, the lead,
exposure and PET."""

import math

import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.lanes.lines import LaneLine, LaneLines
from track_range.ranging.warning.safety import SafetyMonitor, lane_edges_m, post_encroachment_s
from track_range.ranging.warning.settings import WarningSettings
from track_range.ranging.warning.warnings import Warnings
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.tracking.tracks import Tracks

PERSON, CAR, SIGN = (ROAD_CLASSES.index(name) for name in ("person", "car", "traffic sign"))


def measured(
    distance_m,
    closing_mps,
    *,
    offset_m=0.0,
    class_id=CAR,
    time_s=0.0,
    ego_mps=20.0,
    monitor=None,
    **more,
):
    """Measures of one frame; scalars are those of all tracks."""
    d, c, o, k, sigma, p = np.broadcast_arrays(
        distance_m,
        closing_mps,
        offset_m,
        class_id,
        more.get("closing_sigma_mps", 0.1),
        more.get("probability", 0.0),
    )
    n = d.size
    warnings = Warnings(
        np.reshape(p, n),
        np.zeros(n, bool),
        np.reshape(o, n),
        np.full(n, more.get("offset_sigma_m", 0.1)),
    )
    tracks = Tracks(
        np.arange(n),
        np.tile([100.0, 100.0, 200.0, 160.0], (n, 1)),
        np.reshape(k, n),
        np.ones(n),
        np.ones(n, bool),
    )
    d, c, sigma = (np.reshape(values, n).astype(float) for values in (d, c, sigma))
    ttc_s = d / np.where(c > 0, c, np.nan)
    return (monitor or SafetyMonitor()).update(
        tracks,
        time_s,
        distance_m=d,
        closing_mps=c,
        ttc_s=np.array([ttc_s, ttc_s * sigma / c]),
        ego_mps=ego_mps,
        warnings=warnings,
        lane_edges_m=more.get("lane_edges_m"),
    )


def test_by_hand():
    found = measured([21.5], [10.0])  # 20 m before the front, which is 1.5 m ahead of the camera
    assert found.gap_m[0] == pytest.approx(20.0)
    assert found.ttc_front_s[0] == pytest.approx(2.0)
    assert found.headway_s[0] == pytest.approx(1.0)
    assert found.drac_mps2[0] == pytest.approx(2.5)  # c^2 / 2 g
    assert found.mdrac_mps2[0] == pytest.approx(5.0)  # c / 2 (TTC - 1 s)


def test_measures_of_the_path_are_of_objects_on_the_path():
    # both are 1.8 m wide
    found = measured([21.5] * 4, [10.0] * 4, offset_m=[1.7, 1.9, -1.9, np.nan])
    for values in (found.headway_s, found.drac_mps2, found.mdrac_mps2, found.ttc_front_s):
        assert np.isfinite(values).tolist() == [True, False, False, False]
    assert found.gap_m == pytest.approx([20.0] * 4)
    sign = measured([21.5], [10.0], class_id=SIGN)
    assert np.isnan([sign.headway_s[0], sign.drac_mps2[0], sign.ttc_front_s[0]]).all()


def test_a_wider_ego_vehicle_has_more_objects_on_its_path():
    for width_m, is_on_path in ((1.8, False), (2.5, True)):
        monitor = SafetyMonitor(WarningSettings(ego_width_m=width_m))
        assert (
            np.isfinite(measured([21.5], [10.0], offset_m=2.0, monitor=monitor).drac_mps2[0])
            == is_on_path
        )


def test_ttc_of_those_who_will_be_on_the_path():
    likely, unlikely = measured(
        [21.5] * 2, [10.0] * 2, offset_m=4.0, class_id=PERSON, probability=[0.6, 0.4]
    ).ttc_front_s
    assert likely == pytest.approx(2.0)
    assert math.isnan(unlikely)


def test_no_ttc_of_a_far_object_whose_place_is_not_known():
    """1 m beside the middle of the path, with a sigma of 0.5 and of 4 m."""
    for sigma_m, is_known in ((0.5, True), (4.0, False)):
        found = measured([101.5], [20.0], offset_m=1.0, offset_sigma_m=sigma_m)
        assert np.isfinite(found.ttc_front_s[0]) == is_known
        assert np.isfinite(found.drac_mps2[0])


def test_no_ttc_where_the_motion_is_too_uncertain_for_a_probability():
    found = measured([21.5] * 2, [10.0] * 2, probability=[0.0, np.nan])
    assert np.isfinite(found.ttc_front_s).tolist() == [True, False]


def test_no_ttc_without_a_significant_closing_speed():
    found = measured([21.5] * 3, [1.0, 1.0, -2.0], closing_sigma_mps=[0.4, 0.6, 0.1])
    assert np.isfinite(found.ttc_front_s).tolist() == [True, False, False]
    assert np.isfinite(found.drac_mps2).tolist() == [True, True, False]


def test_unknown_or_low_ego_speed_has_no_headway():
    assert math.isnan(measured([21.5], [10.0], ego_mps=math.nan).headway_s[0])
    assert math.isnan(measured([21.5], [10.0], ego_mps=0.2).headway_s[0])


def test_the_lead_is_the_next_vehicle_ahead():
    # a person, an oncoming car, two cars ahead, and a nearer one in the next lane
    found = measured(
        [8.0, 10.0, 40.0, 30.0, 12.0],
        [20.0, 35.0, 2.0, 1.0, 0.0],
        offset_m=[0.0, 0.0, 0.0, 0.5, 3.5],
        class_id=[PERSON, CAR, CAR, CAR, CAR],
    )
    assert found.is_lead.tolist() == [False, False, False, True, False]


def test_exposure_by_hand():
    monitor = SafetyMonitor()
    for i in range(21):  # TTC from 4 s to 2 s, below 3 s in the last ten frames
        found = measured([41.5 - i], [10.0], time_s=0.1 * i, monitor=monitor)
    assert found.tet_s[0] == pytest.approx(1.0)
    assert found.tit_s2[0] == pytest.approx(sum(0.1 * 0.1 * k for k in range(1, 11)))


def test_lanes():
    found = measured([20.0] * 5, [0.0] * 5, offset_m=[-3.4, -0.5, 3.4, 8.0, np.nan])
    assert found.lane_index == pytest.approx([-1, 0, 1, np.nan, np.nan], nan_ok=True)
    assert (found.lane_index_sigma[:3] < 0.1).all()
    edge, unsure = (
        measured([20.0], [0.0], offset_m=1.7, offset_sigma_m=s).lane_index_sigma[0]
        for s in (0.1, 2.0)
    )
    assert 0.5 < edge < 0.75
    assert unsure > edge - 0.1


def test_lane_lines_move_the_lanes():
    camera = PinholeCamera(700.0, 700.0, 320.0, 180.0, 640, 360)

    def line(x_px):
        return LaneLine(np.array([x_px, 0.0, 0.0]), np.eye(3), 200.0, 340.0)

    # a quarter of the lane to the left
    edges = lane_edges_m(LaneLines(line(240.0), line(560.0)), camera)
    assert edges == pytest.approx((-0.875, 2.625))
    assert lane_edges_m(LaneLines(line(240.0), None), camera) is None
    assert lane_edges_m(LaneLines(line(340.0), line(560.0)), camera) is None
    shifted = measured([20.0], [0.0], offset_m=2.3, lane_edges_m=edges).lane_index[0]
    assert (shifted, measured([20.0], [0.0], offset_m=2.3).lane_index[0]) == (0, 1)


def ego_path(speed_mps=10.0, n=61, start_s=0.0):
    t = start_s + 0.1 * np.arange(n)
    return np.stack([t, speed_mps * (t - start_s), 0 * t], axis=1)


def crossing(start_s, *, x_m=40.0, speed_mps=2.0, n=40, from_m=-4.0):
    t = start_s + 0.1 * np.arange(n)
    return np.stack([t, np.full(n, x_m), from_m + speed_mps * (t - start_s)], axis=1)


def test_pet_of_a_person_who_crosses_before():
    # leaves the path of 2 x 1.2 m at 2.6 s; the front is there at 3.85 s
    pet_s = post_encroachment_s(ego_path(), crossing(0.0), half_width_m=0.3)
    assert pet_s == pytest.approx((40 - 1.5) / 10 - 2.6, abs=0.11)


def test_pet_of_a_person_who_crosses_behind():
    # enters the path at 4.5 + 1.4 s, when the rear, 2.7 m behind the camera, has left at 4.27 s
    pet_s = post_encroachment_s(ego_path(), crossing(4.5, n=41), half_width_m=0.3)
    assert pet_s == pytest.approx(5.9 - 4.27, abs=0.11)


def test_no_pet_without_a_crossing():
    ego = ego_path()
    # ends before the path
    assert math.isnan(post_encroachment_s(ego, crossing(0.0, n=15), half_width_m=0.3))
    assert math.isnan(post_encroachment_s(ego, crossing(0.0, n=22), half_width_m=0.3))  # ends on it
    # where nobody drove
    assert math.isnan(post_encroachment_s(ego, crossing(0.0, x_m=90.0), half_width_m=0.3))
    assert math.isnan(post_encroachment_s(ego[:1], crossing(0.0), half_width_m=0.3))
    back = crossing(0.0, n=41)
    back[21:, 2] = back[20::-1, 2][:20]  # steps on the path and goes back
    assert math.isnan(post_encroachment_s(ego, back, half_width_m=0.3))
