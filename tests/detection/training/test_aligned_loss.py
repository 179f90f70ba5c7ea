import math

import numpy as np
import pytest
import torch

from track_range.detection.boxes import iou, xyxy_from_cxcywh
from track_range.detection.training.losses.aligned_loss import AlignedLoss, assign_aligned
from track_range.detection.training.losses.assignment import LabelledObjects
from track_range.detection.training.losses.detection_loss import Batch, Completeness
from track_range.detection.training.networks.network import cells_xy
from track_range.detection.training.networks.registry import make_network
from track_range.detection.training.networks.road_net import N_BINS, boxes_of, split_outputs

SIDE = 128
STRIDES = (8, 16, 32, 64)
HIGH_LOGIT = 14.0


@pytest.fixture(scope="module")
def network():
    return make_network("road", 2)


def objects(*rows, ignored=False, confidence=1.0, image=0):
    """Rows of class, cx, cy, w, h."""
    table = torch.tensor(rows, dtype=torch.float32).reshape(-1, 5)
    n = len(table)
    flags = torch.full((n,), ignored, dtype=torch.bool)
    return LabelledObjects(
        torch.full((n,), image),
        table[:, 0].long(),
        table[:, 1:],
        flags,
        torch.full((n,), confidence),
    )


def joined(*parts):
    return LabelledObjects(
        *(
            torch.cat([getattr(part, n) for part in parts])
            for n in LabelledObjects.__dataclass_fields__
        )
    )


def batch(labels, *, is_complete=(True, True), n_images=1):
    images = torch.zeros(n_images, 3, SIDE, SIDE, dtype=torch.uint8)
    return Batch(
        images,
        labels,
        Completeness(torch.tensor(is_complete).expand(n_images, 2, 2, 2), torch.zeros(n_images, 2)),
    )


