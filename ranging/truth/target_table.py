"""TargetTable: ground truth without boxes, from logs of RTK, lidar or radar, or boxes of a map.

    time_s,target,range_m[,range_rate_mps,lateral_m]            relative to the sensor
    time_s,target,x_m,y_m[,heading_deg,length_m,width_m]        in a map, with a table of poses

    time_s          of the clock of the log; or utc_s, seconds since 1970; or frame, numbers of the video
    target          any name or number; one per object
    range_m         straight distance from the sensor to the nearest point; or forward_m, along its axis
    range_rate_mps  its change, negative when approaching; or closing_mps, the opposite
    lateral_m       offset to the left; or right_m, to the right
    poses           time_s,x_m,y_m,heading_deg of the sensor in the map, heading from x towards y

`ahead_m` is the position of the sensor (or of the point of the poses) ahead of the camera. True
distances are along the axis of the camera. Of boxes in a map they are those of the visible surface,
with length and width, and otherwise those of the centre.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.files.csv_tables import CsvTable, read_csv_table
from track_range.ranging.truth.reference_distance import surface_distance_m

_CLOCKS = ("time_s", "utc_s", "frame")
_RELATIVE, _MAP = ("range_m", "forward_m"), ("x_m", "y_m")
_EXPECTED = (
    "a column time_s, utc_s or frame, a column target, and range_m, forward_m, or x_m and y_m"
)
_MAX_GAP_S = 1.0  # between two rows of a target, across which its values are interpolated
_MAX_GAP_FRAMES = 30.0


@dataclass(frozen=True, slots=True)
class TargetTable:
    """Targets in the axes of the camera, one row per target and moment, by target and time."""

    path: Path
    clock: str  # "time_s", "utc_s" or "frame"
    names: tuple[str, ...]  # of the targets
    target: IntArray  # (N,) index into `names`
    time: FloatArray  # (N,) of the clock
    values: FloatArray  # (3, N) distance ahead, offset to the right, closing speed; NaN = unknown
    # time of the video minus that of the log; None = to be estimated
    offset_s: float | None = None

    def check_clock(self, *, has_utc: bool) -> None:
        """LabelFileError for times of day, if those of the video are unknown."""
        if self.clock == "utc_s" and not has_utc:
            raise LabelFileError(
                f"{self.path}: utc_s needs the time of the video, which is unknown; give --start-utc, "
                "or a column time_s."
            )

    def at(self, number: int, time: FloatArray) -> FloatArray:
        """(3, M) values of a target at the times (M,) of its clock; NaN where it has none."""
        rows = self.target == number
        own, values = self.time[rows], self.values[:, rows]
        after = np.clip(np.searchsorted(own, time), 1, max(len(own) - 1, 1))
        gap = own[np.minimum(after, len(own) - 1)] - own[after - 1]
        largest = _MAX_GAP_FRAMES if self.clock == "frame" else _MAX_GAP_S
        is_known = (time >= own[0]) & (time <= own[-1]) & (gap <= largest)
        return np.where(is_known, [np.interp(time, own, part) for part in values], np.nan)


def is_target_table(header: Sequence[str]) -> bool:
    """Whether the columns of a CSV file are those of targets without boxes."""
    names = {name.strip().lower() for name in header}
    if names & {"x1", "x1_px"}:
        return False
    if "target" in names:  # a wrong name of a distance is said by the reader
        return not names.isdisjoint((*_CLOCKS, *_RELATIVE, *_MAP))
    has_place = bool(names & set(_RELATIVE)) or set(_MAP) <= names
    return has_place and "id" in names


def read_targets(
    path: Path,
    *,
    poses: Path | None = None,
    ahead_m: float = 0.0,
    offset_s: float | None = None,
) -> TargetTable:
    """The targets of a table. LabelFileError: a file cannot be read, a column is missing, a number
    is none, or places in a map have no poses.
    """
    table = read_csv_table(path, LabelFileError, _EXPECTED)
    clock = next((name for name in _CLOCKS if name in table), "time_s")
    name = "target" if "target" in table else "id"
    table.require((clock, name))
    texts = np.array(table.texts(name), np.str_)
    order = np.lexsort((table.finite(clock), texts))
    names, target = np.unique(texts[order], return_inverse=True)
    time, target = table.finite(clock)[order], target.reshape(-1)
    _check_rows(path, texts[order], time)
    is_relative = any(column in table for column in _RELATIVE)
    if not is_relative:
        table.require(_MAP)
    if clock == "frame" and offset_s:
        raise LabelFileError(f"{path}: --truth-offset-s is for times; its rows have frame numbers.")
    if is_relative:
        values = _relative(table)
    elif poses is None:
        raise LabelFileError(
            f"{path}: places in a map need the poses of the camera; give --truth-poses with a "
            "table time_s,x_m,y_m,heading_deg."
        )
    else:
        values = _of_map(table, clock, poses)
    values[0] += ahead_m
    return TargetTable(
        path=path,
        clock=clock,
        names=tuple(map(str, names)),
        target=target,
        time=time,
        values=values[:, order],
        offset_s=0.0 if clock == "frame" else offset_s,
    )


def _check_rows(path: Path, names: npt.NDArray[np.str_], time: FloatArray) -> None:
    """LabelFileError without rows, and for a target in two places at once (rows by target and time)."""
    if not len(time):
        raise LabelFileError(f"{path}: expected a row per target and moment, found none.")
    is_repeated = (names[1:] == names[:-1]) & (np.diff(time) == 0)
    for row in np.flatnonzero(is_repeated)[:1].tolist():
        raise LabelFileError(
            f"{path}: expected each target once per moment, found {names[row]} twice at "
            f"{time[row]:g}; give each object its own name."
        )


def _relative(table: CsvTable) -> FloatArray:
    """(3, N) values from the sensor's own measurements."""
    right_m = table.numbers("right_m") if "right_m" in table else -table.numbers("lateral_m")
    if "forward_m" in table:
        forward_m = table.finite("forward_m")
    else:
        range_m = table.finite("range_m")
        across_m = np.minimum(np.abs(np.nan_to_num(right_m)), range_m)
        forward_m = np.sqrt(range_m**2 - across_m**2)
    is_closing = "closing_mps" in table
    speed_mps = table.numbers("closing_mps" if is_closing else "range_rate_mps")
    return np.stack([forward_m, right_m, speed_mps if is_closing else -speed_mps])


