"""Boxes of people and cars that cross in front of one another, without images.

The ground is flat, the camera stands, turns or drives 1.65 m above it. People walk across at 6 to
25 m, in both directions; cars pass behind them. A box is missing where nearer boxes hide most of
its object, and has noise on every edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.tracking.evaluation.tracked_boxes import TrackedBoxes

FPS = 10.0
MOTIONS = ("standing", "turning", "driving")
"""How the camera moves."""

_WIDTH_PX, _HEIGHT_PX, _FOCAL_PX, _HORIZON_PX, _CAMERA_M = 1242, 375, 721.0, 172.0, 1.65
_PERSON, _CAR, _BICYCLE = (ROAD_CLASSES.index(name) for name in ("person", "car", "bicycle"))
_N_PEOPLE, _N_CARS = 8, 2
_SIZE_M = {_PERSON: (0.6, 1.75), _CAR: (4.2, 1.5)}  # width as seen across, and height
_HIDDEN = 0.6  # hidden fraction of a box from which the object has none
_MIN_VISIBLE = 0.5  # fraction of a true box inside the image below which it does not count
_MISSED = 0.05  # fraction of other boxes that are missing
_YAW_RAD, _PITCH_RAD = 0.06, 0.004  # amplitudes of a camera that turns, and pitches as it drives
_SPEED_MPS = 5.0  # of a camera that drives


@dataclass(frozen=True, slots=True)
class CrossingScene:
    """Detections of each frame, and the true boxes that can be seen."""

    frames: list[Detections]
    truth: TrackedBoxes


def crossing_scene(
    seed: int, *, noise: float, motion: str = "standing", n: int = 100, renamed: float = 0.0
) -> CrossingScene:
    """A scene of `n` frames; `noise` is the standard deviation of an edge / height of the box.

    With `renamed` above 0, every second person rides, and this fraction of its boxes is called a
    bicycle.
    """
    random, names = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    class_id = np.repeat([_PERSON, _CAR], [_N_PEOPLE, _N_CARS])
    n_objects = len(class_id)
    size_m = np.array([_SIZE_M[number] for number in class_id.tolist()])
    size_m = size_m * random.normal(1.0, 0.04, (n_objects, 1))
    depth_m = np.where(
        class_id == _PERSON, random.uniform(6, 25, n_objects), random.uniform(25, 40, n_objects)
    )
    side = random.choice([-1.0, 1.0], n_objects)
    speed_mps = np.where(
        class_id == _PERSON, random.uniform(0.8, 1.8, n_objects), random.uniform(4, 9, n_objects)
    )
    start_m = np.stack([-side * random.uniform(0.0, 0.5, n_objects) * depth_m, depth_m], axis=1)
    rate_mps = np.stack(
        [side * speed_mps, np.where(class_id == _PERSON, random.normal(0, 0.2, n_objects), 0.0)],
        axis=1,
    )
    phase = random.uniform(0, 2 * np.pi, 2)
    frames, truth = [], []
    for frame in range(n):
        time_s = frame / FPS
        x_m, z_m = (start_m + rate_mps * time_s).T
        shift_px = np.zeros(2)
        if motion == "driving":
            z_m = z_m + 6.0 - _SPEED_MPS * time_s
        if motion != "standing":
            angle = np.sin(2 * np.pi * np.array([0.25, 1.1]) * time_s + phase)
            shift_px = _FOCAL_PX * angle * [_YAW_RAD, _PITCH_RAD]
        boxes_px = _projected(x_m, z_m, size_m, shift_px)
        shown, hidden = _visible(boxes_px, z_m)
        truth.append((np.full(len(shown), frame), shown, boxes_px[shown], class_id[shown]))
        is_detected = (hidden <= _HIDDEN) & (random.random(len(shown)) > _MISSED)
        boxes = boxes_px[shown][is_detected]
        edge_px = noise * (boxes[:, 3:] - boxes[:, 1:2])
        is_renamed = (shown % 2 == 0) & (shown < _N_PEOPLE) & (names.random(len(shown)) < renamed)
        named = np.where(is_renamed, _BICYCLE, class_id[shown])
        frames.append(
            Detections.of(
                boxes + random.normal(0, 1, boxes.shape) * edge_px,
                random.uniform(0.6, 1.0, len(boxes)),
                named[is_detected],
            )
        )
    columns = (np.concatenate(column) for column in zip(*truth, strict=True))
    return CrossingScene(frames, TrackedBoxes(*columns))


def _projected(
    x_m: FloatArray, z_m: FloatArray, size_m: FloatArray, shift_px: FloatArray
) -> FloatArray:
    """(N, 4) boxes; not finite for objects behind the camera."""
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(z_m > 2.0, _FOCAL_PX / z_m, np.nan)
    foot_px = _HORIZON_PX + shift_px[1] + _CAMERA_M * scale
    centre_px = _WIDTH_PX / 2 + shift_px[0] + x_m * scale
    width_px, height_px = size_m.T * scale
    return np.stack(
        [centre_px - width_px / 2, foot_px - height_px, centre_px + width_px / 2, foot_px], axis=1
    )


def _visible(boxes_px: FloatArray, z_m: FloatArray) -> tuple[IntArray, FloatArray]:
    """Rows (M,) of the objects that are mostly inside the image, and the hidden fraction (M,) of
    each, by the nearer object that hides most.
    """
    inside = np.clip(boxes_px, 0, [_WIDTH_PX, _HEIGHT_PX, _WIDTH_PX, _HEIGHT_PX])
    area = np.prod(boxes_px[:, 2:] - boxes_px[:, :2], axis=1)
    shown = np.flatnonzero(np.prod(inside[:, 2:] - inside[:, :2], axis=1) >= _MIN_VISIBLE * area)
    boxes, z_m = boxes_px[shown], z_m[shown]
    low = np.maximum(boxes[:, None, :2], boxes[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], boxes[None, :, 2:])
    shared = np.prod(np.maximum(high - low, 0.0), axis=2) * (z_m[None] < z_m[:, None])
    return shown, shared.max(axis=1, initial=0.0) / area[shown]
