"""MeasuredMotion: closing speeds, times to collision, speeds over ground and alarms, from boxes as in a run.

Methods measure each frame's boxes; the stage of a run fuses and filters them, and the collision warning follows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from track_range.evaluation.motion.labelled_motion import LabelledMotion
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.errors import UsageError
from track_range.pipeline.stages import FusionStage
from track_range.ranging.evaluation.box_methods import MethodOptions, as_frames, box_methods, measured_by
from track_range.ranging.evaluation.errors import MethodColumn
from track_range.ranging.filtering.distance_filter import FilteredRanges
from track_range.ranging.filtering.lateral_motion import LateralMotion
from track_range.ranging.ranges import Ranges
from track_range.ranging.warning.collision_warning import CollisionWarning
from track_range.stereo.odometry.ego_motion import EgoMotion

EGO_SIGMA_MPS = 0.05  # standard deviation of the ego speed, that of a wheel sensor


@dataclass(frozen=True, slots=True)
class MeasuredMotion:
    """Motion of N boxes as a run reports it; NaN = not measured."""

    distance_m: FloatArray
    closing_mps: FloatArray
    closing_sigma_mps: FloatArray
    ttc_s: FloatArray
    speed_mps: FloatArray  # over ground
    speed_sigma_mps: FloatArray
    path_offset_m: FloatArray  # offset from the middle of the ego path, positive = right
    is_alarm: BoolArray


def measured_motion(
    motion: LabelledMotion, method: str, options: MethodOptions | None = None, *, is_ego_known: bool = True
) -> MeasuredMotion:
    """Motion of the boxes by a method, or by the fusion of several (`mono+ground`); UsageError: an unknown one."""
    names, known = method.split("+"), [listed.name for listed in box_methods()]
    if not set(names) <= set(known):
        raise UsageError(f"--method {method}: expected {' or '.join(known)}, or several of them with + between them.")
    boxes = motion.boxes
    columns = measured_by(names, boxes, boxes, options)
    distance_m, closing_mps, sigma_mps, ttc_s, speed_mps, speed_sigma_mps, offset_m = np.full((7, len(boxes)), np.nan)
    is_alarm = np.zeros(len(boxes), np.bool_)
    for rows, tracks, frame, is_first in as_frames(boxes, boxes.class_id):
        if is_first:
            stage, warning = FusionStage(boxes.camera_at(rows[0])), CollisionWarning()
        ego = EgoMotion()
        if is_ego_known:
            ego = EgoMotion(float(motion.ego_mps[rows[0]]), EGO_SIGMA_MPS, float(motion.yaw_rad_s[rows[0]]))
        ranges = {name: _ranges(column, rows, tracks.track_id) for name, column in columns.items()}
        state, lateral = stage.update(frame, tracks, ranges, ego)
        alarm = warning.update(tracks, state, lateral, frame.time_s, ego_mps=ego.speed_mps, yaw_rad_s=ego.yaw_rad_s)
        distance_m[rows], ttc_s[rows] = state.ranges.distance_m, state.ttc_s
        closing_mps[rows], sigma_mps[rows] = -state.rate_mps, state.rate_sigma_mps
        speed_mps[rows], speed_sigma_mps[rows] = _ground_speed(state, lateral, ego)
        offset_m[rows], is_alarm[rows] = alarm.path_offset_m, alarm.active
    return MeasuredMotion(distance_m, closing_mps, sigma_mps, ttc_s, speed_mps, speed_sigma_mps, offset_m, is_alarm)


def _ranges(column: MethodColumn, rows: IntArray, track_id: IntArray) -> Ranges:
    systematic_m = None if column.sigma_systematic_m is None else column.sigma_systematic_m[rows]
    return Ranges(track_id, column.distance_m[rows], column.sigma_m[rows], systematic_m)


def _ground_speed(state: FilteredRanges, lateral: LateralMotion, ego: EgoMotion) -> tuple[FloatArray, FloatArray]:
    """(N,) speeds over ground of the tracks and their standard deviations, where the closing speed is known.

    The speeds along the axes of the camera are z' + V - w x and u, which does not contain the yaw rate w.
    """
    w = 0.0 if math.isnan(ego.yaw_rad_s) else ego.yaw_rad_s
    along_mps, across_mps = state.rate_mps + ego.speed_mps - w * lateral.state.x, lateral.state.v
    speed_mps = np.hypot(along_mps, across_mps)
    variances = state.rate_sigma_mps**2 + ego.speed_sigma_mps**2, lateral.state.P_vv
    # to first order along the direction of motion; near zero, where it is unknown, both components count
    weights = (np.stack([along_mps, across_mps]) ** 2 + np.stack(variances)) / (speed_mps**2 + sum(variances))
    return speed_mps, np.sqrt((weights * np.stack(variances)).sum(axis=0))
