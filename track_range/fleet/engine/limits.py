"""Limits of time and memory of a clip."""

from __future__ import annotations

from dataclasses import dataclass

BASE_S = 60.0
"""Time for opening a clip, in addition to that for its frames."""

_FETCH_BYTES_PER_S = 1e6
"""Lowest rate of downloads that is not taken for a hang."""

_FRAMES_PER_S = 10.0
"""Processed frames that extend the limit like a second of video: slow machines, and videos of high rate or size."""

_MIN_BYTES_PER_S = 1000.0
"""Lowest plausible data rate of a video; a damaged header may state any duration."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of the attempts of a fleet.

    Attributes:
        time_factor: seconds for each second of video, or for ten frames.
        memory_bytes: resident memory of a worker.
    """

    time_factor: float
    memory_bytes: int

    def time_s(self, video_s: float, fetch_bytes: float = 0.0, n_frames: int = 0) -> float:
        """Time limit of a clip; it grows with the processed frames, since a worker that makes progress does not hang.

        Args:
            video_s: duration of its video; 0 = not known yet.
            fetch_bytes: bytes to download.
            n_frames: frames processed so far.
        """
        length_s = max(video_s, n_frames / _FRAMES_PER_S)
        return BASE_S + self.time_factor * length_s + fetch_bytes / _FETCH_BYTES_PER_S


def plausible_s(stated_s: float, n_bytes: int) -> float:
    """Duration of a video for the time limit: the stated one, unless the file is too small for it."""
    return max(0.0, min(stated_s, n_bytes / _MIN_BYTES_PER_S))
