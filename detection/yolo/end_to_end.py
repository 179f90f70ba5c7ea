"""Layouts of networks that return one box per object, without suppression (docs/how-to/detectors.md
lists them).

The outputs are recognised by shape and type, since RF-DETR calls its logits `labels`; names decide
only if two shapes are the same. (Carion et al., "End-to-End Object Detection with Transformers",
2020; Wang et al., "YOLOv10", 2024; Peng et al., "D-FINE", 2024; Robinson et al., "RF-DETR", 2025;
exporters of YOLOv7, super-gradients, MMDeploy.)
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from track_range.detection.models.metadata import RT_DETR_DESCRIPTION
from track_range.detection.models.onnx_session import TARGET_SIZES, ModelError
from track_range.detection.yolo import decoders
from track_range.detection.yolo.decoders import Candidates, Decoder, Part, corners
from track_range.detection.yolo.input_format import IMAGENET_MEAN, IMAGENET_STD, InputFormat
from track_range.detection.yolo.network_outputs import NetworkOutputs, YoloModel
from track_range.foundation.arrays import FloatArray, FloatArray32

# largest number of boxes of end-to-end networks (100 to 900 in the papers); grids have more
_MAX_BOXES = 1000
_N_CATEGORIES = 91  # logits of networks trained on COCO's category ids 0 to 90
# class of RT-DETR's head in the metadata that Ultralytics' exporter writes
_RT_DETR_HEAD = "RTDETRDecoder"

_LOWEST_SCORE = 0.05  # boxes with less are padding
N_MASKS = 32  # coefficients of a mask in segmentation networks
MASKS_NOTE = "Masks of the segmentation network are ignored."
KEYPOINTS_NOTE = "Keypoints of the pose network are ignored."

_STRETCHED_INPUT = InputFormat(placement="stretch")
_IMAGENET_INPUT = replace(_STRETCHED_INPUT, mean=IMAGENET_MEAN, std=IMAGENET_STD)
_MMDET_INPUT = InputFormat(  # of MMDetection's RTMDet
    placement="top-left",
    colours="bgr",
    divisor=1.0,
    mean=(103.53, 116.28, 123.675),
    std=(57.375, 57.12, 58.395),
)


# an output, and columns of it; None = the output is a vector of N numbers
Place = tuple[int, slice | None]


@dataclass(frozen=True, slots=True)
class LabelledBoxes:
    """N boxes with one score and label each; the parts may be columns of one output, with or
    without a batch axis.
    """

    boxes: Place
    score: Place
    label: Place
    code: decoders.BoxCode
    first_label: int = 0  # number of the first class; 1 = label 0 is the background

    def decode(self, outputs: Sequence[FloatArray32], min_score: FloatArray) -> Candidates:
        """Candidates of all boxes."""
        score, label = (_numbers(outputs, place).reshape(-1) for place in (self.score, self.label))
        kept = np.flatnonzero(~(score < min_score.min()))
        boxes = self.code(_numbers(outputs, self.boxes)[kept], kept)
        return Candidates.of_labels(boxes, score[kept], label[kept] - self.first_label, min_score)

    def is_possible(self, outputs: Sequence[FloatArray32]) -> bool:
        """Whether the labels of boxes with a score are whole numbers, and scores at most 1."""
        score, label = (_numbers(outputs, place).reshape(-1) for place in (self.score, self.label))
        label = label[score > _LOWEST_SCORE]
        return bool((label == np.floor(label)).all() and not (score > 1.001).any())


def _numbers(outputs: Sequence[FloatArray32], place: Place) -> FloatArray:
    array, columns = outputs[place[0]].astype(np.float64), place[1]
    return array.reshape(-1) if columns is None else array.reshape(-1, array.shape[-1])[:, columns]


def _rows_of(
    output: int, box: int, score: int, label: int, code: decoders.BoxCode
) -> LabelledBoxes:
    """Boxes in rows of one output, with the first column of the box, and the columns of score and
    label.
    """
    columns = (slice(box, box + 4), slice(score, score + 1), slice(label, label + 1))
    boxes, scores, labels = ((output, column) for column in columns)
    return LabelledBoxes(boxes, scores, labels, code)


def labelled_rows(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Readings of [1, N, 6], [N, 6] and [.., 7]: few rows, or any number with `end2end` in the
    metadata.
    """
    is_marked = network.metadata.get("end2end", False, "").value
    if network.metadata.get("head", None, "").value == RT_DETR_DESCRIPTION:
        return
    pixels, fractions = corners(), corners(network.input_wh)
    for i, shape in enumerate(network.shapes):
        if len(shape) not in (2, 3, 4) or any(length != 1 for length in shape[:-2]):
            continue
        n_rows, n_columns = shape[-2:]
        others, is_few = n_columns - 6, n_rows <= _MAX_BOXES and not network.is_grid(n_rows)
        has_masks = others == N_MASKS and any(
            len(s) == 4 and s[:2] == (1, N_MASKS) for s in network.shapes
        )
        note = (
            MASKS_NOTE
            if has_masks
            else KEYPOINTS_NOTE
            if others > 0 and others == network.n_keypoints
            else ""
        )
        readings: tuple[tuple[str, str, str, LabelledBoxes], ...] = ()
        if len(shape) == 4 and n_columns == 7:
            text = "batch, label, score, corners as fractions"
            readings = (("SSD", "ssd-detections", text, _rows_of(i, 3, 2, 1, fractions)),)
        elif n_columns == 7 and len(shape) == 2:
            readings = (
                (
                    "YOLOv7",
                    "yolov7-end2end",
                    "batch, corners, label, score",
                    _rows_of(i, 1, 6, 5, pixels),
                ),
                (
                    "YOLO-NAS",
                    "yolo-nas-flat",
                    "batch, corners, score, label",
                    _rows_of(i, 1, 5, 6, pixels),
                ),
            )
        elif len(shape) != 4 and (is_few or is_marked or len(shape) == 2) and (others == 0 or note):
            readings = (
                (
                    "YOLOv10/YOLO26",
                    "yolov10",
                    "corners, score, label",
                    _rows_of(i, 0, 4, 5, pixels),
                ),
                (
                    "YOLOv10/YOLO26",
                    "yolov10-fractions",
                    "corners as fractions",
                    _rows_of(i, 0, 4, 5, fractions),
                ),
                (
                    "PaddleDetection",
                    "paddle-rows",
                    "label, score, corners",
                    _rows_of(i, 2, 1, 0, pixels),
                ),
            )
        for family, name, text, rows in readings:
            model = _labelled(family, name, f"end-to-end rows {list(shape)}: {text}", rows)
            form = _STRETCHED_INPUT if name == "ssd-detections" else model.input_format
            yield replace(model, note=note, input_format=form)


