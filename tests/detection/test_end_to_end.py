"""Networks without non-maximum suppression, in the layouts of their official exporters, against
reference arithmetic.

The references follow the original implementations step by step, without code of track-range:
YOLOv10 and YOLO26 (rows as they are), D-FINE (DFINEPostProcessor), RF-DETR (PostProcess), DETR
(PostProcess).
"""

import json
import math

import cv2
import numpy as np
import pytest

from tests.support.networks.onnx_models import write_dfine, write_outputs
from track_range.detection.classes import COCO_CATEGORIES, COCO_CLASSES, ROAD_CLASSES
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.detection.yolo.metadata import ModelOptions

IMAGE = np.random.default_rng(0).integers(0, 256, (48, 160, 3), np.uint8)
CAR, TRUCK, PERSON = 2, 7, 0
COCO_CAR, COCO_PERSON = 3, 1
SIZES_INPUTS = {"images": ("N", 3, 64, 64), "orig_target_sizes": ("N", 2)}
ULTRALYTICS = {
    "task": "detect",
    "stride": "32",
    "imgsz": "[64, 64]",
    "end2end": "True",
    "names": "{0: 'car', 1: 'bus'}",
}


def sigmoid(x):
    return 1 / (1 + math.exp(-x))


def random_queries(n_queries, n_logits, *, seed, inside=0.2):
    """Logits, mostly low, and boxes as fractions (centre, size) inside of the image."""
    rng = np.random.default_rng(seed)
    logits = rng.normal(-6, 1, (n_queries, n_logits))
    logits[np.arange(n_queries), rng.integers(0, n_logits, n_queries)] = rng.normal(0, 2, n_queries)
    centre, size = rng.uniform(0.3, 0.7, (n_queries, 2)), rng.uniform(0.1, inside, (n_queries, 2))
    return logits, np.concatenate([centre, size], axis=1)


def corners(box, width, height):
    """box_cxcywh_to_xyxy() of DETR's box_ops.py, times the image's size."""
    cx, cy, w, h = box
    return [
        (cx - w / 2) * width,
        (cy - h / 2) * height,
        (cx + w / 2) * width,
        (cy + h / 2) * height,
    ]


def rows_of(detections):
    """(N, 6) boxes in the corner convention, score and class, in order of their first numbers."""
    rows = np.column_stack([detections.xyxy_px + 0.5, detections.score, detections.class_id])
    return rows[np.lexsort(rows.T[::-1])]


def assert_equal_rows(detections, expected, *, atol=1e-3):
    expected = np.array(expected)
    np.testing.assert_allclose(
        rows_of(detections), expected[np.lexsort(expected.T[::-1])], atol=atol
    )


def labelled_rows(*boxes, n=300):
    rows = np.zeros((1, n, 6))
    rows[0, : len(boxes)] = np.reshape(boxes, (-1, 6))
    return rows


def test_end_to_end_rows_are_not_suppressed(tmp_path):
    boxes = [
        (10, 20, 30, 40, 0.9, 0),
        (11, 20, 31, 40, 0.8, 0),
        (40, 25, 60, 45, 0.7, 1),
        (5, 5, 9, 9, 0.05, 0),
    ]
    model = write_outputs(
        tmp_path / "yolo26n.onnx", {"output0": labelled_rows(*boxes)}, metadata=ULTRALYTICS
    )
    detector = YoloDetector(model, YoloSettings(min_score=0.1))
    # 160 x 48 fits as 64 x 19 under 22 rows of padding
    expected = [
        [
            x1 * 2.5,
            (y1 - 22) * 48 / 19,
            x2 * 2.5,
            (y2 - 22) * 48 / 19,
            score,
            ROAD_CLASSES.index(name),
        ]
        for x1, y1, x2, y2, score, name in [(*row[:5], ("car", "bus")[row[5]]) for row in boxes[:3]]
    ]
    np.testing.assert_allclose(
        rows_of(detector.detect(IMAGE)), np.clip(expected, 0, [160, 48, 160, 48, 1, 9]), atol=1e-4
    )
    assert (detector.model.family, detector.model.names) == ("YOLOv10/YOLO26", ("car", "bus"))
    assert detector.model.input_format.letterbox == "centred-114"
    assert detector.n_invalid == 0


