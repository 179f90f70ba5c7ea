"""Sequences for the tracking benchmark: stored boxes with official ground truth, and random scenes
for timing.

KITTI tracking (RRC boxes of cars and pedestrians), MOT15 and MOT17, scored as by `evaluate tracks`.
A scene has objects on smooth random paths, with jitter, missing boxes and false alarms, determined
by its seed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.formats.detection_files import RecordedDetections, read_detections
from track_range.detection.formats.video_labels.kitti import KittiLabels, read_kitti
from track_range.detection.formats.video_labels.mot import MotRows, read_mot
from track_range.evaluation.sequences.find import find_sequences
from track_range.evaluation.sequences.track import track_sequence
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.tracking.deepsort import DeepSortTracker
from track_range.tracking.evaluation.benchmark_rules import KITTI_TYPES, kitti_cleaned, mot_cleaned
from track_range.tracking.evaluation.scores import TrackingCounts
from track_range.tracking.evaluation.tracked_boxes import TrackedBoxes

SETS = ("kitti-car", "kitti-person", "mot15", "mot17")

_KITTI_FPS, _KITTI_SIZE_PX, _DEFAULT_SIZE_PX = 10.0, (1242, 375), (1920, 1080)
"""Frame rate and image size of KITTI, and image size of other sequences without one."""

_MIN_SCORE = {"kitti-car": 0.5, "kitti-person": 0.5, "mot15": 0.5, "mot17": 0.3}
"""Confidence threshold of boxes for trackers with one threshold, by data set."""

N_WARM_UP = 20  # frames at the start of a scene that are not timed


@dataclass(frozen=True, slots=True)
class Sequence:
    """Stored boxes of one class of a sequence of a data set (of `SETS`, or "scene"), with the
    ground truth.

    `size_px` is (width, height) of the images; a scene has no ground truth.
    """

    name: str
    set_name: str
    road_class: str
    detected: RecordedDetections
    n_frames: int
    fps: float
    size_px: tuple[int, int]
    truth: KittiLabels | MotRows | None

    @property
    def min_score(self) -> float:
        return _MIN_SCORE.get(self.set_name, 0.5)

    @property
    def has_embeddings(self) -> bool:
        return bool(self.detected.detections.descriptor.shape[1])

    def every(self, step: int) -> Sequence:
        """Every `step`-th frame of the sequence, at a lower frame rate."""

        def thinned(rows: Any) -> Any:
            kept = np.flatnonzero(rows.frame % step == 0)
            return _taken(rows, kept, rows.frame[kept] // step)

        n_frames = -(-self.n_frames // step)
        return replace(self._of_rows(thinned), n_frames=n_frames, fps=self.fps / step)

    def backwards(self) -> Sequence:
        """The sequence from its last frame to its first one."""

        def turned(rows: Any) -> Any:
            frame = self.n_frames - 1 - rows.frame
            order = np.argsort(frame, kind="stable")
            return _taken(rows, order, frame[order])

        return self._of_rows(turned)

    def _of_rows(self, changed: Callable[[Any], Any]) -> Sequence:
        truth = None if self.truth is None else changed(self.truth)
        return replace(self, detected=changed(self.detected), truth=truth)

    def boxes(self, frame: IntArray, track_id: IntArray, xyxy_px: FloatArray) -> TrackedBoxes:
        """N track boxes of the class."""
        return TrackedBoxes(
            frame, track_id, xyxy_px, np.full(len(frame), ROAD_CLASSES.index(self.road_class))
        )

    def tracked(
        self, tracker: DeepSortTracker, *, is_online: bool = True
    ) -> tuple[TrackedBoxes, BoolArray]:
        """The boxes of all tracks, as by the command `track`, and (N,) whether they were
        detected.
        """
        frames = track_sequence(
            self.detected, tracker, n_frames=self.n_frames, fps=self.fps, is_online=is_online
        ).frames
        frame = np.repeat(np.arange(len(frames)), [len(tracks) for tracks in frames])
        track_id, xyxy_px, observed = (
            np.concatenate([getattr(tracks, name) for tracks in frames])
            for name in ("track_id", "xyxy_px", "observed")
        )
        return self.boxes(frame, track_id, xyxy_px), observed

    def counts(self, boxes: TrackedBoxes) -> TrackingCounts:
        """Counts of track boxes by the official rules; boxes are rounded to two decimals, as in
        result files.
        """
        boxes = replace(boxes, xyxy_px=np.round(boxes.xyxy_px, 2))
        if isinstance(self.truth, KittiLabels):
            return TrackingCounts.of(*kitti_cleaned(self.truth, boxes, self.road_class))
        if self.truth is None:
            raise ValueError(f"{self.name}: expected a sequence with ground truth, got a scene")
        return TrackingCounts.of(*mot_cleaned(self.truth, boxes))


def _taken(rows: Any, kept: IntArray, frame: IntArray) -> Any:
    """Rows of boxes or labels by number, with new frames."""
    columns = {f.name: getattr(rows, f.name) for f in fields(rows) if f.name != "frame"}
    taken = {k: v[kept] if isinstance(v, np.ndarray) else v for k, v in columns.items()}
    if isinstance(rows, RecordedDetections):
        taken["detections"] = rows.detections.select(kept)
    return replace(rows, frame=frame, **taken)


def sequences_of(set_name: str, data: Path) -> list[Sequence]:
    """All sequences of a data set, of `SETS`, with stored boxes; empty if `data` does not have the
    data set.
    """
    if set_name.startswith("kitti"):
        return list(_kitti(data / "kitti_labels", set_name))
    return list(_mot(data / "mot" / set_name.upper(), set_name))


def _kitti(folder: Path, set_name: str) -> Iterator[Sequence]:
    road_class = set_name.removeprefix("kitti-")
    boxes = folder / "rrc" / KITTI_TYPES[road_class][0]
    for source in find_sequences(boxes, "det") if boxes.is_dir() else ():
        if source.path.stat().st_size == 0:  # the labels do not have the class either
            continue
        detected = read_detections(source.path, default_class_id=ROAD_CLASSES.index(road_class))
        truth = read_kitti(folder / "label_02" / f"{source.name}.txt")
        n_frames = int(detected.frame[-1]) + 1
        yield Sequence(
            source.name, set_name, road_class, detected, n_frames, _KITTI_FPS, _KITTI_SIZE_PX, truth
        )


def _mot(folder: Path, set_name: str) -> Iterator[Sequence]:
    for source in find_sequences(folder, "det") if folder.is_dir() else ():
        detected = read_detections(source.path, default_class_id=ROAD_CLASSES.index("person"))
        n_frames = max(source.info.n_frames or 0, int(detected.frame[-1]) + 1)
        truth = read_mot(folder / source.name / "gt" / "gt.txt")
        fps, size_px = source.info.fps or 30.0, source.info.size_px or _DEFAULT_SIZE_PX
        yield Sequence(source.name, set_name, "person", detected, n_frames, fps, size_px, truth)


def scene(n_objects: int, *, n_frames: int, seed: int = 0) -> Sequence:
    """Random scene of objects on smooth paths: 2 % jitter, 5 % missing boxes, 2 % false alarms, in
    random order.

    The image is 1920 x 1080 px, and larger for more than 200 objects, so that their density stays
    the same.
    """
    random = np.random.default_rng(seed)
    side = max(1.0, (n_objects / 200) ** 0.5)
    size_px = np.array(_DEFAULT_SIZE_PX) * side
    height_px = random.uniform(40, 160, n_objects)
    size = np.stack([height_px * random.uniform(0.4, 1.5, n_objects), height_px], axis=1)
    middle, swing = (
        random.uniform(0.1, 0.9, (2, n_objects, 2)) * size_px * np.array([[[1.0]], [[0.1 / side]]])
    )
    speed, phase = (
        random.uniform(0.2, 1.0, (n_objects, 2)),
        random.uniform(0, 2 * np.pi, (n_objects, 2)),
    )
    frames = []
    for frame in range(n_frames):
        centre = middle + swing * np.sin(speed * frame / 30 + phase)
        boxes = np.concatenate([centre - size / 2, centre + size / 2], axis=1)
        boxes = (boxes + random.normal(0, 0.02, boxes.shape) * np.tile(size, 2))[
            random.random(n_objects) > 0.05
        ]
        corner = random.uniform(0, 0.9, (random.binomial(n_objects, 0.02), 2)) * size_px
        alarms = np.concatenate([corner, corner + random.uniform(30, 120, corner.shape)], axis=1)
        score = np.concatenate(
            [random.uniform(0.6, 1.0, len(boxes)), random.uniform(0.3, 0.7, len(alarms))]
        )
        order = random.permutation(len(score))
        frames.append(
            Detections.of(
                np.concatenate([boxes, alarms])[order], score[order], np.zeros(len(score))
            )
        )
    columns = (
        np.concatenate([getattr(part, name) for part in frames])
        for name in ("xyxy_px", "score", "class_id")
    )
    frame_number = np.repeat(np.arange(n_frames), [len(detections) for detections in frames])
    recorded = RecordedDetections(frame_number, Detections.of(*columns), "rrc", notes=())
    width, height = np.rint(size_px).astype(int).tolist()
    return Sequence(
        f"{n_objects} objects", "scene", "person", recorded, n_frames, 30.0, (width, height), None
    )
