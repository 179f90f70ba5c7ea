"""Calibration boards: the positions of their corners, in metres, and their specification by the
user.

    9x6                            a chessboard of 9 x 6 inner corners (10 x 7 squares)
    charuco:5x7:40:20[:4X4_50]     a ChArUco board of 5 x 7 squares of 40 mm with markers of 20 mm, from that dictionary

A board's frame has x along its rows, y down its columns and z away from the camera.
"""

import re
from dataclasses import dataclass

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.rig import RigError

SQUARE_M = (0.002, 1.0)  # plausible range of the side of a square, metres
# range of the number of inner corners along a side; fewer than 3 would be detected in any texture
_N_CORNERS = (3, 60)

_SIZE = re.compile(r"(\d+)[xX*](\d+)")

# dictionary of ArUco markers if the specification of a board has none
_DEFAULT_DICTIONARY = "4X4_50"


class CalibrationError(RigError):
    """Images from which no calibration can be computed; the message gives the reason and what to
    do.
    """


@dataclass(frozen=True, slots=True)
class ChessBoard:
    """A chessboard."""

    n_columns: int  # number of inner corners in a row
    n_rows: int  # number of inner corners in a column
    square_m: float  # side of a square, metres

    @property
    def name(self) -> str:
        """Specification of the board, as `board_of` parses it."""
        return f"{self.n_columns}x{self.n_rows}"

    @property
    def grid(self) -> tuple[int, int]:
        """(columns, rows) of corners."""
        return self.n_columns, self.n_rows

    @property
    def corners_m(self) -> FloatArray:
        """(N, 3) corners row by row, metres, z = 0."""
        return _grid_m(self.grid, self.square_m)


@dataclass(frozen=True, slots=True)
class CharucoBoard:
    """A chessboard with ArUco markers in its white squares, which may be partly visible."""

    n_columns: int  # number of squares in a row
    n_rows: int  # number of squares in a column
    square_m: float  # side of a square, metres
    marker_m: float  # side of a marker, metres
    dictionary: str = _DEFAULT_DICTIONARY  # dictionary of the markers, OpenCV's name without DICT_

    @property
    def name(self) -> str:
        """Specification of the board, as `board_of` parses it."""
        sides = f"{self.square_m * 1000:g}:{self.marker_m * 1000:g}"
        return f"charuco:{self.n_columns}x{self.n_rows}:{sides}:{self.dictionary}"

    @property
    def grid(self) -> tuple[int, int]:
        """(columns, rows) of inner corners."""
        return self.n_columns - 1, self.n_rows - 1

    @property
    def corners_m(self) -> FloatArray:
        """(N, 3) inner corners by id, metres, z = 0; the first is at (square_m, square_m)."""
        return np.asarray(
            _grid_m(self.grid, self.square_m) + np.array([self.square_m, self.square_m, 0.0])
        )


Board = ChessBoard | CharucoBoard


def board_of(text: str, square_mm: float | None) -> Board:
    """The board with a specification.

    The docstring of this module describes specifications; `square_mm` is the side of a chessboard's
    squares, None for ChArUco boards, since their specification contains it. Raises ValueError, with
    a message for the user, if the specification is wrong, or the size of a square is missing or not
    plausible.
    """
    board = (
        _charuco_of(text, square_mm)
        if text.lower().startswith("charuco")
        else _chess_of(text, square_mm)
    )
    low, high = SQUARE_M
    if not low <= board.square_m <= high:
        side_mm = board.square_m * 1000
        hint = f" ({side_mm:g} m are {side_mm * 1000:g} mm)" if low <= side_mm <= high else ""
        raise ValueError(
            f"expected squares of {low * 1000:g} to {high * 1000:g} mm, got {side_mm:g} mm; give "
            f"the side of a square in millimetres{hint}."
        )
    return board


