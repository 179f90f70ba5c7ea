"""Task-aligned assignment of objects to the cells of an anchor-free network.

    a = s u^6        s: score of the object's class, u: IoU of the predicted box and the object, for every cell

The 10 cells with the largest a among those whose centre is inside the object's box are its positives; the box of a cell
of several objects is that of the one with the largest u. Around objects smaller than the finest cells, centres within
one of these cells count as inside. The target of a positive's class score is

    t = (a / largest a of the object) (largest u of the object)

so that scores rank boxes by their overlap as well. (Feng et al., "TOOD: Task-aligned One-stage Object Detection", ICCV
2021, equations 4 to 6 with alpha = 1, beta = 6.)
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from track_range.detection.training.losses.assignment import LabelledObjects, Rows
from track_range.detection.training.losses.box_losses import pair_iou

_N_POSITIVES = 10  # cells of an object
_BETA = 6.0  # exponent of the IoU in the alignment a
_EPSILON = 1e-9  # added to the largest a of an object, which is 0 if no predicted box overlaps it


@dataclass(frozen=True, slots=True)
class AlignedCells(Rows):
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


@torch.no_grad()
def assign_aligned(
    objects: LabelledObjects, scores: Tensor, cxcywh_px: Tensor, centre_px: Tensor, stride_px: Tensor
) -> AlignedCells:
    """The positive cells of T objects.

    Args:
        objects: the objects.
        scores: (B, N, C) predicted class scores, 0..1.
        cxcywh_px: (B, N, 4) predicted boxes.
        centre_px: (N, 2) centres of the cells.
        stride_px: (N,) sides of the cells.
    """
    reach_px = (objects.cxcywh[:, None, 2:] / 2).clamp(min=float(stride_px.min()))
    is_inside = ((centre_px - objects.cxcywh[:, None, :2]).abs() < reach_px).all(-1)  # (T, N)
    object_index, cell = is_inside.nonzero(as_tuple=True)
    image, class_index = objects.image[object_index], objects.class_index[object_index]
    overlap = is_inside.float()
    overlap[object_index, cell] = pair_iou(cxcywh_px[image, cell], objects.cxcywh[object_index])
    alignment = is_inside.float() - 1  # -1 outside, so that these cells come last
    alignment[object_index, cell] = scores[image, cell, class_index] * overlap[object_index, cell] ** _BETA

    best, best_cell = alignment.topk(min(_N_POSITIVES, len(centre_px)), dim=1)  # (T, 10)
    best_overlap = overlap.gather(1, best_cell)
    target = best / (best[:, :1] + _EPSILON) * best_overlap.amax(1, keepdim=True)

    object_index, rank = (best >= 0).nonzero(as_tuple=True)
    image, cell = objects.image[object_index], best_cell[object_index, rank]
    has_box = _is_largest(best_overlap[object_index, rank], image * len(centre_px) + cell)
    return AlignedCells(image, cell, object_index, target[object_index, rank], has_box)


def _is_largest(value: Tensor, key: Tensor) -> Tensor:
    """(P,) whether a value (P,) is the largest one with the same key (P,); of equal ones, the last one is."""
    place = torch.argsort(torch.argsort(value, stable=True))  # of each value in the sorted order
    largest = torch.full((int(key.max()) + 1 if len(key) else 0,), -1, device=key.device)
    return place == largest.scatter_reduce(0, key, place, "amax")[key]
