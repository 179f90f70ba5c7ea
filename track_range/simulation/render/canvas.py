"""Canvas: an image with a depth buffer, on which textured faces are drawn with exact perspective.

`pieces.py` computes where each piece of a face is in the image; the canvas warps its texture there
and keeps the pixels that no nearer surface hides. Pixel operations use OpenCV, which releases the
GIL for other threads.
"""

from collections.abc import Iterator

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.render.face_table import FaceTable, TextureStore
from track_range.simulation.render.pieces import NEAR_M, Projected, projected, visible_pieces
from track_range.stereo.geometry.camera import PinholeCamera

OPAQUE_ALPHA = 112  # lowest alpha of an opaque sample, below half: no gaps between pieces of a face
# in a BGRA sample read as one uint32, alpha is the highest byte
_OPAQUE_BGRA = np.uint32(OPAQUE_ALPHA << 24)
# largest ratio of the depths of a shadow and its surface: curved roads are drawn as flat pieces
SHADE_SLACK = 1.03
_WARP = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP

Slices = tuple[slice, slice]


class Canvas:
    """An image with a depth buffer: (H, W, 4) uint8 `bgra`, and `inverse_depth`, (H, W) 1/z in 1/m,
    0 = nothing drawn.

    `labels` belong to the face that each sample shows, (H, W) as `FaceTable.label`; (0, 0) without
    `has_labels`.
    """

    def __init__(
        self, camera: PinholeCamera, store: TextureStore, *, has_labels: bool = False
    ) -> None:
        self.camera = camera
        self.bgra: Image = np.zeros((camera.height_px, camera.width_px, 4), np.uint8)
        self.inverse_depth: npt.NDArray[np.float32] = np.zeros(
            (camera.height_px, camera.width_px), np.float32
        )
        self.labels = np.zeros(
            (camera.height_px, camera.width_px) if has_labels else (0, 0), np.uint16
        )
        self._store = store
        self._columns, self._rows = np.arange(camera.width_px), np.arange(camera.height_px)

    def project(self, table: FaceTable) -> Projected:
        """The faces, given in the camera's frame, projected to the image."""
        return projected(visible_pieces(table, self.camera), self.camera)

    def draw(self, table: FaceTable) -> None:
        """Draw faces in order, except parts hidden by nearer surfaces or nearer than `NEAR_M`."""
        pieces = self.project(table)
        self.paint(pieces, table, slice(0, len(pieces.face)))

    def may_be_visible(self, corners_m: FloatArray) -> Iterator[bool]:
        """For each body inside a box with corners (N, 8, 3): whether it may be visible in the image
        as drawn so far.
        """
        z = corners_m[:, :, 2]
        xyw = corners_m @ self.camera.matrix.T
        corners_px = xyw[:, :, :2] / np.maximum(z, NEAR_M)[:, :, None]
        edge = np.array([self.camera.width_px, self.camera.height_px])
        low = np.clip(np.floor(corners_px.min(axis=1)), 0, edge).astype(int).tolist()
        high = np.clip(np.ceil(corners_px.max(axis=1)) + 1, 0, edge).astype(int).tolist()
        depths = zip(z.min(axis=1).tolist(), z.max(axis=1).tolist(), strict=True)
        for (left, top), (right, bottom), (near_m, far_m) in zip(low, high, depths, strict=True):
            if near_m < NEAR_M:
                yield far_m >= NEAR_M
            else:
                window = self.inverse_depth[top:bottom, left:right]
                yield bool(window.size and window.min() < 1 / near_m)

    def paint(self, pieces: Projected, table: FaceTable, part: slice) -> None:
        """Draw the rows `part` of the projected pieces of `table`."""
        faces = pieces.face[part]
        numbers, is_shadow = table.texture[faces].tolist(), table.is_shadow[faces].tolist()
        texels, sizes = pieces.texels[part].tolist(), pieces.size[part].tolist()
        windows, nearest = pieces.window_px[part].tolist(), pieces.nearest[part].tolist()
        planes, maps = pieces.inverse_depth[part].tolist(), pieces.texture_from_px[part]
        labels = table.label[faces].tolist()
        for k, (left, top, right, bottom) in enumerate(windows):
            window = np.s_[top : bottom + 1, left : right + 1]
            if (
                not is_shadow[k]
                and np.minimum.reduce(self.inverse_depth[window], axis=None) >= nearest[k]
            ):
                continue
            texture = self._store.averaged(numbers[k], tuple(texels[k]), tuple(sizes[k]))
            size_px = (right - left + 1, bottom - top + 1)
            warped = np.asarray(
                cv2.warpPerspective(texture, maps[k], size_px, flags=_WARP), np.uint8
            )
            if is_shadow[k]:
                self._shade(window, warped, self._plane(window, planes[k]))
            else:
                self._cover(window, warped, self._plane(window, planes[k]), labels[k])

    def n_sky_rows(self) -> int:
        """Number of rows from the top down to the lowest pixel on which nothing was drawn."""
        return int(np.max(np.flatnonzero(self.inverse_depth.min(axis=1) == 0), initial=-1)) + 1

    def fill_sky(self, sky: Image) -> None:
        """Fill the pixels on which nothing was drawn with the upper rows of the sky, (n, W, 4)."""
        is_sky = (self.inverse_depth[: len(sky)] == 0).view(np.uint8)
        cv2.copyTo(sky, is_sky, self.bgra[: len(sky)])

    def _plane(self, window: Slices, plane: list[float]) -> npt.NDArray[np.float32]:
        """1/z in a window, for a plane with 1/z = plane . (u, v, 1)."""
        rows = (self._rows[window[0]] * plane[1] + plane[2]).astype(np.float32)
        return np.asarray(rows[:, None] + (self._columns[window[1]] * plane[0]).astype(np.float32))

    def _cover(
        self, window: Slices, warped: Image, inverse_depth: npt.NDArray[np.float32], label: int
    ) -> None:
        """Draw the opaque samples that are nearer than samples drawn before."""
        is_nearer = cv2.compare(inverse_depth, self.inverse_depth[window], cv2.CMP_GT)
        is_drawn = cv2.bitwise_and(
            is_nearer, (warped.view(np.uint32)[:, :, 0] >= _OPAQUE_BGRA).view(np.uint8)
        )
        cv2.copyTo(inverse_depth, is_drawn, self.inverse_depth[window])
        cv2.copyTo(warped, is_drawn, self.bgra[window])
        if self.labels.size:
            self.labels[window][is_drawn > 0] = label

    def _shade(
        self, window: Slices, darkness: Image, inverse_depth: npt.NDArray[np.float32]
    ) -> None:
        """Darken the surface under a shadow, by the shadow's alpha."""
        darkness[
            cv2.compare(
                self.inverse_depth[window], inverse_depth * np.float32(SHADE_SLACK), cv2.CMP_GT
            )
            > 0
        ] = 0
        light = cv2.bitwise_not(darkness)
        cv2.multiply(
            self.bgra[window],
            cv2.merge([light, light, light, light]),
            self.bgra[window],
            scale=1 / 255,
        )
