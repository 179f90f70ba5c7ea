"""read_sidecar: telemetry of a file of any supported format, and the names of such files beside a
video.

A format is a module with a reader, and a row of `SIDECARS`.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from track_range.recording.telemetry.sidecars.fit import read_fit
from track_range.recording.telemetry.sidecars.gpx import read_gpx
from track_range.recording.telemetry.sidecars.nmea import read_nmea
from track_range.recording.telemetry.sidecars.seventymai import read_seventymai
from track_range.recording.telemetry.sidecars.speed_csv import read_csv
from track_range.recording.telemetry.sidecars.srt import read_srt
from track_range.recording.telemetry.sidecars.vbo import read_vbo
from track_range.recording.telemetry.sidecars.xml_tracks import read_xml_track
from track_range.recording.telemetry.tracks.track import TelemetryTrack

# speeds beside a video that are no telemetry: a table, KITTI's folder
TABLE_NAME, OXTS_NAME = "ego_speed.csv", "oxts"


class Sidecar(NamedTuple):
    """Suffixes and reader of a format, which returns None for files without telemetry or of another
    format.
    """

    suffixes: tuple[str, ...]
    read: Callable[[Path, str, float], TelemetryTrack | None]
    name: str = ""  # of a file that does not have the name of the video


SIDECARS = (  # in the order in which their files are looked for, and in which a file is tried
    Sidecar((".gpx",), lambda path, video, duration_s: read_gpx(path)),
    Sidecar((".nmea", ".log"), lambda path, video, duration_s: read_nmea(path)),
    Sidecar((".srt",), lambda path, video, duration_s: read_srt(path)),
    Sidecar((".csv", ".tsv"), lambda path, video, duration_s: read_csv(path)),
    Sidecar((".vbo",), lambda path, video, duration_s: read_vbo(path)),
    Sidecar((".tcx", ".kml"), lambda path, video, duration_s: read_xml_track(path)),
    Sidecar((".fit",), lambda path, video, duration_s: read_fit(path)),
    Sidecar((".txt", ".gps"), read_seventymai, name="GPSData000001.txt"),
    Sidecar((".txt", ".gps"), lambda path, video, duration_s: read_nmea(path)),
)

SUFFIXES = tuple(dict.fromkeys(suffix for sidecar in SIDECARS for suffix in sidecar.suffixes))

# of tables of times and speeds, too (`--ego-speed FILE`)
SPEED_TABLE_SUFFIXES = (".csv", ".tsv", ".txt")
# BlackVue's letter of the camera, which its logs lack
_CAMERA_LETTER = re.compile(r"(?<=_[A-Z])[FRIO]$")


def sidecar_names(video: str) -> tuple[str, ...]:
    """Names, in order, of files with telemetry that may lie beside a video with this name, besides
    ego_speed.csv.
    """
    stem = video.rpartition(".")[0] or video
    stems = dict.fromkeys((stem, _CAMERA_LETTER.sub("", stem)))
    names = [
        f"{name}{shown}"
        for suffix in SUFFIXES
        for name in stems
        for shown in (suffix, suffix.upper())
    ]
    return (*names, *(sidecar.name for sidecar in SIDECARS if sidecar.name))


def read_sidecar(path: Path, video: str, duration_s: float) -> TelemetryTrack | None:
    """Telemetry of a file, by its suffix; None = it has none.

    The video to which it belongs has the name `video`, and lasts `duration_s`; 0 = unknown. A
    TelemetryError means that the file cannot be read or used.
    """
    readers = [sidecar.read for sidecar in SIDECARS if path.suffix.lower() in sidecar.suffixes]
    tracks = (read(path, video, duration_s) for read in readers)
    return next((track for track in tracks if track is not None), None)


_KINDS = (  # files without telemetry that can be read: pattern of the name, and what it is
    (
        re.compile(r"event\.json$", re.IGNORECASE),
        "Tesla's event.json, which states one position and no speed; videos from 2025 on contain "
        "the speed",
    ),
    (
        re.compile(r"[rq]log(\.bz2|\.zst)?$", re.IGNORECASE),
        "a log of openpilot; give the folder processed_log of comma2k19, or its speeds as CSV",
    ),
    (
        re.compile(r"\.(mf4|mdf|blf|asc|dbc)$", re.IGNORECASE),
        "a log of a CAN bus; export the speed as CSV with its unit in the heading",
    ),
    (
        re.compile(r"\.(ubx|rtcm3?|sbf)$", re.IGNORECASE),
        "raw data of a GPS receiver; convert it to NMEA",
    ),
    (
        re.compile(r"\.(ulg|tlog|bin|dat)$", re.IGNORECASE),
        "a binary log; export the speed as CSV with its unit in the heading",
    ),
    (re.compile(r"\.kmz$", re.IGNORECASE), "a compressed KML file; unpack it"),
    (
        re.compile(r"\.(json|geojson)$", re.IGNORECASE),
        "JSON, which is not read; export the speed as CSV or GPX",
    ),
)


def kind_of(path: Path) -> str:
    """Probable kind of a file that is not read, and advice, for a message after "found"; empty =
    unknown.
    """
    return next((kind for pattern, kind in _KINDS if pattern.search(path.name)), "")
