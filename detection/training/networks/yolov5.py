"""YOLOv5 (v6.0): CSP backbone, path-aggregation neck, three heads.

    image -> P3 (stride 8), P4 (16), P5 (32) -> neck -> three heads
    centre = (2 sigmoid(xy) - 0.5 + cell) stride      size = (2 sigmoid(wh))^2 anchor

(Jocher et al., "YOLOv5", v6.0, its yolov5n.yaml and yolov5s.yaml for depth and width; CBAM behind
the backbone's C3.)
"""

import math

import torch
from torch import Tensor, nn

from track_range.detection.training.networks.blocks import C3, ConvolutionBlock, Sppf
from track_range.detection.training.networks.network import AnchorNetwork
from track_range.detection.yolo.metadata import Anchors

COCO_ANCHORS_PX: Anchors = (  # YOLOv5's default anchors in input pixels, for COCO at 640 pixels
    ((10, 13), (16, 30), (33, 23)),
    ((30, 61), (62, 45), (59, 119)),
    ((116, 90), (156, 198), (373, 326)),
)


# depth and width as multiples of YOLOv5l's
SCALES = {"yolov5n": (0.33, 0.25), "yolov5s": (0.33, 0.50)}
# prefix of the names of the weights of `YoloV5Body` in networks that have one
BODY_PREFIX = "body."


class YoloV5Body(nn.Module):
    """Backbone and path-aggregation neck; `n_channels` are the channels of the three levels of
    features.
    """

    def __init__(self, scale: tuple[float, float], *, has_cbam: bool = False) -> None:
        super().__init__()
        depth, width = scale
        # multiples of 8
        c1, c2, c3, c4, c5 = (math.ceil(n * width / 8) * 8 for n in (64, 128, 256, 512, 1024))
        d1, d2, d3 = (max(round(n * depth), 1) for n in (3, 6, 9))
        self.n_channels = (c3, c4, c5)
        self.to_p3 = nn.Sequential(
            ConvolutionBlock(3, c1, size=6, stride=2, padding=2),
            ConvolutionBlock(c1, c2, size=3, stride=2),
            C3(c2, c2, d1, has_attention=has_cbam),
            ConvolutionBlock(c2, c3, size=3, stride=2),
            C3(c3, c3, d2, has_attention=has_cbam),
        )
        self.to_p4 = nn.Sequential(
            ConvolutionBlock(c3, c4, size=3, stride=2), C3(c4, c4, d3, has_attention=has_cbam)
        )
        self.to_p5 = nn.Sequential(
            ConvolutionBlock(c4, c5, size=3, stride=2),
            C3(c5, c5, d1, has_attention=has_cbam),
            Sppf(c5, c5),
        )
        self.reduce_p5 = ConvolutionBlock(c5, c4)
        self.join_p4 = C3(2 * c4, c4, d1, is_residual=False)
        self.reduce_p4 = ConvolutionBlock(c4, c3)
        self.out_p3 = C3(2 * c3, c3, d1, is_residual=False)
        self.down_p3 = ConvolutionBlock(c3, c3, size=3, stride=2)
        self.out_p4 = C3(2 * c3, c4, d1, is_residual=False)
        self.down_p4 = ConvolutionBlock(c4, c4, size=3, stride=2)
        self.out_p5 = C3(2 * c4, c5, d1, is_residual=False)
        self.up = nn.Upsample(scale_factor=2, mode="nearest")

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Features (B, n, rows, columns) at strides 8, 16 and 32 for images (B, 3, H, W), RGB in
        0..1.
        """
        p3 = self.to_p3(images)
        p4 = self.to_p4(p3)
        top = self.reduce_p5(self.to_p5(p4))
        middle = self.reduce_p4(self.join_p4(torch.cat([self.up(top), p4], 1)))
        out3 = self.out_p3(torch.cat([self.up(middle), p3], 1))
        out4 = self.out_p4(torch.cat([self.down_p3(out3), middle], 1))
        return out3, out4, self.out_p5(torch.cat([self.down_p4(out4), top], 1))


class YoloV5(AnchorNetwork):
    """A YOLOv5 network; see `AnchorNetwork`."""

    strides_px = (8, 16, 32)
    reach_cells = 0.5

    def __init__(
        self, name: str, n_classes: int, *, anchors_px: Anchors, has_cbam: bool = False
    ) -> None:
        super().__init__(name, n_classes, anchors_px=anchors_px, has_cbam=has_cbam)
        self.body = YoloV5Body(SCALES[name], has_cbam=has_cbam)
        self.heads = nn.ModuleList(
            background_head(c, self.n_anchors, n_classes, stride_px=stride)
            for c, stride in zip(self.body.n_channels, self.strides_px, strict=True)
        )

    def forward(self, images: Tensor) -> list[Tensor]:
        """See `AnchorNetwork`."""
        return self.as_heads(
            [head(features) for head, features in zip(self.heads, self.body(images), strict=True)]
        )

    def boxes(self, raw: Tensor, cells_xy: Tensor, anchors_px: Tensor, stride_px: int) -> Tensor:
        """See `AnchorNetwork`."""
        predictions = raw.sigmoid()
        centre = (2 * predictions[..., :2] - 0.5 + cells_xy) * stride_px
        return torch.cat([centre, (2 * predictions[..., 2:]) ** 2 * anchors_px], -1)


def background_head(n_in: int, n_anchors: int, n_classes: int, *, stride_px: int) -> nn.Conv2d:
    """A head with the initial biases of YOLOv5: about 8 objects per image of 640 pixels, equal
    class probabilities.
    """
    head = nn.Conv2d(n_in, n_anchors * (5 + n_classes), 1)
    with torch.no_grad():
        if head.bias is not None:
            bias = head.bias.view(n_anchors, -1)
            bias[:, 4] += math.log(8 / (640 / stride_px) ** 2)
            bias[:, 5:] += math.log(0.6 / (n_classes - 0.99999))
    return head