def _of_map(table: CsvTable, clock: str, poses: Path) -> FloatArray:
    """(3, N) values from places in a map and the poses of the camera at their times."""
    ego = read_csv_table(poses, LabelFileError, f"columns {clock},x_m,y_m,heading_deg")
    ego.require((clock, *_MAP, "heading_deg"))
    order, time = np.argsort(ego.finite(clock)), table.finite(clock)
    heading_rad = np.unwrap(np.radians(ego.finite("heading_deg")[order]))
    parts = [ego.finite("x_m")[order], ego.finite("y_m")[order], heading_rad]
    known_s = ego.finite(clock)[order]
    x_m, y_m, heading = (np.interp(time, known_s, part, np.nan, np.nan) for part in parts)
    east_m, north_m = table.finite("x_m") - x_m, table.finite("y_m") - y_m
    cos, sin = np.cos(heading), np.sin(heading)
    forward_m, right_m = cos * east_m + sin * north_m, sin * east_m - cos * north_m
    unknown = np.full(len(time), np.nan)
    if "length_m" not in table:
        return np.stack([forward_m, right_m, unknown])
    # a box 2 m high around the plane of the ray, in KITTI's convention
    turned = np.radians(table.finite("heading_deg")) - heading
    height_m, level_m = np.full(len(time), 2.0), np.ones(len(time))
    rays = np.stack([right_m / forward_m, 0 * right_m, level_m], axis=1)
    surface_m = surface_distance_m(
        rays,
        np.stack([right_m, level_m, forward_m], axis=1),
        size_hwl_m=np.stack([height_m, table.finite("width_m"), table.finite("length_m")], axis=1),
        rotation_y_rad=np.arctan2(-np.cos(turned), -np.sin(turned)),
    )
    return np.stack([np.where(forward_m > 0, surface_m, np.nan), right_m, unknown])
