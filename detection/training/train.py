"""Training: the loop over epochs and batches.

After every epoch, `last.pt` (network, average, optimiser, history) and `results.csv` are written to
the run folder, and `best.pt` whenever the validation improves. A step depends only on the settings,
the seed and its number, so that a resumed run takes the same steps as an uninterrupted one (bit by
bit on a CPU, where the order of sums is fixed).
"""

import copy
import datetime
import json
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import onnx
import torch
from torch import Tensor, nn

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.evaluation import DetectionScores
from track_range.detection.models.writing import atomic_output, silent_conversion
from track_range.detection.training import run_folder
from track_range.detection.training.data.batches import BatchMaker, scaled
from track_range.detection.training.data.data_set import TrainingSets
from track_range.detection.training.errors import CheckpointError, TrainingError
from track_range.detection.training.feature_loss import FeatureLoss
from track_range.detection.training.losses.aligned_loss import AlignedLoss
from track_range.detection.training.losses.detection_loss import Batch, DetectionLoss, Losses
from track_range.detection.training.networks.blocks import ConvolutionBlock
from track_range.detection.training.networks.network import AnchorNetwork, DetectionNetwork, placed
from track_range.detection.training.networks.road_net import RoadNet
from track_range.detection.training.networks.yolov5 import BODY_PREFIX
from track_range.detection.training.schedule import Schedule, WeightAverage, optimiser_of
from track_range.detection.training.settings import TrainingSettings
from track_range.detection.training.teacher import Teacher
from track_range.detection.training.validation import NetworkDetector, validate

_MAX_GRADIENT = 10.0  # norm to which the gradient is clipped, as in YOLOv5


class Listener(Protocol):
    """Callbacks on the progress of training, for example for a progress bar."""

    def step(self, epoch: int, i: int, n: int, losses: Losses) -> None:
        """Called after batch `i` of `n`."""

    def validated(self, epoch: int, i: int, n: int) -> None:
        """Called after validation image `i` of `n`."""

    def epoch(self, row: dict[str, float]) -> None:
        """Called after each epoch with its row of results.csv."""


