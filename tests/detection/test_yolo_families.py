"""Identification of network families by their outputs, hand-worked boxes of every layout, and model
options."""

import numpy as np
import pytest

from tests.support.networks.onnx_models import write_model
from track_range.detection.classes import COCO_CLASSES, ROAD_CLASSES, VOC_CLASSES
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.yolo.detector import YoloDetector
from track_range.detection.yolo.metadata import ModelOptions

CELLS = 8 * 8 + 4 * 4 + 2 * 2  # a 64 x 64 input with strides 8, 16, 32
BLACK = np.zeros((64, 64, 3), np.uint8)
CAR, PERSON = 2, 0


def logit(p):
    return np.log(p / (1 - p))


def heads(*shapes, n_columns, n_anchors=3):
    """Raw heads of (rows, columns) cells without detections."""
    arrays = [np.zeros((1, n_anchors * n_columns, *shape)) for shape in shapes]
    for head in arrays:
        head.reshape(n_anchors, n_columns, *head.shape[2:])[:, 4:] = -20.0
    return arrays


def family_of(tmp_path, *outputs, **options):
    detector = YoloDetector(
        write_model(tmp_path / "m.onnx", *outputs), options=ModelOptions(**options)
    )
    return detector.model.family


def test_all_layouts_are_identified(tmp_path):
    assert family_of(tmp_path, np.zeros((1, 3 * CELLS, 85))) == "YOLOv5"
    # one grid more, of stride 64
    assert family_of(tmp_path, np.zeros((1, 3 * (CELLS + 1), 85))) == "YOLOv5"
    assert family_of(tmp_path, np.zeros((1, 3 * 20, 85))) == "YOLOv4-tiny"
    assert family_of(tmp_path, np.zeros((1, CELLS, 85))) == "YOLOX"
    assert family_of(tmp_path, np.zeros((1, 24, CELLS))) == "YOLOv8/YOLO11"
    assert family_of(tmp_path, *heads((2, 2), (4, 4), n_columns=85)) == "YOLOv4-tiny"
    assert family_of(tmp_path, *heads((8, 8), (4, 4), (2, 2), n_columns=85)) == "YOLOv4"
    assert family_of(tmp_path, np.zeros((1, 60, 1, 4)), np.zeros((1, 60, 80))) == "YOLOv4-tiny"
    assert family_of(tmp_path, np.zeros((1, 252, 80)), np.zeros((1, 252, 4))) == "YOLOv4"
    grids = [np.zeros((1, 3, side, side, 85)) for side in (8, 4, 2)]
    # older exports include the raw grids
    assert family_of(tmp_path, np.zeros((1, 3 * CELLS, 85)), *grids) == "YOLOv5"


@pytest.mark.parametrize(
    "shapes",
    [
        [(1, 83, 86)],
        [(1, 3 * CELLS)],
        [(1, 3 * CELLS, 5)],
        [(1, 2000, 6)],
        [(2, CELLS, 85)],
        [(1, 255, 2, 2)],
        [(1, 255, 2, 2), (1, 75, 4, 4)],
        [(1, 256, 2, 2), (1, 256, 4, 4)],
        [(1, 60, 1, 4), (1, 61, 80)],
    ],
)
def test_unknown_outputs_list_known_layouts(tmp_path, shapes):
    model = write_model(tmp_path / "m.onnx", *(np.zeros(shape) for shape in shapes))
    with pytest.raises(ModelError, match=r"m\.onnx: .*YOLOv4"):
        YoloDetector(model)


