"""Families of YOLO networks: which one a file holds, told by the shapes of its outputs, and all that follows from it.

    outputs, for an input of h x w with n = sum of (h / s)(w / s) cells       family by default
    [1, 3 n, 5 + C]              strides 8, 16, 32 (or 8 .. 64)                 YOLOv5
    [1, 3 n, 5 + C]              strides 16, 32                                 YOLOv4-tiny, decoded
    [1, n, 5 + C]                strides 8, 16, 32                              YOLOX
    [1, 4 + C, n]                strides 8, 16, 32                              YOLOv8 / YOLO11
    [1, A (5 + C), h/s, w/s]     two of them                                    YOLOv4-tiny, raw heads
    [1, A (5 + C), h/s, w/s]     three of them                                  YOLOv4, raw heads
    [1, N, 1, 4] or [1, N, 4] with [1, N, C]                                    YOLOv4, decoded

The shapes decide how outputs are read; what else a family takes for granted can be told (`detection.model_facts`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from track_range.detection.classes import COCO_CLASSES, VOC_CLASSES
from track_range.detection.models.metadata import Anchors, Fact, Facts
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

KNOWN_LAYOUTS = (
    "YOLOv5 [1, 3 n, 5 + classes], YOLOX [1, n, 5 + classes], YOLOv8/YOLO11 [1, 4 + classes, n], "
    "raw Darknet heads [1, anchors x (5 + classes), rows, columns] (two or three), decoded YOLOv4 boxes [1, N, 1, 4] "
    "with scores [1, N, classes]; n = cells of strides 8, 16, 32 (export with the batch fixed to 1, NMS left out)"
)

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
        input_format: what the network wants to see.
        names: class names in the network's order.
        facts: what was assumed or told, for `models info`, by key.
    """

    family: str
    layout: str
    decoder: Decoder
    input_format: InputFormat
    names: tuple[str, ...]
    facts: Mapping[str, Fact]


@dataclass(frozen=True, slots=True)
class _Layout:
    """A recognised layout before anything is told of it; `anchors` is empty for a decoded one."""

    family: str
    text: str
    n_classes: int
    input_format: InputFormat
    decoder: Decoder | None = None
    heads: tuple[tuple[int, tuple[int, ...]], ...] = ()


def recognise(path: Path, input_hw: tuple[int, int], outputs: Mapping[str, tuple[int, ...]], facts: Facts) -> YoloModel:
    """The model that outputs of these shapes mean.

    Raises:
        ModelError: no known layout, or what is told of the model does not fit it.
    """
    shapes = list(outputs.values())
    layout = _corners(shapes, input_hw) or _decoded(shapes, input_hw) or _raw_heads(path, shapes, facts)
    if layout is None:
        found = ", ".join(f"{name} {list(shape)}" for name, shape in outputs.items())
        raise ModelError(f"{path}: unknown outputs {found}; known layouts: {KNOWN_LAYOUTS}.")
    used = {"family": facts.of("family", layout.family, "by its outputs")}
    used["names"] = _names(path, layout.n_classes, facts)
    input_format = _input_format(layout.input_format, layout.family, facts, used)
    decoder = layout.decoder or _head_decoder(path, layout, input_hw, facts, used)
    return YoloModel(
        family=str(used["family"].value),
        layout=layout.text,
        decoder=decoder,
        input_format=input_format,
        names=used["names"].value,
        facts=used,
    )