class Training:
    """A training run."""

    def __init__(
        self,
        network: DetectionNetwork,
        settings: TrainingSettings,
        sets: TrainingSets,
        out: Path,
        *,
        teacher: Teacher | None = None,
    ) -> None:
        self._settings, self._sets, self._out, self._teacher = settings, sets, out, teacher
        self._device = torch.device(settings.device)
        if teacher is not None:
            teacher.check_fits(network)
        self.network = placed(network, self._device)  # with the optimiser's latest weights
        self.average = WeightAverage(self.network)  # validated and exported
        self._batches = BatchMaker(
            sets.train, size_px=settings.size_px, batch_size=settings.batch_size, seed=settings.seed
        )
        self._loss: AlignedLoss | DetectionLoss
        self._feature_loss: FeatureLoss | None = None
        if isinstance(self.network, RoadNet):
            self._loss = AlignedLoss(self.network, box_loss=settings.box_loss)
            if teacher is not None:
                self._feature_loss = FeatureLoss(teacher, self.network).to(self._device)
        elif isinstance(self.network, AnchorNetwork):
            self._loss = DetectionLoss(self.network, box_loss=settings.box_loss)
        else:
            raise TrainingError(
                f"{network.name}: expected a network with a loss function, found none."
            )
        trained = [module for module in (self.network, self._feature_loss) if module is not None]
        self._optimiser = optimiser_of(nn.ModuleList(trained), settings.schedule)
        self._schedule = Schedule(
            settings.schedule, n_epochs=settings.n_epochs, n_steps_per_epoch=len(self._batches)
        )
        self._scaler = torch.amp.GradScaler(
            self._device.type, enabled=settings.precision == "float16"
        )
        self.history: list[dict[str, float]] = []  # one row of results.csv for each completed epoch

    def resume(self) -> None:
        """Continue from the last checkpoint in the run folder; CheckpointError if it is damaged or
        of another run.
        """
        path = self._out / run_folder.LAST
        content = run_folder.load_checkpoint(path)
        try:
            run_folder.check_same_run(path, content["identity"], self._identity())
            self.network.load_state_dict(content["network"])
            self.average.network.load_state_dict(content["average"])
            if self._feature_loss is not None:
                self._feature_loss.load_state_dict(content["feature_loss"])
            self._optimiser.load_state_dict(content["optimiser"])
            self._scaler.load_state_dict(content["scaler"])
            self.history = content["history"]
        except (LookupError, TypeError, ValueError, AttributeError, RuntimeError) as error:
            raise CheckpointError(
                f"{path}: damaged checkpoint ({type(error).__name__})."
            ) from error

    def start_from(self, first: Path, *others: Path) -> None:
        """Initialise the weights with the averaged weights of another run's checkpoint, or with the
        mean of several.

        If that run trained another network with the same backbone and neck (YOLOv5n and RoadNet),
        only these are used. The convolutions of the feature loss are taken from the first
        checkpoint, if it had the same teacher. CheckpointError: the checkpoint does not exist, is
        damaged, or has another network.
        """
        content = run_folder.load_mean([first, *others])
        body = {
            name: value
            for name, value in self.network.state_dict().items()
            if name.startswith(BODY_PREFIX)
        }
        saved, is_other = content["average"], content["identity"].get("model") != self.network.name
        for network in (self.network, self.average.network):
            if is_other and _same_shapes(body, saved):
                network.load_state_dict({name: saved[name] for name in body}, strict=False)
            else:
                self._set_weights(network, content, first)
        if (
            self._feature_loss is not None
            and content["identity"].get("teacher") == self._identity()["teacher"]
        ):
            own, saved = self._feature_loss.state_dict(), content["feature_loss"]
            if _same_shapes(own, saved):
                self._feature_loss.load_state_dict({name: saved[name] for name in own})

    def load_best(self) -> None:
        """Set `average` to the average of the best epoch, if there was a validation."""
        if (self._out / run_folder.BEST).is_file():
            self._set_weights(
                self.average.network,
                run_folder.load_checkpoint(self._out / run_folder.BEST),
                self._out / run_folder.BEST,
            )

    def _set_weights(
        self, network: DetectionNetwork, content: Mapping[str, Any], path: Path
    ) -> None:
        """Set the network's weights to the averaged weights of the checkpoint at `path`; its
        anchors do not change.
        """
        saved, expected = content.get("identity", {}), self._identity()
        anchors_px = network.anchors_px.clone() if isinstance(network, AnchorNetwork) else None
        try:
            if saved["classes"] != expected["classes"]:
                raise KeyError("classes")
            network.load_state_dict(content["average"])
        except (RuntimeError, KeyError, TypeError) as error:
            raise CheckpointError(
                f"{path}: expected the same --model, --attention and class names, got "
                f"{saved.get('model')}, attention {saved.get('attention')}, classes "
                f"{', '.join(saved.get('classes', []))}."
            ) from error
        if isinstance(network, AnchorNetwork) and anchors_px is not None:
            network.anchors_px.copy_(anchors_px)

    def run(self, listener: Listener) -> None:
        """Train until the last epoch; TrainingError if the loss is not finite, or there is not
        enough memory.
        """
        try:
            while len(self.history) < self._settings.n_epochs:
                self._epoch(listener)
        except (MemoryError, RuntimeError) as error:
            text = str(error).lower()
            is_known = isinstance(error, MemoryError | torch.OutOfMemoryError)
            if not is_known and "allocate" not in text and "out of memory" not in text:
                raise
            batch = min(self._settings.batch_size, len(self._sets.train))
            raise TrainingError(
                f"out of memory with --batch {batch}; restart with another --out and with --batch "
                f"{max(batch // 2, 1)} or a smaller --size{self._start_hint()}."
            ) from error

    def scores(self, listener: Listener | None = None) -> DetectionScores:
        """Scores of `average` on the validation images."""
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

    def export(self, path: Path, *, family: str, data: str, licence: str = "") -> None:
        """Write `average` as an ONNX file with the attributes that `detection.yolo.metadata`
        reads.

        `family` and `data` are names of the network's family and of the data set, for display.
        """
        network = self.average.network
        about: dict[str, object] = {
            "family": family,
            "names": [ROAD_CLASSES[i] for i in self._sets.road_class_id],
            "letterbox": "centred-114",
            "colours": "rgb",
            "divisor": 255,
            "mean": [0.0, 0.0, 0.0],
            "std": [1.0, 1.0, 1.0],
            "size": self._settings.size_px,
            "data": data,
            "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
            "epochs": len(self.history),
        }
        if isinstance(network, AnchorNetwork):
            about["trained_anchors"] = network.anchors_px.tolist()
        export_onnx(network, path, about | ({"licence": licence} if licence else {}))

    def _epoch(self, listener: Listener) -> None:
        epoch, start_s = len(self.history), time.perf_counter()
        row = {"epoch": epoch + 1.0, "rate": self._schedule.rate(epoch * len(self._batches))}
        row |= {f"loss_{name}": loss for name, loss in self._learn(epoch, listener).items()}
        if (epoch + 1) % self._settings.validate_every == 0 or epoch + 1 == self._settings.n_epochs:
            scores = self.scores(listener)  # NaN if no class is averaged
            row |= {"ap50": scores.mean("ap50"), "ap50_95": scores.mean("ap50_95")}
            row |= {
                f"ap50_{ROAD_CLASSES[i].replace(' ', '_')}": one.ap50
                for i, one in scores.by_class.items()
            }
        row["minutes"] = (time.perf_counter() - start_s) / 60
        self._save(row)
        listener.epoch(row)

    def _learn(self, epoch: int, listener: Listener) -> dict[str, float]:
        """Train one epoch and return the mean of each part of the loss."""
        self.network.train()
        for module in self.network.modules():
            if isinstance(module, ConvolutionBlock):
                module.is_rounded = self._settings.is_rounded_in(epoch)
        total: dict[str, float] = {}
        done, n = 0, len(self._batches)
        for done, batch in enumerate(
            self._batches.epoch(epoch, self._settings.augmentation_in(epoch)), start=1
        ):
            step = epoch * n + done - 1
            self._schedule.set(self._optimiser, step)
            losses = self._step(batch)
            self.average.update(self.network, self._schedule.average_decay(step))
            total = {
                name: total.get(name, 0.0) + float(loss.detach()) for name, loss in losses.items()
            }
            if not np.isfinite(list(total.values())).all():
                raise TrainingError(
                    f"the loss became NaN or infinite in epoch {epoch + 1}; restart with another "
                    f"--out and a lower --learning-rate or --precision float32{self._start_hint()}."
                )
            listener.step(epoch, done, n, losses)
        return {name: loss / done for name, loss in total.items()}

    def _step(self, batch: Batch) -> Losses:
        settings, device = self._settings, self._device
        images = scaled(batch.images.to(device, memory_format=torch.channels_last))
        targets = (
            None
            if self._teacher is None or self._feature_loss is not None
            else self._teacher.outputs(images)
        )
        batch = Batch(batch.images, batch.objects.to(device), batch.complete.to(device), targets)
        losses: Losses = {}
        with torch.autocast(device.type, settings.dtype, settings.precision != "float32"):
            if self._feature_loss is not None and isinstance(self.network, RoadNet):
                levels = self.network.features(images)
                raw, losses = (
                    self.network.outputs(levels),
                    {"features": self._feature_loss(levels, images)},
                )
            else:
                raw = self.network(images)
        losses = {**self._loss([head.float() for head in raw], batch), **losses}
        torch.autograd.backward(
            self._scaler.scale(torch.stack(list(losses.values())).sum() * len(images))
        )
        self._scaler.unscale_(self._optimiser)
        # Without the convolutions of the feature loss: their gradients must not reduce those of the
        # network.
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), _MAX_GRADIENT)
        self._scaler.step(self._optimiser)
        self._scaler.update()
        self._optimiser.zero_grad(set_to_none=True)
        return losses

    def _start_hint(self) -> str:
        return f", and --weights {self._out / run_folder.LAST}" if self.history else ""

    def _save(self, row: dict[str, float]) -> None:
        is_rounded = self._settings.is_rounded_in
        # Epochs without rounding are no rivals of those with it: validation is in float and does
        # not show the gain.
        rivals = [
            old
            for i, old in enumerate(self.history)
            if is_rounded(i) == is_rounded(len(self.history))
        ]
        best = max((rival.get("ap50", 0.0) for rival in rivals), default=0.0)
        self.history.append(row)
        content = {
            "identity": self._identity(),
            "network": self.network.state_dict(),
            "average": self.average.network.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "scaler": self._scaler.state_dict(),
            "feature_loss": {} if self._feature_loss is None else self._feature_loss.state_dict(),
            "history": self.history,
        }
        if row.get("ap50", -1.0) >= best:  # if equal, the later one, which was trained longer
            run_folder.save_checkpoint(self._out / run_folder.BEST, content)
        run_folder.save_checkpoint(self._out / run_folder.LAST, content)
        run_folder.write_results(self._out / run_folder.RESULTS, self.history)

    def _identity(self) -> dict[str, Any]:
        """The settings that a checkpoint must share to be resumed."""
        return {
            "model": self.network.name,
            "attention": self.network.has_cbam,
            "classes": [ROAD_CLASSES[i] for i in self._sets.road_class_id],
            "anchors": self.network.anchors_px.tolist()
            if isinstance(self.network, AnchorNetwork)
            else None,
            "data": self._sets.name,
            "teacher": None if self._teacher is None else self._teacher.name,
            **{
                key: value
                for key, value in _flat(asdict(self._settings))
                if key not in ("device", "validate_every")
            },
        }


