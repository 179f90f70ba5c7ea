"""Alignment: what a calibrated pair still gets wrong, and its correction.

    d_true = d_measured + offset_px + bow_px u^2        u = (x - cx) / (width / 2), about -1 .. 1
    y_right = y_left + row_offset_px                    rows of the rectified right image that match those of the left

The offset is an error of vergence, the bow what distortion leaves (and vergence: it turns the right image plane). On
KITTI's pairs six matchers agree on about half a pixel at the objects.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.camera import PinholeCamera

UNCORRECTED_SIGMA_PX = 0.5
"""Disparity error that a calibrated pair keeps while nobody has measured and corrected it.

Six matchers agree that KITTI's pairs, carefully calibrated, read about half a pixel low at small disparities.
"""


MIN_SIGMAS = 2.0
"""An estimate nearer to zero than this many of its standard deviations is not to be applied."""

MAX_ROW_OFFSET_PX = 0.3
"""Rows further apart than this are worth a warning and a correction."""


def column_from_axis(x_px: FloatArray, camera: PinholeCamera) -> FloatArray:
    """(N,) u of columns (N,) of the left image: 0 on the optical axis, 1 half an image's width right of it."""
    return (x_px - camera.cx_px) / (camera.width_px / 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Alignment:
    """A measured correction of the disparities of one rectified rig.

    Attributes:
        offset_px: added to each disparity.
        bow_px: added at the image's side edges, and less by the square of the distance from the axis inside.
        row_offset_px: y_right - y_left of matching points.
        residual_px: standard deviation of the disparity error that is left, this estimate's own error included.
        offset_sigma_px: standard deviation of the estimated offset.
        bow_sigma_px: of the bow; 0 where none was estimated.
        source: where it comes from, in words for the user.
    """

    offset_px: float = 0.0
    bow_px: float = 0.0
    row_offset_px: float = 0.0
    residual_px: float = UNCORRECTED_SIGMA_PX
    offset_sigma_px: float = UNCORRECTED_SIGMA_PX
    bow_sigma_px: float = 0.0
    source: str = "not measured"

    def corrected(
        self, disparity_px: FloatArray, sigma_px: FloatArray, *, x_px: FloatArray, camera: PinholeCamera
    ) -> tuple[FloatArray, FloatArray]:
        """(N,) disparities measured at the columns x_px (N,) of the left image, put right, and (N,) their sigmas.

        `camera` is the rectified left one. NaN stays NaN.
        """
        u = column_from_axis(x_px, camera)
        return disparity_px + self.offset_px + self.bow_px * u**2, np.hypot(sigma_px, self.residual_px)

    @property
    def is_correcting(self) -> bool:
        """Whether it changes any disparity."""
        return self.offset_px != 0.0 or self.bow_px != 0.0

    @property
    def is_clear(self) -> bool:
        """Whether its correction is more than its own uncertainty."""
        return (
            abs(self.offset_px) > MIN_SIGMAS * self.offset_sigma_px or abs(self.bow_px) > MIN_SIGMAS * self.bow_sigma_px
        )

    @property
    def rows_to_move_px(self) -> float:
        """How far the right image is to be moved up; 0 for a small offset, since moving by part of a pixel blurs."""
        return self.row_offset_px if abs(self.row_offset_px) > MAX_ROW_OFFSET_PX else 0.0

    def if_clear(self) -> Alignment:
        """Itself where it is clear, else `withheld`."""
        return self if self.is_clear else self.withheld()

    def withheld(self) -> Alignment:
        """Without its correction, which is then part of what is left."""
        residual_px = min(float(np.hypot(self.offset_px, self.residual_px)), UNCORRECTED_SIGMA_PX)
        return replace(self, offset_px=0.0, bow_px=0.0, residual_px=residual_px)

    @property
    def is_measured(self) -> bool:
        """Whether anybody has measured the offset, applied or not."""
        return self.offset_sigma_px < UNCORRECTED_SIGMA_PX

    def sentence(self) -> str:
        """What it says and does, in plain words."""
        if self.is_correcting:
            way = "low" if self.offset_px >= 0 else "high"
            bow = f", and {abs(self.bow_px):.2f} px {'lower' if self.bow_px > 0 else 'higher'} at the side edges"
            told = f"{abs(self.offset_px):.2f} +- {self.offset_sigma_px:.2f} px {way}{bow if self.bow_px else ''}"
            return f"Alignment: disparities read {told} (from {self.source}); corrected."
        if self.is_measured:
            return (
                f"Alignment: no clear error of the disparities, +- {self.offset_sigma_px:.2f} px (from {self.source}); "
                "they are taken as they are."
            )
        return f"Alignment: {self.source}; disparities are taken as they are, +- {self.residual_px:.2f} px."
