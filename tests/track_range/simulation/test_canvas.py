"""Tests of the canvas with a few faces: depth order, holes, shadows, sky."""

import numpy as np
import pytest

from track_range.simulation.render.canvas import Canvas
from track_range.simulation.render.face_table import FaceTable, TextureStore, joined_tables
from track_range.simulation.world.bodies.faces import Face
from track_range.stereo.geometry.camera import PinholeCamera

CAMERA = PinholeCamera(100.0, 100.0, 49.5, 29.5, 100, 60)
RED, BLUE, GREY = (0, 0, 250), (250, 0, 0), (100, 100, 100)


def wall(z, bgr, *, hole=False, shadow=None):
    texture = np.full((16, 16, 4), 255, np.uint8)
    texture[:, :, :3] = bgr
    if hole:
        texture[4:12, 4:12, 3] = 0
    if shadow is not None:
        texture[:, :, 3] = shadow
    side = 0.2 * z  # 20 samples
    corner = np.array([-side / 2, -side / 2, z])
    return Face(
        corner,
        np.array([side, 0, 0]),
        np.array([0, side, 0]),
        texture,
        is_shadow=shadow is not None,
    )


def draw(*faces):
    store = TextureStore()
    canvas = Canvas(CAMERA, store)
    canvas.draw(FaceTable.of(faces, store))
    return canvas


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_nearer_face_hides_farther_one(order):
    walls = (wall(5.0, RED), wall(8.0, BLUE))
    canvas = draw(*(walls[k] for k in order))
    assert canvas.bgra[30, 50, :3].tolist() == list(RED)
    assert canvas.inverse_depth[30, 50] == pytest.approx(0.2)


def test_samples_covered_by_a_face():
    is_drawn = draw(wall(5.0, RED)).inverse_depth > 0
    # From -0.5 m to 0.5 m at 5 m: 49.5 -+ 10, so samples 40 .. 59, and rows 20 .. 39.
    assert is_drawn.sum() == 400
    assert is_drawn[20:40, 40:60].all()


def test_hole_shows_what_is_behind():
    canvas = draw(wall(5.0, RED, hole=True), wall(8.0, BLUE))
    assert canvas.bgra[30, 50, :3].tolist() == list(BLUE)
    assert canvas.bgra[22, 42, :3].tolist() == list(RED)


def test_shadow_darkens_by_its_alpha():
    canvas = draw(wall(5.0, GREY), wall(5.0, (0, 0, 0), shadow=102))  # 102 / 255 = 0.4
    assert canvas.bgra[30, 50, :3].tolist() == [60, 60, 60]
    assert canvas.inverse_depth[30, 50] == pytest.approx(0.2)


def test_shadow_does_not_fall_on_nearer_surfaces():
    assert draw(wall(5.0, GREY), wall(5.1, (0, 0, 0), shadow=102)).bgra[30, 50, 0] == 60
    assert draw(wall(5.0, GREY), wall(5.5, (0, 0, 0), shadow=102)).bgra[30, 50, 0] == 100


def test_sky_fills_undrawn_pixels():
    canvas = draw(wall(5.0, RED))
    assert canvas.n_sky_rows() == 60
    canvas.fill_sky(np.full((30, 100, 4), 7, np.uint8))
    assert canvas.bgra[25, 50, :3].tolist() == list(RED)
    assert canvas.bgra[25, 5, 0] == 7
    assert canvas.bgra[45, 5, 0] == 0  # below the given rows of the sky


def test_number_of_sky_rows():
    near = wall(5.0, RED)
    canvas = draw(
        Face(near.corner + np.array([-9.0, 0.55, 0]), 19 * near.along, 9 * near.down, near.texture)
    )
    assert canvas.n_sky_rows() == 30  # the wall's upper edge is at row 30.5


def test_may_be_visible():
    canvas = draw(wall(5.0, RED))
    box = np.array([[x, y, z] for x in (-0.2, 0.2) for y in (-0.2, 0.2) for z in (0.0, 1.0)])
    places = np.array(
        [[0, 0, 4.0], [0, 0, 7.0], [1.0, 0, 7.0], [0, 0, -3.0], [30.0, 0, 5.0], [0, 0, -0.5]]
    )
    # In front of the wall; behind it; next to it; behind the camera; outside the image; around the
    # camera.
    assert list(canvas.may_be_visible(box + places[:, None])) == [
        True,
        False,
        True,
        False,
        False,
        True,
    ]


def test_tables_are_joined_rotated_and_moved():
    store = TextureStore()
    one, two = (FaceTable.of([wall(z, RED)], store) for z in (5.0, 8.0))
    both = joined_tables([one, two]).moved(np.array([[0, 0, 1.0], [0, 0, 2.0]]))
    assert both.corner[:, 2].tolist() == [6.0, 10.0]
    assert both.texture.tolist() == [0, 1]
    half_turn = np.diag([-1.0, 1.0, -1.0])
    np.testing.assert_allclose(both.rotated(half_turn).corner, both.corner * (-1, 1, -1))
    np.testing.assert_allclose(
        both.rotated(np.stack([half_turn, np.eye(3)])).along[:, 0], [-1.0, 1.6]
    )
