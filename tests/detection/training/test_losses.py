import math

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st

from track_range.detection.training.losses.box_losses import ciou, eiou

SQUARES = [[0, 0, 100, 100], [0, 0, 50, 50], [200, 200, 300, 300]]
# from torchvision's test of distance_box_iou; for squares, CIoU equals DIoU
DISTANCE_IOU = [[1.0, 0.1875, -0.4444], [0.1875, 1.0, -0.5625], [-0.4444, -0.5625, 1.0]]


def cxcywh(*corners):
    boxes = torch.tensor(corners, dtype=torch.float64)
    return torch.cat([(boxes[:, :2] + boxes[:, 2:]) / 2, boxes[:, 2:] - boxes[:, :2]], 1)


def by_hand(a, b, kind):
    """The equations of the papers for one pair of boxes, without tensors."""
    (ax, ay, aw, ah), (bx, by, bw, bh) = a, b
    left, right = max(ax - aw / 2, bx - bw / 2), min(ax + aw / 2, bx + bw / 2)
    top, bottom = max(ay - ah / 2, by - bh / 2), min(ay + ah / 2, by + bh / 2)
    intersection = max(right - left, 0) * max(bottom - top, 0)
    iou = intersection / (aw * ah + bw * bh - intersection)
    cw = max(ax + aw / 2, bx + bw / 2) - min(ax - aw / 2, bx - bw / 2)
    ch = max(ay + ah / 2, by + bh / 2) - min(ay - ah / 2, by - bh / 2)
    distance = ((ax - bx) ** 2 + (ay - by) ** 2) / (cw**2 + ch**2)
    if kind == "eiou":
        return iou - distance - (aw - bw) ** 2 / cw**2 - (ah - bh) ** 2 / ch**2
    v = 4 / math.pi**2 * (math.atan(bw / bh) - math.atan(aw / ah)) ** 2
    return iou - distance - (v / (1 - iou + v) * v if v else 0.0)


@pytest.mark.parametrize("i", range(3))
@pytest.mark.parametrize("j", range(3))
def test_ciou_of_squares_equals_torchvision(i, j):
    assert ciou(cxcywh(SQUARES[i]), cxcywh(SQUARES[j])).item() == pytest.approx(
        DISTANCE_IOU[i][j], abs=1e-4
    )


def test_hand_worked():
    # 4 x 2 at the origin, 2 x 2 at x = 1: intersection 4, union 8; enclosing box 4 x 2, distance 1
    a, b = torch.tensor([[0.0, 0, 4, 2]]), torch.tensor([[1.0, 0, 2, 2]])
    assert eiou(a, b).item() == pytest.approx(0.5 - 1 / 20 - 4 / 16 - 0, abs=1e-6)
    v = 4 / math.pi**2 * (math.atan(1.0) - math.atan(2.0)) ** 2
    assert ciou(a, b).item() == pytest.approx(0.5 - 1 / 20 - v * v / (0.5 + v), abs=1e-6)


sides = st.floats(0.5, 200)
positions = st.floats(-300, 300)
boxes = st.tuples(positions, positions, sides, sides)


@given(a=boxes, b=boxes)
@pytest.mark.parametrize(("kind", "loss"), [("ciou", ciou), ("eiou", eiou)])
def test_equals_the_equations(kind, loss, a, b):
    similarity = loss(
        torch.tensor([a], dtype=torch.float64), torch.tensor([b], dtype=torch.float64)
    ).item()
    assert similarity == pytest.approx(by_hand(a, b, kind), abs=1e-5)
    assert similarity <= 1 + 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("loss", [ciou, eiou])
def test_loss_is_zero_at_target_and_decreases(loss):
    target = torch.tensor([[50.0, 40.0, 30.0, 20.0]])
    assert loss(target, target).item() == pytest.approx(1.0, abs=1e-5)
    guess = torch.tensor([[30.0, 70.0, 60.0, 10.0]], requires_grad=True)
    optimiser = torch.optim.Adam([guess], lr=0.5)
    for _ in range(400):
        optimiser.zero_grad()
        torch.autograd.backward((1 - loss(guess, target)).sum())
        optimiser.step()
    assert np.allclose(guess.detach().numpy(), target.numpy(), atol=1.0)


@pytest.mark.parametrize("loss", [ciou, eiou])
def test_empty_boxes(loss):
    empty = torch.zeros(1, 4, requires_grad=True)
    similarity = loss(empty, torch.zeros(1, 4))
    torch.autograd.backward(similarity.sum())
    assert torch.isfinite(similarity).all()
    assert torch.isfinite(empty.grad).all()
