"""GPS logs of BlackVue dashcams beside a video: `[milliseconds]$GPRMC,...`; the files .3gf have accelerations only."""

from __future__ import annotations

import re
from pathlib import Path

from track_range.foundation.files.input_files import read_text
from track_range.recording.telemetry.errors import TelemetryError
from track_range.recording.telemetry.sidecars.nmea import MAX_NMEA_BYTES, fixes_in, nmea_track
from track_range.recording.telemetry.track import TelemetryTrack

_LINE = re.compile(r"^\[\d{10,16}\]\$", re.MULTILINE)


def read_blackvue(path: Path) -> TelemetryTrack | None:
    """Telemetry of a .gps file; None = it is another file, or has no RMC sentence.

    The times are those of the sentences, in UTC: the milliseconds are those of the camera's clock, in local time.

    Raises:
        TelemetryError: it cannot be read, or pynmea2 is not installed.
    """
    text = read_text(path, TelemetryError, "a GPS log of a BlackVue dashcam", max_bytes=MAX_NMEA_BYTES)
    if not _LINE.search(text):
        return None
    return nmea_track([fix for fix in fixes_in(text.splitlines(), str(path)) if fix is not None], path.name)
