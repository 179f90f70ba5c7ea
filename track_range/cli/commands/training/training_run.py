"""Training of a detector from labelled images to an ONNX file; imports PyTorch."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)

from track_range.cli.commands.training.data import fitted_anchors, read_images
from track_range.cli.commands.training.options import TrainOptions
from track_range.cli.shared.console import console, print_grid, print_line
from track_range.detection.training.data.augmentation import AugmentationSettings
from track_range.detection.training.data.data_set import TrainingSets
from track_range.detection.training.data_yaml import TrainingData, read_data_yaml
from track_range.detection.training.errors import TrainingError
from track_range.detection.training.losses.detection_loss import Losses
from track_range.detection.training.networks.registry import NETWORKS, make_network
from track_range.detection.training.run_folder import BEST, LAST, RESULTS, check_start
from track_range.detection.training.schedule import SGD, ScheduleSettings
from track_range.detection.training.settings import TrainingSettings, best_precision, usable_device
from track_range.detection.training.teacher import Teacher
from track_range.detection.training.train import Training, prepare_torch
from track_range.foundation.files.folder_lock import locked_folder
from track_range.foundation.files.output_files import make_folder
from track_range.run.interrupts import stop_on_interrupt
from track_range.run.ready_model import ready_model
from track_range.views.report.detection_tables import class_grid
from track_range.views.report.figures import training_chart

CURVES = "curves.png"  # chart of losses and accuracy in the run folder


def train(options: TrainOptions) -> None:
    """Train, export the best network to the run folder, and print its metrics."""
    settings = _settings(options)
    data = read_data_yaml(options.data)
    print_line(console, *data.notes)
    data.check_trainable(options.data, options.model)
    check_start(
        options.out,
        resume=options.resume,
        weights=options.weights,
        files=(CURVES, f"{options.model}.onnx"),
    )
    teacher = None
    if options.teacher is not None:
        path = ready_model(options.teacher, console)
        teacher = Teacher(
            path, data.road_class_id, device=settings.device, precision=settings.dtype
        )
    make_folder(options.out)
    curves = options.out / CURVES
    with locked_folder(options.out), stop_on_interrupt():
        try:
            training = _prepared(options, settings, data, teacher)
            display = _Display(settings.n_epochs, lambda: training_chart(training.history, curves))
            with display.progress:
                training.run(display)
            _finish(training, options, data)
        except KeyboardInterrupt:
            raise TrainingError(
                f"stopped by the user; continue the run in {options.out} with --resume."
            ) from None


def _prepared(
    options: TrainOptions, settings: TrainingSettings, data: TrainingData, teacher: Teacher | None
) -> Training:
    largest_px = int(settings.size_px * settings.augmentation.max_gain)
    images = read_images(data.train, data, max_side_px=largest_px)
    validation = read_images(data.val, data, max_side_px=None)
    anchors = None
    if options.anchors == "kmeans++":
        anchors = fitted_anchors(images, options.model, options.size_px, options.seed)
    prepare_torch(seed=settings.seed, n_threads=options.n_threads)
    network = make_network(
        options.model,
        len(data.road_class_id),
        anchors_px=anchors,
        has_cbam=options.attention == "cbam",
    )
    sets = TrainingSets(images, validation, data.road_class_id, data.fingerprint())
    training = Training(network, settings, sets, options.out, teacher=teacher)
    if options.resume:
        training.resume()
        print_line(console, f"Resuming after epoch {len(training.history)} of {settings.n_epochs}.")
    elif options.weights:
        training.start_from(*options.weights)
    n = sum(parameter.numel() for parameter in network.parameters())
    print_line(
        console,
        f"{NETWORKS[options.model].family}, {n / 1e6:.2f} million parameters, {settings.device}, "
        f"{settings.precision}; {len(images)} training images ({images.n_cached} in memory), "
        f"{len(validation)} validation images.",
    )
    return training


class _Display:
    """Implements `Listener`: shows a progress bar for the current epoch and a line for each
    finished epoch.
    """

    def __init__(self, n_epochs: int, draw: Callable[[], None]) -> None:
        self._n_epochs, self._draw = n_epochs, draw
        self.progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[text]}"),
            console=console,
            disable=not console.is_terminal,
        )
        self._task: TaskID = self.progress.add_task("", total=None, text="")
        self._minutes: list[float] = []

    def step(self, epoch: int, i: int, n: int, losses: Losses) -> None:
        text = " ".join(f"{name} {float(loss.detach()):.4f}" for name, loss in losses.items())
        self._move(f"epoch {epoch + 1} of {self._n_epochs}", i, n, text)

    def validated(self, epoch: int, i: int, n: int) -> None:
        self._move(f"validation {epoch + 1}", i, n, "")

    def epoch(self, row: dict[str, float]) -> None:
        self._minutes.append(row["minutes"])
        left = (self._n_epochs - row["epoch"]) * float(np.median(self._minutes))
        figures = (
            f"AP50 {100 * row['ap50']:.1f} %, AP50-95 {100 * row['ap50_95']:.1f} %, "
            if "ap50" in row
            else ""
        )
        losses = ", ".join(
            f"{key.removeprefix('loss_')} {loss:.4f}"
            for key, loss in row.items()
            if key.startswith("loss_")
        )
        text = (
            f"epoch {row['epoch']:.0f}/{self._n_epochs}: {figures}losses: {losses}; "
            f"{_duration(row['minutes'])}"
        )
        print_line(console, f"{text}, {_duration(left)} left")
        self._draw()

    def _move(self, description: str, i: int, n: int, text: str) -> None:
        self.progress.update(self._task, description=description, completed=i, total=n, text=text)


def _settings(options: TrainOptions) -> TrainingSettings:
    device, note = usable_device(options.device)
    if note:
        print_line(console, note)
    schedule = SGD if options.optimiser == "sgd" else ScheduleSettings()
    if options.learning_rate is not None:
        schedule = replace(schedule, learning_rate=options.learning_rate)
    return TrainingSettings(
        size_px=options.size_px,
        n_epochs=options.n_epochs,
        batch_size=options.batch_size,
        seed=options.seed,
        box_loss=options.box_loss,
        device=device,
        precision=best_precision(device) if options.precision == "auto" else options.precision,
        validate_every=options.validate_every,
        schedule=schedule,
        augmentation=AugmentationSettings(
            mosaic=options.mosaic, min_gain=options.gain[0], max_gain=options.gain[1]
        ),
        n_last_epochs=options.last_epochs,
        n_int8_epochs=options.int8_epochs,
    )


def _finish(training: Training, options: TrainOptions, data: TrainingData) -> None:
    training.load_best()
    model = options.out / f"{options.model}.onnx"
    name = options.data.stem if options.data.stem != "data" else options.data.absolute().parent.name
    training.export(
        model, family=NETWORKS[options.model].family, data=name, licence=options.licence
    )
    print_grid(
        console,
        class_grid(
            {"n_images": len(data.val), "models": {options.model: training.scores().as_dict()}}
        ),
    )
    names = [name for name in (CURVES, RESULTS, BEST, LAST) if (options.out / name).exists()]
    written = f"Written: {model}, and in the same folder {', '.join(names)}."
    print_line(
        console,
        written,
        f"To use the model: track-range --mono VIDEO --focal-px PX --detector {model}",
    )


def _duration(minutes: float) -> str:
    if minutes < 1.5:
        return f"{60 * minutes:.0f} s"
    return f"{minutes:.0f} min" if minutes < 90 else f"{minutes / 60:.1f} h"
