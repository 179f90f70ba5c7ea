r"""Motion along the road: piecewise linear speeds and lane changes.

speed    v |  __        linear between the (time, speed) pairs, constant before the first and after the last;
           | /  \__     the distance is the exact integral, a sum of trapezoids
           +--------t
lane     u |     ___    u(t) = by_m (3 q^2 - 2 q^3), q = (t - from) / (to - from) clipped to [0, 1]
           | ___/
"""

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from track_range.foundation.arrays import FloatArray

SpeedChanges = tuple[tuple[float, float], ...]  # (time_s, speed_mps) pairs in order of time
Time = TypeVar("Time", float, FloatArray)  # one time, or (T,) times, s


@dataclass(frozen=True, slots=True)
class LaneChange:
    """A lateral move by `by_m` to the right (negative: left) between two times."""

    from_s: float
    to_s: float
    by_m: float

    def moved_m(self, time_s: Time) -> Time:
        """Lateral displacement at one or more times."""
        fraction: Any = np.clip((time_s - self.from_s) / (self.to_s - self.from_s), 0, 1)
        moved_m: Time = self.by_m * fraction**2 * (3 - 2 * fraction)
        return moved_m


def speed_at_mps(changes: SpeedChanges, time_s: float) -> float:
    """Speed at a time."""
    return float(
        np.interp(time_s, [at_s for at_s, _ in changes], [speed_mps for _, speed_mps in changes])
    )


def travelled_m(changes: SpeedChanges, time_s: Time) -> Time:
    """Distance travelled from time 0 to `time_s`; negative for times before 0."""
    if len(changes) == 1:
        return changes[0][1] * time_s
    if isinstance(time_s, np.ndarray):
        return _since_first_m(changes, time_s) - _since_first_m(changes, np.zeros(1))
    low_s: float = min(0.0, time_s)
    high_s: float = max(0.0, time_s)
    times_s = np.array([low_s, *(at_s for at_s, _ in changes if low_s < at_s < high_s), high_s])
    speeds_mps = np.interp(
        times_s, [at_s for at_s, _ in changes], [speed_mps for _, speed_mps in changes]
    )
    distance_m = float(((speeds_mps[1:] + speeds_mps[:-1]) / 2 * np.diff(times_s)).sum())
    return distance_m if time_s >= 0 else -distance_m


def _since_first_m(changes: SpeedChanges, times_s: FloatArray) -> FloatArray:
    """(T,) distance travelled from the first change of speed on."""
    at_s, mps = np.array(changes, np.float64).T
    total_m = np.concatenate([[0.0], np.cumsum((mps[1:] + mps[:-1]) / 2 * np.diff(at_s))])
    last = np.clip(np.searchsorted(at_s, times_s, side="right") - 1, 0, len(at_s) - 1)
    return np.asarray(
        total_m[last] + (mps[last] + np.interp(times_s, at_s, mps)) / 2 * (times_s - at_s[last])
    )
