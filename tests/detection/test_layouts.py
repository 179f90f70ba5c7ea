"""Each public layout gives exactly the boxes that its network encodes; garbage and ambiguous
outputs are refused."""

import re

import cv2
import numpy as np
import onnx
import pytest
from onnx import helper

from tests.detection import layout_networks
from tests.detection.layout_networks import CASES, OBJECTS, SCORES, SIDE, write
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.yolo.detector import YoloDetector
from track_range.detection.yolo.metadata import ModelOptions

IMAGE = np.random.default_rng(0).integers(0, 256, (SIDE, SIDE, 3), np.uint8)
CLASSES = ["car", "person", "truck", "car"]


@pytest.mark.parametrize("title", CASES)
def test_layout(tmp_path, title):
    name, make = CASES[title]
    case = make()
    detector = YoloDetector(write(tmp_path / "m.onnx", case), options=ModelOptions(**case.options))
    for _ in range(2):
        detections = detector.detect(IMAGE)
    assert detector.model.name == name
    classes = ["person"] * 4 if title == "YOLOv8-pose" else CLASSES
    assert [ROAD_CLASSES[i] for i in detections.class_id] == classes, detector.model.layout
    np.testing.assert_allclose(detections.xyxy_px + 0.5, OBJECTS, atol=0.05)
    np.testing.assert_allclose(detections.score, SCORES, atol=0.002)
    assert not case.note or any(case.note in note for note in detector.notes)


