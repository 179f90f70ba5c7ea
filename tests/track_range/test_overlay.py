"""The overlay: what is drawn, where labels stand, and that nothing in a result can break it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from detection.lanes import LaneLine, LaneLines
from tests.track_range.overlay_results import BOX, HEIGHT, WIDTH, grey, painted, result
from track_range.overlay import Overlay
from track_range.overlay_colours import AMBER, CALM, LANE_COLOUR, PALETTE, RED, alarm_colour, track_colour
from track_range.overlay_text import (
    Span,
    closing_span,
    corner_lines,
    distance_text,
    label_lines,
    shown_distance,
    text_sizes_px,
)
from track_range.overlay_writing import Pen
from track_range.results import FrameResult


def words(found: FrameResult, row: int = 0) -> list[list[str]]:
    lines = label_lines(found, row, class_names=["person", "bicycle", "car"], sizes_px=(15, 11))
    return [[span.text for span in line] for line in lines]


def test_the_frame_is_copied_and_never_written_to() -> None:
    rng = np.random.default_rng(3)
    image = rng.integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
    before = image.copy()
    image.setflags(write=False)
    drawn = Overlay().draw(result([BOX], image=image))
    assert np.array_equal(image, before)
    assert drawn.shape == image.shape
    assert drawn.dtype == np.uint8
    assert not np.array_equal(drawn, before)


def test_a_seen_box_has_a_whole_outline_and_a_predicted_one_has_gaps() -> None:
    # The lower edge: no label stands there while there is room above.
    share = {}
    for observed in (True, False):
        drawn = Overlay().draw(result([BOX], observed=observed))
        share[observed] = painted(drawn, track_colour(1))[280, 505:615].mean()
    assert share[True] == 1.0
    assert 0.3 < share[False] < 0.8


def test_a_dashed_outline_keeps_to_the_box() -> None:
    drawn = Overlay().draw(result([BOX], observed=False))
    changed = (drawn != 128).any(axis=2)
    changed[:200] = changed[:, :160] = False
    rows, columns = np.nonzero(changed)
    assert 497 <= columns.min() <= columns.max() <= 623
    assert rows.max() <= 283
    assert not changed[210:270, 510:610].any()


def test_the_window_in_which_stereo_looks_is_marked_by_its_corners() -> None:
    # The inner half of BOX: columns 530..590, rows 220..260.
    inside = Overlay().draw(result([BOX]))[205:275, 505:615]
    rows, columns = np.nonzero(painted(inside, track_colour(1)))
    assert (rows.min() + 205, rows.max() + 205) == (220, 260)
    assert (columns.min() + 505, columns.max() + 505) == (530, 590)
    assert not painted(inside, track_colour(1))[30:40].any()
    for unmarked in (result([BOX], ranges={"mono": (9.0, 1.0)}), result([BOX], observed=False)):
        assert not painted(Overlay().draw(unmarked)[205:275, 505:615], track_colour(1)).any()


def test_lane_lines_are_drawn_where_they_were_seen() -> None:
    straight = LaneLine(np.array([700.0, 0.5, 0.0]), np.eye(3), 210.0, 350.0)
    drawn = Overlay().draw(result([], lanes=LaneLines(None, straight)))
    lime = painted(drawn, LANE_COLOUR)
    rows = np.flatnonzero(lime.any(axis=1))
    assert (rows.min(), rows.max()) == pytest.approx((210, 350), abs=2)
    for row in (230, 280, 340):
        assert np.flatnonzero(lime[row]).mean() == pytest.approx(700 + 0.5 * row, abs=1.5)
    assert not painted(Overlay().draw(result([])), LANE_COLOUR).any()


def test_a_lane_line_that_runs_off_the_image_is_drawn_as_far_as_it_goes() -> None:
    wild = LaneLine(np.array([-1e9, 1e7, 0.0]), np.eye(3), 90.0, 373.0)
    assert Overlay().draw(result([], lanes=LaneLines(wild, None))).shape == (HEIGHT, WIDTH, 3)


def test_a_track_keeps_its_colour_in_every_frame_and_neighbours_differ() -> None:
    assert len(set(PALETTE)) == len(PALETTE) == 12
    assert track_colour(5) == track_colour(5 + 12) != track_colour(6)
    for blue, green, red in PALETTE:
        assert 0.114 * blue + 0.587 * green + 0.299 * red >= 0.49 * 255


def test_with_no_tracks_only_the_corners_and_the_inset_are_drawn_on() -> None:
    drawn = Overlay().draw(result([]))
    changed = (drawn != 128).any(axis=2)
    assert changed[:20].any()
    assert not changed[20:, 160:].any()
    assert changed[300, 60]  # the road from above


def test_corners_say_frame_time_methods_and_strokes() -> None:
    clock, legend = corner_lines(result([BOX]), 11)
    assert [span.text for span in clock[0]] == ["frame 7", "0.72 s"]
    more, _ = corner_lines(result([BOX]), 11, status=("9.8 fps", "85 ms behind"), warning="uncalibrated")
    assert [span.text for span in more[0]] == ["frame 7", "0.72 s", "9.8 fps", "85 ms behind", "uncalibrated"]
    assert more[0][-1].bgr == AMBER
    assert legend[0][0].text == "large: fused ±1 sigma   M mono   S stereo   dashed: predicted"


def test_a_label_says_fused_identity_and_the_methods_side_by_side() -> None:
    assert words(result([BOX])) == [["22.5 m", "±0.5", "car 1"], ["M 23.1  S 22.4"]]
    both = {"sgbm": (np.nan, np.nan), "lane": (104.2, 9.0), "mono": (99.96, 3.0), "fused": (7.04, 0.1)}
    assert words(result([BOX], ranges=both)) == [["7.0 m", "±0.1", "car 1"], ["M 100  L 104"]]


def test_a_track_without_any_range_still_has_its_name() -> None:
    assert words(result([BOX], ranges={})) == [["- m", "car 1"]]
    assert words(result([BOX], ranges={"fused": (np.nan, np.nan)})) == [["- m", "car 1"]]


def test_a_predicted_track_shows_its_filtered_distance() -> None:
    carried = result([BOX], observed=False, ranges={"fused": (np.nan, np.nan), "fused_kf": (31.0, 2.0)})
    assert shown_distance(carried, 0) == (31.0, 2.0)
    assert words(carried) == [["31.0 m", "±2.0", "car 1"]]


def test_closing_is_said_only_when_the_gap_shrinks_on_a_bar_that_turns_amber_and_red() -> None:
    spans = [closing_span(6.2, ttc_s, 11) for ttc_s in (1.9, 3.6, 6.0, 12.0)]
    texts = [f"TTC {ttc_s:.1f} s  closing 6.2 m/s" for ttc_s in (1.9, 3.6, 6.0, 12.0)]
    assert [span.text for span in spans if span] == texts
    assert [span.fill for span in spans if span] == [RED, AMBER, CALM, CALM]
    assert [span.filled for span in spans if span] == pytest.approx([1 - 1.9 / 8, 1 - 3.6 / 8, 0.25, 0])
    assert closing_span(-3.0, np.nan, 11) is None
    assert closing_span(np.nan, np.nan, 11) is None
    slow = closing_span(0.6, 80.0, 11)
    assert slow is not None
    assert (slow.text, slow.filled) == ("closing 0.6 m/s", 0.0)


def test_a_bar_is_as_long_as_it_says_and_its_text_is_read_on_either_part() -> None:
    place = np.array([10.0, 10.0, 213.0, 30.0])  # 200 px behind the stripe
    for filled in (0.0, 0.25, 0.75, 1.0):
        canvas = grey(60, 300)
        Pen().write(canvas, [[Span("TTC 3.0 s  closing 6.2 m/s", 14, 700, (255, 255, 255), AMBER, filled)]], place)
        columns = np.flatnonzero(painted(canvas, AMBER)[11])
        assert len(columns) == round(200 * filled)
        if filled:
            assert (columns[0], columns[-1]) == (13, 12 + round(200 * filled))
        unfilled = canvas[11:27, 13 + round(200 * filled) : 213]
        assert filled == 1.0 or unfilled.max() > 200  # white letters
        assert not filled or (canvas[11:27, 13 : 13 + round(200 * filled)].max(axis=2) < 60).any()  # black ones


def test_warnings_start_below_four_and_two_seconds() -> None:
    assert [alarm_colour(ttc_s) for ttc_s in (1.99, 2.0, 3.99, 4.0, np.nan)] == [RED, AMBER, AMBER, None, None]


def test_an_urgent_track_shows_red_and_a_calm_one_does_not() -> None:
    n_red = [painted(Overlay().draw(result([BOX], closing=(10.0, ttc_s))), RED).sum() for ttc_s in (1.5, 3.0, 10.0)]
    assert n_red[0] > 500
    assert n_red[1:] == [0, 0]


@pytest.mark.parametrize(("metres", "text"), [(7.04, "7.0"), (99.94, "99.9"), (99.96, "100"), (np.nan, "-")])
def test_distances_are_as_long_as_they_are_useful(metres: float, text: str) -> None:
    assert distance_text(metres) == text


def test_text_grows_with_the_image() -> None:
    assert text_sizes_px(374) == (15, 11, 2)
    assert text_sizes_px(720) == (26, 18, 3)
    assert text_sizes_px(100)[1] == 11


HOSTILE = [
    [-300.0, -200.0, -100.0, -50.0],
    [1e9, 1e9, 2e9, 2e9],
    [-1e12, -1e12, 1e12, 1e12],
    [np.nan, 10.0, 20.0, 30.0],
    [10.0, 10.0, np.inf, 30.0],
    [100.0, 100.0, 100.0, 100.0],
    [300.0, 300.0, 200.0, 200.0],
    [1200.0, 350.0, 1300.0, 420.0],
]


@pytest.mark.parametrize("observed", [True, False])
@pytest.mark.parametrize("size", [(HEIGHT, WIDTH), (24, 32), (1, 1)])
def test_boxes_of_any_kind_on_images_of_any_size_are_drawn(observed: bool, size: tuple[int, int]) -> None:
    ranges = {"fused": (np.nan, np.nan), "mono": (np.inf, np.nan)}
    found = result(HOSTILE, image=grey(*size), observed=observed, ranges=ranges, closing=(9.0, 1.0))
    assert Overlay().draw(found).shape == (*size, 3)


def test_a_box_with_nan_leaves_no_mark() -> None:
    nowhere = Overlay().draw(result([[np.nan, 10.0, 20.0, 30.0]]))
    assert np.array_equal(nowhere, Overlay().draw(result([])))


def test_a_box_partly_outside_is_drawn_to_the_image_edge() -> None:
    drawn = Overlay().draw(result([[1100.0, 250.0, 1400.0, 500.0]]))
    mine = painted(drawn, track_colour(1))
    assert mine[250, 1110:WIDTH].all()
    assert not mine[300:340, WIDTH - 2].any()


def test_a_crowd_is_drawn_near_ones_first() -> None:
    rng = np.random.default_rng(5)
    corner = rng.uniform((0, 100), (1200, 300), (80, 2))
    boxes = np.hstack([corner, corner + 40]).tolist()
    drawn = Overlay().draw(result(boxes))
    assert (drawn != 128).any(axis=2).mean() > 0.3


def test_real_frames_keep_their_picture_under_the_marks(shared_data: Path) -> None:
    video = cv2.VideoCapture(str(shared_data / "kitti_stereo/0003/left.mp4"))
    read, image = video.read()
    video.release()
    assert read
    drawn = Overlay().draw(result([BOX, [100.0, 180.0, 160.0, 220.0]], image=np.asarray(image, np.uint8)))
    assert (drawn == image).all(axis=2).mean() > 0.9


def test_the_corner_says_what_the_run_says_at_each_frame() -> None:
    said = iter([(), ("12.3 fps", "a sentence that needs room")])
    overlay = Overlay(status=lambda: next(said))
    short, long = (overlay.draw(result([])) for _ in range(2))
    assert (long != short).any(axis=2)[:15, 150:350].any()


def test_a_label_keeps_its_place_when_another_becomes_as_good() -> None:
    """Car 1 covers what is above car 2; when it has gone, car 2's label stays below."""
    overlay = Overlay()
    blocked = [[480.0, 60.0, 700.0, 195.0], BOX]
    rows = []
    for boxes in (blocked, [[0.0, 0.0, 0.0, 0.0], BOX]):
        label = np.flatnonzero((overlay.draw(result(boxes)) != 128).any(axis=2)[:, 505])
        rows.append(bool((label > 284).any()))
    assert rows[0]
    assert rows[0] == rows[1]
