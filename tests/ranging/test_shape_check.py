"""The focal length by the shapes of drawn vehicles."""

import math

import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.ranging.doubt.scale_check import ShapeCheck
from track_range.ranging.size_models.curve import load_curves
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.tracking.tracks import Tracks

TRUE = PinholeCamera(800.0, 800.0, 639.5, 359.5, 1280, 720)


def boxes_of(x_m, z_m, camera=TRUE):
    """(N, 4) boxes of cars, 4.2 m long, whose rears are at x, z; the camera is 1.5 m above the
    road."""
    corners = [
        camera.project(np.stack([x_m + dx, np.full(len(x_m), y), z_m + dz], axis=1))
        for dx in (-0.9, 0.9)
        for y in (0.0, 1.5)
        for dz in (0.0, 4.2)
    ]
    points = np.array(corners)
    return np.concatenate([points.min(axis=0), points.max(axis=0)], axis=1)


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_focal_lengths_are_measured_by_shapes(factor):
    rng = np.random.default_rng(0)
    focal_px = factor * TRUE.fx_px
    check = ShapeCheck(
        PinholeCamera(focal_px, focal_px, 639.5, 359.5, 1280, 720), load_curves(region="europe")
    )
    side_m, car = np.array([-8.0, -4.5, 4.5, 8.0]), np.full(4, ROAD_CLASSES.index("car"))
    for k in range(100):
        passed = k // 20  # other cars every 2 s
        z_m = np.random.default_rng(passed).uniform(10, 30, 4)
        xyxy_px = boxes_of(side_m, z_m) + rng.normal(0, 0.5, (4, 4))
        check.add(
            Tracks(np.arange(4) + 4 * passed, xyxy_px, car, np.ones(4), np.ones(4, np.bool_)),
            0.1 * k,
        )
        if k < 95:
            assert check.evidence is None
    assert check.evidence is not None
    assert abs(check.evidence.value - math.log(factor)) < 2.5 * check.evidence.sigma
    assert check.evidence.sigma < 0.25
