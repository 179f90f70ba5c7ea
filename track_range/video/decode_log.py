"""DecodeLog: what one reading of a video file has met: the number of each frame, and which could not be used."""

from __future__ import annotations

import heapq

from track_range.video.frame import counted

_GAP_INTERVALS = 2.5  # a step so much longer than the nominal one is noted; the jitter of phones stays below


class DecodeLog:
    """Counts of one reading of one file.

    Attributes:
        n_used: frames handed on.
        n_damaged: frames left out because they, or what they are built on, are damaged.
        n_backward: frames left out because their timestamp repeats or precedes the last one.
        last_s: time of the last frame that decoded; None = none yet.
        end_s: where that frame ends.
        stopped_by: why the file could not be read on; empty = it could.
    """

    def __init__(self) -> None:
        self.n_used = self.n_damaged = self.n_backward = 0
        self.last_s: float | None = None
        self.end_s = 0.0
        self.stopped_by = ""
        self._n_gaps, self._longest_gap_s, self._longest_gap_at_s = 0, 0.0, 0.0
        self._stamps: list[int] = []  # heap of the packets' timestamps that no frame has passed yet
        self._n_passed = 0
        self._index = -1
        self._corrupt: set[int] = set()

    def restart(self) -> None:
        """Reading goes on at a later keyframe: forget the frames decoded so far, but not how many packets came."""
        self.n_damaged = self.n_backward = self._n_gaps = 0
        self.last_s, self._longest_gap_s = None, 0.0

    def packet(self, stamp: int | None, *, is_corrupt: bool) -> None:
        """A packet that holds a frame was met, decoded or not; packets come in the decoder's order."""
        if stamp is not None:
            heapq.heappush(self._stamps, stamp)
            if is_corrupt:
                self._corrupt.add(stamp)

    def frame_index(self, stamp: int | None) -> int:
        """Number of frames before the one of this timestamp; frames come in order of time, each once.

        Packets give it even where frames were skipped or did not decode; without timestamps frames are counted.
        """
        while stamp is not None and self._stamps and self._stamps[0] < stamp:
            heapq.heappop(self._stamps)
            self._n_passed += 1
        self._index = max(self._n_passed, self._index + 1)
        return self._index

    def is_corrupt(self, stamp: int | None) -> bool:
        """Whether the frame's own packet was damaged in the file."""
        return stamp in self._corrupt

    def decoded(self, time_s: float, *, duration_s: float, interval_s: float) -> None:
        """A frame of this time was decoded; times increase."""
        step_s = 0.0 if self.last_s is None else time_s - self.last_s
        if step_s > _GAP_INTERVALS * interval_s:
            self._n_gaps += 1
            if step_s > self._longest_gap_s:
                self._longest_gap_s, self._longest_gap_at_s = step_s, time_s - step_s
        self.last_s, self.end_s = time_s, time_s + duration_s

    def note_shortfall(self, declared_end_s: float, *, tolerance_s: float) -> None:
        """Reading is over: note it if the file's header promised more."""
        if not self.stopped_by and self.end_s < declared_end_s - tolerance_s:
            self.stopped_by = f"{declared_end_s - self.end_s:.1f} s less than its header promises"

    @property
    def notes(self) -> list[str]:
        """Sentences for the user."""
        notes = []
        if self.stopped_by:
            notes.append(
                f"reading ended after {counted(self.n_used, 'frame')}, at {self.end_s:.2f} s: the file is damaged or "
                f"cut short there ({self.stopped_by})."
            )
        if self._n_gaps:
            notes.append(
                f"{counted(self._n_gaps, 'gap')} in its times, the longest of {self._longest_gap_s:.2f} s after "
                f"{self._longest_gap_at_s:.2f} s: frames are missing there."
            )
        if self.n_damaged:
            notes.append(f"{counted(self.n_damaged, 'damaged frame')} left out.")
        if self.n_backward:
            notes.append(f"{counted(self.n_backward, 'frame')} with a repeated or backward timestamp left out.")
        return notes
