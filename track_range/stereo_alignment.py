"""`--align auto|off|FILE`: which correction of the disparities a run uses, and what is told of it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from stereo.alignment import MAX_ROW_OFFSET_PX, UNCORRECTED_SIGMA_PX, Alignment
from stereo.alignment_drive import DriveAlignment
from stereo.alignment_file import load_alignment
from stereo.frames import Frame
from stereo.rig import StereoRig
from track_range.pair_watch import MAX_CHECKED_PAIRS, checked_pair

Progress = Callable[[str], AbstractContextManager[Callable[[int, int], None]]]
"""Opens a progress bar with a text; what it yields is told steps done, and of how many."""

_MAX_LOOK_S = 8.0
"""So much of the drive is looked at; a vehicle that stands still all the while tells nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundAlignment:
    """What was found about a pair's alignment, and what is done about it.

    Attributes:
        measured: as estimated or read.
        is_applied: whether disparities are corrected by it.
        look_s: how long the look through the first frames took.
    """

    measured: Alignment
    is_applied: bool
    look_s: float = 0.0

    @property
    def applied(self) -> Alignment:
        """The correction that disparities get."""
        if self.is_applied:
            return self.measured
        doubt_px = float(np.hypot(self.measured.offset_px, self.measured.residual_px))
        return replace(self.measured, offset_px=0.0, bow_px=0.0, residual_px=min(doubt_px, UNCORRECTED_SIGMA_PX))

    @property
    def rows_moved_px(self) -> float:
        """How far the right image is moved up; not at all for less, since moving by parts of a pixel softens it."""
        row_px = self.measured.row_offset_px
        return row_px if abs(row_px) > MAX_ROW_OFFSET_PX else 0.0

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know, in plain words."""
        rows = (
            f"Rows of left and right are {self.rows_moved_px:+.1f} px apart: corrected, but the rig does not fit these "
            "videos well; calibrate anew.",
        )
        return (self._sentence(), *(rows if self.rows_moved_px else ()))

    def _sentence(self) -> str:
        return self.measured.sentence() if self.is_applied else self.applied.sentence()

    def summary(self) -> dict[str, Any]:
        """The section `alignment` of summary.json."""
        measured = self.measured
        return {
            "offset_px": round(measured.offset_px, 4),
            "bow_px": round(measured.bow_px, 4),
            "row_offset_px": round(measured.row_offset_px, 4),
            "residual_px": round(self.applied.residual_px, 4),
            "source": measured.source,
            "is_applied": self.is_applied,
            "look_s": round(self.look_s, 3),
        }


def find_alignment(
    align: str, rig: StereoRig, frames: Callable[[], Generator[Frame, None, None]], progress: Progress | None = None
) -> FoundAlignment:
    """What `--align` asks for.

    Args:
        align: "auto": estimated from the drive's own first frames; "off": nothing; else an alignment file.
        rig: the rectified pair.
        frames: opens the drive's frames, rectified, for a look of its own.
        progress: told how far that look has come.

    Raises:
        RigError: the file cannot be used; left and right are swapped.
    """
    if align == "off":
        return FoundAlignment(measured=Alignment(source="off, as asked"), is_applied=False)
    if align != "auto":
        return FoundAlignment(measured=load_alignment(Path(align)), is_applied=True)
    began_s = time.perf_counter()
    with (progress or _untold)("looking at the pair's alignment") as tell, closing(frames()) as shown:
        measured = _estimated(rig, shown, tell)
    return FoundAlignment(measured=measured, is_applied=measured.is_clear, look_s=time.perf_counter() - began_s)


def _estimated(rig: StereoRig, frames: Generator[Frame, None, None], tell: Callable[[int, int], None]) -> Alignment:
    drive, is_told_apart, first_s = DriveAlignment(rig), False, math.nan
    for number, frame in enumerate(frames):
        first_s = frame.time_s if number == 0 else first_s
        tell(round(10 * (frame.time_s - first_s)), round(10 * _MAX_LOOK_S))
        if not is_told_apart and number < MAX_CHECKED_PAIRS:
            check = checked_pair(frame)
            is_told_apart = check is not None and check.is_conclusive
        drive.add(frame)
        if drive.is_full or frame.time_s - first_s > _MAX_LOOK_S:
            break
    return drive.estimate()


@contextmanager
def _untold(_: str) -> Generator[Callable[[int, int], None], None, None]:
    yield lambda done, total: None
