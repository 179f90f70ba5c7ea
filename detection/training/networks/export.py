"""Export of a trained network as an .onnx file that `YoloDetector` loads without options.

The graph ends with `DetectionNetwork.exported`, the input size is variable, and the metadata has the attributes that
`detection.models.metadata` reads.
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
from track_range.detection.training.networks.network import DetectionNetwork

_OPSET = 17


class _Exported(nn.Module):
    def __init__(self, network: DetectionNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> tuple[Tensor, ...]:
        """The outputs for images (B, 3, H, W)."""
        return tuple(self.network.exported(self.network(images)).values())


def export_onnx(network: DetectionNetwork, out: Path, metadata: Mapping[str, object]) -> None:
    """Write a network as an ONNX file with `metadata`, whose values are converted to JSON; ModelError if impossible."""
    exported = _Exported(copy.deepcopy(network)).cpu().float().eval()  # the network itself stays on its device
    image = torch.zeros(1, 3, 128, 160)
    with torch.no_grad():
        names = list(exported.network.exported(exported.network(image)))
    variable = {"images": {0: "batch", 2: "height", 3: "width"}}
    with atomic_output(out) as folder:
        path = folder / out.name
        with silent_conversion(out, "exported"):
            torch.onnx.export(
                exported,
                (image,),
                str(path),
                input_names=["images"],
                output_names=names,
                dynamic_axes=variable | {name: {0: "batch", 1: f"rows_of_{name}"} for name in names},
                opset_version=_OPSET,
                dynamo=False,
            )
            model = onnx.load(str(path))
        model.producer_name = "track-range"
        texts = {key: value if isinstance(value, str) else json.dumps(value) for key, value in metadata.items()}
        onnx.helper.set_model_props(model, texts)
        onnx.save(model, str(path))
