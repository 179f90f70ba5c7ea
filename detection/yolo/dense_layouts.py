"""Layouts of networks that return boxes for the cells of grids and leave the suppression to the
caller.

`_READINGS` lists what their numbers may mean; the tables after it list the shapes of the outputs
(docs/how-to/detectors.md shows both). Sources: the heads of the projects that the readings are
named after. The centre of NanoDet's, PicoDet's and YOLOv8's cells is (i + 1/2) stride,
NanoDet-Plus's and RTMDet's i stride.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from track_range.detection.models.metadata import Anchors
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
from track_range.detection.yolo.network_outputs import (
    KEYPOINTS_NOTE,
    MASKS_NOTE,
    N_MASKS,
    STRIDES_PX,
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


_CODES: dict[str, _Code] = {
    "centres and sizes in pixels": lambda *_: centres(),
    "centres and sizes as fractions": lambda network, _: centres(network.input_wh),
    "corners in pixels": lambda *_: corners(),
    "corners as fractions": lambda network, _: corners(network.input_wh),
    "offsets from the cells": lambda _, cells: cell_offsets(cells),
    "distances in pixels": lambda _, cells: distances(cells.points_px(0.0)),
    "8 bins per side": _binned(8, is_clipped=True),
    "8 bins per side from the corner of the cell": _binned(8, 0.0, is_clipped=True),
    "16 bins per side": _binned(16),
}
(
    _CENTRES,
    _CENTRE_FRACTIONS,
    _CORNERS,
    _FRACTIONS,
    _OFFSETS,
    _DISTANCES,
    _BINS8,
    _BINS8_CORNER,
    _BINS16,
) = _CODES


_READINGS = {  # family, code, input format by name
    "yolov5": ("YOLOv5", _CENTRES, _PLAIN),
    "yolov5-fractions": ("YOLOv5", _CENTRE_FRACTIONS, _PLAIN),
    "nanodet": ("NanoDet", _BINS8, _NANODET),
    "nanodet-plus": ("NanoDet-Plus", _BINS8_CORNER, _NANODET_PLUS),
    "yolox": ("YOLOX", _OFFSETS, _YOLOX),
    "yolox-decoded": ("YOLOX", _CENTRES, _YOLOX),
    "yolov6": ("YOLOv6", _CENTRES, _PLAIN),
    "yolov8-rows": ("YOLOv8/YOLO11", _CENTRES, _PLAIN),
    "ppyoloe": ("PP-YOLOE", _CORNERS, _STRETCHED),
    "yolov8-rows-fractions": ("YOLOv8/YOLO11", _CENTRE_FRACTIONS, _PLAIN),
    "yolov8": ("YOLOv8/YOLO11", _CENTRES, _PLAIN),
    "yolov8-corners": ("YOLOv8/YOLO11", _CORNERS, _PLAIN),
    "yolov8-fractions": ("YOLOv8/YOLO11", _CENTRE_FRACTIONS, _PLAIN),
    "picodet": ("PicoDet", _BINS8, _PICODET),
    "nanodet-levels": ("NanoDet", _BINS8, _NANODET),
    "rtmdet-heads": ("RTMDet", _DISTANCES, _RTMDET),
    "yolov8-pairs": ("YOLOv8/YOLO11", _BINS16, _PLAIN),
    "yolox-heads": ("YOLOX", _OFFSETS, _YOLOX),
    "yolov8-heads": ("YOLOv8/YOLO11", _BINS16, _PLAIN),
    "yolov4-boxes": ("YOLOv4", _FRACTIONS, _DARKNET),
    "yolo-nas": ("YOLO-NAS/DAMO-YOLO/YOLO-World", _CORNERS, _PLAIN),
    "boxes-centres": ("boxes and scores", _CENTRES, _PLAIN),
    "boxes-centres-fractions": ("boxes and scores", _CENTRE_FRACTIONS, _PLAIN),
    "ssd": ("SSD", _FRACTIONS, _SSD),
    "ssd-last": ("SSD", _FRACTIONS, _SSD),
    "ssd-pixels": ("SSD", _CORNERS, _SSD),
    "ssd-pixels-last": ("SSD", _CORNERS, _SSD),
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


_GRIDS = (
    _Kind("yolov5 yolov5-fractions", has_objectness=True, n_anchors=_ANCHORS_PER_CELL),
    _Kind("nanodet", n_box=32, n_levels=(3,)),
    _Kind("nanodet-plus", n_box=32, n_levels=(4,)),
    _Kind("yolox yolox-decoded yolov6", has_objectness=True),
    _Kind("yolov8-rows ppyoloe yolov8-rows-fractions"),
    _Kind("yolov8 yolov8-corners yolov8-fractions", is_transposed=True),
)
_LEVELS = (  # by number of dimensions; boxes and scores apart, then in one output for each stride
    (3, _Kind("picodet", n_box=32, n_levels=(4,))),
    (3, _Kind("nanodet-levels", n_box=32, n_levels=(3,))),
    (4, _Kind("rtmdet-heads", n_levels=(3,))),
    (4, _Kind("yolov8-pairs", n_box=64, n_levels=(3,))),
    (4, _Kind("yolox-heads", has_objectness=True, n_levels=(3,))),
    (4, _Kind("yolov8-heads", n_box=64, n_levels=(3,))),
)
_N_APART = 4  # number of kinds above with boxes and scores apart
_PAIRS = "yolov4-boxes yolo-nas boxes-centres boxes-centres-fractions"
_SSD_PAIRS = "ssd ssd-last ssd-pixels ssd-pixels-last"
GRID_NAMES = " ".join(kind.names for kind in _GRIDS)
LEVEL_NAMES = " ".join(
    kind.names if n == 3 else f"{kind.names} {kind.names}-activated" for n, kind in _LEVELS
)
PAIR_NAMES = f"{_PAIRS} {_SSD_PAIRS}"


def grid_boxes(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Readings of one output with the boxes of all cells."""
    for i, n_rows, n_columns in network.matrices():
        for kind in _GRIDS:
            n, width = (n_columns, n_rows) if kind.is_transposed else (n_rows, n_columns)
            is_binned = kind.n_box > 4  # boxes after the classes, and numbers of cells rounded up
            strides = network.grid_strides(n, kind.n_anchors, is_rounded_up=is_binned)
            first = 0 if is_binned else 4 + kind.has_objectness
            if (
                strides is None
                or len(strides) not in kind.n_levels
                or width <= kind.n_box + kind.has_objectness
            ):
                continue
            n_classes, note = (width - 32, "") if is_binned else _n_classes(network, width - first)
            cells = GridCells.of(network.input_hw, strides, kind.n_anchors, is_rounded_up=is_binned)
            part = partial(Part, i, n_anchors=int(kind.is_transposed))
            for name in kind.names.split():
                family, code, form = _READINGS[name]
                rows = BoxRows(
                    boxes=part(slice(n_classes, None) if is_binned else slice(0, 4)),
                    objectness=part(slice(4, 5)) if kind.has_objectness else None,
                    scores=part(slice(first, first + n_classes)),
                    code=_CODES[code](network, cells),
                    cell_px=cells.points_px(),
                )
                is_tiny = kind.n_anchors == _ANCHORS_PER_CELL and len(strides) == 2
                family, form = ("YOLOv4-tiny", _DARKNET) if is_tiny else (family, form)
                layout = f"boxes of all cells {list(network.shapes[i])}: {code}"
                model = _model(family, name, layout, n_classes, form, [rows])
                accepts = (
                    partial(_has_constant_objectness, i, name == "yolov6")
                    if name in _OBJECTNESS
                    else None
                )
                yield replace(model, note=note, accepts=accepts)


