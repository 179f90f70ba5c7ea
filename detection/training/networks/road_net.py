"""RoadNet: YOLOv5n's backbone and neck with four decoupled, anchor-free heads; the network of the packaged detector.

    image -> P3 (stride 8), P4 (16), P5 (32), P6 (64) -> one head per level -> C class scores and 4 distances per cell

A head has two branches, each a 3x3 convolution and a linear 1x1 convolution: one predicts the logits of the classes,
the other one the distances from the cell's centre to the four sides of the box, as distributions over R + 1 bins:

    distance = stride * sum over k of k P(k),   P = softmax(bins),   k = 0 .. R

There is no objectness: a class score is the probability of the class times the expected overlap of the box. The fourth
level is for objects that fill the image, of which a cell of P5 sees only a part.

(Backbone and neck: Jocher et al., "YOLOv5", v6.0. Decoupled heads: Ge et al., "YOLOX", 2021. Distributions of
distances: Li et al., "Generalized Focal Loss", NeurIPS 2020. The fourth level: Yu et al., "PP-PicoDet", 2021.)
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from track_range.detection.training.networks.blocks import ConvolutionBlock
from track_range.detection.training.networks.network import DetectionNetwork, cells_xy
from track_range.detection.training.networks.yolov5 import SCALES, YoloV5Body

N_BINS = 8  # R + 1: bins of a distance, which is at most R = 7 cells
_N_HIDDEN = 48  # channels of a head's branches
# class scores at the start of the training (Lin et al., "Focal Loss", ICCV 2017)
_INITIAL_SCORE = 0.01


class RoadNet(DetectionNetwork):
    """The anchor-free network of the packaged detector; see `DetectionNetwork` and the module's
    description.
    """

    strides_px = (8, 16, 32, 64)

    def __init__(self, name: str, n_classes: int, *, has_cbam: bool = False) -> None:
        super().__init__(name, n_classes, has_cbam=has_cbam)
        self.body = YoloV5Body(SCALES["yolov5n"], has_cbam=has_cbam)
        *_, top = self.body.n_channels
        self.down_p5 = ConvolutionBlock(top, top // 2, size=3, stride=2)
        self.heads = nn.ModuleList(
            RoadNetHead(n, n_classes) for n in (*self.body.n_channels, top // 2)
        )

    def forward(self, images: Tensor) -> list[Tensor]:
        """Raw outputs (B, rows, columns, classes + 4 * bins) of each level for images (B, 3, H, W),
        RGB in 0..1.

        The columns are the logits of the classes, then the logits of the bins of left, top, right
        and bottom. H and W must be divisible by 32; the coarsest level has ceil(H / 64) rows.
        """
        return self.outputs(self.features(images))

    def features(self, images: Tensor) -> list[Tensor]:
        """Features (B, n, rows, columns) of P3 to P6 for images (B, 3, H, W), RGB in 0..1."""
        levels = list(self.body(images))
        return [*levels, self.down_p5(levels[-1])]

    def outputs(self, levels: Sequence[Tensor]) -> list[Tensor]:
        """Raw outputs of each level, as from `forward`, for its features."""
        return [
            head(features).permute(0, 2, 3, 1)
            for head, features in zip(self.heads, levels, strict=True)
        ]

    def decode(self, raw: Sequence[Tensor]) -> Tensor:
        """See `DetectionNetwork`; the objectness is 1, since class scores are complete without
        it.
        """
        outputs = torch.cat([output.flatten(1, 2) for output in raw], 1)
        centre_px, stride_px = self.cells_px(
            [(o.shape[1], o.shape[2]) for o in raw], device=outputs.device
        )
        logits, distances = split_outputs(outputs)
        cxcywh = boxes_of(distances, centre_px, stride_px)
        return torch.cat([cxcywh, torch.ones_like(cxcywh[..., :1]), logits.sigmoid()], -1)

    def cells_px(
        self, grids_hw: Sequence[tuple[int, int]], *, device: torch.device
    ) -> tuple[Tensor, Tensor]:
        """Centres (N, 2) and sides (N,) in input pixels of the cells of all levels with these rows
        and columns.
        """
        grids = [cells_xy(*hw, device=device).flatten(0, 1) for hw in grids_hw]
        parts = list(zip(grids, self.strides_px, strict=True))
        sides = [torch.full((len(grid),), float(stride), device=device) for grid, stride in parts]
        return torch.cat([(grid + 0.5) * stride for grid, stride in parts]), torch.cat(sides)

    def exported(self, raw: Sequence[Tensor]) -> dict[str, Tensor]:
        """Scores (B, n, C) and logits of the bins (B, n, 4 * bins) of each level with n cells:
        PicoDet's layout.

        The boxes of the few cells with high scores are decoded outside the network, see
        `detection.yolo.decoders.binned_distances`.
        """
        rows = {
            stride: output.flatten(1, 2)
            for stride, output in zip(self.strides_px, raw, strict=True)
        }
        scores = {
            f"scores_{stride}": output[..., : -4 * N_BINS].sigmoid()
            for stride, output in rows.items()
        }
        return scores | {
            f"bins_{stride}": output[..., -4 * N_BINS :] for stride, output in rows.items()
        }


def split_outputs(raw: Tensor) -> tuple[Tensor, Tensor]:
    """Logits of the classes (..., C) and distances (..., 4) in cells, from raw outputs (..., C + 4
    * bins).
    """
    bins = raw[..., -4 * N_BINS :].reshape(*raw.shape[:-1], 4, N_BINS)
    values = torch.arange(N_BINS, device=raw.device, dtype=raw.dtype)
    return raw[..., : -4 * N_BINS], bins.softmax(-1) @ values


def boxes_of(distances: Tensor, centre_px: Tensor, stride_px: Tensor) -> Tensor:
    """(..., 4) centre and size in pixels of boxes, from the distances (..., 4) of their sides in
    cells.

    The sides are left, top, right, bottom; `centre_px` (..., 2) and `stride_px` (...) belong to the
    cells.
    """
    low = distances[..., :2] * stride_px[..., None]
    high = distances[..., 2:] * stride_px[..., None]
    return torch.cat([centre_px + (high - low) / 2, low + high], -1)


class RoadNetHead(nn.Module):
    """The head of one level: a branch for the classes and a branch for the distances."""

    def __init__(self, n_in: int, n_classes: int) -> None:
        super().__init__()
        self.score_features = ConvolutionBlock(n_in, _N_HIDDEN, size=3)
        self.scores = nn.Conv2d(_N_HIDDEN, n_classes, 1)
        self.bin_features = ConvolutionBlock(n_in, _N_HIDDEN, size=3)
        self.bins = nn.Conv2d(_N_HIDDEN, 4 * N_BINS, 1)
        if self.scores.bias is not None:
            nn.init.constant_(self.scores.bias, -math.log(1 / _INITIAL_SCORE - 1))

    def forward(self, features: Tensor) -> Tensor:
        """(B, classes + 4 * bins, rows, columns) from features (B, n_in, rows, columns)."""
        return torch.cat(
            [self.scores(self.score_features(features)), self.bins(self.bin_features(features))], 1
        )