@pytest.mark.parametrize("title", ["YOLOv8, fractions", "YOLO-NAS", "YOLOv6", "YOLOv7 --end2end"])
def test_images_prepared_in_advance_have_the_same_boxes(tmp_path, title):
    case = CASES[title][1]()
    detector = YoloDetector(write(tmp_path / "m.onnx", case))
    prepared = [detector.prepared(IMAGE) for _ in range(3)]
    for detect in prepared:
        np.testing.assert_allclose(detect().xyxy_px + 0.5, OBJECTS, atol=0.05)
    wide = np.zeros((SIDE // 2, SIDE, 3), np.uint8)  # of another size, after the choice
    assert len(detector.detect(wide)) == 3  # the fourth is in the padding


def test_nothing_on_the_first_images(tmp_path):
    case = layout_networks.v8()
    case.outputs["output0"][:, 4:] = 0.001
    detector = YoloDetector(write(tmp_path / "m.onnx", case))
    for _ in range(9):
        assert len(detector.detect(IMAGE)) == 0
    assert not any("detected nothing" in note for note in detector.notes)
    detector.detect(IMAGE)
    assert any("detected nothing in the first 10 images" in note for note in detector.notes)
    assert detector.model.name == "yolov8"
    detector.restart()
    detector.detect(IMAGE)
    assert not any("detected nothing" in note for note in detector.notes)


def test_each_video_decides_on_its_own(tmp_path):
    path = write(tmp_path / "m.onnx", layout_networks.v8(unit=SIDE))
    detector = YoloDetector(path)
    for _ in range(2):
        assert len(detector.detect(IMAGE)) == 4
        assert "are plausible" in detector.why
        detector.restart()
        assert "the usual one" in detector.why


def test_garbage_is_refused(tmp_path):
    case = layout_networks.v8()
    case.outputs["output0"][0, :4] = np.array([SIDE / 2, SIDE / 2, SIDE, SIDE])[:, None]
    case.outputs["output0"][0, 4:] = 0.85
    detector = YoloDetector(write(tmp_path / "m.onnx", case))
    with pytest.raises(ModelError, match=r"m\.onnx: .*read as yolov8 .*whole image.*--layout"):
        detector.detect(IMAGE)


def test_a_wrong_layout_is_refused(tmp_path):
    detector = YoloDetector(
        write(tmp_path / "m.onnx", layout_networks.boxes_scores()),
        options=ModelOptions(layout="yolov4-boxes"),
    )
    with pytest.raises(ModelError, match=r"read as yolov4-boxes .*beyond the image"):
        detector.detect(IMAGE)


def test_one_large_object_is_no_garbage(tmp_path):
    case = layout_networks.v8()
    columns = case.outputs["output0"][0]
    columns[4:] = 0.001
    near = slice(1600 + 20 * 7 + 7, 1600 + 20 * 7 + 13)
    columns[:4, near] = np.array([SIDE / 2, SIDE / 2, SIDE, SIDE])[:, None]
    columns[4 + 7, near] = 0.9
    detector = YoloDetector(write(tmp_path / "m.onnx", case))
    for _ in range(12):
        assert len(detector.detect(IMAGE)) == 1


def test_ambiguous_heads_are_refused(tmp_path):
    case = layout_networks.raw_heads(layout_networks.V5_ANCHORS, "square")
    cell = case.outputs["head1"].reshape(3, 85, -1)
    cell[:, 2:4] = 0.0  # as large as the anchor in both readings
    detector = YoloDetector(write(tmp_path / "m.onnx", case))
    assert {reading.name for reading in detector.readings} == {"darknet-heads", "yolov5-heads"}
    for _ in range(9):
        assert len(detector.detect(IMAGE)) >= 4
    with pytest.raises(
        ModelError, match=r"as (darknet|yolov5)-heads or (darknet|yolov5)-heads, .*--layout"
    ):
        detector.detect(IMAGE)


def test_unknown_layouts(tmp_path):
    path = write(tmp_path / "m.onnx", layout_networks.v8())
    with pytest.raises(ModelError, match=r"'yolov9' \(--layout\).*detr, .*yolov8"):
        YoloDetector(path, options=ModelOptions(layout="yolov9"))
    with pytest.raises(ModelError, match="yolov7-end2end"):
        YoloDetector(path, options=ModelOptions(layout="yolov7-end2end"))
    (tmp_path / "m.yaml").write_text("layout: yolov8-corners\n")
    assert YoloDetector(path).model.name == "yolov8-corners"


def test_info_with_an_image(tmp_path, cli, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("a.png", np.full((SIDE, SIDE, 3), 90, np.uint8))
    path = write(tmp_path / "m.onnx", layout_networks.v8(unit=SIDE))
    status, printed, errors = cli("models", "info", path, "--image", "a.png", "--out", "b.png")
    assert (status, errors) == (0, "")
    words = " ".join(printed.split())
    assert "yolov8-fractions" in words
    assert "2 car" in words
    changed = np.argwhere((cv2.imread("b.png") != 90).any(axis=2))
    assert abs(changed[:, 1].max() - 290) <= 4  # the truck's right edge
    assert abs(changed[:, 0].max() - 300) <= 4
    status, printed, _ = cli("models", "info", path)
    assert "yolov8-corners" in printed
    status, _, errors = cli("models", "info", path, "--image", "a.png", "--out", "b.jpg")
    assert (status, "expected a PNG file" in errors) == (1, True)
    status, _, errors = cli("models", "info", path, "--image", "none.png")
    assert (status, "none.png" in errors) == (1, True)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.pt", b"PK\x03\x04rest", "PyTorch weights; use `yolo export model=a.pt format=onnx`"),
        ("a.onnx", b"\x80\x02pickle", "PyTorch weights"),
        ("a.engine", b"ftrt0000", "a TensorRT engine"),
        (
            "a.tflite",
            b"\x1c\0\0\0TFL3rest",
            "a TensorFlow Lite network; use `python -m tf2onnx.convert",
        ),
        ("a.onnx", b"version https://git-lfs.github.com/spec/v1\noid sha256:0", "git lfs pull"),
        ("a.onnx", b"\n<!DOCTYPE html><html>", "a web page"),
        ("a.xml", b"<?xml version='1.0'?>", "an OpenVINO network"),
        ("a.weights", b"\0\0\0\2", "track-range models import"),
    ],
)
def test_files_of_other_kinds(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(
        ModelError,
        match=re.escape(name) + ": .*" + re.escape(words),
    ):
        YoloDetector(tmp_path / name)


def test_operators_of_tensorrt(tmp_path):
    node = helper.make_node("EfficientNMS_TRT", ["images"], ["output0"], domain="TRT")
    values = [
        helper.make_tensor_value_info(n, onnx.TensorProto.FLOAT, (1, 3, 64, 64))
        for n in ("images", "output0")
    ]
    model = helper.make_model(
        helper.make_graph([node], "g", values[:1], values[1:]),
        opset_imports=[helper.make_opsetid("", 13), helper.make_opsetid("TRT", 1)],
        ir_version=9,
    )
    (tmp_path / "m.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(ModelError, match=r"m\.onnx: .*without TensorRT's non-maximum suppression"):
        YoloDetector(tmp_path / "m.onnx")


def test_real_networks_are_neither_refused_nor_ambiguous(shared_data):
    capture = cv2.VideoCapture(str(shared_data / "kitti_stereo/0005/left.mp4"))
    images = [capture.read()[1] for _ in range(3)]
    names = {"yolov5n_coco_640": "yolov5", "yolox_nano_416": "yolox", "picodet_s_416": "picodet"}
    for stem, name in names.items():
        detector = YoloDetector(shared_data / f"models/{stem}.onnx")
        for image in images:
            detector.detect(image)
        assert detector.model.name == name
        assert "usual for these shapes" not in detector.why


def test_another_number_of_boxes_in_each_image(tmp_path):
    """A suppression returns any number of rows: 1 to 4 here, by the brightness of the image."""
    case = layout_networks.labelled("b", "x", "l", "s", is_batched=False)
    constants = {
        "rows": case.outputs["output0"].astype(np.float32),
        "levels": np.float32([-1, 0.2, 0.4, 0.6]),
    }
    nodes = [
        helper.make_node("ReduceMean", ["images"], ["mean"], keepdims=0),
        helper.make_node("Greater", ["mean", "levels"], ["is_kept"]),
        helper.make_node("Compress", ["rows", "is_kept"], ["output0"], axis=0),
    ]
    image = helper.make_tensor_value_info("images", onnx.TensorProto.FLOAT, (1, 3, SIDE, SIDE))
    output = helper.make_tensor_value_info("output0", onnx.TensorProto.FLOAT, ("n", 7))
    weights = [onnx.numpy_helper.from_array(value, name) for name, value in constants.items()]
    graph = helper.make_graph(nodes, "variable", [image], [output], weights)
    onnx.save(
        helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=9),
        tmp_path / "m.onnx",
    )
    detector = YoloDetector(tmp_path / "m.onnx")
    for grey, n in ((0, 1), (255, 4), (128, 3), (64, 2), (0, 1), (255, 4)):
        detections = detector.detect(np.full((SIDE, SIDE, 3), grey, np.uint8))
        np.testing.assert_allclose(detections.xyxy_px + 0.5, OBJECTS[:n], atol=0.01)
    assert detector.model.name == "yolov7-end2end"
