"""LabelledMotion: boxes with the true motion of their objects, and its reader for KITTI's labels
with poses.

    closing speed   -dz/dt          z: depth of the object's centre in the frame of the camera
    speed           |dX/dt|         X: position (x, z) of the bottom centre in the frame of the first camera
    derivatives     slope of the straight line fitted by least squares to the labels within +-0.5 s, if at least 0.3 s
                    before and after are labelled

The labels of a track before and after are used whether they are visible or not, since KITTI's 3-D
boxes are from lidar.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.files.input_files import read_text
from track_range.ranging.truth.frame_times import TimeSource
from track_range.ranging.truth.labelled_boxes import (
    BoxSelection,
    BoxSet,
    box_set,
    file_in,
    times_of,
)
from track_range.stereo.geometry.mounting import Mounting, looks_ahead

_HALF_SPAN_S = 0.5  # s before and after a label over which its true motion is a straight line
_MIN_SIDE_S = 0.3  # shortest labelled time before and after a label whose motion is known
_EGO_HALF_SPAN_S = 0.2  # the same for the ego speed, as of a wheel sensor
_TRAVEL_MPS = 0.1  # smallest mean speed of a camera whose direction of travel is known


@dataclass(frozen=True, slots=True)
class LabelledMotion:
    """N boxes with the true motion of their objects and of the camera."""

    boxes: BoxSet
    closing_mps: FloatArray  # (N,) true closing speed; NaN = unknown
    speed_mps: FloatArray  # (N,) true speed over ground; NaN = unknown
    # (N,) true direction of the motion, counterclockwise from the camera's axis; NaN = unknown
    heading_rad: FloatArray
    ego_mps: FloatArray  # (N,) speed of the camera along its axis
    right_mps: FloatArray  # (N,) its speed to the right of the axis
    yaw_rad_s: FloatArray  # (N,) its yaw rate, positive = to the right
    duration_s: FloatArray  # (S,) of each sequence
    protocol: str  # description of the truth

    @property
    def ttc_s(self) -> FloatArray:
        """(N,) true time to collision, distance / closing speed, negative for objects that draw
        away; NaN = unknown, or of a camera that does not look along the drive, which has none.
        """
        is_ahead = self.are_ahead[self.boxes.sequence]
        is_moving = is_ahead & (np.abs(self.closing_mps) > 1e-3)
        return np.where(
            is_moving, self.boxes.distance_m / np.where(is_moving, self.closing_mps, 1.0), np.nan
        )

    @property
    def are_ahead(self) -> BoolArray:
        """(S,) whether the camera of each sequence looks along the drive."""
        return np.array([looks_ahead(self.mounting(s)) for s in range(len(self.duration_s))])

    @property
    def axis_rad(self) -> FloatArray:
        """(S,) direction of the camera's axis from that of the drive, positive = to the left; 0 =
        unknown.
        """
        mountings = map(self.mounting, range(len(self.duration_s)))
        return np.radians([0.0 if one is None else one.yaw_deg for one in mountings])

    def mounting(self, sequence: int) -> Mounting | None:
        """Where the camera of a sequence looks, from the way that it moves, which is that of a
        vehicle that drives forward in the mean; None = it hardly moves.
        """
        rows = self.boxes.sequence == sequence
        of_rows = np.nan_to_num([self.right_mps[rows], self.ego_mps[rows]])
        right_mps, forward_mps = of_rows.sum(axis=1) / max(rows.sum(), 1)
        if math.hypot(right_mps, forward_mps) < _TRAVEL_MPS:
            return None
        return Mounting(yaw_deg=math.degrees(math.atan2(right_mps, forward_mps)))


def kitti_motion(
    labels: Path,
    calib: Path,
    poses: Path,
    *,
    boxes: str = "labels",
    noise_px: float = 0.0,
    seed: int = 0,
    times: TimeSource | None = None,
) -> LabelledMotion:
    """Boxes of KITTI tracking labels with their true motion; for the arguments see `box_set`.

    Raises LabelFileError: labels, poses or detections cannot be read, or a label has no pose;
    RigError: a calibration cannot be read.
    """
    selection = BoxSelection(has_all_objects=True, reference="centre", times=times)
    every = box_set(labels, calib, selection=selection).with_reference()
    selection = BoxSelection(times=times)
    measured = box_set(
        labels, calib, boxes=boxes, noise_px=noise_px, seed=seed, selection=selection
    )
    camera = np.full((len(measured), 4), np.nan)
    position_m = np.full((len(every), 2), np.nan)
    duration_s = np.zeros(len(every.sequence_names))
    for number, name in enumerate(every.sequence_names):
        pose = read_poses(file_in(poses, f"{name}.txt"))
        rows = every.sequence == number
        if rows.any() and every.frame[rows].max() >= len(pose):
            raise LabelFileError(
                f"{file_in(poses, name + '.txt')}: expected a pose for each labelled frame, up to frame "
                f"{every.frame[rows].max()}, found {len(pose)} poses."
            )
        camera_m = np.stack([every.x_m[rows], np.zeros(rows.sum()), every.distance_m[rows]], axis=1)
        pose_of = pose[every.frame[rows]]
        position_m[rows] = (
            np.einsum("nij,nj->ni", pose_of[:, :, :3], camera_m) + pose_of[:, :, 3]
        )[:, ::2]
        clock = times_of(file_in(labels, f"{name}.txt"), calib, times)
        time_s = clock.at(np.arange(len(pose)))
        duration_s[number] = time_s[-1] + clock.step_s
        rows = measured.sequence == number
        camera[rows] = camera_motion(pose, time_s)[measured.frame[rows]]

    # Truth of all labels of a track, then that of the measured boxes.
    values = np.column_stack([every.distance_m, position_m])
    slopes = track_slopes(np.stack([every.sequence, every.track_id]), every.time_s, values)
    row_of = {key: row for row, key in enumerate(_keys(every))}
    index = np.array([row_of[key] for key in _keys(measured)], np.int64)
    right_mps, forward_mps = slopes[index, 1:].T
    return LabelledMotion(
        boxes=measured,
        closing_mps=-slopes[index, 0],
        speed_mps=np.hypot(right_mps, forward_mps),
        heading_rad=camera[:, 3] - np.arctan2(right_mps, forward_mps),
        ego_mps=camera[:, 0],
        right_mps=camera[:, 1],
        yaw_rad_s=camera[:, 2],
        duration_s=duration_s,
        protocol="slopes over +-0.5 s of the depth of the label's centre, and of its position by "
        "the poses",
    )


def _keys(boxes: BoxSet) -> list[tuple[int, int, int]]:
    return list(
        zip(boxes.sequence.tolist(), boxes.track_id.tolist(), boxes.frame.tolist(), strict=True)
    )


def read_poses(path: Path) -> FloatArray:
    """(N, 3, 4) poses of KITTI's odometry format; LabelFileError if the file cannot be read."""
    lines = read_text(path, LabelFileError, "poses of 12 numbers per frame").splitlines()
    try:
        values = np.array([line.split() for line in lines], np.float64).reshape(len(lines), 12)
    except ValueError as error:
        raise LabelFileError(
            f"{path}: expected 12 numbers in each row, the 3 x 4 pose of a frame."
        ) from error
    if not len(values) or not np.isfinite(values).all():
        raise LabelFileError(
            f"{path}: expected a row of 12 finite numbers per frame, found other content."
        )
    return values.reshape(-1, 3, 4)


