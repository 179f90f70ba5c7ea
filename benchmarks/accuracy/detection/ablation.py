"""Ablation of the detector improvements of the monocular paper, on the same images and training
budget.
"""

from __future__ import annotations

import json
import multiprocessing
import time
from argparse import Namespace
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Figures, median_ms, option, workload
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.models.onnx_session import OnnxSession, Runtime
from track_range.detection.training.data.augmentation import AugmentationSettings
from track_range.detection.training.data.data_set import CachedImages, TrainingSets
from track_range.detection.training.data_yaml import read_data_yaml
from track_range.detection.training.losses.box_losses import BoxLoss
from track_range.detection.training.losses.detection_loss import Losses
from track_range.detection.training.networks.registry import (
    NETWORKS,
    by_head,
    kmeans_anchors,
    make_network,
    mean_best_iou,
)
from track_range.detection.training.run_folder import LAST
from track_range.detection.training.settings import TrainingSettings, best_precision
from track_range.detection.training.train import Training, export_onnx, prepare_torch

MODEL = "yolov5n"


@dataclass(frozen=True, slots=True)
class Configuration:
    """Changes to the baseline: anchors from k-means on the training boxes, attention modules
    (CBAM), box loss.
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


@workload(
    option("--data", type=Path, required=True, help="data.yaml"),
    option("--out", default=Path("out/ablation"), help="folder of the runs"),
    option("--images", default=1500, help="number of training images"),
    option("--size", default=320, help="input size in px"),
    option("--epochs", default=20, help="number of epochs"),
    option("--batch", default=16, help="batch size"),
    option("--seeds", default=(0, 1), help="random seeds of the runs"),
    option("--jobs", default=1, help="parallel runs with a thread each; 1 = one on all cores"),
)
def ablation(options: Namespace) -> Figures:
    runs = [(name, seed, options) for seed in options.seeds for name in CONFIGURATIONS]
    if options.jobs > 1:
        with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
            results = pool.starmap(_trained, runs, chunksize=1)
    else:
        results = [_trained(*run) for run in runs]
    ms = _inference_ms(options)
    figures: Figures = {}
    for name in CONFIGURATIONS:
        rows = [
            result for (other, _, _), result in zip(runs, results, strict=True) if other == name
        ]
        means = {
            f"mean_{key}": float(np.mean([row[key] for row in rows])) for key in ("ap50", "ap50_95")
        }
        figures[name] = {**means, "inference_ms": ms[name], "seeds": rows}
    return figures


class _Log:
    def __init__(self, name: str) -> None:
        self._name = name

    def step(self, epoch: int, i: int, n: int, losses: Losses) -> None:
        """Do nothing."""

    def validated(self, epoch: int, i: int, n: int) -> None:
        """Do nothing."""

    def epoch(self, row: dict[str, float]) -> None:
        """Print the figures of an epoch."""
        print(self._name, {key: round(value, 4) for key, value in row.items()}, flush=True)


def _trained(name: str, seed: int, options: Namespace) -> dict[str, Any]:
    """Figures of one configuration with one seed, which is trained and exported if it is not
    finished.
    """
    out = options.out / f"{name}-{seed}"
    figures = out / "figures.json"
    budget = {key: str(vars(options)[key]) for key in ("data", "images", "size", "epochs", "batch")}
    if figures.is_file():
        stored: dict[str, Any] = json.loads(figures.read_text())
        if stored["budget"] != budget:
            raise SystemExit(
                f"{out}: expected a run with the same options, got "
                f"{stored['budget']}; use another --out."
            )
        return stored
    out.mkdir(parents=True, exist_ok=True)
    configuration = CONFIGURATIONS[name]
    data = read_data_yaml(options.data)
    sample = np.random.default_rng(0).permutation(len(data.train))[: options.images]
    images = CachedImages(
        [data.train[i] for i in sample], data.road_class_id, max_side_px=2 * options.size
    )
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
    network = make_network(
        MODEL, len(data.road_class_id), anchors_px=anchors, has_cbam=configuration.has_cbam
    )
    run = Training(network, settings, TrainingSets(images, validation, data.road_class_id), out)
    if (out / LAST).is_file():
        run.resume()
    run.run(_Log(out.name))
    scores = run.scores()
    export_onnx(
        run.average.network,
        out / "model.onnx",
        {"names": [ROAD_CLASSES[i] for i in data.road_class_id]},
    )
    result = {"seed": seed, "budget": budget, **scores.as_dict(), "anchors": fit}
    figures.write_text(json.dumps(result, indent=2))
    return result


def _inference_ms(options: Namespace, n_rounds: int = 40) -> dict[str, float]:
    """Median time in ms of each configuration's network on one thread, alternating between the
    configurations.
    """
    seed = options.seeds[0]
    networks = {}
    for name in CONFIGURATIONS:
        session = OnnxSession(options.out / f"{name}-{seed}" / "model.onnx", Runtime(n_threads=1))
        networks[name] = session.bound((options.size, options.size))
    times_s: dict[str, list[float]] = {name: [] for name in networks}
    for _ in range(n_rounds):
        for name, network in networks.items():
            start_s = time.perf_counter()
            network.run()
            times_s[name].append(time.perf_counter() - start_s)
    return {name: median_ms(times) for name, times in times_s.items()}
