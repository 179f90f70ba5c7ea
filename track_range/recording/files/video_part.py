"""VideoPart: one file of a recording and its time in it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from track_range.recording.utc import UtcStart


@dataclass(frozen=True, slots=True)
class VideoPart:
    """One file of a recording, or its folder of images.

    Attributes:
        path: the file or folder.
        start_s: time of its first frame, in seconds from the first frame of the recording.
        duration_s: length in seconds as the header states it; 0 = unknown.
        utc: UTC of its first frame; None = unknown.
    """

    path: Path
    start_s: float
    duration_s: float
    utc: UtcStart | None
