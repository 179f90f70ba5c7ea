"""read_sidecar: telemetry of a file of any supported format, and the names of such files beside a
video.

A format is a module with a `Sidecar` and a row of `SIDECARS`, or an entry point of the group
`track_range.sidecars`.
"""

import re
from contextlib import suppress
from pathlib import Path

from track_range.foundation.errors import UserError
from track_range.foundation.files.input_files import first_line
from track_range.foundation.registry import Registry
from track_range.recording.telemetry.sidecars.sidecar import Sidecar
from track_range.recording.telemetry.tracks.signal_choice import ANY_SIGNAL, SignalChoice
from track_range.recording.telemetry.tracks.track import TelemetryError, TelemetryTrack

# speeds beside a video that are no telemetry: a table, KITTI's folder
TABLE_NAME, OXTS_NAME = "ego_speed.csv", "oxts"


SIDECARS = Registry(
    "track_range.sidecars",
    {
        "gpx": "track_range.recording.telemetry.sidecars.gpx:GPX",
        "nmea": "track_range.recording.telemetry.sidecars.nmea:NMEA",
        "srt": "track_range.recording.telemetry.sidecars.srt:SRT",
        "csv": "track_range.recording.telemetry.sidecars.speed_csv:CSV",
        "vbo": "track_range.recording.telemetry.sidecars.vbo:VBO",
        "xml": "track_range.recording.telemetry.sidecars.xml_tracks:XML_TRACK",
        "fit": "track_range.recording.telemetry.sidecars.fit:FIT",
        "mdf": "track_range.recording.telemetry.sidecars.signal_logs:MDF",
        "can": "track_range.recording.telemetry.sidecars.signal_logs:FRAMES",
        "70mai": "track_range.recording.telemetry.sidecars.seventymai:SEVENTYMAI",
        "nmea-text": "track_range.recording.telemetry.sidecars.nmea:NMEA_TEXT",
        "text-log": "track_range.recording.telemetry.sidecars.speed_csv:TEXT_LOG",
    },
    Sidecar,
    error=TelemetryError,
)

# of tables of times and speeds, too (`--ego-speed FILE`)
SPEED_TABLE_SUFFIXES = (".csv", ".tsv", ".txt")
# BlackVue's letter of the camera, which its logs lack
_CAMERA_LETTER = re.compile(r"(?<=_[A-Z])[FRIO]$")


def sidecar_suffixes() -> tuple[str, ...]:
    """Suffixes of files with telemetry, in the order in which they are looked for."""
    return tuple(dict.fromkeys(end for form in SIDECARS.by_priority for end in form.suffixes))


def sidecar_names(video: str) -> tuple[str, ...]:
    """Names, in order, of files with telemetry that may lie beside a video with this name, besides
    ego_speed.csv.
    """
    stem = video.rpartition(".")[0] or video
    stems = dict.fromkeys((stem, _CAMERA_LETTER.sub("", stem)))
    names = [
        f"{name}{shown}"
        for suffix in sidecar_suffixes()
        for name in stems
        for shown in (suffix, suffix.upper())
    ]
    return (*names, *(form.file_name for form in SIDECARS.by_priority if form.file_name))


def signal_suffixes() -> tuple[str, ...]:
    """Suffixes of logs with many signals, of which the user may name one."""
    forms = [form for form in SIDECARS.by_priority if form.read_signal is not None]
    return tuple(end for form in forms for end in form.suffixes)


def read_sidecar(
    path: Path, video: str, duration_s: float, choice: SignalChoice = ANY_SIGNAL
) -> TelemetryTrack | None:
    """Telemetry of a file, by its suffix; None = it has none.

    The video to which it belongs has the name `video`, and lasts `duration_s`; 0 = unknown. A
    TelemetryError means that the file cannot be read or used.
    """
    suffix = path.suffix.lower()

    def answer(form: Sidecar) -> TelemetryTrack | None:
        if suffix not in form.suffixes:
            return None
        if form.read_signal is not None:
            return form.read_signal(path, choice)
        return form.read(path, video, duration_s)

    tracks = SIDECARS.answers(answer, is_last_raised=True)
    return next((track for _, track in tracks if track is not None), None)


_KINDS = (  # files without telemetry that can be read: pattern of name or first line, what it is
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
        re.compile(
            r"\.(dbc|trc)$|^\(\d+\.\d+\) +\w+ +[\dA-F]+#|^;\$FILEVERSION",
            re.IGNORECASE,
        ),
        "a log of a CAN bus; convert it to BLF with `python -m can.logconvert`, or export the speed "
        "as CSV with its unit in the heading",
    ),
    (
        re.compile(r"^%DataLog%"),
        "a log of Haltech, whose channels have no header; export it as CSV with the speed and its "
        "unit in the heading",
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
    texts = [path.name]
    with suppress(UserError, OSError):  # no text
        texts.append(first_line(path, TelemetryError, "a log"))
    return next((kind for p, kind in _KINDS if any(map(p.search, texts))), "")
