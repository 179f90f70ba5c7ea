"""Networks with constant outputs that encode four known boxes in the layouts of public exporters.

The image is as large as the input, so that the boxes in the image are those of the input. Cells
near the centre of an object have its box and a score; the others have a box of two cells and a
score of 0.01, as trained networks do.
"""

from dataclasses import dataclass, field

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

SIDE = 320
OBJECTS = np.array(  # left, top, right, bottom, in the network's corner coordinates
    [[40, 60, 120, 110], [200, 100, 230, 190], [150, 180, 290, 300], [12, 20, 44, 42]], float
)
LABELS = np.array([2, 0, 7, 2])  # COCO's car, person, truck, car
SCORES = np.array([0.9, 0.8, 0.7, 0.6])
ROAD = np.array([2, 0, 5, 2])  # the same in `ROAD_CLASSES`, with truck = 5


@dataclass
class Case:
    """One network: outputs by name, and what else its file has."""

    outputs: dict
    metadata: dict = field(default_factory=dict)
    input_shape: tuple = (1, 3, SIDE, SIDE)
    input_type: int = TensorProto.FLOAT
    options: dict = field(default_factory=dict)
    note: str = ""  # word of a note
    variable: tuple = ()  # outputs whose number of rows is not declared


def write(path, case):
    """Write the network of a case."""
    nodes, weights, infos = [], [], []
    for name, array in case.outputs.items():
        array = np.asarray(array, np.int64 if np.asarray(array).dtype.kind in "iu" else np.float32)
        nodes.append(helper.make_node("Identity", [f"{name}_value"], [name]))
        weights.append(numpy_helper.from_array(array, f"{name}_value"))
        shape = [
            "n" if name in case.variable and side == len(OBJECTS) else side for side in array.shape
        ]
        number = TensorProto.INT64 if array.dtype.kind in "iu" else TensorProto.FLOAT
        infos.append(helper.make_tensor_value_info(name, number, shape))
    image = helper.make_tensor_value_info("images", case.input_type, case.input_shape)
    model = helper.make_model(
        helper.make_graph(nodes, "layout", [image], infos, weights),
        opset_imports=[helper.make_opsetid("", 13)],
    )
    model.ir_version = 9
    helper.set_model_props(model, case.metadata)
    onnx.save(model, path)
    return path


def centre_form(boxes):
    return np.concatenate([(boxes[:, :2] + boxes[:, 2:]) / 2, boxes[:, 2:] - boxes[:, :2]], axis=1)


@dataclass
class Grid:
    """Rows of all cells: for each its column, row, stride, object (or -1) and box."""

    strides: tuple = (8, 16, 32)
    n_anchors: int = 1
    side: int = SIDE

    def __post_init__(self):
        parts = []
        for stride in self.strides:
            n = self.side // stride
            row, column = (a.reshape(-1) for a in np.mgrid[:n, :n])
            cell = np.stack([column, row, np.full(n * n, stride)], axis=1).astype(float)
            parts += [np.column_stack([cell, np.full(n * n, a)]) for a in range(self.n_anchors)]
        cells = np.concatenate(parts)
        self.xy, self.stride, self.anchor = cells[:, :2], cells[:, 2:3], cells[:, 3].astype(int)
        self.centre = (self.xy + 0.5) * self.stride
        self.object = np.full(len(cells), -1)
        self.boxes = np.concatenate([self.centre - self.stride, self.centre + self.stride], axis=1)
        for k, box in enumerate(OBJECTS):
            wanted = np.sqrt(np.prod(box[2:] - box[:2])) / 4
            stride = min(self.strides, key=lambda s: abs(np.log(s / wanted)))
            near = np.abs(self.centre - (box[:2] + box[2:]) / 2).max(axis=1) <= 0.8 * stride
            chosen = near & (self.stride[:, 0] == stride)
            self.object[chosen], self.boxes[chosen] = k, box
        self.is_object = self.object >= 0
        self.score = np.where(self.is_object, SCORES[self.object], 0.01)
        self.distance = np.concatenate(
            [self.centre - self.boxes[:, :2], self.boxes[:, 2:] - self.centre], axis=1
        )

    def classes(self, n=80):
        """(N, n) the score of the object's class; 0.001 for other classes."""
        values = np.full((len(self.object), n), 0.001)
        labels = np.where(self.is_object, LABELS[self.object] % n, 0)
        values[np.arange(len(values)), labels] = self.score
        return values

    def planes(self, numbers):
        """The rows (N, k) as one array (1, A k, h, w) for each stride."""
        planes = []
        for stride in self.strides:
            n, rows = self.side // stride, numbers[self.stride[:, 0] == stride]
            planes.append(
                rows.reshape(self.n_anchors, n, n, -1).transpose(0, 3, 1, 2).reshape(1, -1, n, n)
            )
        return planes


