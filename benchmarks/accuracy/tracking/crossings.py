"""Identity switches of simulated people and cars that cross, by the noise of the boxes and the
motion of the camera; there are no images.
"""

from __future__ import annotations

from argparse import Namespace
from dataclasses import asdict

import numpy as np

from benchmarks.accuracy.tracking.tracking import VARIANTS
from benchmarks.harness import Figures, option, workload
from benchmarks.inputs.crossing_scenes import FPS, MOTIONS, CrossingScene, crossing_scene
from track_range.tracking.deepsort import DeepSortSettings, DeepSortTracker
from track_range.tracking.evaluation.scores import TrackingCounts
from track_range.tracking.evaluation.tracked_boxes import TrackedBoxes

_METRICS = ("hota", "assa", "idf1", "idsw")


@workload(
    option("--seeds", default=20, help="number of scenes"),
    option("--noise", default=(0.02, 0.05), help="sigma of an edge / height of the box"),
    option("--renamed", default=0.0, help="fraction of riders' boxes that are called a bicycle"),
)
def crossings(options: Namespace) -> Figures:
    settings = VARIANTS["track-range"].settings
    figures: Figures = {}
    for noise in options.noise:
        for motion in MOTIONS:
            counts = [
                counts_of(
                    crossing_scene(seed, noise=noise, motion=motion, renamed=options.renamed),
                    settings,
                )
                for seed in range(options.seeds)
            ]
            scores = asdict(TrackingCounts.sum_of(counts).scores())
            figures[f"{motion}, {noise:g}"] = {name: scores[name] for name in _METRICS}
    return figures


def counts_of(scene: CrossingScene, settings: DeepSortSettings) -> TrackingCounts:
    tracker = DeepSortTracker(settings)
    frames = [tracker.update(boxes, k / FPS, None) for k, boxes in enumerate(scene.frames)]
    columns = (
        np.concatenate([getattr(tracks, name) for tracks in frames])
        for name in ("track_id", "xyxy_px", "class_id")
    )
    frame = np.repeat(np.arange(len(frames)), [len(tracks) for tracks in frames])
    return TrackingCounts.of(scene.truth, TrackedBoxes(frame, *columns))
