"""INT8 rounding, simulated in training, so that the network learns weights that quantization changes little.

    x' = s (clip(round(x / s) + z, 0, 255) - z),   s = (high - low) / 255,   z = round(-low / s)

The backward pass takes the rounding as the identity, and gives clipped values no gradient. Ranges are those of
`detection.models.quantize`, measured on each batch: for activations, one range per tensor, from the mean of the images'
minima to the mean of their maxima; for weights, one symmetric range of -127 to 127 steps per output channel. A batch
norm after the convolution scales a channel's weights and their range alike, and so does not change their rounding.

Only the inputs, the weights and the outputs before the activation of convolution blocks are rounded; the INT8 file also
rounds the activations, sums, pooled and resized maps, but keeps a few tensors in float.

Source: Jacob et al., "Quantization and Training of Neural Networks for Efficient Integer-Arithmetic-Only Inference",
CVPR 2018.
"""

from __future__ import annotations

import torch
from torch import Tensor

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
    """The weights (n_out, n_in, h, w) of a convolution, rounded to 255 values per output channel."""
    with torch.no_grad():
        step = (weights.abs().amax((1, 2, 3)).float() / 127).clamp(min=_MIN_STEP)
        zero = torch.zeros_like(step, dtype=torch.int32)
    return torch.fake_quantize_per_channel_affine(weights, step, zero, 0, -127, 127)
