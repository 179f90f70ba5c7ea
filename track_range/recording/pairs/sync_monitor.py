"""SyncMonitor: detects a lag between the two videos of a pair."""

from __future__ import annotations

from collections import Counter, deque

from track_range.foundation.arrays import Image
from track_range.stereo.alignment.sync_check import Sync, check_sync
from track_range.stereo.geometry.frames import Frame, whole_image

_SYNC_EVERY, _MAX_SYNC_CHECKS = 5, 12  # interval in frames, and number, of synchronisation checks
_N_AGREEING_CHECKS = 3  # equal results after which the synchronisation is decided


class SyncMonitor:
    """Detects a lag of one frame between the two videos while the vehicle moves."""

    def __init__(self) -> None:
        self._last: deque[Frame] = deque(maxlen=3)
        self._votes: Counter[Sync] = Counter()
        self._n_frames = self._n_checks = 0

    @property
    def _is_settled(self) -> bool:
        return bool(self._votes) and max(self._votes.values()) >= _N_AGREEING_CHECKS

    def add(self, frame: Frame) -> None:
        """Check the next frame."""
        self._n_frames += 1
        if self._n_checks == _MAX_SYNC_CHECKS or self._is_settled:
            self._last.clear()
            return
        self._last.append(frame)
        if len(self._last) < 3 or self._n_frames % _SYNC_EVERY:
            return
        self._n_checks += 1
        rights: list[Image] = [whole_image(frame.right) for frame in self._last if frame.right is not None]
        if len(rights) == 3 and (sync := check_sync(self._last[1].left, rights)) != "unknown":
            self._votes[sync] += 1

    @property
    def notes(self) -> tuple[str, ...]:
        """The message for the user if one video lags."""
        sync = self._votes.most_common(1)[0][0] if self._is_settled else "synchronised"
        if sync == "synchronised":
            return ()
        late = "right" if sync == "right lags" else "left"
        return (
            f"Left and right are not synchronised: the {late} video lags by one frame (detected from vertical offsets "
            f"while the vehicle moves), so stereo distances are wrong; cut the first frame off the {late} video.",
        )
