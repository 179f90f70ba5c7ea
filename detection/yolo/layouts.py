"""Output layouts of detectors, and the family, decoder, input format and class names that follow from them.

    outputs, for an input of h x w with n = sum of (h / s)(w / s) cells       default family
    [1, 3 n, 5 + C]              strides 8, 16, 32 (or 8 .. 64)                 YOLOv5
    [1, 3 n, 5 + C]              strides 16, 32                                 YOLOv4-tiny, decoded
    [1, n, 5 + C]                strides 8, 16, 32                              YOLOX
    [1, 4 + C, n]                strides 8, 16, 32                              YOLOv8 / YOLO11
    [1, A (5 + C), h/s, w/s]     two of them                                    YOLOv4-tiny, raw heads
    [1, A (5 + C), h/s, w/s]     three of them                                  YOLOv4, raw heads
    [1, N, 1, 4] or [1, N, 4] with [1, N, C]                                    YOLOv4, decoded

s = stride, A = anchors per cell, C = classes. `end_to_end` and `distribution` have the layouts of the networks without
non-maximum suppression and of NanoDet and PicoDet. The shapes determine the decoder; the family's other defaults can be
overridden (`detection.models.metadata`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from track_range.detection.box_errors import COCO_BOX_ERRORS
from track_range.detection.classes import COCO_CATEGORIES, COCO_CLASSES, VOC_CLASSES
from track_range.detection.models.metadata import Anchors, Attribute, ModelMetadata
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.yolo import decoders, end_to_end
from track_range.detection.yolo.distribution import score_and_bin_rows, scores_and_bins
from track_range.detection.yolo.input_format import InputFormat, placement_and_grey
from track_range.detection.yolo.network_outputs import NetworkOutputs, YoloModel
from track_range.foundation.files.input_files import shortened

_EXPORT_HINT = "export with batch size 1 and without postprocessing (docs/detectors.md)"
_SUPPRESSED_HINT = "they are the result of a suppression that returns any number of boxes: export without it"
"""Advice on outputs [N, 6] and [N, 7], as of PaddleDetection and of YOLOv7's `--end2end`."""

_STRIDES_PX = (8, 16, 32)  # of the grids of YOLOX, YOLOv8 and YOLO11
_ANCHOR_STRIDES_PX = {(8, 16, 32): "YOLOv5", (8, 16, 32, 64): "YOLOv5", (16, 32): "YOLOv4-tiny"}  # by strides of grids
_ANCHORS_PER_CELL = 3  # of YOLOv3, v4 and v5

_DEFAULT_NAMES = {80: ("COCO", COCO_CLASSES), 20: ("VOC", VOC_CLASSES), 91: ("COCO", COCO_CATEGORIES)}
"""Class list by number of classes, for networks without class names."""

YOLOV4_TINY_ANCHORS: Anchors = (((81, 82), (135, 169), (344, 319)), ((23, 27), (37, 58), (81, 82)))
"""Anchors in input pixels at strides 32 and 16: masks 3,4,5 and 1,2,3 of AlexeyAB's yolov4-tiny.cfg."""

YOLOV4_ANCHORS: Anchors = (  # anchors in input pixels at strides 8, 16 and 32 (AlexeyAB's yolov4.cfg)
    ((12, 16), (19, 36), (40, 28)),
    ((36, 75), (76, 55), (72, 146)),
    ((142, 110), (192, 243), (459, 401)),
)
_YOLOV4_SCALES = (1.2, 1.1, 1.05)  # scale_x_y at strides 8, 16 and 32 (AlexeyAB's yolov4.cfg)

_PLAIN_INPUT = InputFormat()
_DARKNET_INPUT = InputFormat(pad_grey=128)
_YOLOX_INPUT = InputFormat(placement="top-left", colours="bgr", divisor=1.0)


