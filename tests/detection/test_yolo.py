"""The detector on small ONNX files that the tests write, and on the real YOLOv5n where it is there."""

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from detection.boxes import iou
from detection.classes import ROAD_CLASSES
from detection.onnx_session import ModelError
from detection.yolo import YoloDetector, YoloSettings

N_ROWS = 3 * (8 * 8 + 4 * 4 + 2 * 2)  # a 64 x 64 input with strides 8, 16, 32
CAR, TRUCK = 2, 7


def write_model(path, rows, *, metadata=None, input_shape=(1, 3, 64, 64)):
    """A network whose output is `rows` (1, N, columns) whatever it sees."""
    image = helper.make_tensor_value_info("images", TensorProto.FLOAT, input_shape)
    output = helper.make_tensor_value_info("output0", TensorProto.FLOAT, rows.shape)
    zero = helper.make_tensor("zero", TensorProto.FLOAT, [1], [0.0])
    nodes = [
        helper.make_node("ReduceMean", ["images"], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
        helper.make_node("Add", ["rows", "nothing"], ["output0"]),
    ]
    weights = [zero, numpy_helper.from_array(rows.astype(np.float32), "rows")]
    graph = helper.make_graph(nodes, "constant", [image], [output], weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)])
    model.ir_version = 9
    helper.set_model_props(model, metadata or {})
    onnx.save(model, path)
    return path


def rows_with(*boxes, n_classes=80):
    """YOLOv5 rows: the given (cx, cy, w, h, objectness, {class: score}) first, silence after them."""
    rows = np.zeros((1, N_ROWS, 5 + n_classes))
    for i, (*cxcywh, objectness, scores) in enumerate(boxes):
        rows[0, i, :4] = cxcywh
        rows[0, i, 4] = objectness
        for class_index, score in scores.items():
            rows[0, i, 5 + class_index] = score
    return rows


def test_boxes_scores_and_classes_by_hand(tmp_path):
    model = write_model(tmp_path / "m.onnx", rows_with((32, 32, 16, 8, 0.8, {CAR: 0.5}), (8, 30, 4, 4, 0.9, {0: 1.0})))
    found = YoloDetector(model).detect(np.zeros((128, 256, 3), np.uint8))
    # 256 x 128 fits as 64 x 32 (scale 1/4) under 16 rows of padding: corner 24 -> 96, minus half a pixel
    assert [ROAD_CLASSES[c] for c in found.class_id] == ["person", "car"]
    np.testing.assert_allclose(found.score, [0.9, 0.4], atol=1e-6)
    np.testing.assert_allclose(found.xyxy_px[1], [95.5, 47.5, 159.5, 79.5])


def test_weak_foreign_duplicate_and_nan_boxes_are_dropped(tmp_path):
    rows = rows_with(
        (32, 32, 16, 8, 0.8, {CAR: 0.9}),
        (32, 32, 16, 8, 0.8, {TRUCK: 0.8}),  # the same object, by another name
        (12, 32, 8, 8, 0.05, {CAR: 1.0}),  # weak
        (50, 32, 8, 8, 0.9, {14: 1.0}),  # a bird
        (50, 32, np.nan, 8, 0.9, {CAR: 1.0}),
        (50, 32, 8, 8, np.nan, {CAR: 1.0}),
        (50, 32, 0, 8, 0.9, {CAR: 1.0}),
    )
    found = YoloDetector(write_model(tmp_path / "m.onnx", rows)).detect(np.zeros((64, 64, 3), np.uint8))
    assert [ROAD_CLASSES[c] for c in found.class_id] == ["car"]


def test_classes_wanted(tmp_path):
    rows = rows_with((32, 32, 16, 8, 0.8, {CAR: 0.9}), (12, 32, 8, 8, 0.9, {0: 1.0}))
    detector = YoloDetector(write_model(tmp_path / "m.onnx", rows), YoloSettings(class_id=(0,)))
    assert [ROAD_CLASSES[c] for c in detector.detect(np.zeros((64, 64, 3), np.uint8)).class_id] == ["person"]


