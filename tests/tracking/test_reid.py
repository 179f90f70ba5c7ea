"""Re-identification networks: a tiny one with known features, networks of other kinds, and OSNet on
real cars."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.support.networks.onnx_models import write_mean_network, write_model
from track_range.detection.formats.video_labels.kitti import read_kitti
from track_range.detection.models.onnx_session import ModelError, Runtime
from track_range.tracking.appearance.reid import ReidModel

ONE_THREAD = Runtime(device="cpu", n_threads=1)
MEAN, STD = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])


def picture(n):
    """An image of `n` objects, 30 x 60 px, in two colours each; their boxes; and their expected
    embeddings."""
    # blue, green, red
    colours = np.random.default_rng(4).integers(0, 256, (n, 2, 3)).astype(np.uint8)
    image = np.zeros((100, 40 * n + 20, 3), np.uint8)
    boxes = np.array([[10.0 + 40 * i, 20, 40 + 40 * i, 80] for i in range(n)]).reshape(-1, 4)
    for (x1, y1, x2, y2), (upper, lower) in zip(boxes.astype(int), colours, strict=True):
        image[y1 : (y1 + y2) // 2, x1:x2] = upper
        image[(y1 + y2) // 2 : y2, x1:x2] = lower
    features = ((colours[..., ::-1] / 255 - MEAN) / STD).reshape(n, 6)
    return image, boxes - 0.5, features / np.linalg.norm(features, axis=1, keepdims=True)


@pytest.mark.parametrize("batch", [1, 4, 32, "batch"])
@pytest.mark.parametrize("n", [0, 1, 3, 4, 9, 19])
def test_features_by_hand_for_every_batch(tmp_path, batch, n):
    model = ReidModel(
        write_mean_network(tmp_path / "m.onnx", input_shape=[batch, 3, 60, 30]), ONE_THREAD
    )
    assert (model.input_hw, model.n_values) == ((60, 30), 6)
    image, boxes, expected = picture(n)
    embedding = model.embed(image, boxes)
    assert (embedding.dtype, embedding.shape) == (np.float32, (n, 6))
    np.testing.assert_allclose(embedding, expected, atol=1e-5)


@pytest.mark.parametrize("size", [(20, 10), (64, 32), (240, 90)])
def test_crops_are_resized_to_the_networks_input(tmp_path, size):
    model = ReidModel(
        write_mean_network(tmp_path / "m.onnx", input_shape=["batch", 3, *size]), ONE_THREAD
    )
    image, boxes, expected = picture(3)
    # the edge between the halves blurs
    np.testing.assert_allclose(model.embed(image, boxes), expected, atol=0.03)


def test_crops_are_shrunk_by_area(tmp_path):
    model = ReidModel(write_mean_network(tmp_path / "m.onnx", input_shape=[1, 3, 4, 4]), ONE_THREAD)
    image = np.zeros((16, 16, 3), np.uint8)
    # sampling between pixels, without averaging over the area, would miss these columns
    image[:, ::4] = 252
    feature = ((np.full(3, 63 / 255) - MEAN) / STD)[[0, 1, 2, 0, 1, 2]]
    embedding = model.embed(image, np.array([[-0.5, -0.5, 15.5, 15.5]]))
    np.testing.assert_allclose(embedding[0], feature / np.linalg.norm(feature), atol=1e-4)


def test_default_input_size(tmp_path):
    path = write_mean_network(
        tmp_path / "m.onnx", input_shape=["batch", 3, "height", "width"], split_at_row=256
    )
    model = ReidModel(path, ONE_THREAD)
    assert model.input_hw == (256, 128)
    image, boxes, expected = picture(2)
    np.testing.assert_allclose(model.embed(image, boxes), expected, atol=0.01)


def test_unusable_boxes_and_boxes_at_the_border(tmp_path):
    model = ReidModel(
        write_mean_network(tmp_path / "m.onnx", input_shape=[2, 3, 60, 30]), ONE_THREAD
    )
    image, boxes, expected = picture(2)
    bad = [
        [-50, 0, -10, 90],
        [5, 5, 5, 90],
        [np.nan, 0, 10, 10],
        [10, 20, 12, 80],
        [-1e300, -1e300, 1e300, 1e300],
    ]
    embedding = model.embed(image, np.concatenate([boxes[:1], bad, boxes[1:]]))
    np.testing.assert_allclose(embedding, [expected[0], *np.zeros((5, 6)), expected[1]], atol=1e-5)
    cut = model.embed(image[:, 25:], boxes - [25, 0, 25, 0])  # half of the first object is outside
    np.testing.assert_allclose(cut, expected, atol=1e-5)
    assert not model.embed(np.zeros((1, 1, 3), np.uint8), boxes).any()


def test_boxes_in_a_tiny_image(tmp_path):
    model = ReidModel(
        write_mean_network(tmp_path / "m.onnx", input_shape=[1, 3, 60, 30]), ONE_THREAD
    )
    for shift in np.linspace(0, 1, 11):
        box = np.array([[-2.9 + shift, -2.9 + shift, 1.1 + shift, 1.1 + shift]])
        embedding = model.embed(np.full((2, 2, 3), 200, np.uint8), box)
        assert np.linalg.norm(embedding) == pytest.approx(1 if embedding.any() else 0, abs=1e-6)


def test_networks_of_other_kinds_are_refused(tmp_path):
    def refused(path, message):
        with pytest.raises(ModelError, match=message):
            ReidModel(path, ONE_THREAD)

    detector = write_model(tmp_path / "detector.onnx", np.zeros((1, 20, 6)))
    refused(detector, r"detector\.onnx.*re-identification")
    two = write_model(tmp_path / "two.onnx", np.zeros((1, 5)), np.zeros((1, 3)))
    refused(two, r"two\.onnx.*\[1, 5\], \[1, 3\]")
    mixed = write_model(tmp_path / "mixed.onnx", np.zeros((1, 5)), input_shape=("batch", 3, 64, 32))
    refused(mixed, r"mixed\.onnx.*2 crops")
    grey = write_model(tmp_path / "grey.onnx", np.zeros((1, 5)), input_shape=("batch", 1, 64, 32))
    refused(grey, r"grey\.onnx.*input")
    flat = write_model(tmp_path / "flat.onnx", np.zeros((1, 5)), input_shape=(1, 3))
    refused(flat, r"flat\.onnx.*input")
    refused(tmp_path / "missing.onnx", r"missing\.onnx")
    whole = write_mean_network(tmp_path / "m.onnx", input_shape=[1, 3, 60, 30])
    (tmp_path / "cut.onnx").write_bytes(whole.read_bytes()[:-40])
    refused(tmp_path / "cut.onnx", r"cut\.onnx.*ONNX")


def test_wrong_image_shape(tmp_path):
    path = write_mean_network(tmp_path / "m.onnx", input_shape=[1, 3, 60, 30])
    assert ReidModel(path, ONE_THREAD).notes == ()
    with pytest.raises(ValueError, match=r"image.*shape"):
        ReidModel(path, ONE_THREAD).embed(np.zeros((9, 9), np.uint8), np.zeros((0, 4)))


def test_osnet_on_real_cars(shared_data):
    model = ReidModel(shared_data / "models" / "osnet_x0_25_msmt17.onnx", ONE_THREAD)
    assert (model.input_hw, model.n_values) == ((256, 128), 512)
    folder = shared_data / "kitti_stereo" / "0003"
    labels, video = read_kitti(folder / "label.txt"), cv2.VideoCapture(str(folder / "left.mp4"))
    embeddings = {}
    for frame in range(8):
        image = video.read()[1]
        rows = labels.select((labels.frame == frame) & (labels.kitti_type == "Car"))
        if frame in (6, 7):
            order = np.argsort(rows.track_id)
            embeddings[frame] = rows.track_id[order], model.embed(image, rows.xyxy_px[order])
    (id_a, a), (id_b, b) = embeddings.values()
    np.testing.assert_array_equal(id_a, id_b)
    assert len(id_a) >= 3
    distance = 1 - a @ b.T
    assert (
        distance.argmin(axis=1).tolist()
        == distance.argmin(axis=0).tolist()
        == list(range(len(distance)))
    )
    assert 0.01 < np.diag(distance).min() <= np.diag(distance).max() < model.max_cosine_distance
    assert np.median(distance[~np.eye(len(distance), dtype=bool)]) > model.max_cosine_distance


def test_a_real_detector_is_refused(shared_data):
    with pytest.raises(ModelError, match=r"yolox_nano_416\.onnx.*re-identification"):
        ReidModel(shared_data / "models" / "yolox_nano_416.onnx", ONE_THREAD)
