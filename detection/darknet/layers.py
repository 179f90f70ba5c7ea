"""Darknet's layers: what each section of a cfg computes, from which layers, and the shape that comes out.

    convolutional    out = (in + 2 pad - size) / stride + 1        pad=1 means size / 2, rounded down
    maxpool          out = (in + padding - size) / stride + 1      padding = size - 1, the smaller half of it before
    upsample         out = in * stride                             every value repeated
    route            channels of several layers one after the other, or one of `groups` equal shares of each
    shortcut         sum of the layer before and others
    yolo             reads the layer before: A (5 + classes) channels, A = number of anchors in `mask`

(AlexeyAB's parser.c and the *_layer.c beside it, which made the weights of YOLOv4; divisions round down.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

Shape = tuple[int, int, int]
"""Channels, rows, columns."""

IMAGE = -1
"""The source of a layer that sees the input image."""


@dataclass(frozen=True, slots=True)
class Activation:
    """ONNX operators one after the other; a gate's result is multiplied by what went in."""

    operators: tuple[str, ...] = ()
    is_gate: bool = False
    alpha: float | None = None


ACTIVATIONS: Mapping[str, Activation] = {
    "linear": Activation(),
    "leaky": Activation(("LeakyRelu",), alpha=0.1),
    "relu": Activation(("Relu",)),
    "logistic": Activation(("Sigmoid",)),
    "tanh": Activation(("Tanh",)),
    "swish": Activation(("Sigmoid",), is_gate=True),
    # x tanh(ln(1 + e^x)); ONNX's own Mish is no faster in onnxruntime (46 and 46 ms for six layers), and newer.
    "mish": Activation(("Softplus", "Tanh"), is_gate=True),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Convolution:
    """A convolution, its batch norm and its activation; `pad` counts each side."""

    n_filters: int
    n_channels: int
    size: int
    stride_yx: tuple[int, int]
    pad: int
    groups: int
    has_batch_norm: bool
    activation: str

    @property
    def n_values(self) -> int:
        """How many numbers of the weights file are its own."""
        return (4 if self.has_batch_norm else 1) * self.n_filters + self.n_weights

    @property
    def n_weights(self) -> int:
        """Filters x channels per group x size x size."""
        return self.n_filters * (self.n_channels // self.groups) * self.size**2


@dataclass(frozen=True, slots=True)
class MaxPool:
    """`padding` counts both sides together; what is outside never wins."""

    size: int
    stride_yx: tuple[int, int]
    padding: int


@dataclass(frozen=True, slots=True)
class Upsample:
    """Each value becomes `stride` x `stride` of them."""

    stride: int


@dataclass(frozen=True, slots=True)
class Route:
    """Of each source the channels `group_id` of `groups` equal shares, one source after the other."""

    groups: int
    group_id: int


@dataclass(frozen=True, slots=True)
class Shortcut:
    """The sum of all sources."""

    activation: str


@dataclass(frozen=True, slots=True)
class Dropout:
    """Does nothing once training is over."""


@dataclass(frozen=True, slots=True)
class YoloHead:
    """The reader of an output; `anchors_px` are those of its mask, in input pixels."""

    anchors_px: tuple[tuple[float, float], ...]
    n_classes: int
    scale_x_y: float


Operation = Convolution | MaxPool | Upsample | Route | Shortcut | Dropout | YoloHead


@dataclass(frozen=True, slots=True)
class Layer:
    """One layer: an operation on other layers (their indices, or IMAGE), and the shape that comes out."""

    operation: Operation
    sources: tuple[int, ...]
    shape: Shape


@dataclass(frozen=True, slots=True)
class Network:
    """What a cfg describes.

    Attributes:
        input_shape: of the image.
        letter_box: what [net] says of it; None = nothing.
        layers: in the cfg's order, so that sources come first.
    """

    input_shape: Shape
    letter_box: int | None
    layers: tuple[Layer, ...]

    @property
    def n_values(self) -> int:
        """How many numbers the weights file holds."""
        return sum(layer.operation.n_values for layer in self.layers if isinstance(layer.operation, Convolution))

    @property
    def heads(self) -> list[tuple[int, YoloHead]]:
        """Each [yolo] with the layer that it reads, in the cfg's order."""
        return [(layer.sources[0], layer.operation) for layer in self.layers if isinstance(layer.operation, YoloHead)]
