"""Bird's-eye view: scale, uncertainty bars and colours."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.support.results.overlay_results import BOX, grey, painted, result
from track_range.pipeline.colours import RED
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.views.overlay.birds_eye import BirdsEye, Scale

CAMERA = PinholeCamera(700.0, 700.0, 620.5, 186.5, 1242, 374)
PX_PER_M = 0.94 * 157 / 60
"""Of an image of 374 rows: the inset has 157, 6 % of them below the camera, and shows 60 m."""


def drawn(inset: BirdsEye, **given: Any) -> np.ndarray:
    """The inset's part of the picture of one car."""
    canvas = grey()
    inset.draw(canvas, result([BOX], **given))
    left, top, right, bottom = inset.place((1242, 374)).astype(int)
    assert not (canvas[:top] != 128).any()
    assert not (canvas[:, right:] != 128).any()
    return canvas[top:bottom, left:right]


def at(x_m: float, z_m: float) -> np.ndarray:
    return np.array([[x_m, 0.0, z_m]])


def mark(
    x_m: float, z_m: float, *, sigma_m: float = 0.1, **more: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns changed by a car at this position, relative to the same car far outside."""
    ranges = {"fused": (z_m, sigma_m)}
    beside = drawn(BirdsEye(), ranges=ranges, xyz_m=at(-1e6, z_m), **more)
    rows, columns = np.nonzero(
        (drawn(BirdsEye(), ranges=ranges, xyz_m=at(x_m, z_m), **more) != beside).any(axis=2)
    )
    return rows, columns


def test_same_scale_in_both_directions() -> None:
    near, far, right = mark(0, 35.0), mark(0, 55.0), mark(20, 35.0)
    assert near[0].mean() - far[0].mean() == pytest.approx(20 * PX_PER_M, abs=1)
    assert right[1].mean() - near[1].mean() == pytest.approx(20 * PX_PER_M, abs=1)
    assert near[1].mean() == pytest.approx(63, abs=1)
    assert near[0].mean() == pytest.approx(0.94 * 157 - 35 * PX_PER_M, abs=1)


def test_bar_is_two_sigma_long() -> None:
    rows, columns = mark(0, 35.0, sigma_m=8.0)
    assert np.ptp(rows) == pytest.approx(16 * PX_PER_M, abs=3)
    assert np.ptp(columns) < 15


def test_predicted_track_is_hollow_and_on_its_ray() -> None:
    carried = {"fused": (np.nan, np.nan), "fused_kf": (40.0, 0.1)}
    box = [[1000.0, 150.0, 1041.0, 190.0]]  # 400 px right of the camera's middle: 40 * 400 / 700 m
    shown = result(box, observed=False, ranges=carried)
    assert BirdsEye(CAMERA).ground_m(shown)[0] == pytest.approx([40 * 400 / 700, 40.0, 0.1])
    assert np.isnan(BirdsEye().ground_m(shown)[0]).any()
    where: dict[str, Any] = {"ranges": {"fused": (40.0, 0.1)}, "xyz_m": at(10, 40.0)}
    solid, hollow = (drawn(BirdsEye(), observed=observed, **where) for observed in (True, False))
    assert hollow.astype(int).sum() < solid.astype(int).sum()  # black centre


def test_field_of_view_of_the_camera() -> None:
    narrow, none = (drawn(BirdsEye(camera), ranges={}) for camera in (CAMERA, None))
    rows, columns = np.nonzero((narrow != none).any(axis=2))
    slope = 620.5 / 700  # x / z of the left edge
    for row in (90, 110, 130):
        assert 63 - columns[rows == row].min() == pytest.approx(slope * (0.94 * 157 - row), abs=2)


def test_urgent_track_has_a_red_ring() -> None:
    where: dict[str, Any] = {"ranges": {"fused": (20.0, 0.1)}, "xyz_m": at(0, 20.0)}
    assert painted(drawn(BirdsEye(), closing=(10.0, 1.0), **where), RED).any()
    assert not painted(drawn(BirdsEye(), closing=(1.0, 20.0), **where), RED).any()


def test_range_grows_at_once_and_shrinks_after_3_s() -> None:
    scale, seen = Scale(), []
    for time_s, farthest_m in (
        (0.0, 20.0),
        (0.1, 45.0),
        (0.2, 10.0),
        (2.0, 10.0),
        (3.2, 10.0),
        (4.0, 300.0),
    ):
        scale.update(farthest_m, time_s)
        seen.append(scale.range_m)
    assert seen == [30.0, 60.0, 60.0, 60.0, 30.0, 120.0]


@pytest.mark.parametrize("where", [at(0, np.nan), at(np.inf, 10.0), at(0, 0.0), at(0, -5.0)])
def test_tracks_without_position_are_not_drawn(where: np.ndarray) -> None:
    empty = drawn(BirdsEye(), ranges={}, xyz_m=at(np.nan, np.nan))
    assert np.array_equal(drawn(BirdsEye(), ranges={"fused": (5.0, 0.1)}, xyz_m=where), empty)


def test_tracks_far_outside() -> None:
    assert drawn(BirdsEye(), ranges={"fused": (5.0, 1e9)}, xyz_m=at(1e12, 1e-3)).shape == (
        157,
        126,
        3,
    )
    assert drawn(BirdsEye(), ranges={"fused": (5.0, 1.0)}, xyz_m=at(-1e12, 1e12)).shape == (
        157,
        126,
        3,
    )


def corner_of(inset: BirdsEye, box: list[float], time_s: float) -> tuple[bool, bool]:
    """Whether the inset is at the right and at the bottom of a picture with a car in this box."""
    inset.draw(grey(), result([box], time_s=time_s))
    left, _, right, bottom = inset.place((1242, 374))
    return right == 1242 and left > 0, bottom == 374


def test_inset_moves_to_the_emptiest_corner_and_stays() -> None:
    inset, near_left, near_right = (
        BirdsEye(),
        [0.0, 150.0, 300.0, 370.0],
        [900.0, 150.0, 1240.0, 370.0],
    )
    assert corner_of(inset, BOX, 0.0) == (False, True)
    assert corner_of(inset, near_left, 0.1) == (True, True)
    assert corner_of(inset, near_right, 0.2) == (True, True)  # a move was less than 1 s ago
    assert corner_of(inset, near_right, 1.2) == (False, True)
    assert corner_of(inset, BOX, 3.0) == (False, True)
    assert corner_of(inset, [0.0, 150.0, 1242.0, 370.0], 5.0) == (False, False)  # above both


def test_road_users_stay_visible_in_the_inset() -> None:
    inset, canvas, box = BirdsEye(), grey(), [20.0, 300.0, 60.0, 340.0]
    inset.draw(canvas, result([box, [0.0, 0.0, 1242.0, 200.0], [900.0, 200.0, 1242.0, 374.0]]))
    assert inset.place((1242, 374))[:2].tolist() == [0, 374 - 157]
    assert (canvas[300:340, 20:60] == 128).all()
    assert (canvas[350:370, 5:15] != 128).any()


def test_small_image_has_no_inset() -> None:
    canvas = grey(100, 200)
    BirdsEye().draw(canvas, result([BOX], image=canvas))
    assert (canvas == 128).all()
