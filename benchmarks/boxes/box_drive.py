"""BoxDrive: a drive without images: boxes as the packaged detector finds them, and stereo
distances, frame by frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit, logit, ndtr, ndtri

from benchmarks.boxes import error_model as model
from benchmarks.boxes.error_model import AppearanceErrors, ClassErrors, StereoErrors
from benchmarks.boxes.false_boxes import BoxRows, joined_rows, scenery_boxes, second_boxes
from benchmarks.boxes.true_boxes import CameraPoses, TrueBoxes, true_boxes
from track_range.detection.detections import Detections
from track_range.foundation.arrays import FloatArray, FloatArray32, IntArray
from track_range.simulation.world.scene import Scene
from track_range.stereo.geometry.rig import StereoRig

_PERSONS = ("Pedestrian", "Cyclist", "Motorcycle")
_SIGNS = ("TrafficSign", "TrafficLight")
_FIT_WIDTH_PX = 620.0
_VEHICLES = ("Car", "Van", "Truck", "Bus")


@dataclass(frozen=True, slots=True)
class BoxFrame:
    """The boxes of one frame with what stereo would measure of each."""

    index: int
    time_s: float
    detections: Detections  # K boxes with embeddings
    user: IntArray  # (K,) row of the scene's road users; -1 = a false box
    true_m: FloatArray  # (K,) distance; that of a false box is the distance of the scenery there
    # stereo_m, stereo_sigma_m: (K,) measured distance and reported standard deviation; NaN = no
    # match
    stereo_m: FloatArray
    stereo_sigma_m: FloatArray
    # (2,) estimated motion of far objects in the image since the frame before, by the camera's
    # rotation
    shift_px: FloatArray


class BoxDrive:
    """The frames of a scene with a rectified pair, at equal steps; the same scene and seed give the
    same frames.

    Another drive in the same scene with the same times and rig (`like`) saves the computation of
    the exact boxes.
    """

    def __init__(
        self,
        scene: Scene,
        times_s: FloatArray,
        rig: StereoRig,
        *,
        seed: int,
        like: BoxDrive | None = None,
    ) -> None:
        rng = np.random.default_rng([seed, 31])
        self.scene, self.times_s, self.rig = scene, times_s, rig
        frames = (len(times_s), float(times_s[1] - times_s[0]))
        self.poses: CameraPoses = like.poses if like else CameraPoses.of(scene, times_s)
        poses = self.poses
        self.true: TrueBoxes = (
            like.true if like else true_boxes(scene, times_s, rig.left, poses=poses)
        )
        n_users = len(scene.road_users)
        stereo = StereoErrors()
        first, rows = _detected(scene, self.true, rng, rig, frames)
        first = replace(first, seen_m=_seen_m(rng, stereo, first, self.true, rows, frames))
        is_vehicle = np.array([user.kitti_type in _VEHICLES for user in scene.road_users])[
            first.user
        ]
        network = model.NETWORK_WIDTH_PX / rig.left.width_px
        repeated = second_boxes(
            rng,
            first.select(is_vehicle),
            self.true,
            rows[is_vehicle],
            network,
            frames,
            first_key=n_users,
        )
        false = scenery_boxes(
            rng, rig.left, poses, scene.camera_height_m, frames[1], first_key=2 * n_users
        )
        self._boxes = boxes = joined_rows([first, repeated, false])
        keys = np.unique(boxes.key, return_inverse=True)[1]
        self._stereo_m, self._stereo_sigma_m = _stereo(
            rng, stereo, rig, (boxes.frame, keys, boxes.seen_m), frames
        )
        objects = np.unique(np.where(boxes.user >= 0, boxes.user, boxes.key), return_inverse=True)[
            1
        ]
        self._embedding = _embeddings(rng, AppearanceErrors(), objects, boxes.frame, frames)
        sigma_px = model.CAMERA_MOTION_SIGMA_PX * rig.left.width_px / _FIT_WIDTH_PX
        self._shift_px = poses.image_shifts_px(rig.left) + sigma_px * rng.normal(
            size=(len(times_s), 2)
        )
        self._ends = np.searchsorted(boxes.frame, np.arange(len(times_s) + 1))

    def __iter__(self) -> Iterator[BoxFrame]:
        for index, time_s in enumerate(self.times_s.tolist()):
            part = slice(int(self._ends[index]), int(self._ends[index + 1]))
            boxes = self._boxes
            yield BoxFrame(
                index,
                time_s,
                Detections(
                    boxes.xyxy_px[part],
                    boxes.score[part],
                    boxes.class_id[part],
                    self._embedding[part],
                ),
                boxes.user[part],
                boxes.true_m[part],
                self._stereo_m[part],
                self._stereo_sigma_m[part],
                self._shift_px[index],
            )


def _detected(
    scene: Scene,
    true: TrueBoxes,
    rng: np.random.Generator,
    rig: StereoRig,
    frames: tuple[int, float],
) -> tuple[BoxRows, IntArray]:
    """The detections of road users, and their rows in `true`; `frames`: number and time step."""
    n_users = len(scene.road_users)
    at = (true.user, true.frame)
    network = model.NETWORK_WIDTH_PX / rig.left.width_px
    height_px = true.height_px * network
    latent = model.DETECTION_MEMORY.sample(rng, n_users, *frames)[at]
    edges = np.stack(
        [memory.sample(rng, n_users, *frames)[at] for memory in model.EDGE_MEMORY], axis=1
    )
    group = np.array([_group(user.kitti_type) for user in scene.road_users], np.int64)[true.user]
    rate, score = np.zeros((2, len(group)))
    bias, sigma = np.zeros((2, len(group), 4))
    for number, errors in enumerate((model.PERSON, model.VEHICLE, model.SIGN)):
        rows = np.flatnonzero(group == number)
        rate[rows] = _rates(errors, height_px[rows], true.hidden_fraction[rows])
        rate[rows] *= np.interp(true.outside_fraction[rows], model.OUTSIDE, errors.outside_factor)
        score[rows] = np.interp(np.log(height_px[rows]), np.log(model.HEIGHTS_PX), errors.score)
        bias[rows] = errors.bias
        sigma[rows] = np.hypot(errors.sigma, np.array(errors.sigma_px) / height_px[rows, None])
    score += np.interp(true.hidden_fraction, model.HIDDEN, model.HIDDEN_SCORE)
    is_vehicle = group == 1
    for column, extra in zip((0, 2), model.HIDDEN_SIGMA, strict=True):
        sigma[:, column] = np.hypot(
            sigma[:, column], is_vehicle * np.interp(true.hidden_fraction, model.HIDDEN, extra)
        )
    quantile = ndtr(latent)
    rows = np.flatnonzero(quantile > 1 - rate)  # large latent values are detected, with high scores
    within = np.clip((quantile[rows] - 1 + rate[rows]) / rate[rows], 1e-6, 1 - 1e-6)
    median = np.clip(score[rows], 0.02, model.MAX_SCORE)
    scores = np.clip(
        expit(logit(median) + model.SCORE_SIGMA * ndtri(within)), model.MIN_SCORE, model.MAX_SCORE
    )
    moves = bias[rows] + sigma[rows] * edges[rows]
    moves[:, 2:] += (0.25 * np.log1p((model.SMALLEST_HEIGHT_PX / height_px[rows]) ** 4))[:, None]
    boxes = _moved(true.xyxy_px[rows], moves)
    edge = np.array([rig.left.width_px - 1, rig.left.height_px - 1] * 2, np.float64)
    classes = _classes(scene, rng, frames)[at][rows]
    user, distance_m = true.user[rows], true.distance_m[rows]
    first = BoxRows(
        true.frame[rows],
        user,
        user,
        np.clip(boxes, 0, edge),
        scores,
        classes,
        distance_m,
        distance_m,
    )
    return first, rows


def _group(kitti_type: str) -> int:
    return 0 if kitti_type in _PERSONS else 2 if kitti_type in _SIGNS else 1


def _rates(errors: ClassErrors, height_px: FloatArray, hidden: FloatArray) -> FloatArray:
    """(K,) probabilities of detection, interpolated in the table."""
    table = np.array(errors.rate)
    x = np.interp(np.log(height_px), np.log(model.HEIGHTS_PX), np.arange(len(model.HEIGHTS_PX)))
    y = np.interp(hidden, model.HIDDEN, np.arange(len(model.HIDDEN)))
    i, j = (
        np.minimum(x.astype(int), len(model.HEIGHTS_PX) - 2),
        np.minimum(y.astype(int), len(model.HIDDEN) - 2),
    )
    p, q = x - i, y - j
    low = (1 - p) * (1 - q) * table[i, j] + p * (1 - q) * table[i + 1, j]
    return np.asarray(low + (1 - p) * q * table[i, j + 1] + p * q * table[i + 1, j + 1])


def _moved(xyxy_px: FloatArray, errors: FloatArray) -> FloatArray:
    """Boxes with errors of centre x and y, relative to the height, and of log width and log
    height.
    """
    size = xyxy_px[:, 2:] - xyxy_px[:, :2]
    centre = (xyxy_px[:, 2:] + xyxy_px[:, :2]) / 2 + errors[:, :2] * size[:, 1:]
    half = size * np.exp(errors[:, 2:]) / 2
    return np.concatenate([centre - half, centre + half], axis=1)


def _classes(scene: Scene, rng: np.random.Generator, frames: tuple[int, float]) -> IntArray:
    """(N, T) detected classes of all road users."""
    quantile = ndtr(model.CLASS_MEMORY.sample(rng, len(scene.road_users), *frames))
    classes = np.zeros(quantile.shape, np.int64)
    for row, user in enumerate(scene.road_users):
        ids, fractions = zip(*model.DETECTED_CLASS[user.kitti_type], strict=True)
        index = np.searchsorted(np.cumsum(fractions)[:-1], quantile[row])
        classes[row] = np.array(ids)[index]
    return classes


def _seen_m(
    rng: np.random.Generator,
    process: StereoErrors,
    boxes: BoxRows,
    true: TrueBoxes,
    rows: IntArray,
    frames: tuple[int, float],
) -> FloatArray:
    """(K,) distance that stereo measures: the object's, or its occluder's."""
    n_users = int(true.user.max(initial=-1)) + 1
    quantile = ndtr(process.occluder_memory.sample(rng, n_users, *frames)[boxes.user, boxes.frame])
    is_occluder = quantile < np.interp(
        true.hidden_fraction[rows], model.HIDDEN, process.occluder_rate
    )
    is_occluder &= np.isfinite(true.occluder_m[rows])
    return np.where(is_occluder, true.occluder_m[rows], boxes.true_m)


def _embeddings(
    rng: np.random.Generator,
    process: AppearanceErrors,
    objects: IntArray,
    frame: IntArray,
    frames: tuple[int, float],
) -> FloatArray32:
    """(K, 1 + n_values) embeddings of boxes of the given objects (K,) in the given frames (K,)."""
    n_objects = int(objects.max(initial=-1)) + 1
    values = np.ones((len(objects), 1 + process.n_values), np.float32)
    for column in range(process.n_values):
        mean = process.object_sigma * rng.normal(size=n_objects)
        errors = process.sigma * process.memory.sample(rng, n_objects, *frames)
        values[:, 1 + column] = mean[objects] + errors[objects, frame]
    return np.asarray(values / np.linalg.norm(values, axis=1, keepdims=True))


def _stereo(
    rng: np.random.Generator,
    process: StereoErrors,
    rig: StereoRig,
    boxes: tuple[IntArray, IntArray, FloatArray],
    frames: tuple[int, float],
) -> tuple[FloatArray, FloatArray]:
    """Measured distances and their reported standard deviations; `boxes`: frame, object,
    distance.
    """
    frame, key, true_m = boxes
    n = len(frame)
    error = process.memory.sample(rng, int(key.max(initial=-1)) + 1, *frames)[key, frame]
    near = process.far_sigma_px * np.maximum(process.near_m / true_m, 1.0) ** 2
    sigma_px = (
        near * rig.left.width_px / _FIT_WIDTH_PX * np.exp(process.sigma_spread * rng.normal(size=n))
    )
    scale = np.where(
        rng.uniform(size=n) < process.outlier_rate, process.outlier_scale, process.scale
    )
    base = rig.left.fx_px * rig.baseline_m
    disparity_px = base / true_m + (process.bias + error * scale) * sigma_px
    is_matched = (rng.uniform(size=n) < process.rate) & (disparity_px > 0.5)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance_m = np.where(is_matched, base / disparity_px, np.nan)
    return distance_m, distance_m**2 / base * sigma_px