def identify_layout(network: NetworkOutputs) -> YoloModel:
    """The model with these outputs; ModelError if the layout is unknown, or the model's attributes do not fit it."""
    path, metadata = network.path, network.metadata
    matches = (match(network) for _, match in DETECTOR_LAYOUTS)
    matched = next((match for match in matches if match is not None), None)
    if matched is None:
        shapes = ", ".join(f"{name} {list(shape)}" for name, shape in zip(network.names, network.shapes, strict=True))
        known = ", ".join(dict.fromkeys(name for name, _ in DETECTOR_LAYOUTS))
        is_suppressed = any(len(shape) == 2 and shape[1] in (6, 7) for shape in network.shapes)
        hint = _SUPPRESSED_HINT if is_suppressed else _EXPORT_HINT
        raise ModelError(f"{path}: unknown outputs {shortened(shapes, 80)}; expected those of {known}; {hint}.")
    family = metadata.get("family", matched.family, "from its outputs")
    used = {"family": family, "names": _names(path, matched.n_classes, metadata)}
    for key in ("letterbox", "colours", "divisor", "mean", "std"):
        used[key] = metadata.get(key, getattr(matched.input_format, key), f"default of {matched.family}")
    usual = COCO_BOX_ERRORS.get(matched.family) if used["names"].value == COCO_CLASSES else None
    source = "those of an unknown detector" if usual is None else f"usual for {matched.family} trained with COCO"
    used["box_errors"] = metadata.get("box_errors", usual, source)
    placement, pad_grey = placement_and_grey(used["letterbox"].value)
    scale = {key: used[key].value for key in ("colours", "divisor", "mean", "std")}
    return replace(
        matched,
        family=str(family.value),
        names=used["names"].value,
        input_format=replace(matched.input_format, placement=placement, pad_grey=pad_grey, **scale),
        attributes={**used, **matched.attributes},
    )


def _boxes_and_scores(network: NetworkOutputs) -> YoloModel | None:
    """Match of two outputs in any order: boxes [1, N, 1, 4] or [1, N, 4], and scores [1, N, C]."""
    if len(network.shapes) != 2:
        return None
    for boxes, scores in ((0, 1), (1, 0)):
        box, score = network.shapes[boxes], network.shapes[scores]
        if len(score) == 3 and box in ((1, score[1], 1, 4), (1, score[1], 4)) and score[0] == 1:
            is_tiny = score[1] == _ANCHORS_PER_CELL * network.n_cells((16, 32))
            layout = f"decoded boxes {list(box)} and scores {list(score)}"
            decoder = partial(decoders.decode_corners, boxes, scores, network.input_hw)
            return YoloModel("YOLOv4-tiny" if is_tiny else "YOLOv4", layout, score[2], _DARKNET_INPUT, decoder)
    return None


def _anchor_rows(network: NetworkOutputs) -> YoloModel | None:
    """Match of [1, 3 n, 5 + C]: three decoded boxes per cell."""
    for i, n_rows, n_columns in network.matrices():
        for strides, family in _ANCHOR_STRIDES_PX.items():
            if n_rows == _ANCHORS_PER_CELL * network.n_cells(strides) and n_columns > 5:
                layout = f"decoded rows {[1, n_rows, n_columns]}: box, objectness, classes"
                input_format = _PLAIN_INPUT if family == "YOLOv5" else _DARKNET_INPUT
                return YoloModel(family, layout, n_columns - 5, input_format, partial(decoders.decode_rows, i))
    return None


def _cell_rows(network: NetworkOutputs) -> YoloModel | None:
    """Match of [1, n, 5 + C]: one box per cell, relative to the cell."""
    for i, n_rows, n_columns in network.matrices():
        if n_rows == network.n_cells(_STRIDES_PX) and n_columns > 5:
            layout = f"rows per cell {[1, n_rows, n_columns]}: box, objectness, classes"
            decoder = partial(decoders.decode_grid_rows, i, *decoders.grid_cells(network.input_hw, _STRIDES_PX))
            return YoloModel("YOLOX", layout, n_columns - 5, _YOLOX_INPUT, decoder)
    return None


def _cell_columns(network: NetworkOutputs) -> YoloModel | None:
    """Match of [1, 4 + C, n]: one decoded box per cell, without objectness."""
    for i, n_rows, n_columns in network.matrices():
        if n_columns == network.n_cells(_STRIDES_PX) and n_rows > 4:
            layout = f"decoded columns {[1, n_rows, n_columns]}: box, classes"
            return YoloModel("YOLOv8/YOLO11", layout, n_rows - 4, _PLAIN_INPUT, partial(decoders.decode_columns, i))
    return None


