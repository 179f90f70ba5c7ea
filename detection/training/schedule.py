"""Learning-rate schedule, parameter groups of the optimiser, and moving average of the weights."""

import copy
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import torch
from torch import nn

from track_range.detection.training.networks.network import DetectionNetwork

Optimiser = Literal["sgd", "adamw"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScheduleSettings:
    """Optimiser and learning rate.

    The defaults are for short runs on a CPU: in 5 epochs of 1,500 images, AdamW reached losses for
    which YOLOv5's recipe for COCO (SGD, rate 0.01, decay 0.0005, hyp.scratch-low.yaml) needed two
    more epochs. During the warm-up, the rate rises linearly from 0 (with SGD, the rate of the
    biases falls from ten times `learning_rate`).
    """

    optimiser: Optimiser = "adamw"  # SGD with Nesterov momentum, or AdamW
    learning_rate: float = 0.002  # learning rate after the warm-up
    # final learning rate of the cosine schedule, as a fraction of `learning_rate`
    last_share: float = 0.01
    momentum: float = 0.937  # momentum after the warm-up, during which it rises from 0.8
    # weight decay of the convolutions' weights; biases and batch norms have none
    weight_decay: float = 0.02
    warmup_epochs: float = 1.0  # at most n_epochs / 5
    # time constant of the average of weights, of all steps; at most 10,000 as in YOLOv5
    average_share: float = 0.04


SGD = ScheduleSettings(optimiser="sgd", learning_rate=0.01, weight_decay=5e-4, warmup_epochs=3.0)
"""YOLOv5's recipe (hyp.scratch-low.yaml), without its accumulation of small batches to 64 images
per step."""


class Schedule:
    """Learning rate and momentum of each step; they depend on the step's number only, so that runs
    can be resumed.
    """

    def __init__(
        self, settings: ScheduleSettings, *, n_epochs: int, n_steps_per_epoch: int
    ) -> None:
        self._settings, self._n_steps = settings, n_epochs * n_steps_per_epoch
        self._n_warm = max(round(min(settings.warmup_epochs, n_epochs / 5) * n_steps_per_epoch), 1)

    def rate(self, step: int) -> float:
        """Rate of a step without warm-up: learning_rate (last_share + (1 - last_share) (1 + cos(pi
        step / n)) / 2).
        """
        cosine = (1 + math.cos(math.pi * min(step / self._n_steps, 1.0))) / 2
        last = self._settings.last_share
        return self._settings.learning_rate * (last + (1 - last) * cosine)

    def set(self, optimiser: torch.optim.Optimizer, step: int) -> None:
        """Set the optimiser's learning rates and momentum for a step."""
        warm = min(step / self._n_warm, 1.0)
        for group in optimiser.param_groups:
            start = (
                10 * self._settings.learning_rate
                if group["name"] == "bias" and "betas" not in group
                else 0.0
            )
            group["lr"] = start + warm * (self.rate(step) - start)
            momentum = 0.8 + warm * (self._settings.momentum - 0.8)
            if "betas" in group:
                group["betas"] = (momentum, group["betas"][1])
            else:
                group["momentum"] = momentum

    def average_decay(self, step: int) -> float:
        """Weight of the old average in the update after a step; smaller at the start of a run."""
        horizon = min(max(self._settings.average_share * self._n_steps, 1.0), 10_000.0)
        return (1 - 1 / horizon) * (1 - math.exp(-(step + 1) / (horizon / 5)))


def optimiser_of(network: nn.Module, settings: ScheduleSettings) -> torch.optim.Optimizer:
    """The optimiser with three parameter groups: weights with decay, batch norms, and biases."""
    norms = {
        id(p)
        for module in network.modules()
        if isinstance(module, nn.BatchNorm2d)
        for p in module.parameters()
    }
    groups: dict[str, list[nn.Parameter]] = {"weight": [], "norm": [], "bias": []}
    for name, parameter in network.named_parameters():
        kind = "norm" if id(parameter) in norms else "weight"
        if name.endswith(".bias"):
            kind = "bias"
        groups[kind].append(parameter)
    named = [
        {
            "params": parameters,
            "name": kind,
            "weight_decay": settings.weight_decay if kind == "weight" else 0.0,
        }
        for kind, parameters in groups.items()
    ]
    if settings.optimiser == "adamw":
        return torch.optim.AdamW(named, lr=settings.learning_rate, betas=(settings.momentum, 0.999))
    return torch.optim.SGD(
        named, lr=settings.learning_rate, momentum=settings.momentum, nesterov=True
    )


class WeightAverage:
    """Exponential moving average of weights and batch-norm statistics, in a copy of the network,
    `network`.
    """

    def __init__(self, network: DetectionNetwork) -> None:
        self.network = copy.deepcopy(network).eval()
        for parameter in self.network.parameters():
            parameter.requires_grad_(False)

    @torch.no_grad()
    def update(self, network: nn.Module, decay: float) -> None:
        """Update the average with the network's weights: average = decay * average + (1 - decay) *
        weights.
        """
        for average, weights in zip(_floats(self.network), _floats(network), strict=True):
            average.lerp_(weights, 1 - decay)


def _floats(network: nn.Module) -> Iterator[torch.Tensor]:
    return (value for value in network.state_dict().values() if value.dtype.is_floating_point)
