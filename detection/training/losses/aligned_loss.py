"""AlignedLoss: the loss of an anchor-free network with class scores and distributions of distances.

    loss = batch * (7.5 box + 1.5 bins + 0.5 class)

    class   sum over cells and classes of the binary cross-entropy; the target is w
    box     sum over positive cells of w (1 - CIoU)
    bins    sum over positive cells of w (-(k + 1 - d) log P(k) - (d - k) log P(k + 1)), mean over the four sides,
            d = distance in cells, k = floor(d)

w is the target of `assign_aligned` times the confidence of the object: 1 for labels, the
probability of being right for pseudo-labels. Each sum is divided by the sum of w over the cells
with a box, at least 1. A class that is not completely labelled contributes only a fraction to cells
that are not its positives, since an unlabelled object may be there; cells inside an ignored box
contribute nothing.

(Weights: Jocher et al., "YOLOv8"; bins: Li et al., "Generalized Focal Loss", 2020, equation 6,
"distribution focal loss".)

Task-aligned assignment of objects to the cells of an anchor-free network.

    a = s u^6        s: score of the object's class, u: IoU of the predicted box and the object, for every cell

The 10 cells with the largest a among those whose centre is inside the object's box are its
positives; a cell of several objects gets the box of the object with the largest u. Around objects
smaller than the finest cells, centres within one such cell count as inside. The target of a
positive's class score is

    t = (a / largest a of the object) (largest u of the object)

so that scores rank boxes by their overlap as well. (Feng et al., "TOOD: Task-aligned One-stage
Object Detection", ICCV 2021, equations 4 to 6 with alpha = 1, beta = 6.)
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits as cross_entropy

from track_range.detection.training.losses.assignment import LabelledObjects, TensorRows
from track_range.detection.training.losses.box_losses import BOX_LOSSES, BoxLoss, pair_iou
from track_range.detection.training.losses.detection_loss import Batch, Losses
from track_range.detection.training.networks.road_net import (
    N_BINS,
    RoadNet,
    boxes_of,
    split_outputs,
)

_N_POSITIVES = 10  # cells of an object
_BETA = 6.0  # exponent of the IoU in the alignment a
_EPSILON = 1e-9  # added to the largest a of an object, which is 0 if no predicted box overlaps it


@dataclass(frozen=True, slots=True)
class AlignedCells(TensorRows):
    """P positive cells."""

    image: Tensor  # (P,) int64 index of the image
    cell: Tensor  # (P,) int64 index among the N cells of all levels
    object_index: Tensor  # (P,) int64 index of the object
    target: Tensor  # (P,) target of the score of the object's class, 0..1
    # (P,) the target of the cell's box is this object's; false for all but one object of a cell
    has_box: Tensor


@torch.no_grad()
def assign_aligned(
    objects: LabelledObjects,
    scores: Tensor,
    cxcywh_px: Tensor,
    centre_px: Tensor,
    stride_px: Tensor,
) -> AlignedCells:
    """The positive cells of T objects.

    `scores` (B, N, C) are in 0..1, `cxcywh_px` (B, N, 4) predicted boxes, `centre_px` (N, 2) and
    `stride_px` (N,) centres and sides of the cells.
    """
    reach_px = (objects.cxcywh[:, None, 2:] / 2).clamp(min=float(stride_px.min()))
    is_inside = ((centre_px - objects.cxcywh[:, None, :2]).abs() < reach_px).all(-1)  # (T, N)
    object_index, cell = is_inside.nonzero(as_tuple=True)
    image, class_index = objects.image[object_index], objects.class_index[object_index]
    overlap = is_inside.float()
    overlap[object_index, cell] = pair_iou(cxcywh_px[image, cell], objects.cxcywh[object_index])
    alignment = is_inside.float() - 1  # -1 outside, so that these cells come last
    alignment[object_index, cell] = (
        scores[image, cell, class_index] * overlap[object_index, cell] ** _BETA
    )

    best, best_cell = alignment.topk(min(_N_POSITIVES, len(centre_px)), dim=1)  # (T, 10)
    best_overlap = overlap.gather(1, best_cell)
    target = best / (best[:, :1] + _EPSILON) * best_overlap.amax(1, keepdim=True)

    object_index, rank = (best >= 0).nonzero(as_tuple=True)
    image, cell = objects.image[object_index], best_cell[object_index, rank]
    has_box = _is_largest(best_overlap[object_index, rank], image * len(centre_px) + cell)
    return AlignedCells(image, cell, object_index, target[object_index, rank], has_box)


def _is_largest(value: Tensor, key: Tensor) -> Tensor:
    """(P,) whether a value (P,) is the largest one with the same key (P,); among equal values, only
    the last one is.
    """
    place = torch.argsort(torch.argsort(value, stable=True))  # of each value in the sorted order
    largest = torch.full((int(key.max()) + 1 if len(key) else 0,), -1, device=key.device)
    return place == largest.scatter_reduce(0, key, place, "amax")[key]


_BOX, _BINS, _CLASS = 7.5, 1.5, 0.5  # as in YOLOv8
_INCOMPLETE = 0.2  # weight of cells without an object, for classes that are not completely labelled


class AlignedLoss:
    """The loss function of a network; see the module's description."""

    def __init__(self, network: RoadNet, *, box_loss: BoxLoss = "ciou") -> None:
        self._network = network
        self._overlap = BOX_LOSSES[box_loss]

    def __call__(self, raw: list[Tensor], batch: Batch) -> Losses:
        """The losses of the network's outputs `raw` for a batch."""
        outputs = torch.cat([output.flatten(1, 2) for output in raw], 1).float()
        centre_px, stride_px = self._network.cells_px(
            [(o.shape[1], o.shape[2]) for o in raw], device=outputs.device
        )
        labels = batch.objects.select(~batch.objects.is_ignored)
        with torch.no_grad():
            logits, distances = split_outputs(outputs)
            cxcywh_px = boxes_of(distances, centre_px, stride_px)
            cells = assign_aligned(labels, logits.sigmoid(), cxcywh_px, centre_px, stride_px)
        weight = cells.target * labels.confidence[cells.object_index]
        total = weight[cells.has_box].sum().clamp(min=1.0)

        target = torch.zeros_like(logits)
        n_cells, n_classes = logits.shape[1:]
        column = labels.class_index[cells.object_index] + n_classes * (
            cells.cell + n_cells * cells.image
        )
        target.view(-1).scatter_reduce_(0, column, weight, "amax")
        entropy = cross_entropy(outputs[..., : logits.shape[-1]], target, reduction="none")
        class_score = (entropy * _class_weight(batch, centre_px, target)).sum()

        weight = weight[cells.has_box]
        cells = cells.select(cells.has_box)
        truth = labels.cxcywh[cells.object_index]
        centre_px = centre_px[cells.cell]
        stride_px = stride_px[cells.cell]
        predicted = outputs[cells.image, cells.cell]
        overlap = self._overlap(boxes_of(split_outputs(predicted)[1], centre_px, stride_px), truth)
        box = ((1 - overlap) * weight).sum()
        bins = (_bins_loss(predicted[:, -4 * N_BINS :], truth, centre_px, stride_px) * weight).sum()
        return {
            "box": _BOX * box / total,
            "bins": _BINS * bins / total,
            "class": _CLASS * class_score / total,
        }


