"""TrainingSettings: how to train, and the precision that a device does best."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import torch

from track_range.detection.training.data.augmentation import AugmentationSettings
from track_range.detection.training.errors import TrainingError
from track_range.detection.training.losses.box_losses import BoxLoss
from track_range.detection.training.schedule import ScheduleSettings

COARSEST_STRIDE_PX = 32
MIN_GAIN, MAX_GAIN = 0.05, 16.0

Precision = Literal["float32", "bfloat16", "float16"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingSettings:
    """How to train.

    Attributes:
        size_px: side of the square training images; validation fits the longer side to it.
        n_epochs, batch_size, seed: as they say.
        box_loss: "ciou" or "eiou".
        device: of torch, such as "cpu" or "cuda".
        precision: of the network's arithmetic; losses and weights are float32.
        validate_every: epochs between validations; the last epoch is always validated.
        min_boxes: classes with fewer labels are not averaged in validation.
        schedule: the optimiser, and its rate over the run.
        augmentation: how training images are changed.
    """

    size_px: int = 416
    n_epochs: int = 100
    batch_size: int = 16
    seed: int = 0
    box_loss: BoxLoss = "ciou"
    device: str = "cpu"
    precision: Precision = "float32"
    validate_every: int = 1
    min_boxes: int = 50
    schedule: ScheduleSettings = field(default_factory=ScheduleSettings)
    augmentation: AugmentationSettings = field(default_factory=AugmentationSettings)

    def __post_init__(self) -> None:
        if self.size_px % COARSEST_STRIDE_PX:
            lower = max(self.size_px // COARSEST_STRIDE_PX, 1) * COARSEST_STRIDE_PX
            raise TrainingError(f"--size {self.size_px}: a multiple of {COARSEST_STRIDE_PX} wanted, such as {lower}.")
        low, high = self.augmentation.min_gain, self.augmentation.max_gain
        if not MIN_GAIN <= low <= high <= MAX_GAIN:
            limits = f"{MIN_GAIN:g} <= MIN <= MAX <= {MAX_GAIN:g}"
            raise TrainingError(f"--gain {low:g} {high:g}: {limits} wanted, such as 0.5 1.5.")

    @property
    def dtype(self) -> torch.dtype:
        """The precision as torch names it."""
        return {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}[self.precision]


def usable_device(wanted: str) -> tuple[str, str]:
    """The device that "auto", "cpu", "cuda" or torch's own word for one means here, and a sentence where it is another.

    Raises:
        TrainingError: torch knows no such device.
    """
    has_gpu = torch.cuda.is_available()
    if wanted == "auto":
        return ("cuda" if has_gpu else "cpu"), ""
    try:
        kind = torch.device(wanted).type
    except RuntimeError as error:
        raise TrainingError(f"--device {wanted}: no device of that name; auto, cpu or cuda wanted.") from error
    if kind not in ("cpu", "cuda"):
        raise TrainingError(f"--device {wanted}: training is on cpu or cuda.")
    if kind == "cuda" and not _is_usable(wanted):
        return (
            "cpu",
            f"--device {wanted} is not to be had here (no GPU, or a PyTorch without CUDA): training on cpu.",
        )
    return wanted, ""


def _is_usable(device: str) -> bool:
    """Torch can put something there."""
    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError):  # no such GPU; a PyTorch without CUDA
        return False
    return True


def best_precision(device: str) -> Precision:
    """Half precision where the device computes in it (twice as fast and more), else float32."""
    if device.startswith("cuda"):
        return "float16"
    told: Mapping[str, object] = getattr(torch.cpu, "get_capabilities", dict)()  # PyTorch 2.11 and later tell
    return "bfloat16" if told.get("avx512_bf16") or told.get("amx_bf16") else "float32"
