"""MeasuredMotion: closing speeds, times to collision, speeds over ground and alarms, from boxes as
in a run.

Methods measure each frame's boxes; the stage of a run fuses and filters them, and the collision
warning follows.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from track_range.evaluation.motion.labelled_motion import LabelledMotion
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.foundation.errors import UsageError
from track_range.pipeline.filtering import Filtered, FilterStage
from track_range.pipeline.ranging import FrameRanges
from track_range.ranging.evaluation.box_frames import as_frames, ranges_in_frame
from track_range.ranging.evaluation.box_methods import (
    MethodOptions,
    box_methods,
    measured_by,
)
from track_range.ranging.filtering.distance_filter import FilteredRanges, time_to_collision
from track_range.ranging.fusion.fusion import Fused, Fusion
from track_range.ranging.registry import method_of
from track_range.ranging.truth.errors import MethodColumn
from track_range.ranging.truth.labelled_boxes import BoxSet
from track_range.ranging.warning.collision_warning import CollisionWarning
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import ObjectMotions
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.tracking.tracks import Tracks


def combined(forward: ConstantVelocity, backward: ConstantVelocity) -> ConstantVelocity:
    """State of (N,) tracks from states forwards and backwards in time, or from one direction if
    only one is known.

    The backward filter has negative times and speeds, so that its rate is -v. Given the state, the
    errors of both directions are independent (Fraser and Potter, IEEE TAC 1969), except that both
    contain the measurement of that time:

        P^-1 = P_f^-1 + P_b^-1        x = P (P_f^-1 x_f + P_b^-1 x_b)
    """
    backward = ConstantVelocity(
        backward.x, -backward.v, backward.P_xx, -backward.P_xv, backward.P_vv
    )
    f_information, f_vector = _information(forward)
    b_information, b_vector = _information(backward)
    information = f_information + b_information
    is_known = np.isfinite(forward.x) | np.isfinite(backward.x)
    P = np.linalg.inv(np.where(is_known[:, None, None], information, np.eye(2)))
    P[~is_known] = np.nan
    x, v = (P @ (f_vector + b_vector)[..., None])[..., 0].T
    return ConstantVelocity(x, v, P[:, 0, 0], P[:, 0, 1], P[:, 1, 1])


def _information(state: ConstantVelocity) -> tuple[FloatArray, FloatArray]:
    """P^-1 (N, 2, 2) and P^-1 x (N, 2); 0 where the state is unknown."""
    x, v, P_xx, P_xv, P_vv = state.columns
    is_known = np.isfinite(x)
    P = np.where(is_known, [[P_xx, P_xv], [P_xv, P_vv]], np.eye(2)[..., None]).transpose(2, 0, 1)
    information = np.linalg.inv(P) * is_known[:, None, None]
    vector = information @ np.nan_to_num([x, v]).T[..., None]
    return information, vector[..., 0]


EGO_SIGMA_MPS = 0.05  # standard deviation of the speeds of the camera, that of a wheel sensor


@dataclass(frozen=True, slots=True)
class MeasuredMotion:
    """Motion of N boxes as a run reports it; NaN = not measured."""

    is_alarm: BoolArray
    distance_m: FloatArray
    closing_mps: FloatArray
    closing_sigma_mps: FloatArray
    ttc_s: FloatArray
    ttc_sigma_s: FloatArray
    speed_mps: FloatArray  # over ground
    speed_sigma_mps: FloatArray
    state: FloatArray  # index into `MOTION_STATES`
    state_probability: FloatArray
    static: FloatArray  # probability that the object does not move along the camera's axis
    ego_mps: FloatArray  # speed of the camera, as the filters know it


def measured_motion(
    motion: LabelledMotion,
    method: str,
    options: MethodOptions | None = None,
    *,
    is_ego_known: bool = True,
    look_ahead: bool = False,
) -> MeasuredMotion:
    """Motion of the boxes by a method, or by a fusion of methods (`mono+ground`); UsageError if it
    is unknown.

    With `look_ahead`, closing speeds and times to collision use all frames of a sequence, instead
    of the frames so far.
    """
    boxes = motion.boxes
    columns = method_columns(boxes, method, options)
    values, is_alarm = np.full((11, len(boxes)), np.nan), np.zeros(len(boxes), np.bool_)
    forward = np.full((6, len(boxes)), np.nan)
    warnings = {number: CollisionWarning() for number in np.flatnonzero(motion.are_ahead).tolist()}
    motions = {
        number: ObjectMotions(axis_rad) for number, axis_rad in enumerate(motion.axis_rad.tolist())
    }
    for rows, tracks, ego, fused, filtered in filtered_frames(motion, columns, is_ego_known):
        state, lateral = filtered.fused, filtered.lateral
        sequence = int(boxes.sequence[rows[0]])
        time_s = float(boxes.time_s[rows[0]])
        if sequence in warnings:
            alarm = warnings[sequence].update(
                tracks,
                state,
                lateral,
                time_s,
                ego_mps=ego.speed_mps,
                yaw_rad_s=ego.yaw_rad_s,
                ranges=fused.ranges,
            )
            is_alarm[rows] = alarm.active
        world = motions[sequence].update(
            tracks.track_id, tracks.class_id, state, lateral, time_s, ego=ego, pose=EgoPose()
        )
        values[:3, rows] = state.ranges.distance_m, -state.rate_mps, state.rate_sigma_mps
        values[3:5, rows] = state.ttc_s, state.ttc_sigma_s
        values[5:7, rows] = world.speed_mps, world.speed_sigma_mps
        values[7:10, rows] = world.state, world.state_probability, state.static
        values[10, rows] = ego.speed_mps
        forward[:, rows] = _state(state)
    if look_ahead:
        values[1:5] = _with_look_ahead(motion, columns, is_ego_known, forward)
    return MeasuredMotion(is_alarm, *values)


def method_columns(
    boxes: BoxSet, method: str, options: MethodOptions | None
) -> dict[str, MethodColumn]:
    """Distances of the boxes by the name of each method that is joined in `method`; UsageError if
    one is unknown.
    """
    names = [method_of(part).name if ":" in part else part for part in method.split("+")]
    known = [listed.name for listed in box_methods()]
    if not set(names) <= set(known):
        raise UsageError(
            f"--methods {method}: expected {' or '.join(known)}, or several methods joined by +."
        )
    return measured_by(names, boxes, boxes, options)


def filtered_frames(
    motion: LabelledMotion,
    columns: Mapping[str, MethodColumn],
    is_ego_known: bool,
    *,
    sign: int = 1,
) -> Iterator[tuple[IntArray, Tracks, EgoMotion, Fused, Filtered]]:
    """Row indices, tracks, ego motion, fused distances and filtered motion of each frame; `sign`
    -1 = backwards in time.
    """
    boxes, sequence = motion.boxes, -1
    for rows, tracks, frame, _ in list(as_frames(boxes, boxes.class_id))[::sign]:
        if boxes.sequence[rows[0]] != sequence:
            sequence = int(boxes.sequence[rows[0]])
            mounting = motion.mounting(sequence)
            fusion, stage = Fusion(), FilterStage(boxes.camera_at(rows[0]), mounting=mounting)
        ego = _ego_motion(motion, rows[0], sign) if is_ego_known else EgoMotion()
        ranges = {name: ranges_in_frame(column, tracks, rows) for name, column in columns.items()}
        time_s = sign * frame.time_s
        fused = fusion.fuse(ranges, tracks.track_id, time_s)
        yield (
            rows,
            tracks,
            ego,
            fused,
            stage.update(tracks, FrameRanges(ranges), fused, ego, time_s),
        )


def _ego_motion(motion: LabelledMotion, row: int, sign: int) -> EgoMotion:
    """The motion of the camera at the box `row`; `sign` -1 = backwards in time."""
    columns = motion.ego_mps, motion.right_mps, motion.yaw_rad_s
    speed_mps, right_mps, yaw_rad_s = (sign * float(column[row]) for column in columns)
    sigma_mps = EGO_SIGMA_MPS if math.isfinite(speed_mps) else math.nan
    return EgoMotion(
        speed_mps, sigma_mps, yaw_rad_s, right_mps=right_mps, right_sigma_mps=sigma_mps
    )


def _state(filtered: FilteredRanges) -> FloatArray:
    """(6, N) columns of the state of the filter, and variance of the rate by the systematic error
    of the distance.
    """
    state = filtered.state
    by_size = (filtered.ranges.sigma_m**2 - state.P_xx) * (state.v / state.x) ** 2
    known = filtered.rate_sigma_mps**2 - state.P_vv  # less than by size if the object may be static
    return np.stack([*state.columns, np.maximum(np.where(np.isfinite(known), known, by_size), 0.0)])


def _with_look_ahead(
    motion: LabelledMotion,
    columns: Mapping[str, MethodColumn],
    is_ego_known: bool,
    forward: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(N,) closing speeds and times to collision with their sigmas, from forward states (6, N) and
    a filter backwards in time.
    """
    backward = np.full_like(forward, np.nan)
    for rows, *_, filtered in filtered_frames(motion, columns, is_ego_known, sign=-1):
        backward[:, rows] = _state(filtered.fused)
    state = combined(ConstantVelocity(*forward[:5]), ConstantVelocity(*backward[:5]))
    sigma_mps = np.sqrt(state.P_vv + np.fmin(forward[5], backward[5]))
    variances = (state.P_xx, state.P_xv, state.P_vv)
    return -state.v, sigma_mps, *time_to_collision(state.x, state.v, variances=variances)
