"""What the pipeline of a run takes as known of its cameras."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from track_range.detection.detections import Detections
from track_range.ranging.cameras.unknowns import Unknown
from track_range.recording.cameras.calibration import RecordingCalibration
from track_range.recording.cameras.camera_estimate import CameraEstimate, source_of_guess
from track_range.recording.recording import open_recording
from track_range.run.box_source import boxes_of
from track_range.run.build import open_pipeline
from track_range.run.options.python_keywords import pipeline_options
from track_range.stereo.geometry.focal_guess import FocalGuess
from track_range.stereo.geometry.mounting import Mounting

SIZE_PX = (128, 48)


class NoBoxes:
    def detect(self, image: np.ndarray) -> Detections:
        return Detections.empty()


def calibration(video: Path, focal_px: float | None) -> RecordingCalibration:
    recording = open_recording(video, focal_px=focal_px)
    recording.close()
    return recording.calibration


@pytest.mark.parametrize("is_given", [True, False])
def test_evidence_of_an_estimated_focal_length_counts_once(film, tmp_path: Path, is_given: bool):
    """The run of the same drive neither doubts the estimate nor measures its turns again."""
    video = film(tmp_path / "drive.mp4", [0.0, 0.1])
    if is_given:
        cameras = calibration(video, 100.0)
    else:
        by_motion = source_of_guess(FocalGuess(100.0, 0.015, "the turn at 0:02"), "motion", SIZE_PX)
        estimate = CameraEstimate(size_px=SIZE_PX, sources=(by_motion,))
        cameras = calibration(video, None).with_estimate(estimate)
    options = pipeline_options({"lanes": "off"})
    pipeline = open_pipeline(options, cameras, boxes_of(NoBoxes()))
    prior = pipeline.doubting.check.priors[Unknown.FOCAL]
    assert prior.kind == ("given" if is_given else "unknown")
    assert prior.value == pytest.approx(100.0, rel=0.01)
    assert 0.002 < prior.sigma < 0.03
    pipeline.close()


@pytest.mark.parametrize(
    ("options", "notes"),
    [
        (
            {"camera_height_m": 1.5},
            ("The camera height is as given, and not the 2.03 m of the calibration or mounting.",),
        ),
        ({"camera_height_m": 2.03}, ()),
        ({}, ()),
        ({"camera_height_m": 1.5, "mount": "yaw=1"}, ()),
    ],
)
def test_height_in_place_of_that_of_the_calibration(film, tmp_path: Path, options, notes):
    cameras = calibration(film(tmp_path / "drive.mp4", [0.0, 0.1]), 100.0)
    cameras = replace(cameras, mounting=Mounting(z_m=2.03))
    options = pipeline_options({"lanes": "off", **options})
    pipeline = open_pipeline(options, cameras, boxes_of(NoBoxes()))
    assert pipeline.setup_notes == notes
    pipeline.close()