def logit(p):
    p = np.clip(p, 1e-6, 1 - 1e-6)
    return np.log(p / (1 - p))


def bins(distance, stride, n):
    """Logits (N, 4 n) of distributions with the mean distance / stride, between two bins."""
    mean = np.clip(distance / stride, 0, n - 1.001)
    low = np.floor(mean).astype(int)
    logits = np.full((*mean.shape, n), -40.0)
    rows = np.indices(mean.shape)
    logits[(*rows, low)] = np.log(np.maximum(1 - (mean - low), 1e-12))
    logits[(*rows, low + 1)] = np.log(np.maximum(mean - low, 1e-12))
    return logits.reshape(len(mean), -1)


def one(array, **more):
    return Case({"output0": array[None]}, **more)


def rows(grid, numbers, objectness=None, **more):
    """[1, N, 4 (+ 1) + C]."""
    classes = grid.classes()
    if objectness is not None:
        classes = (
            np.where(grid.is_object[:, None] & (classes > 0.01), 1.0, 0.001)
            if objectness is grid.score
            else classes
        )
        numbers = np.column_stack([numbers, objectness])
    return one(np.column_stack([numbers, classes]), **more)


def split(boxes, scores, **more):
    return Case({"boxes": boxes[None], "scores": scores[None]}, **more)


def yolox_numbers(grid):
    cxcywh = centre_form(grid.boxes)
    return np.concatenate(
        [cxcywh[:, :2] / grid.stride - grid.xy, np.log(cxcywh[:, 2:] / grid.stride)], axis=1
    )


def anchor_numbers(grid, anchors, size, scale_x_y=2.0):
    """Logits of boxes relative to anchors (strides, A, 2), and logits of objectness and classes."""
    level = np.searchsorted(np.array(grid.strides), grid.stride[:, 0])
    anchor = np.array(anchors, float)[level, grid.anchor]
    cxcywh = centre_form(grid.boxes)
    offset = cxcywh[:, :2] / grid.stride - grid.xy
    xy = logit((offset + (scale_x_y - 1) / 2) / scale_x_y)
    ratio = cxcywh[:, 2:] / anchor
    wh = np.log(ratio) if size == "exp" else logit(np.sqrt(ratio) / 2)
    classes = np.where(grid.classes() > 0.01, 0.9999, 0.0001)
    return np.column_stack([xy, wh, logit(grid.score), logit(classes)])


V5_ANCHORS = (
    ((10, 13), (16, 30), (33, 23)),
    ((30, 61), (62, 45), (59, 119)),
    ((116, 90), (156, 198), (373, 326)),
)
V4_ANCHORS = (
    ((12, 16), (19, 36), (40, 28)),
    ((36, 75), (76, 55), (72, 146)),
    ((142, 110), (192, 243), (459, 401)),
)
FASTEST_ANCHORS = np.array(
    [
        [[12.64, 19.39], [37.88, 51.48], [55.71, 138.31]],
        [[126.91, 78.23], [131.57, 214.55], [279.92, 258.87]],
    ]
)
NAMES = {"names": str(dict(enumerate(["person", "car", "truck"])))}
ULTRALYTICS = {"task": "detect", "stride": "32"}


def three(grid):
    """(N, 3) scores of person, car, truck."""
    return grid.classes()[:, [0, 2, 7]]


def v5_rows(strides=(8, 16, 32), unit=1.0, extra=None, **more):
    grid = Grid(strides, 3)
    case = rows(grid, centre_form(grid.boxes) / unit, grid.score, **more)
    if extra is not None:
        array = case.outputs["output0"]
        case.outputs["output0"] = np.concatenate(
            [array, np.full((*array.shape[:2], extra), 3.0)], axis=2
        )
    return case


def v8(strides=(8, 16, 32), unit=1.0, form=centre_form, is_rows=False, extra=0, **more):
    grid = Grid(strides)
    array = np.column_stack(
        [form(grid.boxes) / unit, grid.classes(), np.full((len(grid.object), extra), 3.0)]
    )
    return one(array if is_rows else array.T, **more)


def corner_form(boxes):
    return boxes


