"""Stereo matching: time of the patch matcher and of dense matching on one thread, and accuracy on exact ground truth.

Protocol, speed: jobs alternate on each scene, in reverse order every second round; medians over all rounds, ratios of
medians. Scenes are pairs of KITTI 2015 (or rendered ones) at their size and rendered ones at 1280 x 720, with 15 boxes
each: the cars of the scene, and the same boxes shifted by up to a tenth of their size. `patch, prior` searches around
the true disparity + 3 px, as for tracks; `patch, full range` has no prior. Dense is OpenCV's SGBM with 128 disparities,
without the evaluation of boxes. Rectification: the whole right frame, and the strips searched for the 15 boxes. Goals:
25 times as fast as the fastest dense mode at 1242 x 375, 50 times at 1280 x 720; 15 and 35 times over the full range.
Protocol, accuracy: `stereo_accuracy.py`.
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

from benchmarks.accuracy.stereo_matching.stereo_accuracy import add_accuracy_options, measure_accuracy
from benchmarks.inputs.drives import REAL_DATA
from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.processes import one_opencv_thread
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scene import make_scene
from track_range.simulation.world.truth import label_scene
from track_range.stereo.evaluation.kitti_2015 import TRUTH, pair_names, read_pair
from track_range.stereo.geometry.rectification import Maps, RemappedView
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.patch_matcher import PatchMatcher, PatchMatcherSettings
from track_range.stereo.matching.patches import inner_halves
from track_range.stereo.matching.sgbm import Mode, Sgbm, SgbmSettings

N_BOXES = 15
"""Boxes per scene."""

N_DISPARITIES = 128
"""Disparity range of dense matching."""

PRIOR_ERROR_PX = 3.0
"""Error of the disparity prior in px."""

MIN_BOX_HEIGHT_PX = 20.0
"""Smallest height of a box."""

MIN_TRUE_PIXELS = 20
"""Smallest number of pixels with a true disparity in a box."""

MODES: tuple[Mode, ...] = ("3way", "sgbm", "hh")
"""Modes of OpenCV's SGBM."""

SEARCH_PX = 12
"""Columns to the left and right of a patch that a search around a prior reads, for the rectification of strips."""


@dataclass(frozen=True, slots=True)
class SpeedScene:
    """A rectified pair with boxes.

    Attributes:
        left: left image.
        right: right image.
        xyxy_px: (15, 4) boxes.
        true_px: (15,) true disparities.
        rig: the rectified pair.
    """

    left: Image
    right: Image
    xyxy_px: FloatArray
    true_px: FloatArray
    rig: StereoRig


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this workload."""
    parser.add_argument(
        "--pairs", type=Path, default=REAL_DATA / "kitti2015", help="folder in the layout of KITTI 2015"
    )
    parser.add_argument("--scenes", type=int, default=4, help="number of pairs per image size")
    parser.add_argument("--rounds", type=int, default=5, help="number of rounds")
    add_accuracy_options(parser)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure speed and accuracy, print the tables, and return the figures."""
    groups = {"1280x720": _rendered(options.scenes, width_px=1280, height_px=720)}
    real = _real(options.pairs, options.scenes) if options.pairs.is_dir() else []
    small = real or _rendered(options.scenes, width_px=1242, height_px=376)
    groups = {f"{small[0].left.shape[1]}x{small[0].left.shape[0]}": small, **groups}
    with one_opencv_thread():
        speed = {size: _speed(scenes, options.rounds) for size, scenes in groups.items()}
    _print_speed(speed)
    return {"n_boxes": N_BOXES, "rounds": options.rounds, "speed": speed, "accuracy": measure_accuracy(options)}


def _real(folder: Path, n: int) -> list[SpeedScene]:
    """The n pairs with the most labelled cars."""
    root = folder / "training" if (folder / "training").is_dir() else folder
    pairs = sorted((read_pair(folder, name) for name in pair_names(folder)), key=lambda pair: -len(pair.true_px))
    scenes = []
    for number, pair in enumerate(pairs[:n]):
        steps = cv2.imread(str(root / TRUTH / f"{pair.name}.png"), cv2.IMREAD_UNCHANGED)
        disparity_px = np.where(np.asarray(steps) > 0, np.asarray(steps) / 256.0, np.nan)
        boxes, true_px = _boxes(pair.xyxy_px, disparity_px, seed=number)
        scenes.append(SpeedScene(pair.left, np.asarray(pair.right), boxes, true_px, pair.rig))
    return scenes


def _rendered(n: int, *, width_px: int, height_px: int) -> list[SpeedScene]:
    rig = kitti_like_rig(width_px=width_px, height_px=height_px)
    scenes = []
    for seed in range(n):
        scene = make_scene(seed, seconds=2.0)
        renderer = Renderer(scene, rig)
        labels = label_scene(scene, [1.0], camera=rig.left)
        is_visible = labels.has_3d_box & (labels.truncated == 0) & (labels.occluded <= 1)
        objects = labels.xyxy_px[is_visible & (labels.xyxy_px[:, 3] - labels.xyxy_px[:, 1] >= MIN_BOX_HEIGHT_PX)]
        disparity_px = rig.left.fx_px * rig.baseline_m / renderer.depth_m(1.0)
        boxes, true_px = _boxes(objects, disparity_px, seed=seed)
        left, right = renderer.render(1.0), renderer.render(1.0, side="right")
        scenes.append(SpeedScene(left, right, boxes, true_px, rig))
    return scenes


