from dataclasses import replace

import numpy as np
import pytest

from tests.support.images.lane_roads import (
    CENTRE_PX,
    FOCAL_PX,
    HORIZON_PX,
    HW,
    picture,
    row_px,
    width_px,
)
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.lanes.edges import EdgeLaneFinder
from track_range.detection.lanes.lines import LaneLine, LaneLines
from track_range.foundation.sparse_flow import BackgroundFlow
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.lane_width import LaneWidthRanger, inflated_by_disagreement
from track_range.ranging.size_models.drive_scale import DriveScale
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.ego_motion import CameraStep
from track_range.tracking.tracks import Tracks

CAMERA = PinholeCamera(FOCAL_PX, FOCAL_PX, CENTRE_PX, HORIZON_PX, HW[1], HW[0])
CAR = ROAD_CLASSES.index("car")
FRAME = Frame(7, 0.0, np.zeros((*HW, 3), np.uint8), None)


def lines(lane_m=3.5, *, sigma_px=0.0, rows=(190.0, 355.0)):
    """A lane from a camera height of 1.5 m: x = 320 -+ lane / 2 / 1.5 (y - 170)."""
    slope = lane_m / 2 / 1.5
    covariance = np.diag([sigma_px**2, 0.0, 0.0])
    return LaneLines(
        *(
            LaneLine(np.array([320 - side * slope * 170, side * slope, 0.0]), covariance, *rows)
            for side in (-1, 1)
        )
    )


def boxes_at(*distance_m, lanes_to_the_right=0.0, class_id=CAR, observed=True):
    """Boxes with their bottom edges on the ground at these distances."""
    y = row_px(np.array(distance_m))
    x = CENTRE_PX + lanes_to_the_right * width_px(y)
    n = len(y)
    return Tracks(
        np.arange(1, n + 1),
        np.stack([x - 10, y - 20, x + 10, y], axis=1),
        np.full(n, class_id),
        np.ones(n),
        np.full(n, observed),
    )


def measured(tracks, lane_lines=None, *, width_m=3.5, **more):
    ranger = LaneWidthRanger(CAMERA, width_m=width_m, **more)
    ranger.update_lanes(lane_lines or lines())
    return ranger.measure(tracks, FRAME)


def test_by_hand():
    """500 px x 3.5 m / (3.5 / 1.5 x (220 - 170) = 116.67 px) = 15 m; the tail of a car is 3 cm
    behind the contact."""
    box = Tracks(
        np.array([1]),
        np.array([[310.0, 200, 330, 220]]),
        np.array([CAR]),
        np.ones(1),
        np.ones(1, bool),
    )
    assert measured(box).distance_m == pytest.approx([15.03])
    # the box ends at the tyres
    assert measured(box, has_visible_boxes=True).distance_m == pytest.approx([14.43])


def test_distances_and_another_lane_width():
    true_m = np.array([5.0, 10.0, 20.0, 30.0])
    assert measured(boxes_at(*true_m)).distance_m == pytest.approx(true_m + 0.03)
    assert measured(boxes_at(*true_m), lines(3.0), width_m=3.0).distance_m == pytest.approx(
        true_m + 0.03
    )
    assert measured(boxes_at(*true_m), lines(3.0)).distance_m == pytest.approx(
        true_m * 3.5 / 3.0 + 0.03
    )


def test_sigma_by_error_propagation():
    ranges = measured(boxes_at(15.0), lines(sigma_px=2.0), width_sigma=0.06, box_sigma_px=1.5)
    width = 3.5 / 1.5 * 50
    # of the bottom edge, and of the row in which the lines meet
    row_px = np.hypot(1.5, 0.004 * FOCAL_PX)
    parts = (2 * np.sqrt(2) / width, 0.06, 3.5 / 1.5 * row_px / width, 0.01)
    assert ranges.sigma_m == pytest.approx([15 * np.sqrt(np.sum(np.square(parts)))])


def test_ego_and_neighbouring_lanes_only():
    for lanes_to_the_right, is_measured in (
        (0.0, True),
        (-1.0, True),
        (1.0, True),
        (-2.0, False),
        (2.0, False),
    ):
        ranges = measured(boxes_at(15.0, lanes_to_the_right=lanes_to_the_right))
        assert np.isfinite(ranges.distance_m).tolist() == [is_measured]


