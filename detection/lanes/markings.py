"""Markings: pixels on painted lines, and proposals of straight lines through them.

Networks that distinguish lines number their pixels, and each number gives one proposal. Otherwise
lines are proposed by a Hough transform, which bridges the gaps of dashed lines. A proposal is x = a
+ b y with a support from 0 to 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, check_shape

_CANVAS_WIDTH_PX = 480  # of the Hough transform: small to save time, large enough to separate lines
_MIN_VOTES = 6  # of a line in the Hough transform
_MAX_HOUGH_LINES, _MAX_PROPOSALS = 400, 40  # lines of the Hough transform, and proposals
_MIN_DISTANCE = 0.015  # of two proposals in a near or a middle row, in image widths
_MAX_SLOPE = 3.5  # |dx/dy| of a proposal; lines of the ego lane have up to 2.5
_TOLERANCE = 0.006  # distance of a pixel from the straight line that it supports, in image widths
_MIN_POINTS = 4  # pixels of a numbered line


@dataclass(frozen=True, slots=True)
class Markings:
    """Pixels on lines in one image."""

    xy_px: FloatArray  # (N, 2) pixels, at most one per line and row
    line: IntArray  # (N,) line number of each pixel, -1 = unknown
    sigma_px: float  # standard deviation of a pixel's x

    def __post_init__(self) -> None:
        check_shape("xy_px", self.xy_px, (None, 2))
        check_shape("line", self.line, (len(self.xy_px),))

    @classmethod
    def unnumbered(cls, xy_px: FloatArray, sigma_px: float) -> Markings:
        """Pixels (N, 2) without line numbers."""
        return cls(xy_px, np.full(len(xy_px), -1, np.int64), sigma_px)

    def outside(self, xyxy_px: FloatArray) -> Markings:
        """The pixels outside of the boxes (M, 4): what is on an object is not on the road."""
        x, y = self.xy_px.T[:, None]
        x1, y1, x2, y2 = xyxy_px.T[:, :, None]
        is_hidden = ((x >= x1) & (x <= x2) & (y >= y1) & (y <= y2)).any(axis=0)
        return Markings(self.xy_px[~is_hidden], self.line[~is_hidden], self.sigma_px)


@dataclass(frozen=True, slots=True)
class Proposals:
    """K straight lines x = a + b y."""

    constant: FloatArray  # (K,) a in pixels
    slope: FloatArray  # (K,) b
    # (K,) square root of the number of pixels on the line relative to the best line, 0..1
    support: FloatArray
    line: IntArray  # (K,) line number of the markings; -1 = unknown

    def __len__(self) -> int:
        return len(self.support)


def proposals(markings: Markings, image_hw: tuple[int, int]) -> Proposals:
    """Straight lines through the markings of an image, (height, width) `image_hw`; K may be 0."""
    is_numbered = bool((markings.line >= 0).any())
    constant, slope, line = (
        _numbered_lines(markings) if is_numbered else _hough_lines(markings.xy_px, image_hw)
    )
    if not len(line):
        return Proposals(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0, np.int64))
    x, y = markings.xy_px.T
    # The distance is perpendicular to the line, so that flat lines at the side are not at a
    # disadvantage.
    distance_px = np.abs(x - constant[:, None] - slope[:, None] * y) / np.hypot(1.0, slope)[:, None]
    # numbered lines: pixels with their number
    is_candidate = (line[:, None] < 0) | (line[:, None] == markings.line)
    n_pixels = (is_candidate & (distance_px < _TOLERANCE * image_hw[1])).sum(axis=1)
    return Proposals(constant, slope, np.sqrt(n_pixels / max(float(n_pixels.max()), 1.0)), line)


def run_middles(is_marked: BoolArray, *, widest_px: float = np.inf) -> tuple[IntArray, FloatArray]:
    """Row and centre column of each run of marked pixels in a mask (h, w), without runs wider than
    `widest_px`.
    """
    padded = np.zeros((len(is_marked), is_marked.shape[1] + 2), np.bool_)
    padded[:, 1:-1] = is_marked
    flat = padded.ravel()
    ends = np.flatnonzero(flat[1:] != flat[:-1])  # where runs begin and end, in turn
    row, first = np.divmod(ends[::2], padded.shape[1])
    n_more = ends[1::2] - ends[::2] - 1
    is_narrow = n_more < widest_px
    return row[is_narrow], (first + n_more / 2)[is_narrow]


def _numbered_lines(markings: Markings) -> tuple[FloatArray, FloatArray, IntArray]:
    rows = []
    for number in np.unique(markings.line):
        x, y = markings.xy_px[markings.line == number].T
        near = y >= np.median(y)
        if near.sum() >= _MIN_POINTS and np.ptp(y[near]) > 0:
            slope, constant = np.polyfit(y[near], x[near], 1)
            rows.append((constant, slope, number))
    table = np.array(rows, np.float64).reshape(-1, 3)
    return table[:, 0], table[:, 1], table[:, 2].astype(np.int64)


def _hough_lines(
    xy_px: FloatArray, image_hw: tuple[int, int]
) -> tuple[FloatArray, FloatArray, IntArray]:
    scale = _CANVAS_WIDTH_PX / image_hw[1]
    canvas = np.zeros((round(image_hw[0] * scale) + 1, _CANVAS_WIDTH_PX + 1), np.uint8)
    x, y = np.rint(xy_px.T * scale).astype(np.int64)
    canvas[np.clip(y, 0, canvas.shape[0] - 1), np.clip(x, 0, _CANVAS_WIDTH_PX)] = 1
    detected = cv2.HoughLines(canvas, 1.0, np.pi / 180, _MIN_VOTES)
    lines = (
        np.zeros((0, 2))
        if detected is None
        else np.asarray(detected, np.float64).reshape(-1, detected.shape[-1])
    )
    rho, theta = lines.T[:2]
    steep = np.abs(np.tan(theta)) < _MAX_SLOPE
    rho, theta = rho[steep][:_MAX_HOUGH_LINES], theta[steep][:_MAX_HOUGH_LINES]
    constant, slope = rho / np.cos(theta) / scale, -np.tan(theta)
    x_px = constant[:, None] + slope[:, None] * np.array([0.95, 0.7]) * image_hw[0]
    kept = _strongest(x_px, _MIN_DISTANCE * image_hw[1])
    return constant[kept], slope[kept], np.full(len(kept), -1, np.int64)


def _strongest(x_px: FloatArray, min_distance_px: float) -> IntArray:
    """Indices of the lines, given by x in two rows (L, 2) and strongest first, that are not close
    to a stronger one.
    """
    kept: list[int] = []
    is_left = np.ones(len(x_px), np.bool_)
    while is_left.any() and len(kept) < _MAX_PROPOSALS:
        best = int(is_left.argmax())
        kept.append(best)
        is_left &= np.abs(x_px - x_px[best]).max(axis=1) > min_distance_px
    return np.array(kept, np.int64)