def centres():
    grids = [
        (cells_xy(SIDE // s, SIDE // s, device=torch.device("cpu")).flatten(0, 1) + 0.5) * s
        for s in STRIDES
    ]
    return torch.cat(grids), torch.cat(
        [torch.full((len(grid),), float(s)) for grid, s in zip(grids, STRIDES, strict=True)]
    )


def outputs(box=None, *, stride=16, score_class=0):
    """Raw outputs without objects; with `box` (cx, cy, w, h), all cells of a stride predict it,
    those inside score."""
    heads = []
    for s in STRIDES:
        n = SIDE // s
        head = torch.full((1, n, n, 2 + 4 * N_BINS), -HIGH_LOGIT)
        if box is not None and s == stride:
            centre = (cells_xy(n, n, device=torch.device("cpu")) + 0.5) * s
            cx, cy, w, h = box
            sides = [centre[..., 0] - cx + w / 2, centre[..., 1] - cy + h / 2]
            sides += [cx + w / 2 - centre[..., 0], cy + h / 2 - centre[..., 1]]
            distance = (torch.stack(sides, -1) / s).clamp(0, N_BINS - 1.001)
            k = distance.floor().long()
            p = torch.zeros(1, n, n, 4, N_BINS)
            p.scatter_(-1, k[None, ..., None], (k + 1 - distance)[None, ..., None])
            p.scatter_add_(-1, k[None, ..., None] + 1, (distance - k)[None, ..., None])
            head[..., 2:] = (p + 1e-9).log().flatten(-2)
            inside = (torch.stack(sides, -1) > 0).all(-1)
            head[..., score_class] = torch.where(inside, HIGH_LOGIT, -HIGH_LOGIT)
        heads.append(head)
    return heads


def test_the_ten_best_aligned_cells_inside_are_assigned():
    rng = np.random.default_rng(0)
    centre, stride = centres()
    scores = torch.from_numpy(rng.uniform(0.1, 0.9, (1, len(centre), 2)).astype(np.float32))
    truth = torch.tensor([60.0, 70.0, 60.0, 44.0])
    noise = torch.from_numpy(rng.normal(0, 4, (len(centre), 4)).astype(np.float32))
    boxes = (truth + noise)[None]
    cells = assign_aligned(objects((1, *truth.tolist())), scores, boxes, centre, stride)
    true_xyxy = np.array([[30.0, 48.0, 90.0, 92.0]])
    overlap = torch.from_numpy(
        iou(xyxy_from_cxcywh(boxes[0].numpy().astype(np.float64)), true_xyxy)[:, 0]
    ).float()
    alignment = scores[0, :, 1] * overlap**6
    alignment[~((centre - truth[:2]).abs() < truth[2:] / 2).all(1)] = -1
    best = alignment.argsort(descending=True)[:10]
    assert set(cells.cell.tolist()) == set(best.tolist())
    expected = alignment[cells.cell] / alignment.max() * overlap[best].max()
    assert torch.allclose(cells.target, expected, atol=1e-5)


def test_an_object_smaller_than_a_cell_has_positives():
    centre, stride = centres()
    boxes = torch.cat([centre, torch.full_like(centre, 4.0)], 1)[None]
    cells = assign_aligned(
        objects((0, 16.0, 16.0, 3.0, 3.0)),
        torch.full((1, len(centre), 2), 0.5),
        boxes,
        centre,
        stride,
    )
    assert (stride[cells.cell] == 8).any()
    assert ((centre[cells.cell] - 16).abs() < 8).all()


def test_a_cell_belongs_to_the_object_with_the_largest_overlap():
    centre, stride = centres()
    boxes = torch.tensor([52.0, 52.0, 64.0, 64.0]).expand(1, len(centre), 4)
    both = objects((0, 52.0, 52.0, 64.0, 64.0), (1, 52.0, 52.0, 48.0, 48.0))
    cells = assign_aligned(both, torch.full((1, len(centre), 2), 0.5), boxes, centre, stride)
    owned = cells.select(cells.has_box)
    assert len(set(owned.cell.tolist())) == len(owned.cell) == len(set(cells.cell.tolist()))
    assert (owned.object_index == 0).sum() == 10
    # the class of the other object is a target of its cells too
    assert (cells.object_index == 1).sum() == 10


def test_perfect_predictions_have_no_loss_and_others_have(network):
    box = (56.0, 60.0, 60.0, 44.0)
    loss = AlignedLoss(network)
    perfect = loss(outputs(box), batch(objects((0, *box))))
    assert float(perfect["box"]) == pytest.approx(0, abs=1e-4)
    missed = loss(outputs(), batch(objects((0, *box))))
    wrong_class = loss(outputs(box, score_class=1), batch(objects((0, *box))))
    moved = loss(outputs((62.0, 60.0, 60.0, 44.0)), batch(objects((0, *box))))
    assert float(missed["class"]) > 10 * float(perfect["class"])
    assert float(wrong_class["class"]) > 10 * float(perfect["class"])
    assert float(moved["box"]) > 0.1
    assert float(moved["bins"]) > float(perfect["bins"])


def test_background_alone_has_no_loss(network):
    losses = AlignedLoss(network)(outputs(), batch(objects()))
    assert [float(losses[name]) for name in ("box", "bins")] == [0, 0]
    assert float(losses["class"]) == pytest.approx(0, abs=1e-3)


def test_classes_that_are_not_completely_labelled_count_less(network):
    box = (56.0, 60.0, 60.0, 44.0)
    complete, incomplete = (
        float(
            AlignedLoss(network)(outputs(box), batch(objects(), is_complete=(flag, True)))["class"]
        )
        for flag in (True, False)
    )
    assert incomplete == pytest.approx(0.2 * complete, rel=1e-3)


def test_ignored_boxes_do_not_count(network):
    box = (56.0, 60.0, 60.0, 44.0)
    loss = AlignedLoss(network)
    unlabelled, ignored = (
        loss(outputs(box), batch(labels))
        for labels in (objects(), objects((0, *box), ignored=True))
    )
    assert float(unlabelled["class"]) > 1
    assert float(ignored["class"]) == pytest.approx(0, abs=1e-3)
    labelled = joined(objects((0, *box)), objects((1, *box), ignored=True))
    alone, both = (loss(outputs(), batch(labels)) for labels in (objects((0, *box)), labelled))
    assert float(both["class"]) == pytest.approx(float(alone["class"]), rel=1e-3)


def test_score_that_minimises_the_loss_is_the_confidence_times_the_overlap(network):
    """With perfect boxes, the gradient of the scores is zero at the confidence of a
    pseudo-label."""
    box = (56.0, 60.0, 60.0, 44.0)
    raw = outputs(box)
    p = 0.3
    inside = raw[1][..., 0] > 0
    logits = torch.full_like(raw[1][..., :1], -HIGH_LOGIT)
    logits[inside] = math.log(p / (1 - p))
    logits.requires_grad_(True)
    raw[1] = torch.cat([logits, raw[1][..., 1:]], -1)
    losses = AlignedLoss(network)(raw, batch(objects((0, *box), confidence=p)))
    losses["class"].backward()
    _, stride = centres()
    assigned = assign_aligned(objects((0, *box)), *_predicted(raw), *centres())
    rows = assigned.cell[stride[assigned.cell] == 16] - (SIDE // 8) ** 2
    best = rows[assigned.target[stride[assigned.cell] == 16] > 0.999]
    assert len(best) > 0
    assert torch.allclose(logits.grad.flatten()[best], torch.zeros(len(best)), atol=1e-4)


def _predicted(raw):
    flat = torch.cat([head.flatten(1, 2) for head in raw], 1).detach()
    logits, distance = split_outputs(flat)
    return logits.sigmoid(), boxes_of(distance, *centres())