def camera_motion(pose: FloatArray, time_s: FloatArray) -> FloatArray:
    """(N, 4) speeds along the camera's axis and to the right of it, yaw rates and directions of the
    axis (positive = to the right), from (N, 3, 4) poses at the times (N,).
    """
    n, axis = len(pose), pose[:, :, 2]
    heading_rad = np.unwrap(np.arctan2(axis[:, 0], axis[:, 2]))
    values = np.column_stack([pose[:, :, 3], heading_rad])
    slopes = track_slopes(
        np.zeros((1, n), np.int64), time_s, values, half_span_s=_EGO_HALF_SPAN_S, min_side_s=0.0
    )
    speed_mps = (slopes[:, :3] * axis).sum(axis=1)
    right_mps = (slopes[:, :3] * pose[:, :, 0]).sum(axis=1)
    return np.column_stack([speed_mps, right_mps, slopes[:, 3], heading_rad])


def track_slopes(
    key: IntArray,
    time_s: FloatArray,
    values: FloatArray,
    *,
    half_span_s: float = _HALF_SPAN_S,
    min_side_s: float = _MIN_SIDE_S,
) -> FloatArray:
    """(N, V) slopes per second of the values (N, V) of each track, by straight lines within the
    half span.

    `key` (K, N) identifies tracks. NaN where less than `min_side_s` before or after is labelled, or
    for a single label.
    """
    slopes = np.full(values.shape, np.nan)
    order = np.lexsort((time_s, *key))
    starts = np.flatnonzero(np.any(np.diff(key[:, order], axis=1, prepend=-1) != 0, axis=0))
    for rows in np.split(order, starts[1:]):
        t, x = time_s[rows], values[rows]
        dt = t[None, :] - t[:, None]  # from each row to each other one
        near = np.abs(dt) <= half_span_s + 0.02
        n = near.sum(axis=1)
        mean_s = np.where(near, dt, 0.0).sum(axis=1) / n
        weight = np.where(near, dt - mean_s[:, None], 0.0)
        spread = (weight * dt).sum(axis=1)
        known = (n > 1) & (np.where(near, dt, 0.0).max(axis=1) >= min_side_s - 0.02)
        known &= np.where(near, -dt, 0.0).max(axis=1) >= min_side_s - 0.02
        slopes[rows] = np.where(
            known[:, None], weight @ x / np.where(known, spread, 1.0)[:, None], np.nan
        )
    return slopes
