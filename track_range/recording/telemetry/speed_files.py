"""open_ego_speed: the speed of the camera as a number, in a table, or in a folder of a data set.

50                          constant speed in km/h
FILE.csv                    columns time_s (seconds from the video's first frame) and speed_mps or speed_kmh
OXTS_DIR                    KITTI GPS/IMU folder: NNNNNNNNNN.txt per frame, with the forward speed vf in m/s as the 9th
                            value, and timestamps.txt in it or next to it (Geiger et al., IJRR 2013)
COMMA_DIR                   processed_log of comma2k19: CAN/speed/t and value, global_pose/frame_times (Schafer et al.,
                            2018)
"""

import math
import os
from datetime import datetime
from pathlib import Path

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import UserError
from track_range.foundation.files.csv_tables import read_csv_table
from track_range.foundation.files.input_files import MAX_TABLE_BYTES, quoted, read_text, shortened
from track_range.foundation.files.numeric_text import number, numbers
from track_range.stereo.speed.ego_speed import MAX_SPEED_MPS, EgoSpeed

_MPS_PER_KMH = 1 / 3.6
_MAX_TIME_S = 1e10  # largest absolute time; seconds since 1970 are smaller
_OVER_GROUND = "speed_over_ground_mps"  # column of a table whose speeds are along the camera's axis
_UNITS = {"speed_mps": 1.0, "speed_kmh": _MPS_PER_KMH}  # factor from each speed column to m/s
# of a constant speed; assumed: one that a person reads from a speedometer
_CONSTANT_SIGMA_MPS = 1.0
# forward speed vf, latitude and longitude in a line of KITTI oxts
_OXTS_FORWARD, _OXTS_POSITION = 8, slice(0, 2)
OXTS_TIMES = "timestamps.txt"  # in a folder of KITTI oxts, or beside it
_COMMA_SPEED = "CAN/speed"  # folder with times and speeds of a segment of comma2k19
_OXTS_COLUMNS = 30  # number of values in a line of KITTI oxts


class EgoSpeedError(UserError):
    """An ego speed that cannot be used; the message gives the reason."""


def open_ego_speed(text: str) -> EgoSpeed:
    """Ego speed from a number in km/h, a CSV file or a folder of KITTI oxts files.

    Raises EgoSpeedError: `text` is neither a number, a file nor a folder, or the file or folder
    cannot be used.
    """
    kmh, path = number(text), Path(text)
    if not math.isnan(kmh) or text.strip().lower() == "nan":
        speed_mps = _plausible(np.array([kmh]) * _MPS_PER_KMH, "--ego-speed")
        return EgoSpeed(np.array([-np.inf]), speed_mps, f"{kmh:g} km/h", _CONSTANT_SIGMA_MPS)
    if os.path.isdir(path):  # unlike Path.is_dir, False for a name that is too long
        return _from_comma(path) if (path / _COMMA_SPEED).is_dir() else _from_oxts(path)
    if os.path.lexists(path):
        return _from_csv(path)
    is_decimal = math.isfinite(number(text.replace(",", ".")))
    raise EgoSpeedError(
        f"{shortened(str(path))}: no such file; expected a speed in km/h, a CSV file or a folder "
        f"of KITTI oxts files{'; write decimals with a point' if is_decimal else ''}."
    )


def _from_csv(path: Path) -> EgoSpeed:
    expected = "a header such as 'time_s,speed_kmh' and at least one row"
    table = read_csv_table(path, EgoSpeedError, expected, exact=True)
    units = [name for name in table.header if name in _UNITS]
    if "time_s" not in table or len(units) != 1:
        raise EgoSpeedError(
            f"{path}: expected the columns time_s and either speed_mps or speed_kmh, got "
            f"{shortened(','.join(table.header))}."
        )
    table.refuse_duplicates(table.header)
    if not len(table):
        raise EgoSpeedError(f"{path}: expected at least one row below the header, got none.")
    time_s, speed_mps = table.finite("time_s"), table.finite(units[0]) * _UNITS[units[0]]
    table.check("time_s", np.abs(time_s) <= _MAX_TIME_S, "seconds from the first frame")
    if (np.diff(time_s) <= 0).any():
        raise EgoSpeedError(
            f"{path}: expected time_s to increase from row to row; sort the rows "
            "and drop duplicates."
        )
    over_ground_mps = None
    if _OVER_GROUND in table:
        over_ground_mps = _plausible(table.finite(_OVER_GROUND), str(path))
    speed_mps = _plausible(speed_mps, str(path))
    return EgoSpeed(time_s, speed_mps, path.name, over_ground_mps=over_ground_mps)


