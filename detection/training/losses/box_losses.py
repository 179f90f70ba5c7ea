"""IoU, and similarities of boxes for box losses 1 - CIoU and 1 - EIoU: IoU with penalties for
distance and shape.

    CIoU = IoU - d^2 / c^2 - alpha v    v = 4 / pi^2 (atan(w'/h') - atan(w/h))^2    alpha = v / (1 - IoU + v)
    EIoU = IoU - d^2 / c^2 - (w - w')^2 / C_w^2 - (h - h')^2 / C_h^2

d is the distance between the centres, C_w and C_h are the sides of the smallest enclosing box, c is
its diagonal. alpha is constant in the gradient. (Zheng et al., "Distance-IoU Loss", AAAI 2020, for
CIoU; Zhang et al., "Focal and Efficient IOU Loss", Neurocomputing 2022, for EIoU.)
"""

import math
from collections.abc import Callable, Mapping
from typing import Literal

import torch
from torch import Tensor

BoxLoss = Literal["ciou", "eiou"]

_EPSILON = 1e-7  # added to denominators, which are 0 for empty boxes


def pair_iou(a_cxcywh: Tensor, b_cxcywh: Tensor) -> Tensor:
    """(...) intersection over union of pairs of boxes (..., 4), with broadcasting."""
    (a1, a2), (b1, b2) = _corners(a_cxcywh), _corners(b_cxcywh)
    intersection = (torch.minimum(a2, b2) - torch.maximum(a1, b1)).clamp(min=0).prod(-1)
    union = a_cxcywh[..., 2:].prod(-1) + b_cxcywh[..., 2:].prod(-1) - intersection
    return intersection / (union + _EPSILON)


def ciou(a_cxcywh: Tensor, b_cxcywh: Tensor) -> Tensor:
    """(P,) complete IoU, at most 1, of P pairs of boxes (P, 4)."""
    iou, centres, _ = _terms(a_cxcywh, b_cxcywh)
    angles = [torch.atan(box[:, 2] / (box[:, 3] + _EPSILON)) for box in (a_cxcywh, b_cxcywh)]
    v = (4 / math.pi**2) * (angles[1] - angles[0]) ** 2
    with torch.no_grad():
        alpha = v / (1 - iou + v + _EPSILON)
    return iou - centres - alpha * v


def eiou(a_cxcywh: Tensor, b_cxcywh: Tensor) -> Tensor:
    """(P,) efficient IoU, at most 1, of P pairs of boxes (P, 4)."""
    iou, centres, enclosing = _terms(a_cxcywh, b_cxcywh)
    sides = (a_cxcywh[:, 2:] - b_cxcywh[:, 2:]) ** 2 / (enclosing**2 + _EPSILON)
    return iou - centres - sides.sum(1)


BOX_LOSSES: Mapping[BoxLoss, Callable[[Tensor, Tensor], Tensor]] = {"ciou": ciou, "eiou": eiou}


def _terms(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(P,) IoU, (P,) d^2 / c^2 and (P, 2) C_w and C_h of P pairs of boxes."""
    (a1, a2), (b1, b2) = _corners(a), _corners(b)
    enclosing = torch.maximum(a2, b2) - torch.minimum(a1, b1)
    distance = ((a[:, :2] - b[:, :2]) ** 2).sum(1)
    return pair_iou(a, b), distance / ((enclosing**2).sum(1) + _EPSILON), enclosing


def _corners(cxcywh: Tensor) -> tuple[Tensor, Tensor]:
    half = cxcywh[..., 2:] / 2
    return cxcywh[..., :2] - half, cxcywh[..., :2] + half
