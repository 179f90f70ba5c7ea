"""Simulated INT8 rounding: values, gradients, and where it takes place."""

import numpy as np
import torch
from torch.nn import functional

from track_range.detection.training.networks.blocks import (
    ConvolutionBlock,
    rounded_activations,
    rounded_weights,
)


def test_activations_by_reference_arithmetic():
    x = torch.from_numpy(np.random.default_rng(0).normal(0.4, 1.0, (3, 4, 8, 8)).astype(np.float32))
    images = x.reshape(3, -1).double().numpy()
    low, high = images.min(1).mean(), images.max(1).mean()
    step = (high - low) / 255
    zero = np.rint(-low / step)
    expected = step * (np.clip(np.rint(images / step) + zero, 0, 255) - zero)
    result = rounded_activations(x).reshape(3, -1).numpy()
    assert np.abs(result - expected).max() < 1e-5
    assert (np.abs(result - images) > 0.51 * step).any()  # the most extreme image is clipped
    assert len(np.unique(result)) <= 256


def test_zero_is_exact_and_constant_tensors_stay():
    x = torch.tensor([0.0, 0.3, 7.1]).reshape(1, 1, 1, 3)
    assert rounded_activations(x)[0, 0, 0, 0] == 0
    assert torch.equal(rounded_activations(torch.zeros(2, 3, 4, 4)), torch.zeros(2, 3, 4, 4))
    assert torch.equal(rounded_weights(torch.zeros(2, 3, 1, 1)), torch.zeros(2, 3, 1, 1))


def test_gradient_is_the_identity_except_for_clipped_values():
    x = (
        torch.stack([torch.linspace(-1, 1, 64), torch.linspace(-3, 3, 64)])
        .reshape(2, 1, 8, 8)
        .requires_grad_()
    )
    rounded_activations(x).sum().backward()
    assert torch.equal(x.grad, (x.detach().abs() < 2.01).float())  # the range is -2 to 2


def test_weights_by_output_channel():
    weights = torch.randn(5, 3, 3, 3, generator=torch.Generator().manual_seed(1))
    scales = torch.tensor([0.01, 0.1, 1.0, 10.0, -100.0]).reshape(-1, 1, 1, 1)
    step = weights.abs().amax((1, 2, 3), keepdim=True) / 127
    assert torch.allclose(rounded_weights(weights), (weights / step).round() * step, atol=1e-6)
    # A batch norm that scales the channels does not change their rounding.
    assert torch.allclose(
        rounded_weights(weights * scales), rounded_weights(weights) * scales, rtol=1e-4
    )


def test_block_rounds_input_weights_and_output_in_training():
    torch.manual_seed(0)
    block, images = ConvolutionBlock(3, 8, size=3, stride=2), torch.randn(2, 3, 16, 16)
    block.is_rounded = True
    y = functional.conv2d(
        rounded_activations(images), rounded_weights(block.conv.weight), stride=2, padding=1
    )
    y = functional.batch_norm(
        y, None, None, block.norm.weight, block.norm.bias, training=True, eps=block.norm.eps
    )
    assert torch.equal(block(images), functional.silu(rounded_activations(y)))
    block.eval()
    rounded = block(images)
    block.is_rounded = False
    assert torch.equal(block(images), rounded)