def with_masks(case):
    case.outputs["proto"] = np.zeros((1, 32, SIDE // 4, SIDE // 4))
    case.note = "Masks"
    return case


def pose():
    grid = Grid()
    array = np.column_stack(
        [centre_form(grid.boxes), grid.score, np.full((len(grid.object), 51), 3.0)]
    )
    metadata = {"task": "pose", "kpt_shape": "[17, 3]", "names": "{0: 'person'}"}
    return one(array.T, metadata=metadata, note="Keypoints")


def boxes_scores(
    unit=1.0, form=corner_form, strides=(8, 16, 32), is_first=True, background="", **more
):
    grid = Grid(strides)
    scores = grid.classes()
    if background:
        column = (1 - grid.score)[:, None]
        scores = np.concatenate(
            [column, scores] if background == "first" else [scores, column], axis=1
        )
    outputs = {"boxes": (form(grid.boxes) / unit)[None], "scores": scores[None]}
    return Case(outputs if is_first else dict(reversed(outputs.items())), **more)


def paddle_split():
    grid = Grid()
    return split(grid.boxes, grid.classes().T)


def raw_heads(anchors, size, scale=2.0, is_separate=False, **more):
    grid = Grid(n_anchors=3)
    planes = grid.planes(anchor_numbers(grid, anchors, size, scale))
    if is_separate:
        planes = [p.reshape(1, 3, 85, *p.shape[2:]).transpose(0, 1, 3, 4, 2) for p in planes]
    return Case({f"head{i}": p for i, p in enumerate(planes)}, **more)


def free(kind, is_logit=True):
    grid = Grid()
    scores = logit(grid.classes()) if is_logit else grid.classes()
    if kind == "rtmdet":
        pairs = zip(
            grid.planes(scores),
            grid.planes(
                np.concatenate(
                    [
                        grid.xy * grid.stride - grid.boxes[:, :2],
                        grid.boxes[:, 2:] - grid.xy * grid.stride,
                    ],
                    axis=1,
                )
            ),
            strict=True,
        )
        return Case(
            {
                f"{name}{i}": p
                for i, pair in enumerate(pairs)
                for name, p in zip(("cls", "box"), pair, strict=True)
            }
        )
    if kind == "yolox":
        numbers = np.column_stack(
            [yolox_numbers(grid), grid.score, np.where(grid.classes() > 0.01, 1, 0.0)]
        )
        return Case({f"head{i}": p for i, p in enumerate(grid.planes(numbers))})
    box = bins(grid.distance, grid.stride, 16)
    if kind == "v8":
        return Case(
            {f"head{i}": p for i, p in enumerate(grid.planes(np.column_stack([box, scores])))}
        )
    sums = grid.classes().sum(axis=1, keepdims=True)
    parts = {"box": box, "score": scores, "sum": sums}
    return Case({f"{k}{i}": p for k, v in parts.items() for i, p in enumerate(grid.planes(v))})


def nanodet(strides=(8, 16, 32)):
    grid = Grid(strides)
    offset = 0.5 if len(strides) == 3 else 0.0
    point = (grid.xy + offset) * grid.stride
    distance = np.concatenate([point - grid.boxes[:, :2], grid.boxes[:, 2:] - point], axis=1)
    return one(np.column_stack([grid.classes(), bins(distance, grid.stride, 8)]))


def fastest():
    outputs = {}
    for level, stride in enumerate((16, 32)):
        n = SIDE // stride
        grid = Grid((16, 32), 3)
        of_level = grid.stride[:, 0] == stride
        anchors = FASTEST_ANCHORS[level] * SIDE / 352
        offset = centre_form(grid.boxes)[:, :2] / grid.stride - grid.xy
        best = (
            np.abs(np.log(centre_form(grid.boxes)[:, None, 2:] / anchors))
            .max(axis=2)
            .argmin(axis=1)
        )
        ratio = centre_form(grid.boxes)[:, 2:] / anchors[grid.anchor]
        numbers = np.column_stack([(offset + 0.5) / 2, np.sqrt(ratio) / 2])
        objectness = np.where(grid.anchor == best, grid.score, 0.01)
        box = numbers[of_level].reshape(3, n, n, 4).transpose(1, 2, 0, 3).reshape(n, n, 12)
        obj = objectness[of_level].reshape(3, n, n).transpose(1, 2, 0)
        classes = np.where(grid.classes() > 0.01, 1.0, 0.0)[of_level].reshape(3, n, n, 80)[0]
        outputs[f"out{level}"] = np.concatenate([box, obj, classes], axis=2)[None]
    return Case(outputs)


def labelled(*columns, n=4, unit=1.0, is_batched=True, is_variable=False, extra=0, **more):
    """Rows with the columns b(atch), x (box), s(core), l(abel)."""
    values = {"b": np.zeros(4), "x": OBJECTS / unit, "s": SCORES, "l": LABELS}
    array = np.column_stack([values[c] for c in columns])
    array = np.column_stack([array, np.full((4, extra), 0.3)])
    padded = np.zeros((n, array.shape[1]))
    padded[:4] = array
    padded = padded[None] if is_batched else padded
    return Case({"output0": padded}, variable=("output0",) if is_variable else (), **more)


def suppressed(unit=1.0, is_tf=False, n=20):
    box, score, label = np.zeros((n, 4)), np.zeros(n), np.zeros(n, int)
    box[:4], score[:4], label[:4] = OBJECTS / unit, SCORES, LABELS
    if is_tf:
        box = box[:, [1, 0, 3, 2]]
        categories = np.where(label == 7, 8, label + 1) if is_tf else label
        outputs = {
            "detection_boxes": box[None],
            "detection_classes": categories[None].astype(float),
        }
        outputs |= {"detection_scores": score[None], "num_detections": np.array([4.0])}
        return Case(outputs, input_shape=(1, SIDE, SIDE, 3), input_type=TensorProto.UINT8)
    return Case(
        {
            "num_dets": np.array([[4]]),
            "boxes": box[None],
            "scores": score[None],
            "labels": label[None],
        }
    )


def torchvision():
    categories = np.where(LABELS == 7, 8, LABELS + 1)
    return Case(
        {"boxes": OBJECTS, "labels": categories, "scores": SCORES},
        variable=("boxes", "labels", "scores"),
    )


def mmdet(is_variable=False):
    dets = np.column_stack([OBJECTS, SCORES])[None]
    return Case(
        {"dets": dets, "labels": LABELS[None]}, variable=("dets", "labels") if is_variable else ()
    )


def v6(strides=(8, 16, 32)):
    grid = Grid(strides)
    return rows(grid, centre_form(grid.boxes), np.ones(len(grid.object)))


def yolox(form):
    grid = Grid()
    return rows(grid, yolox_numbers(grid) if form == "raw" else centre_form(grid.boxes), grid.score)


CASES = {  # by title: layout, case
    "YOLOv5": ("yolov5", v5_rows),
    "YOLOv5-p6 (YOLOv7-w6 with grid)": ("yolov5", lambda: v5_rows((8, 16, 32, 64))),
    "YOLOv5-p2": ("yolov5", lambda: v5_rows((4, 8, 16, 32))),
    "YOLOv3-tiny (YOLOv5's code)": ("yolov5", lambda: v5_rows((16, 32))),
    "YOLOv5, fractions (from TensorFlow)": ("yolov5-fractions", lambda: v5_rows(unit=SIDE)),
    "YOLOv7 with grid, three classes": (
        "yolov5",
        lambda: one(
            np.column_stack(
                [
                    centre_form((g := Grid(n_anchors=3)).boxes),
                    g.score,
                    np.where(three(g) > 0.01, 1, 0.001),
                ]
            ),
            metadata=NAMES,
        ),
    ),
    "YOLOv5-seg": ("yolov5", lambda: with_masks(v5_rows(extra=32))),
    "YOLOX, raw": ("yolox", lambda: yolox("raw")),
    "YOLOX with --decode_in_inference": ("yolox-decoded", lambda: yolox("decoded")),
    "YOLOv6": ("yolov6", v6),
    "YOLOv6-P6": ("yolov6", lambda: v6((8, 16, 32, 64))),
    "YOLOv8, YOLO11": ("yolov8", v8),
    "YOLOv8-p2": ("yolov8", lambda: v8((4, 8, 16, 32))),
    "YOLOv8-p6": ("yolov8", lambda: v8((8, 16, 32, 64))),
    "YOLOv3-tiny-u": ("yolov8", lambda: v8((16, 32))),
    "YOLOv8, fractions": ("yolov8-fractions", lambda: v8(unit=SIDE)),
    "YOLOv8, corners": ("yolov8-corners", lambda: v8(form=corner_form)),
    "YOLOv8, transposed": ("yolov8-rows", lambda: v8(is_rows=True)),
    "YOLOv8, transposed, fractions": ("yolov8-rows-fractions", lambda: v8(is_rows=True, unit=SIDE)),
    "YOLOv8-p2, transposed": ("yolov8-rows", lambda: v8((4, 8, 16, 32), is_rows=True)),
    "YOLOv8-seg": ("yolov8", lambda: with_masks(v8(extra=32, metadata={"task": "segment"}))),
    "YOLOv8-pose": ("yolov8", pose),
    "PP-YOLOE without postprocessing": ("ppyoloe", lambda: v8(is_rows=True, form=corner_form)),
    "PP-YOLOE without NMS": ("yolo-nas", paddle_split),
    "YOLO-NAS": ("yolo-nas", boxes_scores),
    "DAMO-YOLO (scores first)": ("yolo-nas", lambda: boxes_scores(is_first=False)),
    "YOLO-World, four strides": ("yolo-nas", lambda: boxes_scores(strides=(8, 16, 32, 64))),
    "YOLOv4, decoded": ("yolov4-boxes", lambda: boxes_scores(unit=SIDE)),
    "boxes as centres, and scores": ("boxes-centres", lambda: boxes_scores(form=centre_form)),
    "SSD, background first": ("ssd", lambda: boxes_scores(unit=SIDE, background="first")),
    "SSD, background last, pixels": ("ssd-pixels-last", lambda: boxes_scores(background="last")),
    "NanoDet": ("nanodet", nanodet),
    "NanoDet-Plus": ("nanodet-plus", lambda: nanodet((8, 16, 32, 64))),
    "YOLOv4 raw heads": (
        "darknet-heads",
        lambda: raw_heads(V4_ANCHORS, "exp", metadata={"scale_x_y": "[2.0]"}),
    ),
    "YOLOv5 or YOLOv7 raw heads (5 axes)": (
        "yolov5-heads",
        lambda: raw_heads(V5_ANCHORS, "square", is_separate=True),
    ),
    "YOLOv5 raw heads (4 axes), --layout": (
        "yolov5-heads",
        lambda: raw_heads(V5_ANCHORS, "square", options={"layout": "yolov5-heads"}),
    ),
    "Yolo-FastestV2": ("yolo-fastestv2", fastest),
    "RTMDet without NMS": ("rtmdet-heads", lambda: free("rtmdet")),
    "RTMDet without NMS, sigmoid inside": (
        "rtmdet-heads-activated",
        lambda: free("rtmdet", is_logit=False),
    ),
    "YOLOv8 raw heads": ("yolov8-heads", lambda: free("v8")),
    "YOLOv8 of RKNN (box, score, sum)": (
        "yolov8-pairs-activated",
        lambda: free("rknn", is_logit=False),
    ),
    "YOLOX heads of RKNN": ("yolox-heads-activated", lambda: free("yolox")),
    "YOLOv10, YOLO26": ("yolov10", lambda: labelled("x", "s", "l", n=300)),
    "rows [N, 6] without batch axis": (
        "yolov10",
        lambda: labelled("x", "s", "l", is_batched=False, is_variable=True),
    ),
    "rows [1, N, 6], fractions": (
        "yolov10-fractions",
        lambda: labelled("x", "s", "l", n=300, unit=SIDE),
    ),
    "YOLO26-seg": (
        "yolov10",
        lambda: with_masks(labelled("x", "s", "l", n=300, extra=32, metadata={"task": "segment"})),
    ),
    "PaddleDetection's rows": (
        "paddle-rows",
        lambda: labelled("l", "s", "x", is_batched=False, is_variable=True),
    ),
    "YOLOv7 --end2end": (
        "yolov7-end2end",
        lambda: labelled("b", "x", "l", "s", is_batched=False, is_variable=True),
    ),
    "YOLO-NAS, flat format": (
        "yolo-nas-flat",
        lambda: labelled("b", "x", "s", "l", is_batched=False, is_variable=True),
    ),
    "suppression: number, boxes, scores, labels": ("end2end", suppressed),
    "the same, fractions": ("end2end-fractions", lambda: suppressed(unit=SIDE)),
    "TensorFlow's detection API": ("tf-detections", lambda: suppressed(unit=SIDE, is_tf=True)),
    "MMDeploy (boxes with scores, labels)": ("mmdet", mmdet),
    "MMDeploy, variable number": ("mmdet", lambda: mmdet(is_variable=True)),
    "torchvision": ("torchvision", torchvision),
    "YOLOv8, input [1, height, width, 3]": ("yolov8", lambda: v8(input_shape=(1, SIDE, SIDE, 3))),
    "YOLOv8, grey input": ("yolov8", lambda: v8(input_shape=(1, 1, SIDE, SIDE))),
    "YOLO-NAS, input of uint8": ("yolo-nas", lambda: boxes_scores(input_type=TensorProto.UINT8)),
}
"""Networks by title: name of the reading, and function that makes the case."""
