"""Surfaces through the disparities of windows: fits by hand, with outliers and curvature, and
several in one box."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from tests.stereo.tile_cases import EXACT_BOX, tiles_of
from track_range.foundation.arrays import FloatArray
from track_range.stereo.matching.surfaces import (
    SurfaceFit,
    Surfaces,
    find_surfaces,
    fit_surfaces,
    surface_terms,
    window_weights,
)
from track_range.stereo.matching.window_matches import WindowMatches

TILES = tiles_of(first_px=12.0)
U, V = TILES.u, TILES.v
WEIGHT = np.full((1, 49), 4.0)
FIRST = 12.0


def fit_of(
    disparity: FloatArray, weight: FloatArray = WEIGHT, *, is_curved: bool = False
) -> FloatArray:
    """The coefficients p (5,) of the surface through the disparities of one box of about 30 px."""
    fit = fit_surfaces(
        disparity, weight, surface_terms(U, V), disparity=np.array([30.0]), is_curved=is_curved
    )
    return fit.p[0]


def surfaces_of(disparity: FloatArray, weight: FloatArray = WEIGHT) -> Surfaces:
    """Surfaces of one box, from disparities (1, G) in px."""
    return find_surfaces(disparity - FIRST, weight, TILES)


# fit_surfaces


def test_a_tilted_plane_by_hand() -> None:
    p = fit_of(30.0 + 3.0 * U - 1.0 * V)
    assert p[0] == pytest.approx(30.0, abs=1e-6)
    # the ridge reduces the tilt by ridge / (ridge + mean u^2) = 0.004 / (0.004 + 0.0625) = 6 %
    assert p[1:3] == pytest.approx([2.82, -0.94], abs=0.02)
    assert p[3:].tolist() == [0.0, 0.0]


def test_outliers_hardly_move_the_plane() -> None:
    disparity = 30.0 + 3.0 * U - 1.0 * V
    clean = fit_of(disparity)
    disparity[0, [0, 7, 20, 33, 41, 46]] += [14.0, -12.0, 25.0, -28.0, 6.0, 9.0]
    assert fit_of(disparity)[:3] == pytest.approx(clean[:3], abs=0.15)
    assert abs(fit_of(disparity)[0] - 30.0) < 0.1


def test_windows_count_by_weight() -> None:
    disparity, weight = np.full((1, 49), 30.0), np.full((1, 49), 4.0)
    disparity[0, 24:], weight[0, 24:] = 55.0, 0.0
    assert fit_of(disparity, weight)[0] == pytest.approx(30.0, abs=1e-6)
    nothing = fit_of(disparity, np.zeros((1, 49)))
    assert np.isfinite(nothing).all()
    assert nothing[0] == 0.0


def test_curvature_of_a_rounded_surface() -> None:
    disparity = 30.0 - 4.0 * U**2 - 2.0 * V**2
    plane, curved = (
        fit_of(disparity, 400.0 * WEIGHT),
        fit_of(disparity, 400.0 * WEIGHT, is_curved=True),
    )
    assert curved[0] == pytest.approx(30.0, abs=0.02)
    assert curved[3:] == pytest.approx([-4.0, -2.0], abs=0.3)
    assert plane[0] < 29.8
    assert plane[3:].tolist() == [0.0, 0.0]
    # large variances: the prior of no curvature decides
    rough = fit_of(disparity, 0.01 * WEIGHT, is_curved=True)
    assert np.abs(rough[3:]).max() < 1.0


def test_values_of_a_surface() -> None:
    fit = SurfaceFit(np.array([[30.0, 2.0, -1.0, 4.0, 8.0]]))
    at = fit.at(np.array([[0.0, 0.5, 0.0]]), np.array([[0.0, 0.0, 0.5]]))
    assert at[0] == pytest.approx([30.0, 32.0, 31.5])


def test_fits_of_boxes_are_independent() -> None:
    rng = np.random.default_rng(2)
    disparity, weight = rng.uniform(18, 24, (5, 49)), rng.uniform(0, 5, (5, 49))
    terms = np.repeat(surface_terms(U, V), 5, axis=0)
    scale = np.linspace(10.0, 50.0, 5)
    for is_curved in (False, True):
        together = fit_surfaces(disparity, weight, terms, disparity=scale, is_curved=is_curved)
        for i in range(5):
            one = slice(i, i + 1)
            alone = fit_surfaces(
                disparity[one],
                weight[one],
                surface_terms(U, V),
                disparity=scale[one],
                is_curved=is_curved,
            )
            assert together.p[i] == pytest.approx(alone.p[0])


# find_surfaces


def test_one_surface_with_outliers() -> None:
    disparity = 30.0 + 3.0 * U - 1.0 * V
    disparity[0, [0, 6, 20, 40]] += [14.0, -12.0, 25.0, -11.0]  # chance matches
    surfaces = surfaces_of(disparity)
    assert surfaces.disparity[0, 0] == pytest.approx(30.0, abs=0.05)
    assert surfaces.centre[0, 0] == pytest.approx(30.0 - FIRST, abs=0.05)
    assert np.flatnonzero(~surfaces.is_member[0, 0]).tolist() == [0, 6, 20, 40]
    assert surfaces.is_member[0, 0].sum() == 45


@pytest.mark.parametrize("slope", [-8.0, 5.0, 12.0])
def test_a_slanted_surface_is_one(slope: float) -> None:
    surfaces = surfaces_of(25.0 + slope * U)
    assert surfaces.is_member[0, 0].all()
    assert surfaces.disparity[0, 0] == pytest.approx(25.0, abs=0.05)
    assert np.isnan(surfaces.centre[1:, 0]).all()
    assert surfaces.is_member[1:, 0].sum(axis=1).tolist() == [0, 0]


@pytest.mark.parametrize(
    ("is_front", "front_px", "behind_px"),
    [
        (np.abs(U) < 0.3, 25.0, 14.0),  # a person before the background
        (V > -0.2, 25.0, 14.0),  # a car under the sky
        (U < -0.2, 40.0, 20.0),  # a car behind a pillar at the left
        (np.abs(U - 0.125) < 0.05, 45.0, 20.0),  # behind a pole
    ],
)
def test_two_surfaces_are_separated(
    is_front: npt.NDArray[np.bool_], front_px: float, behind_px: float
) -> None:
    surfaces = surfaces_of(np.where(is_front, front_px, behind_px))
    front = int(np.nanargmax(surfaces.disparity[:, 0]))
    behind = 1 - front
    assert np.array_equal(surfaces.is_member[front], is_front)
    assert np.array_equal(surfaces.is_member[behind], ~is_front)
    assert surfaces.disparity[[front, behind], 0] == pytest.approx([front_px, behind_px], abs=1e-3)
    assert np.isnan(surfaces.disparity[2, 0])


def test_three_surfaces_and_no_window_in_two() -> None:
    surfaces = surfaces_of(np.select([U < -0.2, U > 0.2], [45.0, 15.0], 26.0))
    assert sorted(surfaces.disparity[:, 0]) == pytest.approx([15.0, 26.0, 45.0], abs=1e-3)
    assert (surfaces.is_member.sum(axis=0) == 1).all()


def test_windows_without_a_match_are_no_members() -> None:
    weight = WEIGHT.copy()
    weight[0, 20:] = 0.0
    surfaces = surfaces_of(np.full((1, 49), 20.0), weight)
    assert np.array_equal(surfaces.is_member[0, 0], np.arange(49) < 20)
    nothing = surfaces_of(np.full((1, 49), 20.0), np.zeros((1, 49)))
    assert np.isnan(nothing.centre).all()
    assert not nothing.is_member.any()


def test_few_windows_have_no_tilt() -> None:
    weight = np.zeros((1, 49))
    weight[0, [17, 24, 31]] = 4.0
    surfaces = surfaces_of(20.0 + 2.0 * V, weight)
    assert surfaces.is_member[0, 0].sum() == 3
    assert surfaces.planes.p[0, 0, 1:].tolist() == [0.0] * 4
    assert 19.7 < surfaces.disparity[0, 0] < 20.3


def test_surfaces_of_boxes_are_independent() -> None:
    tiles = tiles_of(None, EXACT_BOX, (100.0, 30.0, 260.0, 90.0), (30.0, 30.0, 60.0, 60.0))
    rng = np.random.default_rng(3)
    index = rng.choice([4.0, 9.0, 14.0], (3, 49)) + rng.normal(0, 0.2, (3, 49))
    together = find_surfaces(index, np.full((3, 49), 4.0), tiles)
    for i, box in enumerate((EXACT_BOX, (100.0, 30.0, 260.0, 90.0), (30.0, 30.0, 60.0, 60.0))):
        alone = find_surfaces(index[i : i + 1], WEIGHT, tiles_of(None, box))
        assert together.centre[:, i] == pytest.approx(alone.centre[:, 0], nan_ok=True)
        assert np.array_equal(together.is_member[:, i], alone.is_member[:, 0])


def test_weights_of_windows() -> None:
    cost = np.full((1, 49), 3.0)
    cost[0, :4] = [6.0, 8.0, 10.0, 12.0]  # full weight to 6 bits, none from 10
    tiles = tiles_of(None, (211.5, 57.5, 235.5, 73.5))  # only the 3 x 3 central windows are used
    matches = WindowMatches(np.full((1, 49), 5.0), np.full((1, 49), 2.0), cost)
    assert window_weights(matches, TILES)[0, :5] == pytest.approx([2.0, 1.0, 0.0, 0.0, 2.0])
    assert np.array_equal(window_weights(matches, tiles)[0, 5:] > 0, tiles.is_used[0, 5:])
