"""Comparison of imported Darknet networks with OpenCV 4's reader of Darknet files, with random
weights."""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.support.networks import darknet_networks
from tests.support.networks.darknet_networks import write_weights
from track_range.detection.catalogue.darknet.importer import import_darknet
from track_range.detection.catalogue.darknet.network import read_network
from track_range.detection.models.onnx_session import OnnxSession, Runtime

pytestmark = pytest.mark.slow  # OpenCV 4 has its own environment

PROJECT = Path(__file__).resolve().parents[2]
OPENCV_EPSILON, DARKNET_EPSILON = 1e-6, 1e-5

NETWORKS = {
    # text of the cfg and gain of the weights, lower for residual blocks so that their sums stay in
    # range
    "yolov4-tiny": (darknet_networks.yolov4_tiny(size_px=(416, 320)), 2.0),
    "yolov3-tiny": (darknet_networks.yolov3_tiny(size_px=(320, 416)), 2.0),
    "yolov4": (darknet_networks.yolov4(size_px=(256, 192), width=8), 1.4),
    "assorted": (darknet_networks.assorted(), 2.0),
}


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """Network, our outputs and OpenCV's outputs by name, for one random image and random weights.

    OpenCV adds 1e-6 to a variance, Darknet 1e-5; the difference is added to the variances for
    OpenCV.
    """
    python = Path(
        os.environ.get("TRACK_RANGE_OPENCV4", PROJECT / ".venv" / "opencv4" / "bin" / "python")
    )
    if not python.is_file():
        pytest.skip(
            f"OpenCV 4 not available: no {python} (`make setup` installs it; or set "
            "TRACK_RANGE_OPENCV4)"
        )
    folder = tmp_path_factory.mktemp("darknet")
    outputs = {}
    for seed, (name, (text, gain)) in enumerate(NETWORKS.items()):
        cfg, weights = folder / f"{name}.cfg", folder / f"{name}.weights"
        cfg.write_text(text)
        network = read_network(cfg)
        write_weights(weights, network, seed=seed, gain=gain)
        names = [f"class {i}" for i in range(network.heads[0][1].n_classes)]
        import_darknet(cfg, weights, folder / f"{name}.onnx", names=names)
        write_weights(
            weights, network, seed=seed, gain=gain, more_variance=DARKNET_EPSILON - OPENCV_EPSILON
        )
        blob = np.random.default_rng(seed).random((1, *network.input_shape), np.float32)
        np.save(folder / f"{name}.blob.npy", blob)
        outputs[name] = (
            network,
            OnnxSession(folder / f"{name}.onnx", Runtime(device="cpu", n_threads=1)).run(blob),
        )
    subprocess.run([python, Path(__file__).with_name("opencv4_forward.py"), folder], check=True)
    return {
        name: (*outputs[name], dict(np.load(folder / f"{name}.opencv.npz"))) for name in NETWORKS
    }


@pytest.mark.parametrize("name", NETWORKS)
def test_outputs_equal_opencv(compared, name):
    network, outputs, opencv = compared[name]
    assert len(outputs) == len(network.heads) == len(opencv) / 2
    for i, output in enumerate(outputs):
        expected = opencv[f"raw_{i}"]
        # outputs vary over the image, so the input has an effect
        assert expected.std(axis=(2, 3)).mean() > 0.02
        np.testing.assert_allclose(output, expected, rtol=0, atol=5e-5 * expected.std())


@pytest.mark.parametrize("name", NETWORKS)
def test_decoded_boxes_equal_opencv(compared, name):
    network, outputs, opencv = compared[name]
    for i, (raw, (_, head)) in enumerate(zip(outputs, network.heads, strict=True)):
        boxes, objectness, scores = decoded(raw[0], head, network.input_shape[1:])
        expected = opencv[f"decoded_{i}"]
        np.testing.assert_allclose(boxes, expected[:, :4], rtol=2e-4, atol=2e-5)
        np.testing.assert_allclose(objectness, expected[:, 4], rtol=0, atol=2e-5)
        is_clear = np.abs(scores - 0.2) > 1e-4  # OpenCV sets scores below 0.2 to zero
        kept = np.where(scores > 0.2, scores, 0)
        np.testing.assert_allclose(kept[is_clear], expected[:, 5:][is_clear], rtol=0, atol=2e-5)


def decoded(raw, head, input_hw):
    """Boxes (N, 4) cx cy w h as fractions of the image, objectness (N,), scores (N, C), by cell and
    anchor."""
    n_rows, n_columns = raw.shape[1:]
    cells = (
        raw.reshape(len(head.anchors_px), -1, n_rows, n_columns).transpose(2, 3, 0, 1).astype(float)
    )
    row, column = np.mgrid[:n_rows, :n_columns][..., None]
    stretched = head.scale_x_y * sigmoid(cells[..., :2]) - (head.scale_x_y - 1) / 2
    x, y = (stretched[..., 0] + column) / n_columns, (stretched[..., 1] + row) / n_rows
    width, height = np.moveaxis(
        np.array(head.anchors_px) / input_hw[::-1] * np.exp(cells[..., 2:4]), -1, 0
    )
    objectness = sigmoid(cells[..., 4])
    scores = objectness[..., None] * sigmoid(cells[..., 5:])
    return (
        np.stack([x, y, width, height], -1).reshape(-1, 4),
        objectness.ravel(),
        scores.reshape(-1, scores.shape[-1]),
    )


def sigmoid(x):
    return 1 / (1 + np.exp(-x))
