"""Real architectures with random weights, exported as a user exports them, against the library's own
preparation of images and the PyTorch network.

Needs torch, transformers and onnxscript, which are no dependency of the project.
"""

import warnings

import numpy as np
import pytest

from track_range.ranging.networks.network import open_depth_network

torch = pytest.importorskip("torch", reason="needs PyTorch")
transformers = pytest.importorskip("transformers", reason="needs transformers")
pytestmark = pytest.mark.slow

RNG = np.random.default_rng(7)


class Wrapped(torch.nn.Module):
    """The network with some of its outputs as a tuple, for the exporter."""

    def __init__(self, network, names):
        super().__init__()
        self.network, self.names = network.eval(), names

    def forward(self, pixel_values):
        outputs = self.network(pixel_values=pixel_values)
        return tuple(getattr(outputs, name) for name in self.names)


def dinov2(layers=4):
    return transformers.Dinov2Config(
        hidden_size=32,
        num_hidden_layers=layers,
        num_attention_heads=2,
        image_size=126,
        patch_size=14,
        out_features=[f"stage{i + 1}" for i in range(layers)],
        reshape_hidden_states=False,
    )


def depth_anything(kind):
    config = transformers.DepthAnythingConfig(
        backbone_config=dinov2(),
        reassemble_hidden_size=32,
        neck_hidden_sizes=[8, 16, 32, 32],
        fusion_hidden_size=16,
        head_hidden_size=8,
        depth_estimation_type=kind,
        max_depth=80 if kind == "metric" else 1,
    )
    return transformers.DepthAnythingForDepthEstimation(config)


def dpt():
    config = transformers.DPTConfig(
        hidden_size=32,
        num_hidden_layers=4,
        num_attention_heads=2,
        intermediate_size=32,
        image_size=128,
        patch_size=16,
        backbone_out_indices=[0, 1, 2, 3],
        neck_hidden_sizes=[8, 16, 32, 32],
        fusion_hidden_size=16,
        is_hybrid=False,
    )
    return transformers.DPTForDepthEstimation(config)


IMAGENET = ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225])
HALVES = ([0.5] * 3, [0.5] * 3)


def exported(path, network, image, statistics):
    """Export a network for an image (H, W, 3), BGR, and what it gives for the image."""
    mean, std = statistics
    rgb = image[..., ::-1].astype(np.float32) / 255
    pixels = ((rgb - mean) / std).transpose(2, 0, 1)[None].astype(np.float32)
    given = torch.from_numpy(np.ascontiguousarray(pixels))
    wrapped = Wrapped(network, ["predicted_depth"])
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter
        (depth,) = wrapped(given)
        torch.onnx.export(
            wrapped,
            (given,),
            str(path),
            input_names=["pixel_values"],
            output_names=["predicted_depth"],
            opset_version=17,
            dynamo=False,
        )
    return depth.numpy()[0]


@pytest.mark.parametrize(
    ("name", "make", "statistics", "hw"),
    [
        ("depth-anything", lambda: depth_anything("relative"), IMAGENET, (126, 210)),
        ("depth-anything-2-metric", lambda: depth_anything("metric"), IMAGENET, (126, 210)),
        ("dpt", dpt, HALVES, (128, 128)),
    ],
)
def test_an_export_gives_what_the_network_gives(tmp_path, name, make, statistics, hw):
    torch.manual_seed(3)
    image = RNG.integers(0, 256, (*hw, 3), dtype=np.uint8)
    path = tmp_path / "net.onnx"
    expected = exported(path, make(), image, statistics)
    path.with_suffix(".yaml").write_text(f"format: {name}")
    dense = open_depth_network(path).measure(image, 500.0)
    assert dense.is_metric is name.endswith("-metric")
    np.testing.assert_allclose(dense.values, expected, rtol=2e-3, atol=1e-5)
