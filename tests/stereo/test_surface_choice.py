"""The object among the surfaces of a box, by their position, its size, its track and the other
boxes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from tests.stereo.tile_cases import EXACT_BOX, tiles_of
from track_range.foundation.arrays import FloatArray
from track_range.stereo.matching.patch_matches import ExpectedDisparity
from track_range.stereo.matching.surface_choice import (
    THETA,
    OtherBoxes,
    SurfaceChoice,
    are_behind,
    choose_surface,
    features,
)
from track_range.stereo.matching.surfaces import Surfaces, find_surfaces
from track_range.stereo.matching.tiles import BoxTiles

TILES = tiles_of(first_px=12.0)
U, V = TILES.u, TILES.v
WEIGHT, COST = np.full((1, 49), 4.0), np.full((1, 49), 3.0)
NONE = float("nan")
HALVES = np.where(U > 0, 20.0, 40.0)
BARS = np.where((np.arange(49) % 7 % 2 == 0)[None], 40.0, 20.0)
"""Bars at 40 px in four of seven columns, and an object at 20 px between them."""


def features_of(
    disparity: FloatArray,
    *,
    by_size_px: float = NONE,
    track_px: float = NONE,
    others_fraction: FloatArray | None = None,
    weight: FloatArray = WEIGHT,
) -> tuple[FloatArray, Surfaces]:
    """Features and surfaces of one box, from disparities (1, G) in px."""
    surfaces = find_surfaces(disparity - 12.0, weight, TILES)
    phi = features(
        surfaces,
        TILES,
        COST,
        by_size=ExpectedDisparity(np.array([by_size_px]), np.array([0.15])),
        track_px=np.array([track_px]),
        others_fraction=np.zeros((1, 49)) if others_fraction is None else others_fraction,
    )
    return phi, surfaces


def choice_of(
    disparity: FloatArray, *, by_size_px: float = NONE, track_px: float = NONE
) -> SurfaceChoice:
    return choose_surface(*features_of(disparity, by_size_px=by_size_px, track_px=track_px))


def chosen_px(disparity: FloatArray, *, by_size_px: float = NONE, track_px: float = NONE) -> float:
    """Disparity of the chosen surface, px."""
    phi, surfaces = features_of(disparity, by_size_px=by_size_px, track_px=track_px)
    return float(surfaces.disparity[choose_surface(phi, surfaces).chosen[0], 0])


@pytest.mark.parametrize("is_occluder", [U < -0.3, np.abs(U - 0.125) < 0.05, np.abs(U) < 0.05])
@pytest.mark.parametrize("by_size_px", [NONE, 18.0, 20.0, 22.0])
def test_object_behind_a_pole_is_chosen(
    is_occluder: npt.NDArray[np.bool_], by_size_px: float
) -> None:
    disparity = np.where(is_occluder, 45.0, 20.0)
    assert chosen_px(disparity, by_size_px=by_size_px) == pytest.approx(20.0, abs=0.1)
    assert choice_of(disparity, by_size_px=by_size_px).n_surfaces.tolist() == [2]


@pytest.mark.parametrize(
    ("is_object", "by_size_px"),
    [
        ((np.abs(U) < 0.3) & (V > -0.3), 25.0),  # a person before a wall
        ((np.abs(U) < 0.3) & (V > -0.3), 28.0),
        (V > -0.2, 25.0),  # a car under the sky
        (V > -0.3, 22.0),
        (V > -0.3, NONE),
    ],
)
def test_object_before_the_background_is_chosen(
    is_object: npt.NDArray[np.bool_], by_size_px: float
) -> None:
    assert chosen_px(np.where(is_object, 25.0, 14.0), by_size_px=by_size_px) == pytest.approx(
        25.0, abs=0.1
    )


def test_size_decides_between_halves() -> None:
    for by_size_px in (20.0, 40.0):
        assert chosen_px(HALVES, by_size_px=by_size_px) == pytest.approx(by_size_px, abs=0.1)


def test_track_decides_between_halves() -> None:
    for track_px in (20.0, 40.0):
        assert chosen_px(HALVES, track_px=track_px) == pytest.approx(track_px, abs=0.1)


def test_size_decides_between_bars() -> None:
    assert chosen_px(BARS, by_size_px=20.0) == pytest.approx(20.0, abs=0.1)
    assert chosen_px(BARS, by_size_px=40.0) == pytest.approx(40.0, abs=0.1)


def test_probability_grows_towards_the_expected_size() -> None:
    probability = []
    for by_size_px in (20.0, 24.0, 30.0, 35.0, 40.0):
        phi, surfaces = features_of(HALVES, by_size_px=by_size_px)
        near = int(np.nanargmax(surfaces.disparity[:, 0]))
        probability.append(choose_surface(phi, surfaces).probability[near, 0])
    assert (np.diff(probability) > 0).all()
    # half of the box shows another surface, so that none may be the object, too (0.06)
    assert probability[0] < 0.2 < 0.75 < probability[-1]


@pytest.mark.parametrize(
    "disparity", [HALVES, BARS, np.full((1, 49), 25.0), 20.0 + 40.0 * np.abs(U)]
)
def test_probabilities_sum_to_1(disparity: FloatArray) -> None:
    for by_size_px in (NONE, 20.0, 1e-3, 1e6):
        choice = choice_of(disparity, by_size_px=by_size_px, track_px=by_size_px)
        assert choice.probability.sum(axis=0) + choice.none == pytest.approx([1.0])
        assert (choice.probability >= 0).all()
        assert choice.probability[choice.chosen[0], 0] == choice.probability.max()


def test_boxes_without_a_surface() -> None:
    choice = choose_surface(*features_of(HALVES, weight=np.zeros((1, 49))))
    assert choice.probability.tolist() == [[0.0]] * 3
    assert (choice.n_surfaces.tolist(), choice.none.tolist()) == ([0], [1.0])


def test_n_surfaces() -> None:
    assert choice_of(np.full((1, 49), 25.0)).n_surfaces.tolist() == [1]
    single_choice = choice_of(np.full((1, 49), 25.0))
    assert single_choice.probability[0, 0] == 1.0 - single_choice.none[0] > 0.95
    assert choice_of(HALVES).n_surfaces.tolist() == [2]
    assert choice_of(np.select([U < -0.2, U > 0.2], [45.0, 15.0], 26.0)).n_surfaces.tolist() == [3]
    single = np.full((1, 49), 25.0)
    single[0, 30] = 60.0  # one window is no surface
    assert choice_of(single).n_surfaces.tolist() == [1]


def test_features_by_hand() -> None:
    phi, surfaces = features_of(
        np.where(np.abs(U) < 0.05, 40.0, 20.0), by_size_px=20.0, track_px=20.0
    )
    phi = dict(zip(THETA, phi, strict=True))
    front = int(np.nanargmax(surfaces.disparity[:, 0]))
    behind = 1 - front
    assert phi["area"][front, 0] == pytest.approx(np.log(7 / 49 + 0.05), abs=1e-6)
    assert phi["both_sides"][front, 0] == pytest.approx(np.log(0.05))  # a pole is on neither side
    assert phi["both_sides"][behind, 0] == pytest.approx(np.log(1.05))
    assert (phi["width"][front, 0], phi["width"][behind, 0]) == pytest.approx((0.0, 0.75))
    assert phi["height"][:2, 0] == pytest.approx([0.75, 0.75])
    # share of the pole in front of the object
    assert phi["in_front"][behind, 0] == pytest.approx(7 / 49)
    assert phi["in_front"][front, 0] == 0.0
    assert phi["behind"][front, 0] == pytest.approx(42 / 49)
    assert phi["cost"][:2, 0] == pytest.approx([3.0, 3.0])
    # 3.8 standard deviations nearer than the size lets expect
    z = np.log(40 / 20) / np.hypot(0.15, 0.1)
    assert phi["nearer_than_size"][front, 0] == pytest.approx(z, abs=0.02)
    assert phi["nearer_than_size_squared"][front, 0] == pytest.approx(z**2, abs=0.2)
    assert phi["farther_than_size"][:2, 0] == pytest.approx([0.0, 0.0], abs=0.02)
    assert phi["off_track"][front, 0] == 16.0  # at most 4 standard deviations
    assert phi["off_track"][behind, 0] == pytest.approx(0.0, abs=0.02)


def test_surface_of_another_box_is_less_probable() -> None:
    probability = []
    for fraction in (0.0, 1.0):
        phi, surfaces = features_of(HALVES, others_fraction=np.where(U > 0, 0.0, fraction))
        near = int(np.nanargmax(surfaces.disparity[:, 0]))
        probability.append(choose_surface(phi, surfaces).probability[near, 0])
    assert probability[1] < 0.7 * probability[0]


def test_a_single_surface_is_that_of_a_nearer_box() -> None:
    """A box shows one surface at 40 px: its object, also if its size lets expect 20 px, or that of
    another box."""

    def none_of(by_size_px: float, fraction: float) -> float:
        phi, surfaces = features_of(
            np.full((1, 49), 40.0),
            by_size_px=by_size_px,
            others_fraction=np.full((1, 49), fraction),
        )
        return float(choose_surface(phi, surfaces).none[0])

    assert none_of(24.0, 0.0) == none_of(40.0, 0.0) < 0.05  # a child, or the usual size
    assert 0.1 < none_of(20.0, 0.0) < 0.6  # 3.8 sigma: an object of a wrong class, or an occluder
    assert 0.1 < none_of(40.0, 1.0) < none_of(28.0, 1.0) < none_of(20.0, 1.0)
    assert none_of(20.0, 1.0) > 0.95


def test_boxes_behind_others_by_hand() -> None:
    """A car, one that it covers, one covered by 1 %, and one apart; a lower box is nearer."""
    boxes = np.array(
        [(100, 100, 200, 180), (150, 100, 230, 160), (199, 100, 279, 160), (400, 100, 500, 190)]
    )
    assert are_behind(boxes.astype(np.float64)).tolist() == [False, True, False, False]
    assert are_behind(boxes[[0, 2]].astype(np.float64)).tolist() == [False, False]
    assert are_behind(np.zeros((0, 4))).tolist() == []


def of_others(
    boxes: FloatArray, expected_px: FloatArray, tiles: BoxTiles, disparity_px: FloatArray
) -> FloatArray:
    return OtherBoxes(boxes, expected_px).windows(boxes, expected_px, tiles, disparity_px)


def test_windows_of_other_boxes_by_hand() -> None:
    """A nearer car covers the left part of a box; windows there at its disparity belong to it."""
    boxes = np.array([EXACT_BOX, (150.0, 40.0, 219.0, 120.0)])
    tiles = tiles_of(None, *boxes.tolist())
    x_px = 223.5 + 48.0 * tiles.u[0]
    at_40 = np.full((2, 49), 40.0)
    found = of_others(boxes, np.array([20.0, 40.0]), tiles, at_40)
    assert np.array_equal(found[0] == 1.0, x_px < 219.0)
    assert not found[1].any()  # the car does not belong to the box behind it
    at_20 = np.full((2, 49), 20.0)
    assert not of_others(boxes, np.array([20.0, 40.0]), tiles, at_20)[0].any()
    for expected_px in ([20.0, 21.0], [NONE, 40.0], [20.0, NONE]):  # equally far, or unknown
        assert not of_others(boxes, np.array(expected_px), tiles, at_40)[0].any()
    # a box is no other one to itself, though its size is wrong
    itself = OtherBoxes(boxes[:1], np.array([40.0]))
    assert not itself.windows(
        boxes[:1], np.array([20.0]), tiles_of(None, EXACT_BOX), at_40[:1]
    ).any()
    # the background of a nearer object
    farther = of_others(boxes, np.array([40.0, 20.0]), tiles, at_20)
    assert np.array_equal(farther[0] == 1.0, x_px < 219.0)
