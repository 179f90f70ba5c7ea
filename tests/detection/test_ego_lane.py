"""Choice, fit and tracking of the ego lane on exact roads."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.support.images.lane_roads import HORIZON_PX, HW, line_pixels, road_x_px, width_px
from track_range.detection.lanes.ego_lane import EgoLane, own_pair
from track_range.detection.lanes.markings import Markings, Proposals, proposals, run_middles
from track_range.detection.lanes.model import LaneState

ROWS = np.array([220.0, 300.0, 350.0])


def markings(*lines_m, numbered=False, sigma=0.0, seed=0, **more):
    pixels = [line_pixels(x_m, **more) for x_m in lines_m]
    xy = np.concatenate(pixels)
    xy = xy + np.stack(
        [np.random.default_rng(seed).normal(0, sigma, len(xy)), np.zeros(len(xy))], axis=1
    )
    number = (
        np.repeat(np.arange(len(pixels)), [len(part) for part in pixels])
        if numbered
        else np.full(len(xy), -1)
    )
    return Markings(xy, number.astype(np.int64), 1.0)


def tracked(lane, times_s, seen):
    lines = None
    for time_s in times_s:
        lines = lane.update(seen, time_s, HW)
    return lines


@pytest.mark.parametrize("numbered", [False, True])
def test_ego_lane_is_next_to_the_camera(numbered):
    lines = EgoLane().update(markings(-5.25, -1.75, 1.75, 5.25, numbered=numbered), 0.0, HW)
    assert lines.left.x_px(ROWS) == pytest.approx(road_x_px(-1.75, ROWS), abs=0.5)
    assert lines.right.x_px(ROWS) == pytest.approx(road_x_px(1.75, ROWS), abs=0.5)
    assert lines.vanishing_point_px() == pytest.approx((320, HORIZON_PX), abs=1.0)
    assert (lines.left.y_top_px, lines.left.y_bottom_px) == (200.0, 354.0)


@settings(deadline=None, max_examples=25)
@given(offset_m=st.floats(-0.8, 0.8), lane_m=st.floats(2.8, 4.2), seed=st.integers(0, 99))
def test_width_of_any_lane_from_noisy_pixels(offset_m, lane_m, seed):
    left_m = offset_m - lane_m / 2
    lines = EgoLane().update(markings(left_m, left_m + lane_m, sigma=1.0, seed=seed), 0.0, HW)
    width = lines.right.x_px(ROWS) - lines.left.x_px(ROWS)
    sigma = np.hypot(lines.left.sigma_px(ROWS), lines.right.sigma_px(ROWS))
    assert width == pytest.approx(width_px(ROWS, lane_m), rel=0.05)
    assert (np.abs(width - width_px(ROWS, lane_m)) < 3 * sigma).all()


def test_bend_moves_both_lines_alike():
    straight = markings(-1.75, 1.75)
    bend_px = 0.004 * (straight.xy_px[:, 1] - 355) ** 2
    lines = EgoLane().update(
        Markings(straight.xy_px + np.stack([bend_px, 0 * bend_px], axis=1), straight.line, 1.0),
        0.0,
        HW,
    )
    y = np.array([230.0, 340.0])
    assert lines.right.x_px(y) == pytest.approx(
        road_x_px(1.75, y) + 0.004 * (y - 355) ** 2, abs=2.0
    )
    assert lines.right.x_px(y) - lines.left.x_px(y) == pytest.approx(width_px(y), rel=0.03)


def test_outliers_do_not_move_the_lines():
    rng = np.random.default_rng(3)
    outliers = rng.uniform([0, 200], [640, 355], (60, 2))
    xy = np.concatenate([markings(-1.75, 1.75).xy_px, outliers])
    lines = EgoLane().update(Markings.unnumbered(xy, 1.0), 0.0, HW)
    assert lines.right.x_px(ROWS) - lines.left.x_px(ROWS) == pytest.approx(width_px(ROWS), rel=0.03)


def test_markings_everywhere_are_not_a_lane():
    rng = np.random.default_rng(4)
    lines = EgoLane().update(
        Markings.unnumbered(rng.uniform([0, 200], [640, 355], (900, 2)), 1.0), 0.0, HW
    )
    assert lines.left is None
    assert lines.right is None


def test_single_line_continues_but_starts_no_lane():
    lane = EgoLane()
    assert lane.update(markings(1.75), 0.0, HW).right is None
    tracked(lane, [0.1, 0.2, 0.3], markings(-1.75, 1.75))
    # the camera moved 0.2 m to the left, the left line is not visible
    lines = lane.update(markings(1.95), 0.4, HW)
    assert lines.right.x_px(ROWS) == pytest.approx(road_x_px(1.95, ROWS), abs=3.0)
    assert lines.left is not None  # still reported, with a larger sigma than the visible line
    assert (lines.left.sigma_px(ROWS) > lines.right.sigma_px(ROWS)).all()


def test_lost_line_expires_after_half_a_second():
    for step_s in (0.04, 0.2):
        lane = EgoLane()
        tracked(lane, [0.0, step_s], markings(-1.75, 1.75))
        gone = [
            lane.update(markings(1.75), step_s + t, HW).left is None
            for t in np.arange(step_s, 1.0, step_s)
        ]
        times_s = np.arange(step_s, 1.0, step_s)
        assert gone == (times_s > 0.5 + 1e-9).tolist()


def test_both_lines_vanish():
    lane = EgoLane()
    no_markings = Markings.unnumbered(np.zeros((0, 2)), 1.0)
    tracked(lane, [0.0, 0.1], markings(-1.75, 1.75))
    lines = lane.update(no_markings, 0.3, HW)
    assert lines.left is not None
    assert lines.left.sigma_px(ROWS).min() > 3.0
    lines = lane.update(no_markings, 0.7, HW)
    assert lines.left is None
    assert lines.right is None
    assert lane.state is None


def test_gap_in_time_resets_the_lane():
    lane = EgoLane()
    tracked(lane, [0.0, 0.1], markings(-1.75, 1.75))
    assert lane.update(markings(1.75), 5.0, HW).right is None


def test_crossing_lines_are_not_a_lane():
    y = np.arange(200.0, 355.0, 2.0)
    crossing = np.concatenate(
        [np.stack([200 + (y - 200), y], axis=1), np.stack([440 - (y - 200), y], axis=1)]
    )
    lines = EgoLane().update(
        Markings(crossing, np.repeat([0, 1], len(y)).astype(np.int64), 1.0), 0.0, HW
    )
    assert lines.left is None
    assert lines.right is None


def test_lines_that_cross_later_end_the_lane():
    lane = EgoLane()
    tracked(lane, [0.0, 0.1], markings(-1.75, 1.75))
    y = np.arange(200.0, 355.0, 2.0)
    crossing = np.concatenate(
        [np.stack([200 + (y - 200), y], axis=1), np.stack([440 - (y - 200), y], axis=1)]
    )
    swapped = Markings(crossing, np.repeat([0, 1], len(y)).astype(np.int64), 1.0)
    for time_s in (0.2, 0.4, 0.7):
        lines = lane.update(swapped, time_s, HW)
        assert lines.left is None or (lines.right.x_px(ROWS) > lines.left.x_px(ROWS)).all()
    assert lines.left is None


def test_noise_is_smoothed_over_time():
    alone, over_time = [], []
    lane = EgoLane()
    for i in range(30):
        seen = markings(-1.75, 1.75, sigma=6.0, seed=i, step_px=12.0, numbered=True)
        for collected, lines in (
            (alone, EgoLane().update(seen, 0.0, HW)),
            (over_time, lane.update(seen, i / 25, HW)),
        ):
            collected.append(
                lines.right.x_px(ROWS) - lines.left.x_px(ROWS) if lines.left else np.full(3, np.nan)
            )
    assert np.nanstd(over_time[5:], axis=0).max() < 0.75 * np.nanstd(alone[5:], axis=0).max()


def test_lane_change_is_followed():
    lane = EgoLane()
    four = (-5.25, -1.75, 1.75, 5.25)
    for i in range(60):  # 3.5 m to the right in three seconds
        shift_m = 3.5 * i / 60
        lines = lane.update(markings(*(x_m - shift_m for x_m in four)), i * 0.05, HW)
    lines = tracked(lane, [3.0, 3.2, 3.4], markings(*(x_m - 3.5 for x_m in four)))
    assert lines.left.x_px(ROWS) == pytest.approx(road_x_px(-1.75, ROWS), abs=2.0)
    assert lines.right.x_px(ROWS) == pytest.approx(road_x_px(1.75, ROWS), abs=2.0)


def test_wrong_lane_is_corrected_soon():
    """The dashes at the left become visible late; until then only the line beyond them is
    visible."""
    lane = EgoLane()
    without, complete = markings(-5.25, 1.75), markings(-5.25, -1.75, 1.75)
    times_s = np.arange(0, 0.5, 0.1)
    assert tracked(lane, times_s, without).left.x_px(ROWS) == pytest.approx(
        road_x_px(-5.25, ROWS), abs=2
    )
    assert tracked(lane, times_s + 0.5, complete).left.x_px(ROWS) == pytest.approx(
        road_x_px(-1.75, ROWS), abs=2
    )


def test_line_of_the_neighbour_does_not_replace_a_hidden_one():
    """The dashes at the right are hidden for 2 s; the lane is not taken for one of twice its
    width."""
    lane = EgoLane()
    tracked(lane, np.arange(0, 3, 0.1), markings(-1.75, 1.75, 5.25))
    hidden = [lane.update(markings(-1.75, 5.25), time_s, HW) for time_s in np.arange(3, 5, 0.1)]
    assert all(
        lines.right is None or lines.right.x_px(ROWS)[1] < road_x_px(2.5, ROWS[1])
        for lines in hidden
    )
    assert hidden[-1].right is None
    lines = lane.update(markings(-1.75, 1.75, 5.25), 5.0, HW)
    assert lines.right.x_px(ROWS) == pytest.approx(road_x_px(1.75, ROWS), abs=2.0)


def test_lane_has_no_other_line_inside():
    """Two lanes between solid lines, of which the dashed line between them shows little."""
    solid, dash = markings(-1.35, 4.15), markings(1.4, top_px=224.0, bottom_px=250.0)
    seen = Markings.unnumbered(np.concatenate([solid.xy_px, dash.xy_px]), 1.0)
    lines = EgoLane().update(seen, 0.0, HW)
    assert lines.right.x_px(ROWS) == pytest.approx(road_x_px(1.4, ROWS), abs=3.0)
    # without a line inside, the road is as wide as two lanes
    lines = EgoLane().update(solid, 0.0, HW)
    assert lines.right.x_px(ROWS) == pytest.approx(road_x_px(4.15, ROWS), abs=3.0)


@pytest.mark.parametrize(("turned_px", "is_lane"), [(0.0, True), (-60.0, False)])
def test_camera_is_in_its_lane(turned_px, is_lane):
    """A lane of 3.6 m whose middle is 2.4 m to the left, 0.67 widths; the width in the lowest row
    is 3.6 / 1.5 x 190 = 456 px, so that a turn by 60 px makes it 0.67 + 0.13."""
    beside = markings(-4.2, -0.6, top_px=180.0)
    seen = Markings.unnumbered(beside.xy_px + np.array([turned_px, 0.0]), 1.0)
    assert (EgoLane().update(seen, 0.0, HW).right is not None) == is_lane


def test_dashes_preferred_to_distant_kerb():
    dashes = line_pixels(1.75)
    dashes = dashes[(dashes[:, 1] // 30) % 3 == 0]
    xy = np.concatenate([line_pixels(-1.75), dashes, line_pixels(5.25)])
    lines = EgoLane().update(Markings.unnumbered(xy, 1.0), 0.0, HW)
    assert lines.right.x_px(ROWS) == pytest.approx(road_x_px(1.75, ROWS), abs=2.0)


def test_new_image_size_resets_the_lane():
    lane = EgoLane()
    tracked(lane, [0.0, 0.1], markings(-1.75, 1.75))
    assert lane.update(markings(1.75), 0.2, (720, 1280)).right is None


def test_proposals_bridge_dashes():
    dashes = line_pixels(1.75)
    dashes = dashes[(dashes[:, 1] // 30) % 2 == 0]
    lines = proposals(Markings.unnumbered(np.concatenate([line_pixels(-1.75), dashes]), 1.0), HW)
    assert lines.support.max() == 1.0
    slope = 1.75 / 1.5
    near = np.abs(lines.slope - slope) < 0.1
    assert near.any()
    assert lines.support[near].max() == pytest.approx(
        np.sqrt(len(dashes) / len(line_pixels(0.0))), abs=0.1
    )


@pytest.mark.parametrize(("horizon_px", "is_lane"), [(170.0, True), (235.0, True), (285.0, False)])
def test_implausible_pair_is_not_a_lane(horizon_px, is_lane):
    """A vanishing point at the side alone is plausible; together with a low horizon it is not."""
    slope = np.array([-0.9, 1.6])
    lines = Proposals(420.0 - slope * horizon_px, slope, np.array([0.9, 1.0]), np.array([-1, -1]))
    assert (own_pair(lines, HW, None) is not None) == is_lane


def test_no_pair_of_fewer_than_two_lines():
    no_lines = Proposals(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0, np.int64))
    assert own_pair(no_lines, HW, None) is None
    assert len(proposals(Markings.unnumbered(np.zeros((0, 2)), 1.0), HW)) == 0


def test_lane_state_by_hand():
    state = LaneState.from_straight_lines((490.0, -1.0), (150.0, 1.0), HW)
    assert state.horizon_px == pytest.approx(170.0)
    assert state.vanishing_x_px == pytest.approx(320.0)
    assert state.width_px(np.array([170.0, 270.0])) == pytest.approx([0.0, 200.0], abs=1e-9)
    left = state.line(-1.0, y_top_px=200.0, y_bottom_px=300.0)
    assert left.coefficients == pytest.approx([490.0, -1.0, 0.0], abs=1e-9)
    rows = state.rows(ROWS, -1.0)
    assert left.sigma_px(ROWS) == pytest.approx(np.sqrt(np.diag(rows @ state.covariance @ rows.T)))
    assert (
        state.after(1.0).line(-1.0, y_top_px=0.0, y_bottom_px=1.0).sigma_px(ROWS)
        > left.sigma_px(ROWS)
    ).all()


def test_markings_in_a_box_are_not_on_the_road():
    xy = np.array([[10.0, 20], [14, 20], [15, 20], [12, 31], [9, 20], [40, 50]])
    boxes = np.array([[10.0, 15, 14, 30], [38, 48, 60, 70]])
    on_road = Markings(xy, np.arange(6), 1.5).outside(boxes)
    assert on_road.line.tolist() == [2, 3, 4]
    assert on_road.xy_px.tolist() == xy[2:5].tolist()
    assert on_road.sigma_px == 1.5


def test_runs():
    marked = np.zeros((3, 8), bool)
    marked[0, 1:4] = marked[2, 0] = marked[2, 6:] = True
    row, x = run_middles(marked)
    assert row.tolist() == [0, 2, 2]
    assert x.tolist() == [2.0, 0.0, 6.5]
    assert run_middles(marked, widest_px=2)[0].tolist() == [2, 2]


def test_invalid_shapes():
    with pytest.raises(ValueError, match="xy_px"):
        Markings(np.zeros((3, 3)), np.zeros(3, np.int64), 1.0)
    with pytest.raises(ValueError, match="line"):
        Markings(np.zeros((3, 2)), np.zeros(2, np.int64), 1.0)
