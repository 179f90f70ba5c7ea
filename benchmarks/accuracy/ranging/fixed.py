"""Speeds and counts of cameras that stand still, against the exact world of the scenario `fixed`.

The plane of the road is fitted to five clicked points (1.5 px) with an unknown focal length. Boxes are the true ones
with the errors of a plausible detector (`simulation.camera.playback`), or those of the packaged detector in rendered
images. Tracks are matched to road users by the IoU of their boxes in each frame, crossings of a line by direction
within half a second.
"""

from argparse import Namespace
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.harness import Figures, option, workload
from track_range.api.parts import Detector
from track_range.detection.boxes import iou
from track_range.detection.classes import road_class_id, road_class_of
from track_range.detection.detections import Detections
from track_range.detection.detector import ObjectDetector
from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.foundation.arrays import Image
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.world.ground_file import GroundFile, save_ground
from track_range.ranging.world.road_plane import RoadPlane
from track_range.ranging.world.road_plane_fit import PlaneMeasurements, PlanePriors, fit_plane
from track_range.results.counts.counter import KMH, Crossing, LineCounter
from track_range.run.pipeline import Pipeline
from track_range.simulation.camera.fixed_files import crossings, line_texts, point_texts
from track_range.simulation.camera.playback import play_back
from track_range.simulation.render.renderer import Renderer
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.scene import Scene
from track_range.simulation.world.truth import joined, visible_objects
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

_CAMERA = PinholeCamera.of_focal_length(820.0, (1280, 720))
_USUAL_PX, _FOCAL_SIGMA = 1050.0, 0.35  # of a camera of which nothing is known
_SAME, _SAME_S = 0.4, 0.5
_FAR_M = (0.0, 20.0, 40.0, 80.0)  # of the camera, along the road


@dataclass(slots=True)
class _Scores:
    """Rows of speeds (true and measured, sigma, distance), and crossings."""

    rows: list[tuple[float, float, float, float]] = field(default_factory=list)
    unknown: int = 0
    matched: list[tuple[float, float, float, float]] = field(default_factory=list)
    n_true: int = 0
    extra: int = 0


class _Recorded(ObjectDetector):
    """Plays the boxes of each frame back, in order."""

    def __init__(self, labels: KittiLabels, n_frames: int) -> None:
        self._frames = iter([labels.select(labels.frame == number) for number in range(n_frames)])

    def detect(self, image: Image) -> Detections:
        del image
        labels = next(self._frames)
        classes = [road_class_id(road_class_of(str(name)) or "") for name in labels.kitti_type]
        return Detections.of(labels.xyxy_px, labels.score, classes)


@workload(
    option("--seed", default=700, help="first seed of the scenes"),
    option("--seeds", default=12, help="number of scenes with recorded boxes"),
    option("--rendered", default=2, help="number of scenes with rendered images"),
    option("--seconds", default=14.0, help="length of each scene"),
    option("--fps", default=15.0, help="frame rate"),
)
def fixed(options: Namespace) -> Figures:
    """Speeds, crossings and counts of cameras that stand still."""
    figures: Figures = {}
    for name, n in (("recorded boxes", options.seeds), ("packaged detector", options.rendered)):
        scores = _Scores()
        for seed in range(options.seed, options.seed + n):
            _add_scene(scores, seed, options, is_rendered=name == "packaged detector")
        if n:
            figures[name] = _figures(scores)
    return figures


def _add_scene(scores: _Scores, seed: int, options: Namespace, *, is_rendered: bool) -> None:
    scene = make_scenario("fixed", seed=seed, seconds=options.seconds)
    times_s = (np.arange(round(options.seconds * options.fps)) / options.fps).tolist()
    seen = [
        visible_objects(scene, time_s, frame=number, camera=_CAMERA)
        for number, time_s in enumerate(times_s)
    ]
    labels = [one.labels for one in seen]
    boxes = play_back(joined(labels), seed=seed, image_size_px=_CAMERA.size_px)
    renderer = Renderer(scene, StereoRig.rectified(_CAMERA, 0.5)) if is_rendered else None
    detector = Detector("road") if is_rendered else _Recorded(boxes, len(times_s))
    plane = _clicked_plane(scene, seed)
    counter = LineCounter.of(line_texts(scene, _CAMERA), plane=plane)
    blank = np.full((_CAMERA.height_px, _CAMERA.width_px, 3), 90, np.uint8)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "ground.yaml"
        save_ground(path, GroundFile(plane))
        with Pipeline.mono(
            detector=detector, static_camera=True, ground=path, deterministic=True
        ) as pipeline:
            for number, time_s in enumerate(times_s):
                image = blank if renderer is None else renderer.render(time_s)
                result = pipeline.step(image, time_s)
                counter.update(result)
                _add_speeds(scores, scene, result, seen[number])
    _add_crossings(scores, scene, counter.finish(), options.seconds)


