"""Layouts of networks that return one box per object, without suppression (docs/how-to/detectors.md
lists them).

The outputs are recognised by shape and type, since RF-DETR calls its logits `labels`; names decide
only if two shapes are the same. (Carion et al., "End-to-End Object Detection with Transformers",
2020; Wang et al., "YOLOv10", 2024; Peng et al., "D-FINE", 2024; Robinson et al., "RF-DETR", 2025;
exporters of YOLOv7, super-gradients, MMDeploy.)
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple, Self

import numpy as np

from track_range.detection.classes import is_background_name
from track_range.detection.models.onnx_session import TARGET_SIZES, ModelError
from track_range.detection.yolo import decoders
from track_range.detection.yolo.decoders import Candidates, Decoder, Part, corners
from track_range.detection.yolo.input_format import IMAGENET_MEAN, IMAGENET_STD, InputFormat
from track_range.detection.yolo.metadata import RT_DETR_DESCRIPTION
from track_range.detection.yolo.network_outputs import (
    KEYPOINTS_NOTE,
    MASKS_NOTE,
    N_MASKS,
    DetectorLayout,
    NetworkOutputs,
    YoloModel,
)
from track_range.foundation.arrays import FloatArray, FloatArray32

# largest number of boxes of end-to-end networks (100 to 900 in the papers); grids have more
_MAX_BOXES = 1000
_N_CATEGORIES = 91  # logits of networks trained on COCO's category ids 0 to 90
# class of RT-DETR's head in the metadata that Ultralytics' exporter writes
_RT_DETR_HEAD = "RTDETRDecoder"

_LOWEST_SCORE = 0.05  # boxes with less are padding

_USUAL_INPUT = InputFormat()
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
        score, label = self._scores_and_labels(outputs)
        kept = np.flatnonzero(~(score < min_score.min()))
        boxes = self.code(_numbers(outputs, self.boxes)[kept], kept)
        return Candidates.of_labels(boxes, score[kept], label[kept] - self.first_label, min_score)

    def is_possible(self, outputs: Sequence[FloatArray32]) -> bool:
        """Whether the labels of boxes with a score are whole numbers, and scores at most 1."""
        score, label = self._scores_and_labels(outputs)
        label = label[score > _LOWEST_SCORE]
        return bool((label == np.floor(label)).all() and not (score > 1.001).any())

    def _scores_and_labels(self, outputs: Sequence[FloatArray32]) -> tuple[FloatArray, FloatArray]:
        """(N,) both."""
        return _numbers(outputs, self.score).reshape(-1), _numbers(outputs, self.label).reshape(-1)


def _numbers(outputs: Sequence[FloatArray32], place: Place) -> FloatArray:
    """(N,) an output, or (N, k) columns of it."""
    output, columns = place
    array = outputs[output].astype(np.float64)
    if columns is None:
        return array.reshape(-1)
    return array.reshape(-1, array.shape[-1])[:, columns]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Row:
    """A meaning of the columns of one output whose rows are boxes."""

    family: str
    name: str
    text: str  # the columns, for display
    box: int  # the first of four columns
    score: int  # column
    label: int  # column
    is_fraction: bool = False  # whether boxes are fractions of the input's size
    input_format: InputFormat = _USUAL_INPUT

    def boxes(self, output: int, code: decoders.BoxCode) -> LabelledBoxes:
        """The boxes of an output."""
        return LabelledBoxes(
            boxes=(output, slice(self.box, self.box + 4)),
            score=(output, slice(self.score, self.score + 1)),
            label=(output, slice(self.label, self.label + 1)),
            code=code,
        )


_SSD_ROWS = (
    _Row(
        family="SSD",
        name="ssd-detections",
        text="batch, label, score, corners as fractions",
        box=3,
        score=2,
        label=1,
        is_fraction=True,
        input_format=_STRETCHED_INPUT,
    ),
)
_BATCH_ROWS = (
    _Row(
        family="YOLOv7",
        name="yolov7-end2end",
        text="batch, corners, label, score",
        box=1,
        score=6,
        label=5,
    ),
    _Row(
        family="YOLO-NAS",
        name="yolo-nas-flat",
        text="batch, corners, score, label",
        box=1,
        score=5,
        label=6,
    ),
)
_YOLOV10_ROW = _Row(
    family="YOLOv10/YOLO26",
    name="yolov10",
    text="corners, score, label",
    box=0,
    score=4,
    label=5,
)
_ROWS = (
    _YOLOV10_ROW,
    replace(_YOLOV10_ROW, name="yolov10-fractions", text="corners as fractions", is_fraction=True),
    _Row(
        family="PaddleDetection",
        name="paddle-rows",
        text="label, score, corners",
        box=2,
        score=1,
        label=0,
    ),
)
_N_COLUMNS = 6  # of `_ROWS`: box, score and label; more are masks or keypoints


def labelled_rows(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Readings of [1, N, 6], [N, 6] and [.., 7]: few rows, or any number with `end2end` in the
    metadata.
    """
    if network.metadata.get("head", None, "").value == RT_DETR_DESCRIPTION:
        return
    for i, shape in enumerate(network.shapes):
        if len(shape) not in (2, 3, 4) or any(length != 1 for length in shape[:-2]):
            continue
        note = _note_on_columns(network, shape[-1] - _N_COLUMNS)
        for row in _possible_rows(network, shape, has_note=bool(note)):
            layout = f"end-to-end rows {list(shape)}: {row.text}"
            code = corners(network.input_wh) if row.is_fraction else corners()
            boxes = row.boxes(i, code)
            model = _labelled(row.family, row.name, layout, boxes, row.input_format)
            # rows of EfficientDet and SSD may count from 1
            is_known = network.n_names is not None or row in _BATCH_ROWS
            yield replace(model, note=note, is_numbering_known=is_known)


