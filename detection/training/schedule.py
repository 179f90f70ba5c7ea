"""Learning rate over a run, the optimiser's groups, and the moving average of the weights."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import torch
from torch import nn

from track_range.detection.training.networks.network import AnchorNetwork

Optimiser = Literal["sgd", "adamw"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ScheduleSettings:
    """Optimiser and learning rate.

    The defaults are for runs that two cores can pay: in 5 epochs of 1,500 images, AdamW's losses were where those of
    YOLOv5's own recipe for COCO (SGD, rate 0.01, decay 0.0005, hyp.scratch-low.yaml) came two epochs later.

    Attributes:
        optimiser: SGD with Nesterov momentum, or AdamW.
        learning_rate: after the warm-up.
        last_share: of it at the end of the cosine.
        momentum: after the warm-up; before, it rises from 0.8.
        weight_decay: of convolutions' weights; biases and batch norms have none.
        warmup_epochs: in which the rate rises from 0 (SGD's of biases: falls from ten times); at most n_epochs / 5.
        average_share: of all steps that the average of the weights looks back on; at most 10,000 steps (YOLOv5's).
    """

    optimiser: Optimiser = "adamw"
    learning_rate: float = 0.002
    last_share: float = 0.01
    momentum: float = 0.937
    weight_decay: float = 0.02
    warmup_epochs: float = 1.0
    average_share: float = 0.04


SGD = ScheduleSettings(optimiser="sgd", learning_rate=0.01, weight_decay=5e-4, warmup_epochs=3.0)
"""YOLOv5's own (hyp.scratch-low.yaml); there, small batches are added up to 64 images per step."""


class Schedule:
    """Sets the optimiser's rates before each step; it knows nothing but the step's number, so a resumed run agrees."""

    def __init__(self, settings: ScheduleSettings, *, n_epochs: int, n_steps_per_epoch: int) -> None:
        self._settings, self._n_steps = settings, n_epochs * n_steps_per_epoch
        self._n_warm = max(round(min(settings.warmup_epochs, n_epochs / 5) * n_steps_per_epoch), 1)

    def rate(self, step: int) -> float:
        """Learning rate of a step, the warm-up left aside."""
        falling = (1 + math.cos(math.pi * min(step / self._n_steps, 1.0))) / 2
        return self._settings.learning_rate * (self._settings.last_share + (1 - self._settings.last_share) * falling)

    def set(self, optimiser: torch.optim.Optimizer, step: int) -> None:
        """Rates and momentum for a step."""
        warm = min(step / self._n_warm, 1.0)
        for group in optimiser.param_groups:
            start = 10 * self._settings.learning_rate if group["name"] == "bias" and "betas" not in group else 0.0
            group["lr"] = start + warm * (self.rate(step) - start)
            momentum = 0.8 + warm * (self._settings.momentum - 0.8)
            if "betas" in group:
                group["betas"] = (momentum, group["betas"][1])
            else:
                group["momentum"] = momentum

    def average_decay(self, step: int) -> float:
        """Share of the old average that is kept in a step; less while the run is young."""
        horizon = min(max(self._settings.average_share * self._n_steps, 1.0), 10_000.0)
        return (1 - 1 / horizon) * (1 - math.exp(-(step + 1) / (horizon / 5)))


def optimiser_of(network: nn.Module, settings: ScheduleSettings) -> torch.optim.Optimizer:
    """The optimiser with three groups: weights that decay, norms that do not, biases that warm up in their own way."""
    norms = {id(p) for module in network.modules() if isinstance(module, nn.BatchNorm2d) for p in module.parameters()}
    groups: dict[str, list[nn.Parameter]] = {"weight": [], "norm": [], "bias": []}
    for name, parameter in network.named_parameters():
        kind = "bias" if name.endswith(".bias") else "norm" if id(parameter) in norms else "weight"
        groups[kind].append(parameter)
    named = [
        {"params": each, "name": kind, "weight_decay": settings.weight_decay if kind == "weight" else 0.0}
        for kind, each in groups.items()
    ]
    if settings.optimiser == "adamw":
        return torch.optim.AdamW(named, lr=settings.learning_rate, betas=(settings.momentum, 0.999))
    return torch.optim.SGD(named, lr=settings.learning_rate, momentum=settings.momentum, nesterov=True)


class WeightAverage:
    """Exponential moving average of a network's weights and batch statistics."""

    def __init__(self, network: AnchorNetwork) -> None:
        self.network = copy.deepcopy(network).eval()
        for parameter in self.network.parameters():
            parameter.requires_grad_(False)

    @torch.no_grad()
    def update(self, network: nn.Module, decay: float) -> None:
        """Move towards the network's weights."""
        for mine, theirs in zip(_floats(self.network), _floats(network), strict=True):
            mine.lerp_(theirs, 1 - decay)


def _floats(network: nn.Module) -> Iterator[torch.Tensor]:
    return (value for value in network.state_dict().values() if value.dtype.is_floating_point)
