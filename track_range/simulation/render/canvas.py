"""A picture being drawn: textured pieces under exact perspective, hidden surfaces removed by a depth buffer.

`pieces.py` tells where each piece lies; here its texture is warped there, and kept where nothing nearer stands. Pixels
are worked on by OpenCV, which lets other threads run meanwhile.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.render.face_table import FaceTable
from track_range.simulation.render.pieces import NEAR_M, Projected, projected, seen_pieces
from track_range.simulation.render.texture_store import TextureStore
from track_range.stereo.geometry.camera import PinholeCamera

HALF_SEEN = 112
"""Alpha from which a sample counts as hit; a little below half, so that no gap opens between pieces of one face."""

_HIT = np.uint32(HALF_SEEN << 24)
"""The same of a sample's four bytes, read as one number: alpha is the highest."""

SHADE_SLACK = 1.03
"""A shadow lies on what is up to this much nearer than itself: on the road's chords."""

_WARP = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP

Slices = tuple[slice, slice]


class Canvas:
    """A picture being drawn, with a depth buffer: (H, W, 4) `bgra` and (H, W) `inverse_depth`, 1/m, 0 = sky."""

    def __init__(self, camera: PinholeCamera, store: TextureStore) -> None:
        self.camera = camera
        self.bgra: Image = np.zeros((camera.height_px, camera.width_px, 4), np.uint8)
        self.inverse_depth: npt.NDArray[np.float32] = np.zeros((camera.height_px, camera.width_px), np.float32)
        self._store = store
        self._columns, self._rows = np.arange(camera.width_px), np.arange(camera.height_px)

    def place(self, table: FaceTable) -> Projected:
        """Where faces in the camera's frame lie in this picture."""
        return projected(seen_pieces(table, self.camera), self.camera)

    def draw(self, table: FaceTable) -> None:
        """Draw faces, in their order, where nothing nearer stands; what lies before `NEAR_M` is left out."""
        placed = self.place(table)
        self.paint(placed, table, slice(0, len(placed.face)))

    def could_show(self, corners_m: FloatArray) -> Iterator[bool]:
        """Whether what lies within corners (N, 8, 3) may be in the image and not behind what is drawn, one by one."""
        z = corners_m[:, :, 2]
        at = corners_m @ self.camera.matrix.T
        at_px = at[:, :, :2] / np.maximum(z, NEAR_M)[:, :, None]
        edge = np.array([self.camera.width_px, self.camera.height_px])
        low = np.clip(np.floor(at_px.min(axis=1)), 0, edge).astype(int).tolist()
        high = np.clip(np.ceil(at_px.max(axis=1)) + 1, 0, edge).astype(int).tolist()
        depths = zip(z.min(axis=1).tolist(), z.max(axis=1).tolist(), strict=True)
        for (left, top), (right, bottom), (near_m, far_m) in zip(low, high, depths, strict=True):
            if near_m < NEAR_M:
                yield far_m >= NEAR_M
            else:
                window = self.inverse_depth[top:bottom, left:right]
                yield bool(window.size and window.min() < 1 / near_m)

    def paint(self, placed: Projected, table: FaceTable, part: slice) -> None:
        """Draw a part of the pieces that faces of `table` were placed as."""
        faces = placed.face[part]
        numbers, is_shadow = table.texture[faces].tolist(), table.is_shadow[faces].tolist()
        texels, sizes = placed.texels[part].tolist(), placed.size[part].tolist()
        windows, nearest = placed.window_px[part].tolist(), placed.nearest[part].tolist()
        planes, maps = placed.inverse_depth[part].tolist(), placed.texture_from_px[part]
        for k, (left, top, right, bottom) in enumerate(windows):
            window = np.s_[top : bottom + 1, left : right + 1]
            if not is_shadow[k] and np.minimum.reduce(self.inverse_depth[window], axis=None) >= nearest[k]:
                continue
            texture = self._store.averaged(numbers[k], tuple(texels[k]), tuple(sizes[k]))
            size_px = (right - left + 1, bottom - top + 1)
            warped = np.asarray(cv2.warpPerspective(texture, maps[k], size_px, flags=_WARP), np.uint8)
            if is_shadow[k]:
                self._shade(window, warped, self._plane(window, planes[k]))
            else:
                self._cover(window, warped, self._plane(window, planes[k]))

    def sky_until(self) -> int:
        """How many rows, from the top, hold all that nothing was drawn on."""
        return int(np.max(np.flatnonzero(self.inverse_depth.min(axis=1) == 0), initial=-1)) + 1

    def fill_sky(self, sky: Image) -> None:
        """What is behind everything: its upper rows, (n, W, 4), go where nothing was drawn."""
        is_sky = (self.inverse_depth[: len(sky)] == 0).view(np.uint8)
        cv2.copyTo(sky, is_sky, self.bgra[: len(sky)])

    def _plane(self, window: Slices, plane: list[float]) -> npt.NDArray[np.float32]:
        """A plane's 1/z in a window."""
        rows = (self._rows[window[0]] * plane[1] + plane[2]).astype(np.float32)
        return np.asarray(rows[:, None] + (self._columns[window[1]] * plane[0]).astype(np.float32))

    def _cover(self, window: Slices, warped: Image, inverse_depth: npt.NDArray[np.float32]) -> None:
        is_nearer = cv2.compare(inverse_depth, self.inverse_depth[window], cv2.CMP_GT)
        hit = cv2.bitwise_and(is_nearer, (warped.view(np.uint32)[:, :, 0] >= _HIT).view(np.uint8))
        cv2.copyTo(inverse_depth, hit, self.inverse_depth[window])
        cv2.copyTo(warped, hit, self.bgra[window])

    def _shade(self, window: Slices, darkness: Image, inverse_depth: npt.NDArray[np.float32]) -> None:
        """Darken what a shadow lies on, by its alpha."""
        darkness[cv2.compare(self.inverse_depth[window], inverse_depth * np.float32(SHADE_SLACK), cv2.CMP_GT) > 0] = 0
        kept = cv2.bitwise_not(darkness)
        cv2.multiply(self.bgra[window], cv2.merge([kept, kept, kept, kept]), self.bgra[window], scale=1 / 255)
