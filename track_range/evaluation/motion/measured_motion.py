"""MeasuredMotion: closing speeds, times to collision, speeds over ground and alarms, from boxes as in a run.

Methods measure each frame's boxes; the stage of a run fuses and filters them, and the collision warning follows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from track_range.evaluation.motion.labelled_motion import LabelledMotion
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.foundation.errors import UsageError
from track_range.pipeline.stages import FusionStage
from track_range.ranging.evaluation.box_methods import (
    MethodOptions,
    as_frames,
    box_methods,
    measured_by,
    ranges_in_frame,
)
from track_range.ranging.evaluation.errors import MethodColumn
from track_range.ranging.filtering.distance_filter import FilteredRanges, time_to_collision
from track_range.ranging.filtering.lateral_motion import LateralMotion
from track_range.ranging.filtering.look_ahead import combined
from track_range.ranging.warning.collision_warning import CollisionWarning
from track_range.ranging.world.object_motion import over_ground
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.tracking.tracks import Tracks

EGO_SIGMA_MPS = 0.05  # standard deviation of the ego speed, that of a wheel sensor


@dataclass(frozen=True, slots=True)
class MeasuredMotion:
    """Motion of N boxes as a run reports it; NaN = not measured."""

    is_alarm: BoolArray
    distance_m: FloatArray
    closing_mps: FloatArray
    closing_sigma_mps: FloatArray
    ttc_s: FloatArray
    speed_mps: FloatArray  # over ground
    speed_sigma_mps: FloatArray


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
    if not is_ego_known:
        unknown = np.full(len(boxes), np.nan)
        motion = replace(motion, ego_mps=unknown, yaw_rad_s=unknown)
    columns = measured_by(names, boxes, boxes, options)
    values, is_alarm = np.full((6, len(boxes)), np.nan), np.zeros(len(boxes), np.bool_)
    forward = np.full((6, len(boxes)), np.nan)
    sequence, warning = -1, CollisionWarning()
    for rows, tracks, ego, state, lateral in _filtered(motion, columns):
        if boxes.sequence[rows[0]] != sequence:
            sequence, warning = int(boxes.sequence[rows[0]]), CollisionWarning()
        time_s = float(boxes.time_s[rows[0]])
        alarm = warning.update(tracks, state, lateral, time_s, ego_mps=ego.speed_mps, yaw_rad_s=ego.yaw_rad_s)
        is_alarm[rows] = alarm.active
        ground = over_ground(state, lateral, tracks.class_id, ego)
        closing = (-state.rate_mps, state.rate_sigma_mps, state.ttc_s)
        values[:, rows] = state.ranges.distance_m, *closing, ground.speed_mps, ground.sigma_mps
        forward[:, rows] = _state(state)
    if look_ahead:
        values[1:4] = _with_look_ahead(motion, columns, forward)
    return MeasuredMotion(is_alarm, *values)


def _filtered(
    motion: LabelledMotion, columns: Mapping[str, MethodColumn], *, sign: int = 1
) -> Iterator[tuple[IntArray, Tracks, EgoMotion, FilteredRanges, LateralMotion]]:
    """Row indices, tracks, ego motion and filtered motion of each frame; `sign` -1 = backwards in time."""
    boxes, sequence = motion.boxes, -1
    for rows, tracks, frame, _ in list(as_frames(boxes, boxes.class_id))[::sign]:
        if boxes.sequence[rows[0]] != sequence:
            sequence, stage = int(boxes.sequence[rows[0]]), FusionStage(boxes.camera_at(rows[0]))
        speed_mps, yaw_rad_s = sign * float(motion.ego_mps[rows[0]]), sign * float(motion.yaw_rad_s[rows[0]])
        ego = EgoMotion(speed_mps, EGO_SIGMA_MPS if math.isfinite(speed_mps) else math.nan, yaw_rad_s)
        ranges = {name: ranges_in_frame(column, tracks, rows) for name, column in columns.items()}
        yield rows, tracks, ego, *stage.update(replace(frame, time_s=sign * frame.time_s), tracks, ranges, ego)


def _state(filtered: FilteredRanges) -> FloatArray:
    """(6, N) columns of the state of the filter, and variance of the rate by the systematic error of the distance."""
    state = filtered.state
    by_size = (filtered.ranges.sigma_m**2 - state.P_xx) * (state.v / state.x) ** 2
    known = filtered.rate_sigma_mps**2 - state.P_vv  # less than by size if the object may be static
    return np.stack([*state.columns, np.maximum(np.where(np.isfinite(known), known, by_size), 0.0)])


def _with_look_ahead(
    motion: LabelledMotion, columns: Mapping[str, MethodColumn], forward: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(N,) closing speeds, sigmas and times to collision, from forward states (6, N) and a filter backwards in time."""
    backward = np.full_like(forward, np.nan)
    for rows, _, _, filtered, _ in _filtered(motion, columns, sign=-1):
        backward[:, rows] = _state(filtered)
    state = combined(ConstantVelocity(*forward[:5]), ConstantVelocity(*backward[:5]))
    ttc_s, _ = time_to_collision(state.x, state.v, variances=(state.P_xx, state.P_xv, state.P_vv))
    return -state.v, np.sqrt(state.P_vv + np.fmin(forward[5], backward[5])), ttc_s
