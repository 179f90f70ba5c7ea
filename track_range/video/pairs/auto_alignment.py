"""The alignment of a calibrated pair: estimated from its first frames, read from a file, given, or off."""

from __future__ import annotations

import math
import time
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from track_range.foundation.progress import StepProgress, no_progress
from track_range.stereo.alignment.file import load_alignment
from track_range.stereo.alignment.from_drive import DriveAlignment
from track_range.stereo.alignment.model import Alignment
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig

ESTIMATION_SPAN_S = 8.0
"""Length, in s, of the part of a drive from which the alignment is estimated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PairAlignment:
    """An alignment and whether it is applied.

    Attributes:
        measured: as estimated or read.
        is_applied: whether disparities are corrected by it.
        estimation_s: time that the estimation took, including reading the first frames.
    """

    measured: Alignment
    is_applied: bool
    estimation_s: float = 0.0

    @property
    def applied(self) -> Alignment:
        """The correction that is applied to disparities."""
        return self.measured if self.is_applied else self.measured.withheld()

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user."""
        rows_px = self.measured.row_correction_px
        rows = (
            f"Vertical offset of {rows_px:+.1f} px between left and right: corrected, but the rig does not fit these "
            "videos well; calibrate again.",
        )
        return (self.applied.sentence(), *(rows if rows_px else ()))

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
        }


def find_alignment(
    align: str | Path | Alignment,
    rig: StereoRig,
    frames: Generator[Frame, None, None],
    progress: StepProgress = no_progress,
) -> PairAlignment:
    """The alignment of a calibrated pair.

    Args:
        align: "auto" = estimated from the drive's first frames; "off" = none; an alignment file; or an alignment.
        rig: the rectified pair.
        frames: the rectified frames of the first `ESTIMATION_SPAN_S`; as many are read as the estimation needs.
        progress: shows the progress of the estimation.

    Raises:
        RigError: the file cannot be used.
        Errors of `frames`.
    """
    if isinstance(align, Alignment):
        return PairAlignment(measured=align, is_applied=True)
    if align == "off":
        return PairAlignment(measured=Alignment(source="off, as requested"), is_applied=False)
    if align != "auto":
        return PairAlignment(measured=load_alignment(Path(align)), is_applied=True)
    began_s = time.perf_counter()
    drive, first_s = DriveAlignment(rig), math.nan
    with progress("estimating the alignment") as advance:
        for frame in frames:
            first_s = frame.time_s if math.isnan(first_s) else first_s
            advance(round(10 * (frame.time_s - first_s)), round(10 * ESTIMATION_SPAN_S))
            drive.add(frame)
            if drive.is_full:
                break
        measured = drive.estimate()
    return PairAlignment(measured=measured, is_applied=measured.is_clear, estimation_s=time.perf_counter() - began_s)
