"""BlackVue: NMEA sentences with time stamps, `[1520733508000]$GPRMC,...`, in the box `free/gps `.

The stamps are milliseconds since 1970 on the camera's clock (UTC or local time). The box `free/sttm` holds the stamp of
the start of the video; without it the first sentence counts as the start.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from track_range.recording.telemetry.containers.mp4_boxes import Movie, boxes, read_at
from track_range.recording.telemetry.containers.nmea_text import rmc_samples
from track_range.recording.telemetry.containers.samples import MAX_SAMPLES, Sample, track
from track_range.recording.telemetry.track import TelemetryTrack

MAX_GPS_BYTES = 64_000_000
"""Size limit of the boxes; an hour at 1 Hz has 1.5 MB."""

_SENTENCE = re.compile(rb"\[(\d{10,16})\]\s*(\$[A-Z]{2}RMC,[^\r\n\[]{6,100})")
_MAX_JITTER_S = 2.0
"""Largest variation of the time between fix and stamp at which the receiver's clock gives the intervals."""

_MAX_START_DIFFERENCE_MS = 600_000
"""Largest distance between the stamps of the start and of the first sentence: ten minutes, twice a recording."""


def read_blackvue(file: BinaryIO, movie: Movie, path: Path) -> TelemetryTrack | None:
    """Telemetry of the box `free/gps ` of a movie; None = there is none."""
    for box in movie.top[:64]:
        if box.kind not in (b"free", b"skip") or box.end - box.start < 16:
            continue
        if not read_at(file, box.start + 4, 4).strip(b"\0 ").isalnum():
            continue
        content = read_at(file, box.start, min(box.end - box.start, MAX_GPS_BYTES))
        parts = {part.kind: content[part.start : part.end] for part in boxes(content)}
        if b"gps " in parts and (telemetry := parse_stamped(parts[b"gps "], parts.get(b"sttm", b""), str(path))):
            return telemetry
    return None


def parse_stamped(content: bytes, start: bytes, source: str) -> TelemetryTrack | None:
    """Telemetry of stamped sentences.

    Args:
        content: the sentences.
        start: content of the box `sttm`; b"" = there is none.
        source: name of the file, for messages.
    """
    stamped = [match.groups() for match in _SENTENCE.finditer(content)][:MAX_SAMPLES]
    if not stamped:
        return None
    stamps_ms = [int(stamp) for stamp, _ in stamped]
    first_ms = stamps_ms[0]
    stated_ms = [int.from_bytes(start[:8], "big"), int.from_bytes(start[:8], "little")]
    stated_ms = [stamp for stamp in stated_ms if abs(stamp - first_ms) <= _MAX_START_DIFFERENCE_MS]
    if len(start) >= 8 and stated_ms:
        first_ms = stated_ms[0]
    samples = [
        replace(sample, time_s=(stamp_ms - first_ms) / 1000)
        for stamp_ms, sample in zip(stamps_ms, rmc_samples([text for _, text in stamped], source), strict=True)
        if sample
    ]
    return track(_without_jitter(samples), "BlackVue")


def _without_jitter(samples: list[Sample]) -> list[Sample]:
    """Samples with the intervals of the receiver's clock: stamps are the times of arrival, up to 0.3 s late."""
    lags_s = np.array([sample.time_s - sample.utc_s for sample in samples])
    if not len(lags_s) or not np.isfinite(lags_s).all() or np.ptp(lags_s) > _MAX_JITTER_S:
        return samples
    return [sample.at(sample.utc_s + float(np.median(lags_s))) for sample in samples]