def _note_on_columns(network: NetworkOutputs, n_columns: int) -> str:
    """A note on the columns after box, score and label, if masks or keypoints have as many."""
    if n_columns == N_MASKS and network.has_masks:
        return MASKS_NOTE
    if n_columns > 0 and n_columns == network.n_keypoints:
        return KEYPOINTS_NOTE
    return ""


def _possible_rows(
    network: NetworkOutputs, shape: tuple[int, ...], *, has_note: bool
) -> tuple[_Row, ...]:
    """The meanings of rows of an output of this shape; with a note, columns after the sixth are
    ignored.
    """
    n_rows, n_columns = shape[-2:]
    if n_columns == 7 and len(shape) == 4:
        return _SSD_ROWS
    if n_columns == 7 and len(shape) == 2:
        return _BATCH_ROWS
    if len(shape) == 4 or not (n_columns == _N_COLUMNS or has_note):
        return ()
    is_marked = network.metadata.get("end2end", False, "").value
    if len(shape) == 2 or is_marked or _is_few(network, n_rows):
        return _ROWS
    return ()


def _is_few(network: NetworkOutputs, n_rows: int) -> bool:
    """Whether `n_rows` can be the boxes of an end-to-end network: neither too many nor the cells of
    grids.
    """
    return n_rows <= _MAX_BOXES and not network.is_grid(n_rows)


