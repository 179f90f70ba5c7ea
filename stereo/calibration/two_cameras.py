"""Calibration of two cameras: views of one board by both eyes -> StereoRig (OpenCV's stereoCalibrate).

Each eye is calibrated alone first, which gives a start and shows bad views; then all numbers of both, the motion
between them and the board's poses are fitted together. The rows' error is told of pairs that were held out of the fit:

    dy = | y_left - y_right | of a corner in the rectified images, 0 for a perfect rig
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.robust_statistics import jackknife_sigma
from track_range.stereo.calibration.board_views import BoardView, RejectedView
from track_range.stereo.calibration.boards import CalibrationError
from track_range.stereo.calibration.coverage import coverage_of
from track_range.stereo.calibration.one_camera import (
    LENS_TERMS,
    PARALLEL,
    Advance,
    CameraCalibration,
    IntrinsicStd,
    ViewFit,
    camera_of,
    check_determined,
    check_motion,
    check_views,
    fit_camera,
    leave_out_groups,
    pose_of,
    residuals_px,
    total_rms_px,
    without_outliers,
)
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rectification import Rectifier, lens_terms, stereo_rectification
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.rig_checks import BASELINE_M

ViewPair = tuple[BoardView, BoardView]

_UPSIDE_DOWN_DEG = 120.0
_TURNED_DEG = 45.0

_CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-7)

_MAX_PAIR_RMS = 5.0
"""A common fit so many times worse than each eye's own means that the pairs do not belong together."""


@dataclass(frozen=True, slots=True)
class PairFit:
    """How well one pair agrees: the fit of each eye, and the error of its rows."""

    left: ViewFit
    right: ViewFit
    rows_px: float

    @property
    def view(self) -> BoardView:
        """The left view, which names the pair."""
        return self.left.view

    @property
    def rms_px(self) -> float:
        """Root mean square residual of both eyes' corners."""
        return math.sqrt((self.left.rms_px**2 + self.right.rms_px**2) / 2)


@dataclass(frozen=True, slots=True)
class PairCalibration:
    """A calibrated rig, and what there is to know of it.

    Attributes:
        rig: the rig.
        left, right: its cameras' fits in the common one.
        baseline_sd_m: standard deviation of the baseline, from leaving out pairs.
        rms_px: root mean square residual of all corners.
        rows_px: mean |dy| after rectification, of the pairs that the rig was fitted to.
        held_out_rows_px: the same of pairs that it was not fitted to.
        fits: the pairs used.
        rejected: the pairs left out.
    """

    rig: StereoRig
    left: CameraCalibration
    right: CameraCalibration
    baseline_sd_m: float
    rms_px: float
    rows_px: float
    held_out_rows_px: float
    fits: tuple[PairFit, ...]
    rejected: tuple[RejectedView, ...]


def calibrate_pair(
    pairs: Sequence[ViewPair], *, n_distortion_coefficients: int = 5, advance: Advance | None = None
) -> PairCalibration:
    """Calibrate the rig that took all these pairs.

    Args:
        pairs: the same corners of one board, seen by the left and the right eye at one instant.
        n_distortion_coefficients: 0, 4, 5 or 8.
        advance: told steps done, and of how many.

    Raises:
        CalibrationError: too few pairs, they do not determine the rig, or the eyes are swapped or upside down.
    """
    check_views(len(pairs))
    for eye in (0, 1):
        check_motion([pair[eye] for pair in pairs])
    kept, rejected = without_outliers(list(pairs), lambda those: _fit(those, n_distortion_coefficients)[1])
    rig, fits = _fit(kept, n_distortion_coefficients)
    _check_together(kept, fits, n_distortion_coefficients)
    _check_relative_pose(rig)
    held_out_px: list[float] = []

    def without_some(those: list[ViewPair]) -> FloatArray:
        partial, _ = _fit(those, n_distortion_coefficients)
        held_out_px.extend(rows_px(partial, pair) for pair in kept if not any(pair is one for one in those))
        return _numbers(partial)

    sd = jackknife_sigma(leave_out_groups(kept, without_some, advance))
    eyes = [
        _eye(camera, [(fit.left, fit.right)[i] for fit in fits], sd[4 * i : 4 * i + 4])
        for i, camera in enumerate((rig.left, rig.right))
    ]
    rms_px = math.sqrt((eyes[0].rms_px ** 2 + eyes[1].rms_px ** 2) / 2)
    mean_rows_px, held_px = (float(np.mean(each)) for each in ([fit.rows_px for fit in fits], held_out_px))
    return PairCalibration(rig, eyes[0], eyes[1], float(sd[8]), rms_px, mean_rows_px, held_px, fits, rejected)


def rows_px(rig: StereoRig, pair: ViewPair) -> float:
    """Mean |dy| of a pair's corners in the rectified images."""
    cameras = (rig.left, rig.right)
    turns = stereo_rectification(rig)
    rows = [
        cv2.undistortPoints(view.xy_px.reshape(-1, 1, 2), camera.matrix, lens_terms(camera), R=turn, P=new)[:, 0, 1]
        for view, camera, turn, new in zip(pair, cameras, turns[:2], turns[2:4], strict=True)
    ]
    return float(np.abs(rows[0] - rows[1]).mean())


