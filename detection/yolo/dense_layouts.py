"""Layouts of networks that return boxes for the cells of grids and leave the suppression to the
caller.

`_READINGS` lists what their numbers may mean; the tables after it list the shapes of the outputs
(docs/how-to/detectors.md shows both). Sources: the heads of the projects that the readings are
named after. The centre of NanoDet's, PicoDet's and YOLOv8's cells is (i + 1/2) stride,
NanoDet-Plus's and RTMDet's i stride.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, NamedTuple, Self

import numpy as np

from track_range.detection.models.onnx_session import ModelError
from track_range.detection.yolo.decoders import (
    BoxCode,
    BoxRows,
    GridCells,
    Part,
    anchored,
    binned_distances,
    cell_offsets,
    centres,
    corners,
    decode_rows,
    distances,
)
from track_range.detection.yolo.input_format import IMAGENET_MEAN, IMAGENET_STD, InputFormat
from track_range.detection.yolo.metadata import Anchors
from track_range.detection.yolo.network_outputs import (
    KEYPOINTS_NOTE,
    MASKS_NOTE,
    N_MASKS,
    STRIDES_PX,
    DetectorLayout,
    NetworkOutputs,
    YoloModel,
)
from track_range.foundation.arrays import FloatArray32
from track_range.foundation.files.input_files import shortened

_ANCHORS_PER_CELL = 3  # of YOLOv3, v4, v5 and v7
YOLOV4_TINY_ANCHORS: Anchors = (((81, 82), (135, 169), (344, 319)), ((23, 27), (37, 58), (81, 82)))
"""Anchors in input pixels at strides 32 and 16: masks 3,4,5 and 1,2,3 of AlexeyAB's
yolov4-tiny.cfg."""

# anchors in input pixels at strides 8, 16 and 32 (AlexeyAB's yolov4.cfg)
YOLOV4_ANCHORS: Anchors = (
    ((12, 16), (19, 36), (40, 28)),
    ((36, 75), (76, 55), (72, 146)),
    ((142, 110), (192, 243), (459, 401)),
)
_YOLOV4_SCALES = (1.2, 1.1, 1.05)  # scale_x_y at strides 8, 16 and 32 (AlexeyAB's yolov4.cfg)
_YOLOV5_ANCHORS: Anchors = (  # at strides 8, 16, 32 (Ultralytics' yolov5s.yaml)
    ((10, 13), (16, 30), (33, 23)),
    ((30, 61), (62, 45), (59, 119)),
    ((116, 90), (156, 198), (373, 326)),
)
# at strides 16, 32, for an input of 352 px (Yolo-FastestV2's data/coco.data)
_FASTESTV2_ANCHORS: Anchors = (
    ((12.64, 19.39), (37.88, 51.48), (55.71, 138.31)),
    ((126.91, 78.23), (131.57, 214.55), (279.92, 258.87)),
)

_PLAIN = InputFormat()
_STRETCHED = InputFormat(placement="stretch")
_DARKNET = InputFormat(pad_grey=128)
_YOLOX = InputFormat(placement="top-left", colours="bgr", divisor=1.0)
_NANODET = replace(  # ImageNet's mean and standard deviation of pixels 0..255
    _YOLOX,
    placement="centred",
    pad_grey=0,
    mean=(103.53, 116.28, 123.675),
    std=(57.375, 57.12, 58.395),
)
_NANODET_PLUS = replace(_NANODET, placement="stretch", pad_grey=114)
_PICODET = replace(_STRETCHED, mean=IMAGENET_MEAN, std=IMAGENET_STD)
_RTMDET = replace(_NANODET, placement="top-left", pad_grey=114)
_SSD = replace(_STRETCHED, divisor=128.0, mean=(127 / 128,) * 3)  # qfgaohao's pytorch-ssd

_Code = Callable[[NetworkOutputs, GridCells], BoxCode]


def _binned(n_bins: int, offset: float = 0.5, *, is_clipped: bool = False) -> _Code:
    def code(network: NetworkOutputs, cells: GridCells) -> BoxCode:
        limit_hw = network.input_hw if is_clipped else None
        return binned_distances(cells.points_px(offset), cells.stride_px, n_bins, limit_hw)

    return code


_CENTRES = "centres and sizes in pixels"
_CENTRE_FRACTIONS = "centres and sizes as fractions"
_CORNERS = "corners in pixels"
_FRACTIONS = "corners as fractions"
_OFFSETS = "offsets from the cells"
_DISTANCES = "distances in pixels"
_BINS8 = "8 bins per side"
_BINS8_CORNER = "8 bins per side from the corner of the cell"
_BINS16 = "16 bins per side"
_CODES: dict[str, _Code] = {
    _CENTRES: lambda *_: centres(),
    _CENTRE_FRACTIONS: lambda network, _: centres(network.input_wh),
    _CORNERS: lambda *_: corners(),
    _FRACTIONS: lambda network, _: corners(network.input_wh),
    _OFFSETS: lambda _, cells: cell_offsets(cells),
    _DISTANCES: lambda _, cells: distances(cells.points_px(0.0)),
    _BINS8: _binned(8, is_clipped=True),
    _BINS8_CORNER: _binned(8, 0.0, is_clipped=True),
    _BINS16: _binned(16),
}
_FIRST = slice(0, 1)
_LAST = slice(-1, None)


class _Reading(NamedTuple):
    """What the numbers of boxes may mean."""

    family: str
    code: str  # of `_CODES`
    input_format: InputFormat
    background: slice | None = None  # column of the scores that is no class
    # whether the objectness of all boxes is 1, where readings differ by it
    has_constant_objectness: bool | None = None

    @property
    def classes(self) -> slice:
        """Columns of the scores that are classes."""
        if self.background is None:
            return slice(None)
        return slice(1, None) if self.background == _FIRST else slice(0, -1)


_READINGS = {  # by name
    "yolov5": _Reading("YOLOv5", _CENTRES, _PLAIN),
    "yolov5-fractions": _Reading("YOLOv5", _CENTRE_FRACTIONS, _PLAIN),
    "nanodet": _Reading("NanoDet", _BINS8, _NANODET),
    "nanodet-plus": _Reading("NanoDet-Plus", _BINS8_CORNER, _NANODET_PLUS),
    "yolox": _Reading("YOLOX", _OFFSETS, _YOLOX),
    "yolox-decoded": _Reading("YOLOX", _CENTRES, _YOLOX, has_constant_objectness=False),
    "yolov6": _Reading("YOLOv6", _CENTRES, _PLAIN, has_constant_objectness=True),
    "yolov8-rows": _Reading("YOLOv8/YOLO11", _CENTRES, _PLAIN),
    "ppyoloe": _Reading("PP-YOLOE", _CORNERS, _STRETCHED),
    "yolov8-rows-fractions": _Reading("YOLOv8/YOLO11", _CENTRE_FRACTIONS, _PLAIN),
    "yolov8": _Reading("YOLOv8/YOLO11", _CENTRES, _PLAIN),
    "yolov8-corners": _Reading("YOLOv8/YOLO11", _CORNERS, _PLAIN),
    "yolov8-fractions": _Reading("YOLOv8/YOLO11", _CENTRE_FRACTIONS, _PLAIN),
    "picodet": _Reading("PicoDet", _BINS8, _PICODET),
    "nanodet-levels": _Reading("NanoDet", _BINS8, _NANODET),
    "rtmdet-heads": _Reading("RTMDet", _DISTANCES, _RTMDET),
    "yolov8-pairs": _Reading("YOLOv8/YOLO11", _BINS16, _PLAIN),
    "yolox-heads": _Reading("YOLOX", _OFFSETS, _YOLOX),
    "yolov8-heads": _Reading("YOLOv8/YOLO11", _BINS16, _PLAIN),
    "yolov4-boxes": _Reading("YOLOv4", _FRACTIONS, _DARKNET),
    "yolo-nas": _Reading("YOLO-NAS/DAMO-YOLO/YOLO-World", _CORNERS, _PLAIN),
    "boxes-centres": _Reading("boxes and scores", _CENTRES, _PLAIN),
    "boxes-centres-fractions": _Reading("boxes and scores", _CENTRE_FRACTIONS, _PLAIN),
    "ssd": _Reading("SSD", _FRACTIONS, _SSD, _FIRST),
    "ssd-last": _Reading("SSD", _FRACTIONS, _SSD, _LAST),
    "ssd-pixels": _Reading("SSD", _CORNERS, _SSD, _FIRST),
    "ssd-pixels-last": _Reading("SSD", _CORNERS, _SSD, _LAST),
}


@dataclass(frozen=True, slots=True)
class _Kind:
    """A shape of outputs, with the names of its readings, the usual reading first."""

    names: str
    has_objectness: bool = False
    n_box: int = 4
    n_anchors: int = 1  # boxes per cell, of networks with one output
    is_transposed: bool = False
    n_levels: tuple[int, ...] = (3, 4, 2)
    n_dimensions: int = 3  # of each output
    is_apart: bool = False  # whether boxes and scores are different outputs

    @property
    def is_binned(self) -> bool:
        """Whether boxes are distributions of distances; numbers of cells are then rounded up."""
        return self.n_box > 4


_GRIDS = (
    _Kind("yolov5 yolov5-fractions", has_objectness=True, n_anchors=_ANCHORS_PER_CELL),
    _Kind("nanodet", n_box=32, n_levels=(3,)),
    _Kind("nanodet-plus", n_box=32, n_levels=(4,)),
    _Kind("yolox yolox-decoded yolov6", has_objectness=True),
    _Kind("yolov8-rows ppyoloe yolov8-rows-fractions"),
    _Kind("yolov8 yolov8-corners yolov8-fractions", is_transposed=True),
)
_LEVELS = (
    _Kind("picodet", n_box=32, n_levels=(4,), is_apart=True),
    _Kind("nanodet-levels", n_box=32, n_levels=(3,), is_apart=True),
    _Kind("rtmdet-heads", n_levels=(3,), n_dimensions=4, is_apart=True),
    _Kind("yolov8-pairs", n_box=64, n_levels=(3,), n_dimensions=4, is_apart=True),
    _Kind("yolox-heads", has_objectness=True, n_levels=(3,), n_dimensions=4),
    _Kind("yolov8-heads", n_box=64, n_levels=(3,), n_dimensions=4),
)
_PAIR_NAMES = "yolov4-boxes yolo-nas boxes-centres boxes-centres-fractions"
_SSD_NAMES = "ssd ssd-last ssd-pixels ssd-pixels-last"


def grid_boxes(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Readings of one output with the boxes of all cells."""
    for i, n_rows, n_columns in network.matrices():
        # auxiliary heads, as YOLOv9's, come before the main one
        if network.shapes[i] in network.shapes[i + 1 :]:
            continue
        for kind in _GRIDS:
            n_boxes, width = (n_columns, n_rows) if kind.is_transposed else (n_rows, n_columns)
            strides = network.grid_strides(n_boxes, kind.n_anchors, is_rounded_up=kind.is_binned)
            if strides is None or len(strides) not in kind.n_levels:
                continue
            if width > kind.n_box + kind.has_objectness:
                yield from _grid_readings(network, i, kind, strides, width)


