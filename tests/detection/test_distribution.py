"""NanoDet and PicoDet in the layouts of their exporters, against the arithmetic of their heads,
step by step.

The reference follows NanoDet's GFLHead and NanoDetPlusHead and PaddleDetection's PicoHead
(Integral, distance2bbox, center points) without code of track-range.
"""

import math

import numpy as np
import pytest

from tests.support.networks.onnx_models import write_outputs
from track_range.detection.classes import COCO_CLASSES, VOC_CLASSES
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.detection.yolo.metadata import ModelOptions

INPUT_HW = (64, 96)  # not divisible by stride 64
IMAGE = np.random.default_rng(0).integers(0, 256, (64, 96, 3), np.uint8)
CAR, PERSON, BUS = COCO_CLASSES.index("car"), 0, 5
ROAD_OF = {CAR: 2, PERSON: 0, BUS: 4}


def cells(stride):
    return math.ceil(INPUT_HW[0] / stride), math.ceil(INPUT_HW[1] / stride)


def head(stride, *, n_classes=80, seed=0):
    """Scores (n, C), a sixth of the cells with an object, and bins (n, 32) of one stride."""
    rng = np.random.default_rng([seed, stride])
    n = math.prod(cells(stride))
    scores = rng.uniform(0, 0.05, (n, n_classes))
    for cell in rng.choice(n, max(n // 6, 1), replace=False):
        scores[cell, rng.choice([label for label in ROAD_OF if label < n_classes])] = rng.uniform(
            0.2, 0.9
        )
    return scores, rng.normal(0, 2, (n, 32))


def reference(heads, *, offset):
    """All boxes with a score of at least 0.1: (left, top, right, bottom, score, label)."""
    rows = []
    for stride, (scores, bins) in heads.items():
        n_rows, n_columns = cells(stride)
        for cell, (score, t) in enumerate(zip(scores.tolist(), bins.tolist(), strict=True)):
            row, column = divmod(cell, n_columns)
            assert row < n_rows
            x, y = (column + offset) * stride, (row + offset) * stride
            distance = []
            for side in range(4):
                powers = [math.exp(value) for value in t[8 * side : 8 * side + 8]]
                distance.append(
                    stride * sum(k * power for k, power in enumerate(powers)) / sum(powers)
                )
            box = [x - distance[0], y - distance[1], x + distance[2], y + distance[3]]
            box = [min(max(value, 0), INPUT_HW[1 - i % 2]) for i, value in enumerate(box)]
            label = max(range(len(score)), key=score.__getitem__)
            if score[label] >= 0.1:
                rows.append([*box, score[label], label])
    return np.array(rows)


def candidates(detector):
    """All boxes of IMAGE before non-maximum suppression, as the reference has them."""
    detector.fill(IMAGE)
    found = detector.model.decoder(detector.infer(), detector._min_score)
    return np.column_stack([found.xyxy_net, found.score, found.class_index])


def assert_same_rows(rows, expected):
    assert len(rows) == len(expected) >= 10
    np.testing.assert_allclose(
        rows[rows[:, 4].argsort()], expected[expected[:, 4].argsort()], atol=1e-4
    )


def written(path, outputs, **options):
    model = write_outputs(path / "m.onnx", outputs, inputs={"input.1": (1, 3, *INPUT_HW)})
    return YoloDetector(model, YoloSettings(min_score=0.1), options=ModelOptions(**options))


@pytest.mark.parametrize(
    ("strides", "family", "colours", "letterbox"),
    [((8, 16, 32), "NanoDet", "bgr", "centred-0"), ((8, 16, 32, 64), "PicoDet", "rgb", "stretch")],
)
@pytest.mark.parametrize("order", ["scores first", "by stride", "reversed"])
def test_scores_and_bins_of_each_stride(tmp_path, strides, family, colours, letterbox, order):
    heads = {stride: head(stride) for stride in strides}
    by_stride = [
        (f"{stride}{kind}", heads[stride][i][None])
        for stride in strides
        for i, kind in enumerate("sb")
    ]
    outputs = {
        "scores first": by_stride[::2] + by_stride[1::2],
        "by stride": by_stride,
        "reversed": by_stride[::-1],
    }[order]
    detector = written(tmp_path, {str(number): array for number, (_, array) in enumerate(outputs)})
    assert_same_rows(candidates(detector), reference(heads, offset=0.5))
    model = detector.model
    assert (model.family, model.input_format.colours, model.input_format.letterbox) == (
        family,
        colours,
        letterbox,
    )
    assert (model.names, model.is_end_to_end) == (COCO_CLASSES, False)


@pytest.mark.parametrize(
    ("strides", "offset", "family"),
    [((8, 16, 32, 64), 0.0, "NanoDet-Plus"), ((8, 16, 32), 0.5, "NanoDet")],
)
def test_one_output_for_all_strides(tmp_path, strides, offset, family):
    heads = {stride: head(stride, seed=1) for stride in strides}
    rows = np.concatenate([np.hstack(heads[stride]) for stride in strides])
    detector = written(tmp_path, {"output": rows[None]})
    assert_same_rows(candidates(detector), reference(heads, offset=offset))
    assert detector.model.family == family


def test_as_many_classes_as_bins(tmp_path):
    heads = {stride: head(stride, n_classes=32, seed=2) for stride in (8, 16, 32)}
    outputs = {
        f"{stride}{kind}": heads[stride][i][None] for i, kind in enumerate("sb") for stride in heads
    }
    detector = written(tmp_path, outputs, names=COCO_CLASSES[:32])
    assert_same_rows(candidates(detector), reference(heads, offset=0.5))


def test_input_of_nanodet(tmp_path):
    heads = {stride: head(stride) for stride in (8, 16, 32)}
    outputs = {
        f"{stride}{kind}": heads[stride][i][None] for i, kind in enumerate("sb") for stride in heads
    }
    blob = written(tmp_path, outputs).input_blob(IMAGE)
    # _normalize() of NanoDet's transform/color.py, on BGR images
    expected = (IMAGE - np.array([103.53, 116.28, 123.675])) / [57.375, 57.12, 58.395]
    np.testing.assert_allclose(blob[0], expected.transpose(2, 0, 1), atol=1e-5)
    padded = written(tmp_path, outputs).input_blob(IMAGE[:32])
    np.testing.assert_allclose(
        padded[0, :, 0, 0],
        -np.array([103.53, 116.28, 123.675]) / [57.375, 57.12, 58.395],
        rtol=1e-5,
    )


def test_yolox_rows_of_the_same_shape(tmp_path):
    n = sum(math.prod(cells(stride)) for stride in (8, 16, 32))
    rows = {"output": np.zeros((1, n, 85))}
    assert written(tmp_path, rows).model.family == "YOLOX"
    classes = ("car", *(f"class {i}" for i in range(79)), *VOC_CLASSES[:7])
    assert (
        written(tmp_path, {"output": np.zeros((1, n, 5 + 87))}, names=classes).model.family
        == "YOLOX"
    )
    assert (
        written(tmp_path, {"output": np.zeros((1, n, 32 + 87))}, names=classes).model.family
        == "NanoDet"
    )


@pytest.mark.parametrize("missing", [0, 3])
def test_incomplete_heads(tmp_path, missing):
    heads = [array[None] for stride in (8, 16, 32) for array in head(stride)]
    heads[missing] = np.zeros((1, 7, 80))
    with pytest.raises(ModelError, match=r"m\.onnx: .*NanoDet"):
        written(tmp_path, {str(i): array for i, array in enumerate(heads)})
