"""Calibration of one camera: several views of a flat board -> PinholeCamera (Zhang 2000; OpenCV's
calibrateCamera).

Wide lenses are fitted by `fisheye_fit.py`.

    minimise  sum over views v and corners i of | xy_vi - project(camera, pose_v, xyz_i) |^2

Views with outlying residuals are rejected, worst first. The errors of the corners in a view are
correlated (a board that is not flat, a blurred image), so standard deviations come from leaving out
views. The scatter of the corners alone gives a third of these deviations on real photographs:

    sigma^2 = (G - 1) / G * sum over groups g of (theta_without_g - mean)^2        (delete-a-group jackknife)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray
from track_range.foundation.robust_statistics import jackknife_sigma, mad_sigma
from track_range.stereo.calibration.board_views import BoardView, RejectedView
from track_range.stereo.calibration.boards import CalibrationError
from track_range.stereo.calibration.coverage import Coverage, coverage_of, is_static
from track_range.stereo.calibration.fisheye_fit import UNDETERMINED, fit_fisheye
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import rigid_motion
from track_range.stereo.lenses.lens import PINHOLE

Advance = Callable[[int, int], None]  # progress callback: number of finished steps, and the total
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class CameraModel:
    """The camera model that is fitted to the views."""

    lens: str = PINHOLE  # name of the lens model, pinhole or kannala-brandt
    # number of distortion coefficients of a pinhole: 0, 4, 5 or 8
    n_distortion_coefficients: int = 5
    # a camera near the result, for wide lenses; None = searched for
    start: PinholeCamera | None = None

    def started(self, views: Sequence[BoardView]) -> CameraModel:
        """The model with the camera of these views as the start, for fits to parts of the views."""
        return replace(self, start=fit_camera(views, self)[0]) if self.lens != PINHOLE else self


DISTORTION_FLAGS: dict[int, int] = {  # by number: none; k1 k2 p1 p2; with k3; with k3 k4 k5 k6
    0: cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3,
    4: cv2.CALIB_FIX_K3,
    5: 0,
    8: cv2.CALIB_RATIONAL_MODEL,
}

MIN_VIEWS = 5  # minimum number of views of a calibration with an error estimate; 10 to 30 are usual
# A view is rejected if its residual exceeds both this multiple of the median and the median by this
# many sigmas.
_OUTLIER_RATIO, _OUTLIER_SIGMAS = 2.0, 4.0
_MIN_FRACTION_USED = 2 / 3  # of the views: if more were outliers, the views would not be the cause
_MAX_GROUPS = 20  # largest number of groups of the jackknife
# relative standard deviation of the focal length above which it is not determined
_MAX_FOCAL_STD = 0.05


@dataclass(frozen=True, slots=True)
class ViewFit:
    """Residuals and board pose of one view."""

    view: BoardView
    residual_px: FloatArray  # (N, 2) measured minus projected corners
    board_to_camera: FloatArray  # (4, 4) transform from the board's frame to the camera's, metres

    @classmethod
    def of(cls, view: BoardView, board_to_camera: FloatArray, camera: PinholeCamera) -> ViewFit:
        """The fit of a view with a pose in a camera."""
        projected_px = camera.recorded_px(
            view.xyz_m @ board_to_camera[:3, :3].T + board_to_camera[:3, 3]
        )
        return cls(view, view.xy_px - projected_px, board_to_camera)

    @property
    def rms_px(self) -> float:
        """Root mean square distance between measured and projected corners."""
        return total_rms_px([self])

    @property
    def tilt_deg(self) -> float:
        """Angle between the board and the image plane, degrees."""
        return float(np.degrees(np.arccos(np.clip(abs(self.board_to_camera[2, 2]), 0, 1))))


@dataclass(frozen=True, slots=True)
class IntrinsicStd:
    """Standard deviations of focal lengths and principal point, px."""

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """One calibrated camera with its accuracy."""

    camera: PinholeCamera
    # of its parameters: from leaving out views, or the scatter of the corners if that is larger
    std: IntrinsicStd
    rms_px: float  # root mean square residual of all corners
    fits: tuple[ViewFit, ...]  # the views used
    rejected: tuple[RejectedView, ...]  # the views not used
    coverage: Coverage  # coverage of the image by the views used


def calibrate_camera(
    views: Sequence[BoardView],
    *,
    n_distortion_coefficients: int = 5,
    lens: str = PINHOLE,
    advance: Advance | None = None,
) -> CameraCalibration:
    """Calibrate a camera from views of a board, all of the first view's image size; see
    `CameraModel`.

    Raises CalibrationError if there are too few views, or they do not determine the camera.
    """
    check_views(views)
    model = CameraModel(lens, n_distortion_coefficients).started(views)

    def residuals_px(subset: list[BoardView]) -> list[float]:
        return [fit.rms_px for fit in fit_camera(subset, model)[1]]

    used, rejected = without_outliers(views, residuals_px, lambda view: view.name)
    camera, fits = fit_camera(used, model)
    coverage = coverage_of(used, np.stack([fit.board_to_camera for fit in fits]))
    if coverage.is_parallel:
        raise CalibrationError(PARALLEL)
    sampled = leave_out_groups(
        used, lambda subset: intrinsics(fit_camera(subset, model)[0]), advance
    )
    # With few views the jackknife is uncertain itself; the scatter of the corners is a lower limit.
    if lens == PINHOLE:
        corner_std = np.asarray(
            cv2.calibrateCameraExtended(**_problem(used, model))[5], np.float64
        ).ravel()
    else:
        corner_std = fit_fisheye(used, model.start)[2]
    std = IntrinsicStd(*np.maximum(jackknife_sigma(sampled), corner_std[:4]).tolist())
    check_determined(std, camera)
    return CameraCalibration(camera, std, total_rms_px(fits), fits, rejected, coverage)


PARALLEL = (
    "the board has the same tilt in all views, which does not determine the focal length; "
    "tilt it by 20 to 45 degrees, to the left, right, top and bottom."
)


def fit_camera(
    views: Sequence[BoardView], model: CameraModel
) -> tuple[PinholeCamera, tuple[ViewFit, ...]]:
    """The least-squares camera of all views, and the fit of each view."""
    poses: Iterable[FloatArray]
    if model.lens != PINHOLE:
        camera, poses, _ = fit_fisheye(views, model.start)
    else:
        try:
            _, matrix, distortion, rvecs, tvecs = cv2.calibrateCamera(**_problem(views, model))
        except cv2.error as error:
            raise CalibrationError(UNDETERMINED) from error
        camera = camera_of(matrix, distortion, views[0].size_px, model.n_distortion_coefficients)
        poses = map(pose_of, rvecs, tvecs)
    return camera, tuple(
        ViewFit.of(view, pose, camera) for view, pose in zip(views, poses, strict=True)
    )


def _problem(views: Sequence[BoardView], model: CameraModel) -> dict[str, Any]:
    return {
        "objectPoints": [view.xyz_m.astype(np.float32) for view in views],
        "imagePoints": [view.xy_px.astype(np.float32) for view in views],
        "imageSize": views[0].size_px,
        "cameraMatrix": np.eye(3),
        "distCoeffs": np.zeros(max(model.n_distortion_coefficients, 5)),
        "flags": DISTORTION_FLAGS[model.n_distortion_coefficients],
    }


def camera_of(
    matrix: npt.ArrayLike,
    distortion: npt.ArrayLike,
    size_px: tuple[int, int],
    n_distortion_coefficients: int,
) -> PinholeCamera:
    """The camera with OpenCV's (3, 3) matrix and distortion coefficients."""
    return PinholeCamera.of_matrix(
        matrix, size_px, np.asarray(distortion).ravel()[:n_distortion_coefficients]
    )