def test_unmeasurable_boxes_are_nan():
    def is_nan(tracks, lane_lines=None):
        ranges = measured(tracks, lane_lines)
        assert np.isnan(ranges.sigma_m).tolist() == np.isnan(ranges.distance_m).tolist()
        return np.isnan(ranges.distance_m).all()

    assert is_nan(boxes_at(15.0, observed=False))
    assert is_nan(boxes_at(15.0, class_id=ROAD_CLASSES.index("traffic light")))
    assert is_nan(boxes_at(3.98))  # the bottom edge, row 358.4, is at the image border
    assert is_nan(boxes_at(-30.0))  # above the horizon
    assert is_nan(boxes_at(15.0), LaneLines())
    assert is_nan(boxes_at(15.0), LaneLines(lines().left, None))
    assert len(measured(Tracks.empty())) == 0


def test_extrapolation_is_limited():
    lane_lines = lines(rows=(row_px(12.0), 355.0))
    ranges = measured(boxes_at(12.0, 23.9, 24.1), lane_lines)
    assert np.isfinite(ranges.distance_m).tolist() == [True, True, False]
    near_unseen = lines(rows=(190.0, row_px(20.0)))
    assert np.isfinite(measured(boxes_at(9.9, 10.1), near_unseen).distance_m).tolist() == [
        False,
        True,
    ]


def test_uncertain_lines_measure_nothing():
    assert np.isnan(measured(boxes_at(15.0), lines(sigma_px=40.0)).distance_m).all()


def test_nothing_is_measured_without_lines():
    assert np.isnan(LaneWidthRanger(CAMERA).measure(boxes_at(15.0), FRAME).distance_m).all()


def test_cache_depends_on_lines_and_tracks():
    ranger, tracks = LaneWidthRanger(CAMERA, width_m=3.5), boxes_at(15.0)
    for lane_lines in (lines(), LaneLines(), lines()):
        ranger.update_lanes(lane_lines)
        expected = measured(tracks, lane_lines).distance_m
        assert ranger.measure(tracks, FRAME).distance_m == pytest.approx(expected, nan_ok=True)
    assert ranger.measure(boxes_at(12.0, 20.0), FRAME).distance_m == pytest.approx(
        [12.0, 20.0], rel=0.01
    )


def learn(
    ranger,
    lane_m,
    n_frames,
    source="mono",
    *,
    noise=0.02,
    first=0,
    scale=None,
    bias=1.0,
    sigma=0.02,
):
    """Ranges of the last frame; each frame has two cars whose distances by another method have the
    factor `bias`."""
    rng = np.random.default_rng(2)
    for i in range(first, first + n_frames):
        frame = Frame(i, i * 0.1, FRAME.left, None)
        y = row_px(np.array([12.0, 20.0]))
        tracks = Tracks(
            np.array([2 * i, 2 * i + 1]),  # new ones in each frame
            np.stack([CENTRE_PX - 10 + 0 * y, y - 20, CENTRE_PX + 10 + 0 * y, y], axis=1),
            np.full(2, CAR),
            np.ones(2),
            np.ones(2, bool),
        )
        ranger.update_lanes(lines(lane_m))
        other_m = bias * np.array([12.0, 20.0]) * (1 + noise * rng.standard_normal(2))
        others = {source: Ranges(tracks.track_id, other_m, sigma * other_m)}
        ranges = ranger.measure_at_scale(tracks, frame, others, scale or DriveScale()).ranges
    return ranges


def test_width_is_learnt_from_stereo():
    ranger = LaneWidthRanger(CAMERA, width_from="stereo")
    assert learn(ranger, 4.0, 20, "stereo").distance_m == pytest.approx([12.0, 20.0], rel=0.02)
    assert ranger.lane.width_m == pytest.approx(4.0, rel=0.02)
    assert 0.014 < ranger.lane.sigma < 0.03
    learn(ranger, 6.5, 1200, "stereo", first=20)  # another lane, for two minutes
    assert ranger.lane.width_m == pytest.approx(6.5, rel=0.02)


