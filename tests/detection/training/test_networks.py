import numpy as np
import pytest
import torch

from tests.support.networks.onnx_models import write_model
from track_range.detection.detections import Detections
from track_range.detection.models.onnx_session import ModelError, OnnxSession
from track_range.detection.training.networks.network import AnchorNetwork
from track_range.detection.training.networks.registry import NETWORKS, make_network
from track_range.detection.training.networks.road_net import RoadNetHead
from track_range.detection.training.teacher import yolov5_of_export
from track_range.detection.training.train import export_onnx
from track_range.detection.yolo.detector import YoloDetector, YoloSettings

ROAD = ["person", "bicycle", "car", "motorcycle", "bus", "truck", "traffic light", "traffic sign"]


EXPORTED = [
    pytest.param(name, marks=pytest.mark.train if name == "yolov5s" else ())
    for name, kind in NETWORKS.items()
    if kind.anchors_px
]
"""YOLOv5s differs from YOLOv5n in its width and depth only; its export takes longer."""


def n_weights(network):
    return sum(parameter.numel() for parameter in network.parameters())


def random_network(name, **options):
    """A network with random weights and batch statistics, with varying objectness."""
    torch.manual_seed(0)
    network = make_network(name, 8, **options)
    with torch.no_grad():
        for module in network.modules():
            if isinstance(module, torch.nn.BatchNorm2d):
                module.running_mean.normal_(0, 0.1)
                module.running_var.uniform_(0.5, 1.5)
        for head in (module for module in network.modules() if isinstance(module, RoadNetHead)):
            head.scores.weight.mul_(30)
            head.bins.weight.mul_(20)
            head.scores.bias.add_(2)
        for head in network.heads if isinstance(network, AnchorNetwork) else ():
            head.weight.mul_(20)
            head.bias.view(network.n_anchors, -1)[:, 4] += 3
    return network.eval()


@pytest.mark.parametrize(("name", "n"), [("yolov5n", 1_872_157), ("yolov5s", 7_235_389)])
def test_parameter_counts_equal_official_ones(name, n):
    # Ultralytics' YOLOv5 v6 prints these for yolov5n.yaml and yolov5s.yaml (with the anchors, which
    # are no weights)
    assert n_weights(make_network(name, 80)) == n


def test_parameter_count_of_yolov4_tiny():
    # 6.06 million, 24.25 MB: the size of AlexeyAB's yolov4-tiny.weights without its batch
    # statistics
    assert n_weights(make_network("yolov4-tiny", 80)) * 4 / 1e6 == pytest.approx(24.2, abs=0.1)


@pytest.mark.parametrize("name", NETWORKS)
def test_attention_preserves_shapes(name):
    plain, attentive = make_network(name, 8), make_network(name, 8, has_cbam=True)
    assert 1.0 < n_weights(attentive) / n_weights(plain) < 1.02
    images = torch.rand(1, 3, 64, 96)
    assert [h.shape for h in attentive.eval()(images)] == [h.shape for h in plain.eval()(images)]


@pytest.mark.slow
@pytest.mark.parametrize("has_cbam", [False, True])
@pytest.mark.parametrize("name", EXPORTED)
def test_export_equals_network(tmp_path, name, has_cbam):
    network = random_network(name, has_cbam=has_cbam)
    path = tmp_path / "model.onnx"
    export_onnx(network, path, {"names": ROAD, "letterbox": "centred-114"})
    images = torch.rand(2, 3, 96, 160, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        expected = network.decode(network(images)).numpy()
    actual = OnnxSession(path).run(images.numpy())[0]
    assert actual.shape == expected.shape
    # px; random boxes may be huge
    assert np.allclose(actual[..., :4], expected[..., :4], atol=1e-3, rtol=1e-6)
    assert np.abs(actual[..., 4:] - expected[..., 4:]).max() < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPORTED)
def test_detector_loads_export_without_options(tmp_path, name):
    network = random_network(name)
    path = tmp_path / "model.onnx"
    export_onnx(
        network,
        path,
        {"family": NETWORKS[name].family, "names": ROAD, "letterbox": "centred-114", "size": 96},
    )
    detector = YoloDetector(path, YoloSettings(min_score=0.05))
    detections = detector.detect(
        np.random.default_rng(0).integers(0, 255, (80, 96, 3), dtype=np.uint8)
    )
    assert isinstance(detections, Detections)
    assert len(detections) > 0
    assert (detector.model.family, detector.input_hw) == (NETWORKS[name].family, (96, 96))
    assert detector.model.names == tuple(ROAD)


@pytest.mark.slow
@pytest.mark.parametrize("hw", [(96, 160), (64, 64)])  # the coarsest level has ceil(h / 64) rows
def test_detector_decodes_the_export_of_the_road_network(tmp_path, hw):
    network = random_network("road")
    path = tmp_path / "road.onnx"
    input_format = {"letterbox": "centred-114", "mean": [0, 0, 0], "std": [1, 1, 1]}
    export_onnx(
        network, path, {"family": "RoadNet", "names": ROAD, **input_format, "size": max(hw)}
    )
    detector = YoloDetector(path, YoloSettings(min_score=0.3))
    image = np.random.default_rng(0).integers(0, 255, (*hw, 3), dtype=np.uint8)
    detector.fill(image)
    candidates = detector.model.decoder(detector.infer(), np.full(8, 0.3))
    with torch.no_grad():
        images = torch.from_numpy(detector.input_blob(image))
        rows = network.decode(network(images))[0].numpy()
    rows = rows[rows[:, 5:].max(1) >= 0.3]
    assert (detector.model.family, detector.input_hw, len(rows) > 20) == ("RoadNet", hw, True)
    low, high = rows[:, :2] - rows[:, 2:4] / 2, rows[:, :2] + rows[:, 2:4] / 2
    expected = np.concatenate([low, high], 1).clip(0, [hw[1], hw[0]] * 2)
    assert np.abs(candidates.xyxy_net - expected).max() < 1e-2
    assert np.abs(candidates.score - rows[:, 5:].max(1)).max() < 1e-5


def test_import_of_official_export(tmp_path):
    network = random_network("yolov5n")
    path = tmp_path / "model.onnx"
    export_onnx(network, path, {"names": ROAD})
    again = yolov5_of_export(path)
    images = torch.rand(1, 3, 64, 96)
    with torch.no_grad():
        assert torch.allclose(
            again.decode(again(images)), network.decode(network(images)), atol=1e-3
        )


def test_equals_official_yolov5(shared_data):
    path = shared_data / "models/yolov5n_coco_dyn.onnx"
    network = yolov5_of_export(path)
    images = torch.rand(1, 3, 320, 416)
    with torch.no_grad():
        actual = network.decode(network(images)).numpy()
    expected = OnnxSession(path).run(images.numpy())[0]
    assert np.abs(actual - expected)[..., :4].max() < 2e-3  # px of boxes up to 400
    assert np.abs(actual - expected)[..., 4:].max() < 1e-5


def test_import_of_other_models(tmp_path):
    export_onnx(random_network("yolov4-tiny"), tmp_path / "tiny.onnx", {"names": ROAD})
    write_model(tmp_path / "none.onnx", np.zeros((1, 252, 13)))
    (tmp_path / "text.onnx").write_text("not a model")
    for name in ("tiny", "none", "text"):
        with pytest.raises(ModelError, match=name):
            yolov5_of_export(tmp_path / f"{name}.onnx")
