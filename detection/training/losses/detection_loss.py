"""DetectionLoss: what a network's raw heads are worth against labels, and against a teacher's answers where there are.

    loss = batch * (3 / heads) * sum over heads of (0.05 box + g_h (size / 640)^2 objectness + 0.5 (C / 80) class)

    box         mean over the positive cells of 1 - CIoU or EIoU
    objectness  mean over all cells of the binary cross-entropy with the box's CIoU or EIoU (0 where nothing is)
    class       mean over the positive cells and classes of the binary cross-entropy
    g_h         4, 1, 0.4 for strides 8, 16, 32 (YOLOv5's hyp.scratch-low.yaml and its balance; v6)

Cells inside an ignored box are left out of the objectness. With a teacher, its objectness is the target of every cell
that no label claims, and its confident cells are positives too, weighted by that objectness, with its soft class scores
and its box (box and class of the label, where one overlaps). Where labels of a class are complete and none overlaps,
they are believed: the teacher saw what is not there.

What nobody labelled, nor a pseudo-label or a teacher found, is background to the objectness, which all classes share: a
class can be learnt from images where it is not labelled only as well as its stand-ins see it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits as cross_entropy

from track_range.detection.training.losses.assignment import Cells, Objects, assign
from track_range.detection.training.losses.box_losses import BOX_LOSSES, BoxLoss
from track_range.detection.training.networks.network import AnchorNetwork
from track_range.detection.training.teacher import HeadAnswers

_BOX, _OBJECTNESS, _CLASS = 0.05, 1.0, 0.5
_BALANCE = {8: 4.0, 16: 1.0, 32: 0.4}

_SAME_OBJECT_IOU = 0.5
"""Overlap from which a teacher's box is one of a label."""


@dataclass(frozen=True, slots=True)
class Completeness:
    """Where in a batch's images which classes are labelled completely.

    Attributes:
        flags: (B, 2, 2, C) above, below x left, right of `meeting_xy`.
        meeting_xy: (B, 2) where the parts of each mosaic meet, in pixels.
    """

    flags: Tensor
    meeting_xy: Tensor

    def to(self, device: torch.device) -> Completeness:
        """The same on a device."""
        return Completeness(self.flags.to(device), self.meeting_xy.to(device))

    def at(self, image: Tensor, xy: Tensor, class_index: Tensor) -> Tensor:
        """(P,) whether a class is complete at a place (P, 2) of an image."""
        right, below = (xy >= self.meeting_xy[image]).long().unbind(1)
        return self.flags[image, below, right, class_index]


@dataclass(frozen=True, slots=True)
class Batch:
    """What a network is to learn from at once.

    Attributes:
        images: (B, 3, H, W) uint8 RGB.
        objects: their labels.
        complete: where every object of a class is labelled.
        answers: the teacher's, by head; None = there is no teacher.
    """

    images: Tensor
    objects: Objects
    complete: Completeness
    answers: list[HeadAnswers] | None = None


@dataclass(frozen=True, slots=True)
class Losses:
    """The three parts of a loss with their weights in them, per image; their sum times the batch is learnt from."""

    box: Tensor
    objectness: Tensor
    class_score: Tensor

    @property
    def total(self) -> Tensor:
        """Their sum."""
        return self.box + self.objectness + self.class_score

    def numbers(self) -> tuple[float, float, float]:
        """Box, objectness, class, as plain numbers."""
        return float(self.box.detach()), float(self.objectness.detach()), float(self.class_score.detach())


@dataclass(frozen=True, slots=True)
class _Positives:
    """Cells of one head that find something, from labels and teacher alike.

    Attributes:
        cells: where; `of` is meaningless here.
        cxcywh: (P, 4) what they should find.
        class_score: (P, C) with which class scores.
        weight: (P,) how much each counts.
        is_label: (P,) it comes from a label, so its objectness should be the overlap.
    """

    cells: Cells
    cxcywh: Tensor
    class_score: Tensor
    weight: Tensor
    is_label: Tensor

    def and_(self, other: _Positives) -> _Positives:
        """Both."""
        rest = ("cxcywh", "class_score", "weight", "is_label")
        return _Positives(
            self.cells.and_(other.cells), *(torch.cat([getattr(self, name), getattr(other, name)]) for name in rest)
        )


