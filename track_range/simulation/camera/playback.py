"""Simulated detections: labelled boxes with the errors of a plausible detector.

The probability that a box is detected depends on its height and occlusion; objects are also missed
in runs of two or three frames. Box edges have Gaussian errors, scores depend on height and
occlusion, and there are false detections. No network is involved: the detections exercise the rest
of the program, and are no measure of detection accuracy.
"""

from dataclasses import dataclass

import numpy as np

from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.simulation.world.truth import joined

DETECTED_TYPES = {  # detected type of each KITTI type; other types are not detected
    **{name: name for name in ("Car", "Truck", "Bus", "Pedestrian", "Cyclist", "Motorcycle")},
    "Van": "Car",
}
HIDDEN = 2  # minimum value of KITTI's `occluded` of objects that are not detected
# mean width and height of false detections by type
FALSE_SIZES_PX = {"Car": (60.0, 40.0), "Pedestrian": (22.0, 60.0)}
SCORE_FROM, SCORE_TO = 0.3, 0.95  # range of scores


@dataclass(frozen=True, slots=True, kw_only=True)
class Flaws:
    """Error model of the simulated detector."""

    edge_fraction: float = 0.015  # standard deviation of box edges relative to the box height
    edge_min_px: float = 0.7  # limits of this standard deviation
    edge_max_px: float = 2.0
    miss: float = 0.02  # probability that a large, fully visible object is missed in a frame
    # additional probability for a box 10 px high, falling linearly to 0 at 40 px
    miss_small: float = 0.25
    miss_partly_hidden: float = 0.12  # additional probability for KITTI's occluded = 1
    run: float = 0.01  # probability per object and frame that a run of 2 or 3 missed frames starts
    false_per_frame: float = 0.1  # mean number of false detections per frame


def play_back(
    truth: KittiLabels, *, seed: int, image_size_px: tuple[int, int], flaws: Flaws | None = None
) -> KittiLabels:
    """Simulated detections for labels with each object at most once per frame; the same seed gives
    the same detections.

    They are sorted by frame, without ids (-1) and 3-D boxes; boxes are clipped to pixel centres of
    an image of `image_size_px` (width, height).
    """
    flaws = flaws or Flaws()
    rng = np.random.default_rng([seed, 5])
    n_frames = int(truth.frame.max()) + 1 if len(truth) else 0
    truth = truth.select(_is_detected(truth, rng, flaws))
    height_px = truth.xyxy_px[:, 3] - truth.xyxy_px[:, 1]
    sigma_px = np.clip(flaws.edge_fraction * height_px, flaws.edge_min_px, flaws.edge_max_px)
    boxes = truth.xyxy_px + rng.normal(size=(len(truth), 4)) * sigma_px[:, None]
    score_loss = 0.25 * _smallness(height_px) + 0.15 * (truth.occluded > 0)
    score = 0.88 - score_loss + rng.normal(0, 0.06, len(truth))
    types = np.array([DETECTED_TYPES[name] for name in truth.kitti_type.tolist()], np.str_)
    true = _as_detections(truth.frame, types, boxes, score=score, image_size_px=image_size_px)
    false = _false_boxes(rng, flaws, n_frames=n_frames, image_size_px=image_size_px)
    both = joined([true, false])
    return both.select(np.argsort(both.frame, kind="stable"))


def _is_detected(truth: KittiLabels, rng: np.random.Generator, flaws: Flaws) -> BoolArray:
    height_px = truth.xyxy_px[:, 3] - truth.xyxy_px[:, 1]
    miss = (
        flaws.miss
        + flaws.miss_small * _smallness(height_px)
        + flaws.miss_partly_hidden * (truth.occluded == 1)
    )
    is_missed = rng.uniform(size=len(truth)) < miss
    starts_run = rng.uniform(size=len(truth)) < flaws.run
    run_length = rng.integers(2, 4, len(truth))
    # unique per object and frame
    key = truth.track_id * (int(truth.frame.max(initial=0)) + 4) + truth.frame
    for offset in range(3):
        is_missed |= np.isin(key - offset, key[starts_run & (run_length > offset)])
    is_known = np.isin(truth.kitti_type, list(DETECTED_TYPES))
    return np.asarray(is_known & (truth.occluded < HIDDEN) & ~is_missed)


def _smallness(height_px: FloatArray) -> FloatArray:
    """(N,) 1 for boxes up to 10 px high, falling linearly to 0 at 40 px."""
    return np.clip((40.0 - height_px) / 30.0, 0.0, 1.0)


def _false_boxes(
    rng: np.random.Generator, flaws: Flaws, *, n_frames: int, image_size_px: tuple[int, int]
) -> KittiLabels:
    n_in_frame = rng.poisson(flaws.false_per_frame, n_frames)
    frame = np.repeat(np.arange(n_frames, dtype=np.int64), n_in_frame)
    types = rng.choice(list(FALSE_SIZES_PX), len(frame)).astype(np.str_)
    mean_px = np.array([FALSE_SIZES_PX[name] for name in types.tolist()], np.float64).reshape(-1, 2)
    size_px = mean_px * rng.uniform(0.6, 1.6, (len(frame), 1))
    width_px, height_px = image_size_px
    middle_px = rng.uniform(
        (0.05 * width_px, 0.4 * height_px), (0.95 * width_px, 0.75 * height_px), (len(frame), 2)
    )
    boxes = np.concatenate([middle_px - size_px / 2, middle_px + size_px / 2], axis=1)
    return _as_detections(
        frame,
        types,
        boxes,
        score=rng.uniform(SCORE_FROM, 0.55, len(frame)),
        image_size_px=image_size_px,
    )


def _as_detections(
    frame: IntArray,
    types: np.ndarray,
    xyxy_px: FloatArray,
    *,
    score: FloatArray,
    image_size_px: tuple[int, int],
) -> KittiLabels:
    """KITTI detections: boxes clipped to the image, at least 1 px wide and high; all other columns
    unknown.
    """
    n = len(frame)
    edge = np.array(image_size_px, np.float64) - 1
    upper_left = np.clip(xyxy_px[:, :2], 0, edge - 1)
    lower_right = np.clip(np.maximum(xyxy_px[:, 2:], upper_left + 1), 0, edge)
    return KittiLabels(
        frame=frame,
        track_id=np.full(n, -1, np.int64),
        kitti_type=types,
        truncated=np.full(n, -1.0),
        occluded=np.full(n, -1, np.int64),
        xyxy_px=np.concatenate([upper_left, lower_right], axis=1),
        size_hwl_m=np.full((n, 3), -1.0),
        location_m=np.full((n, 3), -1000.0),
        rotation_y_rad=np.full(n, -10.0),
        score=np.clip(score, SCORE_FROM, SCORE_TO),
    )
