"""telemetry.csv: positions, speeds and courses of a recording, written only with --keep-gps."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from track_range.foundation.files.output_files import write_text
from track_range.recording.telemetry.track import TelemetryTrack

TELEMETRY_FILE = "telemetry.csv"  # name of the file in the folder of a run

HEADER = "time_s,latitude_deg,longitude_deg,speed_mps,course_deg"

_MARGIN_S = 1.0  # time before the first and after the last frame of which samples are written, s


def write_positions(path: Path, track: TelemetryTrack, *, first_s: float, last_s: float) -> None:
    """Write the samples between two times of a recording; an empty cell = unknown.

    Raises:
        OutputError: the file cannot be written.
    """
    during = (track.time_s >= first_s - _MARGIN_S) & (track.time_s <= last_s + _MARGIN_S)
    columns = (
        (track.time_s, 3),
        (track.latitude_deg, 7),
        (track.longitude_deg, 7),
        (track.speed_mps, 3),
        (np.degrees(track.course_rad), 2),
    )
    rows = zip(*(_texts(values[during].tolist(), decimals) for values, decimals in columns), strict=True)
    write_text(path, "\n".join([HEADER, *(",".join(row) for row in rows)]) + "\n")


def _texts(values: list[float], decimals: int) -> list[str]:
    return ["" if math.isnan(value) else f"{value:.{decimals}f}" for value in values]
