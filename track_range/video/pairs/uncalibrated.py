"""UncalibratedPair: a pair without a rig, with a given or assumed focal length and the vertical offset.

Distances need the focal length f in pixels. If it is not given, it is computed from the usual field of view of road
cameras, and its relative uncertainty is part of that of all distances.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from track_range.stereo.alignment.model import MAX_ROW_OFFSET_PX
from track_range.stereo.geometry.camera import PinholeCamera

_ASSUMED_FIELD_DEG = 75.0
"""Assumed horizontal field of view; most road cameras have 60 to 90 degrees (KITTI's 81), some more."""

_ASSUMED_FOCAL_SIGMA = 0.25
"""Relative standard deviation of a focal length computed from the assumed field of view."""

_GIVEN_FOCAL_SIGMA = 0.02
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
        focal_sigma: relative standard deviation of the focal length.
        is_assumed: whether the focal length is assumed instead of given.
        row_offset_px: y_right - y_left of matching points.
        has_equal_rows: whether matching points have equal rows after that correction; otherwise the pair cannot be
            matched.
    """

    camera: PinholeCamera
    focal_sigma: float
    is_assumed: bool
    row_offset_px: float = 0.0
    has_equal_rows: bool = False

    @classmethod
    def of(cls, size_px: tuple[int, int], focal_px: float | None) -> UncalibratedPair:
        """The pair before images are read; `size_px` is (width, height), `focal_px` None = unknown."""
        assumed_px = size_px[0] / 2 / math.tan(math.radians(_ASSUMED_FIELD_DEG / 2))
        return cls(
            camera=camera_of_focal_length(focal_px or assumed_px, size_px),
            focal_sigma=_ASSUMED_FOCAL_SIGMA if focal_px is None else _GIVEN_FOCAL_SIGMA,
            is_assumed=focal_px is None,
        )

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
            f"a horizontal field of view of {_ASSUMED_FIELD_DEG:.0f} degrees is assumed (focal length "
            f"{self.camera.fx_px:.0f} px; give --focal-px if it is known)"
            if self.is_assumed
            else f"the focal length is {self.camera.fx_px:.0f} px as given"
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


def camera_of_focal_length(focal_px: float, size_px: tuple[int, int]) -> PinholeCamera:
    """A camera with its principal point at the image centre; `size_px` is (width, height)."""
    width_px, height_px = size_px
    return PinholeCamera(focal_px, focal_px, (width_px - 1) / 2, (height_px - 1) / 2, width_px, height_px)
