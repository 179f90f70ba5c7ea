"""Tests of culling, splitting and projection of faces, against the camera's projection."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.simulation.render.face_table import FaceTable, TextureStore
from track_range.simulation.render.pieces import (
    CUTS,
    DEPTH_RATIO,
    NEAR_M,
    projected,
    visible_pieces,
)
from track_range.simulation.world.bodies.faces import Face
from track_range.stereo.geometry.camera import PinholeCamera

CAMERA = PinholeCamera(500.0, 500.0, 320.0, 120.0, 640, 240)


def table(*faces):
    return FaceTable.of(faces, TextureStore())


def face(corner, along, down, *, two_sided=False, texels=(32, 48)):
    vectors = (np.array(vector, np.float64) for vector in (corner, along, down))
    return Face(*vectors, np.full((*texels, 4), 255, np.uint8), two_sided)


def upright(x=0.0, z=10.0, *, two_sided=False):
    return face((x - 1, -1, z), (2, 0, 0), (0, 2, 0), two_sided=two_sided)


def test_invisible_faces_are_culled():
    away = face((1, -1, 10), (-2, 0, 0), (0, 2, 0))
    both = face((1, -1, 10), (-2, 0, 0), (0, 2, 0), two_sided=True)
    left, right, behind = upright(-8.0), upright(8.0), upright(z=-5.0)
    above, below = (face((-1, y, 10), (2, 0, 0), (0, 2, 0)) for y in (-5.0, 3.0))
    faces = [upright(), away, both, left, right, behind, above, below]
    assert visible_pieces(table(*faces), CAMERA).face.tolist() == [0, 2]


def test_no_faces_give_no_pieces():
    pieces = visible_pieces(table(upright()).select(np.zeros(1, np.bool_)), CAMERA)
    assert len(pieces) == 0
    assert projected(pieces, CAMERA).size.shape == (0, 2)


def test_pieces_of_a_road_tile_its_texture():
    road = face((-1, 1, 30), (2, 0, 0), (0, 0, -25), texels=(100, 40))  # from 30 m to 5 m
    pieces = visible_pieces(table(road), CAMERA)
    covered = np.zeros((100, 40), int)
    for top, bottom, left, right in pieces.window.tolist():
        covered[top:bottom, left:right] += 1
    np.testing.assert_array_equal(covered, 1)
    z = pieces.corners[:, :, 2]
    assert (z.max(axis=1) <= DEPTH_RATIO * z.min(axis=1)).all()
    np.testing.assert_allclose(pieces.corner[:, 2], 30 - 25 * pieces.window[:, 0] / 100)
    assert np.all(np.diff(pieces.window[:, 0]) > 0)  # in order


def test_face_that_extends_behind_the_camera():
    road = face((-1, 1, 30), (2, 0, 0), (0, 0, -40), texels=(512, 40))
    pieces = visible_pieces(table(road), CAMERA)
    z = pieces.corners[:, :, 2]
    # Road nearer than 5 m is below the image: the last piece extends just beyond its lower edge.
    assert NEAR_M <= z.min() < 500 / 120 * 1.0
    assert z.max() == 30.0
    assert len(pieces) < 2**CUTS


COORDINATES = st.floats(-3, 3)


@settings(deadline=None, max_examples=60)
@given(st.tuples(*[COORDINATES] * 6), st.tuples(st.floats(0, 1), st.floats(0, 1)))
def test_texels_are_projected_to_their_points(numbers, fractions):
    corner = np.array([numbers[0], numbers[1], 12.0])
    along, down = np.array([2.0, 0.3, numbers[2] / 2]), np.array([-0.2, 1.5, numbers[3] / 2])
    textured_face = Face(corner, along, down, np.zeros((64, 64, 4), np.uint8), True)
    pieces = projected(visible_pieces(table(textured_face), CAMERA), CAMERA)
    point = corner + fractions[0] * along + fractions[1] * down
    point_px = CAMERA.project(point[None])[0]
    texel = 64 * np.array(fractions)
    for row in range(len(pieces.face)):
        top, bottom, left, right = pieces.texels[row]
        if left <= texel[0] <= right and top <= texel[1] <= bottom:
            in_window = np.array([*(point_px - pieces.window_px[row, :2]), 1.0])
            xyw = pieces.texture_from_px[row] @ in_window
            # With its margin of one texel, the averaged texture starts at 1/2.
            expected = (texel - (left, top)) / (right - left, bottom - top) * pieces.size[
                row, ::-1
            ] + 0.5
            np.testing.assert_allclose(xyw[:2] / xyw[2], expected, atol=1e-6)
            assert pieces.inverse_depth[row] @ np.array([*point_px, 1.0]) == pytest.approx(
                1 / point[2]
            )


def test_texture_sizes_follow_the_longer_edges():
    # 2 m at 10 m are 100 px, but the texture has only 32 rows and 48 columns. At 40 m: 25 px,
    # quantized to 27.
    pieces = projected(visible_pieces(table(upright(), upright(z=40.0)), CAMERA), CAMERA)
    assert pieces.size.tolist() == [[32, 48], [27, 27]]
    np.testing.assert_allclose(pieces.nearest, [0.1, 0.025])
    assert pieces.window_px[0].tolist() == [270, 70, 370, 170]
