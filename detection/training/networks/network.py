"""DetectionNetwork and AnchorNetwork: base classes of the networks, as used by loss, validation and
export.
"""

from collections.abc import Sequence
from typing import TypeVar

import torch
from torch import Tensor, nn

from track_range.detection.yolo.metadata import Anchors


class DetectionNetwork(nn.Module):
    """A network such as "yolov5n" with several heads, each a grid of cells; `has_cbam`: with CBAM
    attention.
    """

    # side of a cell in pixels for each head, in the order of `forward`'s outputs
    strides_px: tuple[int, ...]

    def __init__(self, name: str, n_classes: int, *, has_cbam: bool) -> None:
        super().__init__()
        self.name, self.n_classes, self.has_cbam = name, n_classes, has_cbam

    def forward(self, images: Tensor) -> list[Tensor]:
        """Raw outputs of each head for images (B, 3, H, W), RGB in 0..1, H and W divisible by
        32.
        """
        raise NotImplementedError

    def decode(self, raw: Sequence[Tensor]) -> Tensor:
        """(B, N, 5 + classes) centre, size in input pixels, objectness and class scores, from
        `forward`'s outputs.
        """
        raise NotImplementedError

    def exported(self, raw: Sequence[Tensor]) -> dict[str, Tensor]:
        """Outputs of the exported network by name, from `forward`'s outputs: the decoded boxes."""
        return {"output0": self.decode(raw)}


class AnchorNetwork(DetectionNetwork):
    """A network with several heads, each a grid of cells with A boxes per cell.

    `forward` returns (B, A, rows, columns, 5 + classes) of each head; H and W must be divisible by
    the largest stride.
    """

    anchors_px: Tensor  # (heads, A, 2) width and height in input pixels
    reach_cells: float  # largest distance of a predicted centre outside its cell, in cells
    max_ratio: float = 4.0  # largest ratio of the sides of a box and its anchor

    def __init__(self, name: str, n_classes: int, *, anchors_px: Anchors, has_cbam: bool) -> None:
        super().__init__(name, n_classes, has_cbam=has_cbam)
        self.register_buffer("anchors_px", torch.tensor(anchors_px, dtype=torch.float32))

    @property
    def n_anchors(self) -> int:
        """Number of boxes per cell."""
        return int(self.anchors_px.shape[1])

    def boxes(self, raw: Tensor, cells_xy: Tensor, anchors_px: Tensor, stride_px: int) -> Tensor:
        """(..., 4) centre and size in input pixels of boxes from raw outputs (..., 4).

        `cells_xy` (..., 2) are columns and rows of the cells, `anchors_px` (..., 2) width and
        height of the anchors.
        """
        raise NotImplementedError

    def decode(self, raw: Sequence[Tensor]) -> Tensor:
        """See `DetectionNetwork`; ordered as in YOLOv5's official export, by head, anchor, row and
        column.
        """
        rows = []
        for head, stride_px, anchors_px in zip(raw, self.strides_px, self.anchors_px, strict=True):
            batch, n_anchors, n_rows, n_columns, _ = head.shape
            cells = cells_xy(n_rows, n_columns, device=head.device)
            boxes = self.boxes(
                head[..., :4], cells, anchors_px.view(1, n_anchors, 1, 1, 2), stride_px
            )
            predictions = torch.cat([boxes, head[..., 4:].sigmoid()], -1)
            rows.append(
                predictions.reshape(batch, n_anchors * n_rows * n_columns, 5 + self.n_classes)
            )
        return torch.cat(rows, 1)

    def as_heads(self, predictions: Sequence[Tensor]) -> list[Tensor]:
        """Outputs (B, A, rows, columns, 5 + classes) from the convolutions' (B, A (5 + classes),
        rows, columns).
        """
        heads = []
        for output in predictions:
            batch, _, n_rows, n_columns = output.shape
            grid = output.view(batch, self.n_anchors, 5 + self.n_classes, n_rows, n_columns)
            heads.append(grid.permute(0, 1, 3, 4, 2))
        return heads


_Network = TypeVar("_Network", bound=DetectionNetwork)


def placed(network: _Network, device: torch.device) -> _Network:
    """The network after moving it to a device, with weights in the memory layout that is fastest
    for convolutions.
    """
    network.to(device)
    for parameter in network.parameters():
        if parameter.dim() == 4:
            parameter.data = parameter.data.contiguous(memory_format=torch.channels_last)
    return network


def cells_xy(n_rows: int, n_columns: int, *, device: torch.device) -> Tensor:
    """(rows, columns, 2) column and row of each cell of a grid."""
    rows, columns = torch.arange(n_rows, device=device), torch.arange(n_columns, device=device)
    y, x = torch.meshgrid(rows, columns, indexing="ij")
    return torch.stack([x, y], -1).float()
