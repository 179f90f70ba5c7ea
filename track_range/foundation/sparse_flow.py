"""Sparse optical flow on small grey images: corners in a grid, a mask of boxes, and pyramidal
Lucas-Kanade.

Tracking uses it to move predicted boxes with the background; odometry uses it to measure the motion
of the camera. They share a `BackgroundFlow`, so that the small image, the corners and their flow
are computed once per frame. Pixels belong to the small image, with pixel centres at integers.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32, Image

# side of the cells of the mask, small pixels: boxes grow by up to one, so that few windows overlap
_CELL_PX = 8
# side of the squares of the half-size image with one feature each: 16 small pixels, two cells
_GRID_PX = 8
# minimum corner quality (OpenCV's smaller eigenvalue), above the noise of a textureless area
_MIN_EIGENVALUE = 1e-5
# window of the structure tensor at half size, and smallest eigenvalue that counts
_TENSOR_PX, _MIN_TENSOR = 5, 1e-6
# tracked window, and pyramid levels, for motions larger than the window
_WINDOW_PX, _N_LEVELS, _N_LEVELS_EXPECTED = 9, 4, 2
# Corners are detected at most so often; between, the tracked ones are those of the next flow, if so
# large a fraction of them is tracked.
DETECTION_INTERVAL_S, _MIN_KEPT = 0.06, 0.7
_MIN_SIDE_PX = 32  # of a small image that has room for windows
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)  # iterations and step in px


def small_grey(image: Image, n_halved: int) -> Image:
    """The green channel, which is faster than grey, halved `n_halved` times by 2x2 means, which
    prevent aliasing.
    """
    grey = image if image.ndim == 2 else _green(image)
    for _ in range(n_halved):
        grey = halved(grey)
    return grey


def _green(image: Image) -> Image:
    """The green channel: OpenCV splits the channels with vector instructions, in less than half of
    the time that it needs to extract one.
    """
    green, others = np.empty(image.shape[:2], np.uint8), np.empty((2, *image.shape[:2]), np.uint8)
    cv2.split(image, [others[0], green, others[1]])
    return green


def halved(image: Image) -> Image:
    """(H // 2, W // 2) means of 2x2 pixels; an odd last row or column is left out."""
    height, width = image.shape[0] // 2, image.shape[1] // 2
    even = image[: 2 * height, : 2 * width]
    return np.asarray(cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def masked_cells(xyxy_px: FloatArray, grey_hw: Sequence[int], n_halved: int) -> BoolArray:
    """(rows, columns) whether a box touches a cell of the small image; invalid boxes are ignored.

    The boxes (N, 4) are in pixels of the full image, which was halved `n_halved` times to the
    height and width `grey_hw`.
    """
    n_rows, n_columns = -(-grey_hw[0] // _CELL_PX), -(-grey_hw[1] // _CELL_PX)
    is_valid = np.isfinite(xyxy_px).all(axis=1) & (xyxy_px[:, 2:] > xyxy_px[:, :2]).all(axis=1)
    cells = (xyxy_px[is_valid] + 0.5) / (_CELL_PX << n_halved)
    cells = np.clip(cells, 0, [n_columns, n_rows, n_columns, n_rows])
    is_masked = np.zeros((n_rows, n_columns), np.bool_)
    for left, top, right, bottom in cells.tolist():
        is_masked[int(top) : math.ceil(bottom), int(left) : math.ceil(right)] = True
    return is_masked


def are_masked(points: FloatArray | FloatArray32, is_masked: BoolArray) -> BoolArray:
    """(N,) whether a point (N, 2) of the small image lies in a masked cell."""
    cells = (points / _CELL_PX).astype(np.int64)
    return np.asarray(is_masked[cells[:, 1], cells[:, 0]])


class RankedCorners(NamedTuple):
    """The best corner (N, 2) of each square of 16 px, by descending quality, which is 0 in masked
    cells.
    """

    points: FloatArray32
    quality: FloatArray32

    def n_good(self, n_corners: int, min_quality: float) -> int:
        """Number of the first corners, at most `n_corners`, whose quality is `min_quality` of the
        best or more.
        """
        best = float(self.quality[0]) if len(self.quality) else 0.0
        return int((self.quality[:n_corners] > max(min_quality * best, _MIN_EIGENVALUE)).sum())


def ranked_corners(grey: Image, is_masked: BoolArray) -> RankedCorners:
    """Corners outside masked cells, one per square of 16 px.

    They are detected at half size, because the tracked windows are large; a grid is faster than
    OpenCV's sorting. `grey` (H, W) is the small image, and `is_masked` its mask of `masked_cells`.
    """
    quality = cv2.cornerMinEigenVal(halved(grey), 3)
    n_rows, n_columns = quality.shape[0] // _GRID_PX, quality.shape[1] // _GRID_PX
    whole = quality[: n_rows * _GRID_PX, : n_columns * _GRID_PX].reshape(
        n_rows, _GRID_PX, n_columns, _GRID_PX
    )
    squares = whole.swapaxes(1, 2).reshape(-1, _GRID_PX**2)
    index = squares.argmax(axis=1)
    best = squares[np.arange(len(squares)), index]
    y, x = np.divmod(index, _GRID_PX)
    row, column = np.divmod(np.arange(len(squares)), n_columns)
    corners = 2 * np.stack([column * _GRID_PX + x, row * _GRID_PX + y], axis=1) + 0.5
    best[are_masked(corners, is_masked)] = 0.0
    order = np.argsort(-best, kind="stable")
    return RankedCorners(
        np.asarray(corners[order], np.float32), np.asarray(best[order], np.float32)
    )


def isotropy(grey: Image, points: FloatArray32) -> FloatArray32:
    """(N,) ratio of the smaller to the larger eigenvalue of the structure tensor at points (N, 2):
    0 on an edge.

    The flow along an edge is not determined by the image (the aperture problem). `grey` (H, W) is
    the small image, and the points are its `ranked_corners`.
    """
    slopes = cv2.spatialGradient(halved(grey))
    height, width = slopes[0].shape
    column, row = np.rint((points - 0.5) / 2).astype(np.int64).T
    reach = np.arange(_TENSOR_PX) - _TENSOR_PX // 2
    rows = np.abs(row[:, None] + reach)  # the image is mirrored at its edges
    columns = np.abs(column[:, None] + reach)
    rows, columns = (
        np.minimum(places, 2 * (size - 1) - places)
        for places, size in ((rows, height), (columns, width))
    )
    pixels = (rows[:, :, None] * width + columns[:, None]).reshape(-1, _TENSOR_PX**2)
    x, y = (slope.ravel()[pixels].astype(np.float32) for slope in slopes)
    xx, yy, xy = (np.einsum("ij,ij->i", a, b) / _TENSOR_PX**2 for a, b in ((x, x), (y, y), (x, y)))
    mean, difference = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    return np.asarray((mean - difference) / np.maximum(mean + difference, _MIN_TENSOR), np.float32)


def tracked_corners(
    before: Image,
    now: Image,
    corners: FloatArray32,
    *,
    window_px: int,
    n_levels: int,
    start: FloatArray32 | None = None,
) -> tuple[FloatArray32, BoolArray]:
    """Corners (N, 2) in another image by pyramidal Lucas-Kanade (Bouguet, 2000), and (N,) whether
    each was found.

    The search begins at the points `start` (N, 2), by default at the corners, with `n_levels` above
    the images.
    """
    if len(corners) == 0:
        return np.zeros((0, 2), np.float32), np.zeros(0, bool)
    flags = 0 if start is None else cv2.OPTFLOW_USE_INITIAL_FLOW
    guess = np.empty_like(corners) if start is None else start.copy()
    points, status, _ = cv2.calcOpticalFlowPyrLK(
        before,
        now,
        corners,
        guess,
        winSize=(window_px, window_px),
        maxLevel=n_levels,
        criteria=_STOP,
        flags=flags,
    )
    now_px = np.asarray(points, np.float32).reshape(-1, 2)
    height, width = now.shape
    is_inside = (
        (now_px >= 0).all(axis=1) & (now_px[:, 0] <= width - 1) & (now_px[:, 1] <= height - 1)
    )
    return now_px, np.asarray(is_inside & (status.reshape(-1) > 0))


@dataclass(frozen=True, slots=True)
class FlowFrame:
    """Images and corners of one frame."""

    time_s: float  # NaN = unknown
    image_hw: tuple[int, int]
    n_halved: int
    grey: Image  # (H, W) image of full size, `image_hw`
    small: Image  # (h, w) image, halved `n_halved` times
    is_masked: BoolArray  # cells of the small image with boxes of road users
    corners: RankedCorners  # those of the background
    # (N, 2) places at which the corners were detected, in this frame or an earlier one
    detected: FloatArray32


class BackgroundFlow:
    """Corners of the background, tracked from each frame of one stream to the next, for all
    estimators of its motion.

    The first estimator that adds a frame computes the small image and the corners. An estimator
    that uses fewer corners than another one uses the first of them; the first estimator that needs
    the flow of a frame computes it for all corners that any estimator needed in an earlier frame,
    since each call of Lucas-Kanade computes the pyramids of both images. An estimator that knows
    more may say where it expects corners in the next frame.

    In fast streams, corners are detected in some frames, and those that are tracked go on in the
    frames between: motions are measured from detection to detection, since shorter ones have
    larger errors per second.

    The small image is halved until neither side is longer than `long_side_px`.
    """

    def __init__(self, long_side_px: int = 640) -> None:
        self._long_side_px = long_side_px
        # the last frame; None = there is none, or it is too small
        self.now: FlowFrame | None = None
        # the frame before it; None = there is none of equal size
        self.before: FlowFrame | None = None
        self._last_s = math.nan
        self._points: FloatArray32 = np.zeros((0, 2), np.float32)
        self._is_tracked: BoolArray = np.zeros(0, np.bool_)
        self._needs: set[tuple[int, float]] = set()
        self.is_between = False  # whether the corners of the last frame are those of an earlier one
        # the last frame with new corners, and the last one before `now`; None = there is none of
        # equal size
        self._detection: FlowFrame | None = None
        self.detection_before: FlowFrame | None = None
        # (N, 2) places of the first corners of the last frame that are expected in the next one
        self._expected: FloatArray32 | None = None
        self._start: FloatArray32 | None = None  # where the search of all corners begins

    def add(
        self,
        image: Image,
        xyxy_px: FloatArray,
        time_s: float = math.nan,
        *,
        interval_s: float = DETECTION_INTERVAL_S,
    ) -> None:
        """Use an image, BGR or grey, as the last frame, unless the last frame has the same time;
        NaN = unknown.

        Boxes `xyxy_px` (N, 4) of road users are not background; invalid boxes are ignored. New
        corners are detected `interval_s` after the last ones, or later.
        """
        if time_s == self._last_s:
            return
        self._last_s = time_s
        before, self.before, self.now = self.now, None, None
        self.detection_before, self.is_between = None, False
        expected, self._expected, self._start = self._expected, None, None
        self._points, self._is_tracked = np.zeros((0, 2), np.float32), np.zeros(0, np.bool_)
        image_hw = image.shape[0], image.shape[1]
        n_halved = self.n_halvings(image_hw)
        if min(image_hw) >> n_halved < _MIN_SIDE_PX:
            return
        grey = small_grey(image, 0)
        small = small_grey(grey, n_halved)
        is_masked = masked_cells(xyxy_px, small.shape, n_halved)
        if before is not None and before.image_hw == image_hw:
            self.before = before
            if expected is not None:
                self._start = before.corners.points.copy()
                is_known = np.isfinite(expected).all(axis=1)
                self._start[: len(expected)][is_known] = expected[is_known]
            self._follow(small, is_masked)
        kept = None
        if self.before is None:
            self._detection = None
        if self._detection is not None and time_s - self._detection.time_s < interval_s:
            kept = self._kept_corners()
        self.detection_before = self._detection
        if kept is not None and self.before is not None:
            corners, detected = kept
            moved = self._points - self.before.corners.points[: len(self._points)]
            self._expected = corners.points + moved[self._is_tracked]  # as they moved before
        else:
            corners = ranked_corners(small, is_masked)
            detected = corners.points
        self.now = FlowFrame(time_s, image_hw, n_halved, grey, small, is_masked, corners, detected)
        self.is_between = kept is not None
        if not self.is_between:
            self._detection = self.now

    def _kept_corners(self) -> tuple[RankedCorners, FloatArray32] | None:
        """The corners of the frame before at their places in the last frame, and the places (N, 2)
        at which they were detected; None = others are to be detected.
        """
        n_tracked, n = np.count_nonzero(self._is_tracked), len(self._points)
        if self.before is None or not n_tracked or n_tracked < _MIN_KEPT * n:
            return None
        quality = self.before.corners.quality[:n][self._is_tracked]
        corners = RankedCorners(self._points[self._is_tracked], quality)
        return corners, self.before.detected[:n][self._is_tracked]

    def since_detection(
        self, n_corners: int, min_quality: float
    ) -> tuple[FloatArray32, FloatArray32]:
        """(N, 2) places of corners as of `tracked` in the last frame and in the frame before it in
        which they were detected, `detection_before`.
        """
        points, is_tracked = self.followed(n_corners, min_quality)
        if self.before is None:
            return points, points
        return self.before.detected[: len(points)][is_tracked], points[is_tracked]

    def _follow(self, small: Image, is_masked: BoolArray) -> None:
        """Track the corners of the frame before that estimators need, which are not tracked yet."""
        before, n_tracked = self.before, len(self._points)
        if before is None:
            return
        n_needed = max((before.corners.n_good(*need) for need in self._needs), default=0)
        if n_needed <= n_tracked:
            return
        new = slice(n_tracked, n_needed)
        points, is_tracked = tracked_corners(
            before.small,
            small,
            before.corners.points[new],
            window_px=_WINDOW_PX,
            n_levels=_N_LEVELS if self._start is None else _N_LEVELS_EXPECTED,
            start=None if self._start is None else self._start[new],
        )
        is_tracked[is_tracked] = ~are_masked(points[is_tracked], is_masked)
        self._points = np.concatenate([self._points, points])
        self._is_tracked = np.concatenate([self._is_tracked, is_tracked])

    def expect(self, points: FloatArray32) -> None:
        """Begin the search of the first corners of the last frame at points (N, 2) of the next
        frame, NaN = unknown, so that corners that an expected motion moves far are found.
        """
        self._expected = points

    def n_halvings(self, image_hw: tuple[int, int]) -> int:
        """Number of halvings of the small image of an image of this size."""
        return (max(image_hw) // (self._long_side_px + 1)).bit_length()

    def tracked(self, n_corners: int, min_quality: float) -> tuple[FloatArray32, FloatArray32]:
        """(N, 2) places in both frames of at most `n_corners` corners, of `min_quality` relative to
        the best.
        """
        points, is_tracked = self.followed(n_corners, min_quality)
        if self.before is None:
            return points, points
        return self.before.corners.points[: len(points)][is_tracked], points[is_tracked]

    def followed(self, n_corners: int, min_quality: float) -> tuple[FloatArray32, BoolArray]:
        """(N, 2) places in the last frame of the first corners of the frame before it, at most
        `n_corners` and of `min_quality` relative to the best, and (N,) whether they were found
        outside of the boxes.
        """
        if self.now is None or self.before is None:
            return np.zeros((0, 2), np.float32), np.zeros(0, np.bool_)
        n_good = self.before.corners.n_good(n_corners, min_quality)
        self._needs.add((n_corners, min_quality))
        self._follow(self.now.small, self.now.is_masked)
        return self._points[:n_good], self._is_tracked[:n_good]
