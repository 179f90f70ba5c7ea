"""FeatureTracks: corners followed through the left images and found in each right one, to parts of a pixel.

    left t-1 --LK--> left t --LK--> right t        each way and back again: what does not return to its start is dropped

Lucas-Kanade flow (Bouguet's pyramids) starts across the eyes from a coarse disparity map, since it only finds what is
near; through time it starts from where the point was.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32, Image, IntArray

MIN_ROWS = 30
"""Fewer points tell no row offset."""

_N_POINTS = 1100
_GRID = (3, 8)
"""Rows and columns of cells that get equal numbers of new points."""

_MIN_GAP_PX = 10
_MIN_QUALITY = 0.01
_WINDOW_PX = (15, 15)
_LEVELS = 3
_MAX_RETURN_PX = 0.5
_MAX_ROW_PX = 2.0
"""A right point further from the common row offset is a wrong one."""

_BORDER_PX = 8
_COARSE_RANGE_PX = 80
"""Disparities of the half-size images that are searched: up to twice as many of the whole ones."""

_UNKNOWN_PX = 5.0
_STOP = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 20, 0.01)


class PairPoints(NamedTuple):
    """The points of one frame that both eyes see.

    Attributes:
        number: (N,) the point's number, the same in all frames.
        left_px: (N, 2) x, y.
        right_px: (N, 2).
    """

    number: IntArray
    left_px: FloatArray
    right_px: FloatArray

    @property
    def row_offsets_px(self) -> FloatArray:
        """(N,) y_right - y_left."""
        return self.right_px[:, 1] - self.left_px[:, 1]


class FeatureTracks:
    """Corners of a drive, followed.

    Attributes:
        flow_px: median distance that points moved since the frame before; 0 for the first.
        share_kept: share of the points that were followed into this frame; 1 for the first.
    """

    def __init__(self) -> None:
        self.flow_px, self.share_kept = 0.0, 1.0
        self._before: Image | None = None
        self._left_px: FloatArray32 = np.zeros((0, 2), np.float32)
        self._number: IntArray = np.zeros(0, np.int64)
        self._n_made = 0
        self._coarse = _coarse_matcher()

    def add(self, left: Image, right: Image) -> PairPoints:
        """Follow into the next frame of the drive, (H, W) uint8 grey and rectified, and take up new points."""
        self.flow_px, self.share_kept = 0.0, 1.0
        if self._before is not None and len(self._left_px):
            self._follow(self._before, left)
        self._take_up(left)
        self._before = left
        return self._across(left, right)

    def _follow(self, before: Image, left: Image) -> None:
        moved, kept = _flow(before, left, self._left_px, self._left_px, _LEVELS)
        step_px = np.linalg.norm(moved - self._left_px, axis=1)[kept]
        self.flow_px = float(np.median(step_px)) if len(step_px) else float("inf")
        self.share_kept = float(kept.mean())
        self._left_px, self._number = moved[kept], self._number[kept]

    def _take_up(self, left: Image) -> None:
        n_wanted = _N_POINTS - len(self._left_px)
        if n_wanted <= 0:
            return
        free = np.full(left.shape, 255, np.uint8)
        for x, y in np.round(self._left_px).astype(int).tolist():
            cv2.circle(free, (x, y), _MIN_GAP_PX, 0, -1)
        found = np.concatenate([self._left_px, *_new_corners(left, free, n_wanted)])
        n_new = len(found) - len(self._left_px)
        self._number = np.concatenate([self._number, self._n_made + np.arange(n_new)])
        self._n_made += n_new
        self._left_px = found.astype(np.float32)

    def _across(self, left: Image, right: Image) -> PairPoints:
        """The points that the right eye sees too."""
        if not len(self._left_px):
            return PairPoints(self._number, np.zeros((0, 2)), np.zeros((0, 2)))
        coarse = _coarse_disparity(self._coarse, left, right)
        height, width = coarse.shape
        column = np.clip(self._left_px[:, 0] / 2, 0, width - 1).astype(int)
        row = np.clip(self._left_px[:, 1] / 2, 0, height - 1).astype(int)
        guess_px = coarse[row, column]
        is_known = guess_px > 0
        start = self._left_px.copy()
        start[:, 0] -= np.where(is_known, guess_px, _UNKNOWN_PX)
        found, kept = _flow(left, right, self._left_px, start, 1)
        row_px = found[:, 1] - self._left_px[:, 1]
        if (kept & is_known).any():
            kept &= is_known & (np.abs(row_px - np.median(row_px[kept & is_known])) < _MAX_ROW_PX)
        return PairPoints(self._number[kept], self._left_px[kept].astype(float), found[kept].astype(float))


def row_offset_px(left: Image, right: Image) -> float | None:
    """Median y_right - y_left of the points of one pair, (H, W) or (H, W, 3) each; None with too few points."""
    rows_px = FeatureTracks().add(grey(left), grey(right)).row_offsets_px
    return float(np.median(rows_px)) if len(rows_px) >= MIN_ROWS else None


def grey(image: Image) -> Image:
    """An image (H, W) or (H, W, 3) BGR in grey."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8) if image.ndim == 3 else image


