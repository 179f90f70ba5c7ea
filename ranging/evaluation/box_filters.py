"""Temporal filters for the measured distances of labelled boxes, per track as in a run.

The ego speed is not known: the filter of Zhang et al. (`PaperFilter`) assumes 0, and the default
one (`ranging.filtering.distance_filter`) estimates the relative speed.

The filter of Zhang et al., with filterpy, is predicted by the ego speed V:

    d' = d - V t,  P' = P + Q        K = P' / (P' + R),  d = d' + K (z - d'),  P = (1 - K) P'        Q = R = 0.1 m^2

(Zhang et al., eq. 10-16.) Their eq. 15 has d + V t, but a static object in front of a moving car
approaches by V t. R is 10 % of the distance in their text and 0.1 in their equation; the equation
is used. Q is per frame, for any frame interval. The filter lags behind moving targets, and, if V is
unknown, behind all targets with a relative speed.
"""

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.evaluation.box_evaluation import frame_rows
from track_range.ranging.filtering.distance_filter import (
    DistanceFilters,
    FilteredRanges,
    time_to_collision,
)
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.truth.errors import MethodColumn
from track_range.ranging.truth.labelled_boxes import BoxSet

_NOISE_M2 = 0.1  # Q and R in m^2, from Zhang et al.
_MAX_GAP_S = 1.0  # longest time in s without a measurement; after it the filter of a track restarts
_NOISE_FRACTION = 0.6  # initial independent fraction of sigma for the default filter, that of mono
_UNKNOWN_SIGMA = 0.1  # relative sigma that is assumed for methods without a sigma (plain curves)

FilterName = Literal["none", "paper", "default"]


@dataclass(slots=True)
class _Track:
    """Filter of one track, with the times of its state and of its last measurement in s."""

    kalman: Any
    time_s: float
    measured_s: float


class PaperFilter:
    """The filter of Zhang et al. for all tracks of a video; sigmas of the measurements are not
    used.
    """

    def __init__(self) -> None:
        self._tracks: dict[int, _Track] = {}

    def update(
        self, measured: Ranges, time_s: float, *, ego_speed_mps: float = math.nan
    ) -> FilteredRanges:
        """Filtered ranges of the tracks at `time_s`; the rate is the difference from the previous
        frame.

        `ego_speed_mps` is V; NaN = unknown, 0 is assumed.
        """
        self._tracks = {
            i: track for i, track in self._tracks.items() if time_s - track.measured_s <= _MAX_GAP_S
        }
        distance_m, variance, rate_mps, rate_variance = np.full((4, len(measured)), np.nan)
        for row, (track_id, z) in enumerate(
            zip(measured.track_id.tolist(), measured.distance_m, strict=True)
        ):
            track = self._tracks.get(track_id)
            if track is not None:
                before_m, dt_s = track.kalman.x[0, 0], time_s - track.time_s
                track.kalman.predict(u=np.array([[np.nan_to_num(ego_speed_mps) * dt_s]]))
                if np.isfinite(z):
                    track.kalman.update(z)
                    track.measured_s = time_s
                track.time_s = time_s
                if dt_s > 0:
                    rate_mps[row] = (track.kalman.x[0, 0] - before_m) / dt_s
                    rate_variance[row] = 2 * track.kalman.P[0, 0] / dt_s**2
            elif np.isfinite(z):
                track = self._tracks[track_id] = _Track(_kalman_filter(z), time_s, time_s)
            if track is not None:
                distance_m[row], variance[row] = track.kalman.x[0, 0], track.kalman.P[0, 0]
        variances = (variance, 0 * rate_variance, rate_variance)
        ttc_s, ttc_sigma_s = time_to_collision(distance_m, rate_mps, variances=variances)
        ranges = Ranges(measured.track_id, distance_m, np.sqrt(variance))
        state = ConstantVelocity(distance_m, rate_mps, *variances)
        rate_sigma_mps, own_mps2 = np.sqrt(rate_variance), np.zeros_like(rate_mps)
        return FilteredRanges(ranges, rate_mps, rate_sigma_mps, ttc_s, ttc_sigma_s, state, own_mps2)


def _kalman_filter(first_m: float) -> Any:
    from filterpy.kalman import KalmanFilter  # a local import, since it takes seconds

    kalman = KalmanFilter(dim_x=1, dim_z=1, dim_u=1)
    kalman.x = np.array([[first_m]])
    kalman.P = kalman.Q = kalman.R = np.array([[_NOISE_M2]])
    kalman.F = kalman.H = np.identity(1)
    kalman.B = -np.identity(1)
    return kalman


def filtered(
    boxes: BoxSet, column: MethodColumn, filter_name: FilterName
) -> tuple[MethodColumn, FloatArray]:
    """Filtered distances of a method and (N,) closing speeds, m/s; for "none", unfiltered distances
    without speeds.
    """
    if filter_name == "none":
        return column, np.full(len(boxes), np.nan)
    is_given = np.isfinite(column.sigma_m)
    sigma_m = np.where(is_given, column.sigma_m, _UNKNOWN_SIGMA * column.distance_m)
    distance_m, out_sigma_m, closing_mps = np.full((3, len(boxes)), np.nan)
    sequence = -1
    for rows in frame_rows(boxes):
        if boxes.sequence[rows[0]] != sequence:
            sequence, paper, default = (
                boxes.sequence[rows[0]],
                PaperFilter(),
                DistanceFilters({"": _NOISE_FRACTION}),
            )
        systematic_m = (
            None if column.sigma_systematic_m is None else column.sigma_systematic_m[rows]
        )
        measured = Ranges(
            boxes.track_id[rows], column.distance_m[rows], sigma_m[rows], systematic_m
        )
        time_s = float(boxes.time_s[rows[0]])
        is_paper = filter_name == "paper"
        result = (
            paper.update(measured, time_s)
            if is_paper
            else default.update({"": measured}, time_s)[""]
        )
        distance_m[rows], out_sigma_m[rows] = result.ranges.distance_m, result.ranges.sigma_m
        closing_mps[rows] = -result.rate_mps
    return MethodColumn(distance_m, np.where(is_given.any(), out_sigma_m, np.nan)), closing_mps
