"""Observation: what a frame shows of the tracks beside their distances; FilterStep: one frame, as
the filters see it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.filtering.cut_boxes import CutBoxes
from track_range.ranging.filtering.noise_scale import MeasuredDistances
from track_range.ranging.measurement.growth import Growth
from track_range.stereo.odometry.ego_motion import PREDICTED_NOISE, EgoMotion

# tau, over which errors of the ego speed are correlated; assumed: that of receivers at 1 Hz
_EGO_CORRELATION_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """What a frame shows of N tracks beside their distances."""

    # (N,) code of the condition of each measurement, by method; a change of the code is a change of
    # the systematic error
    conditions: Mapping[str, IntArray] = field(default_factory=dict)
    # boxes of the tracks that the image border cuts; None = no box is cut, and all are on the
    # camera's axis
    cut: CutBoxes | None = None
    # (N,) whether distances come from boxes with hidden sides (`have_hidden_sides`); None = no box
    is_hidden: BoolArray | None = None
    # growth of the tracks in the images, not used of boxes that are cut; None = not measured
    growth: Growth | None = None
    # (N,) heights of the boxes in px, by method whose distances are by an assumed size; NaN = of no
    # rigid object, or by another scale
    heights_px: Mapping[str, FloatArray] = field(default_factory=dict)
    # (N,) road class of each track, whose motion is learnt; None = all are cars
    class_id: IntArray | None = None
    # (N,) False = the track certainly moves; None = all may be static
    may_be_static: BoolArray | None = None


@dataclass(frozen=True, slots=True)
class EgoStep:
    """Motion of the camera towards static objects: a known input of the filters."""

    is_known: bool
    # () or (M, G, N) speed V with which static objects come nearer; NaN = unknown, () then
    speed_mps: FloatArray
    sigma_mps: float  # its standard deviation; 0 = unknown
    # like the speed: dV since the previous frame, 0 where the speed was unknown, and its variance
    change_mps: FloatArray
    change_variance: FloatArray

    @classmethod
    def of(
        cls, ego: EgoMotion, speed_mps: FloatArray, last_mps: FloatArray, dt: FloatArray
    ) -> EgoStep:
        """The step from the speeds V of the previous frame, `last_mps`, in the time `dt`."""
        zero = np.array(0.0)
        if not math.isfinite(ego.speed_mps):
            return cls(False, speed_mps, 0.0, zero, zero)
        change_mps = speed_mps - last_mps
        change_mps = np.where(np.isnan(change_mps), 0.0, change_mps)
        if math.isnan(ego.speed_sigma_mps):
            return cls(True, speed_mps, 0.0, change_mps, zero)
        lasting = max(ego.speed_sigma_mps**2 - ego.noise_mps**2, 0.0)
        variance = 2 * (ego.noise_mps**2 - lasting * np.expm1(-dt / _EGO_CORRELATION_S))
        change_variance = np.where(change_mps == 0, 0.0, variance)
        if ego.is_predicted:
            change_variance = PREDICTED_NOISE**2 * dt
        return cls(True, speed_mps, ego.speed_sigma_mps, change_mps, change_variance)


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterStep:
    """One step of the filters of M methods, G models and N tracks, from the previous frame to this
    one.
    """

    time_s: float
    dt: FloatArray  # (N,) time since the previous frame, 0 for new tracks
    measured: MeasuredDistances
    ego: EgoStep
    turn_rad_s: float  # rate of the camera's turn, to either side; 0 = unknown
    across_mps: float  # speed of the camera across its axis, to either side; 0 = unknown
    observation: Observation
    class_id: IntArray  # (N,)
    condition: FloatArray  # (M, 1, N) codes of the conditions; NaN = not given
    is_hidden: BoolArray  # () or (N,)
    prior: FloatArray  # (M, G, N) probabilities of the models of a new track
    slides: BoolArray  # (N,) whether the box is cut, or was in the previous frame
    # (M, 1, N) factors of the believed sizes since the previous frame; None = no size is assumed
    resized: FloatArray | None = None
