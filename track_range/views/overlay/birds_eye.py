r"""BirdsEye: inset with a bird's-eye view of the road, to scale: positions of the tracks and their
uncertainty.

+---------+   Forward (z) is up, x is to the right, both at the same scale; horizontal lines mark
| --- 40  |   distances. A track is the footprint of its cuboid (a dot if that is smaller) in its colour,
|   |o    |   with a white edge at a known front and a bar of one sigma in both directions along its
| --|- 20 |   ray; hollow = predicted; a border in amber or red = imminent collision. The range is one
|  \./    |   of `RANGES_M`: it grows immediately when a track is farther, and shrinks when no track has
+---------+   been so far away for some seconds.

The inset is in the corner where it covers the fewest road users, and moves at most once per second;
parts of road users under the inset stay visible.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.pipeline.colours import BLACK, GREY, WHITE, track_colour, warning_colour
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.world.cuboid_corners import cuboid_corners
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.views.overlay.labels import shared_areas, text_sizes_px

Point = Sequence[int]
RANGES_M = (30.0, 60.0, 90.0, 120.0)  # possible ranges of the inset in metres
_SHRINK_DELAY_S = 3.0  # seconds for which all tracks must be nearer before the range shrinks
# largest height and width of the inset as fractions of the image's
_HEIGHT_FRACTION, _WIDTH_FRACTION = 0.42, 0.3
_ASPECT = 0.8  # width / height of the inset
_EGO_MARGIN = 0.06  # fraction of the inset's height that is below the camera
_N_LINES = 3  # marked distances
_MOVE_INTERVAL_S = 1.0  # shortest time between two moves of the inset
_MOVE_FRACTION = 0.02  # smallest fraction of the inset that a move makes free
# (4, 2) right and lower corners as 1, the preferred ones first
_CORNERS = np.array([(0, 1), (1, 1), (0, 0), (1, 0)])
_FAINT = (95, 95, 95)  # BGR colour of the grid


@dataclass(slots=True)
class Scale:
    """Range of the inset in metres, over time."""

    range_m: float = RANGES_M[0]
    _needed_s: float = -np.inf

    def update(self, farthest_m: float, time_s: float) -> None:
        """Update with the farthest track of a frame in metres (0 = no track); times must
        increase.
        """
        needed_m = RANGES_M[min(bisect_left(RANGES_M, farthest_m), len(RANGES_M) - 1)]
        if needed_m >= self.range_m:
            self._needed_s = time_s
            self.range_m = needed_m
        elif time_s - self._needed_s > _SHRINK_DELAY_S:
            self.range_m = needed_m


class BirdsEye:
    """Draws the insets of one video; predicted tracks and the field of view need the camera of the
    images.
    """

    def __init__(self, camera: PinholeCamera | None = None) -> None:
        self.camera = camera
        self._scale = Scale()
        # index of `_CORNERS`, and the time of the latest move
        self._corner, self._moved_s = 0, -np.inf
        self._font = cv2.FontFace("sans")
        self._grids: dict[tuple[int, int, float], Image] = {}

    def place(self, image_px: tuple[int, int]) -> FloatArray:
        """(4,) rectangle of the inset in an image (W, H) in its present corner; empty if the image
        is too small.
        """
        return np.asarray(_places(image_px)[self._corner], np.float64)

    def _move(self, image_px: tuple[int, int], boxes: FloatArray, time_s: float) -> None:
        """Choose the corner where the inset covers the smallest area of the boxes, if that is worth
        a move.
        """
        places = _places(image_px)
        area_px2 = float(np.prod(places[0, 2:] - places[0, :2]))
        covered_px2 = shared_areas(places, boxes)
        best = int(np.argmin(covered_px2))
        is_worth = covered_px2[self._corner] - covered_px2[best] > _MOVE_FRACTION * area_px2
        if is_worth and time_s - self._moved_s >= _MOVE_INTERVAL_S:
            self._corner, self._moved_s = best, time_s

    def draw(self, canvas: Image, result: FrameResult, boxes: FloatArray | None = None) -> None:
        """Draw the inset of one frame; `boxes` (N, 4) are boxes in the image, None = the tracks'
        boxes.
        """
        image_px = (canvas.shape[1], canvas.shape[0])
        boxes = result.tracks.xyxy_px if boxes is None else boxes
        boxes = boxes[np.isfinite(boxes).all(axis=1)]
        self._move(image_px, boxes, result.frame.time_s)
        left, top, right, bottom = self.place(image_px).astype(int).tolist()
        ground_m = self.ground_m(result)
        known = np.isfinite(ground_m).all(axis=1) & (ground_m[:, 1] > 0)
        self._scale.update(float(ground_m[known, 1].max(initial=0.0)), result.frame.time_s)
        inset = canvas[top:bottom, left:right]
        if not inset.size:
            return
        before = inset.copy()
        np.right_shift(inset, 2, out=inset)
        cv2.max(inset, self._grid((bottom - top, right - left)), dst=inset)
        far_first = np.flatnonzero(known)[np.argsort(-ground_m[known, 1])]
        x_m, z_m, sigma_m = ground_m[far_first].T
        bar = np.stack([np.ones_like(z_m), 1 - sigma_m / z_m, 1 + sigma_m / z_m], axis=1)
        marks = self._points(x_m[:, None] * bar, z_m[:, None] * bar, (bottom - top, right - left))
        # of unknown ones (4, 2) zeros
        corners_m = np.nan_to_num(cuboid_corners(result.cuboids)[far_first, :4])
        shapes = self._points(corners_m[..., 0], corners_m[..., 2], (bottom - top, right - left))
        for row, (centre, *ends), shape in zip(
            far_first.tolist(), marks.tolist(), shapes, strict=True
        ):
            self._draw_track(inset, result, row, centre=centre, bar=ends, shape=shape)
        outside_px = text_sizes_px(image_px)[2] + 1  # of the line of a box
        covered = np.clip(
            boxes + outside_px * np.array([-1, -1, 2, 2]) - [left, top, left, top],
            0,
            2 * max(inset.shape),
        )
        for x1, y1, x2, y2 in np.rint(covered).astype(int).tolist():
            inset[y1:y2, x1:x2] = before[y1:y2, x1:x2]

    def ground_m(self, result: FrameResult) -> FloatArray:
        """(N, 3) x, z and sigma of z of each track in metres, from the fused or filtered distance;
        NaN = unknown.
        """
        n = len(result.tracks)
        ground_m = np.full((n, 3), np.nan)
        ground_m[:, :2] = result.xyz_m[:, ::2]
        if "fused" in result.ranges:
            ground_m[:, 2] = result.ranges["fused"].sigma_m
        if self.camera is not None and "fused_kf" in result.ranges:
            filtered = result.ranges["fused_kf"]
            centre_px = (result.tracks.xyxy_px[:, :2] + result.tracks.xyxy_px[:, 2:]) / 2
            predicted_m = self.camera.rays(centre_px)[:, ::2] * filtered.distance_m[:, None]
            fallback_m = np.hstack([predicted_m, filtered.sigma_m[:, None]])
            ground_m = np.where(
                np.isfinite(ground_m).all(axis=1, keepdims=True), ground_m, fallback_m
            )
        return ground_m

    def _grid(self, hw: tuple[int, int]) -> Image:
        """Background of the tracks on black, cached by size and range; not to be changed."""
        range_m = self._scale.range_m
        if (*hw, range_m) in self._grids:
            return self._grids[*hw, range_m]
        grid = self._grids[*hw, range_m] = np.zeros((*hw, 3), np.uint8)
        size_px, camera = max(9, hw[0] // 18), self.camera
        # x / z of the camera, and of the left and the right edge of its field of view
        slopes = [0.0]
        if camera is not None:
            slopes += [
                (u_px - camera.cx_px) / camera.fx_px for u_px in (0.0, camera.width_px - 1.0)
            ]
        far_m = np.array([0.0, 2 * range_m, 2 * range_m])[: len(slopes)]
        ego, *far_ends = self._points(far_m * np.array(slopes), far_m, hw).tolist()
        for end in far_ends:
            cv2.line(grid, ego, end, _FAINT, 1, cv2.LINE_AA)
        for number in range(1, _N_LINES + 1):
            z_m = range_m * number / _N_LINES
            y = int(self._points(np.zeros(1), np.array([z_m]), hw)[0, 1])
            cv2.line(grid, (0, y), (hw[1], y), _FAINT, 1)
            text = f"{z_m:.0f} m" if number == _N_LINES else f"{z_m:.0f}"
            cv2.putText(grid, text, (3, y + size_px), GREY, self._font, size_px, 450)
        half = max(2, hw[0] // 60)
        base_y = ego[1] + 2 * half
        cv2.fillConvexPoly(
            grid, np.array([(ego[0] - half, base_y), (ego[0] + half, base_y), ego]), WHITE
        )
        cv2.rectangle(grid, (0, 0), (hw[1] - 1, hw[0] - 1), _FAINT, 1)
        return grid

    def _draw_track(
        self,
        inset: Image,
        result: FrameResult,
        row: int,
        *,
        centre: Point,
        bar: Sequence[Point],
        shape: IntArray,
    ) -> None:
        """Draw a track at `centre`, with the ends of its bar and the corners (4, 2) of its cuboid,
        from the front on the left.
        """
        colour, radius = (
            track_colour(int(result.tracks.track_id[row])),
            max(2, round(inset.shape[0] / 60)),
        )
        border = warning_colour(result, row) or BLACK
        is_observed = bool(result.tracks.observed[row])
        if np.ptp(shape, axis=0).max() > 3 * radius:
            cv2.polylines(inset, [shape], True, border, radius, cv2.LINE_AA)
            cv2.fillConvexPoly(inset, shape, colour if is_observed else BLACK, cv2.LINE_AA)
            cv2.polylines(inset, [shape], True, colour, 1, cv2.LINE_AA)
            if result.cuboids.front_known[row]:
                cv2.line(inset, shape[0], shape[1], WHITE, 1, cv2.LINE_AA)
        else:
            cv2.circle(inset, centre, radius + 2, border, -1, cv2.LINE_AA)
            if not is_observed:
                cv2.circle(inset, centre, radius, BLACK, -1, cv2.LINE_AA)
            cv2.circle(inset, centre, radius, colour, -1 if is_observed else 1, cv2.LINE_AA)
        cv2.line(inset, bar[0], bar[1], colour, max(1, radius // 3), cv2.LINE_AA)

    def _points(self, x_m: FloatArray, z_m: FloatArray, inset_hw: tuple[int, int]) -> IntArray:
        """(..., 2) pixels in an inset (H, W) of points; clipped far outside, as drawing takes
        16-bit pixels.
        """
        height, width = inset_hw
        px_per_m, limit = (1 - _EGO_MARGIN) * height / self._scale.range_m, 5.0 * max(inset_hw)
        pixels = np.stack(
            [width / 2 + x_m * px_per_m, (1 - _EGO_MARGIN) * height - z_m * px_per_m], axis=-1
        )
        return np.rint(np.clip(pixels, -limit, limit)).astype(np.int32)


@cache  # of few sizes of images
def _places(image_px: tuple[int, int]) -> FloatArray:
    """(4, 4) rectangles of the inset in the `_CORNERS` of an image (W, H); the upper two are below
    a line of text.
    """
    width, height = image_px
    inset_px = min(_HEIGHT_FRACTION * height, _WIDTH_FRACTION * width / _ASPECT)
    size_px = np.round(np.array([_ASPECT, 1.0]) * (round(inset_px) if inset_px >= 60 else 0))
    text_px = text_sizes_px(image_px)[1] * 5 // 4 + 2
    corner = _CORNERS * (np.array(image_px) - size_px) + (1 - _CORNERS) * np.array([0, text_px])
    return np.hstack([corner, corner + size_px])