def test_one_box_with_two_similar_classes_is_one_object(tmp_path):
    rows = labelled_rows(
        (10, 20, 30, 40, 0.6, CAR), (10, 20, 30, 40, 0.4, TRUCK), (10, 20, 30, 40, 0.3, PERSON)
    )
    detector = YoloDetector(write_outputs(tmp_path / "m.onnx", {"output0": rows}))
    detections = detector.detect(IMAGE)
    assert [ROAD_CLASSES[c] for c in detections.class_id] == ["car", "person"]
    assert detector.model.names == COCO_CLASSES
    assert "COCO" in detector.model.attributes["names"].source


def test_rows_that_are_no_labels_are_counted(tmp_path):
    rows = labelled_rows(
        (10, 20, 30, 40, 0.9, 80),  # beyond the class names
        (10, 20, 30, 40, 0.9, -1),
        (10, 20, 30, 40, 0.9, 1.5),
        (2, 10, 20, 30, 40, 0.9),  # label, corners, score
        (10, 20, np.inf, 40, 0.9, 2),
        (10, 20, 30, 40, np.nan, 2),
        (40, 20, 60, 40, 1.0004, 2),  # rounded in half precision
    )
    names = ModelOptions(names=COCO_CLASSES)
    detector = YoloDetector(write_outputs(tmp_path / "m.onnx", {"output0": rows}), options=names)
    np.testing.assert_array_equal(detector.detect(IMAGE).score, [1.0])
    assert detector.n_invalid == 6
    assert any("6 boxes" in note for note in detector.notes)


def test_rows_without_names_and_without_a_zero_are_a_question(tmp_path):
    """EfficientDet's labels are COCO's ids, so that 3 is a car; those of YOLOv10 count from 0."""
    path = write_outputs(tmp_path / "m.onnx", {"o": labelled_rows((10, 20, 30, 40, 0.9, 3))})
    with pytest.raises(ModelError, match="--names coco or --names coco-ids"):
        YoloDetector(path).detect(IMAGE)
    for names, road in ((COCO_CLASSES, "motorcycle"), (COCO_CATEGORIES, "car")):
        (class_id,) = YoloDetector(path, options=ModelOptions(names=names)).detect(IMAGE).class_id
        assert ROAD_CLASSES[class_id] == road
    rows = labelled_rows((10, 20, 30, 40, 0.9, 3), (40, 20, 50, 40, 0.9, 0))
    detector = YoloDetector(write_outputs(tmp_path / "zero.onnx", {"o": rows}))
    assert sorted(detector.detect(IMAGE).class_id.tolist()) == [0, 3]  # person, motorcycle


def test_ssd_and_suppressed_boxes_without_names_and_without_a_zero_are_a_question(tmp_path):
    ssd = np.float32([[[[0, 3, 0.9, 0.1, 0.2, 0.4, 0.6]]]])
    suppressed = {
        "num": np.int64([[1]]),
        "boxes": np.float32([[[10, 20, 30, 40], [40, 20, 50, 40]]]),
        "scores": np.float32([[0.9, 0.8]]),
        "labels": np.int64([[3, 6]]),
    }
    for outputs in ({"detections": ssd}, suppressed):
        path = write_outputs(tmp_path / "m.onnx", outputs)
        with pytest.raises(ModelError, match="--names coco or --names coco-ids"):
            YoloDetector(path).detect(IMAGE)


