"""Task-aligned assignment of objects to the cells of an anchor-free network.

    a = s u^6        s: score of the object's class, u: IoU of the predicted box and the object, for every cell

The 10 cells with the largest a among those whose centre is inside the object's box are its positives; the box of a cell
of several objects is that of the one with the largest u. Around objects smaller than a cell, centres within one cell
count as inside. The target of a positive's class score is

    t = (a / largest a of the object) (largest u of the object)

so that scores rank boxes by their overlap as well. (Feng et al., "TOOD: Task-aligned One-stage Object Detection", ICCV
2021, equations 4 to 6 with alpha = 1, beta = 6.)
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from track_range.detection.training.losses.assignment import Objects

_N_POSITIVES = 10
_BETA = 6.0
_EPSILON = 1e-9


@dataclass(frozen=True, slots=True)
class AlignedCells:
    """P positive cells.

    Attributes:
        image, cell: (P,) int64 index of the image and of the cell among the N cells of all levels.
        object_index: (P,) int64 index of the object.
        target: (P,) target of the score of the object's class, 0..1.
        has_box: (P,) the target of the cell's box is this object's; false for all but one of the objects of a cell.
    """

    image: Tensor
    cell: Tensor
    object_index: Tensor
    target: Tensor
    has_box: Tensor

    def select(self, index: Tensor) -> AlignedCells:
        """The cells that indices or a mask (P,) select."""
        return AlignedCells(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


@torch.no_grad()
def assign_aligned(
    objects: Objects, scores: Tensor, xyxy_px: Tensor, centre_px: Tensor, stride_px: Tensor
) -> AlignedCells:
    """The positive cells of T objects.

    Args:
        objects: the objects.
        scores: (B, N, C) predicted class scores, 0..1.
        xyxy_px: (B, N, 4) predicted boxes.
        centre_px: (N, 2) centres of the cells.
        stride_px: (N,) sides of the cells.
    """
    half = objects.cxcywh[:, None, 2:] / 2
    reach = torch.maximum(half, stride_px[:, None] * (half < stride_px.min()))
    is_inside = ((centre_px - objects.cxcywh[:, None, :2]).abs() < reach).all(-1)  # (T, N)
    which, cell = is_inside.nonzero(as_tuple=True)
    image = objects.image[which]
    overlap = pair_iou(xyxy_px[image, cell], _xyxy(objects.cxcywh)[which])
    alignment = scores[image, cell, objects.class_index[which]] * overlap**_BETA

    dense = alignment.new_full(is_inside.shape, -1.0)
    dense[which, cell] = alignment
    best, best_cell = dense.topk(min(_N_POSITIVES, dense.shape[1]), dim=1)
    best_overlap = torch.zeros_like(dense)
    best_overlap[which, cell] = overlap
    best_overlap = best_overlap.gather(1, best_cell)
    largest_a, largest_u = best[:, :1], best_overlap.amax(1, keepdim=True)
    target = best.clamp(min=0) / (largest_a + _EPSILON) * largest_u

    object_index, rank = (best > -1).nonzero(as_tuple=True)
    cell, u = best_cell[object_index, rank], best_overlap[object_index, rank]
    key = objects.image[object_index] * len(centre_px) + cell
    order = torch.argsort(u, stable=True)  # the last write, of the largest overlap, wins
    owner = torch.full((len(scores) * len(centre_px),), -1, device=key.device)
    owner[key[order]] = order
    has_box = owner[key] == torch.arange(len(key), device=key.device)
    return AlignedCells(objects.image[object_index], cell, object_index, target[object_index, rank], has_box)


def pair_iou(a: Tensor, b: Tensor) -> Tensor:
    """(P,) intersection over union of P pairs of boxes (P, 4), corners."""
    size = (torch.minimum(a[:, 2:], b[:, 2:]) - torch.maximum(a[:, :2], b[:, :2])).clamp(min=0)
    intersection = size.prod(1)
    union = (a[:, 2:] - a[:, :2]).prod(1) + (b[:, 2:] - b[:, :2]).prod(1) - intersection
    return intersection / (union + _EPSILON)


def _xyxy(cxcywh: Tensor) -> Tensor:
    half = cxcywh[:, 2:] / 2
    return torch.cat([cxcywh[:, :2] - half, cxcywh[:, :2] + half], 1)
