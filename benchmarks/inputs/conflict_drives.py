"""Rendered drives that end in a contact, and harmless ones, in a cache folder with the packaged detector's boxes.

A drive is rendered once per scenario, seed and image width, and the packaged detector runs once over its left images;
later runs read the videos and the stored boxes.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import av
import numpy as np

from track_range.detection.detections import Detections
from track_range.detection.models.lookup import DEFAULT_MODEL, find_model
from track_range.detection.models.onnx_session import Runtime
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.foundation.arrays import Image
from track_range.simulation.drive import Drive, write_drive
from track_range.simulation.render.renderer import kitti_like_rig

COLLISIONS = ("rear-stationary", "rear-slower", "rear-braking", "crossing-adult", "crossing-child", "cut-in")
"""Scenarios with a contact."""

HARMLESS = ("curve-parked", "oncoming", "overhead-sign", "following", "queue")
"""Scenarios without a contact."""

SECONDS, FPS = 8.0, 10.0
"""Length of a drive in s, after all contacts, and its frame rate."""

WIDTH_PX, HEIGHT_FRACTION = 1240, 376 / 1240
"""Default width of the images, and their height relative to it: KITTI's."""


@dataclass(frozen=True, slots=True)
class ConflictDrive:
    """A rendered drive.

    Attributes:
        scenario: its scenario.
        seed: its random seed.
        files: its files.
        boxes: file with the detector's boxes.
    """

    scenario: str
    seed: int
    files: Drive
    boxes: Path

    def detector(self) -> StoredDetector:
        """A detector that returns the stored boxes of the frames in order."""
        return StoredDetector(stored_boxes(self.boxes))


class StoredDetector:
    """Returns stored boxes, one frame after another, whatever the image."""

    def __init__(self, frames: list[Detections]) -> None:
        self._frames: Iterator[Detections] = iter(frames)

    def detect(self, image: Image) -> Detections:
        """The boxes of the next frame."""
        return next(self._frames)


def conflict_drive(cache_folder: Path, scenario: str, seed: int, *, width_px: int = WIDTH_PX) -> ConflictDrive:
    """The drive of a scenario and seed from the cache folder, rendered first if it is not there."""
    folder = cache_folder / f"{scenario}_{seed}_{width_px}"
    boxes = folder / "boxes.npz"
    files = Drive.in_folder(folder)
    if not boxes.exists():
        rig = kitti_like_rig(width_px=width_px, height_px=2 * round(width_px * HEIGHT_FRACTION / 2))
        write_drive(folder, scenario=scenario, seed=seed, seconds=SECONDS, fps=FPS, rig=rig)
        _store_boxes(files.left, boxes)
    return ConflictDrive(scenario, seed, files, boxes)


def stored_boxes(path: Path) -> list[Detections]:
    """The stored boxes by frame."""
    with np.load(path) as stored:
        arrays = {name: stored[name] for name in ("frame", "xyxy_px", "score", "class_id", "n_frames")}
    rows = [np.flatnonzero(arrays["frame"] == frame) for frame in range(int(arrays["n_frames"]))]
    return [Detections.of(arrays["xyxy_px"][row], arrays["score"][row], arrays["class_id"][row]) for row in rows]


def _store_boxes(video: Path, path: Path) -> None:
    """Write the packaged detector's boxes of a video, with its default thresholds."""
    with av.open(str(video)) as reader:
        frames = [
            _detector().detect(np.asarray(frame.to_ndarray(format="bgr24"), np.uint8))
            for frame in reader.decode(video=0)
        ]
    partial = path.with_name("partial.npz")
    np.savez_compressed(
        partial,
        frame=np.repeat(np.arange(len(frames)), [len(boxes) for boxes in frames]),
        xyxy_px=np.concatenate([boxes.xyxy_px for boxes in frames]),
        score=np.concatenate([boxes.score for boxes in frames]),
        class_id=np.concatenate([boxes.class_id for boxes in frames]),
        n_frames=np.array(len(frames)),
    )
    os.replace(partial, path)


@cache
def _detector() -> YoloDetector:
    return YoloDetector(find_model(DEFAULT_MODEL).path, YoloSettings(), runtime=Runtime(n_threads=1))


def default_cache() -> Path:
    """The default cache folder, in the folder for temporary files."""
    return Path(tempfile.gettempdir()) / "track-range-drives"