def test_scale_of_sizes_is_not_taken_for_the_width():
    """All sizes are 8 % too large, which the width follows by the ratio of the variances; sigma
    contains the rest."""
    ranger = LaneWidthRanger(CAMERA, width_m=3.5, width_sigma=0.12, width_from="mono")
    ranges = learn(ranger, 3.5, 60, bias=1.08, sigma=0.1)
    bias_sigma = DriveScale().bias_of("car").sigma
    gain = 0.12**2 / (0.12**2 + bias_sigma**2)
    assert ranger.lane.width_m == pytest.approx(3.5 * 1.08**gain, rel=0.01)
    assert ranger.lane.sigma == pytest.approx(0.12 * np.sqrt(1 - gain), rel=0.1)
    assert (np.abs(ranges.distance_m - [12.0, 20.0]) < ranges.sigma_m).all()


def test_own_size_does_not_affect_the_distance():
    """The first of three cars is 40 % larger than its class; its distance by lane has the width of
    the others."""
    others = {
        "mono": Ranges(np.array([1, 2, 3]), np.array([8.0, 20.0, 15.0]), np.array([0.8, 2.0, 1.5]))
    }
    distances_m = []
    for first_m in (8.0, 11.0):
        others["mono"].distance_m[0] = first_m
        ranger = LaneWidthRanger(CAMERA, width_m=3.5, width_from="mono")
        ranger.update_lanes(lines())
        distances_m.append(
            ranger.measure_with(boxes_at(12.0, 20.0, 15.0), FRAME, others).distance_m
        )
    assert distances_m[0][0] == pytest.approx(distances_m[1][0], rel=0.01)
    assert distances_m[0][0] == pytest.approx(12.0, rel=0.02)


def test_lines_of_two_lanes_measure_nothing():
    ranger = LaneWidthRanger(CAMERA, width_from="mono")
    assert np.isnan(learn(ranger, 7.0, 10, sigma=0.06).distance_m).all()
    assert ranger.summary() == {}  # which would not be valid JSON
    assert np.isfinite(
        learn(LaneWidthRanger(CAMERA, width_from="mono"), 4.1, 10, sigma=0.06).distance_m
    ).all()


@pytest.mark.parametrize(("power", "is_lane"), [(0.0, True), (0.2, True), (0.7, False)])
def test_lane_is_equally_wide_at_all_objects(power, is_lane):
    """Distances by size grow faster than those by the lines, as where the lines meet below the
    horizon: widths of 3.5 m x 0.6 at 10 m, x 1.6 at 40 m, and 3.5 m on average."""
    true_m = np.array([10.0, 15.0, 20.0, 25.0, 30.0, 40.0])
    tracks, ranger = boxes_at(*true_m), LaneWidthRanger(CAMERA, width_m=3.5, width_from="mono")
    by_size_m = true_m * (true_m / 20.0) ** power
    others = {"mono": Ranges(tracks.track_id, by_size_m, 0.09 * by_size_m)}
    ranger.update_lanes(lines())
    ranges = ranger.measure_with(tracks, FRAME, others)
    assert (np.isfinite(ranges.distance_m) == is_lane).all()


def test_prior_by_region_and_speed():
    still = BackgroundFlow()
    still.add(np.zeros((*HW, 3), np.uint8), np.zeros((0, 4)))
    step = CameraStep(
        time_s=0.1,
        dt_s=0.1,
        rotation=np.eye(3),
        rotation_sigma_rad=0.001,
        travel=np.array([0.0, 0.0, 1.0]),
        travelled_m=3.0,
        travelled_sigma=0.03,
        now=still.now,
    )
    for region, slow_m, fast_m in (("europe", 3.5, 3.6), ("north-america", 3.5, 3.66)):
        ranger = LaneWidthRanger(CAMERA, region=region)
        ranger.update_motion(replace(step, travelled_m=1.0))
        assert ranger.lane.width_m == slow_m
        ranger.update_motion(step)
        assert ranger.lane.width_m == fast_m
    given = LaneWidthRanger(CAMERA, width_m=3.1)
    given.update_motion(step)
    assert given.lane.width_m == 3.1


