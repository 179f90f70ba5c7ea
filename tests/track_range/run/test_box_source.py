"""Boxes that a pre-pass has detected, in the run that follows, and passes for far road users."""

import json

import numpy as np
import pytest

from track_range.detection.detections import Detections
from track_range.run.box_source import BoxSource, remembered
from track_range.stereo.geometry.frames import Frame


def frame(index):
    return Frame(index, 0.1 * index, np.full((2, 2, 3), index, np.uint8), None)


def boxes_at(frame):
    return Detections.of([[0.0, 0.0, 1.0 + frame.index, 1.0]], [0.9], [2])


def test_frames_of_the_pre_pass_are_not_detected_again():
    detected, started = [], []

    def detect(frame):
        detected.append(frame.index)
        return boxes_at(frame)

    def prepare(frame):
        started.append(frame.index)
        return lambda: boxes_at(frame)

    source = BoxSource(
        detect=detect, candidates=boxes_at, description={}, notes=lambda: (), prepare=prepare
    )
    detect_before, remaining = remembered(source)
    assert detect_before(frame(2)).xyxy_px[0, 2] == 3.0
    assert detect_before(frame(4)).xyxy_px[0, 2] == 5.0
    by_run = [remaining.prepare(frame(index))() for index in range(4)]
    assert [boxes.xyxy_px[0, 2] for boxes in by_run] == [1.0, 2.0, 3.0, 4.0]
    assert started == [0, 1, 3]
    # a frame without its own preparation, and one that was given away
    assert [remaining.detect(frame(index)).xyxy_px[0, 2] for index in (4, 2)] == [5.0, 3.0]
    assert detected == [2, 4, 2]


def test_source_without_a_network_has_nothing_to_prepare():
    source = BoxSource(detect=boxes_at, candidates=boxes_at, description={}, notes=lambda: ())
    assert remembered(source)[1].prepare is None


@pytest.mark.slow
def test_far_passes_of_a_run_are_stated(small_drive, cli, tmp_path):
    inputs = ("--mono", small_drive.left, "--focal-px", 360, "--no-overlay", "--lanes", "off")
    for name, options in {
        "whole": (),
        "auto": ("--size", "auto"),
        "every second": ("--size", "320x96", "--far-pass", 2),
    }.items():
        status, _, complaint = cli(*inputs, *options, "--out", tmp_path / name)
        assert status == 0, complaint
    notes = {
        name: " ".join(json.loads((tmp_path / name / "summary.json").read_text())["notes"])
        for name in ("whole", "auto", "every second")
    }
    # images of 620x188 px, which the network sees at their resolution
    assert "second pass" not in notes["whole"] + notes["auto"]
    # 320x96 px, and in half of the frames 608x256 px
    assert "(608x256 px around the horizon) in 6 of 12 frames" in notes["every second"]
    assert "3.5 times as large" in notes["every second"]
    rows = [(tmp_path / name / "tracks.csv").read_text() for name in ("whole", "auto")]
    assert rows[0] == rows[1]
