"""Conversion of a Darknet cfg into layers with their sources and shapes.

Layers count from 0 at the section after [net]; `layers=-1` is the previous layer, `layers=8` the
ninth layer.

    convolutional    out = (in + 2 pad - size) / stride + 1        pad=1 in the cfg means pad = size / 2
    maxpool          out = (in + padding - size) / stride + 1      padding = size - 1, the smaller half top and left
    upsample         out = in * stride                             nearest neighbour
    route            concatenated channels of several layers, or of one of `groups` equal parts of each
    shortcut         sum of the previous layer and others
    yolo             decodes the previous layer: A (5 + classes) channels, A = number of anchors in `mask`

Divisions round down. (AlexeyAB's parser.c and *_layer.c, with which YOLOv4 was trained.)
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from track_range.detection.catalogue.darknet.cfg import CfgSection, read_sections
from track_range.foundation.files.input_files import quoted, shortened

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
    """Maximum pooling; `padding` is the sum of both sides, and padded values are never the
    maximum.
    """

    size: int
    stride_yx: tuple[int, int]
    padding: int


@dataclass(frozen=True, slots=True)
class Upsample:
    """Nearest-neighbour upsampling by the factor `stride`."""

    stride: int


@dataclass(frozen=True, slots=True)
class Route:
    """Concatenation of part `group_id` of the channels of each source, which are divided into
    `groups` equal parts.
    """

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

    # (width, height) in input pixels of the anchors in its mask
    anchors_px: tuple[tuple[float, float], ...]
    n_classes: int
    scale_x_y: float  # factor on the range of the centre offsets


Operation = Convolution | MaxPool | Upsample | Route | Shortcut | Dropout | YoloHead


@dataclass(frozen=True, slots=True)
class Layer:
    """One layer: its operation, the indices of its source layers (or `IMAGE`) and the shape of its
    output.
    """

    operation: Operation
    sources: tuple[int, ...]
    shape: Shape


@dataclass(frozen=True, slots=True)
class Network:
    """The network that a cfg describes."""

    input_shape: Shape  # shape of the input image
    letter_box: int | None  # value of letter_box in [net]; None = absent
    # the layers in the cfg's order; sources precede the layers that use them
    layers: tuple[Layer, ...]

    @property
    def n_values(self) -> int:
        """Number of values in the weights file."""
        return sum(
            layer.operation.n_values
            for layer in self.layers
            if isinstance(layer.operation, Convolution)
        )

    @property
    def heads(self) -> list[tuple[int, YoloHead]]:
        """Index of the source layer and the operation of each [yolo] layer, in the cfg's order."""
        return [
            (layer.sources[0], layer.operation)
            for layer in self.layers
            if isinstance(layer.operation, YoloHead)
        ]


def read_network(path: Path) -> Network:
    """The network that the cfg at `path` describes; ModelError if it is invalid or has unsupported
    options.
    """
    net, sections, network = read_layers(path)
    heads = [head for _, head in network.heads]
    if len(heads) not in (2, 3):
        raise net.error(
            f"expected two or three [yolo] sections as in YOLOv3 and YOLOv4, got {len(heads)}"
        )
    if len({(len(head.anchors_px), head.n_classes) for head in heads}) != 1:
        raise net.error(
            "expected the same number of classes and of anchors per mask in all [yolo] sections"
        )
    image = network.input_shape
    for section, (source, _) in zip(sections, network.heads, strict=True):
        grid = network.layers[source].shape
        if image[1] % grid[1] or image[2] % grid[2]:
            raise section.error(
                "expected width and height of [net] that are multiples of the strides (usually of "
                f"32), got an input of {image[2]}x{image[1]} pixels for a grid of "
                f"{grid[2]}x{grid[1]} cells; check width, height and the strides"
            )
    return network


def read_layers(path: Path) -> tuple[CfgSection, list[CfgSection], Network]:
    """The section [net], the [yolo] sections and the network of a cfg; the heads are not yet
    compared.
    """
    net, *sections = read_sections(path, tuple(_READERS))
    n_channels, height, width = (
        net.integer(key, default, minimum=1) for key, default in _NET_SIZES.items()
    )
    if n_channels != 3:
        raise net.error(f"expected channels=3, got channels={n_channels}")
    if (side := max(height, width)) > _MAX_SIDE_PX:
        raise net.error(f"expected an input of at most {_MAX_SIDE_PX} pixels a side, got {side}")
    trunk = _Trunk((n_channels, height, width))
    for section in sections:
        layer = _READERS[section.kind](section, trunk)
        if math.prod(layer.shape) > _MAX_VALUES:
            raise section.error(
                f"expected an output of at most {_MAX_VALUES:,} values, got {_sizes([layer.shape])}"
            )
        trunk.layers.append(layer)
    letter_box = net.integer("letter_box") if "letter_box" in net.options else None
    network = Network(trunk.image, letter_box, tuple(trunk.layers))
    return net, [section for section in sections if section.kind == "yolo"], network