def _labelled(family: str, name: str, layout: str, boxes: LabelledBoxes) -> YoloModel:
    return YoloModel(
        family,
        layout,
        None,
        InputFormat(),
        boxes.decode,
        is_end_to_end=True,
        name=name,
        accepts=boxes.is_possible,
    )


def labelled_query_rows(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Reading of [1, N, 6], box as fractions, score, label: as `labelled_rows`, with RT-DETR's head
    in the metadata.

    Older versions of Ultralytics return [1, N, 4 + C] (`query_rows`), which is the same shape for
    two classes; their metadata have no `head`.
    """
    head = network.metadata.get("head", None, "").value
    if head != _RT_DETR_HEAD and (head != RT_DETR_DESCRIPTION or network.n_names == 2):
        return
    for i, n_rows, n_columns in network.matrices():
        if n_columns == 6 and n_rows <= _MAX_BOXES:
            layout = f"rows {[1, n_rows, n_columns]}: box as fractions, score, label"
            decoder = _rows_of(i, 0, 4, 5, decoders.centres(network.input_wh)).decode
            yield _square_model("RT-DETR", "rt-detr-rows", layout, None, decoder)


def _square_model(
    family: str, name: str, layout: str, n_classes: int | None, decoder: Decoder
) -> YoloModel:
    return YoloModel(
        family,
        layout,
        n_classes,
        _STRETCHED_INPUT,
        decoder,
        is_end_to_end=True,
        is_square=True,
        name=name,
    )


def labels_boxes_scores(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Readings of labels [1, N], boxes [1, N, 4] and scores [1, N], in any order, or with scores in
    the boxes.

    ModelError: nothing shows the unit of the boxes, since the network has neither the input
    `orig_target_sizes` nor an output with the number of boxes.
    """
    vectors = [
        i
        for i, shape in enumerate(network.shapes)
        if len(shape) == 2 and shape[0] == 1 and shape[1] != 1
    ]
    counts = [i for i, shape in enumerate(network.shapes) if shape in ((1,), (1, 1))]
    boxes = [
        i
        for i, s in enumerate(network.shapes)
        if len(s) in (2, 3) and s[-1] in (4, 5) and s[:-2] in ((), (1,))
    ]
    flat = [i for i, shape in enumerate(network.shapes) if len(shape) == 1 and shape != (1,)]
    boxes = [i for i in boxes if len(network.shapes[i]) == 3] or boxes
    if not vectors and not flat and len(counts) == 2:  # one box
        flat, counts = counts, []
    vectors = vectors or flat
    if (
        len(boxes) != 1
        or len(vectors) not in (1, 2)
        or len(network.shapes) - len(counts) != 1 + len(vectors)
    ):
        return
    labels = [i for i in vectors if network.is_integer[i]] or [
        i for i in vectors if any(word in network.names[i].lower() for word in ("label", "class"))
    ]
    n_boxes, n_columns = network.shapes[boxes[0]][-2:]
    if (
        len(labels) != 1
        or any(network.shapes[i][-1] != n_boxes for i in vectors)
        or n_columns + len(vectors) != 6
    ):
        return
    layout, label = f"{n_boxes} labels, boxes and scores", (labels[0], None)
    if n_columns == 5:
        rows = LabelledBoxes((boxes[0], slice(0, 4)), (boxes[0], slice(4, 5)), label, corners())
        yield replace(_labelled("MMDetection", "mmdet", layout, rows), input_format=_MMDET_INPUT)
        return
    (scores,) = (i for i in vectors if i != labels[0])
    first = int(network.n_names is not None)
    rows = LabelledBoxes((boxes[0], slice(0, 4)), (scores, None), label, corners())
    if network.has_target_sizes:
        text = f"{layout}, with {TARGET_SIZES}"
        yield _square_model("D-FINE/DEIM/RT-DETR", "d-fine", text, None, rows.decode)
    # TensorFlow: top, left, bottom, right; labels from 1
    elif counts and not network.is_integer[labels[0]]:
        rows = replace(rows, code=decoders.rows_first(network.input_wh), first_label=first)
        model = _labelled(
            "TensorFlow's detection API", "tf-detections", f"{layout}, corners as fractions", rows
        )
        yield replace(
            model, n_classes=None if network.n_names else 91, input_format=_STRETCHED_INPUT
        )
    elif counts:
        for name, code in (
            ("end2end", corners()),
            ("end2end-fractions", corners(network.input_wh)),
        ):
            yield _labelled("YOLO with suppression", name, layout, replace(rows, code=code))
    elif flat:  # labels from 1, or COCO's category ids
        rows = replace(rows, first_label=first)
        model = _labelled("torchvision", "torchvision", layout, rows)
        yield replace(
            model, n_classes=None if network.n_names else 91, input_format=_STRETCHED_INPUT
        )
    else:
        raise ModelError(
            f"{network.path}: expected the input {TARGET_SIZES} beside labels, boxes and scores, "
            "found none, so the unit of the boxes is unknown; export again with D-FINE's or DEIM's "
            "export_onnx.py."
        )


def logits_and_boxes(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Reading of logits [1, N, K] and boxes [1, N, 4], in any order; masks and other outputs are
    ignored.

        score = sigmoid(logit_c)                          networks trained with focal loss
        score = exp(logit_c) / sum over K of exp(logit)   DETR, whose last logit means "no object"

    Each query gives its best class; RF-DETR's and RT-DETR's own postprocessing also returns further
    classes of the same box with lower scores. Logits after the classes mean "no object".
    """
    pair = _logits_and_boxes(network)
    if pair is None:
        return
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
    rows = decoders.BoxRows(
        boxes=Part(boxes),
        scores=Part(logits),
        code=decoders.centres(network.input_wh),
        activation=scores.value,
        classes=slice(0, n_classes),
    )
    model = _square_model(family, "detr", layout, n_classes, partial(decoders.decode_rows, [rows]))
    input_format = _IMAGENET_INPUT if is_rf_detr or has_category_ids else _STRETCHED_INPUT
    yield replace(model, input_format=input_format, attributes={"scores": scores})


def _logits_and_boxes(network: NetworkOutputs) -> tuple[int, int] | None:
    """Indices of logits and boxes: the only outputs [1, N, K] and [1, N, 4], or by their usual
    names; else None.
    """
    outputs = [
        i
        for i, n_rows, _ in network.matrices()
        if n_rows <= _MAX_BOXES and not network.is_grid(n_rows)
    ]
    boxes = [i for i in outputs if network.shapes[i][2] == 4]
    if len(boxes) > 1:
        boxes = [
            i for i in boxes if any(word in network.names[i].lower() for word in ("box", "dets"))
        ]
    if len(boxes) != 1:
        return None
    logits = [
        i for i in outputs if i != boxes[0] and network.shapes[i][1] == network.shapes[boxes[0]][1]
    ]
    if len(logits) > 1:
        logits = [i for i in logits if network.names[i] in ("logits", "pred_logits", "labels")]
    return (logits[0], boxes[0]) if len(logits) == 1 else None


def query_rows(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Reading of [1, N, 4 + C]: boxes as fractions and class scores, for the C names in the
    metadata, else 80.
    """
    n_classes = network.n_names or 80
    for i, n_rows, n_columns in network.matrices():
        if n_rows <= _MAX_BOXES and not network.is_grid(n_rows) and n_columns == 4 + n_classes:
            layout = f"rows {[1, n_rows, n_columns]}: box as fractions, classes"
            rows = decoders.BoxRows(
                boxes=Part(i, slice(0, 4)),
                scores=Part(i, slice(4, None)),
                code=decoders.centres(network.input_wh),
            )
            yield _square_model(
                "RT-DETR",
                "rt-detr-queries",
                layout,
                n_classes,
                partial(decoders.decode_rows, [rows]),
            )
