"""AlignedLoss: the loss of an anchor-free network with class scores and distributions of distances.

    loss = batch * (7.5 box + 1.5 bins + 0.5 class)

    class   sum over cells and classes of the binary cross-entropy; the target is w
    box     sum over positive cells of w (1 - CIoU)
    bins    sum over positive cells of w (-(k + 1 - d) log P(k) - (d - k) log P(k + 1)), mean over the four sides,
            d = distance in cells, k = floor(d)

w is the target of `aligned_assignment` times the confidence of the object: 1 for labels, the probability of being right
for pseudo-labels. Each sum is divided by the sum of w over the cells with a box, at least 1. A class that is not
completely labelled contributes only a fraction to cells that are not its positives, since an unlabelled object may be
there; cells inside an ignored box contribute nothing.

(Weights: Jocher et al., "YOLOv8"; bins: Li et al., "Generalized Focal Loss", 2020, equation 6, "distribution focal
loss".)
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits as cross_entropy

from track_range.detection.training.losses.aligned_assignment import assign_aligned
from track_range.detection.training.losses.box_losses import BOX_LOSSES, BoxLoss
from track_range.detection.training.losses.detection_loss import Batch, Losses
from track_range.detection.training.networks.road_net import N_BINS, RoadNet, boxes_of, split_outputs

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
        centre_px, stride_px = self._network.cells_px([(o.shape[1], o.shape[2]) for o in raw], device=outputs.device)
        labels = batch.objects.select(~batch.objects.is_ignored)
        with torch.no_grad():
            logits, distances = split_outputs(outputs)
            cxcywh_px = boxes_of(distances, centre_px, stride_px)
            cells = assign_aligned(labels, logits.sigmoid(), cxcywh_px, centre_px, stride_px)
        weight = cells.target * labels.confidence[cells.object_index]
        total = weight[cells.has_box].sum().clamp(min=1.0)

        target = torch.zeros_like(logits)
        n_cells, n_classes = logits.shape[1:]
        column = labels.class_index[cells.object_index] + n_classes * (cells.cell + n_cells * cells.image)
        target.view(-1).scatter_reduce_(0, column, weight, "amax")
        entropy = cross_entropy(outputs[..., : logits.shape[-1]], target, reduction="none")
        class_score = (entropy * _class_weight(batch, centre_px, target)).sum()

        cells, weight = cells.select(cells.has_box), weight[cells.has_box]
        truth, centre_px, stride_px = labels.cxcywh[cells.object_index], centre_px[cells.cell], stride_px[cells.cell]
        predicted = outputs[cells.image, cells.cell]
        overlap = self._overlap(boxes_of(split_outputs(predicted)[1], centre_px, stride_px), truth)
        box = ((1 - overlap) * weight).sum()
        bins = (_bins_loss(predicted[:, -4 * N_BINS :], truth, centre_px, stride_px) * weight).sum()
        return {"box": _BOX * box / total, "bins": _BINS * bins / total, "class": _CLASS * class_score / total}


def _class_weight(batch: Batch, centre_px: Tensor, target: Tensor) -> Tensor:
    """(B, N, C) weight of each cell and class in the class loss."""
    right_below = (centre_px[None] >= batch.complete.meeting_xy[:, None]).long()  # (B, N, 2)
    image = torch.arange(len(target), device=target.device)[:, None]
    complete = batch.complete.flags[image, right_below[..., 1], right_below[..., 0]]
    weight = torch.where(complete | (target > 0), 1.0, _INCOMPLETE)
    ignored = batch.objects.select(batch.objects.is_ignored)
    if len(ignored.image):
        is_inside = ((centre_px - ignored.cxcywh[:, None, :2]).abs() < ignored.cxcywh[:, None, 2:] / 2).all(-1)
        n_inside = torch.zeros(target.shape[:2], device=target.device)
        n_inside.index_add_(0, ignored.image, is_inside.float())
        weight = torch.where((n_inside > 0)[..., None] & (target == 0), 0.0, weight)
    return weight


def _bins_loss(bins: Tensor, truth_cxcywh: Tensor, centre_px: Tensor, stride_px: Tensor) -> Tensor:
    """(P,) distribution focal loss, mean over the sides, of P cells with the logits `bins` (P, 4 bins)."""
    half = truth_cxcywh[:, 2:] / 2
    from_centre_px = truth_cxcywh[:, :2] - centre_px
    distance = torch.cat([half - from_centre_px, half + from_centre_px], 1) / stride_px[:, None]
    distance = distance.clamp(0, N_BINS - 1.01)
    k = distance.floor().long()[..., None]
    log_p = bins.reshape(-1, 4, N_BINS).log_softmax(-1)
    upper = distance - k[..., 0]
    entropy = -(1 - upper) * log_p.gather(-1, k)[..., 0] - upper * log_p.gather(-1, k + 1)[..., 0]
    return entropy.mean(1)
