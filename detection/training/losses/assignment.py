"""Assignment of objects to cells and anchors, as in YOLOv5.

An object is assigned to every anchor with max(w / w_a, w_a / w, h / h_a, h_a / h) < max_ratio, in
the cell of its centre and in the one or two neighbouring cells that are closest to the centre. A
network whose predicted centres cannot leave their cell uses no neighbours. (Jocher et al.,
"YOLOv5", utils/loss.py of v6.)
"""

from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from track_range.detection.training.networks.network import AnchorNetwork


class TensorRows:
    """Parallel tensors with one row per item, the fields of a dataclass with slots."""

    __slots__: tuple[str, ...] = ()

    def select(self, index: Tensor) -> Self:
        """The rows that indices or a mask select."""
        return type(self)(*(getattr(self, name)[index] for name in self.__slots__))

    def to(self, device: torch.device) -> Self:
        """The rows on another device."""
        return type(self)(*(getattr(self, name).to(device) for name in self.__slots__))

    def concatenate(self, other: Self) -> Self:
        """These rows, followed by the rows of `other`."""
        return type(self)(
            *(torch.cat([getattr(self, name), getattr(other, name)]) for name in self.__slots__)
        )


@dataclass(frozen=True, slots=True)
class LabelledObjects(TensorRows):
    """T labelled objects of a batch of images."""

    image: Tensor  # (T,) int64 index of the image in the batch
    class_index: Tensor  # (T,) int64 class of the network
    cxcywh: Tensor  # (T, 4) float32 centre and size in input pixels
    is_ignored: Tensor  # (T,) predictions of the object are neither true nor false positives
    # (T,) float32 probability that there is such an object: 1 for labels, less for pseudo-labels
    confidence: Tensor


@dataclass(frozen=True, slots=True)
class Cells(TensorRows):
    """P positive cells of one head, each with its anchor and its object; (P,) int64 indices."""

    image: Tensor
    anchor: Tensor
    row: Tensor
    column: Tensor
    object_index: Tensor

    @property
    def where(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Index of the cells in an array (B, A, rows, columns, ...)."""
        return self.image, self.anchor, self.row, self.column


def assign(
    objects: LabelledObjects, network: AnchorNetwork, head: int, grid_hw: tuple[int, int]
) -> Cells:
    """The positive cells of a head with `grid_hw` rows and columns."""
    stride_px, anchors_px = network.strides_px[head], network.anchors_px[head]
    ratio = objects.cxcywh[:, None, 2:] / anchors_px[None]
    which, anchor = (torch.maximum(ratio, 1 / ratio).amax(2) < network.max_ratio).nonzero(
        as_tuple=True
    )
    centre = objects.cxcywh[which, :2] / stride_px
    cell, source = _with_neighbours(centre, grid_hw, reach=network.reach_cells)
    row, column = cell[:, 1].clamp(0, grid_hw[0] - 1), cell[:, 0].clamp(0, grid_hw[1] - 1)
    return Cells(objects.image[which[source]], anchor[source], row, column, which[source])


def _with_neighbours(
    centre: Tensor, grid_hw: tuple[int, int], *, reach: float
) -> tuple[Tensor, Tensor]:
    """(P, 2) int64 x and y of the cells of centres (Q, 2), given in cells, and (P,) index of the
    cell's centre.
    """
    own = centre.floor()
    index = torch.arange(len(centre), device=centre.device)
    cells, source = [own], [index]
    if reach > 0:
        limit = torch.tensor([grid_hw[1], grid_hw[0]], device=centre.device)
        within = centre - own
        for axis in (0, 1):
            for step in (-1, 1):
                is_close = within[:, axis] < reach if step < 0 else within[:, axis] > 1 - reach
                position = own[:, axis] + step
                is_valid = is_close & (position >= 0) & (position < limit[axis])
                neighbour = own[is_valid].clone()
                neighbour[:, axis] += step
                cells.append(neighbour)
                source.append(index[is_valid])
    return torch.cat(cells).long(), torch.cat(source)
