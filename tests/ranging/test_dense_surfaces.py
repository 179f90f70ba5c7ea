"""Surfaces of boxes in dense maps that are made by hand: occluders, windows, edges, resolutions."""

import cv2
import numpy as np
import pytest

from track_range.foundation.arrays import FloatArray, FloatArray32
from track_range.ranging.measurement.dense_map import DenseMap
from track_range.ranging.measurement.dense_surfaces import box_surfaces

HW = (240, 480)
BOX = np.array([[180.0, 80.0, 300.0, 180.0]])
OBJECT_M, ROAD_M = 15.0, 60.0


def depths() -> FloatArray32:
    """A car at 15 m that fills the box, in front of a wall at 60 m."""
    z = np.full(HW, ROAD_M, np.float32)
    z[80:181, 180:301] = OBJECT_M
    return z


def measured(z: FloatArray32, xyxy_px: FloatArray = BOX) -> tuple[float, float]:
    values, sigmas = box_surfaces(DenseMap(z, "depth", HW), xyxy_px)
    return float(values[0]), float(sigmas[0])


def test_a_flat_object_has_its_depth_with_a_small_sigma() -> None:
    value, sigma = measured(depths())
    assert value == pytest.approx(OBJECT_M, rel=1e-3)
    assert 0.0 < sigma < 0.03 * OBJECT_M


def test_the_quantities_of_one_scene_agree() -> None:
    z, focal_baseline = depths(), 390.0
    of_depth = measured(z)[0]
    inverse = box_surfaces(DenseMap(1 / z, "inverse_depth", HW), BOX)[0][0]
    disparity = box_surfaces(DenseMap(focal_baseline / z, "disparity", HW), BOX)[0][0]
    assert 1 / inverse == pytest.approx(of_depth, rel=1e-3)
    assert focal_baseline / disparity == pytest.approx(of_depth, rel=1e-3)


@pytest.mark.parametrize("centre_px", [200, 240, 285])
def test_a_pole_in_front_is_not_the_object(centre_px: int) -> None:
    z = depths()
    z[60:, centre_px - 6 : centre_px + 6] = 6.0
    assert measured(z)[0] == pytest.approx(OBJECT_M, rel=0.02)


def test_the_background_in_the_windows_is_not_the_object() -> None:
    z = depths()
    z[92:125, 195:285] = ROAD_M
    assert measured(z)[0] == pytest.approx(OBJECT_M, rel=0.02)


def test_a_slanted_object_has_the_depth_at_the_centre_of_the_box() -> None:
    z = depths()
    z[80:181, 180:301] = 1 / np.linspace(1 / 12.0, 1 / 16.0, 121, dtype=np.float32)
    value, sigma = measured(z)
    assert value == pytest.approx(2 / (1 / 12 + 1 / 16), rel=0.01)
    assert sigma > measured(depths())[1]


def test_smoothed_edges_have_no_effect_and_unknown_pixels_neither() -> None:
    z = np.asarray(cv2.GaussianBlur(depths(), (0, 0), 5.0), np.float32)
    z[np.random.default_rng(0).uniform(size=HW) < 0.6] = np.nan
    assert measured(z)[0] == pytest.approx(OBJECT_M, rel=0.02)


def test_a_map_of_a_sixth_of_the_resolution() -> None:
    small = np.asarray(cv2.resize(depths(), (80, 40), interpolation=cv2.INTER_AREA), np.float32)
    values, _ = box_surfaces(DenseMap(small, "depth", HW), BOX)
    assert values[0] == pytest.approx(OBJECT_M, rel=0.03)
    disparity = box_surfaces(DenseMap(390.0 / small, "disparity", HW), BOX)
    fine = box_surfaces(DenseMap(390.0 / depths(), "disparity", HW), BOX)
    assert disparity[0][0] == pytest.approx(26.0, rel=0.03)
    assert disparity[1][0] > 2 * fine[1][0]  # pixels of the map are coarser


def test_confidence_decides_between_two_halves() -> None:
    z = depths()
    z[80:181, 180:240] = 20.0
    sure = np.ones(HW, np.float32)
    sure[:, :240] = 0.0
    value = box_surfaces(DenseMap(z, "depth", HW, confidence=sure), BOX)[0][0]
    assert value == pytest.approx(OBJECT_M, rel=0.02)
    value = box_surfaces(DenseMap(z, "depth", HW, confidence=1 - sure), BOX)[0][0]
    assert value == pytest.approx(20.0, rel=0.02)


def test_boxes_without_an_answer_are_nan() -> None:
    boxes = np.array(
        [
            [np.nan, 0.0, 10.0, 10.0],
            [0.0, 0.0, np.inf, 10.0],
            [100.0, 100.0, 101.0, 101.0],
            [900.0, 20.0, 960.0, 80.0],
            [1e12, 20.0, 2e12, 80.0],
            [300.0, 180.0, 180.0, 80.0],
        ]
    )
    for values in box_surfaces(DenseMap(depths(), "depth", HW), boxes):
        assert np.isnan(values).all()
    unknown = np.full(HW, np.nan, np.float32)
    for quantity in ("depth", "inverse_depth", "disparity"):
        assert np.isnan(box_surfaces(DenseMap(unknown, quantity, HW), BOX)).all()
        assert np.isnan(box_surfaces(DenseMap(0 * depths(), quantity, HW), BOX)).all()
        assert box_surfaces(DenseMap(depths(), quantity, HW), np.zeros((0, 4)))[0].shape == (0,)


def test_a_box_is_measured_alone_as_among_others() -> None:
    z = depths()
    z[100:160, 20:80] = 9.0
    boxes = np.concatenate([BOX, [[20.0, 100.0, 80.0, 160.0]], [[400.0, 10.0, 440.0, 40.0]]])
    together = box_surfaces(DenseMap(z, "depth", HW), boxes)[0]
    alone = [measured(z, box[None])[0] for box in boxes]
    np.testing.assert_allclose(together, alone)
    np.testing.assert_allclose(together, [OBJECT_M, 9.0, ROAD_M], rtol=0.02)