# of [net]; None = no default
_NET_SIZES: Mapping[str, int | None] = {"channels": 3, "height": None, "width": None}
_MAX_SIDE_PX = 8192  # of the input, as for ONNX models
_MAX_VALUES = 2**28  # of a layer's output: 1 GB
_MAX_ANCHOR_PX = 65535


class _Trunk:
    """Layers read so far, and the shape of the input image."""

    def __init__(self, image: Shape) -> None:
        self.image = image
        self.layers: list[Layer] = []

    def before(self, section: CfgSection) -> int:
        return self.source(section, len(self.layers) - 1)

    def source(self, section: CfgSection, index: int) -> int:
        """`index` after a check that the layer is not a [yolo], whose output cannot be an input of
        layers.
        """
        if index >= 0 and isinstance(self.layers[index].operation, YoloHead):
            raise section.error(
                f"its source, layer {index}, is a [yolo] layer, which has no features"
            )
        return index

    def shape(self, index: int) -> Shape:
        return self.image if index == IMAGE else self.layers[index].shape

    def layer_indices(self, section: CfgSection, key: str) -> tuple[int, ...]:
        """Indices of the layers under `key`; negative numbers are relative to the current layer."""
        current = len(self.layers)
        indices = tuple(index + current if index < 0 else index for index in section.integers(key))
        if not all(0 <= index < current for index in indices):
            raise section.error(
                f"expected layers before layer {current}, got "
                f"{quoted(f'{key}={section.options[key]}')}"
            )
        return tuple(self.source(section, index) for index in indices)


def _window(
    section: CfgSection, shape: Shape, *, size: int, padding: int, stride_yx: tuple[int, int]
) -> tuple[int, int]:
    """Rows and columns of the output of a sliding window; `padding` is the sum of both sides."""
    rows, columns = (
        (side + padding - size) // stride + 1
        for side, stride in zip(shape[1:], stride_yx, strict=True)
    )
    if rows < 1 or columns < 1:
        raise section.error(f"size={size} is larger than its input of {shape[2]}x{shape[1]} pixels")
    return rows, columns


def _stride_yx(section: CfgSection) -> tuple[int, int]:
    stride = section.integer("stride", 1, minimum=1)
    return section.integer("stride_y", stride, minimum=1), section.integer(
        "stride_x", stride, minimum=1
    )


def _convolution(section: CfgSection, trunk: _Trunk) -> Layer:
    section.require_defaults(_PLAIN_CONVOLUTION)
    source = trunk.before(section)
    shape = trunk.shape(source)
    size = section.integer("size", 1, minimum=1)
    pad = size // 2 if section.integer("pad", 0) else section.integer("padding", 0)
    operation = Convolution(
        n_filters=section.integer("filters", 1, minimum=1),
        n_channels=shape[0],
        size=size,
        stride_yx=_stride_yx(section),
        pad=pad,
        groups=section.integer("groups", 1, minimum=1),
        has_batch_norm=section.integer("batch_normalize", 0) > 0,
        activation=section.word("activation", "logistic", ACTIVATIONS),
    )
    if operation.n_channels % operation.groups or operation.n_filters % operation.groups:
        raise section.error(
            f"groups={operation.groups} does not divide {operation.n_channels} channels and "
            f"{operation.n_filters} filters"
        )
    rows, columns = _window(
        section, shape, size=size, padding=2 * pad, stride_yx=operation.stride_yx
    )
    return Layer(operation, (source,), (operation.n_filters, rows, columns))


def _max_pool(section: CfgSection, trunk: _Trunk) -> Layer:
    section.require_defaults({"maxpool_depth": 0, "antialiasing": 0})
    source = trunk.before(section)
    shape = trunk.shape(source)
    stride_yx = _stride_yx(section)
    size = section.integer("size", section.integer("stride", 1, minimum=1), minimum=1)
    padding = section.integer("padding", size - 1)
    if (padding + 1) // 2 >= size:
        raise section.error(
            f"padding={padding} is too large for size={size}: some windows are outside the input"
        )
    rows, columns = _window(section, shape, size=size, padding=padding, stride_yx=stride_yx)
    return Layer(MaxPool(size, stride_yx, padding), (source,), (shape[0], rows, columns))


