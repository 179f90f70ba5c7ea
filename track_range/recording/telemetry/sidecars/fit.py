"""FIT files of Garmin and other sports computers, read with fitdecode: records with position and
speed, and those of VIRB cameras.
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

_MESSAGES = ("gps_metadata", "record")  # with positions; the first of VIRB cameras, at 10 Hz
_DEGREES = 180 / 2**31  # per semicircle, the unit of positions


def read_fit(path: Path) -> TelemetryTrack | None:
    """Telemetry of a FIT file in UTC; None = it has none.

    Raises TelemetryError if it cannot be read, or fitdecode is not installed.
    """
    fitdecode = optional_package("fitdecode", str(path))
    by_message: dict[str, list[Sample]] = {name: [] for name in _MESSAGES}
    try:
        with fitdecode.FitReader(str(path), check_crc=fitdecode.CrcCheck.DISABLED) as records:
            for record in records:
                if isinstance(record, fitdecode.FitDataMessage) and record.name in _MESSAGES:
                    by_message[record.name].append(_sample(record))
                if max(map(len, by_message.values())) >= MAX_SAMPLES:
                    break
    except Exception as error:  # fitdecode's errors, and those of damaged fields
        if not any(by_message.values()):
            raise TelemetryError(
                f"{path}: expected a FIT file, found another format or a damaged file."
            ) from error
    samples = _with_fractions(next((some for some in by_message.values() if some), []))
    return track(
        samples, path.name, "utc", has_own_speed=any(math.isfinite(s.speed_mps) for s in samples)
    )


def _sample(record: Any) -> Sample:
    speed, enhanced, lat, lon, heading_deg = (
        plain_number(record.get_value(name, fallback=None))
        for name in ("speed", "enhanced_speed", "position_lat", "position_long", "heading")
    )
    # the timestamp of VIRB counts since the camera was started
    moments = (record.get_value(name, fallback=None) for name in ("utc_timestamp", "timestamp"))
    utc_s = next(
        (moment.timestamp() for moment in moments if hasattr(moment, "timestamp")), math.nan
    )
    time_s = utc_s
    if record.name == "gps_metadata":
        milliseconds = plain_number(record.get_value("timestamp_ms", fallback=None))
        time_s = plain_number(record.get_raw_value("timestamp", fallback=None)) + milliseconds / 1e3
    return Sample(
        time_s,
        utc_s,
        speed if math.isnan(enhanced) else enhanced,
        heading_deg,
        lat * _DEGREES,
        lon * _DEGREES,
    )


def _with_fractions(samples: list[Sample]) -> list[Sample]:
    """Samples with UTC as time: VIRB's messages state it in whole seconds, and fractions of the
    time since the camera was started, from which it differs least when a second begins.
    """
    ahead_s = [sample.utc_s - sample.time_s for sample in samples]
    known_s = [value for value in ahead_s if math.isfinite(value)]
    if not known_s:
        return samples
    moments_s = [sample.time_s + max(known_s) for sample in samples]
    return [
        sample._replace(time_s=t, utc_s=t) for sample, t in zip(samples, moments_s, strict=True)
    ]


FIT = Sidecar(suffixes=(".fit",), read=of_file(read_fit), priority=-10)