def test_yolov8_columns_by_hand(tmp_path):
    columns = np.zeros((1, 24, CELLS))
    columns[0, :4, 5] = 32, 32, 16, 8
    car, bird = VOC_CLASSES.index("car"), VOC_CLASSES.index("bird")
    columns[0, 4 + car, 5] = 0.7
    columns[0, 4 + bird, 6] = 0.9
    columns[0, 4 + car, 7] = np.nan
    detector = YoloDetector(write_model(tmp_path / "m.onnx", columns))
    detections = detector.detect(BLACK)
    np.testing.assert_allclose(detections.xyxy_px, [[23.5, 27.5, 39.5, 35.5]], atol=1e-5)
    np.testing.assert_allclose(detections.score, [0.7], atol=1e-6)
    assert detector.n_invalid == 1


def test_yolox_cells_by_hand(tmp_path):
    rows = np.zeros((1, CELLS, 85))
    last = 8 * 8 + 4 * 4 + 3  # the last cell: stride 32, column 1, row 1
    rows[0, last, :5] = 0.25, -0.5, np.log(0.5), np.log(0.25), 0.8
    rows[0, last, 5 + PERSON] = 0.5
    rows[0, 9, :5] = 0, 0, 1000, 0, 0.9  # column 1, row 1 of stride 8, too wide for any float
    rows[0, 9, 5 + CAR] = 1
    detector = YoloDetector(write_model(tmp_path / "m.onnx", rows))
    detections = detector.detect(BLACK)
    # centre (1.25, 0.5) * 32 = (40, 16), size 16 x 8
    np.testing.assert_allclose(detections.xyxy_px, [[31.5, 11.5, 47.5, 19.5]], atol=1e-5)
    np.testing.assert_allclose(detections.score, [0.4], atol=1e-6)
    assert detector.n_invalid == 1


@pytest.mark.parametrize("is_fine_first", [False, True])
def test_raw_heads_by_hand_in_either_order(tmp_path, is_fine_first):
    coarse, fine = heads((2, 2), (4, 4), n_columns=25)
    car = VOC_CLASSES.index("car")
    fine.reshape(3, 25, 4, 4)[1, :, 2, 3] = -20.0
    fine.reshape(3, 25, 4, 4)[1, :5, 2, 3] = logit(0.25), logit(0.5), np.log(0.5), 0.0, logit(0.8)
    fine.reshape(3, 25, 4, 4)[1, 5 + car, 2, 3] = logit(0.9)
    model = write_model(tmp_path / "m.onnx", *((fine, coarse) if is_fine_first else (coarse, fine)))
    detector = YoloDetector(model)
    detections = detector.detect(BLACK)
    # stride 16, anchor 37 x 58 of the masks 1,2,3: centre (3.25, 2.5) * 16 = (52, 40), size 18.5 x
    # 58
    np.testing.assert_allclose(detections.xyxy_px, [[42.25, 10.5, 60.75, 63.5]], atol=1e-4)
    assert [ROAD_CLASSES[c] for c in detections.class_id] == ["car"]
    np.testing.assert_allclose(detections.score, [0.72], atol=1e-6)
    assert detector.model.names == VOC_CLASSES
    assert detector.model.input_format.letterbox == "centred-128"
    assert detector.model.attributes["anchors"].source == "default of YOLOv4-tiny"

    detector = YoloDetector(
        model, options=ModelOptions(anchors="8,8 8,8 8,8 / 8,8 8,8 8,8", letterbox="stretch")
    )
    np.testing.assert_allclose(
        detector.detect(BLACK).xyxy_px, [[49.5, 35.5, 53.5, 43.5]], atol=1e-4
    )
    assert detector.model.attributes["anchors"].source == "as specified"


def test_scale_x_y_of_centres(tmp_path):
    coarse, fine = heads((2, 2), (4, 4), n_columns=6)
    coarse[0, :6, 0, 1] = 20.0, 0.0, 0.0, 0.0, 20.0, 20.0
    metadata = {"names": '["car"]', "scale_x_y": "[1.1, 1.0]", "anchors": "[[[8, 8]], [[4, 4]]]"}
    one_anchor = [head[:, :6] for head in (coarse, fine)]
    detections = YoloDetector(
        write_model(tmp_path / "m.onnx", *one_anchor, metadata=metadata)
    ).detect(BLACK)
    # x: 1.1 * 1 - 0.05 + 1 = 2.05 cells of 32 px = 65.6; the box is clipped at the image's edge
    np.testing.assert_allclose(detections.xyxy_px, [[61.1, 11.5, 63.5, 19.5]], atol=1e-4)