def _labelled(
    family: str, name: str, layout: str, boxes: LabelledBoxes, input_format: InputFormat
) -> YoloModel:
    return YoloModel(
        family,
        layout,
        None,
        input_format,
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
            decoder = _YOLOV10_ROW.boxes(i, decoders.centres(network.input_wh)).decode
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


class _Vectors(NamedTuple):
    """Outputs with one number per box, labels or scores."""

    outputs: list[int]
    is_flat: bool  # whether they are [N], else [1, N]
    n_counts: int  # number of outputs beside them with a single number, the number of boxes

    @classmethod
    def of(cls, network: NetworkOutputs) -> Self:
        """The vectors of a network, [1, N] rather than [N]; two single numbers are the label and
        the score of one box.
        """
        shapes = network.shapes
        counts = [i for i, shape in enumerate(shapes) if shape in ((1,), (1, 1))]
        flat = [i for i, shape in enumerate(shapes) if len(shape) == 1 and i not in counts]
        batched = [
            i
            for i, shape in enumerate(shapes)
            if len(shape) == 2 and shape[0] == 1 and i not in counts
        ]
        if batched:
            return cls(batched, False, len(counts))
        if not flat and len(counts) == 2:
            return cls(counts, True, 0)
        return cls(flat, True, len(counts))


_TENSORFLOW_NAMES = ("detection_boxes", "detection_classes", "detection_scores", "num_detections")


class _LabelledOutputs(NamedTuple):
    """The outputs with labels, boxes and scores."""

    labels: int
    boxes: int
    scores: int | None  # None = the scores are the fifth column of the boxes
    n_boxes: int
    is_flat: bool  # whether labels are [N], else [1, N]
    has_count: bool  # whether another output is the number of boxes

    @classmethod
    def of_tensorflow(cls, network: NetworkOutputs) -> Self | None:
        """The outputs that TensorFlow's detection API names so, among others; None without them."""
        if not {*_TENSORFLOW_NAMES} <= {*network.names}:
            return None
        boxes, labels, scores, _ = map(network.names.index, _TENSORFLOW_NAMES)
        n_boxes = network.shapes[boxes][-2]
        return cls(labels, boxes, scores, n_boxes, is_flat=False, has_count=True)

    @classmethod
    def of(cls, network: NetworkOutputs) -> Self | None:
        """The outputs of a network; None if it has others, or others are missing."""
        box = _box_output(network)
        vectors = _Vectors.of(network)
        if box is None or len(network.shapes) != 1 + len(vectors.outputs) + vectors.n_counts:
            return None
        n_boxes, n_columns = network.shapes[box][-2:]
        if any(network.shapes[i][-1] != n_boxes for i in vectors.outputs):
            return None
        n_expected = 1 if n_columns == 5 else 2  # labels, or labels and scores
        labels = _label_outputs(network, vectors.outputs)
        if len(vectors.outputs) != n_expected or len(labels) != 1:
            return None
        scores = [i for i in vectors.outputs if i not in labels]
        return cls(
            labels=labels[0],
            boxes=box,
            scores=scores[0] if scores else None,
            n_boxes=n_boxes,
            is_flat=vectors.is_flat,
            has_count=vectors.n_counts > 0,
        )

    def rows(self) -> LabelledBoxes:
        """The boxes, as corners in pixels."""
        scores: Place = (self.boxes, slice(4, 5)) if self.scores is None else (self.scores, None)
        return LabelledBoxes((self.boxes, slice(0, 4)), scores, (self.labels, None), corners())


def _box_output(network: NetworkOutputs) -> int | None:
    """The only output [1, N, 4] or [1, N, 5], else the only output [N, 4] or [N, 5]."""
    boxes = [
        i
        for i, shape in enumerate(network.shapes)
        if len(shape) in (2, 3) and shape[-1] in (4, 5) and shape[:-2] in ((), (1,))
    ]
    batched = [i for i in boxes if len(network.shapes[i]) == 3]
    boxes = batched or boxes
    return boxes[0] if len(boxes) == 1 else None


def _label_outputs(network: NetworkOutputs, vectors: Sequence[int]) -> list[int]:
    """The vectors of integers, else those with the name of labels."""
    integers = [i for i in vectors if network.is_integer[i]]
    return integers or [i for i in vectors if _has_word(network.names[i], ("label", "class"))]


def _has_word(name: str, words: Sequence[str]) -> bool:
    return any(word in name.lower() for word in words)


def labels_boxes_scores(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Readings of labels [1, N], boxes [1, N, 4] and scores [1, N], in any order, or with scores in
    the boxes.

    ModelError: nothing shows the unit of the boxes, since the network has neither the input
    `orig_target_sizes` nor an output with the number of boxes.
    """
    outputs = _LabelledOutputs.of_tensorflow(network) or _LabelledOutputs.of(network)
    if outputs is None:
        return
    rows = outputs.rows()
    layout = f"{outputs.n_boxes} labels, boxes and scores"
    if outputs.scores is None:
        yield _labelled("MMDetection", "mmdet", layout, rows, _MMDET_INPUT)
    elif network.has_target_sizes:
        text = f"{layout}, with {TARGET_SIZES}"
        yield _square_model("D-FINE/DEIM/RT-DETR", "d-fine", text, None, rows.decode)
    # TensorFlow: top, left, bottom, right; labels from 1
    elif outputs.has_count and not network.is_integer[outputs.labels]:
        rows = replace(rows, code=decoders.rows_first(network.input_wh))
        text = f"{layout}, corners as fractions"
        yield _category_model(network, "TensorFlow's detection API", "tf-detections", text, rows)
    elif outputs.has_count:
        codes = {"end2end": corners(), "end2end-fractions": corners(network.input_wh)}
        for name, code in codes.items():
            boxes = replace(rows, code=code)
            yield replace(
                _labelled("YOLO with suppression", name, layout, boxes, _USUAL_INPUT),
                is_numbering_known=network.n_names is not None,
            )
    elif outputs.is_flat:
        yield _category_model(network, "torchvision", "torchvision", layout, rows)
    else:
        raise ModelError(
            f"{network.path}: expected the input {TARGET_SIZES} beside labels, boxes and scores, "
            "found none, so the unit of the boxes is unknown; export again with D-FINE's or DEIM's "
            "export_onnx.py."
        )


def _category_model(
    network: NetworkOutputs, family: str, name: str, layout: str, boxes: LabelledBoxes
) -> YoloModel:
    """A network whose labels count the class names from 1, or are COCO's category ids; a list may
    have the background as number 0.
    """
    has_background = network.n_names is not None and is_background_name(network.class_names[0])
    boxes = replace(boxes, first_label=int(network.n_names is not None and not has_background))
    model = _labelled(family, name, layout, boxes, _STRETCHED_INPUT)
    return model if network.n_names else replace(model, n_classes=_N_CATEGORIES)


def logits_and_boxes(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Reading of logits [1, N, K] and boxes [1, N, 4], in any order; masks and other outputs are
    ignored.

        score = sigmoid(logit_c)                          networks trained with focal loss
        score = exp(logit_c) / sum over K of exp(logit)   DETR, whose last logit means "no object"

    Each query gives its best class; RF-DETR's and RT-DETR's own postprocessing also returns further
    classes of the same box with lower scores. Logits after the classes mean "no object".
    """
    pair = _logits_and_boxes(network)
    if pair is None or _LabelledOutputs.of_tensorflow(network) is not None:
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
    family = "DETR" if is_detr else "RT-DETR/D-FINE"
    if is_rf_detr:
        family = "RF-DETR"
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
    outputs = [i for i, n_rows, _ in network.matrices() if _is_few(network, n_rows)]
    boxes = _only(
        [i for i in outputs if network.shapes[i][2] == 4],
        lambda i: _has_word(network.names[i], ("box", "dets")),
    )
    if boxes is None:
        return None
    n_boxes = network.shapes[boxes][1]
    logits = _only(
        [i for i in outputs if i != boxes and network.shapes[i][1] == n_boxes],
        lambda i: network.names[i] in ("logits", "pred_logits", "labels"),
    )
    return None if logits is None else (logits, boxes)


def _only(outputs: Sequence[int], has_usual_name: Callable[[int], bool]) -> int | None:
    """The only one of some outputs, or the only one with a usual name; else None."""
    if len(outputs) > 1:
        outputs = [i for i in outputs if has_usual_name(i)]
    return outputs[0] if len(outputs) == 1 else None


def query_rows(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Reading of [1, N, 4 + C]: boxes as fractions and class scores, for the C names in the
    metadata, else 80.
    """
    n_classes = network.n_names or 80
    for i, n_rows, n_columns in network.matrices():
        if n_columns == 4 + n_classes and _is_few(network, n_rows):
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


# special cases of two outputs with boxes and scores
LOGITS_AND_BOXES = DetectorLayout(
    title="RF-DETR", readings=logits_and_boxes, names=("detr",), priority=20
)
LABELS_BOXES_SCORES = DetectorLayout(
    title="D-FINE/DEIM",
    readings=labels_boxes_scores,
    names=(
        "d-fine",
        "end2end",
        "end2end-fractions",
        "mmdet",
        "torchvision",
        "tf-detections",
    ),
    priority=20,
)
LABELLED_QUERIES = DetectorLayout(
    title="RT-DETR", readings=labelled_query_rows, names=("rt-detr-rows",)
)
# any rows of 6 or 7 numbers
LABELLED_ROWS = DetectorLayout(
    title="YOLOv10",
    readings=labelled_rows,
    names=(
        "yolov10",
        "yolov10-fractions",
        "paddle-rows",
        "yolov7-end2end",
        "yolo-nas-flat",
        "ssd-detections",
    ),
    priority=-10,
)
# any rows of boxes and scores
QUERY_ROWS = DetectorLayout(
    title="RT-DETR", readings=query_rows, names=("rt-detr-queries",), priority=-20
)
