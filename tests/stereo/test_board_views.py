"""Corners detected in rendered images against exact ones, and ambiguous boards."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from tests.support.images.board_scenes import (
    CAMERA,
    CHESS,
    drawn,
    exact_view,
    pose,
    rig,
    varied_poses,
)
from track_range.stereo.calibration.board_views import (
    BoardFinder,
    BoardView,
    RejectedView,
    common_corners,
    count_board_sizes,
    count_markers,
)
from track_range.stereo.calibration.boards import CharucoBoard, ChessBoard, charuco_detectors

CHARUCO = CharucoBoard(8, 6, 0.04, 0.03)
IDEAL_CAMERA = dataclasses.replace(CAMERA, distortion=())


def errors_px(view, board_to_camera, board):
    exact = exact_view(CAMERA, board_to_camera, "", board=board).xy_px[view.corner_id]
    return view.xy_px - exact


def test_corners_of_a_chessboard_to_a_tenth_of_a_pixel():
    errors = []
    for seed, at in enumerate(varied_poses(4, seed=5)):
        view = BoardFinder(CHESS).find(drawn(CAMERA, at, seed=seed), "v")
        assert isinstance(view, BoardView)
        assert view.size_px == (640, 360)
        assert np.array_equal(view.xyz_m, CHESS.corners_m)
        errors.append(errors_px(view, at, CHESS))
    all_errors = np.concatenate(errors)
    assert 0.01 < np.sqrt((all_errors**2).sum(axis=1).mean()) < 0.15
    assert np.abs(all_errors.mean(axis=0)).max() < 0.04  # no offset of half a pixel


def test_corners_of_a_partly_visible_charuco_board():
    at = varied_poses(1, seed=1, board=CHARUCO)[0]
    image = drawn(CAMERA, at, board=CHARUCO)
    whole = BoardFinder(CHARUCO).find(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), "v")
    assert len(whole.corner_id) == 35
    assert np.sqrt((errors_px(whole, at, CHARUCO) ** 2).sum(axis=1).mean()) < 0.3
    middle = whole.xy_px[:, 0].mean()
    image[:, : int(middle)] = 128
    half = BoardFinder(CHARUCO).find(image, "v")
    assert 6 <= len(half.corner_id) < 30
    assert np.abs(errors_px(half, at, CHARUCO)).max() < 1.0
    image[:, : int(whole.xy_px[:, 0].max()) - 40] = 128
    few = BoardFinder(CHARUCO).find(image, "v")
    assert isinstance(few, RejectedView)


def test_charuco_boards_printed_before_opencv_4_6():
    board = CharucoBoard(5, 8, 0.04, 0.02)
    image = charuco_detectors(board)[1].getBoard().generateImage((500, 800), marginSize=50)
    assert len(BoardFinder(board).find(image, "v").corner_id) == 28


def test_images_without_a_board():
    grey = np.full((120, 160), 128, np.uint8)
    for board in (CHESS, CHARUCO):
        finder = BoardFinder(board)
        assert finder.find(grey, "v") == RejectedView("v", "no complete board found")
        assert not finder.may_contain_board(grey)
    assert BoardFinder(CHESS).find(np.zeros((4, 4), np.uint8), "v") == RejectedView(
        "v", "no complete board found"
    )


@pytest.mark.parametrize("marker_id", [None, np.zeros((0, 1), np.int32)])
def test_no_marker_in_both_forms_of_opencv(marker_id):
    finder = BoardFinder(CHARUCO)
    finder._charuco = (SimpleNamespace(detectBoard=lambda image: (None, None, (), marker_id)),)
    assert not finder.may_contain_board(np.zeros((9, 9), np.uint8))


def test_may_contain_board():
    at = pose((10, 20, 5), (0, 0, 0.5))
    assert BoardFinder(CHESS).may_contain_board(
        cv2.resize(drawn(IDEAL_CAMERA, at), None, fx=2, fy=2)
    )
    assert BoardFinder(CHARUCO).may_contain_board(
        drawn(CAMERA, pose((0, 0, 0), (0, 0, 0.7), CHARUCO), board=CHARUCO)
    )


def test_edge_width_grows_with_blur():
    image = drawn(IDEAL_CAMERA, pose((0, 0, 0), (0, 0, 0.5)))
    finder = BoardFinder(CHESS)
    sharp = finder.find(image, "v").edge_px
    soft = finder.find(cv2.GaussianBlur(image, (0, 0), 2.0), "v").edge_px
    assert 1.5 < sharp < 2.5
    # contrast / steepest slope of an edge blurred by sigma is sqrt(2 pi) sigma
    assert soft == pytest.approx(np.sqrt(2 * np.pi) * 2.0, rel=0.25)


@pytest.mark.parametrize(
    ("board", "n_quarters"), [(ChessBoard(8, 6, 0.03), 2), (ChessBoard(7, 7, 0.02), 1)]
)
def test_ambiguous_boards_are_aligned_in_a_pair(board, n_quarters):
    true, at = rig(), pose((10, 20, 5), (0, 0, 0.6), board)
    left = exact_view(true.left, at, "l", board=board)
    right = exact_view(true.right, true.right_from_left @ at, "r", board=board)
    ids = np.arange(len(right.xy_px)).reshape(board.n_rows, board.n_columns)
    rotated = dataclasses.replace(right, xy_px=right.xy_px[np.rot90(ids, n_quarters).ravel()])
    assert np.array_equal(common_corners(left, rotated, board)[1].xy_px, right.xy_px)
    assert np.array_equal(common_corners(left, right, board)[1].xy_px, right.xy_px)


def test_unambiguous_boards_are_not_reordered():
    at = pose((10, 20, 5), (0, 0, 0.6))
    left, right = exact_view(CAMERA, at, "l"), exact_view(CAMERA, at, "r")
    reversed_ = dataclasses.replace(right, xy_px=right.xy_px[::-1])
    assert np.array_equal(common_corners(left, reversed_, CHESS)[1].xy_px, right.xy_px[::-1])


def test_common_corners_of_a_pair():
    at = pose((10, 20, 5), (0, 0, 0.7), CHARUCO)
    left, right = (exact_view(CAMERA, at, name, board=CHARUCO) for name in "lr")
    both = common_corners(
        left.of_corners(np.arange(20)), right.of_corners(np.arange(10, 35)), CHARUCO
    )
    assert [view.corner_id.tolist() for view in both] == [list(range(10, 20))] * 2
    assert np.array_equal(both[0].xyz_m, CHARUCO.corners_m[10:20])


@pytest.mark.slow
def test_count_board_sizes_and_markers():
    images = [drawn(CAMERA, at) for at in varied_poses(3, seed=2)]
    sizes = count_board_sizes([*images, np.full((100, 100), 99, np.uint8)])
    assert sizes.most_common(1)[0] == ((9, 6), 2)  # only a part of the third board is detected
    assert sizes.total() == 3
    image = drawn(CAMERA, pose((0, 0, 0), (0, 0, 0.7), CHARUCO), board=CHARUCO)
    markers = count_markers([image])
    assert markers["4X4_50"] == markers["4X4_1000"] == 24
    assert markers["6X6_50"] == 0


def test_the_real_boards(real_mono):
    rejected = {view.name for view in real_mono if isinstance(view, RejectedView)}
    # the board is partly outside the image
    assert rejected == {"calibration1.jpg", "calibration5.jpg"}
