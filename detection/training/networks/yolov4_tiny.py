"""YOLOv4-tiny: CSPDarknet53-tiny and two heads.

    image -> three CSP blocks -> P4 (stride 16), P5 (stride 32) -> heads of stride 16 and 32
    centre = (1.05 sigmoid(xy) - 0.025 + cell) stride      size = exp(wh) anchor

(Bochkovskiy et al., "YOLOv4", 2020; Jiang et al., "Real-time object detection method based on
improved YOLOv4-tiny", 2020, for a description of the network and its CSP blocks; scale_x_y = 1.05
as in AlexeyAB's yolov4-tiny.cfg.)
"""

import torch
from torch import Tensor, nn

from track_range.detection.training.networks.blocks import Cbam, ConvolutionBlock
from track_range.detection.training.networks.network import AnchorNetwork
from track_range.detection.training.networks.yolov5 import background_head
from track_range.detection.yolo.dense_layouts import YOLOV4_TINY_ANCHORS
from track_range.detection.yolo.metadata import Anchors

DEFAULT_ANCHORS_PX: Anchors = YOLOV4_TINY_ANCHORS[::-1]  # anchors in input pixels, stride 16 first
_SCALE_X_Y = 1.05  # Darknet's factor on the range of the centre offsets
# of a box relative to its anchor (a ratio of 400), to avoid overflow early in training
_MAX_LOG_SIZE = 6.0


class CspBlock(nn.Module):
    """Cross-stage block: two convolutions on half of the channels, concatenation with all channels,
    2x2 max pooling.
    """

    def __init__(self, n_channels: int, *, has_attention: bool) -> None:
        super().__init__()
        half = n_channels // 2
        self.start = _block(n_channels, n_channels, size=3)
        self.first = _block(half, half, size=3)
        self.second = _block(half, half, size=3)
        self.join = _block(n_channels, n_channels)
        self.attention: nn.Module = Cbam(2 * n_channels) if has_attention else nn.Identity()
        self.pool = nn.MaxPool2d(2, 2)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Output (B, 2 * n, H / 2, W / 2) for `x` (B, n, H, W), and features (B, n, H, W) for the
        neck.
        """
        start = self.start(x)
        first = self.first(start[:, start.shape[1] // 2 :])
        joined = self.join(torch.cat([self.second(first), first], 1))
        return self.pool(self.attention(torch.cat([start, joined], 1))), joined


class YoloV4Tiny(AnchorNetwork):
    """A YOLOv4-tiny network; see `AnchorNetwork`."""

    strides_px = (16, 32)
    reach_cells = 0.0

    def __init__(
        self, name: str, n_classes: int, *, anchors_px: Anchors, has_cbam: bool = False
    ) -> None:
        super().__init__(name, n_classes, anchors_px=anchors_px, has_cbam=has_cbam)
        self.stem = nn.Sequential(_block(3, 32, size=3, stride=2), _block(32, 64, size=3, stride=2))
        self.stages = nn.ModuleList(CspBlock(n, has_attention=has_cbam) for n in (64, 128, 256))
        self.top = nn.Sequential(_block(512, 512, size=3), _block(512, 256))
        self.to_p4 = nn.Sequential(_block(256, 128), nn.Upsample(scale_factor=2, mode="nearest"))
        self.out_p4 = _block(384, 256, size=3)
        self.out_p5 = _block(256, 512, size=3)
        self.heads = nn.ModuleList(
            background_head(n, self.n_anchors, n_classes, stride_px=stride)
            for n, stride in zip((256, 512), self.strides_px, strict=True)
        )

    def forward(self, images: Tensor) -> list[Tensor]:
        """See `AnchorNetwork`."""
        x = self.stem(images)
        joined = x
        for stage in self.stages:
            x, joined = stage(x)
        top = self.top(x)
        p4 = self.out_p4(torch.cat([self.to_p4(top), joined], 1))
        return self.as_heads([self.heads[0](p4), self.heads[1](self.out_p5(top))])

    def boxes(self, raw: Tensor, cells_xy: Tensor, anchors_px: Tensor, stride_px: int) -> Tensor:
        """See `AnchorNetwork`."""
        centre = (_SCALE_X_Y * raw[..., :2].sigmoid() - (_SCALE_X_Y - 1) / 2 + cells_xy) * stride_px
        return torch.cat([centre, raw[..., 2:].clamp(max=_MAX_LOG_SIZE).exp() * anchors_px], -1)


def _block(n_in: int, n_out: int, *, size: int = 1, stride: int = 1) -> ConvolutionBlock:
    return ConvolutionBlock(
        n_in, n_out, size=size, stride=stride, activation=nn.LeakyReLU(0.1, inplace=True)
    )
