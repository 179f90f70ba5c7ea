"""Calibration of known rigs, and pairs that are swapped, upside down, or not simultaneous."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from tests.support.error_messages import error_message
from tests.support.images.board_scenes import exact_pairs, exact_view, pose, rig
from track_range.stereo.calibration.board_views import BoardFinder, common_corners
from track_range.stereo.calibration.boards import CalibrationError, ChessBoard
from track_range.stereo.calibration.two_cameras import calibrate_pair, row_error_px

TRUE = rig()
PAIRS = exact_pairs(TRUE, 12)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_known_rig_within_its_sigma(seed):
    result = calibrate_pair(exact_pairs(TRUE, 12, seed=seed))
    assert result.rig.baseline_m == pytest.approx(TRUE.baseline_m, rel=0.005)
    assert abs(result.rig.baseline_m - TRUE.baseline_m) < 4 * result.baseline_std_m
    assert result.baseline_std_m < 0.002 * TRUE.baseline_m
    rotation = result.rig.right_from_left[:3, :3].T @ TRUE.right_from_left[:3, :3]
    assert np.degrees(np.linalg.norm(cv2.Rodrigues(rotation)[0])) < 0.1
    assert abs(result.rig.left.fx_px - 520) < 3 * result.left.std.fx_px
    assert abs(result.rig.right.fx_px - 517) < 3 * result.right.std.fx_px
    # |dy| of two rows with noise of 0.05 px each: 0.05 sqrt(2) sqrt(2 / pi) = 0.056
    assert result.row_error_px == pytest.approx(0.056, rel=0.15)
    assert result.row_error_px < result.held_out_row_error_px < 0.08
    assert result.rms_px == pytest.approx(0.0707, rel=0.1)
    assert len(result.fits) == len(result.left.fits) == len(result.right.fits) == 12


def test_exact_pairs_have_no_row_error():
    assert max(row_error_px(TRUE, pair) for pair in exact_pairs(TRUE, 3, noise_px=0.0)) < 1e-4


@pytest.mark.slow
def test_outlier_pair_is_rejected():
    moved = (
        PAIRS[3][0],
        dataclasses.replace(PAIRS[3][1], xy_px=PAIRS[3][1].xy_px + np.array([0.0, 4.0])),
    )
    result = calibrate_pair([*PAIRS[:3], moved, *PAIRS[4:]])
    assert [view.name for view in result.rejected] == [PAIRS[3][0].name]
    assert result.rig.baseline_m == pytest.approx(TRUE.baseline_m, rel=0.005)


def upside_down(view):
    """The view of a camera that is mounted upside down."""
    return dataclasses.replace(view, xy_px=np.array([639.0, 359.0]) - view.xy_px)


def refused(pairs) -> str:
    return error_message(CalibrationError, calibrate_pair, pairs)


def test_swapped_cameras():
    assert "swap" in refused([(right, left) for left, right in PAIRS])


def test_camera_upside_down():
    assert "upside down" in refused([(left, upside_down(right)) for left, right in PAIRS])


@pytest.mark.slow
def test_rolled_or_vertically_arranged_cameras():
    rolled, above = rig(roll_deg=60), rig()
    above.right_from_left[:3, 3] = (0.0, -0.12, 0.0)
    poses = [fit.board_to_camera for fit in calibrate_pair(PAIRS).left.fits]
    for true, key_word in ((rolled, "rotation"), (above, "side by side")):
        pairs = [
            (exact_view(true.left, at, "l"), exact_view(true.right, true.right_from_left @ at, "r"))
            for at in poses
        ]
        assert key_word in refused(pairs)


def test_implausible_baseline():
    small = [
        tuple(dataclasses.replace(view, xyz_m=view.xyz_m / 100) for view in pair) for pair in PAIRS
    ]
    assert "0.0012 m" in refused(small)


@pytest.mark.slow
def test_mismatched_pairs():
    shifted = [(PAIRS[i][0], PAIRS[(i + 1) % len(PAIRS)][1]) for i in range(len(PAIRS))]
    assert "simultaneous" in refused(shifted)


@pytest.mark.slow
def test_too_few_and_static_pairs():
    assert "4;" in refused(PAIRS[:4])
    assert "same position" in refused(PAIRS[:1] * 6)
    flat = [pose((0, 0, 0), (x, 0, z)) for x in (-0.05, 0.0, 0.05) for z in (0.5, 0.7)]
    pairs = [
        (exact_view(TRUE.left, at, "l"), exact_view(TRUE.right, TRUE.right_from_left @ at, "r"))
        for at in flat
    ]
    assert "tilt" in refused(pairs)


def test_the_real_rig(shared_data):
    folder, board = shared_data / "chessboards" / "stereo", ChessBoard(9, 6, 0.02)
    finder = BoardFinder(board)
    names = [(f"left{n}.jpg", f"right{n}.jpg") for n in range(1, 30, 2)]
    views = [[finder.find(cv2.imread(str(folder / name)), name) for name in pair] for pair in names]
    result = calibrate_pair([common_corners(left, right, board) for left, right in views])
    assert len(result.fits) >= 13
    assert result.rms_px < 0.26
    assert result.row_error_px < result.held_out_row_error_px < 0.25
    # of squares of 20 mm; it scales with them
    assert result.rig.baseline_m == pytest.approx(0.0776, abs=0.001)
    assert result.baseline_std_m < 0.01 * result.rig.baseline_m
