"""CornerTracks: corners of the static scene, tracked through the images of one camera.

Images wider than `LONG_SIDE_PX` are halved. Images are used that are at least `MIN_STEP_S` apart,
since every step adds an error to the tracks. One is a keyframe if the image has moved since the
last keyframe; new corners are found in keyframes, outside the boxes of road users.
"""

import math
from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32, Image, IntArray
from track_range.foundation.corner_flow import checked_flow, new_corners
from track_range.foundation.sparse_flow import halved
from track_range.stereo.geometry.frames import grey

LONG_SIDE_PX = 1300  # longest side of the tracked image
MIN_STEP_S = 0.19  # shortest time between two used images
MAX_GAP_S = 0.5  # longest time between two frames of one track
_MIN_KEY_FLOW_PX = 0.7  # median flow since the last keyframe; a standing camera has no new one
_N_POINTS = 250  # number of tracked points
_MIN_MISSING = 0.1  # of them; fewer are not replaced
_GRID = (4, 8)  # rows and columns of cells with equal numbers of new points
_MIN_GAP_PX = 12  # minimum distance between two points, px
# pyramid levels above the image, and those of the way back of the check
_LEVELS, _RETURN_LEVELS = 4, 1
_BOX_MARGIN_PX = 4.0  # around the boxes of road users


class KeyPoints(NamedTuple):
    """The tracked points of a keyframe."""

    time_s: float
    number: IntArray  # (N,) numbers of the points, equal in all keyframes
    xy_px: FloatArray  # (N, 2) in the tracked image


class CornerTracks:
    """Tracks corners from image to image."""

    def __init__(self, size_px: tuple[int, int]) -> None:
        self.n_halved = (max(size_px) // (LONG_SIDE_PX + 1)).bit_length()
        self._before: Image | None = None
        self._last_s = -math.inf
        self._xy_px: FloatArray32 = np.zeros((0, 2), np.float32)
        self._key_px: FloatArray32 = np.zeros((0, 2), np.float32)  # the same points in the keyframe
        self._number: IntArray = np.zeros(0, np.int64)
        self._next_number = 0

    def add(self, image: Image, time_s: float, xyxy_px: FloatArray) -> KeyPoints | None:
        """Track the points into an image, (H, W) grey or (H, W, 3) BGR; the points of a keyframe,
        None for other frames.

        Points in the boxes `xyxy_px` (N, 4) of road users are lost.
        """
        step_s = time_s - self._last_s
        if 0.0 <= step_s < MIN_STEP_S:
            return None
        if not 0.0 <= step_s <= MAX_GAP_S:
            self._retain(np.zeros(len(self._number), np.bool_))
        self._last_s = time_s
        small = grey(image)
        for _ in range(self.n_halved):
            small = halved(small)
        if self._before is not None and len(self._number):
            self._xy_px, is_tracked = checked_flow(
                self._before, small, self._xy_px, self._xy_px, _LEVELS, _RETURN_LEVELS
            )
            self._retain(is_tracked)
        self._before = small
        is_free = _outside(small.shape, xyxy_px / 2**self.n_halved)
        column, row = np.rint(self._xy_px).astype(np.int64).T
        self._retain(is_free[row, column])
        return self._key_points(small, time_s, is_free)

    def _key_points(self, small: Image, time_s: float, is_free: BoolArray) -> KeyPoints | None:
        flow_px = np.linalg.norm(self._xy_px - self._key_px, axis=1)
        if len(flow_px) and np.median(flow_px) < _MIN_KEY_FLOW_PX:
            return None
        n_missing = _N_POINTS - len(self._number)
        if n_missing > _MIN_MISSING * _N_POINTS:
            new = new_corners(
                small, self._xy_px, n_missing, grid=_GRID, min_gap_px=_MIN_GAP_PX, is_free=is_free
            )
            self._xy_px = np.concatenate([self._xy_px, new])
            self._number = np.concatenate([self._number, self._next_number + np.arange(len(new))])
            self._next_number += len(new)
        self._key_px = self._xy_px
        return KeyPoints(time_s, self._number, self._xy_px.astype(np.float64))

    def _retain(self, is_kept: BoolArray) -> None:
        self._xy_px, self._key_px = self._xy_px[is_kept], self._key_px[is_kept]
        self._number = self._number[is_kept]


def _outside(shape_px: tuple[int, ...], xyxy_px: FloatArray) -> BoolArray:
    """(H, W) pixels outside the boxes (N, 4) and a margin; invalid boxes are ignored."""
    is_free = np.ones(shape_px, np.bool_)
    valid = xyxy_px[np.isfinite(xyxy_px).all(axis=1)]
    edges = np.rint(valid + np.array([-1, -1, 1, 1]) * _BOX_MARGIN_PX).astype(np.int64)
    for left, top, right, bottom in np.maximum(edges, 0).tolist():
        is_free[top : bottom + 1, left : right + 1] = False
    return is_free
