"""Alignment: the remaining errors of a calibrated pair, and their correction.

    d_true = d_measured + offset_px + slope_px u + curvature_px u^2     u = (x - cx) / (width / 2), about -1 .. 1
    y_right = y_left + row_offset_px                  rows of corresponding points in the middle of the rectified images

The offset is an error of the vergence angle, the slope an error of the ratio of the focal lengths;
the curvature comes from residual distortion, and from vergence, which rotates the right image
plane. On KITTI's pairs six matchers agree on about half a pixel at the objects. Row offset, roll
and focal ratio describe the right camera, see `stereo.alignment.right_view`.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.camera import PinholeCamera

# Standard deviation of the disparity error of a calibrated pair without a measured alignment: six
# matchers agree that the disparities of KITTI's carefully calibrated pairs are about half a pixel
# too small.
UNCORRECTED_SIGMA_PX = 0.5
# The same of two cameras without a calibration: those of a user are parallel by eye, and the files
# of a recording that was rectified may have lost their rig.
UNCALIBRATED_SIGMA_PX = 3.0
MIN_SIGMAS = 2.0  # minimum ratio of an estimate to its standard deviation at which it is applied
MAX_ROW_OFFSET_PX = 0.3  # largest vertical offset without a warning and a correction
# Largest offset that is only added to disparities. For larger ones the right image is also shifted
# by whole pixels: otherwise the disparities of far objects would be below those that are searched.
_MAX_OFFSET_PX = 1.0


# Keys in alignment files and JSON of the fields of `Alignment` with other names.
KEYS = {"curvature_px": "bow_px", "curvature_sigma_px": "bow_sigma_px"}


def column_from_axis(x_px: FloatArray, camera: PinholeCamera) -> FloatArray:
    """(N,) u of columns (N,) of the left image: 0 on the optical axis, 1 half an image width to the
    right of it.
    """
    return (x_px - camera.cx_px) / (camera.width_px / 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Alignment:
    """A measured correction of the disparities of one rectified rig."""

    offset_px: float = 0.0  # correction of all disparities
    # additional correction at the left and right image edges, proportional to u^2
    curvature_px: float = 0.0
    row_offset_px: float = 0.0  # vertical offset y_right - y_left of corresponding points
    # standard deviation of the remaining disparity error, including that of the estimate
    residual_px: float = UNCORRECTED_SIGMA_PX
    offset_sigma_px: float = UNCORRECTED_SIGMA_PX  # standard deviation of the offset
    # standard deviation of the curvature; 0 if it was not estimated
    curvature_sigma_px: float = 0.0
    slope_px: float = 0.0  # additional correction at the right image edge, proportional to u
    slope_sigma_px: float = 0.0  # standard deviation of the slope; 0 if it was not estimated
    # rotation of the right camera about its optical axis relative to the rig, degrees, clockwise
    # positive
    roll_deg: float = 0.0
    focal_ratio: float = 1.0  # focal length of the right camera relative to the rig
    # rotation of the right camera about its vertical axis, degrees; 0 unless it is large
    yaw_deg: float = 0.0
    source: str = "not measured"  # origin of the estimate, for the user

    def corrected(
        self,
        disparity_px: FloatArray,
        sigma_px: FloatArray,
        *,
        x_px: FloatArray,
        camera: PinholeCamera,
    ) -> tuple[FloatArray, FloatArray]:
        """(N,) corrected disparities at columns x_px (N,) of the rectified left image, and sigmas;
        NaN stays NaN.
        """
        u = column_from_axis(x_px, camera)
        return disparity_px + self.error_px(u), np.hypot(sigma_px, self.residual_px)

    def error_px(self, u: FloatArray) -> FloatArray:
        """(N,) d_true - d_measured at the columns `u` (N,) from the axis."""
        return np.asarray(self.offset_px + self.slope_px * u + self.curvature_px * u**2)

    @property
    def shift_px(self) -> float:
        """The part of the offset, whole px, by which a run shifts the right image to the left; 0
        for small offsets.
        """
        return float(round(self.offset_px)) if abs(self.offset_px) > _MAX_OFFSET_PX else 0.0

    def after_shift(self) -> Alignment:
        """The correction of disparities that remains after the right image is shifted by
        `shift_px`.
        """
        return replace(self, offset_px=self.offset_px - self.shift_px)

    @property
    def is_correcting(self) -> bool:
        """Whether the correction changes disparities."""
        return self.offset_px != 0.0 or self.curvature_px != 0.0 or self.slope_px != 0.0

    @property
    def is_clear(self) -> bool:
        """Whether offset, slope or curvature are significantly different from 0."""
        offset, slope = (self.offset_px, self.offset_sigma_px), (self.slope_px, self.slope_sigma_px)
        curvature = self.curvature_px, self.curvature_sigma_px
        return any(abs(px) > MIN_SIGMAS * sigma_px for px, sigma_px in (offset, slope, curvature))

    @property
    def row_correction_px(self) -> float:
        """Upward shift of the right image; 0 for a small row offset, because a subpixel shift blurs
        the image.
        """
        return self.row_offset_px if abs(self.row_offset_px) > MAX_ROW_OFFSET_PX else 0.0

    def if_clear(self) -> Alignment:
        """This alignment if it is significant, else `withheld`."""
        return self if self.is_clear else self.withheld()

    def withheld(self) -> Alignment:
        """The alignment without its correction of disparities, which becomes part of the
        residual.
        """
        largest_px = max(UNCORRECTED_SIGMA_PX, self.offset_sigma_px)
        residual_px = min(float(np.hypot(self.offset_px, self.residual_px)), largest_px)
        return replace(self, offset_px=0.0, curvature_px=0.0, slope_px=0.0, residual_px=residual_px)

    @property
    def is_measured(self) -> bool:
        """Whether the offset was measured, applied or not."""
        return self.offset_sigma_px < UNCORRECTED_SIGMA_PX

    def to_dict(self) -> dict[str, float | str]:
        """The values by their keys in alignment files and JSON."""
        return {KEYS.get(name, name): value for name, value in asdict(self).items()}

    def sentence(self, *, correction: str = "corrected") -> str:
        """The alignment and its effect as one sentence for users; `correction` ends it if
        disparities are corrected.
        """
        if self.is_correcting:
            offset, curvature = (
                "too small" if px >= 0 else "too large"
                for px in (self.offset_px, self.curvature_px)
            )
            error = f"{abs(self.offset_px):.2f} ± {self.offset_sigma_px:.2f} px {offset}"
            if self.curvature_px:
                error += (
                    f", and another {abs(self.curvature_px):.2f} px {curvature} at the image edges"
                )
            return f"Alignment: disparities {error} (source: {self.source}); {correction}."
        if self.is_measured:
            return (
                f"Alignment: no significant disparity error, ± {self.offset_sigma_px:.2f} px "
                f"(source: {self.source}); not corrected."
            )
        return (
            f"Alignment: {self.source}; disparities not corrected, uncertainty ± "
            f"{self.residual_px:.2f} px."
        )
