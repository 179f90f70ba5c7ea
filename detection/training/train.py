"""Training: one plain loop over epochs and batches.

The run folder gets `last.pt` after every epoch (network, average, optimiser, history), `best.pt` whenever validation
improves, and `results.csv`. What a step does depends on the settings, the seed and the step's number alone, so a run
that was killed and resumed takes the same steps as one that was not.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from detection.classes import ROAD_CLASSES
from detection.detections import Image, IntArray
from detection.evaluation import DetectionScores
from detection.image_truth import ImageTruth
from detection.training.batches import BatchMaker, LabelledSet, scaled
from detection.training.detection_loss import Batch, DetectionLoss, Losses
from detection.training.errors import CheckpointError, TrainingError
from detection.training.network import AnchorNetwork, placed
from detection.training.run_folder import (
    BEST,
    LAST,
    RESULTS,
    load_checkpoint,
    save_checkpoint,
    write_results,
)
from detection.training.schedule import Schedule, WeightAverage, optimiser_of
from detection.training.settings import TrainingSettings
from detection.training.teacher import Teacher
from detection.training.validation import NetworkDetector, validate

_MAX_GRADIENT = 10.0
"""Norm of the whole gradient (YOLOv5's)."""

_LOSSES = ("loss_box", "loss_objectness", "loss_class")


class ValidationSet(Protocol):
    """Images with their truth."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[tuple[Image, ImageTruth]]: ...


class Listener(Protocol):
    """Hears how training goes."""

    def step(self, epoch: int, i: int, n: int, losses: Losses) -> None:
        """After batch `i` of `n`."""
        ...

    def validated(self, epoch: int, i: int, n: int) -> None:
        """After validation image `i` of `n`."""
        ...

    def epoch(self, row: dict[str, float]) -> None:
        """After each epoch, with its row of results.csv."""
        ...


@dataclass(frozen=True, slots=True)
class TrainingSets:
    """Images to train and validate on, and the road class of each of the network's classes, (C,)."""

    train: LabelledSet
    validation: ValidationSet
    road_class_id: IntArray


class Training:
    """A network being trained.

    Attributes:
        network: as the optimiser leaves it.
        average: its moving average, which is validated, kept and exported.
        history: a row of results.csv per epoch done.
    """

    def __init__(
        self,
        network: AnchorNetwork,
        settings: TrainingSettings,
        sets: TrainingSets,
        out: Path,
        *,
        teacher: Teacher | None = None,
    ) -> None:
        self._settings, self._sets, self._out, self._teacher = settings, sets, out, teacher
        self._device = torch.device(settings.device)
        self.network = placed(network, self._device)
        self.average = WeightAverage(self.network)
        self._batches = BatchMaker(
            sets.train, size_px=settings.size_px, batch_size=settings.batch_size, seed=settings.seed
        )
        self._loss = DetectionLoss(self.network, box_loss=settings.box_loss)
        self._optimiser = optimiser_of(self.network, settings.schedule)
        self._schedule = Schedule(settings.schedule, n_epochs=settings.n_epochs, n_steps_per_epoch=len(self._batches))
        self._scaler = torch.amp.GradScaler(self._device.type, enabled=settings.precision == "float16")
        self.history: list[dict[str, float]] = []

    def resume(self) -> None:
        """Go on from the run folder's last checkpoint.

        Raises:
            CheckpointError: none there, damaged, or of another model or run.
        """
        path = self._out / LAST
        content = load_checkpoint(path)
        mine, theirs = self._identity(), content["identity"]
        for key, value in mine.items():
            if value != theirs.get(key):
                raise CheckpointError(
                    f"{path}: of another run: {key} is {theirs.get(key)} there and {value} here; give the options that "
                    "it began with, or another --out."
                )
        self.network.load_state_dict(content["network"])
        self.average.network.load_state_dict(content["average"])
        self._optimiser.load_state_dict(content["optimiser"])
        self._scaler.load_state_dict(content["scaler"])
        self.history = content["history"]

    def start_from(self, path: Path) -> None:
        """Begin with the averaged weights of another run's checkpoint, and nothing else of it.

        Raises:
            CheckpointError: none there, damaged, or of another network.
        """
        self._take(self.network, path)
        self._take(self.average.network, path)

    def take_best(self) -> None:
        """Make the average that of the best epoch; that of the last one, where no validation could tell.

        Raises:
            CheckpointError: the checkpoint is damaged.
        """
        if (self._out / BEST).is_file():
            self._take(self.average.network, self._out / BEST)

    def _take(self, network: AnchorNetwork, path: Path) -> None:
        content = load_checkpoint(path)
        try:
            network.load_state_dict(content["average"])
        except (RuntimeError, KeyError) as error:
            theirs = content.get("identity", {})
            raise CheckpointError(
                f"{path}: of another network ({theirs.get('model')}, {len(theirs.get('classes', []))} classes, "
                f"attention {theirs.get('attention')}); --model, --attention and the classes must be the same."
            ) from error

    def run(self, listener: Listener) -> None:
        """Train until the last epoch is done.

        Raises:
            TrainingError: the loss is no number any more, or memory ran out.
            CheckpointError: a checkpoint cannot be written.
        """
        try:
            while len(self.history) < self._settings.n_epochs:
                self._epoch(listener)
        except (MemoryError, RuntimeError) as error:
            if not _is_out_of_memory(error):
                raise
            batch = self._settings.batch_size
            raise TrainingError(
                f"memory ran out with a batch of {batch}: try --batch {max(batch // 2, 1)}, or a smaller --size."
            ) from error

    def scores(self, listener: Listener | None = None) -> DetectionScores:
        """The average's figures on the validation images."""
        detector = NetworkDetector(
            self.average.network,
            self._sets.road_class_id,
            size_px=self._settings.size_px,
            device=self._device,
            precision=self._settings.dtype,
        )
        epoch, n = len(self.history), len(self._sets.validation)
        return validate(
            detector,
            self._sets.validation,
            self._sets.road_class_id,
            min_boxes=self._settings.min_boxes,
            done=lambda i: listener.validated(epoch, i, n) if listener else None,
        )

    def _epoch(self, listener: Listener) -> None:
        epoch, began_s = len(self.history), time.perf_counter()
        row = {"epoch": epoch + 1.0, "rate": self._schedule.rate(epoch * len(self._batches))}
        row |= dict(zip(_LOSSES, self._learn(epoch, listener), strict=True))
        if (epoch + 1) % self._settings.validate_every == 0 or epoch + 1 == self._settings.n_epochs:
            row |= _figures(self.scores(listener))
        row["minutes"] = (time.perf_counter() - began_s) / 60
        self._keep(row)
        listener.epoch(row)

    def _learn(self, epoch: int, listener: Listener) -> list[float]:
        """One epoch; its mean losses."""
        self.network.train()
        total, n = np.zeros(3), len(self._batches)
        done = 0
        for done, batch in enumerate(self._batches.epoch(epoch, self._settings.augmentation), start=1):
            step = epoch * n + done - 1
            self._schedule.set(self._optimiser, step)
            losses = self._step(batch)
            self.average.update(self.network, self._schedule.average_decay(step))
            total += losses.numbers()
            if not np.isfinite(total).all():
                raise TrainingError(
                    f"the loss is no number any more in epoch {epoch + 1}; try a lower --learning-rate, or "
                    "--precision float32. The checkpoint of the last epoch is sound."
                )
            listener.step(epoch, done, n, losses)
        mean: list[float] = (total / max(done, 1)).tolist()
        return mean

    def _step(self, batch: Batch) -> Losses:
        """Learn from one batch."""
        settings, device = self._settings, self._device
        images = scaled(batch.images.to(device, memory_format=torch.channels_last))
        answers = None if self._teacher is None else self._teacher.look(images)
        batch = Batch(batch.images, batch.objects.to(device), batch.is_complete.to(device), answers)
        with torch.autocast(device.type, settings.dtype, settings.precision != "float32"):
            raw = self.network(images)
        losses = self._loss([head.float() for head in raw], batch)
        torch.autograd.backward(self._scaler.scale(losses.total * len(images)))
        self._scaler.unscale_(self._optimiser)
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), _MAX_GRADIENT)
        self._scaler.step(self._optimiser)
        self._scaler.update()
        self._optimiser.zero_grad(set_to_none=True)
        return losses

    def _keep(self, row: dict[str, float]) -> None:
        """Write the epoch's checkpoint and results."""
        best = max((each.get("ap50", -1.0) for each in self.history), default=-1.0)
        self.history.append(row)
        content = {
            "identity": self._identity(),
            "network": self.network.state_dict(),
            "average": self.average.network.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "scaler": self._scaler.state_dict(),
            "history": self.history,
        }
        if row.get("ap50", -1.0) > best:
            save_checkpoint(self._out / BEST, content)
        save_checkpoint(self._out / LAST, content)
        write_results(self._out / RESULTS, self.history)

    def _identity(self) -> dict[str, Any]:
        """What makes a checkpoint one of this run."""
        return {
            "model": self.network.name,
            "attention": self.network.has_cbam,
            "classes": [ROAD_CLASSES[i] for i in self._sets.road_class_id],
            "anchors": self.network.anchors_px.tolist(),
            "images": len(self._sets.train),
            "teacher": self._teacher is not None,
            **asdict(self._settings),
        }


def prepare_torch(*, seed: int, n_threads: int = 0) -> None:
    """Make what torch draws from here on, the first weights, the seed's own; and set its threads, 0 = as they are."""
    torch.manual_seed(seed)
    if n_threads:
        torch.set_num_threads(n_threads)


def _figures(scores: DetectionScores) -> dict[str, float]:
    """Of results.csv; NaN where no class is averaged."""
    by_class = {f"ap50_{ROAD_CLASSES[i].replace(' ', '_')}": each.ap50 for i, each in scores.by_class.items()}
    return {"ap50": scores.mean("ap50"), "ap50_95": scores.mean("ap50_95"), **by_class}


def _is_out_of_memory(error: BaseException) -> bool:
    text = str(error).lower()
    return isinstance(error, MemoryError | torch.OutOfMemoryError) or "allocate" in text or "out of memory" in text
