"""Markings: pixels that are taken for painted lines, and the straight lines that may run through them.

A network that tells lines apart numbers its pixels; of others, straight lines are proposed by a Hough transform, which
bridges the gaps of dashed lines. Either way a proposal is x = a + b y, and its support the share of rows it explains.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, check_shape

_CANVAS_WIDTH_PX = (
    480  # the Hough transform's picture: its cost grows with the votes, and paint is wider than its pixel
)
_MIN_VOTES = 6
_MAX_VOTED, _MAX_PROPOSALS = 400, 40
_APART = 0.015  # of the image's width: proposals that are nearer in both a near and a middle row are one line
_MAX_SLOPE = 3.5  # |dx/dy|; a line of the own lane has up to 2.5, flatter ones are of other lanes, and of houses
_TOLERANCE = 0.006  # of the image's width, that a straight proposal may miss its pixels by
_MIN_POINTS = 4


@dataclass(frozen=True, slots=True)
class Markings:
    """What one finder saw in one image.

    Attributes:
        xy_px: (N, 2) pixels on lines, at most one per line and row.
        line: (N,) number of the line that each belongs to, -1 = not told.
        sigma_px: standard deviation of one pixel's x.
    """

    xy_px: FloatArray
    line: IntArray
    sigma_px: float

    def __post_init__(self) -> None:
        check_shape("xy_px", self.xy_px, (None, 2))
        check_shape("line", self.line, (len(self.xy_px),))

    @classmethod
    def unnumbered(cls, xy_px: FloatArray, sigma_px: float) -> Markings:
        """Pixels of nobody knows which lines."""
        return cls(xy_px, np.full(len(xy_px), -1, np.int64), sigma_px)


@dataclass(frozen=True, slots=True)
class Proposals:
    """Straight lines x = a + b y.

    Attributes:
        constant: (K,) a, px.
        slope: (K,) b.
        support: (K,) 0..1, square root of the pixels that each explains, of those of the best: dashes count.
        line: (K,) the number that the finder gave it; -1 = none.
    """

    constant: FloatArray
    slope: FloatArray
    support: FloatArray
    line: IntArray

    def __len__(self) -> int:
        return len(self.support)


def proposals(markings: Markings, image_hw: tuple[int, int]) -> Proposals:
    """The straight lines that markings may be on; K may be 0."""
    numbered = markings.line >= 0
    lines = _numbered_lines(markings) if numbered.any() else _hough_lines(markings.xy_px, image_hw)
    constant, slope, line = lines
    if not len(line):
        return Proposals(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0, np.int64))
    support = _support(markings, lines, tolerance_px=_TOLERANCE * image_hw[1])
    return Proposals(constant, slope, np.sqrt(support / max(float(support.max()), 1.0)), line)


def run_middles(is_marked: BoolArray, *, widest_px: float = np.inf) -> tuple[IntArray, FloatArray]:
    """Row and middle column of each run of marked pixels (h, w), but of those wider than `widest_px`."""
    padded = np.zeros((len(is_marked), is_marked.shape[1] + 2), np.int8)
    padded[:, 1:-1] = is_marked
    step = np.diff(padded, axis=1)
    row, first = np.nonzero(step == 1)
    last = np.nonzero(step == -1)[1] - 1
    narrow = last - first < widest_px
    return row[narrow].astype(np.int64), ((first + last) / 2)[narrow]


def _numbered_lines(markings: Markings) -> tuple[FloatArray, FloatArray, IntArray]:
    """Straight lines through the nearer half of each numbered line's pixels."""
    found = []
    for number in np.unique(markings.line):
        x, y = markings.xy_px[markings.line == number].T
        near = y >= np.median(y)
        if near.sum() >= _MIN_POINTS and np.ptp(y[near]) > 0:
            slope, constant = np.polyfit(y[near], x[near], 1)
            found.append((constant, slope, number))
    table = np.array(found, np.float64).reshape(-1, 3)
    return table[:, 0], table[:, 1], table[:, 2].astype(np.int64)


def _hough_lines(xy_px: FloatArray, image_hw: tuple[int, int]) -> tuple[FloatArray, FloatArray, IntArray]:
    """The strongest straight lines through pixels."""
    scale = _CANVAS_WIDTH_PX / image_hw[1]
    canvas = np.zeros((round(image_hw[0] * scale) + 1, _CANVAS_WIDTH_PX + 1), np.uint8)
    x, y = np.rint(xy_px.T * scale).astype(np.int64)
    canvas[np.clip(y, 0, canvas.shape[0] - 1), np.clip(x, 0, _CANVAS_WIDTH_PX)] = 1
    found = cv2.HoughLines(canvas, 1.0, np.pi / 180, _MIN_VOTES)
    rho, theta = (
        np.zeros((0, 2)).T if found is None else np.asarray(found, np.float64).reshape(-1, found.shape[-1]).T[:2]
    )
    steep = np.abs(np.tan(theta)) < _MAX_SLOPE
    rho, theta = rho[steep][:_MAX_VOTED], theta[steep][:_MAX_VOTED]
    constant, slope = rho / np.cos(theta) / scale, -np.tan(theta)
    kept = _strongest(constant[:, None] + slope[:, None] * np.array([0.95, 0.7]) * image_hw[0], _APART * image_hw[1])
    return constant[kept], slope[kept], np.full(len(kept), -1, np.int64)


def _strongest(x_px: FloatArray, apart_px: float) -> IntArray:
    """Indices of the lines (L, 2), strongest first, that are not a neighbour of a stronger one."""
    kept: list[int] = []
    left = np.ones(len(x_px), np.bool_)
    while left.any() and len(kept) < _MAX_PROPOSALS:
        best = int(left.argmax())
        kept.append(best)
        left &= np.abs(x_px - x_px[best]).max(axis=1) > apart_px
    return np.array(kept, np.int64)


def _support(markings: Markings, lines: tuple[FloatArray, FloatArray, IntArray], *, tolerance_px: float) -> FloatArray:
    """(K,) pixels that each line explains; of numbered lines, their own alone."""
    constant, slope, line = lines
    x, y = markings.xy_px.T
    # Across the line, not along the row: a flat line far to the side is as well defined as a steep one.
    miss_px = np.abs(x - constant[:, None] - slope[:, None] * y) / np.hypot(1.0, slope)[:, None]
    mine = (line[:, None] < 0) | (line[:, None] == markings.line)
    return np.asarray((mine & (miss_px < tolerance_px)).sum(axis=1), np.float64)