def test_corner_boxes_by_hand(tmp_path):
    boxes, scores = np.zeros((1, 60, 1, 4)), np.zeros((1, 60, 80))
    boxes[0, 7, 0] = 0.25, 0.5, 0.5, 0.75
    scores[0, 7, CAR] = 0.6
    detections = YoloDetector(write_model(tmp_path / "m.onnx", boxes, scores)).detect(BLACK)
    np.testing.assert_allclose(detections.xyxy_px, [[15.5, 31.5, 31.5, 47.5]], atol=1e-5)


def test_no_detections_in_any_layout(tmp_path):
    empty_outputs = [
        [np.zeros((1, 3 * CELLS, 85))],
        [np.zeros((1, CELLS, 85))],
        [np.zeros((1, 24, CELLS))],
        heads((2, 2), (4, 4), n_columns=85),
        [np.zeros((1, 60, 1, 4)), np.zeros((1, 60, 80))],
    ]
    for outputs in empty_outputs:
        assert len(YoloDetector(write_model(tmp_path / "m.onnx", *outputs)).detect(BLACK)) == 0


def test_sources_of_class_names(tmp_path):
    two_classes = np.zeros((1, 3 * CELLS, 7))
    model = write_model(tmp_path / "two.onnx", two_classes)
    with pytest.raises(ModelError, match=r"two\.onnx: .*--names"):
        YoloDetector(model)
    with pytest.raises(ModelError, match=r"two\.onnx: .*got 3"):
        YoloDetector(model, options=ModelOptions(names=("a", "b", "c")))
    assert names_of(model, names=("person", "bus")) == ("person", "bus")
    (tmp_path / "two.yaml").write_text("names: {0: person, 1: car}")
    assert names_of(model) == ("person", "car")
    assert names_of(model, names=("person", "bus")) == ("person", "bus")
    named = write_model(
        tmp_path / "named.onnx", two_classes, metadata={"names": "{0: 'bus', 1: 'truck'}"}
    )
    (tmp_path / "named.yaml").write_text("names: [person, car]")
    assert names_of(named) == ("bus", "truck")
    assert (
        names_of(write_model(tmp_path / "coco.onnx", np.zeros((1, 3 * CELLS, 85)))) == COCO_CLASSES
    )
    assert names_of(write_model(tmp_path / "voc.onnx", np.zeros((1, 3 * CELLS, 25)))) == VOC_CLASSES


def test_names_that_are_no_road_classes_are_noted(tmp_path):
    model = write_model(tmp_path / "m.onnx", np.zeros((1, 3 * CELLS, 10)))
    names = ("Cars", "Pedestrians", "big bus", "on rails", "boat")
    detector = YoloDetector(model, options=ModelOptions(names=names))
    assert [ROAD_CLASSES[i] for i in detector.known_class_id] == ["person", "car", "bus"]
    (note,) = [note for note in detector.notes if "left out" in note]
    assert "on rails" in note
    assert "boat" not in note  # COCO's other names are usual
    assert "Cars" not in note


def test_the_last_of_equal_outputs_is_read_with_a_note(tmp_path):
    """YOLOv9's auxiliary head comes before the main one; here it is empty."""
    main = np.zeros((1, 84, CELLS), np.float32)
    main[0, :5, 0] = 20, 20, 20, 20, 0.9
    model = write_model(tmp_path / "m.onnx", np.zeros_like(main), main)
    detector = YoloDetector(model, options=ModelOptions(layout="yolov8"))
    assert len(detector.detect(BLACK)) == 1
    (note,) = [note for note in detector.notes if "auxiliary" in note]
    assert "output0, output1" in note


