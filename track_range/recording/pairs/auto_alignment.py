"""The alignment of a pair: estimated from its first frames or step by step, read from a file,
given, or off.
"""

from __future__ import annotations

import math
import time
from collections.abc import Generator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from track_range.foundation.progress import StepProgress, no_progress
from track_range.stereo.alignment.drift import DriftingAlignment, DriftMonitor
from track_range.stereo.alignment.file import load_alignment
from track_range.stereo.alignment.from_drive import MIN_FRAMES, NOT_MEASURED, DriveAlignment
from track_range.stereo.alignment.health import RigHealth
from track_range.stereo.alignment.model import Alignment, AlignmentSource
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig

# length, in s, of the part of a drive from which the alignment is estimated
ESTIMATION_SPAN_S = 8.0
# frames without motion after which the search restarts; they would use up a drive's frames
_MAX_STATIC_FRAMES = 50
# times of estimates after the first frame in motion; the last one stays
ESTIMATES_S = (2.0, 4.0, 8.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class PairAlignment:
    """An alignment and whether it is applied."""

    measured: Alignment  # as estimated or read
    is_applied: bool  # whether disparities are corrected by it
    rig: StereoRig | None = None  # the rectified pair; None = unknown
    # the applied alignment over the time of the drive, for images shifted by `shift_px`; None =
    # constant
    drifting: DriftingAlignment | None = None
    estimation_s: float = 0.0  # time that the estimation took, including reading the first frames

    @classmethod
    def of_drive(cls, drive: DriveAlignment, rig: StereoRig) -> PairAlignment:
        """The alignment estimated from the frames of a drive, applied if it is significant."""
        start_s = time.perf_counter()
        measured, windows = drive.estimate(), drive.windows()
        drifting = (
            DriftingAlignment(measured.if_clear(), measured, windows)
            if measured.is_measured
            else None
        )
        estimation_s = time.perf_counter() - start_s
        return cls(
            measured=measured,
            is_applied=measured.is_clear,
            rig=rig,
            drifting=drifting,
            estimation_s=estimation_s,
        )

    def drift_monitor(self, rig: StereoRig) -> DriftMonitor | None:
        """The monitor of the drift in the frames of a rectified pair; None = the alignment was not
        measured.
        """
        if self.drifting is None:
            return None
        return DriftMonitor(rig, self.drifting, self.measured, shift_px=self.applied.shift_px)

    @property
    def applied(self) -> Alignment:
        """The correction that is applied to disparities."""
        return self.measured if self.is_applied else self.measured.withheld()

    @property
    def correction(self) -> AlignmentSource:
        """The correction of the disparities of rectified frames, whose right image is shifted by
        `shift_px`.
        """
        return self.drifting or self.applied.after_shift()

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user on the alignment and the fit of the rig."""
        health = self.health
        if health is None:
            return (self.applied.sentence(),)
        m = self.measured
        rows = (
            f"Left and right have a vertical offset of {m.row_offset_px:+.1f} px (roll "
            f"{m.roll_deg:+.2f} degrees, focal length of the right camera "
            f"{100 * (m.focal_ratio - 1):+.1f} %): it is corrected, but the rig does not fit these "
            "videos well; calibrate again.",
        )
        rig = (health.sentence(),) if m.is_measured or health.has_row_error else ()
        moved = (health.move_sentence(),) if health.move is not None else ()
        return (self.applied.sentence(), *rig, *moved, *(rows if health.has_row_error else ()))

    @property
    def health(self) -> RigHealth | None:
        """The meaning of the alignment for distances; None = the rig is unknown."""
        windows = () if self.drifting is None else self.drifting.windows
        return (
            None if self.rig is None else RigHealth(self.rig, self.measured, self.applied, windows)
        )

    def summary(self) -> dict[str, Any]:
        """The section `alignment` of summary.json."""
        measured = self.measured
        return {
            "offset_px": round(measured.offset_px, 4),
            "bow_px": round(measured.curvature_px, 4),
            "row_offset_px": round(measured.row_offset_px, 4),
            "residual_px": round(self.applied.residual_px, 4),
            "source": measured.source,
            "is_applied": self.is_applied,
            "look_s": round(self.estimation_s, 3),
            "offset_sigma_px": round(measured.offset_sigma_px, 4),
            "slope_px": round(measured.slope_px, 4),
            "roll_deg": round(measured.roll_deg, 4),
            "focal_ratio": round(measured.focal_ratio, 6),
            "yaw_deg": round(measured.yaw_deg, 4),
            "health": None if self.health is None else self.health.to_dict(),
        }


def given_alignment(
    align: str | Path | Alignment | PairAlignment, rig: StereoRig
) -> PairAlignment | None:
    """The given alignment, or none ("off"); None = to be estimated ("auto"). Raises RigError for an
    unusable file.
    """
    if isinstance(align, PairAlignment):
        return align
    if isinstance(align, Alignment):
        return PairAlignment(measured=align, is_applied=True, rig=rig)
    if align == "off":
        return PairAlignment(
            measured=Alignment(source="off, as requested"), is_applied=False, rig=rig
        )
    return (
        None
        if align == "auto"
        else PairAlignment(measured=load_alignment(align), is_applied=True, rig=rig)
    )


def find_alignment(
    align: str | Path | Alignment | PairAlignment,
    rig: StereoRig,
    frames: Generator[Frame, None, None],
    progress: StepProgress = no_progress,
    *,
    prior: Alignment = NOT_MEASURED,
) -> PairAlignment:
    """The alignment of a calibrated pair: a given alignment, or "auto" = estimated from the drive's
    first frames.

    As many of the rectified `frames` of the first `ESTIMATION_SPAN_S`, corrected by `prior`, are
    read as the estimation needs. A RigError means that a file cannot be used; errors of `frames`
    are passed on.
    """
    if (given := given_alignment(align, rig)) is not None:
        return given
    began_s = time.perf_counter()
    drive, first_s = DriveAlignment(rig, prior), math.nan
    with progress("estimating the alignment") as advance:
        for frame in frames:
            first_s = frame.time_s if math.isnan(first_s) else first_s
            advance(round(10 * (frame.time_s - first_s)), round(10 * ESTIMATION_SPAN_S))
            drive.add(frame)
            if drive.is_full:
                break
        estimated = PairAlignment.of_drive(drive, rig)
    return replace(estimated, estimation_s=time.perf_counter() - began_s)


class StepwiseAlignment:
    """Estimates the alignment as soon as `MIN_FRAMES` frames in motion exist, again at
    `ESTIMATES_S`, then its drift.

    An `AlignmentSource`: before the first estimate, no correction with the sigma of a pair that was
    not aligned.
    """

    def __init__(self, rig: StereoRig, given: PairAlignment | None = None) -> None:
        """Start with frames rectified to `rig`; a given alignment does not change."""
        self.current = given  # the alignment that is applied; None = not estimated yet
        self._rig, self._prior = rig, NOT_MEASURED
        self._drift: DriftMonitor | None = None
        self._start()
        self._is_final = given is not None

    def restart(self, prior: Alignment) -> None:
        """Start again with frames that `prior` has corrected, which is applied until the next
        estimate.
        """
        self.current = PairAlignment(measured=prior, is_applied=True, rig=self._rig)
        self._prior, self._drift = prior, None
        self._start()

    def _start(self) -> None:
        """Look for the first frames in motion."""
        self._drive, self._moving_s, self._is_final = (
            DriveAlignment(self._rig, self._prior),
            math.nan,
            False,
        )
        self._n_estimates = self._n_static = 0

    @property
    def is_active(self) -> bool:
        """Whether further frames may change the alignment."""
        return not self._is_final or self._drift is not None

    def at(self, time_s: float) -> Alignment:
        """The correction of the disparities of a frame."""
        return Alignment() if self.current is None else self.current.correction.at(time_s)

    def add(self, unaligned: Frame, aligned: Frame) -> PairAlignment | None:
        """A new alignment after this frame, passed without and with the current alignment; None =
        unchanged.
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
            if estimated.measured.residual_px <= self.at(unaligned.time_s).residual_px:
                return None
        self.current = estimated
        if self._is_final:
            self._drift = estimated.drift_monitor(self._rig)
        return estimated

    def _is_due(self, time_s: float) -> bool:
        """Whether to estimate now; the last estimate is final."""
        n_due = sum(time_s - self._moving_s >= after_s for after_s in ESTIMATES_S)  # 0 for NaN
        self._is_final = self._drive.is_full or n_due == len(ESTIMATES_S)
        is_next = (
            n_due >= self._n_estimates if self._n_estimates else self._drive.n_moving >= MIN_FRAMES
        )
        is_due = self._is_final or is_next
        if is_due:
            self._n_estimates = n_due + 1
        return is_due
