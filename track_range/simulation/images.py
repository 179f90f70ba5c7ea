"""Data set of simulated images with exact labels, for training a detector: images, labels, data.yaml.

Objects that are less than half visible are written to `ignored` (see `labels_pseudo` in
detection/training/data/data_yaml.py): whether a detector finds them has no effect on its loss.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np

from track_range.detection.classes import ROAD_CLASS_OF, ROAD_CLASSES
from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.foundation.arrays import Image
from track_range.foundation.files.output_files import OutputError, make_folder, write_bytes, write_text
from track_range.foundation.files.structured_text import yaml_text
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scene import Scene, make_scene
from track_range.simulation.world.truth import label_scene

WIDTH_PX = 640

SECONDS = 6.0  # length of a scene, s; its images have equal intervals
MIN_SIDE_PX = 3.0  # smallest side of a box in the image, px; smaller objects are ignored

_HIDDEN = 2  # KITTI's `occluded` of objects that are less than half visible
_IGNORED_SCORE = 0.3  # of a pseudo-label that training ignores


def write_image_set(
    folder: Path,
    seeds: Sequence[int],
    *,
    n_frames: int,
    make: Callable[[int, float], Scene] = make_scene,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write `n_frames` images of each scene into `folder`; returns data.yaml, which lists all images for training.

    `folder` gets images/, labels/, ignored/ and data.yaml. The same `seeds` give the same images; `make` creates a
    scene from its seed and length in seconds. `progress` is called after each image with the number of finished images
    and the total. OutputError if the folder cannot be written, or contains images or a data.yaml.
    """
    for name in ("images", "labels", "ignored"):
        make_folder(folder / name)
    if (folder / "data.yaml").exists() or any((folder / "images").iterdir()):
        raise OutputError(f"{folder}: the folder already contains a data set; choose another folder.")
    rig = kitti_like_rig()
    times_s = (np.arange(n_frames) * SECONDS / n_frames).tolist()
    n_written = 0
    for seed in seeds:
        scene = make(seed, SECONDS)
        renderer, truth = Renderer(scene, rig), label_scene(scene, times_s, camera=rig.left)
        for frame, time_s in enumerate(times_s):
            _write(folder, f"{seed:06}_{frame:02}", renderer.render(time_s), truth.select(truth.frame == frame))
            n_written += 1
            if progress is not None:
                progress(n_written, len(seeds) * n_frames)
    document = {"train": "images", "val": "images", "names": list(ROAD_CLASSES)}
    path = folder / "data.yaml"
    write_text(path, yaml_text(document | {"labels": "labels", "labels_pseudo": "ignored"}))
    return path


def _write(folder: Path, name: str, image: Image, truth: KittiLabels) -> None:
    height, width = image.shape[:2]
    scale = WIDTH_PX / width
    small = cv2.resize(image, (WIDTH_PX, round(height * scale)), interpolation=cv2.INTER_AREA)
    _, encoded = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 92])
    write_bytes(folder / "images" / f"{name}.jpg", encoded.tobytes())
    boxes = np.clip(truth.xyxy_px + 0.5, 0, [width, height, width, height])
    sizes = boxes[:, 2:] - boxes[:, :2]
    ignored = (truth.occluded >= _HIDDEN) | (scale * sizes.min(axis=1, initial=np.inf) < MIN_SIDE_PX)
    names = [ROAD_CLASS_OF.get(str(kitti_type).lower()) for kitti_type in truth.kitti_type]
    fractions = np.concatenate([(boxes[:, :2] + boxes[:, 2:]) / 2, sizes], axis=1) / [width, height, width, height]
    labels, pseudo_labels = [], []
    for road_class, row, is_ignored in zip(names, fractions, ignored, strict=True):
        if road_class is not None and row[2:].min() > 0:
            line = " ".join([str(ROAD_CLASSES.index(road_class)), *(f"{fraction:.6f}" for fraction in row)])
            if is_ignored:
                pseudo_labels.append(f"{line} {_IGNORED_SCORE}\n")
            else:
                labels.append(f"{line}\n")
    write_text(folder / "labels" / f"{name}.txt", "".join(labels))
    write_text(folder / "ignored" / f"{name}.txt", "".join(pseudo_labels))