def _coarse_matcher() -> cv2.StereoSGBM:
    return cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=_COARSE_RANGE_PX,
        blockSize=5,
        P1=8 * 25,
        P2=32 * 25,
        disp12MaxDiff=1,
        preFilterCap=63,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )


def _coarse_disparity(matcher: cv2.StereoSGBM, left: Image, right: Image) -> FloatArray32:
    """(H / 2, W / 2) disparities in pixels of the whole images; not positive where unknown."""
    halves = [cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for image in (left, right)]
    wide = [cv2.copyMakeBorder(half, 0, 0, _COARSE_RANGE_PX, 0, cv2.BORDER_REPLICATE) for half in halves]
    steps = matcher.compute(wide[0], wide[1])[:, _COARSE_RANGE_PX:]
    return np.asarray(steps.astype(np.float32) * (2 / 16), np.float32)


def _new_corners(left: Image, free: Image, n_wanted: int) -> list[FloatArray32]:
    """Corners in each cell, where `free` is not 0."""
    n_rows, n_columns = _GRID
    rows = np.linspace(0, left.shape[0], n_rows + 1).astype(int).tolist()
    columns = np.linspace(0, left.shape[1], n_columns + 1).astype(int).tolist()
    n_each = max(5, n_wanted // (n_rows * n_columns))
    found = []
    for top, bottom in pairwise(rows):
        for start, end in pairwise(columns):
            cell = np.s_[top:bottom, start:end]
            corners = cv2.goodFeaturesToTrack(
                left[cell], n_each, _MIN_QUALITY, _MIN_GAP_PX, mask=free[cell], blockSize=5
            )
            if corners is not None:
                found.append(corners.reshape(-1, 2).astype(np.float32) + np.array([start, top], np.float32))
    return found


def _flow(
    source: Image, target: Image, points: FloatArray32, start: FloatArray32, levels: int
) -> tuple[FloatArray32, BoolArray]:
    """Where the points (N, 2) of one image lie in another, and which of them are sure."""
    there, back = start.copy(), points.copy()
    found, is_found = _lucas_kanade(source, target, points, there, levels)
    returned, has_returned = _lucas_kanade(target, source, found, back, levels)
    height, width = target.shape
    inside = (found >= _BORDER_PX).all(axis=1) & (found < np.array([width, height]) - 1 - _BORDER_PX).all(axis=1)
    same = np.abs(returned - points).max(axis=1) < _MAX_RETURN_PX
    return found, np.asarray(is_found & has_returned & inside & same)


def _lucas_kanade(
    source: Image, target: Image, points: FloatArray32, start: FloatArray32, levels: int
) -> tuple[FloatArray32, BoolArray]:
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        source,
        target,
        points,
        start,
        winSize=_WINDOW_PX,
        maxLevel=levels,
        criteria=_STOP,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(found, np.float32), status.reshape(-1) > 0
