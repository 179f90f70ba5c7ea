"""DetectionLoss: the loss of a network's raw heads from labels and, optionally, the outputs of a teacher.

    loss = batch * (3 / heads) * sum over heads of (0.05 box + g_h (size / 640)^2 objectness + 0.5 (C / 80) class)

    box         mean over the positive cells of 1 - CIoU or 1 - EIoU
    objectness  mean over all cells of the binary cross-entropy; the target is the box's CIoU or EIoU, 0 for background
    class       mean over the positive cells and classes of the binary cross-entropy
    g_h         4, 1, 0.4 for strides 8, 16, 32 (YOLOv5 v6, hyp.scratch-low.yaml and its balance)

Cells inside an ignored box do not contribute to the objectness. With a teacher, the teacher's objectness is the target
of every cell that is not assigned to a label, and its confident cells are additional positives, weighted by that
objectness. Their targets are the teacher's box and class scores, or the box and class of a label that overlaps the
teacher's box. If the labels of the class are complete and no label overlaps, the teacher's detection is a false
positive and is not used.

Objects that have neither a label nor a pseudo-label nor a detection of the teacher are background for the objectness,
which all classes share. A class that is not labelled in an image is therefore learnt only as well as the pseudo-labels
or the teacher detect it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits as cross_entropy, one_hot

from track_range.detection.training.losses.assignment import (
    Cells,
    LabelledObjects,
    TensorRows,
    assign,
)
from track_range.detection.training.losses.box_losses import BOX_LOSSES, BoxLoss, pair_iou
from track_range.detection.training.networks.network import AnchorNetwork

_BOX, _OBJECTNESS, _CLASS = 0.05, 1.0, 0.5  # as in YOLOv5
# g_h: weight of a head's objectness loss by stride in pixels, as in YOLOv5
_BALANCE = {8: 4.0, 16: 1.0, 32: 0.4}
_SAME_OBJECT_IOU = 0.5  # smallest IoU of a teacher's box and a label of the same object


@dataclass(frozen=True, slots=True)
class Completeness(TensorRows):
    """Completely labelled classes, by quarter of each image in a batch."""

    flags: Tensor  # (B, 2, 2, C) above and below, left and right of `meeting_xy`
    meeting_xy: Tensor  # (B, 2) point in pixels where the quarters of each mosaic meet

    def at(self, image: Tensor, xy: Tensor, class_index: Tensor) -> Tensor:
        """(P,) whether classes (P,) are completely labelled at points (P, 2) of images (P,)."""
        right, below = (xy >= self.meeting_xy[image]).long().unbind(1)
        return self.flags[image, below, right, class_index]


@dataclass(frozen=True, slots=True)
class TeacherOutputs:
    """Outputs of a teacher in one head for a batch, with P confident cells."""

    # (B, A, rows, columns) 0..1; in confident cells of the student's classes, else of any class
    objectness: Tensor
    cells: Cells  # the confident cells
    cxcywh: Tensor  # (P, 4) boxes in input pixels
    # (P, C) 0..1, scores of the student's classes; 0 for classes that the teacher does not have
    class_score: Tensor


@dataclass(frozen=True, slots=True)
class Batch:
    """A training batch."""

    images: Tensor  # (B, 3, H, W) uint8 RGB
    objects: LabelledObjects
    complete: Completeness
    # outputs of the teacher for each head; None = no teacher
    teacher: list[TeacherOutputs] | None = None


# weighted parts per image by name; their sum times the batch size is minimised
Losses = Mapping[str, Tensor]


@dataclass(frozen=True, slots=True)
class _Positives(TensorRows):
    """P positive cells of one head, from labels and teacher, by their (P,) int64 indices, and their
    targets.
    """

    image: Tensor
    anchor: Tensor
    row: Tensor
    column: Tensor
    cxcywh: Tensor  # (P, 4) target boxes
    class_score: Tensor  # (P, C) target class scores
    weight: Tensor  # (P,) weight in the loss
    # (P,) the target is a label, so that the target of the objectness is the overlap of the boxes
    is_label: Tensor


class DetectionLoss:
    """The loss function of a network; see the module's description."""

    def __init__(self, network: AnchorNetwork, *, box_loss: BoxLoss = "ciou") -> None:
        self._network = network
        self._overlap: Callable[[Tensor, Tensor], Tensor] = BOX_LOSSES[box_loss]

    def __call__(self, raw: list[Tensor], batch: Batch) -> Losses:
        """The losses of the network's outputs `raw` for a batch."""
        labels = batch.objects.select(~batch.objects.is_ignored)
        teacher: Sequence[TeacherOutputs | None] = batch.teacher or [None] * len(raw)
        parts = [
            self._of_head(head, predictions.float(), labels, batch, outputs)
            for head, (predictions, outputs) in enumerate(zip(raw, teacher, strict=True))
        ]
        box, objectness, class_score = (
            torch.stack(column).sum() for column in zip(*parts, strict=True)
        )
        height, width = batch.images.shape[2:]
        fraction = 3 / len(raw)
        return {
            "box": _BOX * fraction * box,
            "objectness": _OBJECTNESS * fraction * (height * width / 640**2) * objectness,
            "class": _CLASS * fraction * self._network.n_classes / 80 * class_score,
        }

    def _of_head(
        self,
        head: int,
        raw: Tensor,
        labels: LabelledObjects,
        batch: Batch,
        teacher: TeacherOutputs | None,
    ) -> tuple[Tensor, Tensor, Tensor]:
        network = self._network
        stride_px = network.strides_px[head]
        cells = assign(labels, network, head, (raw.shape[2], raw.shape[3]))
        scores = one_hot(labels.class_index[cells.object_index], network.n_classes).float()
        ones = torch.ones(len(cells.object_index), device=raw.device)
        positives = _Positives(
            *cells.where, labels.cxcywh[cells.object_index], scores, ones, ones.bool()
        )
        target = torch.zeros(raw.shape[:4], device=raw.device)
        if teacher is not None:
            teacher = _corrected(teacher, batch.objects, batch.complete)
            target = teacher.objectness
            weight, boxes = teacher.objectness[teacher.cells.where], teacher.cxcywh
            no_label = torch.zeros_like(weight).bool()
            positives = positives.concatenate(
                _Positives(*teacher.cells.where, boxes, teacher.class_score, weight, no_label)
            )
        where = (positives.image, positives.anchor, positives.row, positives.column)
        predictions = raw[where]
        cells_xy = torch.stack([positives.column, positives.row], 1).float()
        boxes = network.boxes(
            predictions[:, :4], cells_xy, network.anchors_px[head][positives.anchor], stride_px
        )
        overlap = self._overlap(boxes, positives.cxcywh)
        total = positives.weight.sum().clamp(min=1e-6)
        box = ((1 - overlap) * positives.weight).sum() / total
        by_class = cross_entropy(predictions[:, 5:], positives.class_score, reduction="none").mean(
            1
        )
        class_score = (by_class * positives.weight).sum() / total

        of_labels = tuple(index[positives.is_label] for index in where)
        quality = overlap.detach()[positives.is_label].clamp(min=0)
        target[of_labels] = torch.maximum(target[of_labels], quality)
        entropy = cross_entropy(raw[..., 4], target, reduction="none")
        mask = _objectness_mask(raw, stride_px, batch.objects, of_labels)
        objectness = (entropy * mask).sum() / mask.sum().clamp(min=1)
        return box, _BALANCE[stride_px] * objectness, class_score


