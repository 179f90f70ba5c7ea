"""A run distinguishes objects on a collision course from objects that will pass."""

from __future__ import annotations

import numpy as np

from tests.support.results.frame_results import frame_pipeline
from track_range.detection.detections import Detections
from track_range.foundation.arrays import FloatArray, Image
from track_range.pipeline.detecting import DetectionStage
from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.ranging import RangingStage
from track_range.pipeline.threads import run_in_threads
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import Ranger
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

CAMERA = PinholeCamera(700.0, 700.0, 620.0, 187.0, 1241, 374)
IMAGE: Image = np.zeros((374, 1241, 3), np.uint8)
X_M = np.array([0.0, -3.5])
"""Lateral positions: one car is ahead in the ego lane, one approaches in the oncoming lane."""


def z_m_at(time_s: float) -> FloatArray:
    return np.array([30.0 - 10.0 * time_s, 50.0 - 20.0 * time_s])


def detect(frame: Frame) -> Detections:
    z_m = z_m_at(frame.time_s)
    left, right = (620.0 + 700.0 * (X_M + side) / z_m for side in (-0.9, 0.9))
    boxes = np.stack([left, np.full(2, 187.0), right, 187.0 + 700.0 * 1.5 / z_m], axis=1)
    return Detections.of(boxes.tolist(), [0.9, 0.9], [2, 2])


class NumberingTracker:
    """A tracker that numbers the boxes in their order."""

    def update(self, detections: Detections, time_s: float, image: Image) -> Tracks:
        n = len(detections)
        return Tracks(
            np.arange(1, n + 1),
            detections.xyxy_px,
            detections.class_id,
            detections.score,
            np.ones(n, bool),
        )


class ExactRanger(Ranger):
    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        return Ranges(tracks.track_id, z_m_at(frame.time_s), np.full(2, 0.3))


def test_car_ahead_has_a_time_to_collision_and_oncoming_car_passes() -> None:
    pipeline = frame_pipeline(
        CAMERA,
        detection=DetectionStage(detect=detect),
        tracker=NumberingTracker(),
        ranging=RangingStage({"mono": ExactRanger()}),
    )
    results: list[FrameResult] = list(
        run_in_threads(pipeline, (Frame(i, i / 10, IMAGE, None) for i in range(20)))
    )
    last = results[-1]
    assert (last.ttc_s < 2).all()
    assert last.warnings is not None
    assert last.safety is not None
    np.testing.assert_allclose(last.warnings.path_offset_m, X_M, atol=0.3)
    np.testing.assert_allclose(
        last.safety.ttc_front_s, [(z_m_at(1.9)[0] - 1.5) / 10.0, np.nan], atol=0.1
    )
    known = [result.safety for result in results[5:] if result.safety is not None]
    assert len(known) == 15
    assert all(
        np.isfinite(safety.ttc_front_s[0]) and np.isnan(safety.ttc_front_s[1]) for safety in known
    )
