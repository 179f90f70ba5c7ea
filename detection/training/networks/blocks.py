"""Building blocks of the YOLO networks: convolutions, C3 with or without CBAM, spatial pyramid
pooling.

C3 and SPPF as in YOLOv5 (v6.0); CBAM: Woo et al., "CBAM: Convolutional Block Attention Module",
ECCV 2018.

INT8 rounding, simulated in training, so that the network learns weights that quantization changes
little.

    x' = s (clip(round(x / s) + z, 0, 255) - z),   s = (high - low) / 255,   z = round(-low / s)

The backward pass takes the rounding as the identity, and gives clipped values no gradient. Ranges
follow `detection.models.quantize`, measured on each batch: for activations, one range per tensor,
from the mean of the images' minima to the mean of their maxima; for weights, one symmetric range of
-127 to 127 steps per output channel. A batch norm after the convolution scales a channel's weights
and their range alike, and so does not change their rounding.

Only the inputs, the weights and the outputs before the activation of convolution blocks are
rounded; the INT8 file also rounds the activations, sums, pooled and resized maps, but keeps a few
tensors in float.

Source: Jacob et al., "Quantization and Training of Neural Networks for Efficient
Integer-Arithmetic-Only Inference", CVPR 2018.
"""

import torch
from torch import Tensor, nn

_MIN_STEP = 1e-8  # for tensors whose values are all 0


def rounded_activations(x: Tensor) -> Tensor:
    """`x` (B, n, H, W), rounded to the 256 values of unsigned bytes; 0 is one of them."""
    with torch.no_grad():
        low = x.amin((1, 2, 3)).float().mean().clamp(max=0.0)
        high = x.amax((1, 2, 3)).float().mean().clamp(min=0.0)
        step = ((high - low) / 255).clamp(min=_MIN_STEP)
        zero = (-low / step).round().to(torch.int32)
    return torch.fake_quantize_per_tensor_affine(x, step, zero, 0, 255)


def rounded_weights(weights: Tensor) -> Tensor:
    """The weights (n_out, n_in, h, w) of a convolution, rounded to 255 values per output
    channel.
    """
    with torch.no_grad():
        step = (weights.abs().amax((1, 2, 3)).float() / 127).clamp(min=_MIN_STEP)
        zero = torch.zeros_like(step, dtype=torch.int32)
    return torch.fake_quantize_per_channel_affine(weights, step, zero, 0, -127, 127)


class ConvolutionBlock(nn.Module):
    """Convolution (without bias), batch norm and activation (default SiLU), with "same" padding by
    default.
    """

    def __init__(
        self,
        n_in: int,
        n_out: int,
        *,
        size: int = 1,
        stride: int = 1,
        padding: int | None = None,
        activation: nn.Module | None = None,
    ) -> None:
        super().__init__()
        self.conv = nn.Conv2d(
            n_in, n_out, size, stride, size // 2 if padding is None else padding, bias=False
        )
        self.norm = nn.BatchNorm2d(n_out, eps=1e-3, momentum=0.03)
        self.activation = activation or nn.SiLU(inplace=True)
        self.is_rounded = False  # INT8 rounding is simulated in training

    def forward(self, x: Tensor) -> Tensor:
        """(B, n_out, H / stride, W / stride) from `x` (B, n_in, H, W)."""
        y = self._rounded(x) if self.is_rounded and self.training else self.norm(self.conv(x))
        activated: Tensor = self.activation(y)
        return activated

    def _rounded(self, x: Tensor) -> Tensor:
        conv = self.conv
        y = nn.functional.conv2d(
            rounded_activations(x), rounded_weights(conv.weight), None, conv.stride, conv.padding
        )
        return rounded_activations(self.norm(y))


class Bottleneck(nn.Module):
    """A 1x1 and a 3x3 convolution; a residual block adds its input."""

    def __init__(self, n_channels: int, *, is_residual: bool = True) -> None:
        super().__init__()
        self.reduce = ConvolutionBlock(n_channels, n_channels)
        self.expand = ConvolutionBlock(n_channels, n_channels, size=3)
        self.is_residual = is_residual

    def forward(self, x: Tensor) -> Tensor:
        """Output in the shape of `x`."""
        y: Tensor = self.expand(self.reduce(x))
        return x + y if self.is_residual else y


class C3(nn.Module):
    """Cross-stage block of three convolutions and `n_bottlenecks` bottlenecks, optionally with CBAM
    on its output.
    """

    def __init__(
        self,
        n_in: int,
        n_out: int,
        n_bottlenecks: int,
        *,
        is_residual: bool = True,
        has_attention: bool = False,
    ) -> None:
        super().__init__()
        hidden = n_out // 2
        self.main = ConvolutionBlock(n_in, hidden)
        self.side = ConvolutionBlock(n_in, hidden)
        self.steps = nn.Sequential(
            *(Bottleneck(hidden, is_residual=is_residual) for _ in range(n_bottlenecks))
        )
        self.join = ConvolutionBlock(2 * hidden, n_out)
        self.attention: nn.Module = Cbam(n_out) if has_attention else nn.Identity()

    def forward(self, x: Tensor) -> Tensor:
        """(B, n_out, H, W) from `x` (B, n_in, H, W)."""
        joined: Tensor = self.attention(
            self.join(torch.cat([self.steps(self.main(x)), self.side(x)], dim=1))
        )
        return joined


class Sppf(nn.Module):
    """Spatial pyramid pooling: three consecutive 5x5 max pools, equivalent to parallel pools of
    5x5, 9x9 and 13x13.
    """

    def __init__(self, n_in: int, n_out: int) -> None:
        super().__init__()
        self.reduce = ConvolutionBlock(n_in, n_in // 2)
        self.join = ConvolutionBlock(2 * n_in, n_out)
        self.pool = nn.MaxPool2d(5, stride=1, padding=2)

    def forward(self, x: Tensor) -> Tensor:
        """(B, n_out, H, W) from `x` (B, n_in, H, W)."""
        parts = [self.reduce(x)]
        for _ in range(3):
            parts.append(self.pool(parts[-1]))
        joined: Tensor = self.join(torch.cat(parts, dim=1))
        return joined


class Cbam(nn.Module):
    """Channel attention, then spatial attention.

    M_c = sigmoid(MLP(mean over pixels) + MLP(max over pixels))      x' = M_c x
    M_s = sigmoid(conv 7x7 [mean over channels, max over channels])  x'' = M_s x'
    """

    def __init__(self, n_channels: int, *, reduction: int = 16) -> None:
        super().__init__()
        hidden = max(n_channels // reduction, 4)
        self.mlp = nn.Sequential(
            nn.Conv2d(n_channels, hidden, 1, bias=False),
            nn.ReLU(inplace=True),
            nn.Conv2d(hidden, n_channels, 1, bias=False),
        )
        self.spatial = nn.Conv2d(2, 1, 7, padding=3, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        """Output in the shape of `x`."""
        channel = torch.sigmoid(
            self.mlp(x.mean((2, 3), keepdim=True)) + self.mlp(x.amax((2, 3), keepdim=True))
        )
        x = x * channel
        spatial = torch.sigmoid(
            self.spatial(torch.cat([x.mean(1, keepdim=True), x.amax(1, keepdim=True)], dim=1))
        )
        return x * spatial