def test_a_list_may_have_the_background_first(tmp_path):
    """torchvision's labels count from 1, and its lists of categories have __background__."""
    outputs = {
        "boxes": np.float32([[10, 20, 30, 40], [40, 20, 50, 40]]),
        "labels": np.int64([1, 2]),
        "scores": np.float32([0.9, 0.8]),
    }
    path = write_outputs(tmp_path / "m.onnx", outputs)
    for names in (("car", "bus"), ("__background__", "car", "bus"), ("N/A", "car", "bus")):
        detector = YoloDetector(path, options=ModelOptions(names=names))
        classes = [ROAD_CLASSES[i] for i in detector.detect(IMAGE).class_id]
        assert (detector.model.name, classes) == ("torchvision", ["car", "bus"])


def test_torchvisions_own_export_takes_one_image(tmp_path):
    outputs = {
        "boxes": np.float32([[10, 20, 30, 40], [40, 20, 50, 40]]),
        "labels": np.int64([3, 6]),
        "scores": np.float32([0.9, 0.8]),
    }
    path = write_outputs(tmp_path / "m.onnx", outputs, inputs={"image": (3, 64, 64)})
    detections = YoloDetector(path).detect(IMAGE)
    assert [ROAD_CLASSES[i] for i in detections.class_id] == ["car", "bus"]


def test_all_outputs_of_tensorflows_detection_zoo(tmp_path):
    n, n_raw = 5, 12
    outputs = {
        "detection_anchor_indices": np.float32([[3, 1, 0, 0, 0]]),
        "detection_boxes": np.zeros((1, n, 4), np.float32),
        "detection_classes": np.float32([[3, 1, 1, 1, 1]]),
        "detection_multiclass_scores": np.zeros((1, n, 91), np.float32),
        "detection_scores": np.float32([[0.9, 0.8, 0, 0, 0]]),
        "num_detections": np.float32([2]),
        "raw_detection_boxes": np.zeros((1, n_raw, 4), np.float32),
        "raw_detection_scores": np.zeros((1, n_raw, 91), np.float32),
    }
    outputs["detection_boxes"][0, :2] = [[0.2, 0.1, 0.6, 0.4], [0.2, 0.6, 0.6, 0.7]]
    detector = YoloDetector(write_outputs(tmp_path / "m.onnx", outputs))
    detections = detector.detect(IMAGE)
    assert detector.model.name == "tf-detections"
    assert [ROAD_CLASSES[i] for i in detections.class_id] == ["car", "person"]
    np.testing.assert_allclose(detections.xyxy_px[0] + 0.5, [16, 9.6, 64, 28.8], atol=0.01)


def test_end_to_end_mark_in_metadata(tmp_path):
    rows = labelled_rows((10, 20, 30, 40, 0.9, 0), n=2000)
    detector = YoloDetector(
        write_outputs(tmp_path / "m.onnx", {"output0": rows}, metadata=ULTRALYTICS)
    )
    assert len(detector.detect(IMAGE)) == 1


def dfine_reference(logits, boxes, image_wh, n_selected):
    """DFINEPostProcessor.forward, scores of at least 0.1: (left, top, right, bottom, score,
    label)."""
    pairs = [
        (sigmoid(value), query, label)
        for query, row in enumerate(logits)
        for label, value in enumerate(row)
    ]
    pairs.sort(reverse=True)
    return [
        [*corners(boxes[query], *image_wh), score, label]
        for score, query, label in pairs[:n_selected]
        if score >= 0.1
    ]


def test_dfine_network_with_its_postprocessing(tmp_path):
    logits, boxes = random_queries(40, 5, seed=1)
    model = write_dfine(tmp_path / "m.onnx", logits, boxes, inputs=SIZES_INPUTS, n_selected=30)
    names = ("person", "bicycle", "car", "bus", "traffic light")
    detector = YoloDetector(model, YoloSettings(min_score=0.1), options=ModelOptions(names=names))
    road = [ROAD_CLASSES.index(name) for name in names]
    expected = [[*row[:5], road[row[5]]] for row in dfine_reference(logits, boxes, (160, 48), 30)]
    assert len(expected) >= 10
    assert_equal_rows(detector.detect(IMAGE), expected)
    assert detector.model.family == "D-FINE/DEIM/RT-DETR"
    assert detector.session.has_target_sizes