def _grid_readings(
    network: NetworkOutputs, output: int, kind: _Kind, strides: Sequence[int], width: int
) -> Iterator[YoloModel]:
    """Readings of an output with `width` numbers per box of the grids of these strides."""
    part = partial(Part, output, n_anchors=int(kind.is_transposed))
    if kind.is_binned:  # boxes after the classes
        n_classes, note = width - kind.n_box, ""
        boxes, scores = part(slice(n_classes, None)), part(slice(0, n_classes))
    else:
        first = kind.n_box + kind.has_objectness
        n_classes, note = _n_classes(network, width - first)
        boxes, scores = part(slice(0, kind.n_box)), part(slice(first, first + n_classes))
    cells = GridCells.of(network.input_hw, strides, kind.n_anchors, is_rounded_up=kind.is_binned)
    shape = network.shapes[output]
    if network.shapes.count(shape) > 1:
        same = [
            name
            for name, other in zip(network.names, network.shapes, strict=True)
            if other == shape
        ]
        note = (
            f"The last of the outputs {', '.join(same)} is read, since an auxiliary head comes "
            "before the main one, as in YOLOv9. Export one output to choose another."
        )
    is_tiny = kind.n_anchors == _ANCHORS_PER_CELL and len(strides) == 2
    for name in kind.names.split():
        reading = _READINGS[name]
        if is_tiny:
            reading = reading._replace(family="YOLOv4-tiny", input_format=_DARKNET)
        rows = BoxRows(
            boxes=boxes,
            objectness=part(slice(4, 5)) if kind.has_objectness else None,
            scores=scores,
            code=_CODES[reading.code](network, cells),
            cell_px=cells.points_px(),
        )
        layout = f"boxes of all cells {list(network.shapes[output])}: {reading.code}"
        model = _model(reading, name, layout, n_classes, [rows])
        if (expected := reading.has_constant_objectness) is not None:
            model = replace(model, accepts=partial(_has_constant_objectness, output, expected))
        yield replace(model, note=note)


