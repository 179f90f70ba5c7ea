"""Boards to calibrate with: where their corners lie, in metres, and how a user names one.

    9x6                            a chessboard of 9 x 6 inner corners (10 x 7 squares)
    charuco:5x7:40:20[:4X4_50]     a ChArUco board of 5 x 7 squares of 40 mm with markers of 20 mm, of that dictionary

A board's frame has x along its rows and y down its columns, so z points into it when it is looked at.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.rig import RigError

SQUARE_M = (0.002, 1.0)
"""Plausible side of a square: a stamp .. a wall."""

_N_CORNERS = (3, 60)
"""Inner corners that a chessboard may have along a side; fewer than 3 are found anywhere."""

_SIZE = re.compile(r"(\d+)[xX*](\d+)")
_DEFAULT_DICTIONARY = "4X4_50"


class CalibrationError(RigError):
    """Images that no calibration can be made of; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class ChessBoard:
    """A chessboard.

    Attributes:
        n_columns: inner corners along a row.
        n_rows: inner corners down a column.
        square_m: side of a square.
    """

    n_columns: int
    n_rows: int
    square_m: float

    @property
    def name(self) -> str:
        """As `board_of` reads it."""
        return f"{self.n_columns}x{self.n_rows}"

    @property
    def grid(self) -> tuple[int, int]:
        """(columns, rows) of corners."""
        return self.n_columns, self.n_rows

    @property
    def corners_m(self) -> FloatArray:
        """(N, 3) corners row by row, z = 0."""
        return _grid_m(self.grid, self.square_m)


@dataclass(frozen=True, slots=True)
class CharucoBoard:
    """A chessboard with ArUco markers in its white squares, of which any part may be seen.

    Attributes:
        n_columns: squares along a row.
        n_rows: squares down a column.
        square_m: side of a square.
        marker_m: side of a marker.
        dictionary: the markers' dictionary, as OpenCV names it without DICT_.
    """

    n_columns: int
    n_rows: int
    square_m: float
    marker_m: float
    dictionary: str = _DEFAULT_DICTIONARY

    @property
    def name(self) -> str:
        """As `board_of` reads it."""
        sides = f"{self.square_m * 1000:g}:{self.marker_m * 1000:g}"
        return f"charuco:{self.n_columns}x{self.n_rows}:{sides}:{self.dictionary}"

    @property
    def grid(self) -> tuple[int, int]:
        """(columns, rows) of inner corners."""
        return self.n_columns - 1, self.n_rows - 1

    @property
    def corners_m(self) -> FloatArray:
        """(N, 3) inner corners by id, z = 0; the first square's inner corner is (square_m, square_m)."""
        return np.asarray(_grid_m(self.grid, self.square_m) + np.array([self.square_m, self.square_m, 0.0]))


Board = ChessBoard | CharucoBoard


def board_of(text: str, square_mm: float | None) -> Board:
    """The board that a user's words name.

    Args:
        text: see the module's first lines.
        square_mm: side of a chessboard's squares; None for ChArUco boards, which name it themselves.

    Raises:
        ValueError: the words name no board, or the size of a square is missing or not plausible; the message is meant
            for the user.
    """
    board = _charuco_of(text, square_mm) if text.lower().startswith("charuco") else _chess_of(text, square_mm)
    low, high = SQUARE_M
    if not low <= board.square_m <= high:
        given_mm = board.square_m * 1000
        metres = f" ({given_mm:g} m would be {given_mm * 1000:g} mm)" if low <= given_mm <= high else ""
        raise ValueError(
            f"squares of {given_mm:g} mm are not plausible; give the side of one in millimetres, "
            f"{low * 1000:g} .. {high * 1000:g}{metres}."
        )
    return board


def charuco_detectors(board: CharucoBoard) -> tuple[cv2.aruco.CharucoDetector, cv2.aruco.CharucoDetector]:
    """OpenCV's detectors of the board as it is drawn today, and as it was drawn before OpenCV 4.6 (even rows)."""
    today, before = _opencv_board(board), _opencv_board(board)
    before.setLegacyPattern(True)
    return cv2.aruco.CharucoDetector(today), cv2.aruco.CharucoDetector(before)


def dictionaries() -> tuple[str, ...]:
    """Names of the marker dictionaries that this OpenCV knows."""
    return tuple(name[5:] for name in dir(cv2.aruco) if name.startswith("DICT_") and name == name.upper())


def dictionary_of(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's markers of one of `dictionaries`."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))


def _opencv_board(board: CharucoBoard) -> cv2.aruco.CharucoBoard:
    squares = (board.n_columns, board.n_rows)
    return cv2.aruco.CharucoBoard(squares, board.square_m, board.marker_m, dictionary_of(board.dictionary))


def _grid_m(grid: tuple[int, int], square_m: float) -> FloatArray:
    y, x = np.mgrid[0 : grid[1], 0 : grid[0]]
    return np.asarray(np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1) * square_m)


def _chess_of(text: str, square_mm: float | None) -> ChessBoard:
    n_columns, n_rows = _sides(text, text)
    low, high = _N_CORNERS
    if not (low <= n_columns <= high and low <= n_rows <= high):
        raise ValueError(f"'{text}': {low} to {high} inner corners along each side are wanted.")
    if square_mm is None:
        raise ValueError("the side of a square is wanted too: --square-mm 20.")
    return ChessBoard(n_columns, n_rows, square_mm / 1000)


def _charuco_of(text: str, square_mm: float | None) -> CharucoBoard:
    parts = text.split(":")
    if len(parts) not in (4, 5):
        raise ValueError(f"'{text}': write charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM[:DICTIONARY], in squares.")
    n_columns, n_rows = _sides(parts[1], text)
    try:
        side_mm, marker_mm = float(parts[2]), float(parts[3])
    except ValueError as error:
        raise ValueError(f"'{text}': the sides of a square and of a marker are wanted in millimetres.") from error
    dictionary = (parts[4] if len(parts) == 5 else _DEFAULT_DICTIONARY).upper().removeprefix("DICT_")
    if dictionary not in dictionaries():
        raise ValueError(f"'{text}': there is no dictionary {dictionary}; choose of {', '.join(dictionaries())}.")
    if min(n_columns, n_rows) < 3:
        raise ValueError(f"'{text}': at least 3 squares along each side are wanted.")
    n_markers, n_known = n_columns * n_rows // 2, len(dictionary_of(dictionary).bytesList)
    if n_markers > n_known:
        raise ValueError(
            f"'{text}': there are {n_markers} markers on it, of which the dictionary {dictionary} has but {n_known}; "
            "name the one that it was printed with, such as 4X4_1000."
        )
    if not 0 < marker_mm < side_mm:
        raise ValueError(f"'{text}': markers ({marker_mm:g} mm) lie inside squares ({side_mm:g} mm).")
    if square_mm is not None and square_mm != side_mm:
        raise ValueError(f"'{text}' says squares of {side_mm:g} mm, --square-mm {square_mm:g}; leave one of them out.")
    return CharucoBoard(n_columns, n_rows, side_mm / 1000, marker_mm / 1000, dictionary)


def _sides(size: str, text: str) -> tuple[int, int]:
    match = _SIZE.fullmatch(size)
    if match is None:
        raise ValueError(f"'{text}' is no board: write its inner corners as 9x6, or charuco:5x7:40:20:4X4_50.")
    return int(match[1]), int(match[2])