def _upsample(section: CfgSection, trunk: _Trunk) -> Layer:
    section.require_defaults({"scale": 1})
    source = trunk.before(section)
    channels, rows, columns = trunk.shape(source)
    stride = section.integer("stride", 2, minimum=1)
    return Layer(Upsample(stride), (source,), (channels, rows * stride, columns * stride))


def _route(section: CfgSection, trunk: _Trunk) -> Layer:
    sources = trunk.layer_indices(section, "layers")
    shapes = [trunk.shape(source) for source in sources]
    groups, group_id = section.integer("groups", 1, minimum=1), section.integer("group_id", 0)
    if group_id >= groups or any(shape[0] % groups for shape in shapes):
        counts = shortened(", ".join(str(shape[0]) for shape in shapes))
        raise section.error(
            f"groups={groups}, group_id={group_id} is not a valid part of {counts} channels"
        )
    if len({shape[1:] for shape in shapes}) != 1:
        raise section.error(
            f"its layers differ in size: {_sizes(shapes)}; check width and height of [net]"
        )
    channels = sum(shape[0] // groups for shape in shapes)
    return Layer(Route(groups, group_id), sources, (channels, *shapes[0][1:]))


def _shortcut(section: CfgSection, trunk: _Trunk) -> Layer:
    section.word("weights_type", "none", ("none",))
    sources = (trunk.before(section), *trunk.layer_indices(section, "from"))
    shapes = [trunk.shape(source) for source in sources]
    if len(set(shapes)) != 1:
        raise section.error(f"its layers differ in shape: {_sizes(shapes)}")
    return Layer(Shortcut(section.word("activation", "linear", ACTIVATIONS)), sources, shapes[0])


def _yolo(section: CfgSection, trunk: _Trunk) -> Layer:
    section.require_defaults({"new_coords": 0})
    source = trunk.before(section)
    numbers = section.numbers("anchors")
    if len(numbers) % 2 or min(numbers) <= 0 or max(numbers) > _MAX_ANCHOR_PX:
        raise section.error(
            "expected anchors as pairs of a positive width and height up to "
            f"{_MAX_ANCHOR_PX} pixels"
        )
    anchors = tuple(zip(numbers[::2], numbers[1::2], strict=True))
    has_mask = "mask" in section.options
    n_anchors = section.integer("num", len(anchors) if has_mask else 1, minimum=1)
    if n_anchors != len(anchors):
        raise section.error(
            f"expected num={len(anchors)}, the number of anchors, got num={n_anchors}"
        )
    mask = section.integers("mask") if has_mask else tuple(range(n_anchors))
    if not all(0 <= index < len(anchors) for index in mask) or len(set(mask)) < len(mask):
        raise section.error(
            f"expected different mask indices below {len(anchors)}, got "
            f"{shortened(', '.join(map(str, mask)))}"
        )
    scale = section.numbers("scale_x_y", 1.0)[0]
    if not 1 <= scale <= 2:
        raise section.error(f"expected scale_x_y from 1 to 2, got {scale:g}")
    n_classes = section.integer("classes", 20, minimum=1)
    n_filters, shape = len(mask) * (5 + n_classes), trunk.shape(source)
    if (
        shape[0] != n_filters
        or source == IMAGE
        or not isinstance(trunk.layers[source].operation, Convolution)
    ):
        raise section.error(
            f"expected a [convolutional] layer with filters={n_filters} before it, for {len(mask)} "
            f"anchors x (5 + {n_classes} classes); got {shape[0]} channels"
        )
    return Layer(
        YoloHead(tuple(anchors[index] for index in mask), n_classes, scale), (source,), shape
    )


def _sizes(shapes: Sequence[Shape]) -> str:
    return shortened(
        " and ".join(f"{columns}x{rows}x{channels}" for channels, rows, columns in shapes)
    )


# Darknet's defaults; other values would change the weights file or the arithmetic
_PLAIN_CONVOLUTION = {
    **dict.fromkeys(
        "antialiasing assisted_excitation binary cbn coordconv deform dontload "
        "dontloadscales".split(),
        0,
    ),
    **dict.fromkeys("bin_output flipped rotate stretch stretch_sway sway xnor".split(), 0),
    "dilation": 1,
    "share_index": -1_000_000_000,
}
_READERS: Mapping[str, Callable[[CfgSection, _Trunk], Layer]] = {
    "convolutional": _convolution,
    "maxpool": _max_pool,
    "upsample": _upsample,
    "route": _route,
    "shortcut": _shortcut,
    "dropout": lambda section, trunk: Layer(
        Dropout(), (source := trunk.before(section),), trunk.shape(source)
    ),
    "yolo": _yolo,
}