def _from_oxts(folder: Path) -> EgoSpeed:
    files = sorted(
        file
        for part in (folder, folder / "data")
        for file in part.glob("*.txt")
        if file.stem.isdecimal()
    )
    if not files:
        raise EgoSpeedError(
            f"{folder}: expected KITTI oxts files such as 0000000000.txt, or the files of a bag, "
            "found none."
        )
    paths = [
        path / OXTS_TIMES for path in (folder, folder.parent) if os.path.lexists(path / OXTS_TIMES)
    ]
    if not paths:
        raise EgoSpeedError(
            f"{folder}: expected a timestamps.txt in this folder or next to it, found none."
        )
    lines = read_text(paths[0], EgoSpeedError, "timestamps", max_bytes=MAX_TABLE_BYTES).split("\n")
    moments = []
    for i, line in [(i, line.strip()) for i, line in enumerate(lines, start=1) if line.strip()]:
        try:
            # The file has nanoseconds, datetime reads microseconds: 26 characters. A time zone is
            # ignored.
            moments.append(datetime.fromisoformat(line[:26]).replace(tzinfo=None))
        except ValueError as error:
            raise EgoSpeedError(
                f"{paths[0]}, line {i}: expected a time such as '2011-09-26 13:10:51.168593664', "
                f"got {quoted(line)}."
            ) from error
    times_s = np.array([(moment - moments[0]).total_seconds() for moment in moments])
    if (np.diff(times_s) <= 0).any():
        raise EgoSpeedError(f"{paths[0]}: expected times that increase from line to line.")
    frames = [int(file.stem) for file in files]
    if max(frames) >= len(times_s):
        raise EgoSpeedError(
            f"{folder}: expected a line in timestamps.txt for each oxts file, got {len(times_s)} "
            f"lines but a file {files[-1].name}."
        )
    rows = np.array([_oxts_values(file) for file in files])
    speed_mps = np.concatenate(
        [_plausible(rows[i, [_OXTS_FORWARD]], str(file)) for i, file in enumerate(files)]
    )
    return EgoSpeed(
        times_s[np.array(frames)], speed_mps, folder.name, positions_deg=rows[:, _OXTS_POSITION]
    )


def _from_comma(folder: Path) -> EgoSpeed:
    """Speed of the car's wheels in a segment of comma2k19, whose files are NumPy arrays without
    suffix.
    """
    try:
        time_s, speed_mps, frame_s = (
            np.load(folder / name, allow_pickle=False).ravel().astype(np.float64)
            for name in (f"{_COMMA_SPEED}/t", f"{_COMMA_SPEED}/value", "global_pose/frame_times")
        )
    except (OSError, ValueError, EOFError) as error:
        raise EgoSpeedError(
            f"{folder}: expected arrays of NumPy in {_COMMA_SPEED} and global_pose/frame_times, as "
            "in comma2k19, found missing or damaged arrays."
        ) from error
    if not len(frame_s) or len(time_s) != len(speed_mps) or not (np.diff(time_s) > 0).all():
        raise EgoSpeedError(
            f"{folder}: expected increasing times with one speed each, found other values."
        )
    return EgoSpeed(time_s - frame_s[0], _plausible(speed_mps, str(folder)), folder.name)


def _oxts_values(file: Path) -> list[float]:
    cells = read_text(file, EgoSpeedError, "a KITTI oxts file").split()
    unreadable = [
        cell for cell, value in zip(cells, numbers(cells), strict=True) if not math.isfinite(value)
    ]
    if len(cells) != _OXTS_COLUMNS or unreadable:
        given = quoted(unreadable[0]) if len(cells) == _OXTS_COLUMNS else f"{len(cells)} numbers"
        raise EgoSpeedError(
            f"{file}: expected the {_OXTS_COLUMNS} finite numbers of a KITTI oxts "
            f"file, got {given}."
        )
    return numbers(cells)


def _plausible(speed_mps: FloatArray, where: str) -> FloatArray:
    """`speed_mps`, if all values are plausible; raises an EgoSpeedError that begins with `where`
    otherwise.
    """
    implausible = speed_mps[~(np.abs(speed_mps) <= MAX_SPEED_MPS)]
    if len(implausible):
        raise EgoSpeedError(
            f"{where}: expected a speed of at most {MAX_SPEED_MPS * 3.6:.0f} km/h, got "
            f"{float(implausible[0]) * 3.6:.6g} km/h; check the unit."
        )
    return speed_mps
