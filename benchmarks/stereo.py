"""Stereo: the patch matcher against dense matching, in time on one thread, and in accuracy where the truth is exact.

Speed: every job in turn on every scene, the order turned round by round, medians over all turns, ratios of medians.
Scenes are KITTI 2015's pairs (else rendered ones) at their size and rendered ones at 1280x720; 15 boxes each: the
scene's own cars, and the same boxes moved by up to a tenth of their size. `patch, prior` searches about the truth
+ 3 px, as tracks are; `patch, full range` knows nothing. Dense is OpenCV's SGBM with 128 disparities, without the
reading of the boxes. Rectification: the whole right frame against the strips that the 15 boxes are searched in.
Goals: 25 times as fast as the fastest dense mode at 1242x375, 50 times at 1280x720; over the full range 12 times.
Accuracy: see `stereo_accuracy.py`.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.inputs.drives import REAL_DATA
from benchmarks.stereo_accuracy import add_accuracy_options, measure_accuracy
from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scene import make_scene
from track_range.simulation.world.truth import label_scene
from track_range.stereo.evaluation.kitti_2015 import TRUTH, pair_names, read_pair
from track_range.stereo.geometry.rectification import Maps, RemappedView
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.box_matchers import one_thread
from track_range.stereo.matching.patch_matcher import PatchMatcher, PatchMatcherSettings
from track_range.stereo.matching.patches import inner_halves
from track_range.stereo.matching.sgbm import Mode, Sgbm, SgbmSettings

N_BOXES = 15
N_DISPARITIES = 128
PRIOR_ERROR_PX = 3.0
SMALLEST_BOX_PX = 20.0
MIN_TRUE_PIXELS = 20
MODES: tuple[Mode, ...] = ("3way", "sgbm", "hh")
SEARCH_PX = 12
"""Columns right and left of a patch that are read in a search about a prior, for the rectification of strips."""


@dataclass(frozen=True, slots=True)
class SpeedScene:
    """A pair with (15, 4) boxes and their (15,) true disparities."""

    left: Image
    right: Image
    xyxy_px: FloatArray
    true_px: FloatArray
    rig: StereoRig


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this workload."""
    parser.add_argument("--pairs", type=Path, default=REAL_DATA / "kitti2015", help="a set as KITTI 2015's")
    parser.add_argument("--scenes", type=int, default=4, help="pairs per image size")
    parser.add_argument("--rounds", type=int, default=5)
    add_accuracy_options(parser)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Run all of it, print the tables, and return the figures."""
    groups = {"1280x720": _rendered(options.scenes, width_px=1280, height_px=720)}
    real = _real(options.pairs, options.scenes) if options.pairs.is_dir() else []
    small = real or _rendered(options.scenes, width_px=1242, height_px=376)
    groups = {f"{small[0].left.shape[1]}x{small[0].left.shape[0]}": small, **groups}
    with one_thread():
        speed = {size: _speed(scenes, options.rounds) for size, scenes in groups.items()}
    _print_speed(speed)
    return {"n_boxes": N_BOXES, "rounds": options.rounds, "speed": speed, "accuracy": measure_accuracy(options)}


def _real(folder: Path, n: int) -> list[SpeedScene]:
    """The pairs with the most labelled cars."""
    root = folder / "training" if (folder / "training").is_dir() else folder
    pairs = sorted((read_pair(folder, name) for name in pair_names(folder)), key=lambda pair: -len(pair.true_px))
    scenes = []
    for number, pair in enumerate(pairs[:n]):
        steps = cv2.imread(str(root / TRUTH / f"{pair.name}.png"), cv2.IMREAD_UNCHANGED)
        known = np.where(np.asarray(steps) > 0, np.asarray(steps) / 256.0, np.nan)
        boxes, true_px = _boxes(pair.xyxy_px, known, seed=number)
        scenes.append(SpeedScene(pair.left, np.asarray(pair.right), boxes, true_px, pair.rig))
    return scenes


def _rendered(n: int, *, width_px: int, height_px: int) -> list[SpeedScene]:
    rig = kitti_like_rig(width_px=width_px, height_px=height_px)
    scenes = []
    for seed in range(n):
        scene = make_scene(seed, seconds=2.0)
        renderer = Renderer(scene, rig)
        labels = label_scene(scene, [1.0], camera=rig.left)
        seen = labels.has_3d_box & (labels.truncated == 0) & (labels.occluded <= 1)
        own = labels.xyxy_px[seen & (labels.xyxy_px[:, 3] - labels.xyxy_px[:, 1] >= SMALLEST_BOX_PX)]
        known = rig.left.fx_px * rig.baseline_m / renderer.depth_m(1.0)
        boxes, true_px = _boxes(own, known, seed=seed)
        left, right = renderer.render(1.0), renderer.render(1.0, side="right")
        scenes.append(SpeedScene(left, right, boxes, true_px, rig))
    return scenes


def _boxes(own: FloatArray, known_px: FloatArray, *, seed: int) -> tuple[FloatArray, FloatArray]:
    """15 boxes, the scene's own and then the same moved by up to a tenth of their size; and their true disparities."""
    rng = np.random.default_rng(seed)
    image_hw = (known_px.shape[0], known_px.shape[1])
    boxes, found = [], []
    for number in range(100 * N_BOXES):
        box_px = own[number % len(own)]
        if number >= len(own):
            box_px = box_px + np.tile(rng.uniform(-0.1, 0.1, 2) * (box_px[2:] - box_px[:2]), 2)
        patch = next(inner_halves(box_px[None], image_hw, margin_px=3, min_side_px=5))
        inside = np.zeros(0) if patch is None else known_px[patch.top : patch.bottom, patch.left : patch.right]
        if np.isfinite(inside).sum() >= MIN_TRUE_PIXELS:
            boxes.append(box_px)
            found.append(float(np.nanmedian(inside)))
        if len(boxes) == N_BOXES:
            break
    return np.array(boxes), np.array(found)


