"""FeatureLoss: the loss by which a network's features imitate the features of a teacher.

    loss = 2 * sum over P3, P4, P5 of mean over channels of (1 - r)

r is Pearson's correlation, over all cells of a batch, of a channel of the teacher's neck and the
same channel predicted from the student's neck by a 1x1 convolution. The convolutions are trained
with the student and not exported. A teacher that was trained on far more images than the student
thereby teaches the student every cell of every image, not only boxes; the correlation is
independent of the scale of the features, so that levels and channels count equally.

(Cao et al., "PKD: General Distillation Framework for Object Detectors via Pearson Correlation
Coefficient", NeurIPS 2022; the convolutions: Romero et al., "FitNets", 2015.)
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from track_range.detection.training.networks.road_net import RoadNet
from track_range.detection.training.teacher import Teacher

_WEIGHT = 2.0  # relative to the losses of boxes and classes
# rounding error of a constant channel, relative to it, and smallest variance
_RESOLUTION, _TINY = 1e-5, 1e-30


class FeatureLoss(nn.Module):
    """The loss of a student's features and its trained convolutions; see the module's
    description.
    """

    def __init__(self, teacher: Teacher, student: RoadNet) -> None:
        super().__init__()
        self._teacher = teacher
        channels = zip(student.body.n_channels, teacher.network.body.n_channels, strict=True)
        self.predictors = nn.ModuleList(
            nn.Conv2d(n_student, n_teacher, 1, bias=False) for n_student, n_teacher in channels
        )

    def forward(self, levels: Sequence[Tensor], images: Tensor) -> Tensor:
        """The loss of a batch of RGB images (B, 3, H, W) in 0..1.

        `levels` are the features (B, n, rows, columns) of the student's neck at strides 8, 16, 32;
        coarser levels are ignored.
        """
        pairs = zip(self.predictors, levels, self._teacher.features(images), strict=False)
        return (
            _WEIGHT
            * torch.stack(
                [(1 - correlation(own(level), of)).mean() for own, level, of in pairs]
            ).sum()
        )


def correlation(first: Tensor, second: Tensor) -> Tensor:
    """(n,) Pearson's correlation of the channels of two arrays (B, n, rows, columns), 0 where one
    is constant.
    """
    first, second = (_standardised(values.float()) for values in (first, second))
    return (first * second).mean((0, 2, 3))


def _standardised(values: Tensor) -> Tensor:
    centred = values - values.mean((0, 2, 3), keepdim=True)
    rounding = _RESOLUTION**2 * values.detach().square().mean((0, 2, 3), keepdim=True)
    return centred * (centred.square().mean((0, 2, 3), keepdim=True) + rounding + _TINY).rsqrt()
