"""BoardFinder: the corners of a calibration board in an image, with subpixel accuracy, or the
reason for rejecting it.

Chessboards are detected with OpenCV's sector-based method (Duda & Frese 2018) at its highest
accuracy: on two real sets of photographs it detects one more board than the classic detector with
cornerSubPix, and leaves smaller residuals. The corners of a board that looks the same after a
rotation by 180 degrees may be counted from either end; `common_corners` resolves this for a stereo
pair.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.stereo.calibration import boards
from track_range.stereo.geometry.frames import grey

# minimum number of corners of a ChArUco board that determine its pose well enough
_MIN_CHARUCO_CORNERS = 6
# Flags of a slower search for chessboards that the first one misses: in dark images, and curved by
# a wide lens.
_THOROUGH = cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE
# half side of the patch in which a corner's edge width is measured / corner spacing
_PATCH_FRACTION = 0.35
_NO_CORNERS: tuple[IntArray, FloatArray] = (np.zeros(0, np.int64), np.zeros((0, 2)))


@dataclass(frozen=True, slots=True)
class BoardView:
    """The detected corners of a board in one image."""

    name: str  # name of the image
    size_px: tuple[int, int]  # (width, height) of the image
    corner_id: IntArray  # (N,) ids of the detected corners
    xy_px: FloatArray  # (N, 2) their positions in the image, pixel centres at integers
    xyz_m: FloatArray  # (N, 3) their positions on the board, metres
    # width of the edges between black and white: about 2 in sharp images, more than 5 in blurred
    # ones
    edge_px: float

    def of_corners(self, corner_id: IntArray) -> BoardView:
        """The view restricted to the corners with the given ids (K,)."""
        rows = np.isin(self.corner_id, corner_id)
        return replace(
            self, corner_id=self.corner_id[rows], xy_px=self.xy_px[rows], xyz_m=self.xyz_m[rows]
        )


@dataclass(frozen=True, slots=True)
class RejectedView:
    """An image that is not used, and the reason for the user."""

    name: str
    reason: str


class BoardFinder:
    """Detects one type of board."""

    def __init__(self, board: boards.Board) -> None:
        self.board = board
        self._corners_m = board.corners_m
        self._charuco = (
            boards.charuco_detectors(board) if isinstance(board, boards.CharucoBoard) else ()
        )

    def find(self, image: Image, name: str) -> BoardView | RejectedView:
        """The board in an image (H, W) or (H, W, 3) BGR."""
        image = grey(image)
        corner_id, xy_px = (
            self._charuco_corners(image) if self._charuco else self._chess_corners(image)
        )
        if not len(corner_id) and not self._charuco:
            corner_id, xy_px = self._chess_corners(image, flags=_THOROUGH)
        if not len(corner_id):
            return RejectedView(name, "no complete board found")
        xyz_m = self._corners_m[corner_id]
        # corners on one line determine no pose
        spread = np.linalg.svd(xyz_m[:, :2] - xyz_m[:, :2].mean(axis=0), compute_uv=False)
        if len(corner_id) < _MIN_CHARUCO_CORNERS or spread[1] < 1e-6 * max(spread[0], 1e-12):
            return RejectedView(name, f"only {len(corner_id)} corners of the board were found")
        size_px = (image.shape[1], image.shape[0])
        return BoardView(name, size_px, corner_id, xy_px, xyz_m, _edge_px(image, xy_px))

    def may_contain_board(self, image: Image) -> bool:
        """Whether a fast search finds a board: for videos, in which most frames show none."""
        image = grey(image)
        if self._charuco:
            marker_id = self._charuco[0].detectBoard(image)[3]
            # no marker is None or, in OpenCV 5.1, an empty array
            return marker_id is not None and len(marker_id) > 0
        scale = min(1.0, 640 / max(image.shape))
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        return len(self._chess_corners(np.asarray(small, np.uint8), flags=0)[0]) > 0

    def _chess_corners(
        self, image: Image, *, flags: int = cv2.CALIB_CB_ACCURACY
    ) -> tuple[IntArray, FloatArray]:
        try:
            is_found, xy_px = cv2.findChessboardCornersSB(image, self.board.grid, flags=flags)
        except cv2.error:  # fewer pixels than the board has corners
            return _NO_CORNERS
        if not is_found:
            return _NO_CORNERS
        return np.arange(len(self._corners_m)), np.asarray(xy_px, np.float64).reshape(-1, 2)

    def _charuco_corners(self, image: Image) -> tuple[IntArray, FloatArray]:
        """Corners of the board in its current pattern, else in the pattern of OpenCV before 4.6."""
        for detector in self._charuco:
            xy_px, corner_id, *_ = detector.detectBoard(image)
            if corner_id is not None and len(corner_id):
                return np.asarray(corner_id, np.int64).ravel(), np.asarray(
                    xy_px, np.float64
                ).reshape(-1, 2)
        return _NO_CORNERS


def common_corners(
    left: BoardView, right: BoardView, board: boards.Board
) -> tuple[BoardView, BoardView]:
    """Both views restricted to their common corners, counted from the same end of the board.

    A chessboard with two even or two odd numbers of corners looks the same after a rotation by 180
    degrees; the cameras are then assumed to be mounted the same way up. Other boards are
    unambiguous.
    """
    common = np.intersect1d(left.corner_id, right.corner_id)
    left, right = left.of_corners(common), right.of_corners(common)
    if isinstance(board, boards.ChessBoard) and sum(board.grid) % 2 == 0 and len(common):
        ids = np.arange(len(right.corner_id)).reshape(board.n_rows, board.n_columns)
        quarters = (0, 1, 2, 3) if board.n_rows == board.n_columns else (0, 2)
        rotated = [
            replace(right, xy_px=right.xy_px[np.rot90(ids, quarter).ravel()])
            for quarter in quarters
        ]

        def disagreement(view: BoardView) -> float:
            """Distance between the corners in the two images, after aligning their means."""
            shapes = [one.xy_px - one.xy_px.mean(axis=0) for one in (left, view)]
            return float(np.linalg.norm(shapes[0] - shapes[1]))

        right = min(rotated, key=disagreement)
    return left, right


def count_board_sizes(images: Sequence[Image]) -> Counter[tuple[int, int]]:
    """Number of images by size of the chessboard that they show, in inner corners, the larger
    number first.
    """
    counts: Counter[tuple[int, int]] = Counter()
    for image in images:
        flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_ACCURACY
        is_found, _, cells = cv2.findChessboardCornersSBWithMeta(grey(image), (3, 3), flags)
        if is_found and cells is not None:
            rows, columns = cells.shape[:2]
            counts[max(rows, columns), min(rows, columns)] += 1
    return counts


def count_markers(images: Sequence[Image]) -> Counter[str]:
    """Number of ArUco markers in the images, by dictionary.

    In a family such as 4X4_50 .. 4X4_1000, the smaller dictionaries are the start of the largest,
    which is detected.
    """
    counts: Counter[str] = Counter()
    greys = [grey(image) for image in images]
    n_markers = {name: len(boards.dictionary_of(name).bytesList) for name in boards.dictionaries()}
    families = {name: re.sub(r"_\d+$", "", name) for name in n_markers}
    for family in set(families.values()):
        members = [name for name, other in families.items() if other == family]
        detector = cv2.aruco.ArucoDetector(
            boards.dictionary_of(max(members, key=n_markers.__getitem__))
        )
        detected = [
            ids.ravel()
            for ids in (detector.detectMarkers(image)[1] for image in greys)
            if ids is not None
        ]
        ids = np.concatenate([np.zeros(0, np.int32), *detected])
        counts.update({name: int((ids < n_markers[name]).sum()) for name in members})
    return counts


def _edge_px(image: Image, xy_px: FloatArray) -> float:
    """Median over the corners of the width of their edges, contrast / steepest slope."""
    spacing_px = np.linalg.norm(xy_px[:, None] - xy_px[None], axis=2)
    np.fill_diagonal(spacing_px, np.inf)
    half = int(np.clip(_PATCH_FRACTION * float(spacing_px.min()), 2, 20))
    widths = []
    for x, y in xy_px.round().astype(int):
        patch = image[max(y - half, 0) : y + half + 1, max(x - half, 0) : x + half + 1]
        if min(patch.shape) < 3:
            continue
        slope = np.hypot(
            cv2.Sobel(patch, cv2.CV_32F, 1, 0, scale=1 / 8),
            cv2.Sobel(patch, cv2.CV_32F, 0, 1, scale=1 / 8),
        )
        dark, bright = np.percentile(patch, [5, 95])
        widths.append((bright - dark) / max(float(np.percentile(slope, 95)), 1e-3))
    return float(np.median(widths)) if widths else np.inf
