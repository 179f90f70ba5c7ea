"""How fast the camera itself moves along its axis, at any time of the video.

50                          km/h, all the time
FILE.csv                    columns time_s (seconds from the video's first frame) and speed_mps or speed_kmh
OXTS_DIR                    KITTI's GPS/IMU folder: NNNNNNNNNN.txt per frame, whose 9th value is the forward speed vf in
                            m/s, and timestamps.txt in it or beside it (Geiger et al., IJRR 2013)

Between two samples the speed is interpolated by time; outside of what is known it is NaN, and whoever asks goes on
without it. How the camera turns is not in it: distances are along the axis, and what turns past changes them too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.csv_tables import read_csv_table
from track_range.foundation.errors import UserError

_MPS_PER_KMH = 1 / 3.6
_FASTEST_MPS = 120.0
_LONGEST_GAP_S = 3.0
"""Nothing is known in a hole that is longer."""

_EDGE_S = 0.25
"""The first and the last sample hold this much longer: clocks do not start with the video to the frame."""

_UNITS = {"speed_mps": 1.0, "speed_kmh": _MPS_PER_KMH}
_OXTS_FORWARD = 8
_OXTS_COLUMNS = 30


class EgoSpeedError(UserError):
    """An ego speed that cannot be used; the message says what is wanted."""


@dataclass(frozen=True, slots=True)
class EgoSpeed:
    """Samples of the speed.

    Attributes:
        time_s: (N,) rising, seconds from the video's first frame; one sample at -inf = always the same.
        speed_mps: (N,) along the camera's axis, negative = backwards.
        source: where it is from, for notes.
    """

    time_s: FloatArray
    speed_mps: FloatArray
    source: str

    def at(self, time_s: float) -> float:
        """The speed at that time, m/s; NaN = unknown."""
        if np.isneginf(self.time_s[0]):
            return float(self.speed_mps[0])
        if not self.time_s[0] - _EDGE_S <= time_s <= self.time_s[-1] + _EDGE_S:
            return math.nan
        after = int(np.searchsorted(self.time_s, time_s))
        is_between = 0 < after < len(self.time_s)
        if is_between and self.time_s[after] - self.time_s[after - 1] > _LONGEST_GAP_S:
            return math.nan
        return float(np.interp(time_s, self.time_s, self.speed_mps))

    def note(self, last_s: float) -> str | None:
        """What a user should know of a video whose last frame is at `last_s`; None where all of it is covered."""
        first_known_s, last_known_s = float(self.time_s[0]), float(self.time_s[-1])
        if np.isneginf(first_known_s) or (first_known_s - _EDGE_S <= 0 and last_s <= last_known_s + _EDGE_S):
            return None
        return (
            f"The ego speed of {self.source} covers {first_known_s:.1f}-{last_known_s:.1f} s of the video's "
            f"0.0-{last_s:.1f} s; for the rest closing speeds come from the distances alone."
        )


def open_ego_speed(word: str) -> EgoSpeed:
    """The ego speed that a user gives as km/h, a CSV file or a folder of KITTI's oxts.

    Raises:
        EgoSpeedError: it is none of these, or the file or folder cannot be used.
    """
    try:
        kmh = float(word)
    except ValueError:
        return _from_path(Path(word))
    return EgoSpeed(np.array([-np.inf]), _plausible(np.array([kmh]) * _MPS_PER_KMH, "--ego-speed"), f"{kmh:g} km/h")


def _from_path(path: Path) -> EgoSpeed:
    if path.is_dir():
        return _from_oxts(path)
    if not path.is_file():
        raise EgoSpeedError(f"{path}: no such file; a speed in km/h, a CSV file or a folder of KITTI's oxts wanted.")
    return _from_csv(path)


def _from_csv(path: Path) -> EgoSpeed:
    table = read_csv_table(path, EgoSpeedError, "a header such as 'time_s,speed_kmh' and at least one row")
    units = [name for name in table.header if name in _UNITS]
    if "time_s" not in table or len(units) != 1:
        raise EgoSpeedError(
            f"{path}: its header is '{','.join(table.header)}'; expected the columns time_s and either speed_mps or "
            "speed_kmh: a speed needs a unit."
        )
    table.refuse_duplicates(table.header)
    if not len(table):
        raise EgoSpeedError(f"{path}: expected a header such as 'time_s,speed_kmh' and at least one row.")
    time_s, speed_mps = table.finite("time_s"), table.finite(units[0]) * _UNITS[units[0]]
    if (np.diff(time_s) <= 0).any():
        raise EgoSpeedError(f"{path}: the times must rise from row to row.")
    return EgoSpeed(time_s, _plausible(speed_mps, str(path)), path.name)


def _from_oxts(folder: Path) -> EgoSpeed:
    files = sorted(file for at in (folder, folder / "data") for file in at.glob("*.txt") if file.stem.isdigit())
    if not files:
        raise EgoSpeedError(f"{folder}: no files such as 0000000000.txt in this folder; KITTI's oxts wanted.")
    times_s = _oxts_times_s(folder)
    number = np.array([int(file.stem) for file in files])
    if number[-1] >= len(times_s):
        raise EgoSpeedError(f"{folder}: {files[-1].name} is there, but timestamps.txt has {len(times_s)} lines only.")
    speed_mps = np.array([_oxts_forward_mps(file) for file in files])
    return EgoSpeed(times_s[number], _plausible(speed_mps, str(folder)), folder.name)


def _oxts_times_s(folder: Path) -> FloatArray:
    """Seconds since the first of timestamps.txt, which stands in the folder or beside it."""
    for path in (folder / "timestamps.txt", folder.parent / "timestamps.txt"):
        if path.is_file():
            break
    else:
        raise EgoSpeedError(f"{folder}: no timestamps.txt in it or beside it, so nobody knows when its speeds were.")
    try:
        # Nanoseconds, of which datetime takes six digits.
        moments = [datetime.fromisoformat(line.strip()[:26]) for line in path.read_text("utf-8").splitlines() if line]
    except (OSError, ValueError) as error:
        raise EgoSpeedError(f"{path}: lines such as '2011-09-26 13:10:51.168593664' wanted ({error}).") from error
    times_s = np.array([(moment - moments[0]).total_seconds() for moment in moments])
    if (np.diff(times_s) <= 0).any():
        raise EgoSpeedError(f"{path}: the times must rise from line to line.")
    return times_s


def _oxts_forward_mps(file: Path) -> float:
    try:
        values = [float(word) for word in file.read_text("utf-8").split()]
    except (OSError, ValueError) as error:
        raise EgoSpeedError(f"{file}: {_OXTS_COLUMNS} numbers of KITTI's oxts wanted ({error}).") from error
    if len(values) != _OXTS_COLUMNS or not math.isfinite(values[_OXTS_FORWARD]):
        raise EgoSpeedError(f"{file}: {_OXTS_COLUMNS} finite numbers of KITTI's oxts wanted, {len(values)} found.")
    return values[_OXTS_FORWARD]


def _plausible(speed_mps: FloatArray, where: str) -> FloatArray:
    wrong = speed_mps[~(np.abs(speed_mps) <= _FASTEST_MPS)]
    if len(wrong):
        raise EgoSpeedError(f"{where}: {wrong[0] * 3.6:.0f} km/h is no speed of a car; is the unit right?")
    return speed_mps
