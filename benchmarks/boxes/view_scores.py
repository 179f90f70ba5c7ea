"""Scores of a run on a real road: errors of distances by class and method, speeds and states over
ground.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.harness import Figures
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.world.object_motion import MOTION_STATES

SPAN_M = (5.0, 100.0)
MIN_TRACKS = 10  # below which a class is reported with its number of tracks only
METHODS = ("mono", "ground", "lane", "fused", "fused_kf")
_GROSS = 0.25  # relative error above which a distance is wrong rather than inaccurate
# speeds up to which an object rests, and from which it moves; between them no state is wrong
_RESTING_MPS, _MOVING_MPS = 0.3, 1.0
# limits of the angle between its motion and that of the vehicle, in degrees; between them both
# states are right
_ANGLES_DEG = {"moving": (0.0, 35.0), "crossing": (55.0, 125.0), "oncoming": (145.0, 180.1)}


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoredRows:
    """N rows of a run with their truth; NaN = unknown."""

    track_id: IntArray  # (N,) true identity
    class_name: npt.NDArray[np.str_]
    true_m: FloatArray  # (N,) NaN = not scored
    has_motion: BoolArray  # (N,) whether states and speeds are scored, also of cut objects
    # (N, 2) true velocity over ground along the vehicle's axis and to the left of it
    velocity_mps: FloatArray
    ranges: Mapping[str, tuple[FloatArray, FloatArray]]  # distance and sigma by method
    speed_mps: FloatArray  # (N,) over ground
    speed_sigma_mps: FloatArray
    state: FloatArray  # (N,) index into `MOTION_STATES`

    def figures(self) -> Figures:
        """Per cent and fractions; states and speeds of vehicles and of people apart."""
        in_span = (self.true_m >= SPAN_M[0]) & (self.true_m <= SPAN_M[1])  # false for NaN
        figures: Figures = {"tracks": {}}
        for name in np.unique(self.class_name[in_span]).tolist():
            rows = in_span & (self.class_name == name)
            n_tracks = len(np.unique(self.track_id[rows]))
            figures["tracks"][name] = n_tracks
            if n_tracks >= MIN_TRACKS or name == "car":
                for method in (one for one in METHODS if one in self.ranges):
                    figures[f"{name}, {method}"] = self._errors(method, rows)
        is_person = self.class_name == "person"
        for group, members in (("vehicles", ~is_person), ("people", is_person)):
            figures[f"{group}, motion"] = self._motion(self.has_motion & members)
        return figures

    def _errors(self, method: str, rows: BoolArray) -> Figures:
        distance_m, sigma_m = self.ranges[method]
        known = rows & np.isfinite(distance_m)
        error = (distance_m / self.true_m - 1)[known]
        in_sigmas = np.abs(distance_m - self.true_m)[known] / sigma_m[known]
        return {
            "n": int(known.sum()),
            "coverage": mean(known[rows]),
            "mean_pct": 100 * mean(np.abs(error)),
            "bias_pct": 100 * float(np.median(error)) if len(error) else np.nan,
            "within_25": mean(np.abs(error) <= _GROSS),
            "within_1": mean(in_sigmas <= 1),
            "within_2": mean(in_sigmas <= 2),
        }

    def _motion(self, rows: BoolArray) -> Figures:
        true_mps = np.hypot(*self.velocity_mps.T)
        truth = self._true_state(true_mps)
        is_sure = rows & (truth >= 0)
        is_known = is_sure & np.isfinite(self.state)
        right = self.state == truth
        error_mps = np.abs(self.speed_mps - true_mps)
        has_speed = rows & np.isfinite(error_mps)
        in_two = error_mps <= 2 * self.speed_sigma_mps
        return {
            "states": int(is_known.sum()),
            "state_known": mean(np.isfinite(self.state[is_sure])),
            "state_right": mean(right[is_known]),
            **{
                f"{name}_right": mean(right[is_known & (truth == number)])
                for number, name in enumerate(MOTION_STATES)
            },
            "speed_known": mean(np.isfinite(error_mps[rows & np.isfinite(true_mps)])),
            "speed_error_mps": mean(error_mps[has_speed]),
            "speed_within_2": mean(in_two[has_speed]),
        }

    def _true_state(self, true_mps: FloatArray) -> IntArray:
        """(N,) index into `MOTION_STATES`; -1 = between two states, or unknown."""
        ahead, left = self.velocity_mps.T
        angle_deg = np.degrees(np.arctan2(np.abs(left), ahead))
        truth = np.full(len(true_mps), -1)
        truth[true_mps <= _RESTING_MPS] = MOTION_STATES.index("parked")
        for name, (low, high) in _ANGLES_DEG.items():
            rows = (true_mps >= _MOVING_MPS) & (angle_deg >= low) & (angle_deg <= high)
            truth[rows] = MOTION_STATES.index(name)
        return truth


def mean(values: npt.NDArray[Any]) -> float:
    """The mean; NaN of no values."""
    return float(np.mean(values)) if len(values) else float("nan")
