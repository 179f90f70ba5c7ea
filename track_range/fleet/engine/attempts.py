"""Attempts: whether a clip is repeated after its worker died, hung, or took too much memory; the time limit.

failure                              attempts in all
input, internal (application error)  1
network while fetching               2
over the limit of time or memory     2
worker died                          2; 4 if workers died with other clips too, since the machine is then the cause
node lost                            not counted
"""

from __future__ import annotations

from collections import defaultdict
from typing import Literal

ErrorKind = Literal["", "input", "crash", "memory", "timeout", "fetch", "internal"]
"""Kind of a failure; "" = none."""

_REPEATED: frozenset[ErrorKind] = frozenset(("crash", "memory", "timeout", "fetch"))

_N_ATTEMPTS, _N_ATTEMPTS_ELSEWHERE = 2, 4  # attempts for a clip, and those if workers died with other clips as well

BASE_S = 60.0
"""Time for opening a clip, in addition to that for its frames."""

_FETCH_BYTES_PER_S = 1e6  # lowest rate of downloads that is not taken for a hang

_FRAMES_PER_S = 10.0
"""Processed frames that extend the limit like a second of video: slow machines, and videos of high rate or size."""

_MIN_BYTES_PER_S = 1000.0  # lowest plausible data rate of a video; a damaged header may state any duration


class Attempts:
    """Failed attempts of the clips of a fleet."""

    def __init__(self) -> None:
        self._failures: dict[str, list[ErrorKind]] = defaultdict(list)

    def add(self, clip: str, kind: ErrorKind) -> None:
        """Count a failed attempt."""
        self._failures[clip].append(kind)

    def n_failed(self, clip: str) -> int:
        """Number of failed attempts."""
        return len(self._failures.get(clip, ()))

    def is_repeated(self, clip: str) -> bool:
        """Whether the clip is attempted again after its last failure."""
        kinds = self._failures.get(clip, [])
        if not _REPEATED.issuperset(kinds):
            return False
        crashed_elsewhere = any("crash" in others for name, others in self._failures.items() if name != clip)
        is_elsewhere = set(kinds) == {"crash"} and crashed_elsewhere
        return len(kinds) < (_N_ATTEMPTS_ELSEWHERE if is_elsewhere else _N_ATTEMPTS)


def time_limit_s(time_factor: float, video_s: float, fetch_bytes: float = 0.0, n_frames: int = 0) -> float:
    """Time limit of a clip; it grows with the processed frames, since a worker that makes progress does not hang.

    Args:
        time_factor: seconds for each second of video, or for ten frames.
        video_s: duration of its video; 0 = not known yet.
        fetch_bytes: bytes to download.
        n_frames: frames processed so far.
    """
    length_s = max(video_s, n_frames / _FRAMES_PER_S)
    return BASE_S + time_factor * length_s + fetch_bytes / _FETCH_BYTES_PER_S


def plausible_s(stated_s: float, n_bytes: int) -> float:
    """Duration of a video for the time limit: the stated one, unless the file is too small for it."""
    return max(0.0, min(stated_s, n_bytes / _MIN_BYTES_PER_S))
