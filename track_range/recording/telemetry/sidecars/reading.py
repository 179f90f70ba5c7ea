"""read_sidecar: telemetry of a file of any supported format, and the names of such files beside a video."""

from __future__ import annotations

import re
from pathlib import Path

from track_range.recording.telemetry.sidecars.blackvue import read_blackvue
from track_range.recording.telemetry.sidecars.gpx import read_gpx
from track_range.recording.telemetry.sidecars.nmea import read_nmea
from track_range.recording.telemetry.sidecars.seventymai import read_seventymai
from track_range.recording.telemetry.sidecars.speed_csv import read_csv
from track_range.recording.telemetry.sidecars.srt import read_srt
from track_range.recording.telemetry.track import TelemetryTrack

SUFFIXES = (".gpx", ".nmea", ".srt", ".csv", ".txt", ".gps")
"""Suffixes of telemetry beside a video, in the order in which they are looked for."""

TABLE_NAME, OXTS_NAME, SEVENTYMAI_NAME = "ego_speed.csv", "oxts", "GPSData000001.txt"
"""Names of telemetry beside a video that do not depend on the name of the video."""

_CAMERA_LETTER = re.compile(r"(?<=_[A-Z])[FRIO]$")
"""Letter of the camera at the end of the names of BlackVue videos; their logs have none: ..._NF.mp4, ..._N.gps."""


def sidecar_names(video: str) -> tuple[str, ...]:
    """Names, in order, of files with telemetry that may lie beside a video with this name, besides ego_speed.csv."""
    stem = video.rpartition(".")[0] or video
    stems = dict.fromkeys((stem, _CAMERA_LETTER.sub("", stem)))
    names = [f"{name}{suffix}" for suffix in SUFFIXES for name in stems]
    shown = [variant for name in names for variant in (name, _upper(name))]
    return (*shown, SEVENTYMAI_NAME)


def _upper(name: str) -> str:
    stem, point, suffix = name.rpartition(".")
    return f"{stem}{point}{suffix.upper()}"


def read_sidecar(path: Path, video: str, duration_s: float) -> TelemetryTrack | None:
    """Telemetry of a file, by its suffix; None = the file has none.

    Args:
        path: the file.
        video: name of the video file to which it belongs.
        duration_s: length of the video; 0 = unknown.

    Raises:
        TelemetryError: it cannot be read or used.
    """
    suffix = path.suffix.lower()
    if suffix == ".gpx":
        return read_gpx(path)
    if suffix == ".srt":
        return read_srt(path)
    if suffix == ".csv":
        return read_csv(path)
    if suffix == ".nmea":
        return read_nmea(path)
    return read_blackvue(path) or read_seventymai(path, video, duration_s) or read_nmea(path)