def total_rms_px(fits: Sequence[ViewFit]) -> float:
    """Root mean square residual of all corners of all views."""
    return float(
        np.sqrt((np.concatenate([fit.residual_px for fit in fits]) ** 2).sum(axis=1).mean())
    )


def check_views(views: Sequence[BoardView]) -> None:
    """Raise CalibrationError for fewer views than `MIN_VIEWS`, or if the board hardly moves between
    them.
    """
    if len(views) < MIN_VIEWS:
        raise CalibrationError(
            f"expected the board in at least {MIN_VIEWS} views, found it in {len(views)}; add "
            "views (15 to 30 are recommended) with the board tilted and in all parts of the image."
        )
    if is_static(views):
        raise CalibrationError(
            "expected the board at different positions, found it at the same position in all "
            "views; move and tilt it, or move the camera, between the views."
        )


def check_determined(std: IntrinsicStd, camera: PinholeCamera) -> None:
    """Raise CalibrationError if the standard deviation of the focal length is large or NaN."""
    fraction = max(std.fx_px / camera.fx_px, std.fy_px / camera.fy_px)
    if not fraction <= _MAX_FOCAL_STD:
        raise CalibrationError(
            f"the views do not determine the focal length (standard deviation {100 * fraction:.0f} "
            f"%, expected at most {100 * _MAX_FOCAL_STD:.0f} %); add views with the board tilted "
            "by 20 to 45 degrees, in all directions, and near enough to fill the image."
        )


def without_outliers(
    views: Sequence[T], residuals_px: Callable[[list[T]], list[float]], name_of: Callable[[T], str]
) -> tuple[list[T], tuple[RejectedView, ...]]:
    """The views (or pairs) without outliers, and the outliers, worst first; `residuals_px` gives
    RMS residuals.
    """
    used, rejected = list(views), []
    while len(used) > min_used(len(views)):
        rms_px = np.array(residuals_px(used))
        median_px, worst = float(np.median(rms_px)), int(rms_px.argmax())
        if rms_px[worst] <= max(
            _OUTLIER_RATIO * median_px, median_px + _OUTLIER_SIGMAS * mad_sigma(rms_px)
        ):
            break
        reason = f"outlier: residual {rms_px[worst]:.2f} px, median of the views {median_px:.2f} px"
        rejected.append(RejectedView(name_of(used.pop(worst)), reason))
    return used, tuple(rejected)


def min_used(n_views: int) -> int:
    """Minimum number of views to use, out of `n_views`."""
    return max(MIN_VIEWS, round(_MIN_FRACTION_USED * n_views))


def leave_out_groups(
    views: Sequence[T], fitted: Callable[[list[T]], FloatArray], advance: Advance | None = None
) -> FloatArray:
    """(G, P) results of `fitted` without each of G groups of views; few views make groups of one
    view each.
    """
    n_groups = min(len(views), _MAX_GROUPS)
    samples = []
    for group in range(n_groups):
        samples.append(fitted([view for i, view in enumerate(views) if i % n_groups != group]))
        if advance is not None:
            advance(group + 1, n_groups)
    return np.stack(samples)


def intrinsics(camera: PinholeCamera) -> FloatArray:
    """(4,) fx, fy, cx, cy."""
    return np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])


def pose_of(rvec: npt.ArrayLike, tvec: npt.ArrayLike) -> FloatArray:
    """(4, 4) rigid transform with OpenCV's rotation vector and translation."""
    return rigid_motion(cv2.Rodrigues(np.asarray(rvec, np.float64))[0], tvec)
