"""Systematic errors of the boxes of a detector: their values by model, and their way into a run."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.networks.onnx_models import write_model
from track_range.detection.box_errors import UNKNOWN_DETECTOR, BoxError, box_errors_of
from track_range.detection.catalogue.lookup import find_model
from track_range.detection.classes import COCO_CLASSES, ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.yolo.detector import YoloDetector
from track_range.detection.yolo.metadata import ModelOptions
from track_range.run.box_source import boxes_of, network_source
from track_range.run.options.detection import DetectionOptions
from track_range.run.options.opened import open_detector

CELLS = 8 * 8 + 4 * 4 + 2 * 2  # a 64 x 64 input with strides 8, 16, 32


def detector(tmp_path, n_classes=80, names=None, **more):
    path = write_model(tmp_path / "m.onnx", np.zeros((1, 3 * CELLS, 5 + n_classes)), **more)
    return YoloDetector(path, options=ModelOptions(names=names))


def test_values_are_read_from_the_model_or_the_file_beside_it(tmp_path):
    values = {"car": [-0.03, 0.04, 0.01, 0.05], "person": [0, 0.1, 0, 0.1]}
    (tmp_path / "m.yaml").write_text(f"box_errors: {values}\n")
    expected = {"car": BoxError(-0.03, 0.04, 0.01, 0.05), "person": BoxError(0.0, 0.1, 0.0, 0.1)}
    assert detector(tmp_path).box_errors == expected
    assert detector(
        tmp_path, metadata={"box_errors": '{"bus": [0, 0.02, 0, 0.02]}'}
    ).box_errors == {"bus": BoxError(0.0, 0.02, 0.0, 0.02)}


def test_networks_trained_with_coco_are_recognised_by_their_family(tmp_path):
    coco = detector(tmp_path, names=COCO_CLASSES)
    assert -0.06 < coco.box_errors["car"].log_height < -0.02
    assert "COCO" in coco.model.attributes["box_errors"].source
    own = detector(tmp_path, n_classes=8, names=ROAD_CLASSES)
    assert own.box_errors is None
    assert "unknown" in own.model.attributes["box_errors"].source


@pytest.mark.parametrize("name", ["road", "road-licensed"])
def test_packaged_detectors_are_known(name):
    network = YoloDetector(find_model(name).path)
    assert network.box_errors["car"].log_height_sigma < UNKNOWN_DETECTOR["car"].log_height_sigma


@pytest.mark.parametrize(
    ("value", "key_word"),
    [
        ("3", "log_height"),
        ("{lorry: [0, 0.1, 0, 0.1]}", "lorry"),
        ("{car: [0, 0.1, 0]}", "car"),
        ("{car: 0.1}", "car"),
        ("{car: [0, -0.1, 0, 0.1]}", "sigmas"),
        ("{car: [-0.6, 0.1, 0, 0.1]}", "means"),
        ("{car: [.nan, 0.1, 0, 0.1]}", "means"),
        ("{car: [0.1, 0.1, .nan, 0.1]}", "means"),
        ("[car]", "log_height"),
        ("{3: [0, 0.1, 0, 0.1]}", "log_height"),
        ("{car: [0, 0.1, .inf, 0.1]}", "means"),
        ("{car: [a, 0.1, 0, 0.1]}", "car"),
    ],
)
def test_impossible_values(tmp_path, value, key_word):
    (tmp_path / "m.yaml").write_text(f"box_errors: {value}")
    with pytest.raises(ModelError, match=rf"m\.yaml: 'box_errors'.*{key_word}"):
        detector(tmp_path)


def test_a_detector_object_may_know_its_errors():
    class Detector:
        def detect(self, image):
            return Detections.empty()

    assert boxes_of(Detector()).box_errors is None
    known = Detector()
    known.box_errors = box_errors_of({"car": (0.02, 0.03, 0.0, 0.03)})
    assert boxes_of(known).box_errors["car"].log_height == 0.02


def test_a_run_knows_the_errors_of_its_network(tmp_path):
    (tmp_path / "m.yaml").write_text("box_errors: {car: [-0.03, 0.04, 0.01, 0.05]}\n")
    detector(tmp_path)
    options = DetectionOptions(detector=str(tmp_path / "m.onnx"))
    source = network_source(options, Path, open_detector)
    assert source.box_errors == {"car": BoxError(-0.03, 0.04, 0.01, 0.05)}
    assert source.description["detector"]["box_errors"] == "from m.yaml"
