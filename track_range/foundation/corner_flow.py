"""Corners for long tracks: equally many in each cell of the image, and Lucas-Kanade both ways.

Corners are of the full image and followed with subpixel accuracy, which costs more than the flow of
`sparse_flow` on small images.
"""

from itertools import pairwise
from typing import Any

import cv2
import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray32, Image

_MIN_QUALITY = 0.01  # minimum quality of a corner, as a fraction of the best corner's in its cell
_WINDOW_PX = (15, 15)  # size of the tracked window, px
_MAX_RETURN_PX = 0.5  # largest error of the forward-backward check, px
_BORDER_PX = 8  # minimum distance of a point from the image border, px
_MIN_PER_CELL = 5  # smallest number of corners searched in a cell
# iterations of Lucas-Kanade, and step in px
_STOP = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 20, 0.01)


def new_corners(
    image: Image,
    points: FloatArray32,
    n_corners: int,
    *,
    grid: tuple[int, int],
    min_gap_px: int,
    is_free: BoolArray | None = None,
) -> FloatArray32:
    """(M, 2) about `n_corners` corners, equally many in each cell of `grid` (rows, columns).

    They are at least `min_gap_px` from one another and from `points` (N, 2), and where the mask
    `is_free` (H, W) allows.
    """
    free = np.full(image.shape, 255, np.uint8) if is_free is None else is_free.astype(np.uint8)
    for x, y in np.round(points).astype(int).tolist():
        cv2.circle(free, (x, y), min_gap_px, 0, -1)
    n_rows, n_columns = grid
    rows = np.linspace(0, image.shape[0], n_rows + 1).astype(int).tolist()
    columns = np.linspace(0, image.shape[1], n_columns + 1).astype(int).tolist()
    n_per_cell = max(_MIN_PER_CELL, n_corners // (n_rows * n_columns))
    new = [np.zeros((0, 2), np.float32)]
    for top, bottom in pairwise(rows):
        for start, end in pairwise(columns):
            cell = np.s_[top:bottom, start:end]
            corners = cv2.goodFeaturesToTrack(
                image[cell], n_per_cell, _MIN_QUALITY, min_gap_px, mask=free[cell], blockSize=5
            )
            if corners is not None:
                new.append(
                    corners.reshape(-1, 2).astype(np.float32) + np.array([start, top], np.float32)
                )
    return np.concatenate(new)


def checked_flow(
    source: Image,
    target: Image,
    points: FloatArray32,
    start: FloatArray32,
    levels: int,
    return_levels: int | None = None,
) -> tuple[FloatArray32, BoolArray]:
    """Positions in another image of points (N, 2), and (N,) whether they pass the forward-backward
    check.

    The search begins at `start` (N, 2), with `levels` of the pyramid above the images; the way
    back begins at its end, and fewer levels, `return_levels`, are enough for small errors.
    """

    def lucas_kanade(
        first: Image, second: Image, xy: FloatArray32, start: FloatArray32, levels: int
    ) -> tuple[FloatArray32, BoolArray]:
        settings: dict[str, Any] = {"winSize": _WINDOW_PX, "maxLevel": levels, "criteria": _STOP}
        flags = cv2.OPTFLOW_USE_INITIAL_FLOW
        moved, status, _ = cv2.calcOpticalFlowPyrLK(
            first, second, xy, start.copy(), flags=flags, **settings
        )
        return np.asarray(moved, np.float32), status.reshape(-1) > 0

    moved, is_tracked = lucas_kanade(source, target, points, start, levels)
    returned, has_returned = lucas_kanade(
        target, source, moved, points, levels if return_levels is None else return_levels
    )
    height, width = target.shape
    is_inside = (moved >= _BORDER_PX).all(axis=1) & (
        moved < np.array([width, height]) - 1 - _BORDER_PX
    ).all(axis=1)
    is_consistent = np.abs(returned - points).max(axis=1) < _MAX_RETURN_PX
    return moved, np.asarray(is_tracked & has_returned & is_inside & is_consistent)
