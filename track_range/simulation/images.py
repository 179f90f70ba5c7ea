"""Simulated images with exact labels, as a data set to train a detector with: images, labels, data.yaml.

Objects of which less than half is visible go to `ignored` (see `labels_pseudo` in
detection/training/data/data_yaml.py): it is neither right nor wrong to detect them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import yaml

from track_range.detection.classes import ROAD_CLASS_OF, ROAD_CLASSES
from track_range.detection.formats.kitti import KittiLabels
from track_range.foundation.arrays import Image
from track_range.results.output_files import OutputError, make_folder, write_bytes, write_text
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scene import make_scene
from track_range.simulation.world.truth import label_scene

WIDTH_PX = 640
SECONDS = 6.0
"""Length of a scene; its images are spread evenly over it."""

MIN_SIDE_PX = 3.0
"""Smaller objects are ignored."""

_HIDDEN = 2
"""KITTI's `occluded` from which less than half is to be seen."""

_DOUBTFUL = 0.3
"""A score of a pseudo-label that makes it ignored."""


def write_image_set(
    folder: Path, seeds: Sequence[int], *, n_frames: int, progress: Callable[[int, int], None] | None = None
) -> Path:
    """Write `n_frames` images of each scene into `folder`; the same seeds give the same images.

    Args:
        folder: gets images/, labels/, ignored/ and data.yaml, whose train images are all of them.
        seeds: a scene each.
        n_frames: per scene.
        progress: called after each image with the images done and the images in all.

    Returns:
        The data.yaml.

    Raises:
        OutputError: the folder cannot be written, or there are images or a data.yaml in it.
    """
    for name in ("images", "labels", "ignored"):
        make_folder(folder / name)
    if (folder / "data.yaml").exists() or any((folder / "images").iterdir()):
        raise OutputError(f"{folder}: a data set is there already: choose another folder.")
    rig = kitti_like_rig()
    times_s = (np.arange(n_frames) * SECONDS / n_frames).tolist()
    for i, seed in enumerate(seeds):
        scene = make_scene(seed, seconds=SECONDS)
        renderer, truth = Renderer(scene, rig), label_scene(scene, times_s, camera=rig.left)
        for frame, time_s in enumerate(times_s):
            _write(folder, f"{seed:06}_{frame:02}", renderer.render(time_s), truth.select(truth.frame == frame))
            if progress is not None:
                progress(i * n_frames + frame + 1, len(seeds) * n_frames)
    document = {
        "train": "images",
        "val": "images",
        "names": list(ROAD_CLASSES),
        "labels": "labels",
        "labels_pseudo": "ignored",
    }
    path = folder / "data.yaml"
    write_text(path, yaml.safe_dump(document, sort_keys=False))
    return path


def _write(folder: Path, name: str, image: Image, truth: KittiLabels) -> None:
    """One image, its labels, and what is ignored in it."""
    height, width = image.shape[:2]
    scale = WIDTH_PX / width
    small = cv2.resize(image, (WIDTH_PX, round(height * scale)), interpolation=cv2.INTER_AREA)
    _, encoded = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 92])
    write_bytes(folder / "images" / f"{name}.jpg", encoded.tobytes())
    boxes = np.clip(truth.xyxy_px + 0.5, 0, [width, height, width, height])
    sizes = boxes[:, 2:] - boxes[:, :2]
    ignored = (truth.occluded >= _HIDDEN) | (scale * sizes.min(axis=1, initial=np.inf) < MIN_SIDE_PX)
    known = [ROAD_CLASS_OF.get(str(kind).lower()) for kind in truth.kitti_type]
    shares = np.concatenate([(boxes[:, :2] + boxes[:, 2:]) / 2, sizes], axis=1) / [width, height, width, height]
    lines: dict[bool, list[str]] = {False: [], True: []}
    for kind, row, is_ignored in zip(known, shares, ignored, strict=True):
        if kind is not None and row[2:].min() > 0:
            words = [str(ROAD_CLASSES.index(kind)), *(f"{share:.6f}" for share in row)]
            lines[bool(is_ignored)].append(" ".join([*words, str(_DOUBTFUL)] if is_ignored else words) + "\n")
    write_text(folder / "labels" / f"{name}.txt", "".join(lines[False]))
    write_text(folder / "ignored" / f"{name}.txt", "".join(lines[True]))
