"""Scores of a run on a real road: errors of distances by class and method, speeds and states over
ground.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from benchmarks.harness import Figures
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.cameras.causes import ScaleDoubt
from track_range.ranging.world.object_motion import MOTION_STATES

SPAN_M = (5.0, 100.0)
MIN_TRACKS = 10  # below which a class is reported with its number of tracks only
METHODS = ("mono", "ground", "lane", "fused", "fused_kf")
_FAST_MPS = 2.0  # speed of the camera from which its error is relative
_RUN_IDS = 1_000_000  # difference between identities of two runs
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

    @classmethod
    def joined(cls, parts: Sequence[ScoredRows]) -> ScoredRows:
        """The rows of several runs, whose objects are different ones."""
        names = [field.name for field in fields(cls) if field.name not in ("track_id", "ranges")]
        columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        track_id = [part.track_id + _RUN_IDS * number for number, part in enumerate(parts)]
        methods = {name for part in parts for name in part.ranges}
        unknown = [(np.full(len(part.track_id), np.nan),) * 2 for part in parts]
        ranges = {
            name: np.concatenate(
                [part.ranges.get(name, nan) for part, nan in zip(parts, unknown, strict=True)],
                axis=1,
            )
            for name in methods
        }
        pairs = {name: (distance_m, sigma_m) for name, (distance_m, sigma_m) in ranges.items()}
        return cls(track_id=np.concatenate(track_id), ranges=pairs, **columns)

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
            "bias_pct": 100 * _median(error),
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


@dataclass(frozen=True, slots=True, kw_only=True)
class RunScores:
    """What is scored of one or more runs."""

    rows: ScoredRows
    # (R, 3) error of the last position of the camera, its stated standard deviation, and the length
    # of the true path, of each run
    path_m: FloatArray
    doubts: tuple[ScaleDoubt | None, ...]  # of each run, at its end
    n_height_notes: int  # runs with a note that the drive does not show the given camera height
    n_alarms: int  # rows with a collision warning
    # (T, 3) true speed of the camera along its axis in each frame, the measured one and its standard
    # deviation; NaN = unknown
    ego_mps: FloatArray

    @classmethod
    def of_run(
        cls,
        rows: ScoredRows,
        results: Sequence[FrameResult],
        *,
        path_m: FloatArray,
        ego_mps: FloatArray,
        notes: Sequence[str],
    ) -> Self:
        """The scores of the results of a run with its notes; `path_m` (T, 2) are the true positions of the camera
        in the frame `map`, and `ego_mps` (T,) its true speeds along its axis.
        """
        poses = [result.ego_pose for result in results]
        known = [k for k, pose in enumerate(poses) if np.isfinite(pose.x_m)]
        error_m = sigma_m = np.nan
        if known:
            start, last = path_m[known[0]], poses[known[-1]]
            moved_m = path_m[known[-1]] - start
            error_m = float(np.hypot(last.x_m - moved_m[0], last.y_m - moved_m[1]))
            sigma_m = float(np.hypot(*last.sigmas[:2]))
        length_m = float(np.hypot(*np.diff(path_m, axis=0).T).sum())
        return cls(
            rows=rows,
            path_m=np.array([[error_m, sigma_m, length_m]]),
            doubts=(results[-1].scale_doubt,),
            n_height_notes=int(any("camera height is" in note for note in notes)),
            n_alarms=sum(int(np.nansum(result.warnings.active)) for result in results),
            ego_mps=np.array(
                [
                    (true_mps, result.ego_mps, result.ego_sigma_mps)
                    for true_mps, result in zip(ego_mps.tolist(), results, strict=False)
                ]
            ),
        )

    @classmethod
    def joined(cls, runs: Sequence[RunScores]) -> RunScores:
        """The scores of several runs."""
        return cls(
            rows=ScoredRows.joined([run.rows for run in runs]),
            path_m=np.concatenate([run.path_m for run in runs]),
            doubts=tuple(doubt for run in runs for doubt in run.doubts),
            n_height_notes=sum(run.n_height_notes for run in runs),
            n_alarms=sum(run.n_alarms for run in runs),
            ego_mps=np.concatenate([run.ego_mps for run in runs]),
        )

    def figures(self) -> Figures:
        """Figures of the rows, and of the runs as wholes."""
        error_m, sigma_m, length_m = self.path_m.T
        known = np.isfinite(error_m)
        doubts = [doubt for doubt in self.doubts if doubt is not None]
        return {
            **self.rows.figures(),
            "runs": len(self.doubts),
            "runs_in_doubt": len(doubts),
            "doubts": [f"{doubt.cause_names[0]} {doubt.factor:.2f}" for doubt in doubts],
            "height_notes": self.n_height_notes,
            "alarms": self.n_alarms,
            "path_error_m": mean(error_m[known]),
            "path_error_pct": 100 * mean((error_m / np.maximum(length_m, 1.0))[known]),
            "path_in_sigmas": mean((error_m / sigma_m)[known]),
            **self._ego(),
        }

    def _ego(self) -> Figures:
        """Measured speeds of the camera: median errors of fast ones in per cent, and of slow ones."""
        true_mps, measured_mps, sigma_mps = self.ego_mps.T
        known, is_fast = np.isfinite(measured_mps), np.abs(true_mps) > _FAST_MPS
        error_mps = np.abs(measured_mps - true_mps)
        relative = error_mps / np.maximum(np.abs(true_mps), _FAST_MPS)
        return {
            "ego_known": mean(known),
            "ego_error_pct": 100 * _median(relative[known & is_fast]),
            "ego_error_slow_mps": _median(error_mps[known & ~is_fast]),
            "ego_within_2": mean((error_mps <= 2 * sigma_mps)[known]),
        }


def _median(values: npt.NDArray[Any]) -> float:
    return float(np.median(values)) if len(values) else float("nan")


def mean(values: npt.NDArray[Any]) -> float:
    """The mean; NaN of no values."""
    return float(np.mean(values)) if len(values) else float("nan")
