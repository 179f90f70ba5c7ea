"""Which cell and anchor of which head is to find which object, as YOLOv5 does it.

An object belongs to every anchor whose width and height are within `max_ratio` of its own, in the cell of its centre
and in the one or two neighbouring cells that its centre is nearest to (a network whose centres cannot leave their cells
has no neighbours). (Jocher et al., "YOLOv5", utils/loss.py of v6.)
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from track_range.detection.training.networks.network import AnchorNetwork


@dataclass(frozen=True, slots=True)
class Objects:
    """Labelled objects of a batch of images.

    Attributes:
        image: (T,) int64 image in the batch.
        class_index: (T,) int64 class of the network.
        cxcywh: (T, 4) float32 centre and size in input pixels.
        is_ignored: (T,) neither right nor wrong to find.
    """

    image: Tensor
    class_index: Tensor
    cxcywh: Tensor
    is_ignored: Tensor

    def to(self, device: torch.device) -> Objects:
        """The same on a device."""
        return Objects(*(getattr(self, name).to(device) for name in self.__dataclass_fields__))

    def select(self, chosen: Tensor) -> Objects:
        """Those of an index or mask."""
        return Objects(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


@dataclass(frozen=True, slots=True)
class Cells:
    """Cells of one head that are to find something; all (P,).

    Attributes:
        image, anchor, row, column: int64, where.
        of: int64, which object.
    """

    image: Tensor
    anchor: Tensor
    row: Tensor
    column: Tensor
    of: Tensor

    def select(self, chosen: Tensor) -> Cells:
        """Those of an index or mask."""
        return Cells(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))

    def and_(self, other: Cells) -> Cells:
        """Both."""
        return Cells(*(torch.cat([getattr(self, n), getattr(other, n)]) for n in self.__dataclass_fields__))


def assign(objects: Objects, network: AnchorNetwork, head: int, grid_hw: tuple[int, int]) -> Cells:
    """The cells of a head, `grid_hw` rows and columns, that are to find `objects`."""
    stride_px, anchors_px = network.strides_px[head], network.anchors_px[head]
    ratio = objects.cxcywh[:, None, 2:] / anchors_px[None]
    which, anchor = (torch.maximum(ratio, 1 / ratio).amax(2) < network.max_ratio).nonzero(as_tuple=True)
    centre = objects.cxcywh[which, :2] / stride_px
    cell, of_all = _with_neighbours(centre, grid_hw, reach=network.reach_cells)
    row, column = cell[:, 1].clamp(0, grid_hw[0] - 1), cell[:, 0].clamp(0, grid_hw[1] - 1)
    return Cells(objects.image[which[of_all]], anchor[of_all], row, column, which[of_all])


def _with_neighbours(centre: Tensor, grid_hw: tuple[int, int], *, reach: float) -> tuple[Tensor, Tensor]:
    """(P, 2) int64 cells x, y for centres (Q, 2) in cells, and (P,) the centre that each is of."""
    own = centre.floor()
    every = torch.arange(len(centre), device=centre.device)
    cells, of = [own], [every]
    if reach > 0:
        limit = torch.tensor([grid_hw[1], grid_hw[0]], device=centre.device)
        within = centre - own
        for axis in (0, 1):
            for step in (-1, 1):
                towards = within[:, axis] < reach if step < 0 else within[:, axis] > 1 - reach
                there = own[:, axis] + step
                chosen = towards & (there >= 0) & (there < limit[axis])
                neighbour = own[chosen].clone()
                neighbour[:, axis] += step
                cells.append(neighbour)
                of.append(every[chosen])
    return torch.cat(cells).long(), torch.cat(of)
