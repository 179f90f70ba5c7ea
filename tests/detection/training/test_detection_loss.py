import math

import pytest
import torch

from track_range.detection.training.losses.assignment import Cells, LabelledObjects
from track_range.detection.training.losses.detection_loss import (
    Batch,
    Completeness,
    DetectionLoss,
    TeacherOutputs,
)
from track_range.detection.training.networks.registry import make_network

SIDE = 64
HIGH_LOGIT = 12.0


def no_objects(*, ignored=()):
    boxes = torch.tensor([*ignored], dtype=torch.float32).reshape(-1, 4)
    n = len(boxes)
    return LabelledObjects(
        torch.zeros(n).long(), torch.zeros(n).long(), boxes, torch.ones(n).bool(), torch.ones(n)
    )


def one(cx, cy, w, h, class_index=0):
    boxes = torch.tensor([[cx, cy, w, h]], dtype=torch.float32)
    return LabelledObjects(
        torch.zeros(1).long(),
        torch.tensor([class_index]),
        boxes,
        torch.zeros(1).bool(),
        torch.ones(1),
    )


def batch(objects, *, teacher=None, is_complete=(True, True)):
    images = torch.zeros(1, 3, SIDE, SIDE, dtype=torch.uint8)
    flags = torch.tensor(is_complete).expand(1, 2, 2, 2)
    return Batch(images, objects, Completeness(flags, torch.zeros(1, 2)), teacher)