def _clicked_plane(scene: Scene, seed: int) -> RoadPlane:
    """The plane of clicked points."""
    texts = point_texts(scene, _CAMERA, np.random.default_rng([seed, 19]))
    numbers = np.array([[float(n) for n in text.replace("=", ",").split(",")] for text in texts])
    measured = PlaneMeasurements(
        point_px=numbers[:, :2],
        point_m=numbers[:, 2:],
        length_px=np.zeros((0, 2, 2)),
        length_m=np.zeros(0),
        parallel_px=np.zeros((0, 4, 2)),
        names=tuple(texts),
    )
    usual = PinholeCamera.of_focal_length(_USUAL_PX, _CAMERA.size_px)
    return fit_plane(measured, PlanePriors(camera=usual, focal_sigma=_FOCAL_SIGMA))


def _add_speeds(scores: _Scores, scene: Scene, result: FrameResult, seen: Any) -> None:
    overlap = iou(result.tracks.xyxy_px, seen.labels.xyxy_px)
    for row in np.flatnonzero(result.tracks.observed).tolist():
        if not overlap.shape[1] or overlap[row].max() < _SAME:
            continue
        user = scene.road_users[int(seen.row[int(overlap[row].argmax())])]
        if user.raised_m > 0:
            continue
        (x0, z0), (x1, z1) = (user.on_road_m(result.time_s + step) for step in (-1e-3, 1e-3))
        true_mps = float(np.hypot(x1 - x0, z1 - z0)) / 2e-3
        measured = float(result.motion.speed_mps[row]), float(result.motion.speed_sigma_mps[row])
        if np.isfinite(measured[0]):
            scores.rows.append((true_mps, *measured, z1))
        else:
            scores.unknown += 1


def _add_crossings(
    scores: _Scores, scene: Scene, found: tuple[Crossing, ...], seconds: float
) -> None:
    free = list(found)
    for name, _, _, time_s, speed_mps, direction in crossings(scene, seconds - 0.3):
        scores.n_true += 1
        near = [
            one
            for one in free
            if (one.place, one.direction) == (name, direction)
            and abs(one.time_s - time_s) < _SAME_S
        ]
        if near:
            best = min(near, key=lambda one: abs(one.time_s - time_s))
            free.remove(best)
            late_s = best.time_s - time_s
            scores.matched.append(
                (late_s, speed_mps, best.speed_kmh / KMH, best.speed_sigma_kmh / KMH)
            )
    scores.extra += sum(one.time_s < seconds - 0.3 for one in free)


def _figures(scores: _Scores) -> Figures:
    rows, matched = np.array(scores.rows), np.array(scores.matched)
    of_speeds = dict(_bands(rows))
    at_lines = _speed_figures(*matched[np.isfinite(matched[:, 2]), 1:].T)
    late_s = np.abs(matched[:, 0])
    return {
        "speeds": of_speeds,
        "at lines": at_lines,
        "counts": {
            "true": scores.n_true,
            "found": len(matched),
            "extra": scores.extra,
            "median_time_error_s": float(np.median(late_s)),
            "p95_time_error_s": float(np.quantile(late_s, 0.95)),
        },
        "known_pct": 100 * len(rows) / (len(rows) + scores.unknown),
    }


def _bands(rows: np.ndarray) -> Iterator[tuple[str, Figures]]:
    moves = rows[:, 0] > 0.5
    masks = {"all": moves, "standing": ~moves}
    for low, high in pairwise(_FAR_M):
        masks[f"{low:g} to {high:g} m"] = moves & (rows[:, 3] >= low) & (rows[:, 3] < high)
    for name, mask in masks.items():
        if mask.any():
            yield name, _speed_figures(*rows[mask, :3].T)


def _speed_figures(true_mps: np.ndarray, mps: np.ndarray, sigma_mps: np.ndarray) -> Figures:
    error = mps - true_mps
    return {
        "n": len(error),
        "median_error_kmh": float(KMH * np.median(np.abs(error))),
        "p90_error_kmh": float(KMH * np.quantile(np.abs(error), 0.9)),
        "bias_kmh": float(KMH * np.median(error)),
        "median_sigma_kmh": float(KMH * np.median(sigma_mps)),
        "within_1_sigma_pct": 100 * float((np.abs(error) < sigma_mps).mean()),
        "within_2_sigma_pct": 100 * float((np.abs(error) < 2 * sigma_mps).mean()),
    }
