"""MeasuredMotion: closing speeds, times to collision, speeds over ground and alarms, from boxes as in a run.

Methods measure each frame's boxes; the stage of a run fuses and filters them, and the collision warning follows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from track_range.evaluation.motion.labelled_motion import LabelledMotion
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.foundation.errors import UsageError
from track_range.pipeline.stages import FusionStage
from track_range.ranging.evaluation.box_methods import MethodOptions, as_frames, box_methods, measured_by
from track_range.ranging.evaluation.errors import MethodColumn
from track_range.ranging.filtering.distance_filter import FilteredRanges, time_to_collision
from track_range.ranging.filtering.look_ahead import combined
from track_range.ranging.ranges import Ranges
from track_range.ranging.warning.collision_warning import CollisionWarning
from track_range.ranging.world.object_motion import over_ground
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
    motion: LabelledMotion,
    method: str,
    options: MethodOptions | None = None,
    *,
    is_ego_known: bool = True,
    look_ahead: bool = False,
) -> MeasuredMotion:
    """Motion of the boxes by a method, or by the fusion of several (`mono+ground`); UsageError: an unknown one.

    With `look_ahead`, closing speeds and times to collision use all frames of a sequence, others the frames so far.
    """
    names, known = method.split("+"), [listed.name for listed in box_methods()]
    if not set(names) <= set(known):
        raise UsageError(f"--method {method}: expected {' or '.join(known)}, or several of them with + between them.")
    boxes = motion.boxes
    columns = measured_by(names, boxes, boxes, options)
    distance_m, closing_mps, sigma_mps, ttc_s, speed_mps, speed_sigma_mps, offset_m = np.full((7, len(boxes)), np.nan)
    is_alarm = np.zeros(len(boxes), np.bool_)
    states = np.full((6, len(boxes)), np.nan)
    if not is_ego_known:
        motion = replace(motion, ego_mps=distance_m.copy(), yaw_rad_s=distance_m.copy())  # NaN
    for rows, tracks, frame, is_first in as_frames(boxes, boxes.class_id):
        if is_first:
            stage, warning = FusionStage(boxes.camera_at(rows[0])), CollisionWarning()
        ego = _ego(motion, rows[0])
        ranges = {name: _ranges(column, rows, tracks.track_id) for name, column in columns.items()}
        state, lateral = stage.update(frame, tracks, ranges, ego)
        alarm = warning.update(tracks, state, lateral, frame.time_s, ego_mps=ego.speed_mps, yaw_rad_s=ego.yaw_rad_s)
        distance_m[rows], ttc_s[rows] = state.ranges.distance_m, state.ttc_s
        closing_mps[rows], sigma_mps[rows] = -state.rate_mps, state.rate_sigma_mps
        ground = over_ground(state, lateral, tracks.class_id, ego)
        speed_mps[rows], speed_sigma_mps[rows] = ground.speed_mps, ground.sigma_mps
        offset_m[rows], is_alarm[rows] = alarm.path_offset_m, alarm.active
        states[:, rows] = _state(state)
    if look_ahead:
        rate_mps, sigma_mps, ttc_s = _with_look_ahead(motion, columns, states)
        closing_mps = -rate_mps
    return MeasuredMotion(distance_m, closing_mps, sigma_mps, ttc_s, speed_mps, speed_sigma_mps, offset_m, is_alarm)


def _ego(motion: LabelledMotion, row: int, sign: float = 1.0) -> EgoMotion:
    """Motion of the camera in the frame of a box; `sign` -1 = backwards in time."""
    speed_mps, yaw_rad_s = sign * float(motion.ego_mps[row]), sign * float(motion.yaw_rad_s[row])
    return EgoMotion(speed_mps, EGO_SIGMA_MPS if math.isfinite(speed_mps) else math.nan, yaw_rad_s)


def _state(filtered: FilteredRanges) -> FloatArray:
    """(6, N) columns of the state of the filter, and variance of the rate by the systematic error of the distance."""
    state = filtered.state
    by_size = (filtered.ranges.sigma_m**2 - state.P_xx) * (state.v / state.x) ** 2
    known = filtered.rate_sigma_mps**2 - state.P_vv  # less than by size if the object may be static
    return np.stack([*state.columns, np.maximum(np.where(np.isfinite(known), known, by_size), 0.0)])


def _with_look_ahead(
    motion: LabelledMotion, columns: Mapping[str, MethodColumn], forward: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(N,) rates, sigmas and times to collision, from the forward states (6, N) and a filter backwards in time."""
    boxes, backward = motion.boxes, np.full_like(forward, np.nan)
    sequence = -1
    for rows, tracks, frame, _ in reversed(list(as_frames(boxes, boxes.class_id))):
        if boxes.sequence[rows[0]] != sequence:
            sequence, stage = int(boxes.sequence[rows[0]]), FusionStage(boxes.camera_at(rows[0]))
        ranges = {name: _ranges(column, rows, tracks.track_id) for name, column in columns.items()}
        before = replace(frame, time_s=-frame.time_s)
        backward[:, rows] = _state(stage.update(before, tracks, ranges, _ego(motion, rows[0], -1.0))[0])
    state = combined(ConstantVelocity(*forward[:5]), ConstantVelocity(*backward[:5]))
    systematic = np.fmin(forward[5], backward[5])
    ttc_s, _ = time_to_collision(state.x, state.v, variances=(state.P_xx, state.P_xv, state.P_vv))
    return state.v, np.sqrt(state.P_vv + systematic), ttc_s


def _ranges(column: MethodColumn, rows: IntArray, track_id: IntArray) -> Ranges:
    systematic_m = None if column.sigma_systematic_m is None else column.sigma_systematic_m[rows]
    return Ranges(track_id, column.distance_m[rows], column.sigma_m[rows], systematic_m)
