"""DriveState: what the objects of a drive have shown about its ground plane and about their own body types.

    y_i = y0 + delta_t + H x_i + r_i            y_i: bottom edge, x_i = 1 / z_i by size, H: camera height
    delta_t ~ N(0, lambda pitch^2)              pitch and slope of the road at a time
    r_i ~ N(0, lambda (roll_i^2 + kerb_i^2))    contact point off the plane; lambda: roughness of the drive

A frame has few objects, and the size of each is known to some per cent only. y0, H and lambda are common to a drive, so
that the objects seen before contribute to those of the frame. The size error of an object is the same in all of its
frames: an object counts once, with the mean of its normal equations over its frames, and only after it has left; while
it is in view it counts with its present measurement.

The body type of an object (`BodyType`) is the same in all of its frames, too. Its shape errors are, so that the log
likelihoods of its views are averaged, not summed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.track_state import TrackState

_MEMORY_S = 60.0  # time in s over which the contribution of an object that has left decays to 1/e
_ROUGHNESS_OBJECTS = 3.0  # weight of the prior roughness, 1, as a number of objects
_ROUGHNESS_RANGE = (0.2, 5.0)  # smallest and largest roughness lambda
_MAX_CHI2 = 9.0  # largest squared residual relative to its variance that counts for the roughness
_MIN_WEIGHT = 0.02  # weight, relative to a new object, below which an object that has left is forgotten
_MAX_LOG_RATIO = 1.0  # of two body types from the earlier views of an object, since shapes are not cuboids
_N_MEANS = 7  # per object: five terms of the normal equations, two moments of the residuals

_N_GROUND, _N_VIEWS, _TIME, _BODIES = _N_MEANS, _N_MEANS + 1, _N_MEANS + 2, _N_MEANS + 3
"""Rows of the state of an object after the means: frames on the ground, frames, time of the last one; then the mean log
likelihoods of the body types."""


@dataclass(frozen=True, slots=True)
class GroundTerms:
    """Measurements of the ground plane by the N objects of a frame."""

    normal: FloatArray  # (5, N) terms of the normal equations for (y0, H) (`shared_ground.solve_ground`)
    residual2: FloatArray  # (N,) squared residuals of the bottom edges
    rough: FloatArray  # (N,) part of their variance that is proportional to the roughness, for a roughness of 1
    other: FloatArray  # (N,) rest of their variance
    is_on_ground: BoolArray  # (N,) whether the object is on the ground; others do not contribute


class DriveState:
    """State of one drive."""

    def __init__(self) -> None:
        """Start without objects."""
        self._tracks: TrackState | None = None
        self._track_id: IntArray = np.zeros(0, np.int64)
        self._in_view: FloatArray = np.zeros((_BODIES, 0))  # states of these tracks before the frame
        self._time_s = 0.0
        self.information: FloatArray = np.zeros(5)  # (5,) sums of the normal equations over the objects that left
        self.roughness = 1.0  # factor lambda of the variances of pitch and of contact points

    def start_frame(self, track_id: IntArray, time_s: float) -> None:
        """Start a frame with the tracks (N,) `track_id`, whose boxes are measured next."""
        self._track_id, self._time_s = track_id, time_s
        if self._tracks is None:
            return
        self._in_view = self._tracks.get(track_id)
        known, has_left = self._tracks.known, self._tracks.is_absent(track_id)
        means = known[:_N_MEANS] * np.exp((known[_TIME] - time_s) / _MEMORY_S)
        self.information = means[:5, has_left].sum(axis=1)
        excess, expected = means[5:].sum(axis=1).tolist()
        low, high = _ROUGHNESS_RANGE
        self.roughness = min(max((_ROUGHNESS_OBJECTS + excess) / (_ROUGHNESS_OBJECTS + expected), low), high)

    def body_evidence(self, n_bodies: int) -> FloatArray:
        """(B, N) mean log likelihoods of all B body types over the earlier views of the tracks; 0 = the most likely."""
        if self._tracks is None:
            return np.zeros((n_bodies, len(self._track_id)))
        return self._in_view[_BODIES:]

    def add(self, rows: IntArray, ground: GroundTerms | None, log_likelihood: FloatArray) -> None:
        """Add the measurements of the tracks of the frame with the indices `rows` (N,).

        `ground` None = no object is on the ground; `log_likelihood` (B, N) of the body types, 0 = the most likely one.
        """
        if self._tracks is None:
            self._tracks = TrackState(np.zeros(_BODIES + len(log_likelihood)))
            self._in_view = self._tracks.get(self._track_id)
        track_id, state = self._track_id[rows], self._in_view[:, rows]
        if ground is not None:
            state[_N_GROUND] += ground.is_on_ground
            fraction = ground.is_on_ground / np.maximum(state[_N_GROUND], 1.0)
            # Terms of the normal equations and moments of the residuals of this frame.
            expected = ground.other + self.roughness * ground.rough
            gain = ground.rough / expected**2
            excess = np.minimum(ground.residual2, _MAX_CHI2 * expected) - ground.other
            means = np.concatenate([ground.normal, [gain * excess, gain * ground.rough]])
            state[:_N_MEANS] += fraction * (means - state[:_N_MEANS])
        state[_N_VIEWS] += 1.0
        state[_BODIES:] += (np.maximum(log_likelihood, -_MAX_LOG_RATIO) - state[_BODIES:]) / state[_N_VIEWS]
        state[_TIME] = self._time_s
        age_s = self._time_s - self._tracks.known[_TIME]
        self._tracks.put(track_id, state, keep_known=age_s < -_MEMORY_S * math.log(_MIN_WEIGHT))
