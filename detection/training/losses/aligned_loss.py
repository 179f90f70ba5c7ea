"""AlignedLoss: the loss of an anchor-free network with class scores and distributions of distances.

    loss = batch * (7.5 box + 1.5 bins + 0.5 class)

    class   sum over cells and classes of the binary cross-entropy; the target is t, see `aligned_assignment`, times the
            confidence of the object: 1 for labels, the probability of being right for pseudo-labels
    box     sum over positive cells of t (1 - CIoU)
    bins    sum over positive cells and sides of t (-(k + 1 - d) log P(k) - (d - k) log P(k + 1)), d = distance in
            cells, k = floor(d)

Each sum is divided by the sum of all t. A class that is not completely labelled contributes only a fraction to cells
that are not its positives, since an unlabelled object may be there; cells inside an ignored box contribute nothing.

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
from track_range.detection.training.networks.network import cells_xy
from track_range.detection.training.networks.road_net import N_BINS, RoadNet, split_outputs

_BOX, _BINS, _CLASS = 7.5, 1.5, 0.5


class AlignedLoss:
    """The loss function of a network; see the module's description."""

    def __init__(self, network: RoadNet, *, box_loss: BoxLoss = "ciou", incomplete_weight: float = 0.2) -> None:
        self._network = network
        self._overlap = BOX_LOSSES[box_loss]
        self._incomplete_weight = incomplete_weight

    def __call__(self, raw: list[Tensor], batch: Batch) -> Losses:
        """The losses of the network's outputs `raw` for a batch."""
        strides = self._network.strides_px
        centre = torch.cat(
            [
                (cells_xy(o.shape[1], o.shape[2], device=o.device).flatten(0, 1) + 0.5) * s
                for o, s in zip(raw, strides, strict=True)
            ]
        )
        stride = torch.cat(
            [
                torch.full((o.shape[1] * o.shape[2],), float(s), device=o.device)
                for o, s in zip(raw, strides, strict=True)
            ]
        )
        outputs = torch.cat([o.flatten(1, 2) for o in raw], 1).float()
        with torch.no_grad():
            logits, distances = split_outputs(outputs)
            low, high = (centre - distances[..., :2] * stride[:, None], centre + distances[..., 2:] * stride[:, None])
            scores = logits.sigmoid()
        labels = batch.objects.select(~batch.objects.is_ignored)
        positives = assign_aligned(labels, scores, torch.cat([low, high], -1), centre, stride)
        index, cell, which = positives.image, positives.cell, positives.object_index
        weight = positives.target * labels.confidence[which]
        total = weight.sum().clamp(min=1.0)

        target = torch.zeros_like(logits)
        target[index, cell, labels.class_index[which]] = weight
        entropy = cross_entropy(outputs[..., : logits.shape[-1]], target, reduction="none")
        class_score = (entropy * self._class_weight(batch, centre, target)).sum() / total

        here, side = outputs[index, cell], stride[cell][:, None]
        _, distance = split_outputs(here)
        box_low = centre[cell] - distance[:, :2] * side
        box_high = centre[cell] + distance[:, 2:] * side
        truth = labels.cxcywh[which]
        overlap = self._overlap(torch.cat([(box_low + box_high) / 2, box_high - box_low], 1), truth)
        box = ((1 - overlap) * weight).sum() / total

        low_side = centre[cell] - (truth[:, :2] - truth[:, 2:] / 2)
        high_side = truth[:, :2] + truth[:, 2:] / 2 - centre[cell]
        d = (torch.cat([low_side, high_side], 1) / side).clamp(0, N_BINS - 1.01)
        log_p = here[:, -4 * N_BINS :].unflatten(-1, (4, N_BINS)).log_softmax(-1)
        k = d.floor().long()[..., None]
        upper = d - k[..., 0]
        bins = -(1 - upper) * log_p.gather(-1, k)[..., 0] - upper * log_p.gather(-1, k + 1)[..., 0]
        bins = (bins.mean(1) * weight).sum() / total
        return {"box": _BOX * box, "bins": _BINS * bins, "class": _CLASS * class_score}

    def _class_weight(self, batch: Batch, centre: Tensor, target: Tensor) -> Tensor:
        """(B, N, C) weight of each cell and class in the class loss."""
        right_below = (centre[None] >= batch.complete.meeting_xy[:, None]).long()  # (B, N, 2)
        image = torch.arange(len(target), device=target.device)[:, None]
        complete = batch.complete.flags[image, right_below[..., 1], right_below[..., 0]]
        weight = torch.where(complete | (target > 0), 1.0, self._incomplete_weight)
        ignored = batch.objects.select(batch.objects.is_ignored)
        if len(ignored.image):
            inside = ((centre - ignored.cxcywh[:, None, :2]).abs() < ignored.cxcywh[:, None, 2:] / 2).all(-1)
            is_ignored = (
                torch.zeros(target.shape[:2], device=target.device).index_add_(0, ignored.image, inside.float()) > 0
            )
            weight = torch.where(is_ignored[..., None] & (target == 0), 0.0, weight)
        return weight
