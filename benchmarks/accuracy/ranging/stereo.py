"""Stereo matching: processor time of the patch matcher and of dense matching on one thread, and
accuracy on exact truth.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from argparse import Namespace
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.harness import Figures, option, workload
from benchmarks.inputs.drives import REAL_DATA
from track_range.calibration.reference_pairs import read_drive
from track_range.evaluation.stereo_evaluation import expected_disparities
from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.processes import one_opencv_thread
from track_range.simulation.drive import write_drive
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scene import make_scene
from track_range.simulation.world.truth import label_scene
from track_range.stereo.evaluation.box_matchers import measure_pairs
from track_range.stereo.evaluation.disparity_errors import MatcherColumn, figures
from track_range.stereo.evaluation.kitti_2015 import TRUTH, StereoPair, pair_names, read_pair
from track_range.stereo.geometry.rectification import Maps, RemappedView
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.patch_matcher import PatchMatcher, PatchMatcherSettings
from track_range.stereo.matching.sgbm import Mode, Sgbm, SgbmSettings, inner_halves

FROM_M, TO_M = 15.0, 25.0  # distance range in m on simulated drives
MATCHERS = ("patch", "sgbm")

N_BOXES = 15  # per scene
N_DISPARITIES = 128  # of dense matching
PRIOR_ERROR_PX = 3.0
MIN_BOX_HEIGHT_PX = 20.0
MIN_TRUE_PIXELS = 20  # with a true disparity in a box
MODES: tuple[Mode, ...] = ("3way", "sgbm", "hh")

SEARCH_PX = 12
"""Columns to the left and right of a patch that a search around a prior reads, for the
rectification of strips."""


@dataclass(frozen=True, slots=True)
class SpeedScene:
    """A rectified pair with (15, 4) boxes and their (15,) true disparities."""

    left: Image
    right: Image
    xyxy_px: FloatArray
    true_px: FloatArray
    rig: StereoRig


@workload(
    option("--pairs", default=REAL_DATA / "kitti2015", help="folder in the layout of KITTI 2015"),
    option("--scenes", default=4, help="number of pairs per image size"),
    option("--rounds", default=5, help="number of rounds"),
    option("--seeds", default=3, help="number of simulated drives, 0 = only the time"),
    option("--fps", default=2.5, help="frame rate of the simulated drives, of 6 s each"),
)
def stereo(options: Namespace) -> Figures:
    small = _real(options.pairs, options.scenes) if options.pairs.is_dir() else []
    small = small or _rendered(options.scenes, width_px=1242, height_px=376)
    large = _rendered(options.scenes, width_px=1280, height_px=720)
    with one_opencv_thread():
        speed = {
            f"{scenes[0].left.shape[1]}x{scenes[0].left.shape[0]}": _speed(scenes, options.rounds)
            for scenes in (small, large)
        }
    simulated = _simulated(options.seeds, options.fps) if options.seeds else {}
    return {"speed": speed, "simulated": simulated}


def _real(folder: Path, n: int) -> list[SpeedScene]:
    """The n pairs with the most labelled cars."""
    root = folder / "training" if (folder / "training").is_dir() else folder
    pairs = sorted(
        (read_pair(folder, name) for name in pair_names(folder)),
        key=lambda pair: -len(pair.true_px),
    )
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
        objects = labels.xyxy_px[
            is_visible & (labels.xyxy_px[:, 3] - labels.xyxy_px[:, 1] >= MIN_BOX_HEIGHT_PX)
        ]
        disparity_px = rig.left.fx_px * rig.baseline_m / renderer.depth_m(1.0)
        boxes, true_px = _boxes(objects, disparity_px, seed=seed)
        left, right = renderer.render(1.0), renderer.render(1.0, side="right")
        scenes.append(SpeedScene(left, right, boxes, true_px, rig))
    return scenes


def _boxes(
    objects: FloatArray, disparity_px: FloatArray, *, seed: int
) -> tuple[FloatArray, FloatArray]:
    """(15, 4) boxes, those of the objects and then the same shifted, with their (15,) median true
    disparities.
    """
    rng = np.random.default_rng(seed)
    image_hw = (disparity_px.shape[0], disparity_px.shape[1])
    boxes, true_px = [], []
    for number in range(100 * N_BOXES):
        box_px = objects[number % len(objects)]
        if number >= len(objects):
            box_px = box_px + np.tile(rng.uniform(-0.1, 0.1, 2) * (box_px[2:] - box_px[:2]), 2)
        patch = next(inner_halves(box_px[None], image_hw, margin_px=3, min_side_px=5))
        inside = (
            np.zeros(0)
            if patch is None
            else disparity_px[patch.top : patch.bottom, patch.left : patch.right]
        )
        if np.isfinite(inside).sum() >= MIN_TRUE_PIXELS:
            boxes.append(box_px)
            true_px.append(float(np.nanmedian(inside)))
        if len(boxes) == N_BOXES:
            break
    return np.array(boxes), np.array(true_px)


def _speed(scenes: list[SpeedScene], n_rounds: int) -> dict[str, Any]:
    """Median processor time of each job in ms, and ratios of dense matching to the patch matcher."""
    times: dict[str, list[float]] = {}
    for number in range(n_rounds + 1):  # the first round is a warm-up
        for scene in scenes:
            jobs = list(_jobs(scene).items())
            for name, job in jobs if number % 2 else reversed(jobs):
                start_s = time.process_time()
                job()
                if number:
                    times.setdefault(name, []).append(1e3 * (time.process_time() - start_s))
    ms = {name: statistics.median(times[name]) for name in _jobs(scenes[0])}
    dense = {mode: ms[f"dense {mode}"] for mode in MODES}
    ratios = {
        name: {f"dense {mode}": dense_ms / ms[name] for mode, dense_ms in dense.items()}
        for name in ("patch, prior", "patch, full range")
    }
    return {
        "ms": ms,
        "ratios": {name: {**row, "smallest": min(row.values())} for name, row in ratios.items()},
    }


def _jobs(scene: SpeedScene) -> dict[str, Callable[[], object]]:
    patch = PatchMatcher(PatchMatcherSettings.for_rig(scene.rig))
    prior_px, no_prior_px = scene.true_px + PRIOR_ERROR_PX, np.full(len(scene.true_px), np.nan)
    maps, strips = _raw_maps(scene), _strips(scene)
    dense = {mode: Sgbm(SgbmSettings(n_disparities=N_DISPARITIES, mode=mode)) for mode in MODES}
    return {
        "patch, prior": lambda: patch.match(scene.left, scene.right, scene.xyxy_px, prior_px),
        "patch, prior, two boxes": lambda: patch.match(
            scene.left, scene.right, scene.xyxy_px[:2], prior_px[:2]
        ),
        "patch, full range": lambda: patch.match(
            scene.left, scene.right, scene.xyxy_px, no_prior_px
        ),
        **{
            f"dense {mode}": partial(sgbm.dense_disparity, scene.left, scene.right)
            for mode, sgbm in dense.items()
        },
        "rectify right frame": lambda: cv2.remap(scene.right, *maps, cv2.INTER_LINEAR),
        "rectify right strips": lambda: list(
            map(RemappedView(scene.right, maps).__getitem__, strips)
        ),
    }


def _raw_maps(scene: SpeedScene) -> Maps:
    """Rectification maps of a right image with lens distortion and a rotation of half a degree."""
    R = cv2.Rodrigues(np.array([0.003, 0.008, 0.002]))[0]
    matrix, size_px = scene.rig.right.matrix, (scene.rig.right.width_px, scene.rig.right.height_px)
    distortion = np.array([-0.2, 0.05, 0.0, 0.0, 0.0])
    whole, fraction = cv2.initUndistortRectifyMap(
        matrix, distortion, R, matrix, size_px, cv2.CV_16SC2
    )
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


def _simulated(n_drives: int, fps: float) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as name:
        measured = measure_pairs(
            _drives(Path(name), n_drives, fps), MATCHERS, expected=expected_disparities
        )
    objects = measured.objects
    near = (objects.distance_m >= FROM_M) & (objects.distance_m <= TO_M)
    return {
        matcher: figures(
            MatcherColumn(column.disparity_px[near], column.sigma_px[near]), objects.true_px[near]
        )
        for matcher, column in measured.columns.items()
    }


def _drives(folder: Path, n_drives: int, fps: float) -> Iterator[StereoPair]:
    for seed in range(n_drives):
        write_drive(folder / str(seed), seed=seed, fps=fps)
        yield from read_drive(folder / str(seed))
