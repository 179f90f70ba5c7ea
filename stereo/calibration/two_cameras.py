"""Calibration of two cameras: pairs of views of one board -> StereoRig (OpenCV's stereoCalibrate).

Each camera is calibrated alone first, which gives initial values and reveals bad views; then the
intrinsics of both cameras, their relative pose and the poses of the board are optimised together.
Wide lenses are fitted by `fisheye_fit.py`. The row error is also evaluated on pairs held out of the
fit:

    dy = | y_left - y_right | of a corner in the rectified images, 0 for a perfect rig
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.robust_statistics import jackknife_sigma
from track_range.stereo.calibration import one_camera
from track_range.stereo.calibration.board_views import BoardView, RejectedView
from track_range.stereo.calibration.boards import CalibrationError
from track_range.stereo.calibration.coverage import coverage_of
from track_range.stereo.calibration.fisheye_fit import fit_fisheye_pair
from track_range.stereo.geometry import rectification
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError, StereoRig, rigid_motion
from track_range.stereo.geometry.rig_checks import BASELINE_M
from track_range.stereo.lenses.lens import PINHOLE

# views of the left and the right camera with the same corners
ViewPair = tuple[BoardView, BoardView]
# models of the left and the right camera
Models = tuple[one_camera.CameraModel, one_camera.CameraModel]
_UPSIDE_DOWN_DEG = 120.0  # angle between the cameras above which one of them is upside down
_MAX_ANGLE_DEG = 45.0  # largest angle between the cameras
# iterations, and relative change
_CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-7)
# Ratio of a pair's residual in the joint fit to that in fits of the single cameras above which the
# board moved between its images. For wide lenses only: their boards are near, so that small
# movements show.
_MOVED_RATIO = 2.0
# ratio of the residuals of joint and single fits above which the pairs are inconsistent
_MAX_RMS_RATIO = 5.0


@dataclass(frozen=True, slots=True)
class PairFit:
    """Fit of one pair: the fits of both views, and the mean |dy| in pixels."""

    left: one_camera.ViewFit
    right: one_camera.ViewFit
    row_error_px: float

    @property
    def rms_px(self) -> float:
        """Root mean square residual of the corners of both views."""
        return math.sqrt((self.left.rms_px**2 + self.right.rms_px**2) / 2)


@dataclass(frozen=True, slots=True)
class PairCalibration:
    """A calibrated rig with its accuracy."""

    rig: StereoRig
    left: one_camera.CameraCalibration  # from the common fit, like `right`
    right: one_camera.CameraCalibration
    baseline_std_m: float  # standard deviation of the baseline, from leaving out pairs
    scale_sigma: float  # relative standard deviation of focal length times baseline, likewise
    rms_px: float  # root mean square residual of all corners
    # the same of the left and of the right camera fitted alone; the difference to `rms_px` is due
    # to boards or cameras that moved between the two images of a pair
    single_rms_px: tuple[float, float]
    row_error_px: float  # mean |dy| after rectification, of the pairs that the rig was fitted to
    held_out_row_error_px: float  # mean |dy| after rectification, of pairs held out of the fit
    fits: tuple[PairFit, ...]  # the pairs used
    rejected: tuple[RejectedView, ...]  # the pairs not used


def calibrate_pair(
    pairs: Sequence[ViewPair],
    *,
    n_distortion_coefficients: int = 5,
    lens: str = PINHOLE,
    advance: one_camera.Advance | None = None,
) -> PairCalibration:
    """Calibrate a rig from pairs of views with the same corners, in simultaneous images; see
    `CameraModel`.

    Raises CalibrationError if there are too few pairs, they do not determine the rig, or the
    cameras are swapped or upside down.
    """
    for side in (0, 1):
        one_camera.check_views([pair[side] for pair in pairs])
    model = one_camera.CameraModel(lens, n_distortion_coefficients)
    models = model.started([pair[0] for pair in pairs]), model.started([pair[1] for pair in pairs])

    def residuals_px(subset: list[ViewPair]) -> list[float]:
        return [fit.rms_px for fit in _fit(subset, models)[1]]

    used, rejected = one_camera.without_outliers(pairs, residuals_px, lambda pair: pair[0].name)
    used, moved = (
        _without_moved_boards(used, one_camera.min_used(len(pairs)), models)
        if lens != PINHOLE
        else (used, ())
    )
    rig, fits = _fit(used, models)
    left_px, right_px = (one_camera.total_rms_px(fits) for _, fits in _single_fits(used, models))
    _check_consistency(max(left_px, right_px), fits)
    _check_relative_pose(rig)
    held_out_px: list[float] = []

    def parameters_of(subset: list[ViewPair]) -> FloatArray:
        partial, _ = _fit(subset, models)
        held_out_px.extend(
            row_error_px(partial, pair)
            for pair in used
            if not any(pair is member for member in subset)
        )
        baseline_m = np.linalg.norm(partial.right_from_left[:3, 3])
        cameras = *one_camera.intrinsics(partial.left), *one_camera.intrinsics(partial.right)
        return np.array([*cameras, baseline_m, partial.left.fx_px * baseline_m])

    std = jackknife_sigma(one_camera.leave_out_groups(used, parameters_of, advance))
    left = _camera_calibration(rig.left, [fit.left for fit in fits], std[:4])
    right = _camera_calibration(rig.right, [fit.right for fit in fits], std[4:8])
    return PairCalibration(
        rig,
        left,
        right,
        baseline_std_m=float(std[8]),
        scale_sigma=float(std[9]) / abs(rig.left.fx_px * rig.baseline_m),
        rms_px=math.sqrt((left.rms_px**2 + right.rms_px**2) / 2),
        single_rms_px=(left_px, right_px),
        row_error_px=float(np.mean([fit.row_error_px for fit in fits])),
        held_out_row_error_px=float(np.mean(held_out_px)),
        fits=fits,
        rejected=(*rejected, *moved),
    )


def row_error_px(rig: StereoRig, pair: ViewPair) -> float:
    """Mean |dy| of the corners of a pair in the rectified images."""
    r1, r2, p1, p2, _ = rectification.stereo_rectification(rig)
    y_left, y_right = (
        rectification.rectified_points(camera, r, p, view.xy_px)[:, 1]
        for view, camera, r, p in zip(pair, (rig.left, rig.right), (r1, r2), (p1, p2), strict=True)
    )
    return float(np.abs(y_left - y_right).mean())


def _single_fits(
    pairs: Sequence[ViewPair], models: Models
) -> list[tuple[PinholeCamera, tuple[one_camera.ViewFit, ...]]]:
    return [one_camera.fit_camera([pair[side] for pair in pairs], models[side]) for side in (0, 1)]


def _fit(pairs: Sequence[ViewPair], models: Models) -> tuple[StereoRig, tuple[PairFit, ...]]:
    """The least-squares rig, starting from the calibrations of the single cameras."""
    starts = [model.start for model in models if model.start is not None]
    if len(starts) == 2:
        rig, poses = fit_fisheye_pair(pairs, (starts[0], starts[1]))
    else:
        rig, poses = _fitted_pinholes(pairs, models)
    fits = []
    for pair, board_to_left in zip(pairs, poses, strict=True):
        left = one_camera.ViewFit.of(pair[0], board_to_left, rig.left)
        right = one_camera.ViewFit.of(pair[1], rig.right_from_left @ board_to_left, rig.right)
        fits.append(PairFit(left, right, row_error_px(rig, pair)))
    return rig, tuple(fits)


def _fitted_pinholes(pairs: Sequence[ViewPair], models: Models) -> tuple[StereoRig, FloatArray]:
    """The least-squares rig of pinholes, starting from the cameras calibrated alone, and the poses
    of the boards.
    """
    n_distortion_coefficients = models[0].n_distortion_coefficients
    cameras = [camera for camera, _ in _single_fits(pairs, models)]
    distortion = [rectification.distortion_coefficients(camera) for camera in cameras]
    _, m1, d1, m2, d2, r, t, _, _, rvecs, tvecs, _ = (
        cv2.stereoCalibrateExtended(
            [pair[0].xyz_m.astype(np.float32) for pair in pairs],
            [pair[0].xy_px.astype(np.float32) for pair in pairs],
            [pair[1].xy_px.astype(np.float32) for pair in pairs],
            cameras[0].matrix, distortion[0], cameras[1].matrix, distortion[1], pairs[0][0].size_px,
            np.eye(3), np.zeros((3, 1)),
            flags=cv2.CALIB_USE_INTRINSIC_GUESS | one_camera.DISTORTION_FLAGS[n_distortion_coefficients],
            criteria=_CRITERIA
        )
    )  # fmt: skip
    left = one_camera.camera_of(m1, d1, pairs[0][0].size_px, n_distortion_coefficients)
    right = one_camera.camera_of(m2, d2, pairs[0][1].size_px, n_distortion_coefficients)
    return StereoRig(left, right, rigid_motion(r, t)), np.stack(
        list(map(one_camera.pose_of, rvecs, tvecs))
    )


def _camera_calibration(
    camera: PinholeCamera, fits: Sequence[one_camera.ViewFit], std: FloatArray
) -> one_camera.CameraCalibration:
    """Calibration of one camera of the rig, with standard deviations (4,) of fx, fy, cx, cy."""
    coverage = coverage_of(
        [fit.view for fit in fits], np.stack([fit.board_to_camera for fit in fits])
    )
    if coverage.is_parallel:
        raise CalibrationError(one_camera.PARALLEL)
    intrinsic_std = one_camera.IntrinsicStd(*std.tolist())
    one_camera.check_determined(intrinsic_std, camera)
    return one_camera.CameraCalibration(
        camera, intrinsic_std, one_camera.total_rms_px(fits), tuple(fits), (), coverage
    )


def _without_moved_boards(
    pairs: list[ViewPair], n_min: int, models: Models
) -> tuple[list[ViewPair], tuple[RejectedView, ...]]:
    """At least `n_min` pairs without movement of the board between the images, and the omitted
    pairs, worst first.
    """
    alone = [fits for _, fits in _single_fits(pairs, models)]
    alone_px = np.sqrt(
        [(left.rms_px**2 + right.rms_px**2) / 2 for left, right in zip(*alone, strict=True)]
    )
    used, rejected = list(range(len(pairs))), []
    while len(used) > n_min:
        fits = _fit([pairs[i] for i in used], models)[1]
        ratios = np.array([fit.rms_px for fit in fits]) / np.maximum(alone_px[used], 1e-6)
        worst = int(ratios.argmax())
        if not ratios[worst] > _MOVED_RATIO:
            break
        row = used.pop(worst)
        figures = (
            f"{fits[worst].rms_px:.2f} px ({alone_px[row]:.2f} px if each camera is fitted alone)"
        )
        rejected.append(
            RejectedView(
                pairs[row][0].name, f"the board moved between the images: residual {figures}"
            )
        )
    return [pairs[i] for i in used], tuple(rejected)


def _check_consistency(single_px: float, fits: Sequence[PairFit]) -> None:
    """Raise an error if the images of pairs are not simultaneous: they fit each camera alone, but
    not both.
    """
    common_px = math.sqrt(np.mean([fit.rms_px**2 for fit in fits]))
    if common_px > max(_MAX_RMS_RATIO * single_px, 1.0):
        raise CalibrationError(
            "left and right images do not match: expected a residual similar to the single cameras' residual, "
            f"{single_px:.2f} px, got {common_px:.2f} px; check that the images of a pair are simultaneous and that "
            "neither camera is upside down."
        )


def _check_relative_pose(rig: StereoRig) -> None:
    angle_deg = math.degrees(rectification.rotation_angle_rad(rig.right_from_left[:3, :3]))
    if angle_deg > _UPSIDE_DOWN_DEG:
        raise CalibrationError(
            f"one camera is upside down relative to the other (rotated by {angle_deg:.0f} degrees); rotate its images "
            "by 180 degrees, for the calibration and for the measurement."
        )
    if angle_deg > _MAX_ANGLE_DEG:
        raise CalibrationError(
            f"expected cameras that point in similar directions, found a rotation of {angle_deg:.0f} degrees between "
            "them; mount them parallel."
        )
    x_m, y_m, _ = rig.right_from_left[:3, 3]
    if x_m > abs(y_m):
        raise CalibrationError(
            f"expected the right camera to the right of the left one, found it {x_m:.3g} m to the left; swap the left "
            "and right images (or rotate both if the cameras are upside down)."
        )
    low, high = BASELINE_M
    if not low <= rig.baseline_m <= high and abs(x_m) > abs(y_m):
        raise CalibrationError(
            f"expected a baseline between {low:g} and {high:g} m, found {rig.baseline_m:.3g} m; check the size of the "
            "board's squares, --square-mm."
        )
    try:
        rectification.Rectifier(rig)
    except RigError as error:
        raise CalibrationError(str(error)) from error
