"""Calibration of fisheye cameras: known cameras within their sigma, real pairs, moved boards, and
the block solver."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.support.images.board_scenes import exact_view, pose
from track_range.calibration.from_boards import wide_lens_warnings
from track_range.stereo.calibration.board_views import BoardFinder, BoardView, common_corners
from track_range.stereo.calibration.boards import CalibrationError, ChessBoard
from track_range.stereo.calibration.fisheye_fit import board_pose, fit_fisheye, solve_blocks
from track_range.stereo.calibration.one_camera import calibrate_camera
from track_range.stereo.calibration.two_cameras import calibrate_pair
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

LENS = "kannala-brandt"
ORDINARY = PinholeCamera(230.0, 229.0, 325.0, 236.0, 640, 480)
FISHEYE = PinholeCamera(230.0, 229.0, 325.0, 236.0, 640, 480, (0.02, -0.02, 0.015, -0.005), LENS)
RIGHT = PinholeCamera(232.0, 231.5, 318.0, 244.0, 640, 480, (0.015, -0.01, 0.01, -0.004), LENS)


def facing_poses(n: int, *, largest_deg: float = 60.0, seed: int = 0) -> list[np.ndarray]:
    """Boards in directions up to an angle from the axis, tilted by up to 35 degrees against
    them."""
    rng = np.random.default_rng(seed)
    poses = []
    for _ in range(n):
        theta, phi = np.radians(largest_deg) * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
        direction = np.array(
            [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
        )
        axis = np.array([-np.sin(phi), np.cos(phi), 0.0])
        towards = cv2.Rodrigues(theta * axis)[0]
        at = pose((*rng.uniform(-35, 35, 2), rng.uniform(-15, 15)), (0.0, 0.0, 0.0))
        turned = np.eye(4)
        turned[:3, :3] = towards @ at[:3, :3]
        turned[:3, 3] = towards @ at[:3, 3] + direction * rng.uniform(0.22, 0.4)
        poses.append(turned)
    return poses


def views_of(
    camera: PinholeCamera, poses, *, noise_px: float = 0.1, seed: int = 0, name: str = "view"
):
    rng = np.random.default_rng(seed)
    return [
        exact_view(camera, at, f"{name}{i}", noise_px=noise_px, rng=rng)
        for i, at in enumerate(poses)
    ]


def test_exact_corners_give_the_camera_exactly_without_an_initial_focal_length():
    camera = fit_fisheye(views_of(FISHEYE, facing_poses(12), noise_px=0.0))[0]
    assert np.allclose(
        [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px],
        [230.0, 229.0, 325.0, 236.0],
        atol=1e-3,
    )
    assert camera.distortion == pytest.approx(FISHEYE.distortion, abs=1e-4)


@pytest.mark.parametrize("focal_px", [110.0, 180.0, 320.0, 600.0, 1200.0])
def test_focal_length_is_found_for_lenses_from_telephoto_to_330_degrees(focal_px):
    camera = replace(FISHEYE, fx_px=focal_px, fy_px=focal_px, distortion=(0.0,) * 4)
    reach_deg = min(70.0, np.degrees(240 / focal_px) * 0.7)
    fitted = fit_fisheye(views_of(camera, facing_poses(14, largest_deg=reach_deg)))[0]
    assert fitted.fx_px == pytest.approx(focal_px, rel=0.02)


def test_corners_beyond_90_degrees():
    poses = facing_poses(14, largest_deg=80)
    views = views_of(
        replace(FISHEYE, fx_px=150.0, fy_px=150.0, distortion=(0.01, 0.0, 0.0, 0.0)), poses
    )
    camera = fit_fisheye(views)[0]
    assert min(camera.recorded_rays(view.xy_px)[:, 2].min() for view in views) < 0
    assert camera.fx_px == pytest.approx(150.0, rel=0.01)


def test_pose_of_a_board():
    at = facing_poses(1, seed=4)[0]
    assert np.allclose(board_pose(FISHEYE, views_of(FISHEYE, [at], noise_px=0.0)[0]), at, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_known_camera_within_its_sigma(seed):
    result = calibrate_camera(views_of(FISHEYE, facing_poses(16, seed=seed), seed=seed), lens=LENS)
    for name in ("fx_px", "fy_px", "cx_px", "cy_px"):
        assert abs(getattr(result.camera, name) - getattr(FISHEYE, name)) < 4 * getattr(
            result.std, name
        )
    assert result.std.fx_px < 0.02 * FISHEYE.fx_px
    assert 0.11 < result.rms_px < 0.142  # noise of 0.1 px in x and y, reduced by the fit
    assert result.camera.lens == LENS


def known_pairs(
    n: int, *, moved: tuple[int, ...] = ()
) -> tuple[StereoRig, list[tuple[BoardView, BoardView]]]:
    """Pairs of a known rig; in the `moved` ones the board moved by 6 mm between the images."""
    right_from_left = np.eye(4)
    right_from_left[:3, :3] = cv2.Rodrigues(np.array([0.01, -0.02, 0.015]))[0]
    right_from_left[:3, 3] = (-0.11, 0.001, 0.002)
    poses = facing_poses(n, largest_deg=45, seed=2)
    steps = [np.array([0.0, 0.006, 0.0]) if i in moved else np.zeros(3) for i in range(n)]
    later = [np.block([[np.eye(3), step[:, None]], [np.zeros(3), 1.0]]) for step in steps]
    right_poses = [right_from_left @ step @ at for step, at in zip(later, poses, strict=True)]
    left, right = (
        views_of(FISHEYE, poses, name="left"),
        views_of(RIGHT, right_poses, seed=1, name="right"),
    )
    return StereoRig(FISHEYE, RIGHT, right_from_left), list(zip(left, right, strict=True))


@pytest.mark.slow
def test_known_pair_and_moved_boards():
    true, pairs = known_pairs(14, moved=(3, 8))
    result = calibrate_pair(pairs, lens=LENS)
    assert sorted(view.name for view in result.rejected) == ["left3", "left8"]
    assert result.rig.baseline_m == pytest.approx(true.baseline_m, abs=4 * result.baseline_std_m)
    assert np.allclose(result.rig.right_from_left, true.right_from_left, atol=0.004)
    assert result.rms_px < 0.15
    assert max(result.single_rms_px) < 0.15
    assert result.held_out_row_error_px < 0.4


def test_views_that_do_not_determine_a_camera():
    same = views_of(FISHEYE, [facing_poses(1)[0]] * 6, noise_px=0.0)
    with pytest.raises(CalibrationError):
        calibrate_camera(same, lens=LENS)


def test_block_solver_against_scipy():
    rng = np.random.default_rng(0)
    x = rng.uniform(0, 2, (5, 9))
    common, of_views = np.array([0.7, -0.3]), rng.normal(size=(5, 2))

    def model(common, of_views):
        return of_views[:, :1] * np.exp(common[0] * x) + of_views[:, 1:] + common[1] * x**2

    measured = model(common, of_views) + rng.normal(scale=0.01, size=x.shape)

    def residuals_of(common, of_views):
        return (model(common, of_views) - measured).ravel()

    expected = least_squares(
        lambda p: residuals_of(p[:2], p[2:].reshape(5, 2)), np.full(12, 0.1), xtol=1e-12, ftol=1e-12
    )
    solution = solve_blocks(residuals_of, np.full(5, 9), np.full(2, 0.1), np.full((5, 2), 0.1))
    assert np.allclose(solution.common, expected.x[:2], atol=1e-5)
    assert np.allclose(solution.view_parameters.ravel(), expected.x[2:], atol=1e-5)
    covariance = (
        np.linalg.inv(expected.jac.T @ expected.jac)[:2, :2] * (2 * expected.cost) / (45 - 12)
    )
    assert np.allclose(solution.covariance, covariance, rtol=1e-2)


@pytest.mark.real
def test_the_real_fisheye_rig(shared_data):
    board = ChessBoard(9, 6, 0.02423)
    finder = BoardFinder(board)
    pairs = []
    for number in range(1, 22):
        found = [
            finder.find(
                cv2.imread(str(shared_data / "fisheye" / side / f"{side}{number}.jpg")),
                f"{side}{number}",
            )
            for side in ("left", "right")
        ]
        assert all(isinstance(view, BoardView) for view in found)
        pairs.append(common_corners(found[0], found[1], board))
    result = calibrate_pair(pairs, lens=LENS)
    assert max(result.single_rms_px) < 0.25
    assert result.rms_px < 0.3
    assert result.rig.baseline_m == pytest.approx(0.111, rel=0.02)


@pytest.mark.slow
def test_a_pinhole_model_of_a_wide_lens_is_noticed():
    poses = facing_poses(12, largest_deg=50.0)
    wide, ordinary = (calibrate_camera(views_of(camera, poses)) for camera in (FISHEYE, ORDINARY))
    (warning,) = wide_lens_warnings("left", wide)
    assert warning.startswith("left: ")
    assert "--lens fisheye" in warning
    assert [*wide_lens_warnings("left", ordinary)] == []
