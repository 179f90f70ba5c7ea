"""AlignmentEstimates: when the alignment of a pair is estimated from frames that come one by one.

standing   -> first frame in motion, or 50 frames: start again
in motion  -> MIN_FRAMES frames: first estimate -> one at each of `after_s` -> the last one
"""

import math
from typing import NamedTuple

from track_range.recording.cameras.auto_alignment import PairAlignment
from track_range.stereo.alignment.from_drive import MIN_FRAMES, DriveAlignment
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig

# frames without motion after which the search restarts; they would use up a drive's frames
_MAX_STATIC_FRAMES = 50


class PairEstimate(NamedTuple):
    """An alignment estimated from some frames."""

    alignment: PairAlignment
    is_last: bool  # whether it is from all frames that are used


class AlignmentEstimates:
    """Estimates from frames that are rectified to `rig` and corrected by `prior`, at the times
    `after_s` in seconds after the first frame in motion.
    """

    def __init__(
        self, rig: StereoRig, after_s: tuple[float, ...], prior: Alignment | None = None
    ) -> None:
        self._rig, self._after_s, self._prior = rig, after_s, prior
        self._start()

    def _start(self) -> None:
        """Look for the first frames in motion."""
        self._drive = DriveAlignment(self._rig, self._prior)
        self._moving_s = math.nan  # time of the first frame in motion
        self._n_static = 0
        self._n_estimates = 0  # of those that are due, with the first one

    def add(self, frame: Frame) -> PairEstimate | None:
        """Use the next frame; returns an estimate if one is due.

        A last estimate that measures nothing (the view was blocked, or without texture) is the
        start of another series.
        """
        self._drive.add(frame)
        if math.isnan(self._moving_s):
            self._n_static += 1
            if self._drive.n_moving > 1:
                self._moving_s = frame.time_s
            elif self._n_static > _MAX_STATIC_FRAMES:
                self._start()
        n_due = sum(frame.time_s - self._moving_s >= after_s for after_s in self._after_s)
        is_last = self._drive.is_full or n_due == len(self._after_s)
        if not (is_last or self._is_next(n_due)):
            return None
        self._n_estimates = n_due + 1
        # an estimate ends the segment that is in progress
        drive = self._drive if is_last else self._drive.copy()
        alignment = PairAlignment.of_drive(drive, self._rig)
        if is_last and not alignment.measured.is_measured:
            self._start()
            is_last = False
        return PairEstimate(alignment, is_last)

    def _is_next(self, n_due: int) -> bool:
        """Whether another estimate is due, of which `n_due` have their time."""
        if self._n_estimates == 0:
            return self._drive.n_moving >= MIN_FRAMES
        return n_due >= self._n_estimates
