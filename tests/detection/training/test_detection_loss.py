import math

import pytest
import torch

from track_range.detection.training.losses.assignment import Cells, Objects
from track_range.detection.training.losses.detection_loss import Batch, Completeness, DetectionLoss
from track_range.detection.training.networks.registry import make_network
from track_range.detection.training.teacher import HeadAnswers

SIDE = 64
SURE = 12.0


def nobody(*, ignored=()):
    boxes = torch.tensor([*ignored], dtype=torch.float32).reshape(-1, 4)
    n = len(boxes)
    return Objects(torch.zeros(n).long(), torch.zeros(n).long(), boxes, torch.ones(n).bool())


def one(cx, cy, w, h, class_index=0):
    boxes = torch.tensor([[cx, cy, w, h]], dtype=torch.float32)
    return Objects(torch.zeros(1).long(), torch.tensor([class_index]), boxes, torch.zeros(1).bool())


def batch(objects, *, answers=None, is_complete=(True, True)):
    images = torch.zeros(1, 3, SIDE, SIDE, dtype=torch.uint8)
    flags = torch.tensor(is_complete).expand(1, 2, 2, 2)
    return Batch(images, objects, Completeness(flags, torch.zeros(1, 2)), answers)


def silent(network):
    """Raw outputs that are sure of nothing being there."""
    heads = [torch.zeros(1, 3, SIDE // s, SIDE // s, 5 + network.n_classes) for s in network.strides_px]
    for head in heads:
        head[..., 4] = -SURE
    return heads


def logit(p):
    return math.log(p / (1 - p))


def perfect(network, objects):
    """Raw outputs that say an object of 16 x 30 in the cells that are to find it, in the finest head."""
    raw = silent(network)
    from track_range.detection.training.losses.assignment import assign

    for head, stride in enumerate(network.strides_px):
        cells = assign(objects, network, head, raw[head].shape[2:4])
        box = objects.cxcywh[cells.of]
        cell = torch.stack([cells.column, cells.row], 1)
        xy = (box[:, :2] / stride - cell + 0.5) / 2
        wh = (box[:, 2:] / network.anchors_px[head][cells.anchor]).sqrt() / 2
        told = torch.logit(torch.cat([xy, wh], 1).clamp(1e-6, 1 - 1e-6))
        raw[head][cells.image, cells.anchor, cells.row, cells.column, :4] = told
        raw[head][cells.image, cells.anchor, cells.row, cells.column, 4] = SURE
        raw[head][cells.image, cells.anchor, cells.row, cells.column, 5 + 0] = SURE
        raw[head][cells.image, cells.anchor, cells.row, cells.column, 5 + 1] = -SURE
    return raw


@pytest.fixture(scope="module")
def network():
    return make_network("yolov5n", 2)


def test_loss_of_perfect_predictions_is_zero(network):
    objects = one(27, 43, 16, 30)
    losses = DetectionLoss(network)(perfect(network, objects), batch(objects))
    assert losses.numbers() == pytest.approx((0, 0, 0), abs=1e-3)
    assert DetectionLoss(network)(silent(network), batch(nobody())).numbers() == pytest.approx((0, 0, 0), abs=1e-3)


def test_loss_parts_are_independent(network):
    objects = one(27, 43, 16, 30)
    loss = DetectionLoss(network)
    truth = perfect(network, objects)
    moved = [head.clone() for head in truth]
    moved[0][..., 2:4] += 1.0
    assert loss(moved, batch(objects)).box > 5e-3
    wrong_class = loss(truth, batch(one(27, 43, 16, 30, class_index=1)))
    assert wrong_class.class_score > 0.01
    assert wrong_class.box < 1e-3
    missed = loss(silent(network), batch(objects))
    assert missed.objectness > 1e-3


def test_false_positive_by_hand(network):
    raw = silent(network)
    raw[0][0, 0, 0, 0, 4] = 0.0  # says 0.5 where nothing is: ln 2, in 1 of 3 * 64 cells, balance 4
    losses = DetectionLoss(network)(raw, batch(nobody()))
    assert float(losses.objectness) == pytest.approx(4.0 * math.log(2) / (3 * 64) * (SIDE / 640) ** 2, rel=0.01)


def test_no_false_positives_in_ignored_boxes(network):
    raw = silent(network)
    raw[0][0, :, 2:4, 2:4, 4] = SURE  # pixels 16..32
    loud = DetectionLoss(network)(raw, batch(nobody()))
    told = DetectionLoss(network)(raw, batch(nobody(ignored=[(24, 24, 16, 16)])))
    assert float(loud.objectness) > 1e-3
    assert float(told.objectness) == pytest.approx(0.0, abs=1e-5)


def answers(network, *, row=5, column=3, sure=0.9, box=(27, 43, 16, 30), scores=(0.8, 0.1)):
    """A teacher that sees one object, in one cell of the finest head."""
    told = []
    for head, stride in enumerate(network.strides_px):
        objectness = torch.zeros(1, 3, SIDE // stride, SIDE // stride)
        n = 1 if head == 0 else 0
        where = [torch.full((n,), value).long() for value in (0, 1, row, column, 0)]
        if n:
            objectness[0, 1, row, column] = sure
        boxes = torch.tensor([box] * n, dtype=torch.float32).reshape(n, 4)
        told.append(HeadAnswers(objectness, Cells(*where), boxes, torch.tensor([scores] * n).reshape(n, 2)))
    return told


def test_teacher_used_where_labels_incomplete(network):
    loss = DetectionLoss(network)
    incomplete = batch(nobody(), answers=answers(network), is_complete=(False, True))
    agreeing = silent(network)
    agreeing[0][0, 1, 5, 3, :] = torch.tensor([0, 0, 0, 0, logit(0.9), logit(0.8), logit(0.1)])
    centre = (27 / 8 - 3 + 0.5) / 2
    agreeing[0][0, 1, 5, 3, :2] = torch.tensor([logit(centre), logit(centre)])
    told, silence = loss(agreeing, incomplete), loss(silent(network), incomplete)
    assert told.objectness < 0.2 * silence.objectness
    assert told.box < 1e-3
    assert silence.box > 1e-3


def test_teacher_ignored_where_labels_complete(network):
    loss = DetectionLoss(network)
    complete = batch(nobody(), answers=answers(network), is_complete=(True, True))
    assert loss(silent(network), complete).numbers() == pytest.approx((0, 0, 0), abs=1e-3)


def test_label_box_overrides_teacher_box(network):
    objects = one(27, 43, 16, 30)
    shifted = batch(objects, answers=answers(network, box=(29, 45, 16, 30)))
    exact = batch(objects, answers=answers(network))
    raw = perfect(network, objects)
    loss = DetectionLoss(network)
    assert float(loss(raw, shifted).box) == pytest.approx(float(loss(raw, exact).box), abs=1e-6)


def test_eiou_differs_from_ciou(network):
    objects = one(27, 43, 16, 30)
    raw = perfect(network, objects)
    raw[0][..., 2] += 1.0
    ciou, eiou = (float(DetectionLoss(network, box_loss=name)(raw, batch(objects)).box) for name in ("ciou", "eiou"))
    assert eiou != pytest.approx(ciou, rel=0.01)


def test_class_is_distilled_at_label_cells(network):
    objects = one(27, 43, 16, 30, class_index=0)
    raw = perfect(network, objects)
    loss = DetectionLoss(network)
    agreeing, differing = (batch(objects, answers=answers(network, scores=s)) for s in ((0.9, 0.1), (0.1, 0.9)))
    assert float(loss(raw, differing).class_score) == pytest.approx(float(loss(raw, agreeing).class_score), abs=1e-6)


def test_ignored_box_does_not_block_a_label(network):
    label = one(27, 43, 16, 30)
    both = Objects(
        *(
            torch.cat([getattr(nobody(ignored=[(29, 45, 16, 30)]), n), getattr(label, n)])
            for n in ("image", "class_index", "cxcywh", "is_ignored")
        )
    )
    raw = perfect(network, label)
    loss = DetectionLoss(network)
    shifted = loss(raw, batch(both, answers=answers(network, box=(29, 45, 16, 30))))
    assert float(shifted.box) == pytest.approx(0.0, abs=1e-3)


def test_labels_used_where_mosaic_is_complete(network):
    """A class complete on the right alone: the teacher's car on the left is learnt, the one on the right is not."""
    flags = torch.zeros(1, 2, 2, 2, dtype=torch.bool)
    flags[0, :, 1] = True
    images = torch.zeros(1, 3, SIDE, SIDE, dtype=torch.uint8)
    loss = DetectionLoss(network)
    told = {}
    for name, x in (("left of it", 20.0), ("right of it", 60.0)):
        complete = Completeness(flags, torch.tensor([[x, 0.0]]))  # the box's centre is at 27
        told[name] = loss(silent(network), Batch(images, nobody(), complete, answers(network)))
    assert float(told["right of it"].box) > 1e-3
    assert told["left of it"].numbers() == pytest.approx((0, 0, 0), abs=1e-3)
