"""Boxes that burnt-in text adds to simulated drives, and true boxes that are lost with it.

Each drive is rendered without and with lines of text (`edited_images`). A box is true if its IoU
with a road user that is at least half visible is 0.5 or more, with a class that detectors confuse
with it; any other box is added by the text if its IoU with every box of the image without text is
below 0.5. The parts that never move are learnt in a pass before, as in a run of a file.
"""

from argparse import Namespace

import numpy as np

from benchmarks.harness import Figures, option, workload
from benchmarks.inputs.edited_images import edited
from track_range.detection.boxes import iou
from track_range.detection.catalogue.lookup import DEFAULT_MODEL, find_model
from track_range.detection.classes import SAME_OBJECT_GROUP, road_class_id, road_class_of
from track_range.detection.detections import Detections
from track_range.detection.fixed_parts import FixedParts
from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.detection.models.onnx_session import Runtime
from track_range.detection.yolo.detector import YoloDetector
from track_range.foundation.arrays import BoolArray
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.truth import label_scene
from track_range.stereo.geometry.frames import Frame

_SCENARIOS = ("town", "city")
_STEP_S, _SAME = 0.25, 0.5


@workload(
    option("--seed", default=300, help="first seed of the drives"),
    option("--seeds", default=10, help="number of drives of each of two scenarios"),
    option("--seconds", default=6.0, help="length of each drive"),
)
def fixed_parts(options: Namespace) -> Figures:
    """Boxes that text adds, and true boxes, without and with the search for what never moves."""
    network = YoloDetector(find_model(DEFAULT_MODEL).path, runtime=Runtime(n_threads=1))
    counts = {
        edit: dict.fromkeys(("added", "added_left", "true", "true_left"), 0) for edit in _EDITS
    }
    for seed in range(options.seed, options.seed + options.seeds):
        for scenario in _SCENARIOS:
            _add_drive(counts, network, scenario, seed, options.seconds)
    return {"drives": len(_SCENARIOS) * options.seeds, **counts}


_EDITS = ("none", "text")


def _add_drive(
    counts: dict[str, dict[str, int]],
    network: YoloDetector,
    scenario: str,
    seed: int,
    seconds: float,
) -> None:
    scene, rig = make_scenario(scenario, seed=seed, seconds=seconds), kitti_like_rig()
    times_s = np.arange(0.0, seconds, _STEP_S).tolist()
    renderer, labels = Renderer(scene, rig), label_scene(scene, times_s, camera=rig.left)
    plain = [
        Frame(number, time_s, renderer.render(time_s), None)
        for number, time_s in enumerate(times_s)
    ]
    boxes_of_plain = [network.detect(frame.left) for frame in plain]
    for edit in _EDITS:
        frames, parts = edited(plain, edit), FixedParts()
        for frame in frames:
            parts.add(frame.left, frame.time_s)
        for frame, before in zip(frames, boxes_of_plain, strict=True):
            boxes = network.detect(frame.left)
            left = parts.moving(boxes, frame.left)
            for name, some in (("", boxes), ("_left", left)):
                is_true = _are_true(some, labels, frame.index)
                is_added = ~_are_in(some, before) & ~is_true
                counts[edit][f"added{name}"] += int(np.count_nonzero(is_added))
                counts[edit][f"true{name}"] += int(np.count_nonzero(is_true))


def _are_in(boxes: Detections, others: Detections) -> BoolArray:
    overlap = iou(boxes.xyxy_px, others.xyxy_px)
    return np.asarray(overlap.max(axis=1, initial=0.0) >= _SAME)


def _are_true(boxes: Detections, labels: KittiLabels, frame: int) -> BoolArray:
    rows = np.flatnonzero((labels.frame == frame) & (labels.occluded <= 1))
    classes = [road_class_of(str(name)) for name in labels.kitti_type[rows]]
    group = np.array([-1 if c is None else SAME_OBJECT_GROUP[road_class_id(c)] for c in classes])
    is_group = SAME_OBJECT_GROUP[boxes.class_id][:, None] == group
    overlap = np.where(is_group, iou(boxes.xyxy_px, labels.xyxy_px[rows]), 0.0)
    return np.asarray(overlap.max(axis=1, initial=0.0) >= _SAME)
