"""Cuboids on the overlay, and their footprints in the bird's-eye view."""

import numpy as np
import pytest

from tests.support.results.frame_results import cuboids
from tests.support.results.overlay_results import BOX, grey, painted, result
from track_range.pipeline.colours import track_colour
from track_range.ranging.world.cuboids import Cuboids
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.views.overlay.annotator import Overlay
from track_range.views.overlay.birds_eye import BirdsEye
from track_range.views.overlay.cuboid_strokes import cuboid_strokes

CAMERA = PinholeCamera(700.0, 700.0, 620.5, 186.5, 1242, 374)
FAR = [5.0, 1.2, 20.0]  # centre of a car of 4 x 1.8 x 1.5 m


def drawn(given, *, has_cuboids=True, observed=True):
    shown = result([BOX], cuboids=given, observed=observed)
    picture = Overlay(camera=CAMERA, has_cuboids=has_cuboids).draw(shown)
    return painted(picture, track_colour(1))


def near(mask, xyz_m):
    """Whether the mask has pixels at the place of a point."""
    x, y = np.rint(CAMERA.project(np.array([xyz_m]))[0]).astype(int)
    return mask[y - 2 : y + 3, x - 2 : x + 3].any()


def test_edges_are_where_the_cuboid_is():
    ahead = drawn(cuboids(centre_m=FAR))
    across = drawn(cuboids(centre_m=FAR, yaw_deg=90.0))
    for y_m in (1.2 - 0.75, 1.2 + 0.75):
        assert near(ahead, [4.1, y_m, 18.0])
        assert near(ahead, [5.9, y_m, 22.0])
        assert near(across, [3.0, y_m, 19.1])
        assert near(across, [7.0, y_m, 20.9])
    assert not ahead[278:283, 505:615].any()  # the box in the image
    assert drawn(cuboids(centre_m=FAR), has_cuboids=False)[278:283, 505:615].any()
    assert drawn(Cuboids.unknown(1))[278:283, 505:615].any()
    dashed = drawn(cuboids(centre_m=FAR), observed=False)
    assert 0.3 < dashed[:, 750:].sum() / ahead[:, 750:].sum() < 0.8


def test_directions_are_drawn_where_the_front_is_known():
    known, other = (
        cuboid_strokes(cuboids(centre_m=FAR, yaw_deg=180.0, front_known=front), CAMERA)[0, 12]
        for front in (True, False)
    )
    ends = CAMERA.project(np.array([[5.0, 1.95, 20.0], [5.0, 1.95, 18.0]]))
    np.testing.assert_allclose(known[[0, -1]], ends)
    assert np.isnan(other).all()


def test_what_is_behind_the_camera_is_cut():
    strokes = cuboid_strokes(cuboids(centre_m=[2.0, 1.0, 0.5]), CAMERA)[0]
    assert np.isfinite(strokes).all(axis=(1, 2)).sum() == 9  # not the four edges of its rear
    assert np.nanmin(strokes[..., 0]) == pytest.approx(620.5 + 700 * 1.1 / 2.5)
    assert np.isnan(cuboid_strokes(cuboids(centre_m=[2.0, 1.0, -9.0]), CAMERA)).all()
    assert drawn(cuboids(centre_m=[2.0, 1.0, -9.0]))[278:283, 505:615].any()
    assert drawn(cuboids(centre_m=[0.1, 0.0, 2.2])).shape == (374, 1242)


@pytest.mark.parametrize(("yaw_deg", "size_m"), [(0.0, (4.0, 1.8)), (90.0, (1.8, 4.0))])
def test_footprints_in_the_birds_eye_view(yaw_deg, size_m):
    inset, canvas = BirdsEye(), grey()
    where = {"ranges": {"fused": (10.0, 0.01)}, "xyz_m": np.array([[0.0, 0.0, 10.0]])}
    inset.draw(
        canvas, result([BOX], cuboids=cuboids(centre_m=[0.0, 1.0, 12.0], yaw_deg=yaw_deg), **where)
    )
    left, top, right, bottom = inset.place((1242, 374)).astype(int)
    rows, columns = np.nonzero(painted(canvas[top:bottom, left:right], track_colour(1)))
    px_per_m = 0.94 * (bottom - top) / 30.0
    assert np.ptp(rows) == pytest.approx(size_m[0] * px_per_m, abs=3)
    assert np.ptp(columns) == pytest.approx(size_m[1] * px_per_m, abs=3)
    shown = canvas[top:bottom, left:right][rows.min() - 2 : rows.max() + 3]
    assert (shown[:, columns.min() - 2 : columns.max() + 3].min(axis=2) > 200).any()  # its front
