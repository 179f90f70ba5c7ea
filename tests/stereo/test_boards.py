"""Specifications of boards, positions of their corners, and wrong specifications."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest

from track_range.stereo.calibration.boards import (
    CharucoBoard,
    ChessBoard,
    board_of,
    charuco_detectors,
    dictionaries,
)


def test_chessboard_specification():
    board = board_of("9x6", 20)
    assert board == ChessBoard(9, 6, 0.02)
    assert board.corners_m.shape == (54, 3)
    assert np.allclose(
        board.corners_m[[0, 8, 9, 53]], [[0, 0, 0], [0.16, 0, 0], [0, 0.02, 0], [0.16, 0.1, 0]]
    )
    assert board_of(board.name, 20) == board


def test_charuco_specification():
    board = board_of("charuco:5x7:40:20:dict_5x5_100", None)
    assert board == CharucoBoard(5, 7, 0.04, 0.02, "5X5_100")
    assert board_of(board.name, 40) == board
    assert board_of("charuco:5x7:40:20", None).dictionary == "4X4_50"


def test_charuco_corners_equal_opencv():
    board = CharucoBoard(5, 8, 0.04, 0.02)
    expected = np.array(charuco_detectors(board)[0].getBoard().getChessboardCorners())
    assert np.allclose(board.corners_m, expected)


def test_dictionaries_exist_in_opencv():
    assert "4X4_50" in dictionaries()
    assert all(hasattr(cv2.aruco, f"DICT_{name}") for name in dictionaries())


@pytest.mark.parametrize(
    ("text", "square_mm", "key_word"),
    [
        ("9", 20, "9x6"),
        ("9x6x2", 20, "9x6x2"),
        ("2x6", 20, "inner corners"),
        ("9x99", 20, "inner corners"),
        ("9x6", None, "--square-mm"),
        ("9x6", 0.02, "20 mm"),
        ("9x6", 0, "got 0 mm"),
        ("9x6", -20, "got -20 mm"),
        ("9x6", 20000, "got 20000 mm"),
        ("9x6", float("nan"), "got nan mm"),
        ("charuco:5x7", None, "SQUARE_MM"),
        ("charuco:5:40:20", None, "charuco:5:40:20"),
        ("charuco:5x7:a:20", None, "millimetres"),
        ("charuco:5x7:40:20:9X9_1", None, "9X9_1"),
        ("charuco:2x7:40:20", None, "3 squares"),
        ("charuco:11x10:40:20", None, "55 markers"),
        ("charuco:5x7:40:40", None, "markers"),
        ("charuco:5x7:40:20", 30, "--square-mm 30"),
        ("charuco:5x7:0.04:0.02", None, "got 0.04 mm"),
    ],
)
def test_wrong_specifications(text, square_mm, key_word):
    with pytest.raises(ValueError, match=re.escape(key_word)):
        board_of(text, square_mm)
