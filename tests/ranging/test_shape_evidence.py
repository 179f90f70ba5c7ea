"""The focal length by the shapes of drawn vehicles."""

import math

import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.ranging.cameras.evidence import SeenFrame
from track_range.ranging.cameras.shape_evidence import ShapeEvidence
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.size_models.curve import load_curves
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.ego_motion import Ego, EgoMotion
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
    check = ShapeEvidence(
        PinholeCamera(focal_px, focal_px, 639.5, 359.5, 1280, 720), load_curves(region="europe")
    )
    side_m, car = np.array([-8.0, -4.5, 4.5, 8.0]), np.full(4, ROAD_CLASSES.index("car"))
    for k in range(100):
        passed = k // 20  # other cars every 2 s
        z_m = np.random.default_rng(passed).uniform(10, 30, 4)
        xyxy_px = boxes_of(side_m, z_m) + rng.normal(0, 0.5, (4, 4))
        ids = np.arange(4) + 4 * passed
        tracks = Tracks(ids, xyxy_px, car, np.ones(4), np.ones(4, np.bool_))
        by_size = Ranges(ids, z_m, 0.1 * z_m)
        check.add(SeenFrame(tracks, by_size, None, Ego(motion=EgoMotion()), 0.1 * k))
        if k < 95:
            assert not check.evidence
    (measured,) = check.evidence
    assert abs(measured.value - math.log(factor)) < 2.5 * measured.sigma
    assert measured.sigma < 0.25