def _has_constant_objectness(output: int, expected: bool, outputs: Sequence[FloatArray32]) -> bool:
    return bool((outputs[output][0, :, 4] > 0.999).all()) == expected


def _model(
    reading: _Reading, name: str, layout: str, n_classes: int, levels: Sequence[BoxRows]
) -> YoloModel:
    decoder = partial(decode_rows, levels)
    return YoloModel(reading.family, layout, n_classes, reading.input_format, decoder, name=name)


def _names_of(kind: _Kind) -> tuple[str, ...]:
    names = tuple(kind.names.split())
    return names if kind.n_dimensions == 3 else (*names, f"{names[-1]}-activated")


def levels_apart(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Readings of the cells of each stride in one output, or in two, boxes and scores, in any
    order.
    """
    for kind in _LEVELS:
        levels = _levels(network, kind)
        if levels is not None:
            yield from _level_readings(network, kind, levels)


def _levels(network: NetworkOutputs, kind: _Kind) -> list[BoxRows] | None:
    """The rows of each stride; None if a stride lacks outputs, or outputs belong to no stride."""
    shapes = network.shapes
    if any(len(shape) != kind.n_dimensions or shape[0] != 1 for shape in shapes):
        return None
    (n_levels,) = kind.n_levels
    levels, n_outputs = [], 0
    for stride in STRIDES_PX[n_levels - 3]:
        cells = GridCells.of(network.input_hw, (stride,), is_rounded_up=True)
        n_cells = len(cells.stride_px)
        of_stride = [i for i, shape in enumerate(shapes) if _n_cells(shape) == n_cells]
        parts = _parts_of(network, of_stride, kind)
        if parts is None:
            return None
        n_outputs += len(of_stride)
        boxes, scores, objectness = parts
        rows = BoxRows(
            boxes=boxes,
            scores=scores,
            objectness=objectness,
            code=_CODES[_READINGS[kind.names].code](network, cells),
            cell_px=cells.points_px(),
        )
        levels.append(rows)
    return levels if n_outputs == len(shapes) else None


def _n_cells(shape: tuple[int, ...]) -> int:
    """Number of cells of an output [1, N, K] or [1, K, h, w]."""
    return shape[1] if len(shape) == 3 else shape[2] * shape[3]


def _n_numbers(shape: tuple[int, ...]) -> int:
    """K of an output [1, N, K] or [1, K, h, w]."""
    return shape[2] if len(shape) == 3 else shape[1]


_Parts = tuple[Part, Part, Part | None]  # boxes, scores and objectness of one stride


def _parts_of(network: NetworkOutputs, outputs: Sequence[int], kind: _Kind) -> _Parts | None:
    """The parts of one stride; None if the outputs lack one of these."""
    widths = {i: _n_numbers(network.shapes[i]) for i in outputs}
    part = partial(Part, n_anchors=int(kind.n_dimensions == 4))
    if kind.is_apart:
        return _parts_apart(widths, kind, part)
    first = kind.n_box + kind.has_objectness
    if len(outputs) != 1 or widths[outputs[0]] <= first:
        return None
    output = outputs[0]
    objectness = part(output, slice(4, 5)) if kind.has_objectness else None
    return part(output, slice(0, kind.n_box)), part(output, slice(first, None)), objectness


def _parts_apart(
    widths: Mapping[int, int], kind: _Kind, part: Callable[[int], Part]
) -> _Parts | None:
    """Boxes and scores in different outputs, from the numbers per box of each output."""
    # the scores come first if there are as many classes
    boxes = [i for i, width in widths.items() if width == kind.n_box][-1:]
    scores = [i for i in widths if i not in boxes]
    if len(widths) > 2:  # RKNN: scores, and their sum
        scores = [i for i in scores if widths[i] > 1]
    if len(boxes) != 1 or len(scores) != 1:
        return None
    return part(boxes[0]), part(scores[0]), None


def _level_readings(
    network: NetworkOutputs, kind: _Kind, levels: Sequence[BoxRows]
) -> Iterator[YoloModel]:
    """Readings of these levels: scores of [1, N, K] are probabilities, those of planes also
    logits.
    """
    scores = [level.scores for level in levels]
    widths = {
        _n_numbers(network.shapes[part.output]) - (part.columns.start or 0) for part in scores
    }
    if len(widths) != 1:
        return
    (n_classes,) = widths
    name = kind.names
    reading = _READINGS[name]
    shapes = shortened(", ".join(str(list(shape)) for shape in network.shapes), 60)
    layout = f"boxes of {len(levels)} strides {shapes}: {reading.code}"
    model = _model(reading, name, layout, n_classes, levels)
    if kind.n_dimensions == 3:
        yield replace(model, score_outputs=tuple(part.output for part in scores))
        return
    logits = [replace(level, activation="sigmoid") for level in levels]
    yield replace(
        model,
        decoder=partial(decode_rows, logits),
        accepts=partial(_are_probabilities, scores, False),
    )
    yield replace(
        model, name=f"{name}-activated", accepts=partial(_are_probabilities, scores, True)
    )


def _are_probabilities(
    parts: Sequence[Part], expected: bool, outputs: Sequence[FloatArray32]
) -> bool:
    scores = (part.of(outputs) for part in parts)
    return all(score.min() >= 0 and score.max() <= 1.001 for score in scores) == expected


def boxes_and_scores(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Readings of boxes [1, N, 1, 4] or [1, N, 4], and scores [1, N, C] or [1, C, N], in any order.

    The scores of SSD-like networks have a column more than there are names: the background, first
    or last.
    """
    if len(network.shapes) != 2:
        return
    for boxes, scores in ((0, 1), (1, 0)):
        box, score = network.shapes[boxes], network.shapes[scores]
        if len(box) not in (3, 4) or len(score) != 3 or score[0] != 1:
            continue
        n_rows = box[1]
        if box in ((1, n_rows, 1, 4), (1, n_rows, 4)) and n_rows in score[1:]:
            yield from _pair_readings(network, boxes, scores, n_rows)


def _pair_readings(
    network: NetworkOutputs, boxes: int, scores: int, n_rows: int
) -> Iterator[YoloModel]:
    """Readings of two outputs with `n_rows` boxes and their scores."""
    score_shape = network.shapes[scores]
    is_transposed = score_shape[1] != n_rows
    n_columns = score_shape[1] if is_transposed else score_shape[2]
    part = Part(scores, n_anchors=int(is_transposed))
    strides = network.grid_strides(n_rows)
    cells = GridCells.of(network.input_hw, strides or ())
    is_tiny = n_rows == _ANCHORS_PER_CELL * network.n_cells((16, 32))
    has_background = _has_background(network, n_columns)
    for name in (_SSD_NAMES if has_background else _PAIR_NAMES).split():
        reading = _READINGS[name]
        if is_tiny and reading.family == "YOLOv4":
            reading = reading._replace(family="YOLOv4-tiny")
        rows = BoxRows(
            boxes=Part(boxes),
            scores=part,
            code=_CODES[reading.code](network, cells),
            classes=reading.classes,
            cell_px=cells.points_px() if strides else None,
        )
        layout = (
            f"boxes {list(network.shapes[boxes])}: {reading.code}, and scores {list(score_shape)}"
        )
        model = _model(reading, name, layout, n_columns - has_background, [rows])
        if reading.background is not None:
            model = replace(model, accepts=partial(_is_background, part, reading.background))
        yield model


def _has_background(network: NetworkOutputs, n_columns: int) -> bool:
    """Whether scores have a column more than there are names: their own, or COCO's or VOC's."""
    n_classes = n_columns - 1
    return n_classes == network.n_names if network.n_names else n_classes in (80, 20)


def _is_background(part: Part, column: slice, outputs: Sequence[FloatArray32]) -> bool:
    """Whether a column of the scores exceeds the other columns in most rows."""
    scores = part.of(outputs)
    return bool(np.mean(scores[:, column].max(axis=1) >= scores.max(axis=1)) > 0.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class _AnchorFamily:
    """A family with raw heads, and its usual anchors and scales, from the finest stride."""

    name: str
    family: str
    anchors: Anchors
    scales: tuple[float, ...]  # scale_x_y
    size: Literal["exp", "square"]  # see `anchored`
    input_format: InputFormat


def _anchor_families(n_heads: int) -> tuple[_AnchorFamily, _AnchorFamily]:
    """The families that networks with so many heads may belong to."""
    darknet = _AnchorFamily(
        name="darknet-heads",
        family="YOLOv4",
        anchors=YOLOV4_ANCHORS,
        scales=_YOLOV4_SCALES,
        size="exp",
        input_format=_DARKNET,
    )
    if n_heads == 2:
        darknet = replace(
            darknet,
            family="YOLOv4-tiny",
            anchors=YOLOV4_TINY_ANCHORS[::-1],
            scales=(1.0, 1.0),
        )
    yolov5 = _AnchorFamily(
        name="yolov5-heads",
        family="YOLOv5",
        anchors=_YOLOV5_ANCHORS,
        scales=(2.0,) * n_heads,
        size="square",
        input_format=_PLAIN,
    )
    return darknet, yolov5


class _Heads(NamedTuple):
    """The common shape of two to four raw heads."""

    n_anchors: int
    n_columns: int  # 5 + C
    is_separate: bool  # whether the heads are [1, A, rows, columns, 5 + C]

    @classmethod
    def of(cls, network: NetworkOutputs) -> Self | None:
        """The shape of a network's heads; None if its outputs are no heads.

        ModelError: the explicit anchors do not belong to as many heads.
        """
        shapes = network.shapes
        dimensions = {len(shape) for shape in shapes}
        if len(shapes) not in (2, 3, 4) or dimensions not in ({4}, {5}):
            return None
        if any(shape[0] != 1 for shape in shapes):
            return None
        n_anchors = _n_anchors(network)
        is_separate = dimensions == {5}
        if is_separate:
            n_columns, remainder = shapes[0][4], shapes[0][1] - n_anchors
        else:
            n_columns, remainder = divmod(shapes[0][1], n_anchors)
        n_widths = len({shape[4 if is_separate else 1] for shape in shapes})
        if n_widths != 1 or remainder or n_columns < 6:
            return None
        return cls(n_anchors, n_columns, is_separate)


def _n_anchors(network: NetworkOutputs) -> int:
    """Number of anchors per cell; ModelError if the explicit anchors do not fit the heads."""
    given = network.metadata.get("anchors", None, "")
    if not given.value:
        return _ANCHORS_PER_CELL
    numbers = [len(head) for head in given.value]
    if len(numbers) != len(network.shapes) or len(set(numbers)) != 1:
        raise ModelError(
            f"{network.path}: expected the same number of anchors for each of "
            f"{len(network.shapes)} output heads, got {shortened(', '.join(map(str, numbers)))} "
            f"({given.source}); give --anchors 'w,h w,h w,h / w,h w,h w,h' in the order of the "
            "outputs."
        )
    return numbers[0]


def anchor_heads(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Readings of two to four raw heads [1, A (5 + C), rows, columns] or [1, A, rows, columns, 5 +
    C].
    """
    heads = _Heads.of(network)
    if heads is None:
        return
    metadata = network.metadata
    has_anchors = bool(metadata.get("anchors", None, "").value)
    is_scaled = metadata.get("scale_x_y", None, "").value is not None  # as only Darknet's heads are
    for family in _anchor_families(len(network.shapes)):
        is_excluded = heads.is_separate if family.name == "darknet-heads" else is_scaled
        has_default_anchors = len(family.anchors) == len(network.shapes)
        if not is_excluded and (has_anchors or has_default_anchors):
            yield _anchor_model(network, heads, family)


def _anchor_model(network: NetworkOutputs, heads: _Heads, family: _AnchorFamily) -> YoloModel:
    """The reading of heads as those of a family; ModelError if `scale_x_y` does not fit."""
    metadata, shapes = network.metadata, network.shapes
    is_coarse_first = shapes[0][3] < shapes[-1][3]
    order = slice(None, None, -1 if is_coarse_first else 1)
    source = f"default of {family.family}"
    anchors = metadata.get("anchors", family.anchors[order], source)
    scales = metadata.get("scale_x_y", family.scales[order], source)
    n_scales = len(scales.value)
    if n_scales not in (1, len(shapes)):
        raise ModelError(
            f"{network.path}: expected one scale_x_y for each of {len(shapes)} output heads, "
            f"got {shortened(str(list(scales.value)))} ({scales.source})."
        )
    levels = []
    for i, (shape, anchor) in enumerate(zip(shapes, anchors.value, strict=True)):
        cells = GridCells.of_grid(network.input_hw, shape[2:4], heads.n_anchors)
        code = anchored(
            cells,
            np.array(anchor),
            scale_x_y=scales.value[i % n_scales],
            size=family.size,
            is_logit=True,
        )
        part = partial(Part, i, n_anchors=0 if heads.is_separate else heads.n_anchors)
        rows = BoxRows(
            boxes=part(slice(0, 4)),
            objectness=part(slice(4, 5)),
            scores=part(slice(5, None)),
            code=code,
            activation="sigmoid",
            cell_px=cells.points_px(),
        )
        levels.append(rows)
    listed = ", ".join(str(list(shape)) for shape in shapes)
    layout = f"raw heads {listed}: {heads.n_anchors} anchors per cell"
    reading = _Reading(family.family, "", family.input_format)
    model = _model(reading, family.name, layout, heads.n_columns - 5, levels)
    return replace(model, attributes={"anchors": anchors, "scale_x_y": scales})


def fastest_heads(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Reading of Yolo-FastestV2's two heads [1, rows, columns, 5 A + C] after sigmoid and softmax;
    A = 3.
    """
    height, width = network.input_hw
    shapes = network.shapes
    n_anchors = _ANCHORS_PER_CELL
    n_classes = shapes[0][-1] - 5 * n_anchors
    grids = [(1, height // stride, width // stride) for stride in (16, 32)]
    if [shape[:-1] for shape in shapes] != grids or n_classes < 1:
        return
    usual = [[(w * width / 352, h * height / 352) for w, h in head] for head in _FASTESTV2_ANCHORS]
    anchors = network.metadata.get("anchors", usual, "default of Yolo-FastestV2")
    levels = []
    for i, k in np.ndindex(2, n_anchors):
        cells = GridCells.of_grid(network.input_hw, shapes[i][1:3])
        anchor = np.array(anchors.value[i][k : k + 1])
        objectness = 4 * n_anchors + k
        rows = BoxRows(
            boxes=Part(i, slice(4 * k, 4 * k + 4)),
            objectness=Part(i, slice(objectness, objectness + 1)),
            scores=Part(i, slice(5 * n_anchors, None)),
            code=anchored(cells, anchor, size="square", is_logit=False),
            cell_px=cells.points_px(),
        )
        levels.append(rows)
    layout = (
        f"heads {list(shapes[0])}, {list(shapes[1])}: boxes and objectness of {n_anchors} anchors, "
        "classes"
    )
    reading = _Reading("Yolo-FastestV2", "", replace(_STRETCHED, colours="bgr"))
    yield _model(reading, "yolo-fastestv2", layout, n_classes, levels)


def _n_classes(network: NetworkOutputs, n_columns: int) -> tuple[int, str]:
    """Number of classes among the columns after the box, and a note on coefficients of masks or
    keypoints.
    """
    if network.has_masks and n_columns > N_MASKS:
        return n_columns - N_MASKS, MASKS_NOTE
    n_keypoints = network.n_keypoints
    if not n_keypoints and network.n_names == 1 and n_columns % 3 == 1:
        n_keypoints = n_columns - 1  # x, y and visibility
    if 0 < n_keypoints < n_columns:
        return n_columns - n_keypoints, KEYPOINTS_NOTE
    return n_columns, ""


# special cases of a grid with an output that is left out
PAIRS = DetectorLayout(
    title="YOLOv4, YOLO-NAS, SSD",
    readings=boxes_and_scores,
    names=tuple(f"{_PAIR_NAMES} {_SSD_NAMES}".split()),
    priority=10,
)
GRIDS = DetectorLayout(
    title="YOLOv5 to v8, YOLOX",
    readings=grid_boxes,
    names=tuple(" ".join(kind.names for kind in _GRIDS).split()),
)
LEVELS = DetectorLayout(
    title="NanoDet, PicoDet, RTMDet",
    readings=levels_apart,
    names=tuple(name for kind in _LEVELS for name in _names_of(kind)),
)
FASTEST_HEADS = DetectorLayout(
    title="Yolo-FastestV2", readings=fastest_heads, names=("yolo-fastestv2",)
)
# any outputs with the shapes of heads
ANCHOR_HEADS = DetectorLayout(
    title="Darknet",
    readings=anchor_heads,
    names=("darknet-heads", "yolov5-heads"),
    priority=-20,
)
