"""Known cameras found again, bad views left out, and sets of views that determine nothing."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from tests.stereo.board_scenes import CAMERA, drawn, exact_view, exact_views, pose, varied_poses
from track_range.foundation.robust_statistics import jackknife_sigma
from track_range.stereo.calibration.board_views import BoardFinder, BoardView
from track_range.stereo.calibration.boards import CalibrationError, ChessBoard
from track_range.stereo.calibration.one_camera import calibrate_camera, leave_out_groups
from track_range.stereo.geometry.camera import PinholeCamera


def within(found, true: PinholeCamera, n_sigmas: float) -> bool:
    names = ("fx_px", "fy_px", "cx_px", "cy_px")
    return all(abs(getattr(found.camera, n) - getattr(true, n)) < n_sigmas * getattr(found.std, n) for n in names)


@pytest.mark.parametrize("seed", range(3))
def test_a_known_camera_is_found_within_its_own_error(seed):
    found = calibrate_camera(exact_views(14, seed=seed))
    assert within(found, CAMERA, 3)
    assert found.std.fx_px < 0.005 * CAMERA.fx_px
    assert 0.055 < found.rms_px < 0.0708  # noise of 0.05 px in x and y, less what the fit takes up
    assert len(found.fits) == 14
    assert found.rejected == ()
    assert (found.camera.width_px, found.camera.height_px) == (640, 360)


def test_a_known_camera_is_found_in_drawn_images():
    finder = BoardFinder(ChessBoard(9, 6, 0.03))
    views = [finder.find(drawn(CAMERA, at, seed=i), str(i)) for i, at in enumerate(varied_poses(10, seed=3))]
    found = calibrate_camera([view for view in views if isinstance(view, BoardView)])
    assert within(found, CAMERA, 3)
    assert found.camera.fx_px == pytest.approx(CAMERA.fx_px, rel=0.005)
    assert found.rms_px < 0.12


def test_exact_corners_give_the_camera_exactly():
    found = calibrate_camera(exact_views(12, noise_px=0.0))
    assert found.camera.fx_px == pytest.approx(CAMERA.fx_px, abs=1e-2)
    assert found.camera.distortion == pytest.approx(CAMERA.distortion, abs=1e-3)
    assert found.rms_px < 1e-3


@pytest.mark.parametrize("n_terms", [0, 4, 5, 8])
def test_lens_terms_are_as_many_as_asked_for(n_terms):
    straight = dataclasses.replace(CAMERA, distortion=())
    rng = np.random.default_rng(0)
    views = [exact_view(straight, at, "v", noise_px=0.03, rng=rng) for at in varied_poses(12, seed=1)]
    found = calibrate_camera(views, n_distortion_coefficients=n_terms)
    assert len(found.camera.distortion) == n_terms
    assert found.camera.fx_px == pytest.approx(520, rel=0.01)


def test_a_wrong_view_is_left_out_and_named():
    views = exact_views(12, seed=2)
    xy_px = views[4].xy_px.copy()
    xy_px[10:20] += 6.0
    views[4] = dataclasses.replace(views[4], xy_px=xy_px, name="bent.png")
    found = calibrate_camera(views)
    assert [view.name for view in found.rejected] == ["bent.png"]
    assert "px, where the others have 0.0" in found.rejected[0].reason
    assert len(found.fits) == 11
    assert within(found, CAMERA, 3)


def test_progress_is_told():
    told = []
    calibrate_camera(exact_views(6), advance=lambda done, total: told.append((done, total)))
    assert told == [(i, 6) for i in range(1, 7)]


@pytest.mark.parametrize(
    ("views", "said"),
    [
        ([], "the board was found in 0 views only, 5 at least"),
        (exact_views(1), "found in 1 view only"),
        (exact_views(4), "found in 4 views only"),
        (exact_views(1) * 8, "the board stands at the same place in all views"),
    ],
)
def test_sets_that_are_too_small(views, said):
    with pytest.raises(CalibrationError, match=said):
        calibrate_camera(views)


@pytest.mark.parametrize("turn_deg", [(0, 0, 0), (0, 25, 0)])
def test_boards_that_are_all_parallel_leave_the_focal_length_open(turn_deg):
    rng = np.random.default_rng(0)
    at = [pose(turn_deg, (x, y, z)) for x in (-0.1, 0.0, 0.1) for y in (-0.05, 0.05) for z in (0.5, 0.7)]
    views = [exact_view(CAMERA, each, "v", noise_px=0.05, rng=rng) for each in at]
    with pytest.raises(CalibrationError, match=r"same tilt in all views|leave the focal length open"):
        calibrate_camera(views)


def test_hardly_tilted_boards_leave_the_focal_length_open():
    rng = np.random.default_rng(1)
    at = [pose((*rng.uniform(-6, 6, 2), 0), (*rng.uniform(-0.05, 0.05, 2), 0.6)) for _ in range(8)]
    views = [exact_view(CAMERA, each, "v", noise_px=0.4, rng=rng) for each in at]
    with pytest.raises(CalibrationError, match=r"leave the focal length open \(standard deviation \d+ %\)"):
        calibrate_camera(views)


def test_the_jackknife_of_a_mean_is_its_standard_error():
    values = np.random.default_rng(0).normal(size=20)
    samples = leave_out_groups(list(values), lambda kept: np.array([np.mean(kept)]))
    assert samples.shape == (20, 1)
    assert jackknife_sigma(samples)[0] == pytest.approx(values.std(ddof=1) / np.sqrt(20))


def test_many_views_are_left_out_in_twenty_groups():
    sizes = leave_out_groups(list(range(50)), lambda kept: np.array([len(kept)]))
    assert len(sizes) == 20
    assert sizes.sum() == 50 * 19


def bow_px(xy_px: np.ndarray) -> float:
    """Root mean square distance of the points (rows, columns, 2) of each row from a straight line."""
    flat = xy_px - xy_px.mean(axis=1, keepdims=True)
    return float(np.sqrt(np.mean([np.linalg.svd(row, compute_uv=False)[1] ** 2 / len(row) for row in flat])))


def test_the_real_camera(real_mono, shared_data):
    result = calibrate_camera([view for view in real_mono if isinstance(view, BoardView)])
    assert len(result.fits) == 18
    assert result.rms_px < 0.9
    assert abs(result.camera.fx_px - 1157) < 15
    # a view that had no part in it, since its lowest row of corners is cut off: lines get straight
    image = cv2.imread(str(shared_data / "chessboards" / "mono9x6" / "calibration1.jpg"))
    rows = ChessBoard(9, 5, 0.02)
    before = BoardFinder(rows).find(image, "before").xy_px.reshape(5, 9, 2)
    after = cv2.undistortPoints(
        before.reshape(-1, 1, 2), result.camera.matrix, np.array(result.camera.distortion), P=result.camera.matrix
    ).reshape(5, 9, 2)
    assert bow_px(before) > 2.0
    assert bow_px(after) < 0.5
    assert bow_px(before.swapaxes(0, 1)) > 2 * bow_px(after.swapaxes(0, 1))