def _same_shapes(own: Mapping[str, Tensor], saved: Mapping[str, Tensor]) -> bool:
    """Whether a checkpoint has all weights (at least one) with the same shapes."""
    return bool(own) and all(
        name in saved and saved[name].shape == value.shape for name, value in own.items()
    )


def prepare_torch(*, seed: int, n_threads: int = 0) -> None:
    """Set torch's random seed and number of threads; 0 = do not change the number of threads."""
    torch.manual_seed(seed)
    if n_threads:
        torch.set_num_threads(n_threads)


def _flat(settings: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Keys and values of nested settings, without the names of the groups."""
    for key, value in settings.items():
        if isinstance(value, Mapping):
            yield from _flat(value)
        else:
            yield key, value


_OPSET = 17


class _Exported(nn.Module):
    def __init__(self, network: DetectionNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> tuple[Tensor, ...]:
        return tuple(self.network.exported(self.network(images)).values())


def export_onnx(network: DetectionNetwork, out: Path, metadata: Mapping[str, object]) -> None:
    """Write a network as an ONNX file that `YoloDetector` loads without options; ModelError if
    impossible.

    The graph ends with `DetectionNetwork.exported`, the input size is variable. The values of
    `metadata`, which `detection.yolo.metadata` reads, are converted to JSON.
    """
    # the network itself stays on its device
    exported = _Exported(copy.deepcopy(network)).cpu().float().eval()
    image = torch.zeros(1, 3, 128, 160)
    with torch.no_grad():
        names = list(exported.network.exported(exported.network(image)))
    variable = {"images": {0: "batch", 2: "height", 3: "width"}}
    with atomic_output(out) as folder:
        path = folder / out.name
        with silent_conversion(out, "exported"):
            torch.onnx.export(
                exported,
                (image,),
                str(path),
                input_names=["images"],
                output_names=names,
                dynamic_axes=variable
                | {name: {0: "batch", 1: f"rows_of_{name}"} for name in names},
                opset_version=_OPSET,
                dynamo=False,
            )
            model = onnx.load(str(path))
        model.producer_name = "track-range"
        texts = {
            key: value if isinstance(value, str) else json.dumps(value)
            for key, value in metadata.items()
        }
        onnx.helper.set_model_props(model, texts)
        onnx.save(model, str(path))
