"""How boards are named, where their corners lie, and every way to name one wrongly."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest

from track_range.stereo.calibration.boards import CharucoBoard, ChessBoard, board_of, charuco_detectors, dictionaries


def test_a_chessboard_counts_inner_corners_row_by_row():
    board = board_of("9x6", 20)
    assert board == ChessBoard(9, 6, 0.02)
    assert board.corners_m.shape == (54, 3)
    assert np.allclose(board.corners_m[[0, 8, 9, 53]], [[0, 0, 0], [0.16, 0, 0], [0, 0.02, 0], [0.16, 0.1, 0]])
    assert board_of(board.name, 20) == board


def test_a_charuco_board_counts_squares_and_says_its_size():
    board = board_of("charuco:5x7:40:20:dict_5x5_100", None)
    assert board == CharucoBoard(5, 7, 0.04, 0.02, "5X5_100")
    assert board_of(board.name, 40) == board
    assert board_of("charuco:5x7:40:20", None).dictionary == "4X4_50"


def test_charuco_corners_are_where_opencv_has_them():
    board = CharucoBoard(5, 8, 0.04, 0.02)
    theirs = np.array(charuco_detectors(board)[0].getBoard().getChessboardCorners())
    assert np.allclose(board.corners_m, theirs)


def test_the_default_dictionary_is_one_that_opencv_has():
    assert "4X4_50" in dictionaries()
    assert all(hasattr(cv2.aruco, f"DICT_{name}") for name in dictionaries())


@pytest.mark.parametrize(
    ("text", "square_mm", "said"),
    [
        ("9", 20, "'9' is no board: write its inner corners as 9x6"),
        ("9x6x2", 20, "is no board"),
        ("2x6", 20, "3 to 60 inner corners"),
        ("9x99", 20, "3 to 60 inner corners"),
        ("9x6", None, "--square-mm 20"),
        ("9x6", 0.02, "squares of 0.02 mm are not plausible; give the side of one in millimetres, 2 .. 1000 (0.02 m "),
        ("9x6", 0, "squares of 0 mm"),
        ("9x6", -20, "squares of -20 mm"),
        ("9x6", 20000, "squares of 20000 mm"),
        ("9x6", float("nan"), "squares of nan mm"),
        ("charuco:5x7", None, "charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM"),
        ("charuco:5:40:20", None, "is no board"),
        ("charuco:5x7:a:20", None, "wanted in millimetres"),
        ("charuco:5x7:40:20:9X9_1", None, "there is no dictionary 9X9_1; choose of 4X4_100"),
        ("charuco:2x7:40:20", None, "at least 3 squares"),
        ("charuco:11x10:40:20", None, "there are 55 markers on it, of which the dictionary 4X4_50 has but 50"),
        ("charuco:5x7:40:40", None, "markers (40 mm) lie inside squares (40 mm)"),
        ("charuco:5x7:40:20", 30, "says squares of 40 mm, --square-mm 30"),
        ("charuco:5x7:0.04:0.02", None, "squares of 0.04 mm are not plausible"),
    ],
)
def test_names_of_no_board(text, square_mm, said):
    with pytest.raises(ValueError, match=re.escape(said)):
        board_of(text, square_mm)
