"""The detector on small ONNX files written by the tests, and on the real YOLOv5n if available."""

import numpy as np
import pytest

from tests.support.networks.onnx_models import write_model, write_rectangle_finder
from track_range.detection.boxes import iou
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.models.onnx_session import ModelError, Runtime
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.detection.yolo.letterbox import rectangular_input_hw
from track_range.detection.yolo.metadata import ModelOptions
from track_range.foundation.prefetch import prefetch

N_ROWS = 3 * (8 * 8 + 4 * 4 + 2 * 2)  # a 64 x 64 input with strides 8, 16, 32
CAR, TRUCK = 2, 7


def rows_with(*boxes, n_classes=80):
    """YOLOv5 rows: the given (cx, cy, w, h, objectness, {class: score}) first, zeros after them."""
    rows = np.zeros((1, N_ROWS, 5 + n_classes))
    for i, (*cxcywh, objectness, scores) in enumerate(boxes):
        rows[0, i, :4] = cxcywh
        rows[0, i, 4] = objectness
        for class_index, score in scores.items():
            rows[0, i, 5 + class_index] = score
    return rows


def test_boxes_scores_and_classes_by_hand(tmp_path):
    model = write_model(
        tmp_path / "m.onnx",
        rows_with((32, 32, 16, 8, 0.8, {CAR: 0.5}), (8, 30, 4, 4, 0.9, {0: 1.0})),
    )
    detections = YoloDetector(model).detect(np.zeros((128, 256, 3), np.uint8))
    # 256 x 128 fits as 64 x 32 (scale 1/4) under 16 rows of padding: corner 24 -> 96, minus half a
    # pixel
    assert [ROAD_CLASSES[c] for c in detections.class_id] == ["person", "car"]
    np.testing.assert_allclose(detections.score, [0.9, 0.4], atol=1e-6)
    np.testing.assert_allclose(detections.xyxy_px[1], [95.5, 47.5, 159.5, 79.5])


def test_boxes_that_are_dropped(tmp_path):
    rows = rows_with(
        (32, 32, 16, 8, 0.8, {CAR: 0.9}),
        (32, 32, 16, 8, 0.8, {TRUCK: 0.8}),  # the same object as another class
        (12, 32, 8, 8, 0.05, {CAR: 1.0}),  # low score
        (50, 32, 8, 8, 0.9, {14: 1.0}),  # a bird
        (50, 32, np.nan, 8, 0.9, {CAR: 1.0}),
        (50, 32, 8, 8, np.nan, {CAR: 1.0}),
        (50, 32, 0, 8, 0.9, {CAR: 1.0}),
    )
    detector = YoloDetector(write_model(tmp_path / "m.onnx", rows))
    assert not any("NaN" in note for note in detector.notes)
    detections = detector.detect(np.zeros((64, 64, 3), np.uint8))
    assert [ROAD_CLASSES[c] for c in detections.class_id] == ["car"]
    assert [note for note in detector.notes if "NaN" in note and "2 boxes" in note]
    detector.detect(np.zeros((64, 64, 3), np.uint8))
    assert detector.n_invalid == 4


def test_selected_classes(tmp_path):
    rows = rows_with((32, 32, 16, 8, 0.8, {CAR: 0.9}), (12, 32, 8, 8, 0.9, {0: 1.0}))
    detector = YoloDetector(write_model(tmp_path / "m.onnx", rows), YoloSettings(class_id=(0,)))
    assert [ROAD_CLASSES[c] for c in detector.detect(np.zeros((64, 64, 3), np.uint8)).class_id] == [
        "person"
    ]


def test_threshold_per_class(tmp_path):
    rows = rows_with(
        (32, 32, 16, 8, 1.0, {CAR: 0.4}),
        (12, 32, 8, 8, 1.0, {0: 0.4}),
        (50, 32, 8, 8, 1.0, {0: 0.6}),
    )
    settings = YoloSettings(min_score=0.3, class_min_score=((0, 0.5),))
    detections = YoloDetector(write_model(tmp_path / "m.onnx", rows), settings).detect(
        np.zeros((64, 64, 3), np.uint8)
    )
    assert [ROAD_CLASSES[c] for c in detections.class_id] == ["person", "car"]


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((8, 8), np.uint8),
        np.zeros((8, 8, 3), np.uint16),
        np.zeros((0, 8, 3), np.uint8),
        np.zeros((8, 8, 4), np.uint8),
    ],
)
def test_images_of_wrong_format(tmp_path, image):
    detector = YoloDetector(write_model(tmp_path / "m.onnx", rows_with()))
    with pytest.raises(ValueError, match=r"image: .*uint8"):
        detector.detect(image)