class DetectionLoss:
    """The loss of one network; see the module."""

    def __init__(self, network: AnchorNetwork, *, box_loss: BoxLoss = "ciou") -> None:
        self._network = network
        self._overlap: Callable[[Tensor, Tensor], Tensor] = BOX_LOSSES[box_loss]

    def __call__(self, raw: list[Tensor], batch: Batch) -> Losses:
        """The loss of `forward`'s outputs for a batch."""
        labels = batch.objects.select(~batch.objects.is_ignored)
        answers: Sequence[HeadAnswers | None] = batch.answers or [None] * len(raw)
        parts = [
            self._of_head(head, predictions.float(), labels, batch, said)
            for head, (predictions, said) in enumerate(zip(raw, answers, strict=True))
        ]
        box, objectness, class_score = (torch.stack(column).sum() for column in zip(*parts, strict=True))
        height, width = batch.images.shape[2:]
        share = 3 / len(raw)
        return Losses(
            _BOX * share * box,
            _OBJECTNESS * share * (height * width / 640**2) * objectness,
            _CLASS * share * self._network.n_classes / 80 * class_score,
        )

    def _of_head(
        self, head: int, raw: Tensor, labels: Objects, batch: Batch, answers: HeadAnswers | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Box, objectness and class loss of one head, each a mean."""
        network = self._network
        stride_px = network.strides_px[head]
        found = _of_labels(assign(labels, network, head, (raw.shape[2], raw.shape[3])), labels, network.n_classes)
        wanted = torch.zeros(raw.shape[:4], device=raw.device)
        if answers is not None:
            answers = _believed(answers, batch.objects, batch.complete)
            wanted = answers.objectness
            found = found.and_(_of_teacher(answers))
        where = (found.cells.image, found.cells.anchor, found.cells.row, found.cells.column)
        predictions = raw[where]
        cells = torch.stack([found.cells.column, found.cells.row], 1).float()
        boxes = network.boxes(predictions[:, :4], cells, network.anchors_px[head][found.cells.anchor], stride_px)
        overlap = self._overlap(boxes, found.cxcywh)
        total = found.weight.sum().clamp(min=1e-6)
        box = ((1 - overlap) * found.weight).sum() / total
        by_class = cross_entropy(predictions[:, 5:], found.class_score, reduction="none").mean(1)
        class_score = (by_class * found.weight).sum() / total
        own = tuple(index[found.is_label] for index in where)
        quality = overlap.detach()[found.is_label].clamp(min=0)
        wanted[own] = torch.maximum(wanted[own], quality)
        each = cross_entropy(raw[..., 4], wanted, reduction="none")
        counts = _counts(raw, stride_px, batch.objects, own)
        objectness = (each * counts).sum() / counts.sum().clamp(min=1)
        return box, _BALANCE[stride_px] * objectness, class_score


def _of_labels(cells: Cells, labels: Objects, n_classes: int) -> _Positives:
    scores = torch.nn.functional.one_hot(labels.class_index[cells.of], n_classes).float()
    ones = torch.ones(len(cells.of), device=scores.device)
    return _Positives(cells, labels.cxcywh[cells.of], scores, ones, ones.bool())


def _of_teacher(answers: HeadAnswers) -> _Positives:
    """The confident cells of a teacher."""
    cells = answers.cells
    weight = answers.objectness[cells.image, cells.anchor, cells.row, cells.column]
    return _Positives(cells, answers.cxcywh, answers.class_score, weight, torch.zeros_like(weight).bool())


def _counts(raw: Tensor, stride_px: int, objects: Objects, positive: tuple[Tensor, ...]) -> Tensor:
    """(B, A, rows, columns) 1 where the objectness is learnt: everywhere but inside ignored boxes."""
    counts = torch.ones(raw.shape[:4], device=raw.device)
    ignored = objects.select(objects.is_ignored)
    half = ignored.cxcywh[:, 2:] / 2
    first = ((ignored.cxcywh[:, :2] - half) / stride_px).floor().long().clamp(min=0).tolist()
    last = ((ignored.cxcywh[:, :2] + half) / stride_px).ceil().long().clamp(min=0).tolist()
    for image, (x1, y1), (x2, y2) in zip(ignored.image.tolist(), first, last, strict=True):
        counts[image, :, y1:y2, x1:x2] = 0.0
    counts[positive] = 1.0
    return counts


def _believed(answers: HeadAnswers, objects: Objects, complete: Completeness) -> HeadAnswers:
    """A teacher's answers, with a label's box and class where they meet, nothing where labels know of nothing."""
    cells, n_classes = answers.cells, answers.class_score.shape[1]
    label, is_labelled = _best_of(answers, objects, ~objects.is_ignored)
    _, is_ignored = _best_of(answers, objects, objects.is_ignored)
    guess = answers.class_score.argmax(1)
    wrong = ~is_labelled & ~is_ignored & complete.at(cells.image, answers.cxcywh[:, :2], guess)
    objectness, boxes, scores = answers.objectness.clone(), answers.cxcywh.clone(), answers.class_score.clone()
    objectness[cells.image[wrong], cells.anchor[wrong], cells.row[wrong], cells.column[wrong]] = 0.0
    of = label[is_labelled]
    boxes[is_labelled] = objects.cxcywh[of]
    scores[is_labelled] = torch.nn.functional.one_hot(objects.class_index[of], n_classes).to(scores)
    return HeadAnswers(objectness, cells.select(~wrong), boxes[~wrong], scores[~wrong])


def _best_of(answers: HeadAnswers, objects: Objects, among: Tensor) -> tuple[Tensor, Tensor]:
    """(P,) which of some objects each of a teacher's boxes overlaps most, and whether that is one and the same."""
    of = torch.zeros_like(answers.cells.image)
    overlap = torch.zeros(len(of), device=of.device)
    for image in torch.unique(answers.cells.image).tolist():  # image by image: all pairs would be too many
        mine = (answers.cells.image == image).nonzero()[:, 0]
        theirs = ((objects.image == image) & among).nonzero()[:, 0]
        if len(theirs):
            overlap[mine], best = _iou(answers.cxcywh[mine], objects.cxcywh[theirs]).max(1)
            of[mine] = theirs[best]
    return of, overlap >= _SAME_OBJECT_IOU


def _iou(a_cxcywh: Tensor, b_cxcywh: Tensor) -> Tensor:
    """(N, M) intersection over union of boxes (N, 4) and (M, 4)."""
    (a1, a2), (b1, b2) = ((box[:, :2] - box[:, 2:] / 2, box[:, :2] + box[:, 2:] / 2) for box in (a_cxcywh, b_cxcywh))
    shared = (torch.minimum(a2[:, None], b2[None]) - torch.maximum(a1[:, None], b1[None])).clamp(min=0).prod(2)
    return shared / (a_cxcywh[:, 2:].prod(1)[:, None] + b_cxcywh[:, 2:].prod(1)[None] - shared + 1e-7)
