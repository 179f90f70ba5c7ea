"""A pair without a rig: a focal length given or assumed, and the vertical offset of its first frames.

Without the focal length f an image determines no distances: an object twice as far and twice as large gives the same
image. So f is taken from the usual field of view of dash cameras, and its uncertainty is that of all distances.
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
"""Sets the range of disparities that is searched, and nothing else."""

HOW_TO_CALIBRATE = (
    "for true metres photograph a chessboard with both cameras, run `track-range calibrate --stereo LEFT RIGHT "
    "--board 9x6 --square-mm MM --out rig.yaml`, and give --rig rig.yaml"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class UncalibratedPair:
    """Assumptions on a pair without calibration.

    Attributes:
        camera: either camera, approximately.
        focal_sigma: relative standard deviation of its focal length.
        is_assumed: whether the focal length is assumed, not given.
        row_offset_px: y_right - y_left of matching points.
        has_equal_rows: whether rows of left and right agree once it is taken out; else the pair cannot be matched.
    """

    camera: PinholeCamera
    focal_sigma: float
    is_assumed: bool
    row_offset_px: float = 0.0
    has_equal_rows: bool = False

    @classmethod
    def of(cls, size_px: tuple[int, int], focal_px: float | None) -> UncalibratedPair:
        """The pair before its images are read: size_px (width, height); focal_px None = unknown."""
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
        """Sentences for the user."""
        focal = (
            f"a horizontal field of view of {_ASSUMED_FIELD_DEG:.0f} degrees is assumed (focal length "
            f"{self.camera.fx_px:.0f} px; give --focal-px if you know it)"
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
                "Rows of left and right do not agree, so without a rig stereo cannot be used: distances come from the "
                "left video alone.",
            )
        rows = (
            f" Vertical offset of {self.row_offset_px:+.1f} px between left and right; corrected."
            if self.row_offset_px
            else ""
        )
        return (f"{first}; {HOW_TO_CALIBRATE}.{rows}",)


def camera_of_focal_length(focal_px: float, size_px: tuple[int, int]) -> PinholeCamera:
    """A camera whose principal point is the centre of its image; size_px (width, height)."""
    width_px, height_px = size_px
    return PinholeCamera(focal_px, focal_px, (width_px - 1) / 2, (height_px - 1) / 2, width_px, height_px)