def test_smallest_and_very_large_images(tmp_path):
    detector = YoloDetector(
        write_model(tmp_path / "m.onnx", rows_with((32, 32, 16, 8, 0.8, {CAR: 0.9})))
    )
    assert detector.detect(np.zeros((1, 1, 3), np.uint8)).xyxy_px.tolist() == [
        [-0.125, -0.0625, 0.125, 0.0625]
    ]
    (huge,) = detector.detect(np.zeros((6000, 8000, 3), np.uint8)).xyxy_px
    np.testing.assert_allclose(huge, [2999.5, 2499.5, 4999.5, 3499.5])


def rectangle(x1, y1, x2, y2, *, image_hw=(96, 96)):
    """A white rectangle on the grey of the padding."""
    image = np.full((*image_hw, 3), 114, np.uint8)
    image[y1:y2, x1:x2] = 255
    return image


def test_prepared_images(tmp_path):
    metadata = {"names": "{0: 'car'}"}
    path = write_rectangle_finder(
        tmp_path / "m.onnx", side_px=96, grey=114 / 255, metadata=metadata
    )
    images = [rectangle(8 * k, 8, 8 * k + 24, 40) for k in range(6)]
    images += [rectangle(16, 8, 64, 40, image_hw=(64, 128)), images[1]]
    detector, other = YoloDetector(path), YoloDetector(path)
    expected = [other.detect(image) for image in images]
    # all of them before the first detection
    prepared = [detector.prepared(image) for image in images]
    for detect, detections in zip(prepared, expected, strict=True):
        np.testing.assert_array_equal(detect().xyxy_px, detections.xyxy_px)
    np.testing.assert_array_equal(detector.detect(images[2]).xyxy_px, expected[2].xyxy_px)
    assert len({tuple(detections.xyxy_px[0]) for detections in expected}) == 7


def finder(tmp_path):
    return write_rectangle_finder(
        tmp_path / "m.onnx", side_px=96, grey=114 / 255, metadata={"names": "{0: 'car'}"}
    )


@pytest.mark.parametrize("other_hw", [(64, 128), (96, 96), (128, 64)])
def test_images_prepared_between_fill_and_infer(other_hw, tmp_path):
    path = finder(tmp_path)
    image, other = rectangle(8, 16, 40, 60), rectangle(16, 8, 56, 40, image_hw=other_hw)
    detector = YoloDetector(path)
    detector.fill(image)
    detect_other = detector.prepared(other)
    boxes = detector.decode(detector.infer())
    np.testing.assert_array_equal(boxes.xyxy_px, YoloDetector(path).detect(image).xyxy_px)
    np.testing.assert_array_equal(detect_other().xyxy_px, YoloDetector(path).detect(other).xyxy_px)
    for filled in (image, other, image):  # the padding is that of the image
        np.testing.assert_array_equal(
            detector.input_blob(filled), YoloDetector(path).input_blob(filled)
        )
    assert (
        detector.prepared(image)().score.tolist()
        == detector.candidates(np.zeros(8)).score.tolist()
        == [1.0]
    )


def test_an_invalid_image_does_not_release_the_input_twice(tmp_path):
    image, other = rectangle(8, 16, 40, 60), rectangle(16, 8, 56, 40)
    detector = YoloDetector(finder(tmp_path))
    expected = detector.detect(image).xyxy_px
    detector.fill(image)
    with pytest.raises(ValueError, match="image"):
        detector.fill(image[..., 0])
    np.testing.assert_array_equal(detector.decode(detector.infer()).xyxy_px, expected)
    detector.fill(image)
    detector.prepared(other)
    np.testing.assert_array_equal(detector.decode(detector.infer()).xyxy_px, expected)


def test_images_prepared_in_another_thread(tmp_path):
    """As in runs: one thread prepares, the other one detects, and may fill the input with other
    images meanwhile."""
    path = finder(tmp_path)
    sizes_hw = [(96, 96)] * 4 + [(64, 128), (128, 64)]
    images = [
        rectangle(k, 8, 24 + k % 7, 40, image_hw=sizes_hw[k % len(sizes_hw)]) for k in range(16)
    ]
    other = YoloDetector(path)
    expected = [other.detect(image).xyxy_px for image in images]
    detector = YoloDetector(path, runtime=Runtime(n_threads=1))
    prepared = prefetch((detector.prepared(images[k % 16]) for k in range(320)), depth=3)
    for k, detect in enumerate(prepared):
        detector.fill(images[k % 5])
        np.testing.assert_array_equal(detect().xyxy_px, expected[k % 16])
        np.testing.assert_array_equal(
            detector.candidates(np.zeros(8)).xyxy_px[:1], expected[k % 16]
        )
        np.testing.assert_array_equal(detector.decode(detector.infer()).xyxy_px, expected[k % 5])