def _raw_heads(network: NetworkOutputs) -> YoloModel | None:
    """Match of two or three outputs [1, A (5 + C), rows, columns] with the same number of channels."""
    shapes, metadata = network.shapes, network.metadata
    if len(shapes) not in (2, 3) or any(len(shape) != 4 or shape[0] != 1 for shape in shapes):
        return None
    anchors = metadata.get("anchors", None, "")
    if anchors.value and (len(anchors.value) != len(shapes) or len({len(head) for head in anchors.value}) != 1):
        raise ModelError(
            f"{network.path}: expected the same number of anchors for each of {len(shapes)} output heads, got "
            f"{shortened(', '.join(str(len(head)) for head in anchors.value))} ({anchors.source}); "
            "give --anchors 'w,h w,h w,h / w,h w,h w,h' in the order of the outputs."
        )
    n_anchors = len(anchors.value[0]) if anchors.value else _ANCHORS_PER_CELL
    n_columns, rest = divmod(shapes[0][1], n_anchors)
    if len({shape[1] for shape in shapes}) != 1 or rest or n_columns < 6:
        return None
    is_tiny = len(shapes) == 2
    family = "YOLOv4-tiny" if is_tiny else "YOLOv4"
    default_anchors = YOLOV4_TINY_ANCHORS if is_tiny else YOLOV4_ANCHORS
    default_scales = (1.0, 1.0) if is_tiny else _YOLOV4_SCALES
    first_width, last_width = shapes[0][3], shapes[-1][3]
    if first_width > last_width if is_tiny else first_width < last_width:  # opposite order of the defaults
        default_anchors, default_scales = default_anchors[::-1], default_scales[::-1]
    used = {
        "anchors": metadata.get("anchors", default_anchors, f"default of {family}"),
        "scale_x_y": metadata.get("scale_x_y", default_scales, f"default of {family}"),
    }
    scales = used["scale_x_y"].value
    if len(scales) not in (1, len(shapes)):
        raise ModelError(
            f"{network.path}: expected one scale_x_y for each of {len(shapes)} output heads, got "
            f"{shortened(str(list(scales)))} ({used['scale_x_y'].source})."
        )
    height, width = network.input_hw
    scales = scales * len(shapes) if len(scales) == 1 else scales
    heads = [
        decoders.Head(np.array(anchor, np.float64), np.array([width / shape[3], height / shape[2]]), scale)
        for shape, anchor, scale in zip(shapes, used["anchors"].value, scales, strict=True)
    ]
    layout = f"raw heads {', '.join(str(list(shape)) for shape in shapes)}: {n_anchors} anchors per cell"
    return YoloModel(
        family, layout, n_columns - 5, _DARKNET_INPUT, partial(decoders.decode_heads, heads), attributes=used
    )


def _names(path: Path, n_classes: int | None, metadata: ModelMetadata) -> Attribute:
    """The network's class names: explicit, or the names of COCO or VOC if the number of classes matches."""
    explicit = metadata.get("names", None, "")
    if n_classes is None:
        return metadata.get(
            "names", COCO_CLASSES, "not in the model; COCO's, although the outputs do not show how many"
        )
    if explicit.value is None:
        if n_classes not in _DEFAULT_NAMES:
            raise ModelError(
                f"{path}: {n_classes} classes without names; specify them with --names a,b,c or --names FILE."
            )
        list_name, names = _DEFAULT_NAMES[n_classes]
        return Attribute(names, f"not in the model; {list_name}'s, because it has {n_classes} classes")
    if len(explicit.value) != n_classes:
        raise ModelError(
            f"{path}: expected {n_classes} class names, got {len(explicit.value)} ({explicit.source}); "
            "specify all names in the network's order."
        )
    return explicit


DETECTOR_LAYOUTS: tuple[tuple[str, Callable[[NetworkOutputs], YoloModel | None]], ...] = (
    ("RF-DETR", end_to_end.logits_and_boxes),
    ("D-FINE/DEIM", end_to_end.labels_boxes_scores),
    ("YOLOv4", _boxes_and_scores),
    ("YOLOv5", _anchor_rows),
    ("NanoDet", score_and_bin_rows),
    ("NanoDet", scores_and_bins),
    ("YOLOX", _cell_rows),
    ("YOLOv8", _cell_columns),
    ("RT-DETR", end_to_end.labelled_query_rows),
    ("YOLOv10", end_to_end.labelled_rows),
    ("RT-DETR", end_to_end.query_rows),
    ("Darknet", _raw_heads),
)
"""The known layouts, in the order in which they are tried: a name for messages, and the function that matches it."""
