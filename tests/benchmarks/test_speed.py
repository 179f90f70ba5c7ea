"""Tests of the speed workloads: the network that takes a given time, and figures of steps."""

from argparse import Namespace

import numpy as np
import pytest

import track_range as tr
from benchmarks.inputs.emulated_network import (
    INPUT_HW,
    OpenedStoredBoxes,
    StoredBoxes,
    time_ms,
    write_network,
)
from benchmarks.speed.devices import DEVICES
from benchmarks.speed.latency import step_figures
from track_range.detection.detections import Detections
from track_range.detection.models.devices import ACCELERATORS
from track_range.detection.models.onnx_session import Runtime
from track_range.run.options.opened import DetectorOptions

IMAGE = np.zeros((72, 128, 3), np.uint8)


def boxes(*lefts):
    return [
        Detections.of(np.array([[x, 10.0, x + 20, 30.0]]), np.full(1, 0.9), np.zeros(1, int))
        for x in lefts
    ]


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    path = tmp_path_factory.mktemp("network") / "network.onnx"
    write_network(path, 0.5)
    return path


def test_a_slower_network_takes_longer(network, tmp_path):
    slow = tmp_path / "slow.onnx"
    assert write_network(slow, 8.0) > 0
    assert time_ms(slow) > time_ms(network)


def test_stored_boxes_come_frame_by_frame_and_start_again(network):
    opened = OpenedStoredBoxes(boxes(1.0, 2.0))
    detector = opened(network, DetectorOptions(device="cpu", threads=1))
    lefts = [float(detector.detect(IMAGE).xyxy_px[0, 0]) for _ in range(3)]
    assert lefts == [1.0, 2.0, 1.0]
    assert detector.input_hw == INPUT_HW


def test_boxes_are_those_of_the_prepared_frame(network):
    runtime = Runtime(device="cpu", n_threads=1)
    detector = StoredBoxes(network, boxes(1.0, 2.0), runtime=runtime)
    first, second = detector.prepared(IMAGE), detector.prepared(IMAGE)
    assert [float(detect().xyxy_px[0, 0]) for detect in (first, second)] == [1.0, 2.0]


class NoBoxes:
    def detect(self, image):
        return Detections.empty()


def test_steps_have_percentiles_and_the_longest_are_named():
    rng = np.random.default_rng(0)
    frames = [(rng.integers(0, 255, (72, 128, 3), np.uint8),) for _ in range(3)]
    pipeline = tr.Pipeline.mono(focal_px=100.0, detector=NoBoxes())
    figures = step_figures(pipeline, frames, 10.0, Namespace(steps=8, paced=False))
    assert 0 < figures["p50"] <= figures["p95"] <= figures["p99"] <= figures["longest"]
    longest = figures["ms_of_longest"]
    assert longest == sorted(longest, reverse=True)
    assert set(figures["steps_of_longest"]) <= set(range(8))


def test_providers_are_those_of_the_devices():
    assert set(DEVICES) <= {"cpu", *ACCELERATORS}
