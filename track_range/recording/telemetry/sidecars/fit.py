"""FIT files of Garmin and other sports computers, read with fitdecode: records with position and
speed.
"""

import math
from pathlib import Path
from typing import Any

from track_range.foundation.files.numeric_text import plain_number
from track_range.recording.telemetry.sidecars.sidecar import Sidecar, of_file
from track_range.recording.telemetry.tracks.samples import MAX_SAMPLES, Sample, track
from track_range.recording.telemetry.tracks.track import (
    TelemetryError,
    TelemetryTrack,
    optional_package,
)

_DEGREES = 180 / 2**31  # per semicircle, the unit of positions


def read_fit(path: Path) -> TelemetryTrack | None:
    """Telemetry of a FIT file in UTC; None = it has none.

    Raises TelemetryError if it cannot be read, or fitdecode is not installed.
    """
    fitdecode = optional_package("fitdecode", str(path))
    samples: list[Sample] = []
    try:
        with fitdecode.FitReader(str(path), check_crc=fitdecode.CrcCheck.DISABLED) as records:
            for record in records:
                if isinstance(record, fitdecode.FitDataMessage) and record.name == "record":
                    samples.append(_sample(record))
                if len(samples) >= MAX_SAMPLES:
                    break
    except Exception as error:  # fitdecode's errors, and those of damaged fields
        if not samples:
            raise TelemetryError(
                f"{path}: expected a FIT file, found another format or a damaged file."
            ) from error
    return track(
        samples, path.name, "utc", has_own_speed=any(math.isfinite(s.speed_mps) for s in samples)
    )


def _sample(record: Any) -> Sample:
    speed, enhanced, lat, lon = (
        plain_number(record.get_value(name, fallback=None))
        for name in ("speed", "enhanced_speed", "position_lat", "position_long")
    )
    moment = record.get_value("timestamp", fallback=None)
    utc_s = moment.timestamp() if hasattr(moment, "timestamp") else math.nan
    return Sample(
        utc_s,
        utc_s,
        speed if math.isnan(enhanced) else enhanced,
        math.nan,
        lat * _DEGREES,
        lon * _DEGREES,
    )


FIT = Sidecar(suffixes=(".fit",), read=of_file(read_fit), priority=-10)