def test_labels_boxes_and_scores_in_any_order(tmp_path):
    boxes = np.array([[[8, 16, 24, 32], [40, 16, 56, 32]]])
    outputs = {
        "a": np.array([[0.9, 0.3]]),
        "b": boxes.astype(float),
        "c": np.array([[CAR, PERSON]]),
    }
    detector = YoloDetector(write_outputs(tmp_path / "m.onnx", outputs, inputs=SIZES_INPUTS))
    assert_equal_rows(
        detector.detect(IMAGE), [[20, 12, 60, 24, 0.9, 2], [100, 12, 140, 24, 0.3, 0]]
    )


def best_of_queries(scores, boxes, image_wh, class_id_of):
    """Best class of each query with a score of at least 0.1, for classes with a road class."""
    rows = []
    for row, box in zip(scores, boxes, strict=True):
        label = max(range(len(row)), key=row.__getitem__)
        if row[label] >= 0.1 and class_id_of[label] is not None:
            rows.append([*corners(box, *image_wh), row[label], class_id_of[label]])
    return rows


def road_id(name):
    return (
        ROAD_CLASSES.index({"stop sign": "traffic sign"}.get(name, name))
        if name in (*ROAD_CLASSES, "stop sign")
        else None
    )


def test_rf_detr_with_misleading_names(tmp_path):
    logits, boxes = random_queries(50, 91, seed=2)
    logits[:20, COCO_CAR], logits[20:40, COCO_PERSON] = 2.5, 1.5
    outputs = {"dets": boxes[None], "labels": logits[None]}
    model = write_outputs(tmp_path / "rf-detr-nano.onnx", outputs, inputs={"input": (1, 3, 64, 64)})
    detector = YoloDetector(model, YoloSettings(min_score=0.1))
    scores = [[sigmoid(value) for value in row] for row in logits]
    expected = best_of_queries(
        scores, boxes, (160, 48), [road_id(name) for name in COCO_CATEGORIES]
    )
    assert len(expected) >= 30
    assert_equal_rows(detector.detect(IMAGE), expected)
    assert (detector.model.family, detector.model.names) == ("RF-DETR", COCO_CATEGORIES)
    # torchvision: to_tensor(image), normalize(means, stds), resize to a square
    pixels = cv2.resize(IMAGE, (64, 64), interpolation=cv2.INTER_LINEAR)[..., ::-1] / 255
    expected_blob = ((pixels - [0.485, 0.456, 0.406]) / [0.229, 0.224, 0.225]).transpose(2, 0, 1)
    np.testing.assert_allclose(detector.input_blob(IMAGE)[0], expected_blob, atol=1e-5)


@pytest.mark.parametrize("order", [("dets", "labels"), ("labels", "dets")])
def test_rf_detr_of_three_classes_and_no_object(tmp_path, order):
    logits, boxes = random_queries(30, 4, seed=3)  # both outputs are [1, 30, 4]
    arrays = {"dets": boxes[None], "labels": logits[None]}
    document = {
        "task": "detect",
        "means": [0.5, 0.5, 0.5],
        "stds": [0.25, 0.25, 0.25],
        "num_classes": 4,
        "class_id_to_name": {"0": "car", "1": "person", "2": "bus"},
    }
    model = write_outputs(
        tmp_path / "m.onnx",
        {name: arrays[name] for name in order},
        metadata={"rfdetr_inference": json.dumps(document)},
    )
    detector = YoloDetector(model, YoloSettings(min_score=0.1))
    scores = [[sigmoid(value) for value in row] for row in logits]
    assert_equal_rows(
        detector.detect(IMAGE), best_of_queries(scores, boxes, (160, 48), [2, 0, 4, None])
    )
    assert detector.model.names == ("car", "person", "bus", "N/A")
    assert detector.model.input_format.mean == (0.5, 0.5, 0.5)
    assert detector.model.attributes["std"].source == "from the model's metadata"


