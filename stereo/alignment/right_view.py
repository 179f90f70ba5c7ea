"""RightView: the errors of the right camera of a rectified pair, and their estimate from matched points."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.robust_statistics import jackknife_sigma
from track_range.stereo.geometry.alignment import MAX_ROW_OFFSET_PX, Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.cauchy_fit import CauchyFit, cauchy_fit

_N_ROUNDS = 8  # rounds of the reweighted least squares, for many points
# minimum number of points for roll and focal ratio; with fewer, only the median row offset is used
_MIN_POINTS = 200
_N_STRIPS = 8  # number of vertical strips of the jackknife
_MAX_POINTS = 12_000  # largest number of points in the fit; more do not make it more accurate
# minimum standard deviation of the columns, as a fraction of the value for points all over the
# image
_MIN_SPAN = 0.5


@dataclass(frozen=True, slots=True)
class RightView:
    """Errors of the right camera of a rectified pair that move rows, from the rows of matched
    points.

        M = R(pitch, 0, roll) diag(1 / ratio, 1 / ratio, 1)         (x, y, 1) of the right image -> M (x, y, 1)
        y_right - y_left = f (-roll X + pitch (1 + Y^2) - yaw X Y + ln(ratio) Y)       X, Y: right point / f

    with rotation angles about the axes x (pitch), y (yaw), z (roll). In a rectified pair
    corresponding points have equal rows, so all four angles and the ratio are visible in a single
    pair. A small yaw is not used: in real lenses residual distortion has the same form (on a KITTI
    drive it would be 0.5 degrees, and the disparities disagree).
    """

    row_offset_px: float = 0.0  # y_right - y_left in the middle of the image
    roll_deg: float = 0.0  # rotation about the optical axis
    focal_ratio: float = 1.0  # true focal length divided by the rig's
    yaw_deg: float = 0.0  # rotation about the vertical axis; 0 unless it is large

    @classmethod
    def of(cls, alignment: Alignment) -> RightView:
        """The view of an alignment."""
        return cls(
            alignment.row_offset_px, alignment.roll_deg, alignment.focal_ratio, alignment.yaw_deg
        )

    def rows_px(self, camera: PinholeCamera) -> float:
        """Root mean square of y_right - y_left over the image."""
        roll_px = math.radians(self.roll_deg) * camera.width_px / math.sqrt(12)
        focal_px = (self.focal_ratio - 1) * camera.height_px / math.sqrt(12)
        yaw_px = (
            math.radians(self.yaw_deg) * camera.width_px * camera.height_px / (12 * camera.fx_px)
        )
        return math.hypot(self.row_offset_px, roll_px, focal_px, yaw_px)

    def if_needed(self, camera: PinholeCamera) -> RightView:
        """The view if rows differ by more than 0.3 px, else the view of a right camera without
        errors.
        """
        return self if self.rows_px(camera) > MAX_ROW_OFFSET_PX else RightView()

    def matrix(self, camera: PinholeCamera) -> FloatArray:
        """(3, 3) M from directions in the rectified right image to corrected directions."""
        pitch_rad = math.atan(self.row_offset_px / camera.fx_px)
        rotation = cv2.Rodrigues(
            np.array([pitch_rad, math.radians(self.yaw_deg), math.radians(self.roll_deg)])
        )[0]
        return np.asarray(
            rotation @ np.diag([1 / self.focal_ratio, 1 / self.focal_ratio, 1.0]), np.float64
        )

    def corrected(self, right_px: FloatArray, camera: PinholeCamera) -> FloatArray:
        """(N, 2) corrected points of the rectified right image."""
        if self == RightView():
            return right_px
        return camera.project(camera.rays(right_px) @ self.matrix(camera).T)


def fit_rows(
    left_px: FloatArray,
    right_px: FloatArray,
    camera: PinholeCamera,
    *,
    least_scale_px: float,
    n_rounds: int = 4,
) -> CauchyFit:
    """(4,) pitch f, roll w, ln(ratio) w and yaw w of the right camera in px, with w half an image
    width, from the rows of matched points (N, 2); a point that is off by twice the scatter of all,
    at least `least_scale_px`, has half the weight.
    """
    X, Y = camera.rays(right_px)[:, :2].T
    f_over_w = camera.fx_px / (camera.width_px / 2)
    design = np.array([1 + Y**2, -f_over_w * X, f_over_w * Y, -f_over_w * X * Y]).T
    rows_px = right_px[:, 1] - left_px[:, 1]
    return cauchy_fit(design, rows_px, least_scale=least_scale_px, n_rounds=n_rounds)


def view_sigma(left_px: FloatArray, right_px: FloatArray, camera: PinholeCamera) -> FloatArray:
    """(3,) standard deviations of row offset in px, roll in degrees and focal ratio of
    `fit_right_view`, by the jackknife over strips of the image: errors of a lens are common to all
    points there.
    """
    strip = (left_px[:, 0] * _N_STRIPS / camera.width_px).astype(np.int64)
    views = [
        fit_right_view(left_px[strip != k], right_px[strip != k], camera) for k in range(_N_STRIPS)
    ]
    values = np.array([(v.row_offset_px, v.roll_deg, v.focal_ratio) for v in views])
    return jackknife_sigma(values)


def fit_right_view(
    left_px: FloatArray, right_px: FloatArray, camera: PinholeCamera, *, has_yaw: bool = False
) -> RightView:
    """The right view from matched points (N, 2) of one or several rectified pairs; without its yaw
    by default.
    """
    rows_px = right_px[:, 1] - left_px[:, 1]
    step = len(rows_px) // _MAX_POINTS + 1
    left_px, rows_px, right_px = left_px[::step], rows_px[::step], right_px[::step]
    median_px = float(np.median(rows_px)) if len(rows_px) else 0.0
    if len(rows_px) < _MIN_POINTS or right_px[:, 0].std() < _MIN_SPAN * camera.width_px / math.sqrt(
        12
    ):
        return RightView(median_px)
    fit = fit_rows(left_px, right_px, camera, least_scale_px=1e-3, n_rounds=_N_ROUNDS)
    pitch_px = float(fit.solution[0])
    roll_rad, log_ratio, yaw_rad = (fit.solution[1:] / (camera.width_px / 2)).tolist()
    view = RightView(
        median_px,
        math.degrees(roll_rad),
        math.exp(log_ratio),
        math.degrees(yaw_rad) if has_yaw else 0.0,
    )
    if view.rows_px(camera) <= MAX_ROW_OFFSET_PX:
        return view
    f = camera.fx_px
    return replace(view, row_offset_px=f * math.tan(pitch_px / f))
