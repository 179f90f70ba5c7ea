"""Known rigs found again, and pairs that are swapped, upside down, or not of one instant."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from tests.stereo.board_scenes import exact_pairs, exact_view, pose, rig
from track_range.stereo.calibration.board_views import BoardFinder, in_step
from track_range.stereo.calibration.boards import CalibrationError, ChessBoard
from track_range.stereo.calibration.two_cameras import calibrate_pair, rows_px

TRUE = rig()
PAIRS = exact_pairs(TRUE, 12)


@pytest.mark.parametrize("seed", range(2))
def test_a_known_rig_is_found_within_its_own_error(seed):
    found = calibrate_pair(exact_pairs(TRUE, 12, seed=seed))
    assert found.rig.baseline_m == pytest.approx(TRUE.baseline_m, rel=0.005)
    assert abs(found.rig.baseline_m - TRUE.baseline_m) < 4 * found.baseline_sd_m
    assert found.baseline_sd_m < 0.002 * TRUE.baseline_m
    turn = found.rig.right_from_left[:3, :3].T @ TRUE.right_from_left[:3, :3]
    assert np.degrees(np.linalg.norm(cv2.Rodrigues(turn)[0])) < 0.1
    assert abs(found.rig.left.fx_px - 520) < 3 * found.left.std.fx_px
    assert abs(found.rig.right.fx_px - 517) < 3 * found.right.std.fx_px
    # |dy| of two rows with noise of 0.05 px each: 0.05 sqrt(2) sqrt(2 / pi) = 0.056
    assert found.rows_px == pytest.approx(0.056, rel=0.15)
    assert found.rows_px < found.held_out_rows_px < 0.08
    assert found.rms_px == pytest.approx(0.0707, rel=0.1)
    assert len(found.fits) == len(found.left.fits) == len(found.right.fits) == 12


def test_exact_pairs_lie_in_one_row():
    assert max(rows_px(TRUE, pair) for pair in exact_pairs(TRUE, 3, noise_px=0.0)) < 1e-4


def test_a_pair_not_of_one_instant_is_left_out():
    moved = (PAIRS[3][0], dataclasses.replace(PAIRS[3][1], xy_px=PAIRS[3][1].xy_px + np.array([0.0, 4.0])))
    found = calibrate_pair([*PAIRS[:3], moved, *PAIRS[4:]])
    assert [view.name for view in found.rejected] == [PAIRS[3][0].name]
    assert found.rig.baseline_m == pytest.approx(TRUE.baseline_m, rel=0.005)


def upside_down(view):
    """The view as an eye has it that is mounted upside down."""
    return dataclasses.replace(view, xy_px=np.array([639.0, 359.0]) - view.xy_px)


def refused(pairs) -> str:
    with pytest.raises(CalibrationError) as error:
        calibrate_pair(pairs)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_eyes_that_are_swapped():
    assert "left and right are swapped (or both upside down); give them the other way round" in refused(
        [(right, left) for left, right in PAIRS]
    )


def test_an_eye_upside_down():
    said = refused([(left, upside_down(right)) for left, right in PAIRS])
    assert "one eye is upside down against the other (turned by 1" in said


def test_eyes_rolled_against_each_other_or_one_above_the_other():
    rolled, above = rig(roll_deg=60), rig()
    above.right_from_left[:3, 3] = (0.0, -0.12, 0.0)
    poses = [fit.board_to_camera for fit in calibrate_pair(PAIRS).left.fits]
    for true, said in ((rolled, "turned against each other by 6"), (above, "stand one above the other")):
        pairs = [
            (exact_view(true.left, at, "l"), exact_view(true.right, true.right_from_left @ at, "r")) for at in poses
        ]
        assert said in refused(pairs)


def test_a_baseline_that_cannot_be():
    small = [tuple(dataclasses.replace(view, xyz_m=view.xyz_m / 100) for view in pair) for pair in PAIRS]
    said = refused(small)
    assert "the baseline comes out as 0.0012 m, which is not within 0.01 .. 5 m; check the size" in said


def test_pairs_whose_partners_are_mixed_up():
    shifted = [(PAIRS[i][0], PAIRS[(i + 1) % len(PAIRS)][1]) for i in range(len(PAIRS))]
    assert "left and right do not belong together" in refused(shifted)


def test_too_few_and_unmoved_pairs():
    assert "found in 4 views only" in refused(PAIRS[:4])
    assert "at the same place" in refused(PAIRS[:1] * 6)
    flat = [pose((0, 0, 0), (x, 0, z)) for x in (-0.05, 0.0, 0.05) for z in (0.5, 0.7)]
    pairs = [(exact_view(TRUE.left, at, "l"), exact_view(TRUE.right, TRUE.right_from_left @ at, "r")) for at in flat]
    assert "tilt" in refused(pairs)


def test_the_real_rig(shared_data):
    folder, board = shared_data / "chessboards" / "stereo", ChessBoard(9, 6, 0.02)
    finder = BoardFinder(board)
    names = [(f"left{n}.jpg", f"right{n}.jpg") for n in range(1, 30, 2)]
    views = [[finder.find(cv2.imread(str(folder / name)), name) for name in pair] for pair in names]
    found = calibrate_pair([in_step(left, right, board) for left, right in views])
    assert len(found.fits) >= 13
    assert found.rms_px < 0.26
    assert found.rows_px < found.held_out_rows_px < 0.25
    assert found.rig.baseline_m == pytest.approx(0.0776, abs=0.001)  # of squares of 20 mm; it scales with them
    assert found.baseline_sd_m < 0.01 * found.rig.baseline_m
