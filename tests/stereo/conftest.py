"""Real images of boards, searched once for all tests."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

from track_range.stereo.calibration.board_views import BoardFinder, BoardView, RejectedView
from track_range.stereo.calibration.boards import ChessBoard


@pytest.fixture(scope="session")
def real_mono(shared_data: Path) -> list[BoardView | RejectedView]:
    """The 20 photographs of chessboards/mono9x6, cut to 1280x720."""
    finder = BoardFinder(ChessBoard(9, 6, 0.02))
    paths = sorted((shared_data / "chessboards" / "mono9x6").glob("*.jpg"))
    return [finder.find(cv2.imread(str(path))[:720, :1280], path.name) for path in paths]
