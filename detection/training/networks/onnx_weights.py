"""Import of the weights of an exported YOLOv5 into the PyTorch network, so that teachers run as fast as students."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import nn

from track_range.detection.models.onnx_session import ModelError, check_model_file
from track_range.detection.training.networks.yolov5 import COCO_ANCHORS_PX, SCALES, YoloV5


def yolov5_of_export(path: Path) -> YoloV5:
    """A YOLOv5n or YOLOv5s in evaluation mode, from its official export with folded batch norms; else ModelError."""
    weights = _convolutions(path)
    for name in SCALES:
        n_classes = weights[-1][0].shape[0] // 3 - 5
        if n_classes < 1:
            break
        network = YoloV5(name, n_classes, anchors_px=COCO_ANCHORS_PX).eval()
        convolutions = _in_order(network)
        if [tuple(conv.weight.shape) for conv in convolutions] == [weight.shape for weight, _ in weights]:
            _fill(convolutions, weights)
            for module in network.modules():
                if hasattr(module, "norm"):
                    module.norm = nn.Identity()
            return network
    raise ModelError(f"{path}: expected an export of {' or '.join(SCALES)} as the teacher, got another network.")


def _convolutions(path: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    """Weights and biases of the convolutions, in the order of the graph."""
    check_model_file(path)
    try:
        graph = onnx.load(str(path)).graph
    except Exception as error:  # onnx and protobuf raise unrelated types
        raise ModelError(f"{path}: not a readable ONNX model ({type(error).__name__}).") from error
    values = {tensor.name: tensor for tensor in graph.initializer}
    for node in graph.node:  # equal weights may be stored once
        if node.op_type == "Identity" and node.input[0] in values:
            values[node.output[0]] = values[node.input[0]]
    nodes = [node for node in graph.node if node.op_type == "Conv"]
    if not nodes or any(len(node.input) != 3 or not set(node.input[1:]) <= values.keys() for node in nodes):
        raise ModelError(f"{path}: expected a float32 export with folded batch norms as the teacher.")
    try:
        arrays = [[numpy_helper.to_array(values[name]) for name in node.input[1:]] for node in nodes]
    except Exception as error:  # as above
        raise ModelError(f"{path}: expected weights of the announced sizes ({type(error).__name__}).") from error
    return [(weight, bias) for weight, bias in arrays]


def _in_order(network: nn.Module) -> list[nn.Conv2d]:
    """The convolutions of a network in the order of execution."""
    order: list[nn.Conv2d] = []
    hooks = [
        module.register_forward_pre_hook(lambda conv, _: order.append(conv))
        for module in network.modules()
        if isinstance(module, nn.Conv2d)
    ]
    with torch.no_grad():
        network(torch.zeros(1, 3, 64, 64))
    for hook in hooks:
        hook.remove()
    return order


def _fill(convolutions: list[nn.Conv2d], weights: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Set weights and biases of the convolutions."""
    for conv, (weight, bias) in zip(convolutions, weights, strict=True):
        conv.weight = nn.Parameter(torch.from_numpy(weight.copy()), requires_grad=False)
        conv.bias = nn.Parameter(torch.from_numpy(bias.copy()), requires_grad=False)
