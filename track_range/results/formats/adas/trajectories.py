"""Trajectories: where the ego vehicle and the road users of a drive are, for scenarios and roads."""

import math
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

from track_range.foundation.arrays import FloatArray
from track_range.ranging.methods.lane_width import LaneWidth, usual_width
from track_range.ranging.warning.settings import WarningSettings
from track_range.stereo.geometry.mounting import Mounting

N_VALUES = 18  # of a row
_NOMINAL = WarningSettings()
# length, width and height of the ego vehicle: nominal
EGO_SIZE_M = (_NOMINAL.ego_length_m, _NOMINAL.ego_width_m, 1.5)


def ego_centre_m(mounting: Mounting | None) -> tuple[float, float]:
    """How far the middle of the ego vehicle is in front of the camera, and to its left, in the
    directions of the vehicle; nominal where the mounting does not state it.
    """
    bumper_m = None if mounting is None else mounting.bumper_m
    front_m = _NOMINAL.front_m if bumper_m is None else bumper_m
    return front_m - EGO_SIZE_M[0] / 2, 0.0 if mounting is None else -mounting.y_m


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectories:
    """Poses of the ego vehicle and rows of the tracks in the frame `map`.

    A row has time, x, y and heading of the cuboid, whether its front is known, whether parked (NaN =
    unknown), track ID, class, gap to the front of the ego vehicle, lateral offset from its path,
    speed over ground, speed of the ego vehicle, and length, width and height with their sigmas.
    """

    ego: FloatArray  # (N, 4) time, x, y and heading
    rows: FloatArray  # (M, N_VALUES)
    start_utc_s: float | None  # of time 0; None = unknown
    # largest standard deviation of the last position of the ego vehicle
    end_sigma_m: float = math.nan
    ego_centre_m: tuple[float, float] = ego_centre_m(None)  # see there
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
