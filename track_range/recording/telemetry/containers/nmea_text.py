"""RMC sentences in text or binary data of a video file, as samples."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

from track_range.recording.telemetry.containers.samples import Sample
from track_range.recording.telemetry.sidecars.nmea import fixes_in

_RMC = re.compile(rb"([A-Z]{2}RMC,[ -#%-)+-:<-~]{6,90}(?:\*[0-9A-Fa-f]{2})?)")
"""RMC sentence; the dollar sign is missing in some subtitles."""


def rmc_samples(contents: Iterable[bytes], source: str) -> list[Sample | None]:
    """The first RMC sentence of each content; None = it has none.

    Args:
        contents: texts, or records that contain text.
        source: name of the file, for messages.

    Raises:
        TelemetryError: there are sentences, but the library that reads them is not installed.
    """
    matches = [_RMC.search(content) for content in contents]
    texts = ["$" + match[1].decode("ascii").rstrip(";") if match else "" for match in matches]
    return [
        Sample(
            math.nan,
            fix.utc_s,
            fix.speed_mps,
            math.degrees(fix.course_rad),
            fix.latitude_deg,
            fix.longitude_deg,
        )
        if fix
        else None
        for fix in fixes_in(texts, source)
    ]


def has_rmc(content: bytes) -> bool:
    """Whether a content has an RMC sentence."""
    return b"RMC," in content and _RMC.search(content) is not None
