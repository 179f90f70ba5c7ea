"""Box losses: 1 - IoU with penalties for how far apart the centres are and how the sides differ.

    CIoU = IoU - d^2 / c^2 - a v       v = 4 / pi^2 (atan(w'/h') - atan(w/h))^2     a = v / (1 - IoU + v)
    EIoU = IoU - d^2 / c^2 - (w - w')^2 / C_w^2 - (h - h')^2 / C_h^2

d is the distance of the centres, C_w and C_h the sides of the smallest box around both, c its diagonal. a is held
constant under the gradient. (Zheng et al., "Distance-IoU Loss", AAAI 2020, for CIoU; Zhang et al., "Focal and Efficient
IOU Loss", Neurocomputing 2022, for EIoU.)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

BoxLoss = Literal["ciou", "eiou"]

_EPSILON = 1e-7
"""Keeps boxes without extent from dividing by zero."""


@dataclass(frozen=True, slots=True)
class _Pair:
    """What both losses are made of; all (P,).

    Attributes:
        iou: intersection over union.
        centres: squared distance of the centres over the enclosing box's squared diagonal.
        enclosing: (P, 2) width and height of the smallest box around both.
    """

    iou: Tensor
    centres: Tensor
    enclosing: Tensor


def ciou(a_cxcywh: Tensor, b_cxcywh: Tensor) -> Tensor:
    """(P,) complete IoU, at most 1, of boxes (P, 4) pairwise."""
    pair = _pair(a_cxcywh, b_cxcywh)
    slopes = [torch.atan(box[:, 2] / (box[:, 3] + _EPSILON)) for box in (a_cxcywh, b_cxcywh)]
    v = (4 / math.pi**2) * (slopes[1] - slopes[0]) ** 2
    with torch.no_grad():
        weight = v / (1 - pair.iou + v + _EPSILON)
    return pair.iou - pair.centres - weight * v


def eiou(a_cxcywh: Tensor, b_cxcywh: Tensor) -> Tensor:
    """(P,) efficient IoU, at most 1, of boxes (P, 4) pairwise."""
    pair = _pair(a_cxcywh, b_cxcywh)
    sides = (a_cxcywh[:, 2:] - b_cxcywh[:, 2:]) ** 2 / (pair.enclosing**2 + _EPSILON)
    return pair.iou - pair.centres - sides.sum(1)


BOX_LOSSES: Mapping[BoxLoss, Callable[[Tensor, Tensor], Tensor]] = {"ciou": ciou, "eiou": eiou}


def _pair(a: Tensor, b: Tensor) -> _Pair:
    (a1, a2), (b1, b2) = _corners(a), _corners(b)
    shared = (torch.minimum(a2, b2) - torch.maximum(a1, b1)).clamp(min=0).prod(1)
    union = a[:, 2:].prod(1) + b[:, 2:].prod(1) - shared
    enclosing = torch.maximum(a2, b2) - torch.minimum(a1, b1)
    distance = ((a[:, :2] - b[:, :2]) ** 2).sum(1)
    return _Pair(shared / (union + _EPSILON), distance / ((enclosing**2).sum(1) + _EPSILON), enclosing)


def _corners(cxcywh: Tensor) -> tuple[Tensor, Tensor]:
    half = cxcywh[:, 2:] / 2
    return cxcywh[:, :2] - half, cxcywh[:, :2] + half
