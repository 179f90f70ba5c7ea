"""BoxDrive: a drive without images: boxes as the packaged detector finds them, and stereo distances, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from track_range.detection.detections import Detections
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.simulation.boxes.error_model import (
    CLASS_MEMORY,
    DETECTED_CLASS,
    DETECTION_MEMORY,
    EDGE_MEMORY,
    HEIGHTS_PX,
    HIDDEN,
    HIDDEN_SCORE,
    MAX_SCORE,
    MIN_SCORE,
    NETWORK_WIDTH_PX,
    OUTSIDE,
    PERSON,
    SCORE_SIGMA,
    SIGN,
    VEHICLE,
    ClassErrors,
    FalseBoxes,
    StereoErrors,
)
from track_range.simulation.boxes.true_boxes import TrueBoxes, true_boxes
from track_range.simulation.world.scene import Scene
from track_range.simulation.world.trajectories import ego_z_m
from track_range.stereo.geometry.rig import StereoRig

_PERSONS = ("Pedestrian", "Cyclist", "Motorcycle")
_SIGNS = ("TrafficSign", "TrafficLight")
_FIT_WIDTH_PX = 620.0
_PHANTOM_HEIGHT_M = {0: 1.7, 2: 1.5, 5: 3.0, 6: 0.9}
"""Height by class id from which the distance of a phantom follows, m."""


@dataclass(frozen=True, slots=True)
class BoxFrame:
    """The boxes of one frame with what stereo would measure of each.

    Attributes:
        index: number of the frame.
        time_s: its time.
        detections: K boxes.
        user: (K,) row of the scene's road users; -1 = a false box.
        true_m: (K,) distance; that of a false box is the distance of the scenery there.
        stereo_m, stereo_sigma_m: (K,) measured distance and reported standard deviation; NaN = no match.
    """

    index: int
    time_s: float
    detections: Detections
    user: IntArray
    true_m: FloatArray
    stereo_m: FloatArray
    stereo_sigma_m: FloatArray


class BoxDrive:
    """The frames of a scene; the same scene and seed give the same frames."""

    def __init__(
        self,
        scene: Scene,
        times_s: FloatArray,
        rig: StereoRig,
        *,
        seed: int,
        false_boxes: FalseBoxes | None = None,
        stereo: StereoErrors | None = None,
    ) -> None:
        """Compute all frames.

        Args:
            scene: the scene.
            times_s: (T,) times of the frames, at equal steps.
            rig: the rectified pair.
            seed: random seed of the errors.
            false_boxes: model of boxes without an object; None = the fitted one.
            stereo: error model of stereo; None = the fitted one.
        """
        rng = np.random.default_rng([seed, 31])
        self.scene, self.times_s, self.rig = scene, times_s, rig
        self.true = true_boxes(scene, times_s, rig.left)
        step_s = float(times_s[1] - times_s[0])
        real = _detected(scene, self.true, rng, rig, (len(times_s), step_s))
        false = _phantoms(scene, times_s, rig, rng, false_boxes or FalseBoxes(), step_s)
        rows = [np.concatenate(columns) for columns in zip(real, false, strict=True)]
        order = np.argsort(rows[0], kind="stable")
        self._frame, self._user, self._xyxy_px, self._score, self._class_id, self._true_m = (row[order] for row in rows)
        keys = np.unique(self._user, return_inverse=True)[1]
        self._stereo_m, self._stereo_sigma_m = _stereo(
            rng, stereo or StereoErrors(), rig, (self._frame, keys, self._true_m), (len(times_s), step_s)
        )
        self._ends = np.searchsorted(self._frame, np.arange(len(times_s) + 1))

    def __iter__(self) -> Iterator[BoxFrame]:
        """The frames in order."""
        for index, time_s in enumerate(self.times_s.tolist()):
            part = slice(int(self._ends[index]), int(self._ends[index + 1]))
            yield BoxFrame(
                index,
                time_s,
                Detections.of(self._xyxy_px[part], self._score[part], self._class_id[part]),
                np.where(self._user[part] >= 0, self._user[part], -1),
                self._true_m[part],
                self._stereo_m[part],
                self._stereo_sigma_m[part],
            )


Rows = tuple[IntArray, IntArray, FloatArray, FloatArray, IntArray, FloatArray]
"""Frame, road user (negative: number of a phantom), box, score, class, distance."""


def _detected(
    scene: Scene, true: TrueBoxes, rng: np.random.Generator, rig: StereoRig, frames: tuple[int, float]
) -> Rows:
    """The detections of road users; `frames`: number and time step."""
    n_users = len(scene.road_users)
    at = (true.user, true.frame)
    network = NETWORK_WIDTH_PX / rig.left.width_px
    height_px = true.height_px * network
    latent = DETECTION_MEMORY.sample(rng, n_users, *frames)[at]
    edges = np.stack([memory.sample(rng, n_users, *frames)[at] for memory in EDGE_MEMORY], axis=1)
    group = np.array([_group(user.kitti_type) for user in scene.road_users], np.int64)[true.user]
    rate, score, bias, sigma = (
        np.zeros(len(at[0])),
        np.zeros(len(at[0])),
        np.zeros((len(at[0]), 4)),
        np.zeros((len(at[0]), 4)),
    )
    for number, errors in enumerate((PERSON, VEHICLE, SIGN)):
        rows = np.flatnonzero(group == number)
        rate[rows] = _rates(errors, height_px[rows], true.hidden_share[rows])
        rate[rows] *= np.interp(true.outside_share[rows], OUTSIDE, errors.outside_factor)
        score[rows] = np.interp(np.log(height_px[rows]), np.log(HEIGHTS_PX), errors.score)
        bias[rows] = errors.bias
        sigma[rows] = np.hypot(errors.sigma, np.array(errors.sigma_px) / height_px[rows, None])
    score += np.interp(true.hidden_share, HIDDEN, HIDDEN_SCORE)
    quantile = ndtr(latent)
    rows = np.flatnonzero(quantile > 1 - rate)  # large latent values are detected, with high scores
    within = np.clip((quantile[rows] - 1 + rate[rows]) / rate[rows], 1e-6, 1 - 1e-6)
    scores = np.clip(score[rows] + SCORE_SIGMA * ndtri(within), MIN_SCORE, MAX_SCORE)
    boxes = _moved(true.xyxy_px[rows], bias[rows] + sigma[rows] * edges[rows])
    edge = np.array([rig.left.width_px - 1, rig.left.height_px - 1] * 2, np.float64)
    classes = _classes(scene, rng, frames)[at][rows]
    return true.frame[rows], true.user[rows], np.clip(boxes, 0, edge), scores, classes, true.distance_m[rows]


def _group(kitti_type: str) -> int:
    return 0 if kitti_type in _PERSONS else 2 if kitti_type in _SIGNS else 1


def _rates(errors: ClassErrors, height_px: FloatArray, hidden: FloatArray) -> FloatArray:
    """(K,) probabilities of detection, interpolated in the table."""
    table = np.array(errors.rate)
    x = np.interp(np.log(height_px), np.log(HEIGHTS_PX), np.arange(len(HEIGHTS_PX)))
    y = np.interp(hidden, HIDDEN, np.arange(len(HIDDEN)))
    low_x, low_y = np.minimum(x.astype(int), len(HEIGHTS_PX) - 2), np.minimum(y.astype(int), len(HIDDEN) - 2)
    share_x, share_y = x - low_x, y - low_y
    return np.asarray(
        (1 - share_x) * (1 - share_y) * table[low_x, low_y]
        + share_x * (1 - share_y) * table[low_x + 1, low_y]
        + (1 - share_x) * share_y * table[low_x, low_y + 1]
        + share_x * share_y * table[low_x + 1, low_y + 1]
    )


def _moved(xyxy_px: FloatArray, errors: FloatArray) -> FloatArray:
    """Boxes with errors of centre x and y, relative to the height, and of log width and log height."""
    size = xyxy_px[:, 2:] - xyxy_px[:, :2]
    centre = (xyxy_px[:, 2:] + xyxy_px[:, :2]) / 2 + errors[:, :2] * size[:, 1:]
    half = size * np.exp(errors[:, 2:]) / 2
    return np.concatenate([centre - half, centre + half], axis=1)


def _classes(scene: Scene, rng: np.random.Generator, frames: tuple[int, float]) -> IntArray:
    """(N, T) detected classes of all road users."""
    quantile = ndtr(CLASS_MEMORY.sample(rng, len(scene.road_users), *frames))
    classes = np.zeros(quantile.shape, np.int64)
    for row, user in enumerate(scene.road_users):
        ids, shares = zip(*DETECTED_CLASS[user.kitti_type], strict=True)
        index = np.searchsorted(np.cumsum(shares)[:-1], quantile[row])
        classes[row] = np.array(ids)[index]
    return classes


def _phantoms(
    scene: Scene,
    times_s: FloatArray,
    rig: StereoRig,
    rng: np.random.Generator,
    model: FalseBoxes,
    step_s: float,
) -> Rows:
    """The boxes without an object; each phantom has a negative number."""
    n_frames, camera = len(times_s), rig.left
    network = NETWORK_WIDTH_PX / camera.width_px
    n = rng.poisson(model.starts_hz * step_s * n_frames)
    start = rng.integers(0, n_frames, n)
    shares, means = np.array(model.mean_frames).T
    kind = rng.choice(len(shares), n, p=shares / shares.sum())
    length = np.maximum(np.rint(rng.geometric(1 / means[kind]) * 0.1 / step_s), 1).astype(np.int64)
    score = MIN_SCORE + np.array(model.mean_score)[kind] * rng.exponential(size=n)
    ids, class_shares, height, spread, centre, width = np.array(model.classes).T
    chosen = rng.choice(len(ids), n, p=class_shares / class_shares.sum())
    height_px = height[chosen] * np.exp(spread[chosen] * rng.normal(size=n)) / network
    side = np.where(centre[chosen] < 0, np.where(rng.uniform(size=n) < 0.5, 1, -1), 0)
    share = np.where(side == 0, centre[chosen], 0.5 + side * np.abs(centre[chosen])) + width[chosen] * rng.normal(
        size=n
    )
    class_id = ids[chosen].astype(np.int64)
    tall_m = np.array([_PHANTOM_HEIGHT_M[int(number)] for number in class_id.tolist()])
    z_m = camera.fy_px * tall_m / height_px
    x_m = (share * camera.width_px - camera.cx_px) / camera.fx_px * z_m
    speed = np.where(rng.uniform(size=n) < model.moving_share, rng.uniform(0, 1, n), 0.0)
    frame, number = _frames_of(start, length, n_frames)
    ego_m = ego_z_m(scene, times_s)
    z = z_m[number] - (1 - speed[number]) * (ego_m[frame] - ego_m[start[number]])
    is_ahead = z > 3.0
    frame, number, z = frame[is_ahead], number[is_ahead], z[is_ahead]
    scale = camera.fx_px / z
    bottom = camera.cy_px + scale * scene.camera_height_m
    middle = camera.cx_px + scale * x_m[number]
    high = scale * tall_m[number] * np.exp(0.06 * rng.normal(size=len(z)))
    wide = high * np.where(class_id[number] == 0, 0.4, np.where(class_id[number] == 6, 0.4, 1.2))
    boxes = np.stack([middle - wide / 2, bottom - high, middle + wide / 2, bottom], axis=1)
    edge = np.array([camera.width_px - 1, camera.height_px - 1] * 2, np.float64)
    clipped = np.clip(boxes, 0, edge)
    area = np.prod(clipped[:, 2:] - clipped[:, :2], axis=1)
    rows = np.flatnonzero(area > 0.5 * wide * high)
    scores = np.clip(score[number] + 0.03 * rng.normal(size=len(number)), MIN_SCORE, MAX_SCORE)
    return frame[rows], -1 - number[rows], clipped[rows], scores[rows], class_id[number[rows]], z[rows]


def _frames_of(start: IntArray, length: IntArray, n_frames: int) -> tuple[IntArray, IntArray]:
    """The frames of all phantoms, and the number of the phantom in each."""
    number = np.repeat(np.arange(len(start)), length)
    first = np.repeat(np.cumsum(length) - length, length)
    frame = start[number] + np.arange(len(number)) - first
    is_inside: BoolArray = frame < n_frames
    return frame[is_inside], number[is_inside]


def _stereo(
    rng: np.random.Generator,
    model: StereoErrors,
    rig: StereoRig,
    boxes: tuple[IntArray, IntArray, FloatArray],
    frames: tuple[int, float],
) -> tuple[FloatArray, FloatArray]:
    """Measured distances and their reported standard deviations; `boxes`: frame, object, distance."""
    frame, key, true_m = boxes
    n = len(frame)
    error = model.memory.sample(rng, int(key.max(initial=-1)) + 1, *frames)[key, frame]
    near = model.far_sigma_px * np.maximum(model.near_m / true_m, 1.0) ** 2
    sigma_px = near * rig.left.width_px / _FIT_WIDTH_PX * np.exp(model.sigma_spread * rng.normal(size=n))
    scale = np.where(rng.uniform(size=n) < model.outlier_rate, model.outlier_scale, model.scale)
    base = rig.left.fx_px * rig.baseline_m
    disparity_px = base / true_m + (model.bias + error * scale) * sigma_px
    is_matched = (rng.uniform(size=n) < model.rate) & (disparity_px > 0.5)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance_m = np.where(is_matched, base / disparity_px, np.nan)
    return distance_m, distance_m**2 / base * sigma_px
