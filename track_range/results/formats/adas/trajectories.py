"""Trajectories: where the ego vehicle and the road users of a drive are, for scenarios and roads."""

import math
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

from track_range.foundation.arrays import FloatArray
from track_range.ranging.methods.lane_width import LaneWidth, usual_width

N_VALUES = 18  # of a row


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectories:
    """Poses of the ego vehicle and rows of the tracks in the frame `map`.

    A row has time, x, y and heading of the cuboid, whether its front is known, whether parked, track
    ID, class, gap to the front of the ego vehicle, lateral offset from its path, speed over ground,
    speed of the ego vehicle, and length, width and height with their sigmas.
    """

    ego: FloatArray  # (N, 4) time, x, y and heading
    rows: FloatArray  # (M, N_VALUES)
    start_utc_s: float | None  # of time 0; None = unknown
    end_sigma_m: float = (
        math.nan
    )  # largest standard deviation of the last position of the ego vehicle
    lane: LaneWidth = field(default_factory=lambda: usual_width("unknown"))

    @property
    def start_s(self) -> float:
        """Time of its first pose."""
        return float(self.ego[0, 0]) if len(self.ego) else 0.0

    @property
    def date(self) -> str:
        """UTC of its start; that of 1970 if it is unknown, so that the same run gives the same
        files.
        """
        utc_s = 0.0 if self.start_utc_s is None else self.start_utc_s + self.start_s
        return datetime.fromtimestamp(utc_s, UTC).strftime("%Y-%m-%dT%H:%M:%S")

    def between(self, start_s: float, end_s: float) -> "Trajectories":
        """The part between two times."""
        ego, rows = (
            table[(table[:, 0] >= start_s) & (table[:, 0] <= end_s)]
            for table in (self.ego, self.rows)
        )
        return replace(self, ego=ego, rows=rows)