def test_names_without_the_no_object_logit(tmp_path):
    logits, boxes = random_queries(30, 3, seed=4)
    model = write_outputs(tmp_path / "m.onnx", {"dets": boxes[None], "labels": logits[None]})
    detector = YoloDetector(
        model, YoloSettings(min_score=0.1), options=ModelOptions(names=("car", "person"))
    )
    scores = [[sigmoid(value) for value in row[:2]] for row in logits]
    assert_equal_rows(detector.detect(IMAGE), best_of_queries(scores, boxes, (160, 48), [2, 0]))


def test_dfine_from_hugging_face(tmp_path):
    logits, boxes = random_queries(50, 80, seed=5)
    logits[:20, CAR] = 1.0
    outputs = {"logits": logits[None], "pred_boxes": boxes[None]}
    detector = YoloDetector(
        write_outputs(tmp_path / "m.onnx", outputs, inputs={"pixel_values": ("batch", 3, 64, 64)}),
        YoloSettings(min_score=0.1),
    )
    scores = [[sigmoid(value) for value in row] for row in logits]
    expected = best_of_queries(scores, boxes, (160, 48), [road_id(name) for name in COCO_CLASSES])
    assert_equal_rows(detector.detect(IMAGE), expected)
    assert detector.model.family == "RT-DETR/D-FINE"
    assert detector.model.input_format.mean == (0, 0, 0)


def test_detr_softmax(tmp_path):
    logits, boxes = random_queries(40, 92, seed=6)
    logits[:15, COCO_CAR], logits[15:, 91] = 6.0, 9.0  # the others are "no object"
    outputs = {"logits": logits[None], "pred_boxes": boxes[None]}
    detector = YoloDetector(
        write_outputs(tmp_path / "m.onnx", outputs), YoloSettings(min_score=0.1)
    )
    powers = [[math.exp(value) for value in row] for row in logits]
    scores = [[value / sum(row) for value in row[:-1]] for row in powers]
    expected = best_of_queries(
        scores, boxes, (160, 48), [road_id(name) for name in COCO_CATEGORIES]
    )
    assert len(expected) == 15
    assert_equal_rows(detector.detect(IMAGE), expected)
    assert (detector.model.family, len(detector.model.names)) == ("DETR", 91)


def test_softmax_in_the_sidecar(tmp_path):
    logits, boxes = random_queries(30, 3, seed=7)
    model = write_outputs(tmp_path / "m.onnx", {"logits": logits[None], "pred_boxes": boxes[None]})
    (tmp_path / "m.yaml").write_text(
        "scores: softmax\nnames: [car, person]\nmean: [0.5, 0.5, 0.5]\nstd: [2, 2, 2]\n"
    )
    detector = YoloDetector(model, YoloSettings(min_score=0.1))
    powers = [[math.exp(value) for value in row] for row in logits]
    scores = [[value / sum(row) for value in row[:-1]] for row in powers]
    assert_equal_rows(detector.detect(IMAGE), best_of_queries(scores, boxes, (160, 48), [2, 0]))
    assert detector.model.input_format.std == (2, 2, 2)


def test_rt_detr_from_ultralytics(tmp_path):
    logits, boxes = random_queries(300, 3, seed=8)
    pairs = sorted(
        ((sigmoid(v), q, c) for q, row in enumerate(logits) for c, v in enumerate(row)),
        reverse=True,
    )[:300]
    rows = np.array([[*boxes[query], score, label] for score, query, label in pairs])
    metadata = {
        "task": "detect",
        "end2end": "False",
        "head": "RTDETRDecoder",
        "names": "{0: 'car', 1: 'person', 2: 'x'}",
    }
    detector = YoloDetector(
        write_outputs(tmp_path / "m.onnx", {"output0": rows[None]}, metadata=metadata),
        YoloSettings(min_score=0.1),
    )
    # RTDETRPredictor.postprocess: xywh2xyxy, times the image's size
    expected = [
        [*corners(row[:4], 160, 48), row[4], (2, 0)[int(row[5])]]
        for row in rows
        if row[4] >= 0.1 and row[5] < 2
    ]
    assert len(expected) >= 50
    assert_equal_rows(detector.detect(IMAGE), expected)
    assert (detector.model.family, detector.model.input_format.placement) == ("RT-DETR", "stretch")


