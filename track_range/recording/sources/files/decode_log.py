"""DecodeLog: frame numbers and counts of unusable frames of one pass over a video file."""

import heapq

from track_range.foundation.files.input_files import counted

# time step, in frame intervals, above which a gap is reported; the jitter of phones is smaller
_GAP_INTERVALS = 2.5


class DecodeLog:
    """Frame numbers and counts of one reading of one file.

    Attributes:
        n_used: frames passed on.
        n_damaged: frames skipped because they, or frames that they depend on, are damaged.
        n_backward: frames skipped because their timestamp equals or precedes the last timestamp.
        resets_s: times of the last frames before the clock of the file was set back.
    """

    def __init__(self) -> None:
        self.n_used = self.n_damaged = self.n_backward = 0
        self.last_s: float | None = None  # time of the last decoded frame; None = none yet
        self.end_s = 0.0  # time at which that frame ends
        self.stopped_by = ""  # reason why reading stopped early; empty = it did not
        self.resets_s: list[float] = []
        self._n_gaps, self._longest_gap = 0, (0.0, 0.0)  # length and place, s
        self._stamps: list[int] = []  # heap of packet timestamps not yet passed by a frame
        self._n_passed = 0
        self._index = -1
        self._corrupt: set[int] = set()

    def restart(self) -> None:
        """Continue at a later keyframe: reset the counts of decoded frames, but not the number of
        packets.
        """
        self.n_damaged = self.n_backward = self._n_gaps = 0
        self.last_s, self._longest_gap = None, (0.0, 0.0)

    def packet(self, stamp: int | None, *, is_corrupt: bool) -> None:
        """Register a packet that contains a frame, decoded or not; packets come in decoding
        order.
        """
        if stamp is not None:
            heapq.heappush(self._stamps, stamp)
            if is_corrupt:
                self._corrupt.add(stamp)

    def frame_index(self, stamp: int | None) -> int:
        """Index of the frame with this timestamp, from 0; to be called once per frame in order of
        time.

        It is the number of earlier packets, so that skipped and undecodable frames count; without
        timestamps decoded frames are counted.
        """
        while stamp is not None and self._stamps and self._stamps[0] < stamp:
            heapq.heappop(self._stamps)
            self._n_passed += 1
        self._index = max(self._n_passed, self._index + 1)
        return self._index

    def is_corrupt(self, stamp: int | None) -> bool:
        """Whether the packet of the frame with this timestamp is damaged."""
        return stamp in self._corrupt

    def decoded(self, time_s: float, *, duration_s: float, interval_s: float) -> None:
        """Register a decoded frame; times increase."""
        step_s = 0.0 if self.last_s is None else time_s - self.last_s
        if step_s > _GAP_INTERVALS * interval_s:
            self._n_gaps += 1
            if step_s > self._longest_gap[0]:
                self._longest_gap = step_s, time_s - step_s
        self.last_s, self.end_s = time_s, time_s + duration_s

    def note_shortfall(self, declared_end_s: float, *, tolerance_s: float) -> None:
        """Report a file that ends more than `tolerance_s` before the end stated by its header."""
        if not self.stopped_by and self.end_s < declared_end_s - tolerance_s:
            self.stopped_by = f"{declared_end_s - self.end_s:.1f} s shorter than its header states"

    @property
    def notes(self) -> list[str]:
        """Messages for the user on damaged frames and times, without the file's name."""
        notes = []
        if self.stopped_by:
            notes.append(
                f"reading stopped after {counted(self.n_used, 'frame')}, at {self.end_s:.2f} s: "
                f"the file is damaged or truncated there ({self.stopped_by})."
            )
        if self.resets_s:
            notes.append(
                f"the clock was set back {counted(len(self.resets_s), 'time')}, first after "
                f"{self.resets_s[0]:.2f} s, as in joined files: later frames continue at the "
                "nominal frame rate."
            )
        if self._n_gaps:
            notes.append(
                f"the timestamps have {counted(self._n_gaps, 'gap')}, the longest "
                f"{self._longest_gap[0]:.2f} s, after {self._longest_gap[1]:.2f} s: frames are "
                "missing there."
            )
        if self.n_damaged:
            notes.append(f"skipped {counted(self.n_damaged, 'damaged frame')}.")
        if self.n_backward:
            notes.append(
                f"skipped {counted(self.n_backward, 'frame')} with a repeated or backward "
                "timestamp."
            )
        return notes
