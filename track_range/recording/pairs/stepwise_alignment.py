"""StepwiseAlignment: the alignment of a pair whose frames come one by one, without a look ahead."""

from __future__ import annotations

import math

from track_range.recording.pairs.auto_alignment import PairAlignment
from track_range.stereo.alignment.drift import DriftMonitor
from track_range.stereo.alignment.from_drive import MIN_FRAMES, DriveAlignment
from track_range.stereo.alignment.model import Alignment
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig

_MAX_STATIC_FRAMES = 50
"""Frames without motion after which the search starts again, so that they do not use up the frames of a drive."""

ESTIMATES_S = (2.0, 4.0, 8.0)
"""Times after the first frame in motion at which the alignment is estimated again; the last estimate stays."""


class StepwiseAlignment:
    """Estimates the alignment as soon as `MIN_FRAMES` frames in motion exist, again at `ESTIMATES_S`, then its drift.

    An `AlignmentSource`: before the first estimate, no correction with the sigma of a pair that was not aligned.

    Attributes:
        current: the alignment that is applied; None = not estimated yet.
    """

    def __init__(self, rig: StereoRig, given: PairAlignment | None = None) -> None:
        """Start with frames rectified to `rig`; an alignment that is given stays as it is."""
        self.current = given
        self._rig = rig
        self._drift: DriftMonitor | None = None
        self._start()
        self._is_final = given is not None

    def _start(self) -> None:
        """Look for the first frames in motion."""
        self._drive, self._moving_s, self._is_final = DriveAlignment(self._rig), math.nan, False
        self._n_estimates = self._n_static = 0

    @property
    def is_active(self) -> bool:
        """Whether further frames may change the alignment."""
        return not self._is_final or self._drift is not None

    def at(self, time_s: float) -> Alignment:
        """The correction of the disparities of a frame."""
        return Alignment() if self.current is None else self.current.correction.at(time_s)

    def add(self, unaligned: Frame, aligned: Frame) -> PairAlignment | None:
        """A new alignment for the frames after this one; None = as before.

        Args:
            unaligned: the frame as rectified by the rig alone.
            aligned: the frame as rectified with the current alignment.
        """
        if self._is_final:
            if self._drift is not None:
                self._drift.add(aligned)
            return None
        self._drive.add(unaligned)
        if math.isnan(self._moving_s):
            self._n_static += 1
            if self._drive.n_moving > 1:
                self._moving_s = unaligned.time_s
            elif self._n_static > _MAX_STATIC_FRAMES:
                self._start()
        if not self._is_due(unaligned.time_s):
            return None
        drive = self._drive if self._is_final else self._drive.copy()
        estimated = PairAlignment.of_drive(drive, self._rig)
        if not estimated.measured.is_measured:
            if self._is_final:  # the view was blocked, or without texture: look again
                self._start()
            return None
        self.current = estimated
        if self._is_final:
            self._drift = estimated.drift_monitor(self._rig)
        return estimated

    def _is_due(self, time_s: float) -> bool:
        """Whether to estimate now; the last estimate is final."""
        n_due = sum(time_s - self._moving_s >= after_s for after_s in ESTIMATES_S)  # 0 for NaN
        self._is_final = self._drive.is_full or n_due == len(ESTIMATES_S)
        is_next = n_due >= self._n_estimates if self._n_estimates else self._drive.n_moving >= MIN_FRAMES
        is_due = self._is_final or is_next
        if is_due:
            self._n_estimates = n_due + 1
        return is_due
