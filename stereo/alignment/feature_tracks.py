"""FeatureTracks: corners tracked through the left images and matched in each right image, with
subpixel accuracy.

    left t-1 --LK--> left t --LK--> right t        with a forward-backward check: both directions must agree

Pyramidal Lucas-Kanade (Bouguet) finds only nearby positions: from left to right it starts from a
coarse disparity map, over time from the last position.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, FloatArray32, Image, IntArray
from track_range.foundation.corner_flow import checked_flow, new_corners
from track_range.stereo.geometry.frames import grey

MIN_ROWS = 30  # minimum number of points for a row offset
_N_POINTS = 1100  # number of points that are tracked
_GRID = (3, 8)  # rows and columns of cells with equal numbers of new points
_MIN_GAP_PX = 10  # minimum distance between two points, px
_LEVELS = 3  # pyramid levels above the full image for tracking over time
# largest difference between the row offset of a right point and the common one, px
_MAX_ROW_PX = 2.0
# number of disparities searched in the half-size images; twice as many in full pixels
_COARSE_RANGE_PX = 80
# smallest of them: a wrong vergence of 0.5 degrees makes disparities of far points negative
_COARSE_MIN_PX = -8
_UNKNOWN_PX = 5.0  # initial disparity where the coarse map has none, px
_MAX_LOG_GAIN = 0.15  # largest difference of the contrasts of left and right that is left as it is


class PairPoints(NamedTuple):
    """The points of one frame that are visible in both images."""

    number: IntArray  # (N,) numbers of the points, equal in all frames
    left_px: FloatArray  # (N, 2) x, y in the left image
    right_px: FloatArray  # (N, 2) x, y in the right image

    @property
    def row_offsets_px(self) -> FloatArray:
        """(N,) y_right - y_left."""
        return self.right_px[:, 1] - self.left_px[:, 1]


class TrackedFrame(NamedTuple):
    """The points of one frame of a drive, and how well they were tracked from the frame before."""

    time_s: float  # time of the frame
    points: PairPoints  # points that are visible in both images
    flow_px: float  # median flow since the previous frame; 0 for the first frame
    # fraction of the points tracked from the previous frame; 1 for the first frame
    fraction_tracked: float


class FeatureTracks:
    """Tracks corners through the frames of a drive."""

    def __init__(self) -> None:
        self._before: Image | None = None
        self._left_px: FloatArray32 = np.zeros((0, 2), np.float32)
        self._number: IntArray = np.zeros(0, np.int64)
        self._next_number = 0
        self._coarse = cv2.StereoSGBM.create(
            minDisparity=_COARSE_MIN_PX,
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

    def add(self, left: Image, right: Image, time_s: float = 0.0) -> TrackedFrame:
        """Track the points into the next frame, rectified (H, W) grey or (H, W, 3) BGR, and add new
        corners.
        """
        left, right = grey(left), _as_bright(grey(right), grey(left))
        flow_px, fraction_tracked = 0.0, 1.0
        if self._before is not None and len(self._left_px):
            moved, is_tracked = checked_flow(
                self._before, left, self._left_px, self._left_px, _LEVELS
            )
            step_px = np.linalg.norm(moved - self._left_px, axis=1)[is_tracked]
            flow_px = float(np.median(step_px)) if len(step_px) else float("inf")
            fraction_tracked = float(is_tracked.mean())
            self._left_px, self._number = moved[is_tracked], self._number[is_tracked]
        self._add_corners(left)
        self._before = left
        return TrackedFrame(time_s, self._match_right(left, right), flow_px, fraction_tracked)

    def _add_corners(self, left: Image) -> None:
        n_missing = _N_POINTS - len(self._left_px)
        if n_missing <= 0:
            return
        new = new_corners(left, self._left_px, n_missing, grid=_GRID, min_gap_px=_MIN_GAP_PX)
        points = np.concatenate([self._left_px, new])
        n_new = len(points) - len(self._left_px)
        self._number = np.concatenate([self._number, self._next_number + np.arange(n_new)])
        self._next_number += n_new
        self._left_px = points.astype(np.float32)

    def _match_right(self, left: Image, right: Image) -> PairPoints:
        """The points that are also visible in the right image."""
        if not len(self._left_px):
            return PairPoints(self._number, np.zeros((0, 2)), np.zeros((0, 2)))
        coarse = self._coarse_disparity(left, right)
        height, width = coarse.shape
        column = np.clip(self._left_px[:, 0] / 2, 0, width - 1).astype(int)
        row = np.clip(self._left_px[:, 1] / 2, 0, height - 1).astype(int)
        coarse_px = coarse[row, column]
        is_known = np.isfinite(coarse_px)
        start = self._left_px.copy()
        start[:, 0] -= np.where(is_known, coarse_px, _UNKNOWN_PX)
        right_px, is_matched = checked_flow(left, right, self._left_px, start, 1)
        row_px = right_px[:, 1] - self._left_px[:, 1]
        if (is_matched & is_known).any():
            is_matched &= is_known & (
                np.abs(row_px - np.median(row_px[is_matched & is_known])) < _MAX_ROW_PX
            )
        left_px = self._left_px[is_matched].astype(float)
        return PairPoints(self._number[is_matched], left_px, right_px[is_matched].astype(float))

    def _coarse_disparity(self, left: Image, right: Image) -> FloatArray32:
        """(H / 2, W / 2) disparities in full pixels; NaN where unknown."""
        halves = [
            cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            for image in (left, right)
        ]
        border = (0, 0, _COARSE_RANGE_PX, -_COARSE_MIN_PX)
        padded = [cv2.copyMakeBorder(half, *border, cv2.BORDER_REPLICATE) for half in halves]
        steps = self._coarse.compute(padded[0], padded[1])[:, _COARSE_RANGE_PX:_COARSE_MIN_PX]
        return np.where(
            steps >= 16 * _COARSE_MIN_PX, steps.astype(np.float32) * (2 / 16), np.float32(np.nan)
        )


def row_offset_px(left: Image, right: Image) -> float | None:
    """Median y_right - y_left of the points of a pair, (H, W) or (H, W, 3) each; None with too few
    points.
    """
    rows_px = FeatureTracks().add(left, right).points.row_offsets_px
    return float(np.median(rows_px)) if len(rows_px) >= MIN_ROWS else None


def _as_bright(image: Image, other: Image) -> Image:
    """The image with the brightness of the other image, if they differ much: Lucas-Kanade compares
    grey levels.
    """
    factor = float(other.std()) / max(float(image.std()), 1.0)
    if abs(math.log(max(factor, 1e-3))) < _MAX_LOG_GAIN:
        return image
    return np.asarray(cv2.convertScaleAbs(image, alpha=factor, beta=0.0), np.uint8)
