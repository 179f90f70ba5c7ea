r"""Which pieces of faces a camera sees, and where: a table of faces -> culled -> cut -> projected, all as arrays.

A face is C + s U + t V in the camera's frame. With the texture's texel (i, j) at s = (i + 1/2) / n, its pixel is
    (u w, v w, w)^T = K [U V C] (s, t, 1)^T                   a homography: cv2.warpPerspective draws it exactly
and on its plane n . P = d, n = U x V, the inverse depth is affine in the pixel, 1/z = n . (x, y, 1)^T / d.
Against aliasing, which would move a texture against its surface, faces that reach far along the view are cut into
pieces of nearly equal depth, whose textures are averaged each for its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.simulation.render.face_table import FaceTable
from track_range.simulation.render.texture_store import stepped_up
from track_range.stereo.geometry.camera import PinholeCamera

NEAR_M = 0.3
DEPTH_RATIO = 1.4
"""A face reaching farther than this between nearest and farthest corner is cut in two, up to `CUTS` times."""

CUTS = 6


@dataclass(frozen=True, slots=True)
class Pieces:
    """Pieces of faces in the camera's frame, in the order of their faces.

    Attributes:
        face: (P,) rows of the table.
        corner, along, down: (P, 3) metres.
        window: (P, 4) rows from, to, columns from, to, of the face's texture.
    """

    face: IntArray
    corner: FloatArray
    along: FloatArray
    down: FloatArray
    window: IntArray

    def __len__(self) -> int:
        return len(self.face)

    @property
    def corners(self) -> FloatArray:
        """(P, 4, 3) round the piece."""
        right = self.corner + self.along
        return np.stack([self.corner, right, right + self.down, self.corner + self.down], axis=1)

    @property
    def n_texels(self) -> IntArray:
        """(P, 2) rows and columns."""
        return self.window[:, 1::2] - self.window[:, ::2]

    def select(self, rows: IntArray | BoolArray) -> Pieces:
        """Some of the pieces."""
        return Pieces(self.face[rows], self.corner[rows], self.along[rows], self.down[rows], self.window[rows])


@dataclass(frozen=True, slots=True)
class Projected:
    """Where pieces lie in the image.

    Attributes:
        face: (P,) rows of the table.
        texels: (P, 4) the piece's window of its texture.
        size: (P, 2) rows and columns to which that is to be averaged.
        window_px: (P, 4) left, top, right, bottom in the image, all of them within it.
        texture_from_px: (P, 3, 3) pixels of that window -> texels of the averaged texture with its margin.
        inverse_depth: (P, 3) 1/z = these times (u, v, 1).
        nearest: (P,) 1/z of the nearest corner.
    """

    face: IntArray
    texels: IntArray
    size: IntArray
    window_px: IntArray
    texture_from_px: FloatArray
    inverse_depth: FloatArray
    nearest: FloatArray


def seen_pieces(table: FaceTable, camera: PinholeCamera) -> Pieces:
    """What may be in the image: before the camera, turned to it, and cut where it reaches far."""
    facing = (np.cross(table.along, table.down) * table.corner).sum(axis=1) > 0
    rows = np.flatnonzero(facing | table.two_sided)
    window = np.zeros((len(rows), 4), np.int64)
    window[:, 1::2] = table.texels[rows]
    pieces = _in_view(Pieces(rows, table.corner[rows], table.along[rows], table.down[rows], window), camera)
    for _ in range(CUTS):
        too_long = _reaches_far(pieces)
        if not too_long.any():
            break
        pieces = _in_view(_halved(pieces, too_long), camera)
    return pieces.select(pieces.corners[:, :, 2].min(axis=1) >= NEAR_M)


def projected(pieces: Pieces, camera: PinholeCamera) -> Projected:
    """Where pieces lie in the image, those left out that cover no pixel of it."""
    matrix = camera.matrix
    corners = pieces.corners
    at = corners @ matrix.T
    at_px = at[:, :, :2] / at[:, :, 2:]
    edge = np.array([camera.width_px - 1, camera.height_px - 1])
    low = np.maximum(np.floor(at_px.min(axis=1)), 0).astype(np.int64)
    high = np.minimum(np.ceil(at_px.max(axis=1)), edge).astype(np.int64)
    size = _samples_covered(at_px, pieces.n_texels)
    columns = np.stack([pieces.along / size[:, 1:], pieces.down / size[:, :1], pieces.corner], axis=2)
    px_from_texture = matrix @ columns
    px_from_texture[:, :, 2] -= 0.5 * (px_from_texture[:, :, 0] + px_from_texture[:, :, 1])
    px_from_texture[:, :2] -= low[:, :, None] * px_from_texture[:, 2:]
    normal = np.cross(pieces.along, pieces.down)
    inverse = normal @ np.linalg.inv(matrix) / (normal * pieces.corner).sum(axis=1)[:, None]
    seen = np.flatnonzero((low <= high).all(axis=1) & (np.abs(np.linalg.det(px_from_texture)) > 0))
    return Projected(
        pieces.face[seen],
        pieces.window[seen],
        size[seen],
        np.concatenate([low, high], axis=1)[seen],
        np.asarray(np.linalg.inv(px_from_texture[seen]), np.float64),
        inverse[seen],
        1 / corners[seen, :, 2].min(axis=1),
    )


def _samples_covered(at_px: FloatArray, n_texels: IntArray) -> IntArray:
    """(P, 2) rows and columns of texels for a piece's corners (P, 4, 2): as its longer edges are, on a step."""
    edges = np.roll(at_px, -1, axis=1) - at_px
    top, right, bottom, left = np.sqrt((edges * edges).sum(axis=2)).T
    covered = np.stack([np.maximum(left, right), np.maximum(top, bottom)], axis=1)
    return stepped_up(np.minimum(np.maximum(np.ceil(covered), 1), n_texels).astype(np.int64), n_texels)


