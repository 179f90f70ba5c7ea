"""Where labels stand: inside the image, beside their boxes, never on one another."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.track_range.overlay_results import BOX, HEIGHT, WIDTH
from track_range.foundation.arrays import FloatArray
from track_range.overlay.label_layout import (
    PLACES,
    LabelPlacer,
    covered,
    free_place,
    label_places,
    place_costs,
    shared_areas,
)


def test_shared_areas_by_hand() -> None:
    places = np.array([[0.0, 0, 10, 10], [20, 20, 30, 30]])
    others = np.array([[5.0, 5, 15, 15], [8, 0, 9, 2], [10, 10, 20, 20]])
    assert shared_areas(places, others).tolist() == [25 + 2, 0]
    assert shared_areas(places, np.zeros((0, 4))).tolist() == [0, 0]


def test_a_label_stands_above_its_box_when_nothing_is_in_the_way() -> None:
    boxes = np.array([BOX])
    places = label_places(boxes, np.array([[90.0, 40.0]]), (WIDTH, HEIGHT))
    number = free_place(places[0], place_costs(places, boxes)[0], np.zeros((0, 4)))
    assert number == 0
    assert places[0, number].tolist() == [500, 160, 590, 200]


def test_a_label_gives_way_and_gives_up() -> None:
    boxes = np.array([BOX])
    places = label_places(boxes, np.array([[90.0, 40.0]]), (WIDTH, HEIGHT))
    costs = place_costs(places, boxes)
    second = free_place(places[0], costs[0], np.array([[400.0, 100, 700, 200]]))
    assert second is not None
    assert places[0, second].tolist() == [500, 280, 590, 320]
    assert free_place(places[0], costs[0], np.array([[0.0, 0, WIDTH, HEIGHT]])) is None


def test_the_place_of_the_frame_before_wins_over_one_that_is_little_better() -> None:
    boxes, size_px = np.array([BOX]), np.array([[90.0, 40.0]])
    places = label_places(boxes, size_px, (WIDTH, HEIGHT))
    nothing = np.zeros((0, 4))
    assert free_place(places[0], place_costs(places, boxes, [2])[0], nothing) == 2
    assert free_place(places[0], place_costs(places, boxes, [None])[0], nothing) == 0
    # Far from the box, or on it, is no place to stay.
    assert free_place(places[0], place_costs(places, boxes, [len(PLACES) - 1])[0], nothing) == 0
    assert free_place(places[0], place_costs(places, boxes, [6])[0], nothing) == 0


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
        number = free_place(places[i], costs[i], taken)
        if number is not None:
            assert shared_areas(places[i, number][None], taken)[0] == 0
            taken = np.vstack([taken, places[i, number]])
    assert len(taken) >= 1


def placed(boxes: list[list[float]], *, urgent: bool, image_px: tuple[int, int] = (WIDTH, HEIGHT)) -> list[int | None]:
    """Which size (0 = full) each label takes, of 130 x 46 and 90 x 20 px."""
    n = len(boxes)
    sizes_px = np.array([[[130.0, 46.0]] * n, [[90.0, 20.0]] * n])
    found = LabelPlacer().place(
        range(n), np.array(boxes), sizes_px, occupied=np.zeros((0, 4)), image_px=image_px, urgent=[urgent] * n
    )
    return [None if one is None else one[0] for one in found]


def test_a_label_is_cut_short_where_it_would_hide_boxes_unless_it_is_urgent() -> None:
    assert placed([BOX], urgent=False) == [0]
    wall = [[x, 0.0, x + 40.0, float(HEIGHT)] for x in range(0, WIDTH, 40)]  # cars wherever one looks
    assert placed([*wall, BOX], urgent=False)[0] == 1
    assert placed([*wall, BOX], urgent=True)[0] == 0


def test_a_label_that_the_image_cannot_hold_is_cut_short_or_left_out() -> None:
    assert placed([[10.0, 10.0, 40.0, 30.0]], urgent=True, image_px=(100, 60)) == [1]
    assert placed([[10.0, 10.0, 40.0, 30.0]], urgent=True, image_px=(80, 60)) == [None]


def test_a_place_that_only_touches_is_free() -> None:
    places = np.array([[0.0, 0, 10, 10], [20, 20, 30, 30]])
    assert covered(places, np.array([[10.0, 0, 20, 10]])).tolist() == [False, False]
    assert covered(places, np.array([[9.0, 9, 20, 21]])).tolist() == [True, False]
    assert covered(places, np.array([[0.0, 0, 40, 40]])).tolist() == [True, True]
    assert covered(places, np.zeros((0, 4))).tolist() == [False, False]