def _fit(pairs: Sequence[ViewPair], n_distortion_coefficients: int) -> tuple[StereoRig, tuple[PairFit, ...]]:
    """The rig with the least squared residuals, each eye's own calibration being the start."""
    eyes = [fit_camera([pair[eye] for pair in pairs], n_distortion_coefficients)[0] for eye in (0, 1)]
    lens = [np.array(camera.distortion or (0.0,) * 5) for camera in eyes]
    _, left_matrix, left_lens, right_matrix, right_lens, turn, shift, _, _, turns, shifts, _ = (
        cv2.stereoCalibrateExtended(
            [pair[0].xyz_m.astype(np.float32) for pair in pairs],
            [pair[0].xy_px.astype(np.float32) for pair in pairs],
            [pair[1].xy_px.astype(np.float32) for pair in pairs],
            eyes[0].matrix, lens[0], eyes[1].matrix, lens[1], pairs[0][0].size_px, np.eye(3), np.zeros((3, 1)),
            flags=cv2.CALIB_USE_INTRINSIC_GUESS | LENS_TERMS[n_distortion_coefficients], criteria=_CRITERIA,
        )
    )  # fmt: skip
    right_from_left = np.eye(4)
    right_from_left[:3, :3], right_from_left[:3, 3] = turn, np.asarray(shift).ravel()
    left = camera_of(left_matrix, left_lens, pairs[0][0].size_px, n_distortion_coefficients)
    right = camera_of(right_matrix, right_lens, pairs[0][1].size_px, n_distortion_coefficients)
    rig = StereoRig(left, right, right_from_left)
    poses = [pose_of(each_turn, each_shift) for each_turn, each_shift in zip(turns, shifts, strict=True)]
    return rig, tuple(_pair_fit(rig, pair, pose) for pair, pose in zip(pairs, poses, strict=True))


def _pair_fit(rig: StereoRig, pair: ViewPair, pose: FloatArray) -> PairFit:
    in_right = rig.right_from_left @ pose
    left = ViewFit(pair[0], residuals_px(pair[0], pose, rig.left), pose)
    right = ViewFit(pair[1], residuals_px(pair[1], in_right, rig.right), in_right)
    return PairFit(left, right, rows_px(rig, pair))


def _eye(camera: PinholeCamera, fits: Sequence[ViewFit], sd: FloatArray) -> CameraCalibration:
    coverage = coverage_of([fit.view for fit in fits], np.stack([fit.board_to_camera for fit in fits]))
    if coverage.is_parallel:
        raise CalibrationError(PARALLEL)
    std = IntrinsicStd(*sd.tolist())
    check_determined(std, camera)
    return CameraCalibration(camera, std, total_rms_px(fits), tuple(fits), (), coverage)


def _check_together(pairs: Sequence[ViewPair], fits: Sequence[PairFit], n_distortion_coefficients: int) -> None:
    """Refuse pairs whose images were not taken together: each eye fits alone, but not both."""
    alone_px = [total_rms_px(fit_camera([pair[eye] for pair in pairs], n_distortion_coefficients)[1]) for eye in (0, 1)]
    together_px = math.sqrt(np.mean([fit.rms_px**2 for fit in fits]))
    if together_px > max(_MAX_PAIR_RMS * max(alone_px), 1.0):
        raise CalibrationError(
            f"left and right do not belong together: each eye alone leaves {max(alone_px):.2f} px, both "
            f"{together_px:.2f} px; check that images of one pair were taken at one instant, and that neither eye is "
            "upside down."
        )


def _check_relative_pose(rig: StereoRig) -> None:
    """Refuse eyes that are swapped, upside down or one above the other."""
    rotation = rig.right_from_left[:3, :3]
    angle_deg = math.degrees(math.acos(float(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))
    if angle_deg > _UPSIDE_DOWN_DEG:
        raise CalibrationError(
            f"one eye is upside down against the other (turned by {angle_deg:.0f} degrees); turn its images by 180 "
            "degrees, here and in what you want to measure."
        )
    if angle_deg > _TURNED_DEG:
        raise CalibrationError(
            f"the eyes are turned against each other by {angle_deg:.0f} degrees; only eyes that look the same way "
            "can be used."
        )
    x_m, y_m, _ = rig.right_from_left[:3, 3]
    if x_m > abs(y_m):
        raise CalibrationError(
            f"the right camera stands {x_m:.3g} m left of the left one: left and right are swapped (or both upside "
            "down); give them the other way round."
        )
    low, high = BASELINE_M
    if not low <= rig.baseline_m <= high and abs(x_m) > abs(y_m):
        raise CalibrationError(
            f"the baseline comes out as {rig.baseline_m:.3g} m, which is not within {low:g} .. {high:g} m; "
            "check the size of the board's squares, --square-mm."
        )
    try:
        Rectifier(rig)
    except RigError as error:
        raise CalibrationError(str(error)) from error


def _numbers(rig: StereoRig) -> FloatArray:
    """(9,) fx fy cx cy of both eyes, and the baseline."""
    eyes = [[eye.fx_px, eye.fy_px, eye.cx_px, eye.cy_px] for eye in (rig.left, rig.right)]
    return np.array([*eyes[0], *eyes[1], np.linalg.norm(rig.right_from_left[:3, 3])])
