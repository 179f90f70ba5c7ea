"""The overlay with the disparities below it."""

from __future__ import annotations

import numpy as np

from tests.support.results.overlay_results import BOX, HEIGHT, WIDTH, result
from track_range.ranging.measurement.dense_map import DenseMap, MapPair
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.views.overlay.annotator import SCALE_M, DensePicture, Overlay, StackedPicture

RIG = StereoRig.rectified(PinholeCamera(700.0, 700.0, 620.5, 186.5, WIDTH, HEIGHT), 0.5)


def disparity_at(metres: float) -> dict[str, DenseMap]:
    values = np.full((HEIGHT, WIDTH), 350.0 / metres, np.float32)
    pair = MapPair(RIG, Alignment())
    return {"sgbm": DenseMap(values, "disparity", (HEIGHT, WIDTH), pair=pair)}


def test_overlay_above_disparities() -> None:
    shown = result([], dense=disparity_at(20.0))
    both = StackedPicture(Overlay()).draw(shown)
    assert both.shape == (2 * HEIGHT, WIDTH, 3)
    assert np.array_equal(both[:HEIGHT], Overlay().draw(shown))
    lower = both[HEIGHT:]
    assert np.array_equal(lower[:300], DensePicture().draw(shown)[:300])


def test_scale_has_the_colours_of_the_picture() -> None:
    pictures = DensePicture()
    for metres in (10.0, 30.0):
        assert metres in SCALE_M
        shown = result([], dense=disparity_at(metres))
        colour = pictures.draw(shown)[0, 0].astype(int)
        scale = pictures.draw_marked(result([]))[HEIGHT - 40 :]
        assert (np.abs(scale.astype(int) - colour).max(axis=2) <= 12).any()


def test_boxes_are_outlined_on_the_disparities() -> None:
    plain, marked = (
        DensePicture().draw_marked(result(boxes)) for boxes in ([], [BOX, [np.nan] * 4])
    )
    rows, columns = np.nonzero((plain != marked).any(axis=2))
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (200, 280, 500, 620)


def test_lower_half_without_dense_stereo() -> None:
    lower = StackedPicture(Overlay()).draw(result([]))[HEIGHT:]
    assert not lower[:300].any()


def test_narrow_image_has_no_scale() -> None:
    assert not DensePicture().draw_marked(result([], image=np.zeros((48, 64, 3), np.uint8))).any()
