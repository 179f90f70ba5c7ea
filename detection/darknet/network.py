"""From a Darknet cfg to layers: who reads whom, and with which shapes, or what is wrong with it.

Layers count from 0 with the section after [net]; `layers=-1` is the one before, `layers=8` the ninth of all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from track_range.detection.darknet.cfg import Section, read_sections
from track_range.detection.darknet.layers import (
    ACTIVATIONS,
    IMAGE,
    Convolution,
    Dropout,
    Layer,
    MaxPool,
    Network,
    Route,
    Shape,
    Shortcut,
    Upsample,
    YoloHead,
)


def read_network(path: Path) -> Network:
    """The network that the cfg at `path` describes.

    Raises:
        ModelError: no readable cfg, or it wants what cannot be imported.
    """
    net, *sections = read_sections(path, tuple(_READERS))
    n_channels, height, width = (net.whole(key, default, least=1) for key, default in _NET_SIZES.items())
    if n_channels != 3:
        raise net.error(f"channels={n_channels}; images have three")
    trunk = _Trunk((n_channels, height, width))
    for section in sections:
        trunk.layers.append(_READERS[section.kind](section, trunk))
    network = Network(
        trunk.image, net.whole("letter_box") if "letter_box" in net.options else None, tuple(trunk.layers)
    )
    _check_heads(net, [head for _, head in network.heads])
    return network


def _check_heads(net: Section, heads: Sequence[YoloHead]) -> None:
    if len(heads) not in (2, 3):
        raise net.error(f"the network has {len(heads)} sections [yolo]; two or three wanted, as in YOLOv3 and YOLOv4")
    if len({(len(head.anchors_px), head.n_classes) for head in heads}) != 1:
        raise net.error("all sections [yolo] must have the same number of classes and of anchors in their masks")


_NET_SIZES: Mapping[str, int | None] = {"channels": 3, "height": None, "width": None}


class _Trunk:
    """The layers so far."""

    def __init__(self, image: Shape) -> None:
        self.image = image
        self.layers: list[Layer] = []

    def before(self, section: Section) -> int:
        """Index of the layer before; what comes out of [yolo] are no features."""
        return self.source(section, len(self.layers) - 1)

    def source(self, section: Section, index: int) -> int:
        if index >= 0 and isinstance(self.layers[index].operation, YoloHead):
            raise section.error(f"it reads layer {index}, a [yolo], which only an output may do")
        return index

    def shape(self, index: int) -> Shape:
        return self.image if index == IMAGE else self.layers[index].shape

    def layer_indices(self, section: Section, key: str) -> tuple[int, ...]:
        """Layers that a section names: below zero counted back from itself, else from the first layer."""
        own = len(self.layers)
        indices = tuple(index + own if index < 0 else index for index in section.wholes(key))
        if not all(0 <= index < own for index in indices):
            raise section.error(f"'{key}={section.options[key]}' from layer {own} is no layer before it")
        return tuple(self.source(section, index) for index in indices)


def _window(section: Section, shape: Shape, *, size: int, padding: int, stride_yx: tuple[int, int]) -> tuple[int, int]:
    """Rows and columns that a sliding window leaves; `padding` counts both sides together."""
    rows, columns = ((side + padding - size) // stride + 1 for side, stride in zip(shape[1:], stride_yx, strict=True))
    if rows < 1 or columns < 1:
        raise section.error(f"size={size} is larger than the {shape[2]}x{shape[1]} pixels before it")
    return rows, columns


def _stride_yx(section: Section) -> tuple[int, int]:
    stride = section.whole("stride", 1, least=1)
    return section.whole("stride_y", stride, least=1), section.whole("stride_x", stride, least=1)


def _convolution(section: Section, trunk: _Trunk) -> Layer:
    section.refuse(_PLAIN_CONVOLUTION)
    source = trunk.before(section)
    shape = trunk.shape(source)
    size = section.whole("size", 1, least=1)
    pad = size // 2 if section.whole("pad", 0) else section.whole("padding", 0)
    operation = Convolution(
        n_filters=section.whole("filters", 1, least=1),
        n_channels=shape[0],
        size=size,
        stride_yx=_stride_yx(section),
        pad=pad,
        groups=section.whole("groups", 1, least=1),
        has_batch_norm=section.whole("batch_normalize", 0) > 0,
        activation=section.word("activation", "logistic", ACTIVATIONS),
    )
    if operation.n_channels % operation.groups or operation.n_filters % operation.groups:
        raise section.error(
            f"groups={operation.groups} does not divide {operation.n_channels} channels into {operation.n_filters}"
        )
    rows, columns = _window(section, shape, size=size, padding=2 * pad, stride_yx=operation.stride_yx)
    return Layer(operation, (source,), (operation.n_filters, rows, columns))


def _max_pool(section: Section, trunk: _Trunk) -> Layer:
    section.refuse({"maxpool_depth": 0, "antialiasing": 0})
    source = trunk.before(section)
    shape = trunk.shape(source)
    stride_yx = _stride_yx(section)
    size = section.whole("size", section.whole("stride", 1, least=1), least=1)
    padding = section.whole("padding", size - 1)
    if (padding + 1) // 2 >= size:
        raise section.error(f"padding={padding} leaves windows of size={size} wholly outside")
    rows, columns = _window(section, shape, size=size, padding=padding, stride_yx=stride_yx)
    return Layer(MaxPool(size, stride_yx, padding), (source,), (shape[0], rows, columns))


def _upsample(section: Section, trunk: _Trunk) -> Layer:
    section.refuse({"scale": 1})
    source = trunk.before(section)
    channels, rows, columns = trunk.shape(source)
    stride = section.whole("stride", 2, least=1)
    return Layer(Upsample(stride), (source,), (channels, rows * stride, columns * stride))


def _route(section: Section, trunk: _Trunk) -> Layer:
    sources = trunk.layer_indices(section, "layers")
    shapes = [trunk.shape(source) for source in sources]
    groups, group_id = section.whole("groups", 1, least=1), section.whole("group_id", 0)
    if group_id >= groups or any(shape[0] % groups for shape in shapes):
        counts = ", ".join(str(shape[0]) for shape in shapes)
        raise section.error(f"groups={groups}, group_id={group_id} is no share of {counts} channels")
    if len({shape[1:] for shape in shapes}) != 1:
        raise section.error(f"its layers differ in size: {_sizes(shapes)}; do width and height of [net] suit?")
    channels = sum(shape[0] // groups for shape in shapes)
    return Layer(Route(groups, group_id), sources, (channels, *shapes[0][1:]))


def _shortcut(section: Section, trunk: _Trunk) -> Layer:
    section.word("weights_type", "none", ("none",))
    sources = (trunk.before(section), *trunk.layer_indices(section, "from"))
    shapes = [trunk.shape(source) for source in sources]
    if len(set(shapes)) != 1:
        raise section.error(f"its layers differ in shape: {_sizes(shapes)}")
    return Layer(Shortcut(section.word("activation", "linear", ACTIVATIONS)), sources, shapes[0])


def _dropout(section: Section, trunk: _Trunk) -> Layer:
    source = trunk.before(section)
    return Layer(Dropout(), (source,), trunk.shape(source))


def _yolo(section: Section, trunk: _Trunk) -> Layer:
    section.refuse({"new_coords": 0})
    source = trunk.before(section)
    numbers = section.numbers("anchors")
    if len(numbers) % 2 or min(numbers) <= 0:
        raise section.error("anchors are pairs of a width and a height above zero")
    anchors = tuple(zip(numbers[::2], numbers[1::2], strict=True))
    mask = section.wholes("mask") if "mask" in section.options else tuple(range(section.whole("num", 1, least=1)))
    if not all(0 <= index < len(anchors) for index in mask):
        raise section.error(f"mask {', '.join(map(str, mask))} names anchors that are not there: it has {len(anchors)}")
    scale = section.numbers("scale_x_y", 1.0)[0]
    if not 1 <= scale <= 2:
        raise section.error(f"scale_x_y={scale:g} is not from 1 to 2")
    n_classes = section.whole("classes", 20, least=1)
    wanted, shape = len(mask) * (5 + n_classes), trunk.shape(source)
    if shape[0] != wanted or source == IMAGE or not isinstance(trunk.layers[source].operation, Convolution):
        raise section.error(
            f"the layer before it must be a [convolutional] with filters={wanted}: {len(mask)} anchors x "
            f"(5 + {n_classes} classes); it has {shape[0]} channels"
        )
    return Layer(YoloHead(tuple(anchors[index] for index in mask), n_classes, scale), (source,), shape)


def _sizes(shapes: Sequence[Shape]) -> str:
    return " and ".join(f"{columns}x{rows}x{channels}" for channels, rows, columns in shapes)


_PLAIN_CONVOLUTION = {
    **dict.fromkeys("antialiasing assisted_excitation binary cbn coordconv deform dontload dontloadscales".split(), 0),
    **dict.fromkeys("bin_output flipped rotate stretch stretch_sway sway xnor".split(), 0),
    "dilation": 1,
    "share_index": -1_000_000_000,
}
"""Darknet's defaults of options that would change the weights file or the arithmetic."""

_READERS: Mapping[str, Callable[[Section, _Trunk], Layer]] = {
    "convolutional": _convolution,
    "maxpool": _max_pool,
    "upsample": _upsample,
    "route": _route,
    "shortcut": _shortcut,
    "dropout": _dropout,
    "yolo": _yolo,
}
