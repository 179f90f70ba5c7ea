"""Teacher: a trained YOLOv5 from which a network learns besides the labels (knowledge
distillation).

A network with YOLOv5's heads (strides 8, 16, 32 with three anchors per cell) learns from the
teacher's outputs: objectness, class scores and boxes are the targets where images are not
completely labelled. Where labels are complete, they determine which of the network's cells are
positive. RoadNet, which has other heads, learns from the teacher's features
(`training.feature_loss`).

(Hinton et al., "Distilling the Knowledge in a Neural Network", 2015; Mehta & Ozturk, "Object
Detection at 200 Frames Per Second", ECCV 2018 workshops, for distillation scaled by objectness.)

Import of the weights of an exported YOLOv5 into the PyTorch network, so that teachers run as fast
as students.
"""

from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from track_range.detection.classes import COCO_CLASSES, map_to_road_classes
from track_range.detection.models.onnx_session import ModelError, OnnxSession, check_model_file
from track_range.detection.training.errors import TrainingError
from track_range.detection.training.losses.assignment import Cells
from track_range.detection.training.losses.detection_loss import TeacherOutputs
from track_range.detection.training.networks.network import AnchorNetwork, DetectionNetwork, placed
from track_range.detection.training.networks.road_net import RoadNet
from track_range.detection.training.networks.yolov5 import COCO_ANCHORS_PX, SCALES, YoloV5
from track_range.detection.yolo.metadata import ModelOptions, read_metadata
from track_range.foundation.arrays import IntArray
from track_range.foundation.files.input_files import quoted
from track_range.foundation.files.structured_text import parse_json


def yolov5_of_export(path: Path) -> YoloV5:
    """A YOLOv5n or YOLOv5s in evaluation mode, from its official export with folded batch norms;
    else ModelError.
    """
    weights = _convolutions(path)
    for name in SCALES:
        n_classes = weights[-1][0].shape[0] // 3 - 5
        if n_classes < 1:
            break
        network = YoloV5(name, n_classes, anchors_px=COCO_ANCHORS_PX).eval()
        convolutions = _in_order(network)
        if [tuple(conv.weight.shape) for conv in convolutions] == [
            weight.shape for weight, _ in weights
        ]:
            for conv, (weight, bias) in zip(convolutions, weights, strict=True):
                conv.weight = nn.Parameter(torch.from_numpy(weight.copy()), requires_grad=False)
                conv.bias = nn.Parameter(torch.from_numpy(bias.copy()), requires_grad=False)
            for module in network.modules():
                if hasattr(module, "norm"):
                    module.norm = nn.Identity()
            return network
    raise ModelError(
        f"{path}: expected an export of {' or '.join(SCALES)} as the teacher, got another network."
    )


