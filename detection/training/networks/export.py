"""Export of a trained network as an .onnx file that `YoloDetector` loads without options.

The graph decodes the boxes (rows of centre, size, objectness and class scores in input pixels, YOLOv5's layout), the
input size is variable, and the metadata has the attributes that `detection.models.metadata` reads.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from pathlib import Path

import onnx
import torch
from torch import Tensor, nn

from track_range.detection.models.writing import atomic_output, silent_conversion
from track_range.detection.training.networks.network import AnchorNetwork

_OPSET = 17


class _Decoded(nn.Module):
    """A network with decoded output."""

    def __init__(self, network: AnchorNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> Tensor:
        """(B, N, 5 + classes) decoded boxes of images (B, 3, H, W)."""
        return self.network.decode(self.network(images))


def export_onnx(network: AnchorNetwork, out: Path, metadata: Mapping[str, object]) -> None:
    """Write a network as an ONNX file with `metadata`, whose values are converted to JSON.

    Raises:
        ModelError: the network cannot be converted, or the file cannot be written.
    """
    decoded = _Decoded(copy.deepcopy(network)).cpu().float().eval()  # the network itself stays on its device
    with atomic_output(out) as folder:
        path = folder / out.name
        with silent_conversion(out, "exported"):
            torch.onnx.export(
                decoded,
                (torch.zeros(1, 3, 128, 160),),
                str(path),
                input_names=["images"],
                output_names=["output0"],
                dynamic_axes={"images": {0: "batch", 2: "height", 3: "width"}, "output0": {0: "batch", 1: "rows"}},
                opset_version=_OPSET,
                dynamo=False,
            )
            model = onnx.load(str(path))
        model.producer_name = "track-range"
        onnx.helper.set_model_props(model, {key: _text(value) for key, value in metadata.items()})
        onnx.save(model, str(path))


def _text(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)
