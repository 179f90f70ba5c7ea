"""GPS logs of 70mai dashcams (GPSData000001.txt): `$V02`, then a line per fix with the name of the
video.

    seconds,A|V,latitude,longitude,course in 0.01 deg,speed in 0.01 m/s,gx,gy,gz,VIDEO.MP4,0,0,0

The seconds are since 1970, of a clock whose time zone is unknown and which differs from the clock
of the videos' names. The rows of a video follow the rows of the previous video, which gives the
start of the video to about a second.
"""

import math
from pathlib import Path

import numpy as np

from track_range.foundation.files.input_files import first_line, read_text
from track_range.foundation.files.numeric_text import numbers
from track_range.recording.telemetry.sidecars.sidecar import Sidecar
from track_range.recording.telemetry.tracks.samples import plain_track
from track_range.recording.telemetry.tracks.track import (
    MAX_SIDECAR_BYTES,
    TelemetryError,
    TelemetryTrack,
)

_N_CELLS = 10
_MAX_STEP_S = 5.0  # longest time from one video to the next, if the recording did not stop between
# degrees and m/s per unit, by several models' users and parked cars
_COURSE_SCALE, _SPEED_SCALE = 0.01, 0.01


def read_seventymai(path: Path, video: str, duration_s: float) -> TelemetryTrack | None:
    """Telemetry of a video in a log of 70mai; None = the file is another text.

    If the log has no rows of the video, all rows are used. A length of 0 = unknown. Raises
    TelemetryError.
    """
    if not first_line(path, TelemetryError, "a log of a 70mai dashcam").startswith("$V0"):
        return None
    text = read_text(path, TelemetryError, "a log of a 70mai dashcam", max_bytes=MAX_SIDECAR_BYTES)
    cells = [line.split(",") for line in text.splitlines()]
    rows = [row for row in cells if len(row) >= _N_CELLS and row[1] in ("A", "V")]
    values = np.array([[*numbers(row[:1]), *numbers(row[2:6])] for row in rows]).reshape(-1, 5)
    is_dated = np.isfinite(values[:, 0]) & (values[:, 0] > 0)
    own = [
        index for index, row in enumerate(rows) if _base(row[9]) == _base(video) and is_dated[index]
    ]
    index = np.array(own or np.flatnonzero(is_dated), np.int64)
    if not len(index):
        return None
    start_s = _start_s(values[:, 0], own, duration_s) if own else math.nan
    is_timed = math.isfinite(start_s)
    has_fix = np.array([rows[i][1] == "A" for i in index.tolist()])
    lat, lon, course, speed = (
        np.where(has_fix, values[index, column], np.nan) for column in range(1, 5)
    )
    utc_s = values[index, 0]
    time_s = utc_s - (start_s if is_timed else 0.0)
    samples = np.column_stack(
        [time_s, utc_s, np.abs(speed) * _SPEED_SCALE, course * _COURSE_SCALE, lat, lon]
    )
    return plain_track(samples, path.name, "video" if is_timed else "local")


def _start_s(seconds: np.ndarray, own: list[int], duration_s: float) -> float:
    """Time of the log at the start of the video with the rows `own`; NaN = unknown."""
    first, last = own[0], own[-1]
    if first > 0 and 0 < seconds[first] - seconds[first - 1] <= _MAX_STEP_S:
        return float(seconds[first])
    if (
        duration_s > 0
        and last + 1 < len(seconds)
        and 0 < seconds[last + 1] - seconds[last] <= _MAX_STEP_S
    ):
        return float(seconds[last + 1] - duration_s)
    return math.nan


def _base(name: str) -> str:
    """Name of a video without its suffix and the letter of the camera."""
    return name.strip().rpartition(".")[0].rstrip("FBRI").lower()


SEVENTYMAI = Sidecar(
    suffixes=(".txt", ".gps"),
    read=read_seventymai,
    file_name="GPSData000001.txt",
    priority=-20,
)