def _convolutions(path: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    check_model_file(path)
    try:
        graph = onnx.load(str(path)).graph
    except Exception as error:  # onnx and protobuf raise unrelated types
        raise ModelError(
            f"{path}: this is not a readable ONNX model ({type(error).__name__})."
        ) from error
    values = {tensor.name: tensor for tensor in graph.initializer}
    for node in graph.node:  # equal weights may be stored once
        if node.op_type == "Identity" and node.input[0] in values:
            values[node.output[0]] = values[node.input[0]]
    nodes = [node for node in graph.node if node.op_type == "Conv"]
    if not nodes or any(
        len(node.input) != 3 or not set(node.input[1:]) <= values.keys() for node in nodes
    ):
        raise ModelError(
            f"{path}: expected a float32 export with folded batch norms as the teacher."
        )
    try:
        arrays = [
            [numpy_helper.to_array(values[name]) for name in node.input[1:]] for node in nodes
        ]
    except Exception as error:  # as above
        raise ModelError(
            f"{path}: expected weights of the announced sizes ({type(error).__name__})."
        ) from error
    return [(weight, bias) for weight, bias in arrays]


def _in_order(network: nn.Module) -> list[nn.Conv2d]:
    order: list[nn.Conv2d] = []
    convolutions = (module for module in network.modules() if isinstance(module, nn.Conv2d))
    hooks = [
        conv.register_forward_pre_hook(lambda conv, _: order.append(conv)) for conv in convolutions
    ]
    with torch.no_grad():
        network(torch.zeros(1, 3, 64, 64))
    for hook in hooks:
        hook.remove()
    return order


MIN_OBJECTNESS = 0.1  # smallest objectness of a teacher's cell that is a positive


class Teacher:
    """A YOLOv5n or YOLOv5s network, loaded from its official export.

    ModelError if the file cannot be read, is not a YOLOv5n or YOLOv5s, or has none of the classes.
    `name`: file name of the export.
    """

    def __init__(
        self,
        path: Path,
        road_class_id: IntArray,
        *,
        device: str,
        precision: torch.dtype = torch.float32,
    ) -> None:
        """`road_class_id` (C,) is the road class of each class of the student; `precision` is for
        the arithmetic.
        """
        network = yolov5_of_export(path)
        metadata = OnnxSession(path).metadata
        names = (
            read_metadata(path, metadata, ModelOptions())
            .get("names", COCO_CLASSES, "default")
            .value
        )
        if "trained_anchors" in metadata:
            network.anchors_px.copy_(
                _anchors(metadata["trained_anchors"], path, network.anchors_px)
            )
        class_id = map_to_road_classes(names)
        if network.n_classes != len(names) or not np.isin(class_id, road_class_id).any():
            raise ModelError(
                f"{path}: expected a teacher whose class names include classes to train; got "
                f"{network.n_classes} classes and {len(names)} names."
            )
        self.name = path.name
        self.network = placed(network, torch.device(device))
        self._columns = [5 + np.flatnonzero(class_id == student_id) for student_id in road_class_id]
        self._precision = precision

    def check_fits(self, student: DetectionNetwork) -> None:
        """TrainingError unless the student is RoadNet, or a network with the same grids and
        anchors.
        """
        if isinstance(student, RoadNet):
            return
        if not isinstance(student, AnchorNetwork) or student.strides_px != self.network.strides_px:
            raise TrainingError(
                f"--teacher: expected a model with YOLOv5's grids, got {student.name}."
            )
        if not torch.allclose(student.anchors_px.cpu(), self.network.anchors_px.cpu(), rtol=0.01):
            raise TrainingError(
                "--teacher: expected the anchors of the teacher, got different ones; use --anchors "
                "default."
            )

    @torch.no_grad()
    def features(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Features (B, n, rows, columns) of the neck at strides 8, 16, 32 for images (B, 3, H, W)
        RGB in 0..1.
        """
        with torch.autocast(images.device.type, self._precision, self._precision != torch.float32):
            p3, p4, p5 = self.network.body(images)
        return p3, p4, p5

    @torch.no_grad()
    def outputs(self, images: Tensor) -> list[TeacherOutputs]:
        """The outputs of each head for images (B, 3, H, W) RGB in 0..1."""
        with torch.autocast(images.device.type, self._precision, self._precision != torch.float32):
            heads = self.network(images)
        return [self._of_head(index, head) for index, head in enumerate(heads)]

    def _of_head(self, index: int, head: Tensor) -> TeacherOutputs:
        objectness = head[..., 4].float().sigmoid()
        where = (objectness > MIN_OBJECTNESS).nonzero(as_tuple=True)
        image, anchor, row, column = where
        logits = head[where].float()
        cells_xy = torch.stack([column, row], 1).float()
        network = self.network
        boxes = network.boxes(
            logits[:, :4], cells_xy, network.anchors_px[index][anchor], network.strides_px[index]
        )
        scores = logits.sigmoid()
        best = scores[:, 5:].amax(1)
        none = torch.zeros(len(scores), device=scores.device)
        best_of = [
            scores[:, list(columns)].amax(1) if len(columns) else none for columns in self._columns
        ]
        student_scores = torch.stack(best_of, 1)
        # 1 if the best class is the student's
        objectness[where] *= student_scores.amax(1) / best.clamp(min=1e-6)
        is_confident = objectness[where] > MIN_OBJECTNESS
        cells = Cells(image, anchor, row, column, torch.zeros_like(image)).select(is_confident)
        return TeacherOutputs(objectness, cells, boxes[is_confident], student_scores[is_confident])


def _anchors(text: str, path: Path, default_px: Tensor) -> Tensor:
    """Anchors in pixels from a model's metadata, in the shape of the network's default anchors;
    else ModelError.
    """
    place = f"{path}: metadata 'trained_anchors'"
    try:
        anchors_px = torch.tensor(
            parse_json(text, place, ModelError, "anchors"), dtype=default_px.dtype
        )
    except (TypeError, ValueError, RuntimeError) as error:
        raise ModelError(f"{place}: expected lists of numbers, found {quoted(text)}.") from error
    if anchors_px.shape != default_px.shape or not ((anchors_px > 0) & (anchors_px < 1e5)).all():
        expected = " x ".join(str(size) for size in default_px.shape)
        raise ModelError(f"{place}: expected {expected} positive numbers, found {quoted(text)}.")
    return anchors_px
