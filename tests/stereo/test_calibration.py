"""Calibration of known cameras, rejection of bad views, and sets of views that do not determine the
camera."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from tests.support.images.board_scenes import (
    CAMERA,
    drawn,
    exact_view,
    exact_views,
    pose,
    varied_poses,
)
from track_range.foundation.robust_statistics import jackknife_sigma
from track_range.stereo.calibration.board_views import BoardFinder, BoardView
from track_range.stereo.calibration.boards import CalibrationError, ChessBoard
from track_range.stereo.calibration.one_camera import calibrate_camera, leave_out_groups
from track_range.stereo.geometry.camera import PinholeCamera


def within(result, true: PinholeCamera, n_sigmas: float) -> bool:
    names = ("fx_px", "fy_px", "cx_px", "cy_px")
    return all(
        abs(getattr(result.camera, n) - getattr(true, n)) < n_sigmas * getattr(result.std, n)
        for n in names
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_known_camera_within_its_sigma(seed):
    result = calibrate_camera(exact_views(14, seed=seed))
    assert within(result, CAMERA, 3)
    assert result.std.fx_px < 0.005 * CAMERA.fx_px
    assert 0.055 < result.rms_px < 0.0708  # noise of 0.05 px in x and y, reduced by the fit
    assert len(result.fits) == 14
    assert result.rejected == ()
    assert (result.camera.width_px, result.camera.height_px) == (640, 360)


@pytest.mark.slow
def test_known_camera_from_rendered_images():
    finder = BoardFinder(ChessBoard(9, 6, 0.03))
    views = [
        finder.find(drawn(CAMERA, at, seed=i), str(i))
        for i, at in enumerate(varied_poses(10, seed=3))
    ]
    result = calibrate_camera([view for view in views if isinstance(view, BoardView)])
    assert within(result, CAMERA, 3)
    assert result.camera.fx_px == pytest.approx(CAMERA.fx_px, rel=0.005)
    assert result.rms_px < 0.12


def test_exact_corners_give_the_camera_exactly():
    result = calibrate_camera(exact_views(12, noise_px=0.0))
    assert result.camera.fx_px == pytest.approx(CAMERA.fx_px, abs=1e-2)
    assert result.camera.distortion == pytest.approx(CAMERA.distortion, abs=1e-3)
    assert result.rms_px < 1e-3


@pytest.mark.parametrize("n_terms", [0, 4, 5, pytest.param(8, marks=pytest.mark.slow)])
def test_number_of_distortion_coefficients(n_terms):
    ideal = dataclasses.replace(CAMERA, distortion=())
    rng = np.random.default_rng(0)
    views = [exact_view(ideal, at, "v", noise_px=0.03, rng=rng) for at in varied_poses(12, seed=1)]
    result = calibrate_camera(views, n_distortion_coefficients=n_terms)
    assert len(result.camera.distortion) == n_terms
    assert result.camera.fx_px == pytest.approx(520, rel=0.01)


def test_outlier_view_is_rejected():
    views = exact_views(12, seed=2)
    xy_px = views[4].xy_px.copy()
    xy_px[10:20] += 6.0
    views[4] = dataclasses.replace(views[4], xy_px=xy_px, name="bent.png")
    result = calibrate_camera(views)
    assert [view.name for view in result.rejected] == ["bent.png"]
    assert "outlier" in result.rejected[0].reason
    assert len(result.fits) == 11
    assert within(result, CAMERA, 3)


def test_progress_callback():
    steps = []
    calibrate_camera(exact_views(6), advance=lambda done, total: steps.append((done, total)))
    assert steps == [(i, 6) for i in range(1, 7)]


@pytest.mark.parametrize(
    ("views", "key_word"),
    [
        ([], "0;"),
        (exact_views(1), "1;"),
        (exact_views(4), "4;"),
        (exact_views(1) * 8, "same position"),
    ],
)
def test_too_few_views(views, key_word):
    with pytest.raises(CalibrationError, match=key_word):
        calibrate_camera(views)


@pytest.mark.slow
@pytest.mark.parametrize("rotation_deg", [(0, 0, 0), (0, 25, 0)])
def test_parallel_boards_are_refused(rotation_deg):
    rng = np.random.default_rng(0)
    poses = [
        pose(rotation_deg, (x, y, z))
        for x in (-0.1, 0.0, 0.1)
        for y in (-0.05, 0.05)
        for z in (0.5, 0.7)
    ]
    views = [exact_view(CAMERA, at, "v", noise_px=0.05, rng=rng) for at in poses]
    with pytest.raises(CalibrationError, match="focal length"):
        calibrate_camera(views)


def test_hardly_tilted_boards_are_refused():
    rng = np.random.default_rng(1)
    poses = [
        pose((*rng.uniform(-6, 6, 2), 0), (*rng.uniform(-0.05, 0.05, 2), 0.6)) for _ in range(8)
    ]
    views = [exact_view(CAMERA, at, "v", noise_px=0.4, rng=rng) for at in poses]
    with pytest.raises(CalibrationError, match="focal length"):
        calibrate_camera(views)


def test_jackknife_of_a_mean_is_its_standard_error():
    values = np.random.default_rng(0).normal(size=20)
    samples = leave_out_groups(list(values), lambda subset: np.array([np.mean(subset)]))
    assert samples.shape == (20, 1)
    assert jackknife_sigma(samples)[0] == pytest.approx(values.std(ddof=1) / np.sqrt(20))


def test_many_views_are_left_out_in_twenty_groups():
    sizes = leave_out_groups(list(range(50)), lambda subset: np.array([len(subset)]))
    assert len(sizes) == 20
    assert sizes.sum() == 50 * 19


def curvature_px(xy_px: np.ndarray) -> float:
    """Root mean square distance of the points (rows, columns, 2) of each row from a straight
    line."""
    flat = xy_px - xy_px.mean(axis=1, keepdims=True)
    return float(
        np.sqrt(np.mean([np.linalg.svd(row, compute_uv=False)[1] ** 2 / len(row) for row in flat]))
    )


def test_the_real_camera(real_mono, shared_data):
    result = calibrate_camera([view for view in real_mono if isinstance(view, BoardView)])
    assert len(result.fits) == 18
    assert result.rms_px < 0.9
    assert abs(result.camera.fx_px - 1157) < 15
    # Lines become straight in a view that was not used, since its lowest row of corners is outside
    # the image.
    image = cv2.imread(str(shared_data / "chessboards" / "mono9x6" / "calibration1.jpg"))
    rows = ChessBoard(9, 5, 0.02)
    before = BoardFinder(rows).find(image, "before").xy_px.reshape(5, 9, 2)
    after = cv2.undistortPoints(
        before.reshape(-1, 1, 2),
        result.camera.matrix,
        np.array(result.camera.distortion),
        P=result.camera.matrix,
    ).reshape(5, 9, 2)
    assert curvature_px(before) > 2.0
    assert curvature_px(after) < 0.5
    assert curvature_px(before.swapaxes(0, 1)) > 2 * curvature_px(after.swapaxes(0, 1))
