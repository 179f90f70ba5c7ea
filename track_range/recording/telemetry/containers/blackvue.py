"""BlackVue: NMEA sentences with time stamps, `[1520733508000]$GPRMC,...`, in the box `free/gps `.

The stamps are milliseconds since 1970 on the camera's clock (UTC or local time). The box
`free/sttm` holds the stamp of the start of the video; without it the first sentence counts as the
start.
"""

import re
from pathlib import Path
from typing import BinaryIO

import numpy as np

from track_range.recording.telemetry.containers.mp4_boxes import (
    MAX_TELEMETRY_BYTES,
    Movie,
    boxes,
    read_at,
)
from track_range.recording.telemetry.sidecars.nmea import rmc_samples
from track_range.recording.telemetry.tracks.samples import MAX_SAMPLES, Sample, track
from track_range.recording.telemetry.tracks.track import TelemetryTrack

_SENTENCE = re.compile(rb"\[(\d{10,16})\]\s*(\$[A-Z]{2}RMC,[^\r\n\[]{6,100})")
# largest variation from fix to stamp at which the receiver's clock gives the intervals
_MAX_JITTER_S = 2.0
# from the start to the first sentence: ten minutes, twice a recording
_MAX_START_DIFFERENCE_MS = 600_000


def read_blackvue(file: BinaryIO, movie: Movie, path: Path) -> TelemetryTrack | None:
    """Telemetry of the box `free/gps ` of a movie; None = there is none."""
    for box in movie.top[:64]:
        if box.type not in (b"free", b"skip") or box.end - box.start < 16:
            continue
        if not read_at(file, box.start + 4, 4).strip(b"\0 ").isalnum():
            continue
        content = read_at(file, box.start, min(box.end - box.start, MAX_TELEMETRY_BYTES))
        parts = dict(boxes(content))
        if b"gps " in parts and (
            telemetry := _stamped_track(parts[b"gps "], parts.get(b"sttm", b""), str(path))
        ):
            return telemetry
    return None


def _stamped_track(content: bytes, start: bytes, source: str) -> TelemetryTrack | None:
    """Telemetry of stamped sentences; `start` is the content of the box `sttm`, b"" = there is
    none.
    """
    stamped = [(int(stamp), text) for stamp, text in _SENTENCE.findall(content)][:MAX_SAMPLES]
    if not stamped:
        return None
    first_ms = stamped[0][0]
    stated_ms = (
        [int.from_bytes(start[:8], "big"), int.from_bytes(start[:8], "little")]
        if len(start) >= 8
        else []
    )
    start_ms = next(
        (stamp for stamp in stated_ms if abs(stamp - first_ms) <= _MAX_START_DIFFERENCE_MS),
        first_ms,
    )
    samples = [
        sample.at((stamp_ms - start_ms) / 1000)
        for (stamp_ms, _), sample in zip(
            stamped, rmc_samples([text for _, text in stamped], source), strict=True
        )
        if sample
    ]
    return track(_without_jitter(samples), "BlackVue")


def _without_jitter(samples: list[Sample]) -> list[Sample]:
    """Samples with the intervals of the receiver's clock: stamps are the times of arrival, up to
    0.3 s late.
    """
    lags_s = np.array([sample.time_s - sample.utc_s for sample in samples])
    if not len(lags_s) or not np.isfinite(lags_s).all() or np.ptp(lags_s) > _MAX_JITTER_S:
        return samples
    return [sample.at(sample.utc_s + float(np.median(lags_s))) for sample in samples]
