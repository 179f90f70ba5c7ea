import numpy as np
import pytest

import track_range as tr
from tests.support.networks import darknet_networks
from tests.support.networks.onnx_models import write_model
from track_range.detection.catalogue.darknet.network import read_network
from track_range.detection.classes import ROAD_CLASSES, ClassNameError
from track_range.detection.models.onnx_session import ModelError
from track_range.foundation.errors import ConfigError, UsageError
from track_range.run.options.detection import DetectionOptions, input_size
from track_range.run.options.opened import (
    DetectorOptions,
    class_names,
    open_detector,
    thresholds,
)

CAR, PERSON = ROAD_CLASSES.index("car"), ROAD_CLASSES.index("person")
BLACK = np.zeros((64, 64, 3), np.uint8)


@pytest.fixture
def model(tmp_path):
    """A model that detects a car (score 0.4) and a person (0.2), without class names."""
    rows = np.zeros((1, 252, 7))
    rows[0, 0] = 32, 32, 16, 8, 1.0, 0.0, 0.4
    rows[0, 1] = 8, 8, 8, 8, 1.0, 0.2, 0.0
    return write_model(tmp_path / "m.onnx", rows)


def test_detector_from_options(model, tmp_path):
    (tmp_path / "two.names").write_text("person\n\ncar\n")
    for names in ("person,car", str(tmp_path / "two.names")):
        detections = open_detector(model, DetectorOptions(names=names)).detect(BLACK)
        assert detections.class_id.tolist() == [CAR, PERSON]
    options = DetectorOptions(names="person,car", min_score="0.1,person=0.3")
    assert open_detector(model, options).detect(BLACK).class_id.tolist() == [CAR]
    assert len(open_detector(model, options, lowest_score=0.001).detect(BLACK)) == 2
    options = DetectorOptions(names="person,car", classes=("pedestrian",), letterbox="stretch")
    assert open_detector(model, options).detect(BLACK).class_id.tolist() == [PERSON]
    with pytest.raises(ModelError, match="none of its classes"):
        open_detector(model, DetectorOptions(names="person,car", classes=("truck",)))
    with pytest.raises(ModelError, match=r"--letterbox: .*middle"):
        open_detector(model, DetectorOptions(names="person,car", letterbox="middle"))


def test_detector_from_keywords(model):
    detector = tr.Detector(model, names=["person", "car"], min_score=0.3)
    assert detector.class_names == ("person", "car")
    assert detector.detect(BLACK).class_id.tolist() == [CAR]
    person = tr.Detector(model, names=["person", "car"], classes=["pedestrian"])
    assert person.detect(BLACK).class_id.tolist() == [PERSON]
    with pytest.raises(TypeError, match="min_scores"):
        tr.Detector(model, min_scores=0.3)


@pytest.mark.parametrize(
    ("option", "expected"),
    [
        (None, (0.1, ())),
        ("0.25", (0.25, ())),
        ("car=0.3", (0.1, ((CAR, 0.3),))),
        ("0.2, car=0.3,pedestrian=0.5", (0.2, ((CAR, 0.3), (PERSON, 0.5)))),
    ],
)
def test_thresholds(option, expected):
    assert thresholds(option, otherwise=0.1) == expected


@pytest.mark.parametrize("option", ["high", "1.5", "-0.1", "nan", "0.1,", "car=", "0.1,0.2"])
def test_invalid_thresholds(option):
    with pytest.raises(UsageError, match="--min-score"):
        thresholds(option, otherwise=0.1)


def test_unknown_class_of_a_threshold():
    with pytest.raises(ClassNameError, match=r"'cra'.*'car'"):
        thresholds("cra=0.3", otherwise=0.1)


@pytest.mark.parametrize(
    ("option", "size_px"), [(None, None), (608, 608), ("608", 608), ("960x544", (960, 544))]
)
def test_input_sizes(option, size_px):
    assert input_size(option) == size_px


@pytest.mark.parametrize(
    "option", ["large", "31", "4097", "608.5", "nan", "960x540", "960x", "960x544x3", "auto", ""]
)
def test_invalid_input_sizes(option):
    with pytest.raises(UsageError, match=r"--size: .*960x544"):
        input_size(option)


