"""Expected disparities of labelled objects, from the sizes of their classes."""

from __future__ import annotations

import numpy as np
import pytest

from track_range.evaluation.stereo_evaluation import expected_disparities
from track_range.stereo.evaluation.kitti_2015 import StereoPair
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

RIG = StereoRig.rectified(PinholeCamera(700.0, 700.0, 320.0, 180.0, 640, 360), 0.5)
CAR = (280.0, 170.0, 350.0, 225.0)
"""A box 55 px high: a car of 1.5 m at about 19 m, 18 px."""


def pair_of(*classes: str, boxes: list[tuple[float, ...]] | None = None) -> StereoPair:
    image = np.zeros((360, 640, 3), np.uint8)
    xyxy_px = np.array(boxes or [CAR] * max(len(classes), 1))
    return StereoPair(
        "0", image, image, xyxy_px, np.full(len(xyxy_px), 18.0), RIG, class_names=classes
    )


def test_disparity_of_a_car() -> None:
    expected = expected_disparities(pair_of("car", "person", "unicorn"))
    assert expected.disparity_px[0] == pytest.approx(18.0, rel=0.25)
    assert 0.05 < expected.log_sigma[0] < 0.4
    assert np.isfinite(expected.disparity_px[1])
    assert np.isnan(expected.disparity_px[2])


def test_larger_boxes_are_nearer() -> None:
    larger = (200.0, 130.0, 340.0, 240.0)
    expected = expected_disparities(pair_of("car", "car", boxes=[CAR, larger]))
    assert expected.disparity_px[1] == pytest.approx(2 * expected.disparity_px[0], rel=0.15)


def test_cut_boxes_are_less_certain() -> None:
    cut = (0.0, 170.0, 70.0, 225.0)
    expected = expected_disparities(pair_of("car", "car", boxes=[CAR, cut]))
    assert expected.log_sigma[1] >= 0.4 > expected.log_sigma[0]


def test_pairs_without_classes() -> None:
    assert np.isnan(expected_disparities(pair_of()).disparity_px).tolist() == [True]


def test_pairs_without_objects() -> None:
    image = np.zeros((360, 640, 3), np.uint8)
    none = StereoPair("0", image, image, np.zeros((0, 4)), np.zeros(0), RIG, class_names=())
    assert expected_disparities(none).disparity_px.shape == (0,)
