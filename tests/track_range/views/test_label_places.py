"""Layout of labels: inside the image, near their boxes, without overlap."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings, strategies as st

from tests.support.results.overlay_results import BOX, HEIGHT, WIDTH
from track_range.foundation.arrays import FloatArray
from track_range.views.overlay.labels import (
    PLACES,
    LabelPlacer,
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


def test_label_above_its_box_by_default() -> None:
    boxes = np.array([BOX])
    places = label_places(boxes, np.array([[90.0, 40.0]]), (WIDTH, HEIGHT))
    number = free_place(places[0], place_costs(places, boxes)[0], np.zeros((0, 4)))
    assert number == 0
    assert places[0, number].tolist() == [500, 160, 590, 200]


def test_label_moves_away_or_is_omitted() -> None:
    boxes = np.array([BOX])
    places = label_places(boxes, np.array([[90.0, 40.0]]), (WIDTH, HEIGHT))
    costs = place_costs(places, boxes)
    second = free_place(places[0], costs[0], np.array([[400.0, 100, 700, 200]]))
    assert second is not None
    assert places[0, second].tolist() == [500, 280, 590, 320]
    assert free_place(places[0], costs[0], np.array([[0.0, 0, WIDTH, HEIGHT]])) is None


def test_previous_place_is_preferred() -> None:
    boxes, size_px = np.array([BOX]), np.array([[90.0, 40.0]])
    places = label_places(boxes, size_px, (WIDTH, HEIGHT))
    nothing = np.zeros((0, 4))
    assert free_place(places[0], place_costs(places, boxes, [2])[0], nothing) == 2
    assert free_place(places[0], place_costs(places, boxes, [None])[0], nothing) == 0
    # positions far from the box or on it are not kept
    assert free_place(places[0], place_costs(places, boxes, [len(PLACES) - 1])[0], nothing) == 0
    assert free_place(places[0], place_costs(places, boxes, [6])[0], nothing) == 0


coordinates = st.floats(-500, 2000)


@given(
    st.lists(st.tuples(coordinates, coordinates, coordinates, coordinates), min_size=1, max_size=12)
)
@settings(deadline=None, max_examples=60)
def test_labels_are_inside_without_overlap(boxes: list[tuple[float, float, float, float]]) -> None:
    box_array = np.array(boxes)
    size_px = np.tile([130.0, 46.0], (len(box_array), 1))
    places = label_places(box_array, size_px, (WIDTH, HEIGHT))
    costs = place_costs(places, box_array)
    assert places.min() >= 0
    assert (places[..., 2:] <= (WIDTH, HEIGHT)).all()
    assert np.array_equal(
        places[..., 2:] - places[..., :2], np.broadcast_to(size_px[:, None], (*places.shape[:2], 2))
    )
    occupied: FloatArray = np.zeros((0, 4))
    for i in range(len(box_array)):
        number = free_place(places[i], costs[i], occupied)
        if number is not None:
            assert shared_areas(places[i, number][None], occupied)[0] == 0
            occupied = np.vstack([occupied, places[i, number]])
    assert len(occupied) >= 1


def placed(
    boxes: list[list[float]], *, urgent: bool, image_px: tuple[int, int] = (WIDTH, HEIGHT)
) -> list[int | None]:
    """Size (0 = full, 130 x 46 px; 1 = short, 90 x 20 px) of each label."""
    n = len(boxes)
    sizes_px = np.array([[[130.0, 46.0]] * n, [[90.0, 20.0]] * n])
    placements = LabelPlacer().place(
        range(n),
        np.array(boxes),
        sizes_px,
        occupied=np.zeros((0, 4)),
        image_px=image_px,
        urgent=[urgent] * n,
    )
    return [None if one is None else one[0] for one in placements]


def test_label_over_boxes_is_shortened_unless_urgent() -> None:
    assert placed([BOX], urgent=False) == [0]
    wall = [[x, 0.0, x + 40.0, float(HEIGHT)] for x in range(0, WIDTH, 40)]  # cars everywhere
    assert placed([*wall, BOX], urgent=False)[0] == 1
    assert placed([*wall, BOX], urgent=True)[0] == 0


def test_labels_do_not_cover_nearer_road_users() -> None:
    """The car in BOX is behind a lorry, which leaves no room for a label except to its right."""
    lorry = [0.0, 0.0, 1100.0, float(HEIGHT)]
    sizes_px = np.array([[[130.0, 46.0]] * 2, [[90.0, 20.0]] * 2])
    free = {"occupied": np.zeros((0, 4)), "image_px": (WIDTH, HEIGHT)}
    behind = LabelPlacer().place(
        range(2),
        np.array([lorry, [1050.0, 150.0, 1080.0, 170.0]]),
        sizes_px,
        urgent=[False] * 2,
        **free,
    )
    assert behind[1] is not None
    assert behind[1][1][0] >= 1100
    for urgent, expected in ((False, None), (True, 0)):
        hidden = LabelPlacer().place(
            range(2), np.array([lorry, BOX]), sizes_px, urgent=[urgent] * 2, **free
        )
        assert (hidden[1] and hidden[1][0]) == expected


def test_label_larger_than_the_image() -> None:
    assert placed([[10.0, 10.0, 40.0, 30.0]], urgent=True, image_px=(100, 60)) == [1]
    assert placed([[10.0, 10.0, 40.0, 30.0]], urgent=True, image_px=(80, 60)) == [None]


def test_touching_places_are_free() -> None:
    places = np.array([[0.0, 0, 10, 10], [20, 20, 30, 30]])
    costs = np.array([0.0, 1.0])
    assert free_place(places, costs, np.array([[10.0, 0, 20, 10]])) == 0
    assert free_place(places, costs[::-1], np.array([[10.0, 0, 20, 10]])) == 1
    assert free_place(places, costs, np.array([[9.0, 9, 20, 21]])) == 1
    assert free_place(places, costs, np.array([[0.0, 0, 40, 40]])) is None
    assert free_place(places, costs, np.zeros((0, 4))) == 0
