"""Darknet's layers: the operation of each section of a cfg, its source layers and the shape of its output.

    convolutional    out = (in + 2 pad - size) / stride + 1        pad=1 in the cfg means pad = size / 2
    maxpool          out = (in + padding - size) / stride + 1      padding = size - 1, the smaller half top and left
    upsample         out = in * stride                             nearest neighbour
    route            concatenated channels of several layers, or of one of `groups` equal parts of each
    shortcut         sum of the previous layer and others
    yolo             decodes the previous layer: A (5 + classes) channels, A = number of anchors in `mask`

Divisions round down. (AlexeyAB's parser.c and *_layer.c, with which YOLOv4 was trained.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

Shape = tuple[int, int, int]  # number of channels, rows and columns of an output

IMAGE = -1  # index of the input image as a source of layers


@dataclass(frozen=True, slots=True)
class Activation:
    """An activation function as ONNX operators."""

    operators: tuple[str, ...] = ()  # operators that are applied one after the other
    is_gate: bool = False  # the result is multiplied by the input
    alpha: float | None = None  # slope for negative inputs, of LeakyRelu; None for other operators


ACTIVATIONS: Mapping[str, Activation] = {
    "linear": Activation(),
    "leaky": Activation(("LeakyRelu",), alpha=0.1),
    "relu": Activation(("Relu",)),
    "logistic": Activation(("Sigmoid",)),
    "tanh": Activation(("Tanh",)),
    "swish": Activation(("Sigmoid",), is_gate=True),
    # x tanh(ln(1 + e^x)); ONNX's Mish needs a newer operator set and is not faster in onnxruntime.
    "mish": Activation(("Softplus", "Tanh"), is_gate=True),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Convolution:
    """A convolution with batch norm and activation."""

    n_filters: int
    n_channels: int
    size: int  # side of the kernel in pixels
    stride_yx: tuple[int, int]
    pad: int  # padding of each side in pixels
    groups: int  # number of channel groups
    has_batch_norm: bool
    activation: str  # key of `ACTIVATIONS`

    @property
    def n_values(self) -> int:
        """Number of values of this layer in the weights file."""
        return (4 if self.has_batch_norm else 1) * self.n_filters + self.n_weights

    @property
    def n_weights(self) -> int:
        """Number of weights: filters x channels per group x size x size."""
        return self.n_filters * (self.n_channels // self.groups) * self.size**2


@dataclass(frozen=True, slots=True)
class MaxPool:
    """Maximum pooling; `padding` is the sum of both sides, and padded values are never the maximum."""

    size: int
    stride_yx: tuple[int, int]
    padding: int


@dataclass(frozen=True, slots=True)
class Upsample:
    """Nearest-neighbour upsampling by the factor `stride`."""

    stride: int


@dataclass(frozen=True, slots=True)
class Route:
    """Concatenation of the sources; of each, part `group_id` of `groups` equal parts of its channels."""

    groups: int
    group_id: int


@dataclass(frozen=True, slots=True)
class Shortcut:
    """Sum of all sources, with an activation."""

    activation: str


@dataclass(frozen=True, slots=True)
class Dropout:
    """Dropout; has no effect in inference."""


@dataclass(frozen=True, slots=True)
class YoloHead:
    """A [yolo] layer."""

    anchors_px: tuple[tuple[float, float], ...]  # (width, height) in input pixels of the anchors in its mask
    n_classes: int
    scale_x_y: float  # factor on the range of the centre offsets


Operation = Convolution | MaxPool | Upsample | Route | Shortcut | Dropout | YoloHead


@dataclass(frozen=True, slots=True)
class Layer:
    """One layer: its operation, the indices of its source layers (or `IMAGE`) and the shape of its output."""

    operation: Operation
    sources: tuple[int, ...]
    shape: Shape


@dataclass(frozen=True, slots=True)
class Network:
    """The network that a cfg describes."""

    input_shape: Shape  # shape of the input image
    letter_box: int | None  # value of letter_box in [net]; None = absent
    layers: tuple[Layer, ...]  # the layers in the cfg's order; sources precede the layers that use them

    @property
    def n_values(self) -> int:
        """Number of values in the weights file."""
        return sum(layer.operation.n_values for layer in self.layers if isinstance(layer.operation, Convolution))

    @property
    def heads(self) -> list[tuple[int, YoloHead]]:
        """Index of the source layer and the operation of each [yolo] layer, in the cfg's order."""
        return [(layer.sources[0], layer.operation) for layer in self.layers if isinstance(layer.operation, YoloHead)]
