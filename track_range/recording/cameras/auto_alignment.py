"""PairAlignment: the alignment of a pair, as estimated, read from a file, given, or off."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from track_range.foundation.errors import Note
from track_range.stereo.alignment.file import load_alignment
from track_range.stereo.alignment.from_drive import DriveAlignment
from track_range.stereo.alignment.health import Move, RigHealth, Window
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.rig import StereoRig

_OFF = "off, as requested"


@dataclass(frozen=True, slots=True, kw_only=True)
class PairAlignment:
    """An alignment and whether it is applied."""

    measured: Alignment  # as estimated or read
    is_applied: bool  # whether disparities are corrected by it
    rig: StereoRig | None = None  # the rectified pair; None = unknown
    # the offset in parts of the drive from which it was estimated; empty = not from a drive
    windows: tuple[Window, ...] = ()
    estimation_s: float = 0.0  # time that the estimation took, including reading the first frames

    @classmethod
    def of_drive(cls, drive: DriveAlignment, rig: StereoRig) -> PairAlignment:
        """The alignment estimated from the frames of a drive, applied if it is significant."""
        start_s = time.perf_counter()
        measured = drive.estimate()
        return cls(
            measured=measured,
            is_applied=measured.is_clear,
            rig=rig,
            windows=drive.windows() if measured.is_measured else (),
            estimation_s=time.perf_counter() - start_s,
        )

    @property
    def of_frames(self) -> Alignment:
        """The correction of the disparities of rectified frames, whose right images are shifted by
        `shift_px`.
        """
        return self.applied.after_shift()

    @property
    def applied(self) -> Alignment:
        """The correction that is applied to disparities."""
        return self.measured if self.is_applied else self.measured.withheld()

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user on the alignment and the fit of the rig; on movements of a camera,
        those of the frame by frame measurement are better (`RightCameraMonitor`).
        """
        health, m = self.health, self.measured
        if health is None:
            rows = (
                Note(
                    f"Left and right have a vertical offset of {m.row_offset_px:+.1f} px, which is "
                    "corrected.",
                    "rows-corrected",
                    "ok",
                    "pair",
                ),
            )
            return (
                Note(self.applied.sentence(), "alignment", "ok", "pair"),
                *(rows if m.row_correction_px else ()),
            )
        rows = (
            Note(
                f"Left and right have a vertical offset of {m.row_offset_px:+.1f} px (roll "
                f"{m.roll_deg:+.2f} degrees, focal length of the right camera "
                f"{100 * (m.focal_ratio - 1):+.1f} %): it is corrected, but the rig does not fit these "
                "videos well; calibrate again.",
                "rig-does-not-fit",
                "warning",
                "pair",
            ),
        )
        rig = (
            (Note(health.sentence(), "rig", "ok", "pair"),)
            if m.is_measured or health.has_row_error
            else ()
        )
        return (
            Note(self.applied.sentence(), "alignment", "ok", "pair"),
            *rig,
            *(rows if health.has_row_error else ()),
        )

    @property
    def health(self) -> RigHealth | None:
        """The meaning of the alignment for distances; None = the rig is unknown, or only
        assumed.
        """
        if self.rig is None or self.rig.is_assumed:
            return None
        return RigHealth(self.rig, self.measured, self.applied, self.windows)

    @property
    def is_off(self) -> bool:
        """Whether the user wants no correction."""
        return self.measured.source == _OFF

    def summary(self, later: Move | None = None) -> dict[str, Any]:
        """The section `alignment` of summary.json, with a movement that a run saw."""
        measured, health = self.measured, self.health
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
            "health": None if health is None else replace(health, later=later).to_dict(),
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
        unmeasured = replace(rig.unaligned, source=_OFF)
        return PairAlignment(measured=unmeasured, is_applied=False, rig=rig)
    return (
        None
        if align == "auto"
        else PairAlignment(measured=load_alignment(align), is_applied=True, rig=rig)
    )
