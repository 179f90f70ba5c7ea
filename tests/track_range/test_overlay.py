"""The overlay: what is drawn, where labels stand, and that nothing in a result can break it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from detection.detections import BoolArray, FloatArray, Image
from ranging.ranges import Ranges
from stereo.frames import Frame
from track_range.overlay import (
    AMBER,
    GREY,
    PALETTE,
    RED,
    Overlay,
    alarm_colour,
    closing_span,
    corner_lines,
    distance_text,
    free_place,
    label_lines,
    label_places,
    place_costs,
    shared_areas,
    text_sizes_px,
    track_colour,
)
from track_range.results import FrameResult
from tracking.tracks import Tracks

HEIGHT, WIDTH = 374, 1242
BOX = [500.0, 200.0, 620.0, 280.0]


def grey(height: int = HEIGHT, width: int = WIDTH) -> Image:
    return np.full((height, width, 3), 128, np.uint8)


def result(
    boxes: list[list[float]],
    *,
    image: Image | None = None,
    observed: bool = True,
    ranges: dict[str, tuple[float, float]] | None = None,
    closing: tuple[float, float] = (np.nan, np.nan),
) -> FrameResult:
    n = len(boxes)
    ids = np.arange(1, n + 1)
    tracks = Tracks(ids, np.array(boxes).reshape(-1, 4), np.full(n, 2), np.ones(n), np.full(n, observed))
    wanted = {"mono": (23.1, 1.5), "stereo": (22.4, 0.5), "fused": (22.5, 0.45)} if ranges is None else ranges
    found = {name: Ranges(ids, np.full(n, metres), np.full(n, sigma)) for name, (metres, sigma) in wanted.items()}
    frame = Frame(7, 0.723, grey() if image is None else image, None)
    return FrameResult(frame, tracks, found, np.full(n, closing[0]), np.full(n, closing[1]), np.zeros((n, 3)))


def painted(image: Image, colour: tuple[int, int, int]) -> BoolArray:
    return np.asarray((image == np.array(colour, np.uint8)).all(axis=2))


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
    changed[:200] = False
    rows, columns = np.nonzero(changed)
    assert 497 <= columns.min() <= columns.max() <= 623
    assert rows.max() <= 283
    assert not changed[210:270, 510:610].any()


def test_a_track_keeps_its_colour_in_every_frame_and_neighbours_differ() -> None:
    assert len(set(PALETTE)) == len(PALETTE) == 12
    assert track_colour(5) == track_colour(5 + 12) != track_colour(6)
    for blue, green, red in PALETTE:
        assert 0.114 * blue + 0.587 * green + 0.299 * red >= 0.49 * 255


def test_with_no_tracks_only_the_corners_are_drawn_on() -> None:
    drawn = Overlay().draw(result([]))
    changed = (drawn != 128).any(axis=2)
    assert changed[:20].any()
    assert not changed[20:].any()


def test_corners_say_frame_time_methods_and_strokes() -> None:
    clock, legend = corner_lines(result([BOX]), 11)
    assert [span.text for span in clock[0]] == ["frame 7", "0.72 s"]
    assert legend[0][0].text == "large: fused ±1 sigma   M mono   S stereo   dashed: predicted"


def test_a_label_says_fused_identity_and_the_methods_side_by_side() -> None:
    assert words(result([BOX])) == [["22.5 m", "±0.5", "car 1"], ["M 23.1  S 22.4"]]
    both = {"sgbm": (np.nan, np.nan), "lane": (104.2, 9.0), "mono": (99.96, 3.0), "fused": (7.04, 0.1)}
    assert words(result([BOX], ranges=both)) == [["7.0 m", "±0.1", "car 1"], ["M 100  L 104  G -"]]


def test_a_track_without_any_range_still_has_its_name() -> None:
    assert words(result([BOX], ranges={})) == [["- m", "car 1"]]
    assert words(result([BOX], ranges={"fused": (np.nan, np.nan)})) == [["- m", "car 1"]]


def test_closing_is_said_only_when_the_gap_shrinks_and_turns_amber_and_red() -> None:
    urgent, soon, far = (closing_span(6.2, ttc_s, 11) for ttc_s in (1.9, 3.6, 12.0))
    assert urgent is not None
    assert soon is not None
    assert far is not None
    assert (urgent.text, urgent.back) == ("TTC 1.9 s  closing 6.2 m/s", RED)
    assert (soon.text, soon.back) == ("TTC 3.6 s  closing 6.2 m/s", AMBER)
    assert (far.text, far.back, far.bgr) == ("TTC 12.0 s  closing 6.2 m/s", None, GREY)
    assert closing_span(-3.0, np.nan, 11) is None
    assert closing_span(np.nan, np.nan, 11) is None
    slow = closing_span(0.6, 80.0, 11)
    assert slow is not None
    assert slow.text == "closing 0.6 m/s"


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


def test_shared_areas_by_hand() -> None:
    places = np.array([[0.0, 0, 10, 10], [20, 20, 30, 30]])
    others = np.array([[5.0, 5, 15, 15], [8, 0, 9, 2], [10, 10, 20, 20]])
    assert shared_areas(places, others).tolist() == [25 + 2, 0]
    assert shared_areas(places, np.zeros((0, 4))).tolist() == [0, 0]


def test_a_label_stands_above_its_box_when_nothing_is_in_the_way() -> None:
    boxes = np.array([BOX])
    places = label_places(boxes, np.array([[90.0, 40.0]]), (WIDTH, HEIGHT))
    costs = place_costs(places, boxes)
    place = free_place(places[0], costs[0], np.zeros((0, 4)))
    assert place is not None
    assert place.tolist() == [500, 160, 590, 200]


def test_a_label_gives_way_and_gives_up() -> None:
    boxes = np.array([BOX])
    places = label_places(boxes, np.array([[90.0, 40.0]]), (WIDTH, HEIGHT))
    costs = place_costs(places, boxes)
    above = np.array([[400.0, 100, 700, 200]])
    second = free_place(places[0], costs[0], above)
    assert second is not None
    assert second.tolist() == [500, 280, 590, 320]
    assert free_place(places[0], costs[0], np.array([[0.0, 0, WIDTH, HEIGHT]])) is None


coordinates = st.floats(-500, 2000)


@given(st.lists(st.tuples(coordinates, coordinates, coordinates, coordinates), min_size=1, max_size=12))
@settings(deadline=None, max_examples=60)
def test_labels_stay_inside_and_never_cover_each_other(boxes: list[tuple[float, float, float, float]]) -> None:
    found = np.array(boxes)
    size_px = np.tile([130.0, 46.0], (len(found), 1))
    places = label_places(found, size_px, (WIDTH, HEIGHT))
    costs = place_costs(places, found)
    assert places.min() >= 0
    assert (places[..., 2:] <= (WIDTH, HEIGHT)).all()
    assert np.array_equal(places[..., 2:] - places[..., :2], np.broadcast_to(size_px[:, None], (*places.shape[:2], 2)))
    taken: FloatArray = np.zeros((0, 4))
    for i in range(len(found)):
        place = free_place(places[i], costs[i], taken)
        if place is not None:
            assert shared_areas(place[None], taken)[0] == 0
            taken = np.vstack([taken, place])
    assert len(taken) >= 1


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