def names_of(model, **options):
    return YoloDetector(model, options=ModelOptions(**options)).model.names


@pytest.mark.parametrize("names", ["bus truck", "7", "{", "[]"])
def test_metadata_without_a_list_of_names(tmp_path, names):
    model = write_model(tmp_path / "m.onnx", np.zeros((1, 3 * CELLS, 7)), metadata={"names": names})
    with pytest.raises(ModelError, match=r"m\.onnx: metadata 'names'"):
        YoloDetector(model)


@pytest.mark.parametrize(
    ("text", "key_word"),
    [
        ("labels: []", "family"),
        ("[", "YAML"),
        ("names: 7", "names"),
        ("divisor: 0", "divisor"),
        ("colours: red", "colours"),
        ("scale_x_y: [0.5]", "scale_x_y"),
        ("letterbox: left-114", "left-114"),
        ("letterbox: centred-999", "letterbox"),
    ],
)
def test_invalid_sidecar(tmp_path, text, key_word):
    model = write_model(tmp_path / "m.onnx", np.zeros((1, 3 * CELLS, 85)))
    (tmp_path / "m.yaml").write_text(text)
    with pytest.raises(ModelError, match=rf"m\.yaml.*: .*{key_word}"):
        YoloDetector(model)


@pytest.mark.parametrize(
    ("anchors", "message"),
    [
        ("10,14 23,27", r"m\.onnx: .*2 output heads"),
        ("10,14 / 23,27 3,3", r"m\.onnx: .*got 1, 2"),
        ("10,14 23 / 1,2 3,4", "--anchors"),
        ("10,14 23,-4 5,5 / 1,2 3,4 5,5", "--anchors"),
        ("a,b c,d e,f / 1,2 3,4 5,5", "--anchors"),
        ("10,14 / 23,27", r"m\.onnx: the 70 classes"),
        ("/", "--anchors"),
    ],
)
def test_invalid_anchors(tmp_path, anchors, message):
    model = write_model(tmp_path / "m.onnx", *heads((2, 2), (4, 4), n_columns=25))
    with pytest.raises(ModelError, match=message):
        YoloDetector(model, options=ModelOptions(anchors=anchors))


def test_one_scale_x_y_per_head(tmp_path):
    model = write_model(
        tmp_path / "m.onnx",
        *heads((2, 2), (4, 4), n_columns=25),
        metadata={"scale_x_y": "[1, 1, 1]"},
    )
    with pytest.raises(ModelError, match=r"m\.onnx: .*scale_x_y"):
        YoloDetector(model)


def test_sidecar_attributes(tmp_path):
    model = write_model(tmp_path / "m.onnx", np.zeros((1, CELLS, 85)))
    (tmp_path / "m.yaml").write_text(
        "family: custom\nletterbox: stretch\ncolours: rgb\ndivisor: 255\n"
    )
    read = YoloDetector(model).model
    assert (read.family, read.input_format.placement, read.input_format.colours) == (
        "custom",
        "stretch",
        "rgb",
    )
    assert read.input_format.divisor == 255
    assert read.attributes["letterbox"].source == "from m.yaml"


@pytest.mark.parametrize(
    ("file", "family", "n_names"),
    [
        ("yolov5n_coco_640.onnx", "YOLOv5", 80),
        ("yolov4tiny_voc_416.onnx", "YOLOv4-tiny", 20),
        ("yolox_nano_416.onnx", "YOLOX", 80),
        ("nanodet_m_416.onnx", "NanoDet", 80),
        ("picodet_s_416.onnx", "PicoDet", 80),
    ],
)
def test_real_networks_are_identified(shared_data, file, family, n_names):
    model = YoloDetector(shared_data / "models" / file).model
    assert (model.family, len(model.names)) == (family, n_names)
