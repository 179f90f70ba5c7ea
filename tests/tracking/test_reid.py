"""Re-identification networks: a tiny one whose features are known, wrong ones, and OSNet on real cars."""

from __future__ import annotations

import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from tests.detection.onnx_models import write_model
from track_range.detection.formats.kitti import read_kitti
from track_range.detection.models.onnx_session import ModelError, Runtime
from track_range.tracking.reid import ReidModel

ONE_THREAD = Runtime(device="cpu", n_threads=1)
MEAN, DEVIATION = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])


def write_mean_network(path, *, input_shape, split_at_row=None):
    """Features = each channel's mean over the upper half of the input, then over the lower half: (batch, 6)."""
    height = split_at_row or input_shape[2]
    constants = {
        name: np.array([value]) for name, value in (("0", 0), ("half", height // 2), ("all", height), ("2", 2))
    }
    nodes = []
    for name, start, end in (("upper", "0", "half"), ("lower", "half", "all")):
        nodes.append(helper.make_node("Slice", ["images", start, end, "2"], [f"{name}_half"]))
        nodes.append(helper.make_node("ReduceMean", [f"{name}_half"], [name], axes=[2, 3], keepdims=0))
    nodes.append(helper.make_node("Concat", ["upper", "lower"], ["features"], axis=1))
    image = helper.make_tensor_value_info("images", TensorProto.FLOAT, input_shape)
    features = helper.make_tensor_value_info("features", TensorProto.FLOAT, [input_shape[0], 6])
    weights = [numpy_helper.from_array(value, name) for name, value in constants.items()]
    model = helper.make_model(
        helper.make_graph(nodes, "means", [image], [features], weights), opset_imports=[helper.make_opsetid("", 13)]
    )
    model.ir_version = 9
    onnx.save(model, path)
    return path


def picture(n):
    """A row of `n` things, 30 x 60 px, each of two colours; their boxes; and what the network should make of them."""
    colours = np.random.default_rng(4).integers(0, 256, (n, 2, 3)).astype(np.uint8)  # blue, green, red
    image = np.zeros((100, 40 * n + 20, 3), np.uint8)
    boxes = np.array([[10.0 + 40 * i, 20, 40 + 40 * i, 80] for i in range(n)]).reshape(-1, 4)
    for (x1, y1, x2, y2), (upper, lower) in zip(boxes.astype(int), colours, strict=True):
        image[y1 : (y1 + y2) // 2, x1:x2] = upper
        image[(y1 + y2) // 2 : y2, x1:x2] = lower
    features = ((colours[..., ::-1] / 255 - MEAN) / DEVIATION).reshape(n, 6)
    return image, boxes - 0.5, features / np.linalg.norm(features, axis=1, keepdims=True)


@pytest.mark.parametrize("batch", [1, 4, 32, "batch"])
@pytest.mark.parametrize("n", [0, 1, 3, 4, 9, 19])
def test_features_by_hand_for_every_batch(tmp_path, batch, n):
    model = ReidModel(write_mean_network(tmp_path / "m.onnx", input_shape=[batch, 3, 60, 30]), ONE_THREAD)
    assert (model.input_hw, model.n_values) == ((60, 30), 6)
    image, boxes, wanted = picture(n)
    described = model.embed(image, boxes)
    assert (described.dtype, described.shape) == (np.float32, (n, 6))
    np.testing.assert_allclose(described, wanted, atol=1e-5)


@pytest.mark.parametrize("size", [(20, 10), (64, 32), (240, 90)])
def test_crops_are_resized_to_the_networks_input(tmp_path, size):
    model = ReidModel(write_mean_network(tmp_path / "m.onnx", input_shape=["batch", 3, *size]), ONE_THREAD)
    image, boxes, wanted = picture(3)
    np.testing.assert_allclose(model.embed(image, boxes), wanted, atol=0.03)  # the edge between the halves blurs


def test_an_open_size_is_that_of_people(tmp_path):
    path = write_mean_network(tmp_path / "m.onnx", input_shape=["batch", 3, "height", "width"], split_at_row=256)
    model = ReidModel(path, ONE_THREAD)
    assert model.input_hw == (256, 128)
    image, boxes, wanted = picture(2)
    np.testing.assert_allclose(model.embed(image, boxes), wanted, atol=0.01)


def test_boxes_that_nobody_could_describe_are_zeros_and_parts_outside_are_cut(tmp_path):
    model = ReidModel(write_mean_network(tmp_path / "m.onnx", input_shape=[2, 3, 60, 30]), ONE_THREAD)
    image, boxes, wanted = picture(2)
    bad = [[-50, 0, -10, 90], [5, 5, 5, 90], [np.nan, 0, 10, 10], [10, 20, 12, 80], [-1e300, -1e300, 1e300, 1e300]]
    described = model.embed(image, np.concatenate([boxes[:1], bad, boxes[1:]]))
    np.testing.assert_allclose(described, [wanted[0], *np.zeros((5, 6)), wanted[1]], atol=1e-5)
    cut = model.embed(image[:, 25:], boxes - [25, 0, 25, 0])  # half of the first is gone
    np.testing.assert_allclose(cut, wanted, atol=1e-5)
    assert not model.embed(np.zeros((1, 1, 3), np.uint8), boxes).any()


def test_slivers_inside_a_picture_of_two_pixels(tmp_path):
    model = ReidModel(write_mean_network(tmp_path / "m.onnx", input_shape=[1, 3, 60, 30]), ONE_THREAD)
    for shift in np.linspace(0, 1, 11):
        box = np.array([[-2.9 + shift, -2.9 + shift, 1.1 + shift, 1.1 + shift]])
        described = model.embed(np.full((2, 2, 3), 200, np.uint8), box)
        assert np.linalg.norm(described) == pytest.approx(1 if described.any() else 0, abs=1e-6)


def test_networks_that_are_none_for_re_identification(tmp_path):
    def refused(path, message):
        with pytest.raises(ModelError, match=message):
            ReidModel(path, ONE_THREAD)

    detector = write_model(tmp_path / "detector.onnx", np.zeros((1, 20, 6)))
    refused(
        detector,
        r"detector\.onnx: not a re-identification network: expected one output \[batch, values\] for 1 crops, found "
        r"\[1, 20, 6\] \(a detector's\?\)\.$",
    )
    two = write_model(tmp_path / "two.onnx", np.zeros((1, 5)), np.zeros((1, 3)))
    refused(two, r"for 1 crops, found \[1, 5\], \[1, 3\]")
    mixed = write_model(tmp_path / "mixed.onnx", np.zeros((1, 5)), input_shape=("batch", 3, 64, 32))
    refused(mixed, r"for 2 crops, found \[1, 5\]")
    grey = write_model(tmp_path / "grey.onnx", np.zeros((1, 5)), input_shape=("batch", 1, 64, 32))
    refused(grey, r"grey\.onnx: expected one input .*, found \[any, 1, 64, 32\]")
    flat = write_model(tmp_path / "flat.onnx", np.zeros((1, 5)), input_shape=(1, 3))
    refused(flat, r"flat\.onnx: one input \[batch, 3, height, width\] wanted, found: images \[1, 3\]")
    refused(tmp_path / "missing.onnx", r"missing\.onnx: no such model file")
    whole = write_mean_network(tmp_path / "m.onnx", input_shape=[1, 3, 60, 30])
    (tmp_path / "cut.onnx").write_bytes(whole.read_bytes()[:-40])
    refused(tmp_path / "cut.onnx", r"cut\.onnx: not a usable ONNX model \(.*\)\.$")


def test_a_device_that_is_not_to_be_had_is_told(tmp_path):
    path = write_mean_network(tmp_path / "m.onnx", input_shape=[1, 3, 60, 30])
    assert ReidModel(path, ONE_THREAD).notes == ()
    with pytest.raises(ValueError, match=r"image: expected shape \(\*, \*, 3\), got \(9, 9\)"):
        ReidModel(path, ONE_THREAD).embed(np.zeros((9, 9), np.uint8), np.zeros((0, 4)))


def test_osnet_finds_real_cars_again(shared_data):
    model = ReidModel(shared_data / "models" / "osnet_x0_25_msmt17.onnx", ONE_THREAD)
    assert (model.input_hw, model.n_values) == ((256, 128), 512)
    folder = shared_data / "kitti_stereo" / "0003"
    labels, video = read_kitti(folder / "label.txt"), cv2.VideoCapture(str(folder / "left.mp4"))
    described = {}
    for frame in range(8):
        image = video.read()[1]
        rows = labels.select((labels.frame == frame) & (labels.kitti_type == "Car"))
        if frame in (6, 7):
            order = np.argsort(rows.track_id)
            described[frame] = rows.track_id[order], model.embed(image, rows.xyxy_px[order])
    (id_a, a), (id_b, b) = described.values()
    np.testing.assert_array_equal(id_a, id_b)
    assert len(id_a) >= 3
    apart = 1 - a @ b.T
    assert apart.argmin(axis=1).tolist() == apart.argmin(axis=0).tolist() == list(range(len(apart)))
    assert 0.01 < np.diag(apart).min() <= np.diag(apart).max() < model.max_cosine_distance
    assert np.median(apart[~np.eye(len(apart), dtype=bool)]) > model.max_cosine_distance


def test_a_real_detector_is_refused(shared_data):
    with pytest.raises(ModelError, match=r"yolox_nano_416\.onnx: not a re-identification network: .*a detector's"):
        ReidModel(shared_data / "models" / "yolox_nano_416.onnx", ONE_THREAD)
