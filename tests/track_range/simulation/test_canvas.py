"""Small pictures drawn by hand: what hides what, holes, shadows, sky."""

import numpy as np
import pytest

from track_range.simulation.render.canvas import Canvas
from track_range.simulation.render.face_table import FaceTable, joined_tables
from track_range.simulation.render.texture_store import TextureStore
from track_range.simulation.world.faces import Face
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
    return Face(corner, np.array([side, 0, 0]), np.array([0, side, 0]), texture, is_shadow=shadow is not None)


def drawn(*faces):
    store = TextureStore()
    canvas = Canvas(CAMERA, store)
    canvas.draw(FaceTable.of(faces, store))
    return canvas


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_nearer_wins_in_any_order(order):
    walls = (wall(5.0, RED), wall(8.0, BLUE))
    canvas = drawn(*(walls[k] for k in order))
    assert canvas.bgra[30, 50, :3].tolist() == list(RED)
    assert canvas.inverse_depth[30, 50] == pytest.approx(0.2)


def test_a_wall_covers_just_the_samples_within_it():
    hit = drawn(wall(5.0, RED)).inverse_depth > 0
    # From -0.5 m to 0.5 m at 5 m: 49.5 -+ 10, so samples 40 .. 59, and rows 20 .. 39.
    assert hit.sum() == 400
    assert hit[20:40, 40:60].all()


def test_through_a_hole_one_sees_what_is_behind():
    canvas = drawn(wall(5.0, RED, hole=True), wall(8.0, BLUE))
    assert canvas.bgra[30, 50, :3].tolist() == list(BLUE)
    assert canvas.bgra[22, 42, :3].tolist() == list(RED)


def test_a_shadow_darkens_by_its_alpha_and_hides_nothing():
    canvas = drawn(wall(5.0, GREY), wall(5.0, (0, 0, 0), shadow=102))  # 102 / 255 = 0.4
    assert canvas.bgra[30, 50, :3].tolist() == [60, 60, 60]
    assert canvas.inverse_depth[30, 50] == pytest.approx(0.2)


def test_a_shadow_does_not_lie_on_what_is_nearer_than_its_slack():
    assert drawn(wall(5.0, GREY), wall(5.1, (0, 0, 0), shadow=102)).bgra[30, 50, 0] == 60
    assert drawn(wall(5.0, GREY), wall(5.5, (0, 0, 0), shadow=102)).bgra[30, 50, 0] == 100


def test_the_sky_fills_what_nothing_was_drawn_on():
    canvas = drawn(wall(5.0, RED))
    assert canvas.sky_until() == 60
    canvas.fill_sky(np.full((30, 100, 4), 7, np.uint8))
    assert canvas.bgra[25, 50, :3].tolist() == list(RED)
    assert canvas.bgra[25, 5, 0] == 7
    assert canvas.bgra[45, 5, 0] == 0  # lower rows were not handed over


def test_rows_without_sky_are_not_asked_for():
    near = wall(5.0, RED)
    canvas = drawn(Face(near.corner + np.array([-9.0, 0.55, 0]), 19 * near.along, 9 * near.down, near.texture))
    assert canvas.sky_until() == 30  # the wall's upper edge lies at row 30.5


def test_what_could_show():
    canvas = drawn(wall(5.0, RED))
    box = np.array([[x, y, z] for x in (-0.2, 0.2) for y in (-0.2, 0.2) for z in (0.0, 1.0)])
    places = np.array([[0, 0, 4.0], [0, 0, 7.0], [1.0, 0, 7.0], [0, 0, -3.0], [30.0, 0, 5.0], [0, 0, -0.5]])
    # Before it; hidden by it; beside it; behind the camera; out of the image; around the camera.
    assert list(canvas.could_show(box + places[:, None])) == [True, False, True, False, False, True]


def test_tables_are_joined_in_order_turned_and_moved():
    store = TextureStore()
    one, two = (FaceTable.of([wall(z, RED)], store) for z in (5.0, 8.0))
    both = joined_tables([one, two]).moved(np.array([[0, 0, 1.0], [0, 0, 2.0]]))
    assert both.corner[:, 2].tolist() == [6.0, 10.0]
    assert both.texture.tolist() == [0, 1]
    half_turn = np.diag([-1.0, 1.0, -1.0])
    np.testing.assert_allclose(both.turned(half_turn).corner, both.corner * (-1, 1, -1))
    np.testing.assert_allclose(both.turned(np.stack([half_turn, np.eye(3)])).along[:, 0], [-1.0, 1.6])
