"""UncalibratedPair: a pair without a rig, with a given or assumed focal length and the vertical offset.

Distances need the focal length f in pixels. If it is not given, it is estimated, and its relative uncertainty is part
of that of all distances.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from track_range.ranging.fitting.camera.measurements import FocalGuess
from track_range.stereo.alignment.model import MAX_ROW_OFFSET_PX
from track_range.stereo.geometry.camera import PinholeCamera

GIVEN_FOCAL_SIGMA = 0.02
"""Relative standard deviation of a focal length given by the user; assumed."""

ASSUMED_BASELINE_M = 0.5
"""Baseline of an uncalibrated pair; it only sets the range of disparities that is searched."""

HOW_TO_CALIBRATE = (
    "for calibrated distances record a chessboard with both cameras, run `track-range calibrate --stereo LEFT RIGHT "
    "--board 9x6 --square-mm MM --out rig.yaml`, and give --rig rig.yaml"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class UncalibratedPair:
    """Assumptions about a pair without calibration.

    Attributes:
        camera: approximate model of both cameras.
        guess: the focal length with its uncertainty.
        is_given: whether the user gave it.
        row_offset_px: y_right - y_left of matching points.
        has_equal_rows: whether matching points have equal rows after that correction; otherwise the pair cannot be
            matched.
    """

    camera: PinholeCamera
    guess: FocalGuess
    is_given: bool
    row_offset_px: float = 0.0
    has_equal_rows: bool = False

    @classmethod
    def of(cls, size_px: tuple[int, int], guess: FocalGuess, *, is_given: bool) -> UncalibratedPair:
        """The pair before images are read; `size_px` is (width, height)."""
        camera = PinholeCamera.of_focal_length(guess.focal_px, size_px)
        return cls(camera=camera, guess=guess, is_given=is_given)

    @property
    def focal_sigma(self) -> float:
        """Relative standard deviation of the focal length."""
        return self.guess.sigma

    def with_focal_length(self, guess: FocalGuess) -> UncalibratedPair:
        """A copy with another estimate of the focal length."""
        size_px = self.camera.width_px, self.camera.height_px
        return replace(self, camera=PinholeCamera.of_focal_length(guess.focal_px, size_px), guess=guess)

    def with_row_offsets(self, row_offsets_px: list[float]) -> UncalibratedPair:
        """A copy with the median of the row offsets of the first image pairs; an empty list = rows do not match."""
        if not row_offsets_px:
            return self
        row_px = float(np.median(row_offsets_px))
        return replace(self, row_offset_px=row_px if abs(row_px) > MAX_ROW_OFFSET_PX else 0.0, has_equal_rows=True)

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user."""
        focal = (
            f"the focal length is {self.camera.fx_px:.0f} px as given" if self.is_given else focal_sentence(self.guess)
        )
        first = (
            f"No rig, so distances are uncalibrated: {focal}, and the baseline is estimated from the sizes of road "
            "users"
        )
        if not self.has_equal_rows:
            return (
                f"No rig, so distances are uncalibrated: {focal}; {HOW_TO_CALIBRATE}.",
                "Matching points of left and right are not in equal rows, so stereo matching needs a rig: distances "
                "come from the left video alone.",
            )
        rows = (
            f" Vertical offset of {self.row_offset_px:+.1f} px between left and right; corrected."
            if self.row_offset_px
            else ""
        )
        return (f"{first}; {HOW_TO_CALIBRATE}.{rows}",)


def focal_sentence(guess: FocalGuess) -> str:
    """Clause about an estimated focal length."""
    return (
        f"the focal length is estimated as {guess.focal_px:.0f} px within {100 * guess.sigma:.0f} %, from "
        f"{guess.source} (give --focal-px if it is known)"
    )