def background(network):
    """Raw outputs without objects, with high confidence."""
    heads = [
        torch.zeros(1, 3, SIDE // s, SIDE // s, 5 + network.n_classes) for s in network.strides_px
    ]
    for head in heads:
        head[..., 4] = -HIGH_LOGIT
    return heads


def numbers(losses):
    return tuple(float(losses[name]) for name in ("box", "objectness", "class"))


def logit(p):
    return math.log(p / (1 - p))


def perfect(network, objects):
    """Raw outputs that predict the objects exactly in all cells assigned to them, with class 0."""
    raw = background(network)
    from track_range.detection.training.losses.assignment import assign

    for head, stride in enumerate(network.strides_px):
        cells = assign(objects, network, head, raw[head].shape[2:4])
        box = objects.cxcywh[cells.object_index]
        cell = torch.stack([cells.column, cells.row], 1)
        xy = (box[:, :2] / stride - cell + 0.5) / 2
        wh = (box[:, 2:] / network.anchors_px[head][cells.anchor]).sqrt() / 2
        logits = torch.logit(torch.cat([xy, wh], 1).clamp(1e-6, 1 - 1e-6))
        raw[head][cells.image, cells.anchor, cells.row, cells.column, :4] = logits
        raw[head][cells.image, cells.anchor, cells.row, cells.column, 4] = HIGH_LOGIT
        raw[head][cells.image, cells.anchor, cells.row, cells.column, 5 + 0] = HIGH_LOGIT
        raw[head][cells.image, cells.anchor, cells.row, cells.column, 5 + 1] = -HIGH_LOGIT
    return raw


@pytest.fixture(scope="module")
def network():
    return make_network("yolov5n", 2)


def test_loss_of_perfect_predictions_is_zero(network):
    objects = one(27, 43, 16, 30)
    losses = DetectionLoss(network)(perfect(network, objects), batch(objects))
    assert numbers(losses) == pytest.approx((0, 0, 0), abs=1e-3)
    assert numbers(
        DetectionLoss(network)(background(network), batch(no_objects()))
    ) == pytest.approx((0, 0, 0), abs=1e-3)


def test_loss_parts_are_independent(network):
    objects = one(27, 43, 16, 30)
    loss = DetectionLoss(network)
    truth = perfect(network, objects)
    moved = [head.clone() for head in truth]
    moved[0][..., 2:4] += 1.0
    assert loss(moved, batch(objects))["box"] > 5e-3
    wrong_class = loss(truth, batch(one(27, 43, 16, 30, class_index=1)))
    assert wrong_class["class"] > 0.01
    assert wrong_class["box"] < 1e-3
    missed = loss(background(network), batch(objects))
    assert missed["objectness"] > 1e-3


def test_false_positive_by_hand(network):
    raw = background(network)
    # probability 0.5 for background: ln 2, in 1 of 3 * 64 cells, balance 4
    raw[0][0, 0, 0, 0, 4] = 0.0
    losses = DetectionLoss(network)(raw, batch(no_objects()))
    assert float(losses["objectness"]) == pytest.approx(
        4.0 * math.log(2) / (3 * 64) * (SIDE / 640) ** 2, rel=0.01
    )


def test_no_false_positives_in_ignored_boxes(network):
    raw = background(network)
    raw[0][0, :, 2:4, 2:4, 4] = HIGH_LOGIT  # pixels 16..32
    without_ignored = DetectionLoss(network)(raw, batch(no_objects()))
    with_ignored = DetectionLoss(network)(raw, batch(no_objects(ignored=[(24, 24, 16, 16)])))
    assert float(without_ignored["objectness"]) > 1e-3
    assert float(with_ignored["objectness"]) == pytest.approx(0.0, abs=1e-5)


def teacher_outputs(
    network, *, row=5, column=3, score=0.9, box=(27, 43, 16, 30), scores=(0.8, 0.1)
):
    """Outputs of a teacher that detects one object, in one cell of the finest head."""
    outputs = []
    for head, stride in enumerate(network.strides_px):
        objectness = torch.zeros(1, 3, SIDE // stride, SIDE // stride)
        n = 1 if head == 0 else 0
        where = [torch.full((n,), value).long() for value in (0, 1, row, column, 0)]
        if n:
            objectness[0, 1, row, column] = score
        boxes = torch.tensor([box] * n, dtype=torch.float32).reshape(n, 4)
        outputs.append(
            TeacherOutputs(
                objectness, Cells(*where), boxes, torch.tensor([scores] * n).reshape(n, 2)
            )
        )
    return outputs


def test_teacher_used_where_labels_incomplete(network):
    loss = DetectionLoss(network)
    incomplete = batch(no_objects(), teacher=teacher_outputs(network), is_complete=(False, True))
    agreeing = background(network)
    agreeing[0][0, 1, 5, 3, :] = torch.tensor([0, 0, 0, 0, logit(0.9), logit(0.8), logit(0.1)])
    centre = (27 / 8 - 3 + 0.5) / 2
    agreeing[0][0, 1, 5, 3, :2] = torch.tensor([logit(centre), logit(centre)])
    agreement, disagreement = loss(agreeing, incomplete), loss(background(network), incomplete)
    assert agreement["objectness"] < 0.2 * disagreement["objectness"]
    assert agreement["box"] < 1e-3
    assert disagreement["box"] > 1e-3


def test_teacher_ignored_where_labels_complete(network):
    loss = DetectionLoss(network)
    complete = batch(no_objects(), teacher=teacher_outputs(network), is_complete=(True, True))
    assert numbers(loss(background(network), complete)) == pytest.approx((0, 0, 0), abs=1e-3)


def test_label_box_overrides_teacher_box(network):
    objects = one(27, 43, 16, 30)
    shifted = batch(objects, teacher=teacher_outputs(network, box=(29, 45, 16, 30)))
    exact = batch(objects, teacher=teacher_outputs(network))
    raw = perfect(network, objects)
    loss = DetectionLoss(network)
    assert float(loss(raw, shifted)["box"]) == pytest.approx(
        float(loss(raw, exact)["box"]), abs=1e-6
    )


def test_eiou_differs_from_ciou(network):
    objects = one(27, 43, 16, 30)
    raw = perfect(network, objects)
    raw[0][..., 2] += 1.0
    ciou, eiou = (
        float(DetectionLoss(network, box_loss=name)(raw, batch(objects))["box"])
        for name in ("ciou", "eiou")
    )
    assert eiou != pytest.approx(ciou, rel=0.01)


def test_class_is_distilled_at_label_cells(network):
    objects = one(27, 43, 16, 30, class_index=0)
    raw = perfect(network, objects)
    loss = DetectionLoss(network)
    agreeing, differing = (
        batch(objects, teacher=teacher_outputs(network, scores=s)) for s in ((0.9, 0.1), (0.1, 0.9))
    )
    assert float(loss(raw, differing)["class"]) == pytest.approx(
        float(loss(raw, agreeing)["class"]), abs=1e-6
    )


def test_ignored_box_does_not_block_a_label(network):
    label = one(27, 43, 16, 30)
    both = LabelledObjects(
        *(
            torch.cat([getattr(no_objects(ignored=[(29, 45, 16, 30)]), n), getattr(label, n)])
            for n in ("image", "class_index", "cxcywh", "is_ignored", "confidence")
        )
    )
    raw = perfect(network, label)
    loss = DetectionLoss(network)
    shifted = loss(raw, batch(both, teacher=teacher_outputs(network, box=(29, 45, 16, 30))))
    assert float(shifted["box"]) == pytest.approx(0.0, abs=1e-3)


def test_labels_used_where_mosaic_is_complete(network):
    """A class that is complete only on the right: the teacher's car is learnt on the left, but not
    on the right."""
    flags = torch.zeros(1, 2, 2, 2, dtype=torch.bool)
    flags[0, :, 1] = True
    images = torch.zeros(1, 3, SIDE, SIDE, dtype=torch.uint8)
    loss = DetectionLoss(network)
    losses = {}
    for name, x in (("left of it", 20.0), ("right of it", 60.0)):
        complete = Completeness(flags, torch.tensor([[x, 0.0]]))  # the box's centre is at 27
        losses[name] = loss(
            background(network), Batch(images, no_objects(), complete, teacher_outputs(network))
        )
    assert float(losses["right of it"]["box"]) > 1e-3
    assert numbers(losses["left of it"]) == pytest.approx((0, 0, 0), abs=1e-3)
