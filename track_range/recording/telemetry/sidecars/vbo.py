"""VBO files of Racelogic's VBOX and of apps: columns separated by spaces, times in UTC, positions
in minutes.

Source: Racelogic, "VBO File Format". Longitudes are positive in the west.
"""

import math
import re
from pathlib import Path

import numpy as np

from track_range.foundation.files.input_files import read_text
from track_range.foundation.files.numeric_text import number
from track_range.recording.telemetry.sidecars.sidecar import Sidecar, of_file
from track_range.recording.telemetry.sidecars.time_texts import unwrapped
from track_range.recording.telemetry.tracks.positions import MPS_PER_UNIT
from track_range.recording.telemetry.tracks.samples import Sample, date_s, plain_track, unit_in
from track_range.recording.telemetry.tracks.track import (
    MAX_SIDECAR_BYTES,
    TelemetryError,
    TelemetryTrack,
)

_SECTION = re.compile(r"^\[([^\]\n]{1,40})\]\s*$", re.MULTILINE)
_VELOCITY = re.compile(r"^velocity.*$", re.IGNORECASE | re.MULTILINE)
_CREATED = re.compile(r"created on (\d{1,2})/(\d{1,2})/(\d{4})", re.IGNORECASE)


def read_vbo(path: Path) -> TelemetryTrack | None:
    """Telemetry of a VBO file; None for other files. Raises TelemetryError if it cannot be read."""
    parts = _SECTION.split(
        read_text(path, TelemetryError, "a VBO file", max_bytes=MAX_SIDECAR_BYTES)
    )
    sections = dict(zip((name.lower() for name in parts[1::2]), parts[2::2], strict=True))
    names = sections.get("column names", "").lower().split()
    if not {"time", "velocity"} <= set(names) or "data" not in sections:
        return None
    stated = " ".join(_VELOCITY.findall(sections.get("header", "")))
    unit, notes = unit_in(stated) or "km/h", tuple[str, ...]()
    if unit_in(stated) is None:
        notes = (
            "its header states no unit of the velocity; km/h is assumed, as Racelogic writes.",
        )
    rows = [
        dict(zip(names, line.split(), strict=False))
        for line in sections["data"].splitlines()
        if line.strip()
    ]
    clock_s = unwrapped(np.array([_clock_s(row.get("time", "")) for row in rows]))
    dates = [row.get("date", "") for row in rows]
    created = _CREATED.search(parts[0])
    start_s = next(
        (
            date_s(number(d[4:]), number(d[2:4]), number(d[:2]), 0, 0, 0)
            for d in dates
            if len(d) == 6
        ),
        math.nan,
    )
    if math.isnan(start_s) and created:
        start_s = date_s(number(created[3]), number(created[2]), number(created[1]), 0, 0, 0)
    samples = []
    for row, second in zip(rows, clock_s.tolist(), strict=True):
        utc_s = second + (start_s if math.isfinite(start_s) else 0.0)
        lat, long, velocity, course = (
            number(row.get(name, "")) for name in ("lat", "long", "velocity", "heading")
        )
        samples.append(
            Sample(utc_s, utc_s, velocity * MPS_PER_UNIT[unit], course, lat / 60, -long / 60)
        )
    dated = [sample for sample in samples if math.isfinite(sample.time_s)]
    return plain_track(dated, path.name, "utc", unit=unit, notes=notes) if dated else None


def _clock_s(text: str) -> float:
    """Seconds since midnight of HHMMSS.SS; NaN for other texts."""
    value = number(text)
    if not 0 <= value < 240_000:
        return math.nan
    return 3600.0 * (value // 10_000) + 60.0 * (value // 100 % 100) + value % 100


VBO = Sidecar(suffixes=(".vbo",), read=of_file(read_vbo), priority=-10)
