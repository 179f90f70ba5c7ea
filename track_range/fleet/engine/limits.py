"""Limits of time and memory of a clip."""

from __future__ import annotations

from dataclasses import dataclass

BASE_S = 60.0
"""Time for opening a clip, in addition to that for its frames."""

_FETCH_BYTES_PER_S = 1e6
"""Lowest rate of downloads that is not taken for a hang."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of the attempts of a fleet.

    Attributes:
        time_factor: seconds for each second of video.
        memory_bytes: resident memory of a worker.
    """

    time_factor: float
    memory_bytes: int

    def time_s(self, video_s: float, remote_bytes: int = 0) -> float:
        """Time limit of a clip.

        Args:
            video_s: duration of its video; 0 = not known yet.
            remote_bytes: bytes to download.
        """
        return BASE_S + self.time_factor * max(video_s, 0.0) + remote_bytes / _FETCH_BYTES_PER_S