_OBJECTNESS = ("yolox-decoded", "yolov6")  # readings that differ by it: it is 1 in YOLOv6


def _has_constant_objectness(output: int, expected: bool, outputs: Sequence[FloatArray32]) -> bool:
    return bool((outputs[output][0, :, 4] > 0.999).all()) == expected


def _model(
    family: str,
    name: str,
    layout: str,
    n_classes: int,
    form: InputFormat,
    levels: Sequence[BoxRows],
) -> YoloModel:
    return YoloModel(family, layout, n_classes, form, partial(decode_rows, levels), name=name)


def levels_apart(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Readings of the cells of each stride in one output, or in two, boxes and scores, in any
    order.
    """
    shapes = network.shapes
    for number, (n_dimensions, kind) in enumerate(_LEVELS):
        if any(len(shape) != n_dimensions or shape[0] != 1 for shape in shapes):
            continue
        is_apart, n_levels, name = number < _N_APART, kind.n_levels[0], kind.names
        family, code, form = _READINGS[name]
        levels, n_of_strides = [], 0
        for stride in STRIDES_PX[n_levels - 3]:
            cells = GridCells.of(network.input_hw, (stride,), is_rounded_up=True)
            of_stride = [
                i
                for i, s in enumerate(shapes)
                if (s[1] if n_dimensions == 3 else s[2] * s[3]) == len(cells.stride_px)
            ]
            n_of_strides += len(of_stride)
            parts = _parts_of(network, of_stride, kind, is_apart=is_apart)
            if parts is not None:
                boxes, scores, objectness = parts
                code_of = _CODES[code](network, cells)
                levels.append(
                    BoxRows(
                        boxes=boxes,
                        scores=scores,
                        objectness=objectness,
                        code=code_of,
                        cell_px=cells.points_px(),
                    )
                )
        if len(levels) != n_levels or n_of_strides != len(shapes):
            continue
        score_parts = [level.scores for level in levels]
        widths = {
            shapes[part.output][2 if n_dimensions == 3 else 1] - (part.columns.start or 0)
            for part in score_parts
        }
        layout = (
            f"boxes of {n_levels} strides "
            f"{shortened(', '.join(str(list(s)) for s in shapes), 60)}: {code}"
        )
        model = _model(family, name, layout, widths.pop(), form, levels)
        if widths:
            continue
        if n_dimensions == 3:
            yield replace(model, score_outputs=tuple(part.output for part in score_parts))
            continue
        logits = [replace(level, activation="sigmoid") for level in levels]
        decoder = partial(decode_rows, logits)
        yield replace(
            model, decoder=decoder, accepts=partial(_are_probabilities, score_parts, False)
        )
        yield replace(
            model, name=f"{name}-activated", accepts=partial(_are_probabilities, score_parts, True)
        )


def _parts_of(
    network: NetworkOutputs, outputs: Sequence[int], kind: _Kind, *, is_apart: bool
) -> tuple[Part, Part, Part | None] | None:
    """Boxes, scores and objectness of one stride; None if the outputs lack one of these."""
    is_planes = all(len(network.shapes[i]) == 4 for i in outputs)
    width = {i: network.shapes[i][1 if is_planes else 2] for i in outputs}
    part = partial(Part, n_anchors=int(is_planes))
    if not is_apart:
        first = kind.n_box + kind.has_objectness
        if len(outputs) != 1 or width[outputs[0]] <= first:
            return None
        objectness = part(outputs[0], slice(4, 5)) if kind.has_objectness else None
        return (
            part(outputs[0], slice(0, kind.n_box)),
            part(outputs[0], slice(first, None)),
            objectness,
        )
    # the scores come first if there are as many classes
    boxes = [i for i in outputs if width[i] == kind.n_box][-1:]
    # RKNN: and their sum
    scores = [i for i in outputs if i not in boxes and (len(outputs) == 2 or width[i] > 1)]
    return (part(boxes[0]), part(scores[0]), None) if len(boxes) == len(scores) == 1 else None


def _are_probabilities(
    parts: Sequence[Part], expected: bool, outputs: Sequence[FloatArray32]
) -> bool:
    return (
        all(
            scores.min() >= 0 and scores.max() <= 1.001 for scores in (p.of(outputs) for p in parts)
        )
        == expected
    )


def boxes_and_scores(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Readings of boxes [1, N, 1, 4] or [1, N, 4], and scores [1, N, C] or [1, C, N], in any order.

    The scores of SSD-like networks have a column more than there are names: the background, first
    or last.
    """
    for boxes, scores in ((0, 1), (1, 0)) if len(network.shapes) == 2 else ():
        box, score = network.shapes[boxes], network.shapes[scores]
        n_rows = box[1] if len(box) > 1 else 0
        is_box = box in ((1, n_rows, 1, 4), (1, n_rows, 4))
        if not is_box or len(score) != 3 or score[0] != 1 or n_rows not in score[1:]:
            continue
        is_transposed = score[1] != n_rows
        n_columns = score[1] if is_transposed else score[2]
        strides = network.grid_strides(n_rows)
        cells = GridCells.of(network.input_hw, strides or ())
        part = Part(scores, n_anchors=int(is_transposed))
        is_tiny = n_rows == _ANCHORS_PER_CELL * network.n_cells((16, 32))
        has_background = n_columns - 1 in (network.n_names, *(() if network.n_names else (80, 20)))
        for name in (_SSD_PAIRS if has_background else _PAIRS).split():
            family, code, form = _READINGS[name]
            is_last = name.endswith("-last")
            kept, other = (
                (slice(0, -1), slice(-1, None)) if is_last else (slice(1, None), slice(0, 1))
            )
            rows = BoxRows(
                boxes=Part(boxes),
                scores=part,
                code=_CODES[code](network, cells),
                classes=kept if has_background else slice(None),
                cell_px=cells.points_px() if strides else None,
            )
            family = "YOLOv4-tiny" if is_tiny and family == "YOLOv4" else family
            layout = f"boxes {list(box)}: {code}, and scores {list(score)}"
            model = _model(family, name, layout, n_columns - has_background, form, [rows])
            yield replace(
                model, accepts=partial(_is_background, part, other) if has_background else None
            )


def _is_background(part: Part, column: slice, outputs: Sequence[FloatArray32]) -> bool:
    """Whether a column of the scores exceeds the other columns in most rows."""
    scores = part.of(outputs)
    return bool(np.mean(scores[:, column].max(axis=1) >= scores.max(axis=1)) > 0.5)


def anchor_heads(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Readings of two to four raw heads [1, A (5 + C), rows, columns] or [1, A, rows, columns, 5 +
    C].
    """
    shapes, metadata = network.shapes, network.metadata
    n_dimensions = {len(shape) for shape in shapes}
    if (
        len(shapes) not in (2, 3, 4)
        or n_dimensions not in ({4}, {5})
        or any(shape[0] != 1 for shape in shapes)
    ):
        return
    given = metadata.get("anchors", None, "")
    if given.value and (
        len(given.value) != len(shapes) or len({len(head) for head in given.value}) != 1
    ):
        raise ModelError(
            f"{network.path}: expected the same number of anchors for each of {len(shapes)} output "
            f"heads, got {shortened(', '.join(str(len(head)) for head in given.value))} "
            f"({given.source}); give --anchors 'w,h w,h w,h / w,h w,h w,h' in the order of the "
            "outputs."
        )
    n_anchors = len(given.value[0]) if given.value else _ANCHORS_PER_CELL
    is_separate = n_dimensions == {5}
    n_columns, rest = (
        (shapes[0][4], shapes[0][1] - n_anchors) if is_separate else divmod(shapes[0][1], n_anchors)
    )
    if len({shape[4 if is_separate else 1] for shape in shapes}) != 1 or rest or n_columns < 6:
        return
    tiny = ("darknet-heads", "YOLOv4-tiny", YOLOV4_TINY_ANCHORS[::-1], (1.0, 1.0), _DARKNET)
    darknet = ("darknet-heads", "YOLOv4", YOLOV4_ANCHORS, _YOLOV4_SCALES, _DARKNET)
    yolov5 = ("yolov5-heads", "YOLOv5", _YOLOV5_ANCHORS, (2.0,) * len(shapes), _PLAIN)
    is_coarse_first = shapes[0][3] < shapes[-1][3]
    is_scaled = metadata.get("scale_x_y", None, "").value is not None  # as only Darknet's heads are
    for name, family, anchors, scales, form in (tiny if len(shapes) == 2 else darknet, yolov5):
        is_darknet = name == "darknet-heads"
        if (is_separate if is_darknet else is_scaled) or (
            not given.value and len(anchors) != len(shapes)
        ):
            continue
        order = slice(None, None, -1 if is_coarse_first else 1)
        used = {
            "anchors": metadata.get("anchors", anchors[order], f"default of {family}"),
            "scale_x_y": metadata.get("scale_x_y", scales[order], f"default of {family}"),
        }
        scale = used["scale_x_y"].value
        if len(scale) not in (1, len(shapes)):
            raise ModelError(
                f"{network.path}: expected one scale_x_y for each of {len(shapes)} output heads, "
                f"got {shortened(str(list(scale)))} ({used['scale_x_y'].source})."
            )
        levels = []
        for i, (shape, anchor) in enumerate(zip(shapes, used["anchors"].value, strict=True)):
            size: Literal["exp", "square"] = "exp" if is_darknet else "square"
            cells = GridCells.of_grid(network.input_hw, shape[2:4], n_anchors)
            code = anchored(
                cells, np.array(anchor), scale_x_y=scale[i % len(scale)], size=size, is_logit=True
            )
            part = partial(Part, i, n_anchors=0 if is_separate else n_anchors)
            boxes, objectness, classes = part(slice(0, 4)), part(slice(4, 5)), part(slice(5, None))
            rows = BoxRows(
                boxes=boxes,
                objectness=objectness,
                scores=classes,
                code=code,
                cell_px=cells.points_px(),
            )
            levels.append(replace(rows, activation="sigmoid"))
        layout = (
            f"raw heads {', '.join(str(list(shape)) for shape in shapes)}: {n_anchors} anchors per "
            "cell"
        )
        yield replace(_model(family, name, layout, n_columns - 5, form, levels), attributes=used)


def fastest_heads(network: NetworkOutputs) -> Iterator[YoloModel]:
    """Reading of Yolo-FastestV2's two heads [1, rows, columns, 5 A + C] after sigmoid and softmax;
    A = 3.
    """
    height, width = network.input_hw
    n, shapes = _ANCHORS_PER_CELL, network.shapes
    n_classes = shapes[0][-1] - 5 * n
    if [shape[:-1] for shape in shapes] != [
        (1, height // s, width // s) for s in (16, 32)
    ] or n_classes < 1:
        return
    usual = [[(w * width / 352, h * height / 352) for w, h in head] for head in _FASTESTV2_ANCHORS]
    anchors = network.metadata.get("anchors", usual, "default of Yolo-FastestV2")
    levels = []
    for i, k in np.ndindex(2, n):
        cells = GridCells.of_grid(network.input_hw, shapes[i][1:3])
        levels.append(
            BoxRows(
                boxes=Part(i, slice(4 * k, 4 * k + 4)),
                objectness=Part(i, slice(4 * n + k, 4 * n + k + 1)),
                scores=Part(i, slice(5 * n, None)),
                code=anchored(
                    cells, np.array(anchors.value[i][k : k + 1]), size="square", is_logit=False
                ),
                cell_px=cells.points_px(),
            )
        )
    layout = (
        f"heads {list(shapes[0])}, {list(shapes[1])}: boxes and objectness of {n} anchors, classes"
    )
    form = replace(_STRETCHED, colours="bgr")
    yield _model("Yolo-FastestV2", "yolo-fastestv2", layout, n_classes, form, levels)


def _n_classes(network: NetworkOutputs, n_columns: int) -> tuple[int, str]:
    """Number of classes among the columns after the box, and a note on coefficients of masks or
    keypoints.
    """
    if (
        any(len(shape) == 4 and shape[:2] == (1, N_MASKS) for shape in network.shapes)
        and n_columns > N_MASKS
    ):
        return n_columns - N_MASKS, MASKS_NOTE
    n_keypoints = network.n_keypoints or (
        n_columns - 1 if network.n_names == 1 and n_columns % 3 == 1 else 0
    )
    return (
        (n_columns - n_keypoints, KEYPOINTS_NOTE)
        if 0 < n_keypoints < n_columns
        else (n_columns, "")
    )