def _in_view(pieces: Pieces, camera: PinholeCamera) -> Pieces:
    """Those that are not altogether behind the camera, or beyond one of the image's four edges."""
    at = pieces.corners @ camera.matrix.T
    x, y, z = np.moveaxis(at, 2, 0)
    beyond = (x < -z).all(axis=1) | (x > camera.width_px * z).all(axis=1)
    beyond |= (y < -z).all(axis=1) | (y > camera.height_px * z).all(axis=1)
    return pieces.select(~beyond & (z.max(axis=1, initial=-np.inf) >= NEAR_M))


def _reaches_far(pieces: Pieces) -> BoolArray:
    z = pieces.corners[:, :, 2]
    deep = z.max(axis=1) > DEPTH_RATIO * np.maximum(z.min(axis=1), NEAR_M)
    return np.asarray(deep & (pieces.n_texels.min(axis=1) > 1))


def _halved(pieces: Pieces, too_long: BoolArray) -> Pieces:
    """The marked ones cut in two across the edge that reaches farther in depth, at a whole texel; order is kept."""
    both = pieces.select(np.repeat(np.arange(len(pieces)), 1 + too_long))
    is_cut = np.repeat(too_long, 1 + too_long)
    is_second = is_cut & (np.cumsum(is_cut) % 2 == 0)
    across = np.abs(both.along[:, 2]) >= np.abs(both.down[:, 2])
    n_first = np.where(across, both.n_texels[:, 1], both.n_texels[:, 0]) // 2
    share = n_first / np.where(across, both.n_texels[:, 1], both.n_texels[:, 0])
    kept = np.where(is_cut, np.where(is_second, 1 - share, share), 1.0)[:, None]
    start = np.where(is_second, share, 0.0)[:, None]
    corner = both.corner + start * np.where(across[:, None], both.along, both.down)
    window = both.window.copy()
    for axis, is_axis in ((0, ~across), (2, across)):
        middle = window[:, axis] + n_first
        window[:, axis] = np.where(is_second & is_axis, middle, window[:, axis])
        window[:, axis + 1] = np.where(is_cut & ~is_second & is_axis, middle, window[:, axis + 1])
    along = both.along * np.where(across[:, None], kept, 1.0)
    down = both.down * np.where(across[:, None], 1.0, kept)
    return Pieces(both.face, corner, along, down, window)
