"""TrainingSettings, and the device and precision to train with."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import torch

from track_range.detection.training.data.augmentation import AugmentationSettings
from track_range.detection.training.errors import TrainingError
from track_range.detection.training.losses.box_losses import BoxLoss
from track_range.detection.training.schedule import ScheduleSettings

COARSEST_STRIDE_PX = 32  # the input size must be a multiple of it
MIN_GAIN, MAX_GAIN = 0.05, 16.0  # limits of `AugmentationSettings.min_gain` and `max_gain`


Precision = Literal["float32", "bfloat16", "float16"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingSettings:
    """Settings of a training run."""

    # side of the square training images, and longer side of the validation images
    size_px: int = 416
    n_epochs: int = 100
    batch_size: int = 16
    seed: int = 0
    box_loss: BoxLoss = "ciou"
    device: str = "cpu"  # torch device, such as "cpu" or "cuda"
    # precision of the network's arithmetic; losses and weights are float32
    precision: Precision = "float32"
    validate_every: int = 1  # epochs between validations; the last epoch is always validated
    min_boxes: int = 50  # classes with fewer labels are excluded from the means of the validation
    schedule: ScheduleSettings = field(default_factory=ScheduleSettings)
    augmentation: AugmentationSettings = field(default_factory=AugmentationSettings)
    # at the end, without mosaics, to learn from whole images (Ge et al., "YOLOX", 2021)
    n_last_epochs: int = 0
    n_int8_epochs: int = 0  # number of epochs at the end in which INT8 rounding is simulated

    def __post_init__(self) -> None:
        if self.size_px % COARSEST_STRIDE_PX:
            lower = max(self.size_px // COARSEST_STRIDE_PX, 1) * COARSEST_STRIDE_PX
            raise TrainingError(
                f"--size: expected a multiple of {COARSEST_STRIDE_PX}, such as {lower}, got "
                f"{self.size_px}."
            )
        for flag, n in (
            ("--last-epochs", self.n_last_epochs),
            ("--int8-epochs", self.n_int8_epochs),
        ):
            if n > self.n_epochs:
                raise TrainingError(
                    f"{flag}: expected at most {self.n_epochs}, the number of --epochs, got {n}."
                )
        low, high = self.augmentation.min_gain, self.augmentation.max_gain
        if not MIN_GAIN <= low <= high <= MAX_GAIN:
            limits = f"{MIN_GAIN:g} <= MIN <= MAX <= {MAX_GAIN:g}"
            raise TrainingError(
                f"--gain: expected {limits}, such as 0.5 1.5, got {low:g} {high:g}."
            )

    def augmentation_in(self, epoch: int) -> AugmentationSettings:
        """Augmentation in an epoch, counted from 0."""
        if epoch < self.n_epochs - self.n_last_epochs:
            return self.augmentation
        return replace(self.augmentation, mosaic=0.0)

    def is_rounded_in(self, epoch: int) -> bool:
        """Whether INT8 rounding is simulated in an epoch, counted from 0."""
        return epoch >= self.n_epochs - self.n_int8_epochs

    @property
    def dtype(self) -> torch.dtype:
        """The precision as a torch dtype."""
        return {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}[
            self.precision
        ]


def usable_device(name: str) -> tuple[str, str]:
    """The torch device for "auto", "cpu", "cuda" or torch's name of a device, and a note if it
    differs from `name`.

    TrainingError if the name is unknown, or the device is neither a CPU nor a CUDA GPU.
    """
    has_gpu = torch.cuda.is_available()
    if name == "auto":
        return ("cuda" if has_gpu else "cpu"), ""
    try:
        kind = torch.device(name).type
    except RuntimeError as error:
        raise TrainingError(f"--device: expected auto, cpu or cuda, got '{name}'.") from error
    if kind not in ("cpu", "cuda"):
        raise TrainingError(f"--device: training supports cpu and cuda, got '{name}'.")
    if kind == "cuda":
        try:
            torch.zeros(1, device=name)
        except (RuntimeError, AssertionError):  # no such GPU; a PyTorch without CUDA
            note = (
                f"--device {name} is not available on this machine (no GPU, or PyTorch without "
                "CUDA); training on cpu."
            )
            return "cpu", note
    return name, ""


def best_precision(device: str) -> Precision:
    """Half precision if the device supports it (at least twice as fast), else float32."""
    if device.startswith("cuda"):
        return "float16"
    # from PyTorch 2.11
    capabilities: Mapping[str, object] = getattr(torch.cpu, "get_capabilities", dict)()
    return (
        "bfloat16" if capabilities.get("avx512_bf16") or capabilities.get("amx_bf16") else "float32"
    )
