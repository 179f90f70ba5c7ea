"""Boxes that are not the one box of an object: boxes of scenery, and second boxes of vehicles."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.special import ndtr

from benchmarks.boxes.error_model import (
    MAX_SCORE,
    MIN_SCORE,
    NETWORK_WIDTH_PX,
    FalseBoxes,
    SecondBoxes,
)
from benchmarks.boxes.true_boxes import CameraPoses, TrueBoxes
from track_range.detection.boxes import area_px2
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.stereo.geometry.camera import PinholeCamera

_HEIGHT_M = {0: 1.7, 2: 1.5, 5: 3.0, 6: 0.9, 7: 0.7}  # height of an object by class id, m
# width of a box relative to its height by class id
_ASPECT = {0: 0.38, 2: 1.2, 5: 1.2, 6: 0.4, 7: 1.0}
_VISIBLE_FRACTION = 0.5  # smallest fraction of a false box inside the image


@dataclass(frozen=True, slots=True)
class BoxRows:
    """K boxes of a drive."""

    frame: IntArray
    user: IntArray  # (K,) row of the scene's road users; -1 = a false box
    # (K,) number of the object for errors that are correlated in time, unique for each user, false
    # box and sequence of second boxes
    key: IntArray
    xyxy_px: FloatArray
    score: FloatArray
    class_id: IntArray
    true_m: FloatArray  # true_m, seen_m: (K,) true distance, and that of what is inside the box
    seen_m: FloatArray

    def select(self, rows: IntArray | BoolArray) -> BoxRows:
        return BoxRows(*(getattr(self, field.name)[rows] for field in fields(self)))


def joined_rows(parts: list[BoxRows]) -> BoxRows:
    columns = [
        np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(BoxRows)
    ]
    return BoxRows(*columns).select(np.argsort(columns[0], kind="stable"))


def scenery_boxes(
    rng: np.random.Generator,
    camera: PinholeCamera,
    poses: CameraPoses,
    height_m: float,
    step_s: float,
    *,
    first_key: int,
) -> BoxRows:
    """Boxes of scenery, fixed in the world; keys count from `first_key`, `height_m` is that of the
    camera.
    """
    model = FalseBoxes()
    n_frames = len(poses.position_m)
    n = int(rng.poisson(model.starts_hz * step_s * n_frames))
    start = rng.integers(0, n_frames, n)
    fractions, means = np.array(model.mean_frames).T
    mean = means[rng.choice(len(fractions), n, p=fractions / fractions.sum())]
    length = np.maximum(np.rint(rng.geometric(1 / mean) * 0.1 / step_s), 1).astype(np.int64)
    ids, class_fractions, height, spread, offset, width = np.array(model.classes).T
    chosen = rng.choice(len(ids), n, p=class_fractions / class_fractions.sum())
    class_id = ids[chosen].astype(np.int64)
    height_px = (
        height[chosen]
        * np.exp(spread[chosen] * rng.normal(size=n))
        * camera.width_px
        / NETWORK_WIDTH_PX
    )
    side = np.where(rng.uniform(size=n) < 0.5, 1.0, -1.0)
    u_px = (0.5 + side * (offset[chosen] + width[chosen] * rng.normal(size=n))) * camera.width_px
    by_height_m = (
        camera.fy_px * np.array([_HEIGHT_M[number] for number in class_id.tolist()]) / height_px
    )
    z_m = by_height_m * model.distance[0] * np.exp(model.distance[1] * rng.normal(size=n))
    tall_m = height_px * z_m / camera.fy_px
    lower_m = np.full(n, height_m * (1 - model.raised))
    at_start = np.stack([(u_px - camera.cx_px) / camera.fx_px * z_m, lower_m, z_m], axis=1)
    world_m = poses.position_m[start] + np.einsum(
        "nji,nj->ni", poses.camera_from_world[start], at_start
    )
    frame, number = _frames_of(start, length, n_frames)
    at_m = np.einsum(
        "nij,nj->ni", poses.camera_from_world[frame], world_m[number] - poses.position_m[frame]
    )
    is_ahead = at_m[:, 2] > 3.0
    frame, number, at_m = frame[is_ahead], number[is_ahead], at_m[is_ahead]
    scale = camera.fx_px / at_m[:, 2]
    middle, bottom = camera.cx_px + scale * at_m[:, 0], camera.cy_px + scale * at_m[:, 1]
    high = scale * tall_m[number] * np.exp(0.06 * rng.normal(size=len(number)))
    wide = high * np.array([_ASPECT[kind] for kind in class_id[number].tolist()])
    boxes = np.stack([middle - wide / 2, bottom - high, middle + wide / 2, bottom], axis=1)
    edge = np.array([camera.width_px - 1, camera.height_px - 1] * 2, np.float64)
    clipped = np.clip(boxes, 0, edge)
    score = (MIN_SCORE + model.mean_score * rng.exponential(size=n))[number] + 0.03 * rng.normal(
        size=len(number)
    )
    none, score, z = np.full(len(frame), -1), np.clip(score, MIN_SCORE, MAX_SCORE), at_m[:, 2]
    rows = BoxRows(frame, none, first_key + number, clipped, score, class_id[number], z, z)
    return rows.select(area_px2(clipped) > _VISIBLE_FRACTION * wide * high)


def _frames_of(start: IntArray, length: IntArray, n_frames: int) -> tuple[IntArray, IntArray]:
    """The frames of all sequences, and the number of the sequence in each."""
    number = np.repeat(np.arange(len(start)), length)
    first = np.repeat(np.cumsum(length) - length, length)
    frame = start[number] + np.arange(len(number)) - first
    is_inside: BoolArray = frame < n_frames
    return frame[is_inside], number[is_inside]


def second_boxes(
    rng: np.random.Generator,
    first: BoxRows,
    true: TrueBoxes,
    rows: IntArray,
    network: float,
    frames: tuple[int, float],
    *,
    first_key: int,
) -> BoxRows:
    """Second boxes of vehicles, whose first boxes are in the rows (K,) of `true`.

    `network`: network pixels per pixel. `frames`: number of frames and time step.
    """
    model = SecondBoxes()
    n_users = int(true.user.max(initial=-1)) + 1
    at = (first.user, first.frame)
    quantile = ndtr(model.presence.sample(rng, n_users, *frames)[at])
    errors = (
        np.stack([model.offset.sample(rng, n_users, *frames)[at] for _ in range(4)], axis=1)
        * model.sigma
    )
    rate = np.where(
        true.overlap_fraction[rows] >= model.min_overlap, model.overlap_rate, model.rate
    )
    rate = np.where(true.height_px[rows] * network > model.near_px, rate * model.near_factor, rate)
    is_second = quantile < rate
    size = first.xyxy_px[:, 2:] - first.xyxy_px[:, :2]
    centre = (first.xyxy_px[:, 2:] + first.xyxy_px[:, :2]) / 2 + errors[:, :2] * size
    half = size * np.exp(errors[:, 2:]) / 2
    boxes = np.concatenate([centre - half, centre + half], axis=1)
    low, high = (
        np.maximum(boxes[:, :2], first.xyxy_px[:, :2]),
        np.minimum(boxes[:, 2:], first.xyxy_px[:, 2:]),
    )
    common = np.prod(np.clip(high - low, 0, None), axis=1)
    overlap = common / np.maximum(area_px2(boxes) + area_px2(first.xyxy_px) - common, 1e-9)
    is_second &= overlap <= model.max_iou
    factor = np.exp(model.distance_sigma * errors[:, 0] / model.sigma[0])
    rank = ndtr(model.offset.sample(rng, n_users, *frames)[at])
    score = np.minimum(MIN_SCORE - model.mean_score * np.log(1 - rank), first.score)
    second = replace(
        first, key=first_key + first.user, xyxy_px=boxes, score=score, seen_m=first.true_m * factor
    )
    return second.select(is_second)