@pytest.mark.parametrize("names", ["{0: 'car', 1: 'person', 2: 'bus'}", "{0: 'car', 1: 'person'}"])
def test_rt_detr_from_older_versions_of_ultralytics(tmp_path, names):
    n_classes = names.count(":")
    logits, boxes = random_queries(300, n_classes, seed=8)
    scores = 1 / (1 + np.exp(-logits))
    metadata = {"task": "detect", "description": "Ultralytics rt-detr-l model", "names": names}
    model = write_outputs(
        tmp_path / "m.onnx", {"output0": np.hstack([boxes, scores])[None]}, metadata=metadata
    )
    detector = YoloDetector(model, YoloSettings(min_score=0.1))
    assert_equal_rows(
        detector.detect(IMAGE), best_of_queries(scores.tolist(), boxes, (160, 48), [2, 0, 4])
    )


def test_variable_input_is_square(tmp_path):
    logits, boxes = random_queries(30, 80, seed=9)
    inputs = {"pixel_values": ("batch", 3, "height", "width")}
    model = write_outputs(
        tmp_path / "m.onnx", {"logits": logits[None], "pred_boxes": boxes[None]}, inputs=inputs
    )
    (tmp_path / "m.yaml").write_text("size: 384\n")
    detector = YoloDetector(model)
    detector.detect(IMAGE)
    assert detector.input_hw == (384, 384)


LABELS = {"labels": np.zeros((1, 9), int), "boxes": np.zeros((1, 9, 4)), "scores": np.zeros((1, 9))}
ROWS = {"output": np.zeros((7, 6))}
IMAGE_INPUT = {"image": (1, 3, 64, 64)}


@pytest.mark.parametrize(
    ("outputs", "inputs", "word"),
    [
        (LABELS, {"images": (1, 3, 64, 64)}, "orig_target_sizes"),
        (LABELS, {"images": (1, 3, 64, 64), "target_sizes": (1, 2)}, "orig_target_sizes"),
        (LABELS, {"images": (32, 3, 64, 64), "orig_target_sizes": (32, 2)}, "batch size 1"),
        (ROWS, {**IMAGE_INPUT, "im_shape": (1, 2), "scale_factor": (1, 2)}, "without other inputs"),
        (ROWS, {"pixel_values": (1, 3, 64, 64), "pixel_mask": (1, 64)}, "without other inputs"),
        ({"logits": np.zeros((1, 30, 80))}, IMAGE_INPUT, "RF-DETR"),
        ({"boxes": np.zeros((1, 30, 4)), "logits": np.zeros((1, 31, 80))}, IMAGE_INPUT, "RF-DETR"),
        (
            {"dets": np.zeros((1, 30, 4)), "labels": np.zeros((1, 30, 17))},
            IMAGE_INPUT,
            "17 classes",
        ),
        ({"a": np.zeros((1, 30, 4)), "b": np.zeros((1, 30, 4))}, IMAGE_INPUT, "4 classes"),
    ],
)
def test_near_misses(tmp_path, outputs, inputs, word):
    model = write_outputs(tmp_path / "m.onnx", outputs, inputs=inputs)
    with pytest.raises(ModelError, match=rf"m\.onnx: .*{word}") as caught:
        YoloDetector(model)
    assert len(str(caught.value).replace(str(tmp_path), "")) <= 300


@pytest.mark.parametrize(
    "text", ["mean: [1, 2]", "std: [0, 1, 1]", "std: red", "scores: tanh", "mean: [a, b, c]"]
)
def test_invalid_attributes(tmp_path, text):
    model = write_outputs(tmp_path / "m.onnx", {"output0": labelled_rows()})
    (tmp_path / "m.yaml").write_text(text)
    with pytest.raises(ModelError, match=rf"m\.yaml.*'{text.partition(':')[0]}'"):
        YoloDetector(model)
