"""Teacher: a trained detector that says, for every cell of every image of a batch, what it would have answered.

Its answers are soft targets (objectness, class scores, boxes) where nobody labelled anything, and where labels are
complete they tell which cells should find an object. Its heads must be the student's own: YOLOv5's, strides 8, 16, 32,
three anchors per cell. (Hinton et al., "Distilling the Knowledge in a Neural Network", 2015; Mehta & Ozturk, "Object
Detection at 200 Frames Per Second", ECCV 2018 workshops, for distillation scaled by objectness.)
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from track_range.detection.classes import COCO_CLASSES, map_to_road_classes
from track_range.detection.models.metadata import ModelOptions, read_metadata
from track_range.detection.models.onnx_session import ModelError, OnnxSession
from track_range.detection.training.errors import TrainingError
from track_range.detection.training.losses.assignment import Cells
from track_range.detection.training.networks.network import AnchorNetwork, placed
from track_range.detection.training.networks.onnx_weights import yolov5_of_export
from track_range.foundation.arrays import IntArray

CONFIDENT = 0.1
"""Objectness from which a teacher's cell is to find something."""


@dataclass(frozen=True, slots=True)
class HeadAnswers:
    """What a teacher says in one head of a batch.

    Attributes:
        objectness: (B, A, rows, columns) 0..1; of the student's classes where it is confident, else of anything.
        cells: where it is confident, P of them.
        cxcywh: (P, 4) its boxes there, in input pixels.
        class_score: (P, C) 0..1, of the student's classes; 0 for those that the teacher does not know.
    """

    objectness: Tensor
    cells: Cells
    cxcywh: Tensor
    class_score: Tensor


class Teacher:
    """A YOLOv5n or s from its official export."""

    def __init__(
        self, path: Path, road_class_id: IntArray, *, device: str, precision: torch.dtype = torch.float32
    ) -> None:
        """Load it.

        Args:
            path: the export.
            road_class_id: (C,) road class of each class of the student.
            device: where it runs.
            precision: of its arithmetic.

        Raises:
            ModelError: unreadable, no YOLOv5n or s, or it knows none of the classes.
        """
        network = yolov5_of_export(path)
        metadata = OnnxSession(path).metadata
        names = read_metadata(path, metadata, ModelOptions()).get("names", COCO_CLASSES, "default").value
        if "trained_anchors" in metadata:
            network.anchors_px.copy_(torch.tensor(json.loads(metadata["trained_anchors"])))
        mine = map_to_road_classes(names)
        if network.n_classes != len(names) or not np.isin(mine, road_class_id).any():
            raise ModelError(f"{path}: its {network.n_classes} classes are not known by name, or none is a road class.")
        self.name = path.name
        self.network = placed(network, torch.device(device))
        self._columns = [5 + np.flatnonzero(mine == each) for each in road_class_id]
        self._precision = precision

    def check_fits(self, student: AnchorNetwork) -> None:
        """Make sure that cell and anchor of one are cell and anchor of the other.

        Raises:
            TrainingError: other grids or anchors.
        """
        if student.strides_px != self.network.strides_px:
            raise TrainingError(f"--teacher: it answers for YOLOv5's grids; {student.name} has others.")
        if not torch.allclose(student.anchors_px.cpu(), self.network.anchors_px.cpu(), rtol=0.01):
            raise TrainingError("--teacher: its anchors are not the network's; use --anchors default with it.")

    @torch.no_grad()
    def look(self, images: Tensor) -> list[HeadAnswers]:
        """Its answers to images (B, 3, H, W) RGB in 0..1, by head."""
        with torch.autocast(images.device.type, self._precision, self._precision != torch.float32):
            heads = self.network(images)
        return [self._told(index, head) for index, head in enumerate(heads)]

    def _told(self, index: int, head: Tensor) -> HeadAnswers:
        objectness = head[..., 4].float().sigmoid()
        where = (objectness > CONFIDENT).nonzero(as_tuple=True)
        image, anchor, row, column = where
        logits = head[where].float()
        cells_xy = torch.stack([column, row], 1).float()
        network = self.network
        boxes = network.boxes(logits[:, :4], cells_xy, network.anchors_px[index][anchor], network.strides_px[index])
        scores = logits.sigmoid()
        best = scores[:, 5:].amax(1)
        mine = torch.stack([_best(scores, columns) for columns in self._columns], 1)
        share = mine.amax(1) / best.clamp(min=1e-6)  # near 1 where its best class is one of the student's
        objectness[where] *= share
        certain = objectness[where] > CONFIDENT
        cells = Cells(image, anchor, row, column, torch.zeros_like(image)).select(certain)
        return HeadAnswers(objectness, cells, boxes[certain], mine[certain])


def _best(scores: Tensor, columns: Sequence[int] | IntArray) -> Tensor:
    """(P,) largest of some columns, 0 where there are none."""
    return scores[:, list(columns)].amax(1) if len(columns) else torch.zeros(len(scores), device=scores.device)
