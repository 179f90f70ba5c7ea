"""Ablation of the detector improvements of the monocular paper, on the same images and training budget.

Protocol: YOLOv5n from random weights on N images of a data set's training split (the same random sample for all), with
its labels and without a teacher; the same epochs and input size; each configuration with each seed. Figures are those
of the averaged weights after the last epoch, without selection, on the whole validation split at the same size. Times
are those of onnxruntime on one thread with square input, alternating between the configurations. Runs are stored in
`--out`: an interrupted run is resumed, a finished one is not repeated. `--jobs 2` trains two networks in parallel with
one thread each.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.models.onnx_session import OnnxSession, Runtime
from track_range.detection.training.data.augmentation import AugmentationSettings
from track_range.detection.training.data.data_set import CachedImages, TrainingSets
from track_range.detection.training.data.data_yaml import read_data_yaml
from track_range.detection.training.losses.box_losses import BoxLoss
from track_range.detection.training.losses.detection_loss import Losses
from track_range.detection.training.networks.anchors import by_head, kmeans_anchors, mean_best_iou
from track_range.detection.training.networks.export import export_onnx
from track_range.detection.training.networks.registry import NETWORKS, make_network
from track_range.detection.training.run_folder import LAST
from track_range.detection.training.settings import TrainingSettings, best_precision
from track_range.detection.training.train import Training, prepare_torch

MODEL = "yolov5n"
"""Network of all configurations."""


@dataclass(frozen=True, slots=True)
class Configuration:
    """Changes to the baseline.

    Attributes:
        has_own_anchors: anchors from k-means on the training boxes instead of those of YOLOv5.
        has_cbam: attention modules (CBAM) in the network.
        box_loss: loss of the boxes.
    """

    has_own_anchors: bool = False
    has_cbam: bool = False
    box_loss: BoxLoss = "ciou"


CONFIGURATIONS: Mapping[str, Configuration] = {
    "baseline": Configuration(),
    "kmeans": Configuration(has_own_anchors=True),
    "cbam": Configuration(has_cbam=True),
    "eiou": Configuration(box_loss="eiou"),
    "all": Configuration(has_own_anchors=True, has_cbam=True, box_loss="eiou"),
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this workload."""
    parser.add_argument("--data", type=Path, required=True, help="data.yaml")
    parser.add_argument("--out", type=Path, default=Path("out/ablation"), help="folder of the runs")
    parser.add_argument("--images", type=int, default=1500, help="number of training images")
    parser.add_argument("--size", type=int, default=320, help="input size in px")
    parser.add_argument("--epochs", type=int, default=20)
    parser.add_argument("--batch", type=int, default=16, help="batch size")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1], help="random seeds of the runs")
    parser.add_argument("--jobs", type=int, default=1, help="parallel runs with a thread each; 1 = one on all cores")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Train the configurations that are not finished, print the table, and return its figures."""
    runs = [(name, seed, options) for seed in options.seeds for name in CONFIGURATIONS]
    if options.jobs > 1:
        with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
            figures = pool.starmap(_trained, runs, chunksize=1)
    else:
        figures = [_trained(*run) for run in runs]
    ms = _inference_ms(options)
    rows = {
        name: {
            "seeds": [f for (n, _, _), f in zip(runs, figures, strict=True) if n == name],
            "inference_ms": ms[name],
        }
        for name in CONFIGURATIONS
    }
    _print_table(rows, options)
    return {"protocol": __doc__, "options": {k: str(v) for k, v in vars(options).items()}, "configurations": rows}


class _Log:
    """Training listener that prints a line per epoch with the name of the run."""

    def __init__(self, name: str) -> None:
        self._name = name

    def step(self, epoch: int, i: int, n: int, losses: Losses) -> None:
        """Ignore a training step."""

    def validated(self, epoch: int, i: int, n: int) -> None:
        """Ignore a validation step."""

    def epoch(self, row: dict[str, float]) -> None:
        """Print the figures of an epoch."""
        print(self._name, {key: round(value, 4) for key, value in row.items()}, flush=True)


def _trained(name: str, seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """Figures of one configuration with one seed, which is trained and exported if it is not finished."""
    out = options.out / f"{name}-{seed}"
    figures = out / "figures.json"
    budget = {key: str(vars(options)[key]) for key in ("data", "images", "size", "epochs", "batch")}
    if figures.is_file():
        stored: dict[str, Any] = json.loads(figures.read_text())
        if stored["budget"] != budget:
            raise SystemExit(f"{out}: expected a run with the same options, got {stored['budget']}; use another --out.")
        return stored
    out.mkdir(parents=True, exist_ok=True)
    configuration = CONFIGURATIONS[name]
    data = read_data_yaml(options.data)
    sample = np.random.default_rng(0).permutation(len(data.train))[: options.images]
    images = CachedImages([data.train[i] for i in sample], data.road_class_id, max_side_px=2 * options.size)
    validation = CachedImages(data.val, data.road_class_id)
    anchors, fit = None, None
    if configuration.has_own_anchors:
        sizes = images.box_sizes_px(options.size)
        fitted = kmeans_anchors(sizes, NETWORKS[MODEL].n_anchors, np.random.default_rng(seed))
        anchors = by_head(fitted, NETWORKS[MODEL].n_heads)
        default = np.array(NETWORKS[MODEL].anchors_px, np.float64).reshape(-1, 2)
        fit = {
            "before": mean_best_iou(sizes, default),
            "after": mean_best_iou(sizes, fitted),
            "anchors": fitted.tolist(),
        }
    settings = TrainingSettings(
        size_px=options.size,
        n_epochs=options.epochs,
        batch_size=options.batch,
        seed=seed,
        box_loss=configuration.box_loss,
        precision=best_precision("cpu"),
        validate_every=options.epochs,
        augmentation=AugmentationSettings(),
    )
    prepare_torch(seed=seed, n_threads=1 if options.jobs > 1 else 0)
    network = make_network(MODEL, len(data.road_class_id), anchors_px=anchors, has_cbam=configuration.has_cbam)
    run = Training(network, settings, TrainingSets(images, validation, data.road_class_id), out)
    if (out / LAST).is_file():
        run.resume()
    run.run(_Log(out.name))
    scores = run.scores()
    export_onnx(run.average.network, out / "model.onnx", {"names": [ROAD_CLASSES[i] for i in data.road_class_id]})
    result = {"seed": seed, "budget": budget, **scores.as_dict(), "anchors": fit}
    figures.write_text(json.dumps(result, indent=2))
    return result


def _inference_ms(options: argparse.Namespace, n_rounds: int = 40) -> dict[str, float]:
    """Median time in ms of each configuration's network on one thread, alternating between the configurations."""
    seed = options.seeds[0]
    networks = {
        name: OnnxSession(options.out / f"{name}-{seed}" / "model.onnx", Runtime(n_threads=1)).bound(
            (options.size, options.size)
        )
        for name in CONFIGURATIONS
    }
    times: dict[str, list[float]] = {name: [] for name in networks}
    for _ in range(n_rounds):
        for name, network in networks.items():
            start_s = time.perf_counter()
            network.run()
            times[name].append(1e3 * (time.perf_counter() - start_s))
    return {name: float(np.median(times_ms)) for name, times_ms in times.items()}


def _print_table(rows: Mapping[str, Mapping[str, Any]], options: argparse.Namespace) -> None:
    table = Table(
        "configuration",
        *(f"{figure}, seed {seed}" for figure in ("AP50 %", "AP50-95 %") for seed in options.seeds),
        "mean AP50 %",
        "mean AP50-95 %",
        "ms",
        title=f"Ablation: {options.images} images, {options.size} px, {options.epochs} epochs",
        box=box.SIMPLE_HEAD,
    )
    for name, row in rows.items():
        by_key = {key: [100 * scores[key] for scores in row["seeds"]] for key in ("ap50", "ap50_95")}
        cells = [f"{value:.1f}" for values in by_key.values() for value in values]
        means = [f"{np.mean(values):.1f}" for values in by_key.values()]
        table.add_row(name, *cells, *means, f"{row['inference_ms']:.1f}")
    Console().print(table)