def test_width_from_the_height_of_the_camera():
    """Lines with an opening of 4.2 / 1.5 from a camera 1.5 m high are 4.2 m apart, with a sigma of
    6 %."""
    tracks = boxes_at(12.0, 20.0)
    others = {"mono": Ranges.unmeasured(tracks.track_id)}
    ranger = LaneWidthRanger(CAMERA, width_from="mono", camera_height_m=1.5)
    ranger.update_lanes(lines(4.2))
    ranges = ranger.measure_with(tracks, FRAME, others)
    gain = 0.13**2 / (0.13**2 + 0.06**2)
    assert ranger.lane.width_m == pytest.approx(3.5 ** (1 - gain) * 4.2**gain)
    assert ranger.lane.sigma == pytest.approx(0.13 * np.sqrt(1 - gain), rel=1e-3)
    assert ranges.distance_m == pytest.approx([12.0, 20.0], rel=0.04)


def test_nothing_is_learnt_from_nothing():
    ranger = LaneWidthRanger(CAMERA, width_from="mono")
    before = ranger.lane
    tracks = boxes_at(15.0)
    mono = Ranges(tracks.track_id, np.array([15.0]), np.array([0.1]))
    assert np.isnan(ranger.measure_with(tracks, FRAME, {"mono": mono}).distance_m).all()  # no lines
    ranger.update_lanes(lines(4.0))
    ranger.measure_with(tracks, FRAME, {"mono": Ranges.unmeasured(tracks.track_id)})
    assert ranger.lane.width_m == pytest.approx(before.width_m)
    assert ranger.lane.sigma == pytest.approx(before.sigma)


def test_from_image_to_metres():
    """A rendered road with lane detection by edges, against the exact distances."""
    ranger = LaneWidthRanger(CAMERA, width_m=3.5)
    ranger.update_lanes(EdgeLaneFinder().find(picture(-1.75, 1.75), 0.0))
    true_m = np.array([6.0, 10.0, 20.0, 30.0])
    ranges = ranger.measure(boxes_at(*true_m), FRAME)
    error = ranges.distance_m / true_m - 1
    assert np.abs(error).max() < 0.05
    assert (np.abs(error) < ranges.sigma_m / true_m).all()


def by(distance_m, relative_sigma):
    metres = np.asarray(distance_m, float)
    return Ranges(np.arange(1, len(metres) + 1), metres, relative_sigma * metres)


def test_common_error_inflates_sigma():
    true_m = np.array([10.0, 20.0, 40.0, 50.0])
    wrong = inflated_by_disagreement(by(0.7 * true_m, 0.03), [by(true_m, 0.08)])
    error = 1.25 * np.hypot(0.03, 0.08) / 2
    np.testing.assert_allclose(
        wrong.sigma_m / wrong.distance_m, np.hypot(0.03, -np.log(0.7) - error)
    )
    np.testing.assert_array_equal(wrong.distance_m, 0.7 * true_m)


def test_single_error_does_not_inflate_sigma():
    true_m = np.array([10.0, 20.0, 40.0, 50.0])
    by_size = by(true_m * [1.05, 0.97, 2.2, 0.98], 0.08)  # the third is detected as a truck
    np.testing.assert_allclose(
        inflated_by_disagreement(by(true_m, 0.03), [by_size]).sigma_m, 0.03 * true_m
    )


def test_stereo_has_precedence_over_size():
    true_m, unknown = np.array([10.0, 20.0]), np.full(2, np.nan)
    lane = by(true_m, 0.03)
    np.testing.assert_allclose(
        inflated_by_disagreement(lane, [by(2 * true_m, 0.08), by(true_m, 0.01)]).sigma_m,
        lane.sigma_m,
    )
    assert (
        inflated_by_disagreement(lane, [by(2 * true_m, 0.08), by(unknown, 0.01)]).sigma_m
        > 0.5 * true_m
    ).all()


@pytest.mark.parametrize("others", [[], [by([np.nan, np.nan], 0.1)]])
def test_sigma_is_unchanged_without_other_methods(others):
    lane = by([10.0, np.nan], 0.03)
    np.testing.assert_array_equal(inflated_by_disagreement(lane, others).sigma_m, lane.sigma_m)
    assert len(inflated_by_disagreement(by([], 0.03), [by([], 0.1)])) == 0
