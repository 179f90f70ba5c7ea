"""Calibration of one camera: several views of a flat board -> PinholeCamera (Zhang 2000; OpenCV's calibrateCamera).

    minimise  sum over views v and corners i of | xy_vi - project(camera, pose_v, xyz_i) |^2

Views whose residual sticks out are left out, worst first. Corners of one view err together (a board that is not flat,
an image that is blurred), so standard deviations come from leaving out views, not from the corners' scatter alone,
which on real photographs gives a third of it:

    sd^2 = (G - 1) / G * sum over groups g of (theta_without_g - mean)^2        (delete-a-group jackknife)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray
from track_range.foundation.robust_statistics import jackknife_sigma, mad_sigma
from track_range.stereo.calibration.board_views import BoardView, RejectedView
from track_range.stereo.calibration.boards import CalibrationError
from track_range.stereo.calibration.coverage import Coverage, coverage_of, lack_of_motion
from track_range.stereo.geometry.camera import PinholeCamera

Advance = Callable[[int, int], None]
T = TypeVar("T")

LENS_TERMS: dict[int, int] = {
    0: cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3,
    4: cv2.CALIB_FIX_K3,
    5: 0,
    8: cv2.CALIB_RATIONAL_MODEL,
}
"""OpenCV's flags by the number of lens terms: none; k1 k2 p1 p2; and k3; and k4 k5 k6."""

MIN_VIEWS = 5
"""Fewer fix no camera whose errors could be told; ten to thirty are usual."""

_OUTLIER_TIMES = 2.0
_OUTLIER_SDS = 4.0
"""A view is left out if its residual is so many times the median one, and so many robust sigmas above it."""

_KEPT_SHARE = 2 / 3
"""If more than a third of the views would have to go, it is not they that are wrong."""

_MAX_GROUPS = 20
_MAX_FOCAL_SD = 0.05
"""Relative standard deviation of the focal length above which it counts as not determined."""


@dataclass(frozen=True, slots=True)
class ViewFit:
    """How well one view agrees.

    Attributes:
        view: the view.
        residual_px: (N, 2) measured minus projected corners.
        board_to_camera: (4, 4) pose of the board, metres.
    """

    view: BoardView
    residual_px: FloatArray
    board_to_camera: FloatArray

    @property
    def rms_px(self) -> float:
        """Root mean square distance between measured and projected corners."""
        return float(np.sqrt((self.residual_px**2).sum(axis=1).mean()))


class Fit(Protocol):
    """How well one view, or pair of views, agrees."""

    @property
    def view(self) -> BoardView:
        """The view, or the pair's left one."""

    @property
    def rms_px(self) -> float:
        """Its residual."""


@dataclass(frozen=True, slots=True)
class IntrinsicStd:
    """Standard deviations of a camera's numbers, px."""

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """One calibrated camera, and what there is to know of it.

    Attributes:
        camera: the camera.
        std: of its numbers: from leaving out views, or from the corners' scatter where that is more.
        rms_px: root mean square residual of all corners.
        fits: the views used.
        rejected: the views left out.
        coverage: of the image by the views used.
    """

    camera: PinholeCamera
    std: IntrinsicStd
    rms_px: float
    fits: tuple[ViewFit, ...]
    rejected: tuple[RejectedView, ...]
    coverage: Coverage


def calibrate_camera(
    views: Sequence[BoardView], *, n_distortion_coefficients: int = 5, advance: Advance | None = None
) -> CameraCalibration:
    """Calibrate the camera that took all these views; the first one's size is taken for all.

    Args:
        views: of one board, from one camera.
        n_distortion_coefficients: 0, 4, 5 or 8.
        advance: told steps done, and of how many.

    Raises:
        CalibrationError: too few views, or they do not determine the camera.
    """
    check_views(len(views))
    check_motion(views)
    kept, rejected = without_outliers(list(views), lambda those: fit_camera(those, n_distortion_coefficients)[1])
    camera, fits = fit_camera(kept, n_distortion_coefficients)
    coverage = coverage_of(kept, np.stack([fit.board_to_camera for fit in fits]))
    if coverage.is_parallel:
        raise CalibrationError(PARALLEL)
    sampled = leave_out_groups(
        kept, lambda those: _intrinsics(fit_camera(those, n_distortion_coefficients)[0]), advance
    )
    # Few views make the jackknife itself uncertain; the corners' scatter is what is left at least.
    std = IntrinsicStd(*np.maximum(jackknife_sigma(sampled), _corner_std(kept, n_distortion_coefficients)).tolist())
    check_determined(std, camera)
    return CameraCalibration(camera, std, total_rms_px(fits), fits, rejected, coverage)


PARALLEL = (
    "the board has the same tilt in all views, which leaves the focal length open; "
    "tilt it by 20 to 45 degrees, to the left, right, top and bottom."
)


def fit_camera(views: Sequence[BoardView], n_distortion_coefficients: int) -> tuple[PinholeCamera, tuple[ViewFit, ...]]:
    """The camera with the least squared residuals, and how each view fits; nothing is left out."""
    size_px = views[0].size_px
    with_points = ([view.xyz_m.astype(np.float32) for view in views], [view.xy_px.astype(np.float32) for view in views])
    try:
        _, matrix, lens, turns, shifts = cv2.calibrateCamera(
            *with_points,
            size_px,
            np.eye(3),
            np.zeros(max(n_distortion_coefficients, 5)),
            flags=LENS_TERMS[n_distortion_coefficients],
        )
    except cv2.error as error:
        raise CalibrationError("these views determine no camera; show the board tilted and in other places.") from error
    camera = camera_of(matrix, lens, size_px, n_distortion_coefficients)
    poses = [pose_of(turn, shift) for turn, shift in zip(turns, shifts, strict=True)]
    return camera, tuple(
        ViewFit(view, residuals_px(view, pose, camera), pose) for view, pose in zip(views, poses, strict=True)
    )


