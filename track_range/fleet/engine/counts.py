"""Counts: clips of a run by result."""

from __future__ import annotations

import time
from dataclasses import dataclass, field


@dataclass(slots=True)
class Counts:
    """Clips of a run by result.

    Attributes:
        total: all clips.
        skipped: complete before.
        done: completed in this run, or found to be unchanged by a worker.
        failed: failed in this run, or before and not repeated.
        video_s: duration of the clips completed in this run, s.
        start_s: start on the monotonic clock.
    """

    total: int = 0
    skipped: int = 0
    done: int = 0
    failed: int = 0
    video_s: float = 0.0
    start_s: float = field(default_factory=time.monotonic)

    @property
    def left(self) -> int:
        """Clips without a result."""
        return self.total - self.skipped - self.done - self.failed

    @property
    def clips_per_hour(self) -> float | None:
        """Rate of this run; None before the first clip."""
        elapsed_s = time.monotonic() - self.start_s
        return 3600 * self.done / elapsed_s if self.done and elapsed_s > 0 else None
