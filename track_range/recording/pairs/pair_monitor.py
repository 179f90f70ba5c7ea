"""PairMonitor: checks the first pairs of a run for swapped videos and a vertical offset."""

from __future__ import annotations

from track_range.stereo.alignment.pair_checks import check_pair
from track_range.stereo.geometry.frames import Frame, whole_image
from track_range.stereo.geometry.rig import RigError

MAX_CHECKED_PAIRS = 10  # largest number of pairs that are checked for swapped cameras; fewer if enough are conclusive

_MAX_ROW_OFFSET_PX = 1.5
"""Vertical offset above which the user is warned; feature positions are whole pixels, so one pair cannot show smaller
offsets."""

_UNMATCHED = (
    f"The rig could not be checked: left and right have too few matching points in equal rows in the first "
    f"{MAX_CHECKED_PAIRS} pairs; check that the two videos and the rig belong together."
)


class PairMonitor:
    """Checks the first pairs, up to `n_conclusive` conclusive ones, for swapped cameras, and measures row offsets."""

    def __init__(self, *, n_conclusive: int = 1) -> None:
        self.row_offsets_px: list[float] = []  # mean of y_right - y_left of matching points, one per conclusive pair
        self.corrected_px = 0.0  # row offset that is corrected in the frames after the check
        self._n_conclusive = n_conclusive
        self._n_checked, self._last_index = 0, -1
        self._is_unmatched = False

    @property
    def is_done(self) -> bool:
        """Whether the check has ended."""
        return len(self.row_offsets_px) >= self._n_conclusive or self._n_checked >= MAX_CHECKED_PAIRS

    def add(self, frame: Frame) -> None:
        """Check a frame if it is new and the check has not ended; raises RigError if left and right are swapped."""
        if frame.right is None or frame.index <= self._last_index:
            return
        if self.is_done:
            self._is_unmatched = not self.row_offsets_px
            return
        check = check_pair(frame.left, whole_image(frame.right))
        if check.is_swapped:
            raise RigError(
                f"left and right are swapped: {100 * check.negative_fraction:.0f} % of {check.n_matches} matched "
                "points have a negative disparity; swap the two videos."
            )
        self._last_index = frame.index
        self._n_checked += 1
        if check.is_conclusive:
            self.row_offsets_px.append(check.row_offset_px)

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        if self._is_unmatched:
            return (_UNMATCHED,)
        row_px = self.row_offsets_px[0] - self.corrected_px if self.row_offsets_px else 0.0
        if abs(row_px) <= _MAX_ROW_OFFSET_PX:
            return ()
        return (
            f"Vertical offset of {row_px:+.1f} px between left and right: the rig does not fit these videos well, so "
            "stereo distances are less accurate; calibrate again.",
        )
