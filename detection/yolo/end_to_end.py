"""Layouts of networks that return one box per object, without non-maximum suppression.

    outputs (N at most 1000)                           family
    [1, N, 6] left, top, right, bottom, score, label   YOLOv10, YOLO26; other YOLO networks exported with suppression
    labels [1, N], boxes [1, N, 4], scores [1, N]      RT-DETR, D-FINE, DEIM, DEIMv2, with the input orig_target_sizes
    logits [1, N, K], boxes [1, N, 4]                  RF-DETR; DETR, RT-DETR, D-FINE from Hugging Face's exporter
    [1, N, 6] box, score, label                        RT-DETR from Ultralytics' exporter, by its metadata
    [1, N, 4 + C] box, class scores                    RT-DETR from older versions of it

The outputs are recognised by shape and type, since RF-DETR calls its logits `labels`; names decide only if two shapes
are the same. (Carion et al., "End-to-End Object Detection with Transformers", 2020; Wang et al., "YOLOv10", 2024; Peng
et al., "D-FINE", 2024; Robinson et al., "RF-DETR", 2025.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.special import softmax

from track_range.detection.boxes import xyxy_from_cxcywh
from track_range.detection.models.metadata import RT_DETR_DESCRIPTION
from track_range.detection.models.onnx_session import TARGET_SIZES, ModelError
from track_range.detection.yolo.decoders import Candidates, Decoder, sigmoid
from track_range.detection.yolo.input_format import IMAGENET_MEAN, IMAGENET_STD, InputFormat
from track_range.detection.yolo.network_outputs import NetworkOutputs, YoloModel
from track_range.foundation.arrays import FloatArray, FloatArray32

_MAX_BOXES = 1000  # largest number of boxes of end-to-end networks (100 to 900 in the papers); grids have more
_N_CATEGORIES = 91  # logits of networks trained on COCO's category ids 0 to 90
_RT_DETR_HEAD = "RTDETRDecoder"  # class of RT-DETR's head in the metadata that Ultralytics' exporter writes

_STRETCHED_INPUT = InputFormat(placement="stretch")
_IMAGENET_INPUT = replace(_STRETCHED_INPUT, mean=IMAGENET_MEAN, std=IMAGENET_STD)


def _decode_labelled_rows(
    output: int, fractions_of_hw: tuple[int, int] | None, outputs: Sequence[FloatArray32], min_score: FloatArray
) -> Candidates:
    """Candidates of one output [1, N, 6]: box, score, label.

    Boxes are left, top, right, bottom in input pixels, or centre x, y, width, height as fractions of an input size.
    """
    rows = outputs[output][0].astype(np.float64)
    rows = rows[~(rows[:, 4] < min_score.min())]
    boxes = rows[:, :4] if fractions_of_hw is None else _boxes_of_fractions(rows[:, :4], fractions_of_hw)
    return Candidates.of_labels(boxes, rows[:, 4], rows[:, 5], min_score)


def _decode_labelled_boxes(
    labels: int, boxes: int, scores: int, outputs: Sequence[FloatArray32], min_score: FloatArray
) -> Candidates:
    """Candidates of labels [1, N], boxes [1, N, 4] (left, top, right, bottom in input pixels) and scores [1, N].

    The network scales its boxes to `orig_target_sizes`, which is the size of its input here.
    """
    label, xyxy, score = (outputs[i][0].astype(np.float64) for i in (labels, boxes, scores))
    kept = ~(score < min_score.min())
    return Candidates.of_labels(xyxy[kept], score[kept], label[kept], min_score)


def _decode_queries(
    logits_output: int,
    boxes_output: int,
    input_hw: tuple[int, int],
    n_classes: int,
    is_softmax: bool,
    outputs: Sequence[FloatArray32],
    min_score: FloatArray,
) -> Candidates:
    """Candidates of logits [1, N, K] and boxes [1, N, 4]: centre x, y, width, height as fractions of the input size.

        score = sigmoid(logit_c)                          networks trained with focal loss
        score = exp(logit_c) / sum over K of exp(logit)   DETR, whose last logit means "no object"

    Each query gives its best class; RF-DETR's and RT-DETR's own postprocessing also returns further classes of the same
    box with lower scores. Logits after the first `n_classes` mean "no object".
    """
    logits = outputs[logits_output][0].astype(np.float64)
    scores = (softmax(logits, axis=-1) if is_softmax else sigmoid(logits))[:, :n_classes]
    kept = np.flatnonzero(~(scores.max(axis=1) < min_score.min()))
    boxes = _boxes_of_fractions(outputs[boxes_output][0][kept], input_hw)
    return Candidates.of(boxes, scores[kept].astype(np.float32), min_score)


def _decode_query_rows(
    output: int, input_hw: tuple[int, int], outputs: Sequence[FloatArray32], min_score: FloatArray
) -> Candidates:
    """Candidates of one output [1, N, 4 + C]: box as fractions of the input size, class scores."""
    rows = outputs[output][0]
    rows = rows[~(rows[:, 4:].max(axis=1) < min_score.min())]
    return Candidates.of(_boxes_of_fractions(rows[:, :4], input_hw), rows[:, 4:], min_score)


def _boxes_of_fractions(cxcywh: FloatArray | FloatArray32, input_hw: tuple[int, int]) -> FloatArray:
    """(N, 4) corners in input pixels of boxes (N, 4) given as centre and size in fractions of the input size."""
    height, width = input_hw
    return xyxy_from_cxcywh(cxcywh.astype(np.float64)) * np.array([width, height, width, height], np.float64)


def labelled_rows(network: NetworkOutputs) -> YoloModel | None:
    """Match of [1, N, 6], left, top, right, bottom, score, label: few rows, or marked `end2end` in the metadata."""
    is_marked = network.metadata.get("end2end", False, "").value
    if network.metadata.get("head", None, "").value == RT_DETR_DESCRIPTION:
        return None
    for i, n_rows, n_columns in network.matrices():
        if n_columns == 6 and (n_rows <= _MAX_BOXES or is_marked):
            layout = f"end-to-end rows {[1, n_rows, n_columns]}: corners, score, label"
            decoder = partial(_decode_labelled_rows, i, None)
            return YoloModel("YOLOv10/YOLO26", layout, None, InputFormat(), decoder, is_end_to_end=True)
    return None


def labelled_query_rows(network: NetworkOutputs) -> YoloModel | None:
    """Match of [1, N, 6], box as fractions, score, label: as `labelled_rows`, with RT-DETR's head in the metadata.

    Older versions of Ultralytics return [1, N, 4 + C] (`query_rows`), which is the same shape for two classes; their
    metadata have no `head`.
    """
    head = network.metadata.get("head", None, "").value
    if head != _RT_DETR_HEAD and (head != RT_DETR_DESCRIPTION or network.n_names == 2):
        return None
    for i, n_rows, n_columns in network.matrices():
        if n_columns == 6 and n_rows <= _MAX_BOXES:
            layout = f"rows {[1, n_rows, n_columns]}: box as fractions, score, label"
            return _square_model("RT-DETR", layout, None, partial(_decode_labelled_rows, i, network.input_hw))
    return None


def _square_model(family: str, layout: str, n_classes: int | None, decoder: Decoder) -> YoloModel:
    return YoloModel(family, layout, n_classes, _STRETCHED_INPUT, decoder, is_end_to_end=True, is_square=True)


def labels_boxes_scores(network: NetworkOutputs) -> YoloModel | None:
    """Match of integer labels [1, N], boxes [1, N, 4] and scores [1, N], in any order.

    ModelError: the network lacks the input `orig_target_sizes`, so that the unit of its boxes is unknown.
    """
    vectors = [i for i, shape in enumerate(network.shapes) if len(shape) == 2 and shape[0] == 1]
    boxes = [i for i, shape in enumerate(network.shapes) if len(shape) == 3 and shape[0] == 1 and shape[2] == 4]
    if len(network.shapes) != 3 or len(vectors) != 2 or len(boxes) != 1:
        return None
    labels = [i for i in vectors if network.is_integer[i]] or [i for i in vectors if "label" in network.names[i]]
    n_boxes = network.shapes[boxes[0]][1]
    if len(labels) != 1 or any(network.shapes[i][1] != n_boxes for i in vectors):
        return None
    if not network.has_target_sizes:
        raise ModelError(
            f"{network.path}: expected the input {TARGET_SIZES} beside labels, boxes and scores, found none, so the "
            "unit of the boxes is unknown; export again with D-FINE's or DEIM's export_onnx.py."
        )
    (scores,) = (i for i in vectors if i != labels[0])
    layout = f"{n_boxes} labels, boxes and scores, with {TARGET_SIZES}"
    decoder = partial(_decode_labelled_boxes, labels[0], boxes[0], scores)
    return _square_model("D-FINE/DEIM/RT-DETR", layout, None, decoder)


def logits_and_boxes(network: NetworkOutputs) -> YoloModel | None:
    """Match of logits [1, N, K] and boxes [1, N, 4], in any order; masks and other outputs are ignored."""
    pair = _logits_and_boxes(network)
    if pair is None:
        return None
    logits, boxes = pair
    n_boxes, n_logits = network.shapes[logits][1:]
    is_detr = n_logits == _N_CATEGORIES + 1
    function = "softmax" if is_detr else "sigmoid"
    scores = network.metadata.get("scores", function, "default for this number of logits")
    has_no_object = scores.value == "softmax" or network.n_names == n_logits - 1
    has_category_ids = n_logits in (_N_CATEGORIES, _N_CATEGORIES + 1)
    is_rf_detr = network.names[boxes] == "dets" or n_logits == _N_CATEGORIES
    n_classes = n_logits - has_no_object
    family = "RF-DETR" if is_rf_detr else "DETR" if is_detr else "RT-DETR/D-FINE"
    layout = f"logits {[1, n_boxes, n_logits]} and boxes of {n_boxes} queries"
    decoder = partial(_decode_queries, logits, boxes, network.input_hw, n_classes, scores.value == "softmax")
    input_format = _IMAGENET_INPUT if is_rf_detr or has_category_ids else _STRETCHED_INPUT
    model = _square_model(family, layout, n_classes, decoder)
    return replace(model, input_format=input_format, attributes={"scores": scores})


def _logits_and_boxes(network: NetworkOutputs) -> tuple[int, int] | None:
    """Indices of logits and boxes: the only outputs [1, N, K] and [1, N, 4], or those of the usual names; else None."""
    grids = {3 * network.n_cells(strides) for strides in ((16, 32), (8, 16, 32))}  # YOLOv4's boxes, 3 per cell
    outputs = [i for i, n_rows, _ in network.matrices() if n_rows <= _MAX_BOXES and n_rows not in grids]
    boxes = [i for i in outputs if network.shapes[i][2] == 4]
    if len(boxes) > 1:
        boxes = [i for i in boxes if any(word in network.names[i].lower() for word in ("box", "dets"))]
    if len(boxes) != 1:
        return None
    logits = [i for i in outputs if i != boxes[0] and network.shapes[i][1] == network.shapes[boxes[0]][1]]
    if len(logits) > 1:
        logits = [i for i in logits if network.names[i] in ("logits", "pred_logits", "labels")]
    return (logits[0], boxes[0]) if len(logits) == 1 else None


def query_rows(network: NetworkOutputs) -> YoloModel | None:
    """Match of [1, N, 4 + C]: boxes as fractions and class scores, for the C names in the metadata, else COCO's 80."""
    n_classes = network.n_names or 80
    for i, n_rows, n_columns in network.matrices():
        if n_rows <= _MAX_BOXES and n_columns == 4 + n_classes:
            layout = f"rows {[1, n_rows, n_columns]}: box as fractions, classes"
            return _square_model("RT-DETR", layout, n_classes, partial(_decode_query_rows, i, network.input_hw))
    return None
