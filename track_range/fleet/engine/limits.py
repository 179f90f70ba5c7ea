"""Limits of time and memory of a clip."""

from __future__ import annotations

from dataclasses import dataclass

BASE_S = 60.0
"""Time for opening a clip, in addition to that for its frames."""

_FETCH_BYTES_PER_S = 1e6
"""Lowest rate of downloads that is not taken for a hang."""

_MIN_BYTES_PER_S = 1000.0
"""Lowest plausible data rate of a video; a damaged header may state any duration."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of the attempts of a fleet.

    Attributes:
        time_factor: seconds for each second of video.
        memory_bytes: resident memory of a worker.
    """

    time_factor: float
    memory_bytes: int

    def time_s(self, video_s: float, fetch_bytes: float = 0.0) -> float:
        """Time limit of a clip.

        Args:
            video_s: duration of its video; 0 = not known yet.
            fetch_bytes: bytes to download.
        """
        return BASE_S + self.time_factor * max(video_s, 0.0) + fetch_bytes / _FETCH_BYTES_PER_S


def plausible_s(stated_s: float, n_bytes: int) -> float:
    """Duration of a video for the time limit: the stated one, unless the file is too small for it."""
    return max(0.0, min(stated_s, n_bytes / _MIN_BYTES_PER_S))