def test_class_names_from_option_metadata_sidecar_and_default(tmp_path):
    two = rows_with((32, 32, 16, 8, 0.8, {1: 0.9}), n_classes=2)
    model = write_model(tmp_path / "two.onnx", two)
    with pytest.raises(ModelError, match="2 classes without names; give them with --names"):
        YoloDetector(model)
    with pytest.raises(ModelError, match="2 classes, but 3 names"):
        YoloDetector(model, names=("a", "b", "c"))
    with pytest.raises(ModelError, match="none of its classes"):
        YoloDetector(model, names=("cat", "dog"))
    assert YoloDetector(model, names=("person", "bus")).names == ("person", "bus")
    (tmp_path / "two.yaml").write_text("names: {0: person, 1: car}")
    assert YoloDetector(model).names == ("person", "car")
    (tmp_path / "two.yaml").write_text("labels: []")
    with pytest.raises(ModelError, match=r"two\.yaml: a list 'names:"):
        YoloDetector(model)
    told = write_model(tmp_path / "told.onnx", two, metadata={"names": "{0: 'bus', 1: 'truck'}"})
    assert YoloDetector(told).names == ("bus", "truck")
    for nonsense in ("bus truck", "7", "{"):
        odd = write_model(tmp_path / "odd.onnx", two, metadata={"names": nonsense})
        with pytest.raises(ModelError, match="its metadata 'names' is no list of names"):
            YoloDetector(odd)
    silent = YoloDetector(write_model(tmp_path / "coco.onnx", rows_with()))
    assert len(silent.names) == 80
    assert any("COCO" in note for note in silent.notes)


@pytest.mark.parametrize("shape", [(1, 84, 84), (1, N_ROWS), (1, N_ROWS, 5), (1, 84, 85)])
def test_unknown_outputs_are_named_with_the_layouts_known(tmp_path, shape):
    model = write_model(tmp_path / "m.onnx", np.zeros(shape))
    with pytest.raises(ModelError, match=r"unknown outputs output0 \[1, .*known layouts: YOLOv5"):
        YoloDetector(model)


def test_files_that_are_no_model(tmp_path):
    with pytest.raises(ModelError, match="no such model file"):
        YoloDetector(tmp_path / "none.onnx")
    text = tmp_path / "text.onnx"
    text.write_text("not a model")
    with pytest.raises(ModelError, match="not a usable ONNX model"):
        YoloDetector(text)
    whole = write_model(tmp_path / "whole.onnx", rows_with()).read_bytes()
    text.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ModelError, match="not a usable ONNX model"):
        YoloDetector(text)
    flat = write_model(tmp_path / "flat.onnx", rows_with(), input_shape=(1, 64))
    with pytest.raises(ModelError, match=r"one input \[batch, 3, height, width\] wanted"):
        YoloDetector(flat)


def test_a_device_that_is_not_here_falls_back_with_one_note(tmp_path):
    detector = YoloDetector(write_model(tmp_path / "m.onnx", rows_with()), device="tensorrt")
    if detector.device == "tensorrt":
        pytest.skip("TensorRT is here")
    assert sum("--device tensorrt" in note for note in detector.notes) == 1


@pytest.mark.parametrize("model", ["yolov5n_coco_640.onnx", "yolov5n_coco_dyn.onnx"])
def test_real_network_finds_the_near_car_wherever_the_image_is_padded(shared_data, model):
    import cv2

    capture = cv2.VideoCapture(str(shared_data / "kitti_stereo/0003/left.mp4"))
    image = capture.read()[1]
    detector = YoloDetector(shared_data / "models" / model, n_threads=2)
    label = np.array([[894.768, 190.650, 1241.0, 374.0]])  # label.txt, frame 0, car 0
    assert iou(label, detector.detect(image).xyxy_px).max() > 0.8
    shifted = cv2.copyMakeBorder(image, 40, 60, 80, 20, cv2.BORDER_CONSTANT, value=(114, 114, 114))
    moved = detector.detect(shifted).xyxy_px - np.array([80, 40, 80, 40])
    assert iou(label, moved).max() > 0.75
    assert len(detector.detect(image[:1, :1])) == 0