def _objectness_mask(
    raw: Tensor, stride_px: int, objects: LabelledObjects, positive: tuple[Tensor, ...]
) -> Tensor:
    """(B, A, rows, columns) weight of the objectness loss: 0 inside ignored boxes except for
    positive cells, else 1.
    """
    mask = torch.ones(raw.shape[:4], device=raw.device)
    ignored = objects.select(objects.is_ignored)
    half = ignored.cxcywh[:, 2:] / 2
    first = ((ignored.cxcywh[:, :2] - half) / stride_px).floor().long().clamp(min=0).tolist()
    last = ((ignored.cxcywh[:, :2] + half) / stride_px).ceil().long().clamp(min=0).tolist()
    for image, (x1, y1), (x2, y2) in zip(ignored.image.tolist(), first, last, strict=True):
        mask[image, :, y1:y2, x1:x2] = 0.0
    mask[positive] = 1.0
    return mask


def _corrected(
    teacher: TeacherOutputs, objects: LabelledObjects, complete: Completeness
) -> TeacherOutputs:
    """The teacher's outputs with box and class of overlapping labels, and without its false
    positives.
    """
    cells, n_classes = teacher.cells, teacher.class_score.shape[1]
    label, is_labelled = _best_overlap(teacher, objects, ~objects.is_ignored)
    _, is_ignored = _best_overlap(teacher, objects, objects.is_ignored)
    class_index = teacher.class_score.argmax(1)
    is_false = (
        ~is_labelled & ~is_ignored & complete.at(cells.image, teacher.cxcywh[:, :2], class_index)
    )
    objectness = teacher.objectness.clone()
    boxes = teacher.cxcywh.clone()
    scores = teacher.class_score.clone()
    objectness[cells.select(is_false).where] = 0.0
    label = label[is_labelled]
    boxes[is_labelled] = objects.cxcywh[label]
    scores[is_labelled] = one_hot(objects.class_index[label], n_classes).to(scores)
    return TeacherOutputs(objectness, cells.select(~is_false), boxes[~is_false], scores[~is_false])


def _best_overlap(
    teacher: TeacherOutputs, objects: LabelledObjects, is_candidate: Tensor
) -> tuple[Tensor, Tensor]:
    """(P,) index of the candidate object that each teacher's box overlaps most, and whether it is
    the same object.
    """
    index = torch.zeros_like(teacher.cells.image)
    overlap = torch.zeros(len(index), device=index.device)
    # image by image, to limit the number of pairs
    for image in torch.unique(teacher.cells.image).tolist():
        boxes = (teacher.cells.image == image).nonzero()[:, 0]
        candidates = ((objects.image == image) & is_candidate).nonzero()[:, 0]
        if len(candidates):
            overlap[boxes], best = pair_iou(
                teacher.cxcywh[boxes, None], objects.cxcywh[None, candidates]
            ).max(1)
            index[boxes] = candidates[best]
    return index, overlap >= _SAME_OBJECT_IOU