def charuco_detectors(
    board: CharucoBoard,
) -> tuple[cv2.aruco.CharucoDetector, cv2.aruco.CharucoDetector]:
    """OpenCV's detectors of the board in its current pattern, and in the pattern of OpenCV before
    4.6 (even rows).
    """
    current, legacy = _opencv_board(board), _opencv_board(board)
    legacy.setLegacyPattern(True)
    return cv2.aruco.CharucoDetector(current), cv2.aruco.CharucoDetector(legacy)


def dictionaries() -> tuple[str, ...]:
    """Names of the marker dictionaries of the installed OpenCV."""
    return tuple(
        name[5:] for name in dir(cv2.aruco) if name.startswith("DICT_") and name == name.upper()
    )


def dictionary_of(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary with a name from `dictionaries`."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))


def _opencv_board(board: CharucoBoard) -> cv2.aruco.CharucoBoard:
    squares = (board.n_columns, board.n_rows)
    return cv2.aruco.CharucoBoard(
        squares, board.square_m, board.marker_m, dictionary_of(board.dictionary)
    )


def _grid_m(grid: tuple[int, int], square_m: float) -> FloatArray:
    y, x = np.mgrid[0 : grid[1], 0 : grid[0]]
    return np.asarray(np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1) * square_m)


def _chess_of(text: str, square_mm: float | None) -> ChessBoard:
    n_columns, n_rows = _sides(text, text)
    low, high = _N_CORNERS
    if not (low <= n_columns <= high and low <= n_rows <= high):
        raise ValueError(f"'{text}': expected {low} to {high} inner corners along each side.")
    if square_mm is None:
        raise ValueError(
            f"'{text}': expected the side of a square in millimetres; add for example "
            "--square-mm 20."
        )
    return ChessBoard(n_columns, n_rows, square_mm / 1000)


def _charuco_of(text: str, square_mm: float | None) -> CharucoBoard:
    parts = text.split(":")
    if len(parts) not in (4, 5):
        raise ValueError(
            f"'{text}': expected charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM[:DICTIONARY], with "
            "columns and rows counted in squares."
        )
    n_columns, n_rows = _sides(parts[1], text)
    try:
        side_mm, marker_mm = float(parts[2]), float(parts[3])
    except ValueError as error:
        raise ValueError(
            f"'{text}': expected the sides of a square and of a marker in millimetres."
        ) from error
    dictionary = (
        (parts[4] if len(parts) == 5 else _DEFAULT_DICTIONARY).upper().removeprefix("DICT_")
    )
    if dictionary not in dictionaries():
        raise ValueError(
            f"'{text}': unknown dictionary {dictionary}; choose one of {', '.join(dictionaries())}."
        )
    if min(n_columns, n_rows) < 3:
        raise ValueError(f"'{text}': expected at least 3 squares along each side.")
    n_markers, n_available = n_columns * n_rows // 2, len(dictionary_of(dictionary).bytesList)
    if n_markers > n_available:
        raise ValueError(
            f"'{text}': expected a dictionary of at least {n_markers} markers, {dictionary} has "
            f"{n_available}; give the dictionary that the board was printed with, such as 4X4_1000."
        )
    if not 0 < marker_mm < side_mm:
        raise ValueError(
            f"'{text}': expected markers smaller than squares, got {marker_mm:g} and "
            f"{side_mm:g} mm."
        )
    if square_mm is not None and square_mm != side_mm:
        raise ValueError(
            f"'{text}': squares of {side_mm:g} mm contradict --square-mm "
            f"{square_mm:g}; omit the option."
        )
    return CharucoBoard(n_columns, n_rows, side_mm / 1000, marker_mm / 1000, dictionary)


def _sides(size: str, text: str) -> tuple[int, int]:
    match = _SIZE.fullmatch(size)
    if match is None:
        raise ValueError(
            f"'{text}': expected a board, given by its inner corners such as 9x6 or as "
            "charuco:5x7:40:20:4X4_50."
        )
    return int(match[1]), int(match[2])
