r"""BirdsEye: an inset that shows the road from above, to scale: where each track is, and how sure that is.

+---------+   Up is forward (z), right is right (x), one scale for both; lines across are equal distances. A track is
| --- 40  |   a dot in its colour with a bar of one sigma to either side along its ray; hollow = predicted, a ring in
|   |o    |   amber or red = a collision is near. The scale is one of `RANGES_M`: it grows at once when a track is
| --|- 20 |   farther, and shrinks when none has been for a while.
|  \./    |
+---------+
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, Image
from track_range.overlay.colours import BLACK, GREY, WHITE, alarm_colour, track_colour
from track_range.run.frame_result import FrameResult
from track_range.stereo.geometry.camera import PinholeCamera

Point = tuple[int, int]

RANGES_M = (30.0, 60.0, 90.0, 120.0)
"""How far the inset may show."""

_CALM_S = 3.0  # so long must all tracks be nearer before the scale changes
_HEIGHT_SHARE, _WIDTH_SHARE = 0.42, 0.3  # of the image, at most
_ASPECT = 0.8  # width / height
_EGO_ROOM = 0.06  # of the height, below the camera
_N_LINES = 3  # distances marked
_FAINT = (95, 95, 95)


@dataclass(slots=True)
class Scale:
    """How far the inset shows, in metres, at each time."""

    range_m: float = RANGES_M[0]
    _needed_s: float = -np.inf

    def update(self, farthest_m: float, time_s: float) -> None:
        """Take the farthest track of a frame, 0 = there is none; times increase."""
        wanted_m = next((far_m for far_m in RANGES_M if farthest_m <= far_m), RANGES_M[-1])
        if wanted_m >= self.range_m:
            self._needed_s = time_s
            self.range_m = wanted_m
        elif time_s - self._needed_s > _CALM_S:
            self.range_m = wanted_m


class BirdsEye:
    """Draws the insets of one video.

    Attributes:
        camera: of the images; predicted tracks and its field of view need it, None = these are left out.
    """

    def __init__(self, camera: PinholeCamera | None = None) -> None:
        """Begin a video."""
        self.camera = camera
        self._scale = Scale()
        self._font = cv2.FontFace("sans")
        self._grids: dict[tuple[int, int, float], Image] = {}

    def place(self, image_px: tuple[int, int]) -> FloatArray:
        """(4,) where the inset stands in an image (W, H): at the lower left; empty in an image too small for one."""
        width, height = image_px
        tall = min(_HEIGHT_SHARE * height, _WIDTH_SHARE * width / _ASPECT)
        tall = round(tall) if tall >= 60 else 0
        return np.array([0, height - tall, round(_ASPECT * tall), height], np.float64)

    def draw(self, canvas: Image, result: FrameResult) -> None:
        """Draw the inset of one frame."""
        left, top, right, bottom = self.place((canvas.shape[1], canvas.shape[0])).astype(int).tolist()
        ground_m = self.ground_m(result)
        known = np.isfinite(ground_m).all(axis=1) & (ground_m[:, 1] > 0)
        self._scale.update(float(ground_m[known, 1].max(initial=0.0)), result.frame.time_s)
        inset = canvas[top:bottom, left:right]
        if not inset.size:
            return
        np.right_shift(inset, 2, out=inset)
        cv2.max(inset, self._grid((bottom - top, right - left)), dst=inset)
        far_first = np.flatnonzero(known)[np.argsort(-ground_m[known, 1])]
        for row, (at, *bar) in zip(far_first.tolist(), self._marks(ground_m[far_first], inset), strict=True):
            self._draw_track(inset, result, row, at=at, bar=bar)

    def ground_m(self, result: FrameResult) -> FloatArray:
        """(N, 3) x, z and sigma of z of each track, from the fused distance, else the filtered one; NaN = unknown."""
        n = len(result.tracks)
        ground_m = np.full((n, 3), np.nan)
        ground_m[:, :2] = result.xyz_m[:, ::2]
        if "fused" in result.ranges:
            ground_m[:, 2] = result.ranges["fused"].sigma_m
        if self.camera is not None and "fused_kf" in result.ranges:
            found = result.ranges["fused_kf"]
            centre_px = (result.tracks.xyxy_px[:, :2] + result.tracks.xyxy_px[:, 2:]) / 2
            carried = self.camera.rays(centre_px)[:, ::2] * found.distance_m[:, None]
            filled = np.hstack([carried, found.sigma_m[:, None]])
            ground_m = np.where(np.isfinite(ground_m).all(axis=1, keepdims=True), ground_m, filled)
        return ground_m

    def pixels(self, x_m: FloatArray, z_m: FloatArray, inset_hw: tuple[int, int]) -> FloatArray:
        """(..., 2) pixels in an inset of this height and width."""
        height, width = inset_hw
        px_per_m = (1 - _EGO_ROOM) * height / self._scale.range_m
        return np.stack([width / 2 + x_m * px_per_m, (1 - _EGO_ROOM) * height - z_m * px_per_m], axis=-1)

    def _grid(self, hw: tuple[int, int]) -> Image:
        """What is under the tracks, on black; the same until the scale changes."""
        key = (*hw, self._scale.range_m)
        if key not in self._grids:
            self._grids[key] = self._new_grid(hw)
        return self._grids[key]

    def _new_grid(self, hw: tuple[int, int]) -> Image:
        grid = np.zeros((*hw, 3), np.uint8)
        range_m, size_px = self._scale.range_m, max(9, hw[0] // 18)
        ego, *far_ends = self._points(
            [(0.0, 0.0)] + [(2 * range_m * slope, 2 * range_m) for slope in self._slopes()], hw
        )
        for end in far_ends:
            cv2.line(grid, ego, end, _FAINT, 1, cv2.LINE_AA)
        for number in range(1, _N_LINES + 1):
            z_m = range_m * number / _N_LINES
            y = self._points([(0.0, z_m)], hw)[0][1]
            cv2.line(grid, (0, y), (hw[1], y), _FAINT, 1)
            text = f"{z_m:.0f} m" if number == _N_LINES else f"{z_m:.0f}"
            cv2.putText(grid, text, (3, y + size_px), GREY, self._font, size_px, 450)
        half = max(2, hw[0] // 60)
        foot = ego[1] + 2 * half
        cv2.fillConvexPoly(grid, np.array([(ego[0] - half, foot), (ego[0] + half, foot), ego]), WHITE)
        cv2.rectangle(grid, (0, 0), (hw[1] - 1, hw[0] - 1), _FAINT, 1)
        return grid

    def _slopes(self) -> list[float]:
        """How x / z is at the left and the right edge of the camera's view; none where it is not known."""
        if self.camera is None:
            return []
        return [(u_px - self.camera.cx_px) / self.camera.fx_px for u_px in (0.0, self.camera.width_px - 1.0)]

    def _marks(self, ground_m: FloatArray, inset: Image) -> list[list[Point]]:
        """Of each track: its place, and the ends of its bar."""
        z_m, sigma_m = ground_m[:, 1], ground_m[:, 2]
        share = np.stack([np.ones_like(z_m), 1 - sigma_m / z_m, 1 + sigma_m / z_m], axis=1)
        points_m = (ground_m[:, None, :2] * share[:, :, None]).reshape(-1, 2)
        points = self._points(points_m, (inset.shape[0], inset.shape[1]))
        return [points[first : first + 3] for first in range(0, len(points), 3)]

    def _draw_track(self, inset: Image, result: FrameResult, row: int, *, at: Point, bar: Sequence[Point]) -> None:
        colour, radius = track_colour(int(result.tracks.track_id[row])), max(2, round(inset.shape[0] / 60))
        alarm, seen = (
            alarm_colour(float(result.ttc_s[row]), may_hit=result.may_hit(row)),
            bool(result.tracks.observed[row]),
        )
        cv2.circle(inset, at, radius + 2, BLACK if alarm is None else alarm, -1, cv2.LINE_AA)
        if not seen:
            cv2.circle(inset, at, radius, BLACK, -1, cv2.LINE_AA)
        cv2.circle(inset, at, radius, colour, -1 if seen else 1, cv2.LINE_AA)
        cv2.line(inset, bar[0], bar[1], colour, 1, cv2.LINE_AA)

    def _points(self, points_m: npt.ArrayLike, hw: tuple[int, int]) -> list[Point]:
        """Pixels of x, z (N, 2) in the inset; those far outside are brought near it, since drawing takes 16 bits."""
        x_m, z_m = np.asarray(points_m, np.float64).T
        limit = 5.0 * max(hw)
        pixels = np.rint(np.clip(self.pixels(x_m, z_m, hw), -limit, limit)).astype(int)
        return [(x, y) for x, y in pixels.tolist()]