def test_changing_image_sizes(shared_data):
    import cv2

    image = cv2.VideoCapture(str(shared_data / "kitti_stereo/0005/left.mp4")).read()[1]
    crops = [image[:, :w] for w in range(1242, 300, -90)]
    crops += [np.ascontiguousarray(crop.transpose(1, 0, 2)) for crop in crops]
    path, settings = shared_data / "models/yolov5n_coco_dyn.onnx", YoloSettings(size_px=320)
    detector = YoloDetector(path, settings)
    for crop in [*crops, *crops]:
        detections, expected = detector.detect(crop), YoloDetector(path, settings).detect(crop)
        np.testing.assert_array_equal(detections.xyxy_px, expected.xyxy_px)
    sizes = {rectangular_input_hw(crop.shape[:2], size_px=320) for crop in crops}
    assert len(sizes) > 8  # more than are cached


def test_half_precision_input(tmp_path):
    rows = rows_with((32, 32, 16, 8, 0.8, {CAR: 0.5}))
    model = write_model(tmp_path / "m.onnx", rows, is_half=True)
    detections = YoloDetector(model).detect(np.zeros((64, 64, 3), np.uint8))
    np.testing.assert_allclose(detections.score, [0.4], atol=1e-3)


def test_networks_of_other_tasks(tmp_path):
    model = write_model(tmp_path / "m.onnx", rows_with(), metadata={"task": "obb"})
    with pytest.raises(ModelError, match=r"m\.onnx: .*obb"):
        YoloDetector(model)


def test_no_selected_class(tmp_path):
    with pytest.raises(ModelError, match=r"m\.onnx: none of its classes"):
        YoloDetector(
            write_model(tmp_path / "m.onnx", rows_with(n_classes=2)),
            options=ModelOptions(names=("cat", "dog")),
        )


def test_unreadable_models(tmp_path):
    with pytest.raises(ModelError, match=r"none\.onnx: no such"):
        YoloDetector(tmp_path / "none.onnx")
    text = tmp_path / "text.onnx"
    text.write_text("not a model")
    with pytest.raises(ModelError, match=r"text\.onnx: not a usable"):
        YoloDetector(text)
    whole = write_model(tmp_path / "whole.onnx", rows_with()).read_bytes()
    text.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ModelError, match=r"text\.onnx: not a usable"):
        YoloDetector(text)
    flat = write_model(tmp_path / "flat.onnx", rows_with(), input_shape=(1, 64))
    with pytest.raises(ModelError, match=r"flat\.onnx: expected one input"):
        YoloDetector(flat)


def test_unavailable_device_falls_back_with_note(tmp_path):
    detector = YoloDetector(
        write_model(tmp_path / "m.onnx", rows_with()), runtime=Runtime(device="tensorrt")
    )
    if detector.session.device == "tensorrt":
        pytest.skip("TensorRT is available")
    assert sum("--device tensorrt" in note for note in detector.notes) == 1


@pytest.mark.parametrize("model", ["yolov5n_coco_640.onnx", "yolov5n_coco_dyn.onnx"])
def test_near_car_in_padded_images(shared_data, model):
    import cv2

    capture = cv2.VideoCapture(str(shared_data / "kitti_stereo/0003/left.mp4"))
    image = capture.read()[1]
    detector = YoloDetector(shared_data / "models" / model, runtime=Runtime(n_threads=2))
    label = np.array([[894.768, 190.650, 1241.0, 374.0]])  # label.txt, frame 0, car 0
    assert iou(label, detector.detect(image).xyxy_px).max() > 0.8
    shifted = cv2.copyMakeBorder(image, 40, 60, 80, 20, cv2.BORDER_CONSTANT, value=(114, 114, 114))
    moved = detector.detect(shifted).xyxy_px - np.array([80, 40, 80, 40])
    assert iou(label, moved).max() > 0.75
    assert len(detector.detect(image[:1, :1])) == 0
