"""Layouts of YOLO networks' outputs, and the family, decoder, input and class names that follow from them.

    outputs, for an input of h x w with n = sum of (h / s)(w / s) cells       family by default
    [1, 3 n, 5 + C]              strides 8, 16, 32 (or 8 .. 64)                 YOLOv5
    [1, 3 n, 5 + C]              strides 16, 32                                 YOLOv4-tiny, decoded
    [1, n, 5 + C]                strides 8, 16, 32                              YOLOX
    [1, 4 + C, n]                strides 8, 16, 32                              YOLOv8 / YOLO11
    [1, A (5 + C), h/s, w/s]     two of them                                    YOLOv4-tiny, raw heads
    [1, A (5 + C), h/s, w/s]     three of them                                  YOLOv4, raw heads
    [1, N, 1, 4] or [1, N, 4] with [1, N, C]                                    YOLOv4, decoded

The shapes decide how outputs are decoded; the family's other defaults can be overridden (`detection.models.metadata`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from track_range.detection.classes import COCO_CLASSES, VOC_CLASSES
from track_range.detection.models.metadata import Anchors, Attribute, ModelMetadata
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.yolo.decoders import (
    ColumnDecoder,
    CornerDecoder,
    Decoder,
    GridRowDecoder,
    Head,
    HeadDecoder,
    RowDecoder,
)
from track_range.detection.yolo.input_format import InputFormat, placement_and_grey

_EXPORT_HINT = "n = cells of strides 8, 16, 32 (export with the batch fixed to 1, NMS left out)"

_STRIDES_PX = (8, 16, 32)
_ANCHOR_STRIDES_PX = {(8, 16, 32): "YOLOv5", (8, 16, 32, 64): "YOLOv5", (16, 32): "YOLOv4-tiny"}
_ANCHORS_PER_CELL = 3
_DEFAULT_NAMES = {80: ("COCO", COCO_CLASSES), 20: ("VOC", VOC_CLASSES)}

YOLOV4_TINY_ANCHORS: Anchors = (((81, 82), (135, 169), (344, 319)), ((23, 27), (37, 58), (81, 82)))
"""Strides 32, 16: masks 3,4,5 and 1,2,3 of 10,14 23,27 37,58 81,82 135,169 344,319 (AlexeyAB's yolov4-tiny.cfg)."""

YOLOV4_ANCHORS: Anchors = (
    ((12, 16), (19, 36), (40, 28)),
    ((36, 75), (76, 55), (72, 146)),
    ((142, 110), (192, 243), (459, 401)),
)
"""Strides 8, 16, 32, each with its scale_x_y of `_YOLOV4_SCALES` (AlexeyAB's yolov4.cfg)."""

_YOLOV4_SCALES = (1.2, 1.1, 1.05)
_PLAIN = InputFormat()
_DARKNET_INPUT = InputFormat(pad_grey=128)
_YOLOX_INPUT = InputFormat(placement="top-left", colours="bgr", divisor=1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class YoloModel:
    """A network as it is to be used.

    Attributes:
        family: the name for people.
        layout: its outputs, in words.
        decoder: reads them.
        input_format: how an image becomes the network's input.
        names: class names in the network's order.
        facts: explicit and default attributes, for `models info`, by key.
    """

    family: str
    layout: str
    decoder: Decoder
    input_format: InputFormat
    names: tuple[str, ...]
    facts: Mapping[str, Attribute]


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchedLayout:
    """What a layout means for one network.

    Attributes:
        family: the family of networks that the layout belongs to, by default.
        text: the outputs, in words.
        n_classes: number of the network's classes.
        input_format: the family's default input.
        decoder: reads the outputs.
        attributes: further attributes that the decoder was made from, by key, for `models info`.
    """

    family: str
    text: str
    n_classes: int
    input_format: InputFormat
    decoder: Decoder
    attributes: Mapping[str, Attribute] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class NetworkOutputs:
    """What a layout is recognised from.

    Attributes:
        path: the model's file, for messages.
        input_hw: (height, width) of the network's input.
        shapes: shape of each output, in the network's order.
        facts: explicit attributes of the model, such as its anchors.
    """

    path: Path
    input_hw: tuple[int, int]
    shapes: tuple[tuple[int, ...], ...]
    facts: ModelMetadata

    def n_cells(self, strides_px: Sequence[int]) -> int:
        """Number of grid cells of the input at these strides, together."""
        return sum((self.input_hw[0] // stride) * (self.input_hw[1] // stride) for stride in strides_px)

    def rows(self) -> Iterator[tuple[int, int, int]]:
        """Number, second and third side of each output [1, ., .]; older YOLOv5 exports have raw grids beside it."""
        for i, shape in enumerate(self.shapes):
            if len(shape) == 3 and shape[0] == 1:
                yield i, shape[1], shape[2]


@dataclass(frozen=True, slots=True)
class DetectorLayout:
    """One layout of a detector's outputs.

    Attributes:
        name: the layout, for messages that list the known ones.
        match: what the layout means for a network with these outputs; None = the outputs are of another layout.
    """

    name: str
    match: Callable[[NetworkOutputs], MatchedLayout | None]


def identify_layout(
    path: Path, input_hw: tuple[int, int], outputs: Mapping[str, tuple[int, ...]], facts: ModelMetadata
) -> YoloModel:
    """The model that outputs of these shapes mean.

    Raises:
        ModelError: no known layout, or explicit attributes of the model do not fit it.
    """
    network = NetworkOutputs(path, input_hw, tuple(outputs.values()), facts)
    matches = (layout.match(network) for layout in DETECTOR_LAYOUTS)
    matched = next((match for match in matches if match is not None), None)
    if matched is None:
        found = ", ".join(f"{name} {list(shape)}" for name, shape in outputs.items())
        known = ", ".join(layout.name for layout in DETECTOR_LAYOUTS)
        raise ModelError(f"{path}: unknown outputs {found}; known layouts: {known}; {_EXPORT_HINT}.")
    used = {"family": facts.of("family", matched.family, "by its outputs")}
    used["names"] = _names(path, matched.n_classes, facts)
    input_format = _input_format(matched.input_format, matched.family, facts, used)
    return YoloModel(
        family=str(used["family"].value),
        layout=matched.text,
        decoder=matched.decoder,
        input_format=input_format,
        names=used["names"].value,
        facts={**used, **matched.attributes},
    )


def _boxes_and_scores(network: NetworkOutputs) -> MatchedLayout | None:
    """Two outputs, boxes [1, N, 1, 4] or [1, N, 4] and scores [1, N, C], in any order."""
    if len(network.shapes) != 2:
        return None
    for boxes, scores in ((0, 1), (1, 0)):
        box, score = network.shapes[boxes], network.shapes[scores]
        if len(score) == 3 and box in ((1, score[1], 1, 4), (1, score[1], 4)) and score[0] == 1:
            is_tiny = score[1] == _ANCHORS_PER_CELL * network.n_cells((16, 32))
            return MatchedLayout(
                family="YOLOv4-tiny" if is_tiny else "YOLOv4",
                text=f"decoded boxes {list(box)} and scores {list(score)}",
                n_classes=score[2],
                input_format=_DARKNET_INPUT,
                decoder=CornerDecoder(boxes, scores, network.input_hw),
            )
    return None


def _anchor_rows(network: NetworkOutputs) -> MatchedLayout | None:
    """[1, 3 n, 5 + C]: three decoded boxes per cell."""
    for i, n_rows, n_columns in network.rows():
        for strides, family in _ANCHOR_STRIDES_PX.items():
            if n_rows == _ANCHORS_PER_CELL * network.n_cells(strides) and n_columns > 5:
                return MatchedLayout(
                    family=family,
                    text=f"decoded rows {[1, n_rows, n_columns]}: box, objectness, classes",
                    n_classes=n_columns - 5,
                    input_format=_PLAIN if family == "YOLOv5" else _DARKNET_INPUT,
                    decoder=RowDecoder(i),
                )
    return None


def _cell_rows(network: NetworkOutputs) -> MatchedLayout | None:
    """[1, n, 5 + C]: one box per cell, relative to the cell."""
    for i, n_rows, n_columns in network.rows():
        if n_rows == network.n_cells(_STRIDES_PX) and n_columns > 5:
            return MatchedLayout(
                family="YOLOX",
                text=f"rows per cell {[1, n_rows, n_columns]}: box, objectness, classes",
                n_classes=n_columns - 5,
                input_format=_YOLOX_INPUT,
                decoder=GridRowDecoder.for_input(i, network.input_hw, _STRIDES_PX),
            )
    return None


def _cell_columns(network: NetworkOutputs) -> MatchedLayout | None:
    """[1, 4 + C, n]: one decoded box per cell, without objectness."""
    for i, n_rows, n_columns in network.rows():
        if n_columns == network.n_cells(_STRIDES_PX) and n_rows > 4:
            return MatchedLayout(
                family="YOLOv8/YOLO11",
                text=f"decoded columns {[1, n_rows, n_columns]}: box, classes",
                n_classes=n_rows - 4,
                input_format=_PLAIN,
                decoder=ColumnDecoder(i),
            )
    return None


def _raw_heads(network: NetworkOutputs) -> MatchedLayout | None:
    """Two or three outputs [1, A (5 + C), rows, columns] of one number of channels."""
    shapes, facts = network.shapes, network.facts
    if len(shapes) not in (2, 3) or any(len(shape) != 4 or shape[0] != 1 for shape in shapes):
        return None
    anchors = facts.of("anchors", None, "")
    if anchors.value:
        _check_anchors(network.path, anchors, len(shapes))
    n_anchors = len(anchors.value[0]) if anchors.value else _ANCHORS_PER_CELL
    n_columns, rest = divmod(shapes[0][1], n_anchors)
    if len({shape[1] for shape in shapes}) != 1 or rest or n_columns < 6:
        return None
    is_tiny = len(shapes) == 2
    family = "YOLOv4-tiny" if is_tiny else "YOLOv4"
    default_anchors = YOLOV4_TINY_ANCHORS if is_tiny else YOLOV4_ANCHORS
    default_scales = (1.0, 1.0) if is_tiny else _YOLOV4_SCALES
    first_width, last_width = shapes[0][3], shapes[-1][3]
    if first_width > last_width if is_tiny else first_width < last_width:  # the defaults are in the other order
        default_anchors, default_scales = default_anchors[::-1], default_scales[::-1]
    used = {
        "anchors": facts.of("anchors", default_anchors, f"default of {family}"),
        "scale_x_y": facts.of("scale_x_y", default_scales, f"default of {family}"),
    }
    scales = used["scale_x_y"].value
    if len(scales) not in (1, len(shapes)):
        raise ModelError(
            f"{network.path}: expected one scale_x_y for each of {len(shapes)} output heads, got {list(scales)} "
            f"({used['scale_x_y'].source})."
        )
    height, width = network.input_hw
    heads = tuple(
        Head(i, np.array(anchor, np.float64), np.array([width / shape[3], height / shape[2]]), scale)
        for i, (shape, anchor, scale) in enumerate(
            zip(shapes, used["anchors"].value, scales * len(shapes) if len(scales) == 1 else scales, strict=True)
        )
    )
    return MatchedLayout(
        family=family,
        text=f"raw heads {', '.join(str(list(shape)) for shape in shapes)}: {n_anchors} anchors per cell",
        n_classes=n_columns - 5,
        input_format=_DARKNET_INPUT,
        decoder=HeadDecoder(heads),
        attributes=used,
    )


def _check_anchors(path: Path, anchors: Attribute, n_heads: int) -> None:
    if len(anchors.value) != n_heads or len({len(head) for head in anchors.value}) != 1:
        raise ModelError(
            f"{path}: expected a group of anchors for each of {n_heads} output heads, all of one size; got groups of "
            f"{', '.join(str(len(head)) for head in anchors.value)} ({anchors.source}); "
            "give --anchors 'w,h w,h w,h / w,h w,h w,h' in the order of the outputs."
        )


def _names(path: Path, n_classes: int, facts: ModelMetadata) -> Attribute:
    said = facts.of("names", None, "")
    if said.value is None:
        if n_classes not in _DEFAULT_NAMES:
            raise ModelError(
                f"{path}: it has {n_classes} classes without names; give them with --names a,b,c or --names FILE."
            )
        list_name, names = _DEFAULT_NAMES[n_classes]
        return Attribute(names, f"it has none; {n_classes} classes, so {list_name}'s {n_classes}")
    if len(said.value) != n_classes:
        raise ModelError(
            f"{path}: it has {n_classes} classes, but {len(said.value)} names ({said.source}); give all, in order."
        )
    return said


def _input_format(default: InputFormat, family: str, facts: ModelMetadata, used: dict[str, Attribute]) -> InputFormat:
    source = f"default of {family}"
    used["letterbox"] = facts.of("letterbox", default.letterbox, source)
    used["colours"] = facts.of("colours", default.colours, source)
    used["divisor"] = facts.of("divisor", default.divisor, source)
    placement, pad_grey = placement_and_grey(used["letterbox"].value)
    return replace(
        default,
        placement=placement,
        pad_grey=pad_grey,
        colours=used["colours"].value,
        divisor=used["divisor"].value,
    )


DETECTOR_LAYOUTS: tuple[DetectorLayout, ...] = (
    DetectorLayout("decoded YOLOv4 boxes [1, N, 1, 4] with scores [1, N, classes]", _boxes_and_scores),
    DetectorLayout("YOLOv5 [1, 3 n, 5 + classes]", _anchor_rows),
    DetectorLayout("YOLOX [1, n, 5 + classes]", _cell_rows),
    DetectorLayout("YOLOv8/YOLO11 [1, 4 + classes, n]", _cell_columns),
    DetectorLayout("raw Darknet heads [1, anchors x (5 + classes), rows, columns] (two or three)", _raw_heads),
)
"""The known layouts, in the order in which they are tried; n = cells of strides 8, 16, 32. A new one is a row here."""