def _speed(scenes: list[SpeedScene], n_rounds: int) -> dict[str, Any]:
    """Median milliseconds of every job, and the ratios to it of dense matching."""
    times: dict[str, list[float]] = {}
    for number in range(n_rounds + 1):  # the first warms up
        for scene in scenes:
            jobs = list(_jobs(scene).items())
            for name, job in jobs if number % 2 else reversed(jobs):
                began_s = time.perf_counter()
                job()
                if number:
                    times.setdefault(name, []).append(1e3 * (time.perf_counter() - began_s))
    ms = {name: statistics.median(times[name]) for name in _jobs(scenes[0])}
    dense = {mode: ms[f"dense {mode}"] for mode in MODES}
    ratios = {
        name: {mode: dense_ms / ms[name] for mode, dense_ms in dense.items()}
        for name in ("patch, prior", "patch, full range")
    }
    return {
        "n_scenes": len(scenes),
        "ms": ms,
        "ratios": ratios,
        "ratio_prior": min(ratios["patch, prior"].values()),
        "ratio_full_range": min(ratios["patch, full range"].values()),
    }


def _jobs(scene: SpeedScene) -> dict[str, Callable[[], object]]:
    """What is timed on one scene."""
    patch = PatchMatcher(PatchMatcherSettings.for_rig(scene.rig))
    prior_px, nothing_px = scene.true_px + PRIOR_ERROR_PX, np.full(len(scene.true_px), np.nan)
    maps, strips = _raw_maps(scene), _strips(scene)
    dense = {mode: Sgbm(SgbmSettings(n_disparities=N_DISPARITIES, mode=mode)) for mode in MODES}
    return {
        "patch, prior": lambda: patch.match(scene.left, scene.right, scene.xyxy_px, prior_px),
        "patch, full range": lambda: patch.match(scene.left, scene.right, scene.xyxy_px, nothing_px),
        **{f"dense {mode}": _dense_job(sgbm, scene) for mode, sgbm in dense.items()},
        "rectify right frame": lambda: cv2.remap(scene.right, *maps, cv2.INTER_LINEAR),
        "rectify right strips": lambda: _looked_at(RemappedView(scene.right, maps), strips),
    }


def _dense_job(sgbm: Sgbm, scene: SpeedScene) -> Callable[[], object]:
    return lambda: sgbm.dense_disparity(scene.left, scene.right)


def _raw_maps(scene: SpeedScene) -> Maps:
    """What would rectify the right image if it were a raw one: a lens, and a turn of half a degree."""
    turn = cv2.Rodrigues(np.array([0.003, 0.008, 0.002]))[0]
    matrix, size_px = scene.rig.right.matrix, (scene.rig.right.width_px, scene.rig.right.height_px)
    lens = np.array([-0.2, 0.05, 0.0, 0.0, 0.0])
    whole, fraction = cv2.initUndistortRectifyMap(matrix, lens, turn, matrix, size_px, cv2.CV_16SC2)
    return np.asarray(whole, np.int16), np.asarray(fraction, np.uint16)


def _strips(scene: SpeedScene) -> list[tuple[slice, slice]]:
    """Windows of the right image that a search about the prior reads."""
    image_hw = (scene.left.shape[0], scene.left.shape[1])
    patches = inner_halves(scene.xyxy_px, image_hw, margin_px=3, min_side_px=5)
    found = []
    for patch, true_px in zip(patches, scene.true_px.tolist(), strict=True):
        if patch is not None:
            start = max(round(patch.left - true_px) - SEARCH_PX, 0)
            end = max(round(patch.right - true_px) + SEARCH_PX, start + 1)
            found.append((slice(patch.top - 2, patch.bottom + 3), slice(start, end)))
    return found


def _looked_at(view: RemappedView, strips: list[tuple[slice, slice]]) -> None:
    for strip in strips:
        view[strip]


def _print_speed(speed: dict[str, Any]) -> None:
    title = f"Median ms per frame with {N_BOXES} boxes, one thread"
    table = Table(title=title, box=box.SIMPLE_HEAD, padding=0, title_justify="left")
    table.add_column("job")
    for size in speed:
        table.add_column(size, justify="right")
    for name in next(iter(speed.values()))["ms"]:
        table.add_row(name, *(f"{found['ms'][name]:.2f}" for found in speed.values()))
    for name in ("patch, prior", "patch, full range"):
        for mode in MODES:
            ratios = (found["ratios"][name][mode] for found in speed.values())
            table.add_row(f"dense {mode} / {name}", *(f"{ratio:.1f}" for ratio in ratios))
    Console().print(table)
