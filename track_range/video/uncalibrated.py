"""A pair without a rig: a focal length given or assumed, rows made to agree, and what the user is told of it.

Without the focal length f no picture tells metres: everything twice as far and twice as large looks the same. So f is
taken from how wide dash cameras usually see, and all distances are as uncertain as that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from track_range.stereo.alignment.model import MAX_ROW_OFFSET_PX
from track_range.stereo.geometry.camera import PinholeCamera

_ASSUMED_FIELD_DEG = 75.0
"""Horizontal field of view; road cameras have 60 to 90 degrees (KITTI's 81), some wider."""

_ASSUMED_FOCAL_SIGMA = 0.25
"""Relative standard deviation of a focal length taken from it."""

_GIVEN_FOCAL_SIGMA = 0.02

ASSUMED_BASELINE_M = 0.5
"""For the range of disparities that is searched, and for nothing else."""

HOW_TO_CALIBRATE = (
    "for true metres photograph a chessboard with both cameras, run `track-range calibrate --stereo LEFT RIGHT "
    "--board 9x6 --square-mm MM --out rig.yaml`, and give --rig rig.yaml"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class UncalibratedPair:
    """What is taken for granted of a pair that nobody has calibrated.

    Attributes:
        camera: either camera, roughly.
        focal_sigma: relative standard deviation of its focal length.
        is_assumed: whether that is no more than a guess.
        row_offset_px: y_right - y_left of matching points.
        has_equal_rows: whether there is such an offset at all; without one the pair cannot be matched.
    """

    camera: PinholeCamera
    focal_sigma: float
    is_assumed: bool
    row_offset_px: float = 0.0
    has_equal_rows: bool = False

    @classmethod
    def of(cls, size_px: tuple[int, int], focal_px: float | None) -> UncalibratedPair:
        """Before its images have been looked at: for images of (width, height) and a focal length, None = unknown."""
        assumed_px = size_px[0] / 2 / math.tan(math.radians(_ASSUMED_FIELD_DEG / 2))
        return cls(
            camera=camera_of_focal_length(focal_px or assumed_px, size_px),
            focal_sigma=_ASSUMED_FOCAL_SIGMA if focal_px is None else _GIVEN_FOCAL_SIGMA,
            is_assumed=focal_px is None,
        )

    def with_rows(self, row_offsets_px: list[float]) -> UncalibratedPair:
        """This pair with the row offsets that its first pairs show; none = rows do not agree."""
        if not row_offsets_px:
            return self
        row_px = float(np.median(row_offsets_px))
        return replace(self, row_offset_px=row_px if abs(row_px) > MAX_ROW_OFFSET_PX else 0.0, has_equal_rows=True)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know."""
        focal = (
            f"a horizontal field of view of {_ASSUMED_FIELD_DEG:.0f} degrees is assumed (focal length "
            f"{self.camera.fx_px:.0f} px; give --focal-px if you know it)"
            if self.is_assumed
            else f"the focal length is {self.camera.fx_px:.0f} px as given"
        )
        first = (
            f"No rig, so distances are uncalibrated: {focal}, and the baseline is learnt from the sizes of road users"
        )
        if not self.has_equal_rows:
            return (
                f"No rig, so distances are uncalibrated: {focal}; {HOW_TO_CALIBRATE}.",
                "Rows of left and right do not agree, so without a rig stereo cannot be used: distances come from the "
                "left video alone.",
            )
        rows = (
            f" Rows of left and right are {self.row_offset_px:+.1f} px apart; corrected." if self.row_offset_px else ""
        )
        return (f"{first}; {HOW_TO_CALIBRATE}.{rows}",)


def camera_of_focal_length(focal_px: float, size_px: tuple[int, int]) -> PinholeCamera:
    """A camera that looks at the middle of its image of (width, height)."""
    width_px, height_px = size_px
    return PinholeCamera(focal_px, focal_px, (width_px - 1) / 2, (height_px - 1) / 2, width_px, height_px)