@pytest.mark.parametrize(
    ("options", "size_px", "every"),
    [
        ({}, None, 0),
        ({"size_px": 608}, "608", 0),
        ({"size_px": "auto"}, None, None),
        ({"size_px": "auto", "far_pass": 0}, None, 0),
        ({"size_px": "960x544", "far_pass": 3}, "960x544", 3),
    ],
)
def test_far_passes_by_the_size(options, size_px, every):
    settings = DetectionOptions(**options)
    assert DetectorOptions.of(settings).size_px == size_px
    assert settings.far_pass_every == every


def test_sizes_that_are_none_and_the_word_for_the_usual_one(cli):
    with pytest.raises(UsageError, match=r"such as 960x544, or \(in runs\) auto, got 'abc'"):
        input_size("abc")
    assert "auto|PX|WIDTHxHEIGHT" in "".join(cli("run", "--help")[1].split())
    assert "auto|auto" not in "".join(cli("run", "--help")[1].split())


@pytest.mark.parametrize("option", ["none.names", "a,,b", "", "visdron"])
def test_invalid_names(option):
    with pytest.raises(ConfigError, match="--names"):
        class_names(option)


def test_one_name_of_a_road_class():
    assert class_names("car") == ("car",)


def test_models_info_shows_attributes_and_sources(model, cli):
    status, printed, _ = cli("models", "info", model, "--names", "person,car")
    assert status == 0
    for words in (
        "YOLOv5",
        "centred-114",
        "default of YOLOv5",
        "person, car",
        "as specified",
        "classes not covered",
    ):
        assert words in printed
    status, _, complaint = cli("models", "info", model)
    assert status == 1
    assert "2 classes have no names" in complaint


def test_models_info_shows_anchors(tmp_path, cli):
    heads = [np.zeros((1, 75, 2, 2)), np.zeros((1, 75, 4, 4))]
    path = write_model(tmp_path / "m.onnx", *heads)
    anchors = "81,82 135,169 344,319 / 23,27 37,58 81,82"
    _, printed, _ = cli("models", "info", path)
    assert anchors in printed
    assert "VOC" in printed
    _, printed, _ = cli("models", "info", path, "--anchors", "1,2 3,4 5,6.5 / 1,1 2,2 3,3")
    assert "1,2 3,4 5,6.5 / 1,1 2,2 3,3" in printed


def test_models_info_does_not_download(cli, tmp_path, monkeypatch):
    monkeypatch.setenv("TRACK_RANGE_CACHE", str(tmp_path))
    status, printed, _ = cli("models", "info", "yolov5n")
    assert status == 0
    for words in (
        "not downloaded",
        "models pull yolov5n",
        "AGPL-3.0",
        "releases/download/v7.0/yolov5n.onnx",
        "sha1:",
    ):
        assert words in printed
    status, printed, _ = cli("models", "list")
    assert status == 0
    assert printed.count("not downloaded") >= 5
    assert str(tmp_path) in printed


def test_cached_model_is_used_by_name(model, cli, tmp_path, monkeypatch):
    (tmp_path / "models").mkdir()
    model.rename(tmp_path / "models/custom.onnx")
    monkeypatch.setenv("TRACK_RANGE_CACHE", str(tmp_path))
    status, printed, _ = cli("models", "info", "custom", "--names", "person,car")
    assert (status, "YOLOv5" in printed) == (0, True)
    status, printed, _ = cli("models", "pull", "custom")
    assert (status, "--detector custom" in printed) == (0, True)


def test_models_import_of_darknet_files(cli, tmp_path):
    cfg, weights, out = (tmp_path / f"net.{suffix}" for suffix in ("cfg", "weights", "onnx"))
    cfg.write_text(darknet_networks.yolov4_tiny(size_px=(64, 64), n_classes=2, width=16))
    darknet_networks.write_weights(weights, read_network(cfg), seed=0)
    status, printed, complaint = cli(
        "models", "import", cfg, weights, "--names", "person,car", "--out", out
    )
    assert status == 0, complaint
    assert "yolov4-tiny, 64x64" in printed
    assert "--letterbox stretch" in printed
    status, printed, _ = cli("models", "info", out)
    assert (status, "81,82 135,169 344,319 / 23,27 37,58 81,82" in printed) == (0, True)
    with weights.open("ab") as file:
        file.write(b"1234")
    status, _, complaint = cli(
        "models", "import", cfg, weights, "--names", "person,car", "--out", out
    )
    assert status == 1
    assert "net.weights" in complaint