def _class_weight(batch: Batch, centre_px: Tensor, target: Tensor) -> Tensor:
    """(B, N, C) weight of each cell and class in the class loss."""
    right_below = (centre_px[None] >= batch.complete.meeting_xy[:, None]).long()  # (B, N, 2)
    image = torch.arange(len(target), device=target.device)[:, None]
    complete = batch.complete.flags[image, right_below[..., 1], right_below[..., 0]]
    weight = torch.where(complete | (target > 0), 1.0, _INCOMPLETE)
    ignored = batch.objects.select(batch.objects.is_ignored)
    if len(ignored.image):
        is_inside = (
            (centre_px - ignored.cxcywh[:, None, :2]).abs() < ignored.cxcywh[:, None, 2:] / 2
        ).all(-1)
        n_inside = torch.zeros(target.shape[:2], device=target.device)
        n_inside.index_add_(0, ignored.image, is_inside.float())
        weight = torch.where((n_inside > 0)[..., None] & (target == 0), 0.0, weight)
    return weight


def _bins_loss(bins: Tensor, truth_cxcywh: Tensor, centre_px: Tensor, stride_px: Tensor) -> Tensor:
    """(P,) distribution focal loss, mean over the sides, of P cells with the logits `bins` (P, 4 *
    bins).
    """
    half = truth_cxcywh[:, 2:] / 2
    from_centre_px = truth_cxcywh[:, :2] - centre_px
    distance = torch.cat([half - from_centre_px, half + from_centre_px], 1) / stride_px[:, None]
    distance = distance.clamp(0, N_BINS - 1.01)
    k = distance.floor().long()[..., None]
    log_p = bins.reshape(-1, 4, N_BINS).log_softmax(-1)
    upper = distance - k[..., 0]
    entropy = -(1 - upper) * log_p.gather(-1, k)[..., 0] - upper * log_p.gather(-1, k + 1)[..., 0]
    return entropy.mean(1)