def _boxes(objects: FloatArray, disparity_px: FloatArray, *, seed: int) -> tuple[FloatArray, FloatArray]:
    """(15, 4) boxes, those of the objects and then the same shifted, with their (15,) median true disparities."""
    rng = np.random.default_rng(seed)
    image_hw = (disparity_px.shape[0], disparity_px.shape[1])
    boxes, true_px = [], []
    for number in range(100 * N_BOXES):
        box_px = objects[number % len(objects)]
        if number >= len(objects):
            box_px = box_px + np.tile(rng.uniform(-0.1, 0.1, 2) * (box_px[2:] - box_px[:2]), 2)
        patch = next(inner_halves(box_px[None], image_hw, margin_px=3, min_side_px=5))
        inside = np.zeros(0) if patch is None else disparity_px[patch.top : patch.bottom, patch.left : patch.right]
        if np.isfinite(inside).sum() >= MIN_TRUE_PIXELS:
            boxes.append(box_px)
            true_px.append(float(np.nanmedian(inside)))
        if len(boxes) == N_BOXES:
            break
    return np.array(boxes), np.array(true_px)


def _speed(scenes: list[SpeedScene], n_rounds: int) -> dict[str, Any]:
    """Median time of each job in ms, and ratios of dense matching to the patch matcher."""
    times: dict[str, list[float]] = {}
    for number in range(n_rounds + 1):  # the first round is a warm-up
        for scene in scenes:
            jobs = list(_jobs(scene).items())
            for name, job in jobs if number % 2 else reversed(jobs):
                start_s = time.perf_counter()
                job()
                if number:
                    times.setdefault(name, []).append(1e3 * (time.perf_counter() - start_s))
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
    """Timed functions on one scene by name."""
    patch = PatchMatcher(PatchMatcherSettings.for_rig(scene.rig))
    prior_px, no_prior_px = scene.true_px + PRIOR_ERROR_PX, np.full(len(scene.true_px), np.nan)
    maps, strips = _raw_maps(scene), _strips(scene)
    dense = {mode: Sgbm(SgbmSettings(n_disparities=N_DISPARITIES, mode=mode)) for mode in MODES}
    return {
        "patch, prior": lambda: patch.match(scene.left, scene.right, scene.xyxy_px, prior_px),
        "patch, full range": lambda: patch.match(scene.left, scene.right, scene.xyxy_px, no_prior_px),
        **{f"dense {mode}": _dense_job(sgbm, scene) for mode, sgbm in dense.items()},
        "rectify right frame": lambda: cv2.remap(scene.right, *maps, cv2.INTER_LINEAR),
        "rectify right strips": lambda: _read(RemappedView(scene.right, maps), strips),
    }


def _dense_job(sgbm: Sgbm, scene: SpeedScene) -> Callable[[], object]:
    return lambda: sgbm.dense_disparity(scene.left, scene.right)


def _raw_maps(scene: SpeedScene) -> Maps:
    """Rectification maps of a right image with lens distortion and a rotation of half a degree."""
    R = cv2.Rodrigues(np.array([0.003, 0.008, 0.002]))[0]
    matrix, size_px = scene.rig.right.matrix, (scene.rig.right.width_px, scene.rig.right.height_px)
    distortion = np.array([-0.2, 0.05, 0.0, 0.0, 0.0])
    whole, fraction = cv2.initUndistortRectifyMap(matrix, distortion, R, matrix, size_px, cv2.CV_16SC2)
    return np.asarray(whole, np.int16), np.asarray(fraction, np.uint16)


def _strips(scene: SpeedScene) -> list[tuple[slice, slice]]:
    """Windows (rows, columns) of the right image that a search around the prior reads."""
    image_hw = (scene.left.shape[0], scene.left.shape[1])
    patches = inner_halves(scene.xyxy_px, image_hw, margin_px=3, min_side_px=5)
    strips = []
    for patch, true_px in zip(patches, scene.true_px.tolist(), strict=True):
        if patch is not None:
            start = max(round(patch.left - true_px) - SEARCH_PX, 0)
            end = max(round(patch.right - true_px) + SEARCH_PX, start + 1)
            strips.append((slice(patch.top - 2, patch.bottom + 3), slice(start, end)))
    return strips


def _read(view: RemappedView, strips: list[tuple[slice, slice]]) -> None:
    for strip in strips:
        view[strip]


def _print_speed(speed: dict[str, Any]) -> None:
    title = f"Median ms per frame with {N_BOXES} boxes, one thread"
    table = Table(title=title, box=box.SIMPLE_HEAD, padding=0, title_justify="left")
    table.add_column("job")
    for size in speed:
        table.add_column(size, justify="right")
    for name in next(iter(speed.values()))["ms"]:
        table.add_row(name, *(f"{figures['ms'][name]:.2f}" for figures in speed.values()))
    for name in ("patch, prior", "patch, full range"):
        for mode in MODES:
            ratios = (figures["ratios"][name][mode] for figures in speed.values())
            table.add_row(f"dense {mode} / {name}", *(f"{ratio:.1f}" for ratio in ratios))
    Console().print(table)