def _n_cells(input_hw: tuple[int, int], strides_px: Sequence[int]) -> int:
    return sum((input_hw[0] // stride) * (input_hw[1] // stride) for stride in strides_px)


def _decoded(shapes: Sequence[tuple[int, ...]], input_hw: tuple[int, int]) -> _Layout | None:
    """One output [1, boxes, columns], or [1, columns, boxes]; older YOLOv5 exports have the raw grids beside it."""
    for i, shape in enumerate(shapes):
        if len(shape) != 3 or shape[0] != 1:
            continue
        n_rows, n_columns = shape[1:]
        for strides, family in _ANCHOR_STRIDES_PX.items():
            if n_rows == _ANCHORS_PER_CELL * _n_cells(input_hw, strides) and n_columns > 5:
                text = f"decoded rows {list(shape)}: box, objectness, classes"
                style = _PLAIN if family == "YOLOv5" else _DARKNET_INPUT
                return _Layout(family, text, n_columns - 5, style, RowDecoder(i))
        n_cells = _n_cells(input_hw, _STRIDES_PX)
        if n_rows == n_cells and n_columns > 5:
            decoder = GridRowDecoder.for_input(i, input_hw, _STRIDES_PX)
            text = f"rows per cell {list(shape)}: box, objectness, classes"
            return _Layout("YOLOX", text, n_columns - 5, _YOLOX_INPUT, decoder)
        if n_columns == n_cells and n_rows > 4:
            text = f"decoded columns {list(shape)}: box, classes"
            return _Layout("YOLOv8/YOLO11", text, n_rows - 4, _PLAIN, ColumnDecoder(i))
    return None


def _corners(shapes: Sequence[tuple[int, ...]], input_hw: tuple[int, int]) -> _Layout | None:
    """Two outputs, boxes and scores."""
    if len(shapes) != 2:
        return None
    for boxes, scores in ((0, 1), (1, 0)):
        box, score = shapes[boxes], shapes[scores]
        if len(score) == 3 and box in ((1, score[1], 1, 4), (1, score[1], 4)) and score[0] == 1:
            text = f"decoded boxes {list(box)} and scores {list(score)}"
            decoder = CornerDecoder(boxes, scores, input_hw)
            tiny = score[1] == _ANCHORS_PER_CELL * _n_cells(input_hw, (16, 32))
            return _Layout("YOLOv4-tiny" if tiny else "YOLOv4", text, score[2], _DARKNET_INPUT, decoder)
    return None


def _raw_heads(path: Path, shapes: Sequence[tuple[int, ...]], facts: Facts) -> _Layout | None:
    """Two or three outputs [1, A (5 + C), rows, columns] of one number of channels."""
    if len(shapes) not in (2, 3) or any(len(shape) != 4 or shape[0] != 1 for shape in shapes):
        return None
    anchors = facts.of("anchors", None, "")
    if anchors.value:
        _check_anchors(path, anchors, len(shapes))
    n_anchors = len(anchors.value[0]) if anchors.value else _ANCHORS_PER_CELL
    channels = {shape[1] for shape in shapes}
    n_columns, rest = divmod(shapes[0][1], n_anchors)
    if len(channels) != 1 or rest or n_columns < 6:
        return None
    family = "YOLOv4-tiny" if len(shapes) == 2 else "YOLOv4"
    text = f"raw heads {', '.join(str(list(shape)) for shape in shapes)}: {n_anchors} anchors per cell"
    return _Layout(family, text, n_columns - 5, _DARKNET_INPUT, None, tuple(enumerate(shapes)))


def _check_anchors(path: Path, anchors: Fact, n_heads: int) -> None:
    if len(anchors.value) != n_heads or len({len(head) for head in anchors.value}) != 1:
        raise ModelError(
            f"{path}: {n_heads} output heads want as many groups of anchors, all of one size; got groups of "
            f"{', '.join(str(len(head)) for head in anchors.value)} ({anchors.source}); "
            "give --anchors 'w,h w,h w,h / w,h w,h w,h' in the order of the outputs."
        )


def _head_decoder(
    path: Path, layout: _Layout, input_hw: tuple[int, int], facts: Facts, used: dict[str, Fact]
) -> HeadDecoder:
    """The decoder of raw heads, with anchors told or the family's, which belong to heads by their strides."""
    defaults = YOLOV4_TINY_ANCHORS if len(layout.heads) == 2 else YOLOV4_ANCHORS
    default_scales = (1.0, 1.0) if len(layout.heads) == 2 else _YOLOV4_SCALES
    if len(layout.heads) == 2 and layout.heads[0][1][3] > layout.heads[1][1][3]:
        defaults = defaults[::-1]
    if len(layout.heads) == 3 and layout.heads[0][1][3] < layout.heads[2][1][3]:
        defaults, default_scales = defaults[::-1], default_scales[::-1]
    source = f"default of {layout.family}"
    used["anchors"] = facts.of("anchors", defaults, source)
    used["scale_x_y"] = facts.of("scale_x_y", default_scales, source)
    anchors, scales = used["anchors"].value, used["scale_x_y"].value
    scales = scales * len(layout.heads) if len(scales) == 1 else scales
    if len(scales) != len(layout.heads):
        raise ModelError(
            f"{path}: {len(layout.heads)} output heads want one scale_x_y each; got {list(scales)} "
            f"({used['scale_x_y'].source})."
        )
    heads = (
        Head(
            output,
            np.array(anchors[output], np.float64),
            np.array([input_hw[1] / shape[3], input_hw[0] / shape[2]]),
            scales[output],
        )
        for output, shape in layout.heads
    )
    return HeadDecoder(tuple(heads))


def _names(path: Path, n_classes: int, facts: Facts) -> Fact:
    said = facts.of("names", None, "")
    if said.value is None:
        if n_classes not in _DEFAULT_NAMES:
            raise ModelError(
                f"{path}: it has {n_classes} classes without names; give them with --names a,b,c or --names FILE."
            )
        list_name, names = _DEFAULT_NAMES[n_classes]
        return Fact(names, f"it has none; {n_classes} classes, so {list_name}'s {n_classes}")
    if len(said.value) != n_classes:
        raise ModelError(
            f"{path}: it has {n_classes} classes, but {len(said.value)} names ({said.source}); give all, in order."
        )
    return said


def _input_format(default: InputFormat, family: str, facts: Facts, used: dict[str, Fact]) -> InputFormat:
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