def residuals_px(view: BoardView, board_to_camera: FloatArray, camera: PinholeCamera) -> FloatArray:
    """(N, 2) measured minus projected corners."""
    turn = np.asarray(cv2.Rodrigues(board_to_camera[:3, :3])[0])
    lens = np.array(camera.distortion or (0.0,) * 4)
    projected = cv2.projectPoints(view.xyz_m, turn, board_to_camera[:3, 3], camera.matrix, lens)[0]
    return view.xy_px - np.asarray(projected, np.float64).reshape(-1, 2)


def camera_of(
    matrix: npt.ArrayLike, lens: npt.ArrayLike, size_px: tuple[int, int], n_distortion_coefficients: int
) -> PinholeCamera:
    """OpenCV's (3, 3) matrix and lens terms as a camera."""
    (fx, _, cx), (_, fy, cy) = np.asarray(matrix, np.float64)[:2].tolist()
    terms = np.asarray(lens, np.float64).ravel()[:n_distortion_coefficients]
    return PinholeCamera(fx, fy, cx, cy, *size_px, tuple(terms.tolist()))


def total_rms_px(fits: Sequence[ViewFit]) -> float:
    """Root mean square residual of all corners of all views."""
    return float(np.sqrt((np.concatenate([fit.residual_px for fit in fits]) ** 2).sum(axis=1).mean()))


def check_views(n_views: int) -> None:
    """Refuse to calibrate with too few views.

    Raises:
        CalibrationError: fewer than `MIN_VIEWS`.
    """
    if n_views < MIN_VIEWS:
        raise CalibrationError(
            f"the board was found in {n_views} view{'' if n_views == 1 else 's'} only, {MIN_VIEWS} at least are wanted "
            "and 15 to 30 are good; add more, with the board tilted and in all parts of the image."
        )


def check_motion(views: Sequence[BoardView]) -> None:
    """Refuse views that are all the same.

    Raises:
        CalibrationError: the board hardly moves.
    """
    if lack_of_motion(views):
        raise CalibrationError(
            "the board stands at the same place in all views; move and tilt it, or move the camera, between them."
        )


def check_determined(std: IntrinsicStd, camera: PinholeCamera) -> None:
    """Refuse a camera whose focal length is open.

    Raises:
        CalibrationError: its standard deviation is large, or no number.
    """
    share = max(std.fx_px / camera.fx_px, std.fy_px / camera.fy_px)
    if not share <= _MAX_FOCAL_SD:
        raise CalibrationError(
            f"these views leave the focal length open (standard deviation {100 * share:.0f} %); "
            "add views with the board tilted by 20 to 45 degrees, in all directions, and near enough to fill the image."
        )


def without_outliers(
    views: list[T], fitted: Callable[[list[T]], Sequence[Fit]]
) -> tuple[list[T], tuple[RejectedView, ...]]:
    """The views without those whose residual sticks out, worst first, and these with the reason.

    `fitted` gives the fits of some views, in their order. A pair may be a view here.
    """
    kept, rejected = list(views), []
    least = max(MIN_VIEWS, round(_KEPT_SHARE * len(views)))
    while len(kept) > least:
        fits = fitted(kept)
        rms_px = np.array([fit.rms_px for fit in fits])
        median_px = float(np.median(rms_px))
        sd_px = mad_sigma(rms_px)
        worst = int(rms_px.argmax())
        if rms_px[worst] <= max(_OUTLIER_TIMES * median_px, median_px + _OUTLIER_SDS * sd_px):
            break
        kept.pop(worst)
        reason = f"residual {rms_px[worst]:.2f} px, where the others have {median_px:.2f} px"
        rejected.append(RejectedView(fits[worst].view.name, reason))
    return kept, tuple(rejected)


def leave_out_groups(
    views: Sequence[T], fitted: Callable[[list[T]], FloatArray], advance: Advance | None = None
) -> FloatArray:
    """(G, P) what `fitted` gives without each of G groups of views, which are one view each where these are few."""
    n_groups = min(len(views), _MAX_GROUPS)
    samples = []
    for group in range(n_groups):
        samples.append(fitted([view for i, view in enumerate(views) if i % n_groups != group]))
        if advance is not None:
            advance(group + 1, n_groups)
    return np.stack(samples)


def _corner_std(views: Sequence[BoardView], n_distortion_coefficients: int) -> FloatArray:
    """(4,) standard deviations of fx, fy, cx, cy if all corners erred on their own (OpenCV's)."""
    corners = ([view.xyz_m.astype(np.float32) for view in views], [view.xy_px.astype(np.float32) for view in views])
    terms, flags = np.zeros(max(n_distortion_coefficients, 5)), LENS_TERMS[n_distortion_coefficients]
    std = cv2.calibrateCameraExtended(*corners, views[0].size_px, np.eye(3), terms, flags=flags)[5]
    return np.asarray(std, np.float64).ravel()[:4]


def _intrinsics(camera: PinholeCamera) -> FloatArray:
    return np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])


def pose_of(turn: npt.ArrayLike, shift: npt.ArrayLike) -> FloatArray:
    """(4, 4) pose of a rotation vector and a translation."""
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.asarray(turn, np.float64))[0]
    pose[:3, 3] = np.asarray(shift, np.float64).ravel()
    return pose
