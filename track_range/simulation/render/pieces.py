r"""Pieces of faces that a camera sees: culling, splitting and projection of a table of faces.

A face is C + s U + t V in the camera's frame. With the texture's texel (i, j) at s = (i + 1/2) / n, its pixel is
    (u w, v w, w)^T = K [U V C] (s, t, 1)^T                   a homography, drawn exactly by cv2.warpPerspective
and on its plane n . P = d, n = U x V, the inverse depth is affine in the pixel, 1/z = n . (x, y, 1)^T / d.
To avoid aliasing, which would shift a texture relative to its surface, faces that extend far in depth are split into
pieces of nearly constant depth, and the texture of each piece is averaged to its resolution in the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.simulation.render.face_table import FaceTable, quantized_up
from track_range.stereo.geometry.camera import PinholeCamera

NEAR_M = 0.3  # depth of the near plane, m
# ratio of the depths of the farthest and the nearest corner above which a face is split in two
DEPTH_RATIO = 1.4
CUTS = 6  # largest number of times that a face is split


@dataclass(frozen=True, slots=True)
class Pieces:
    """Pieces of faces in the camera's frame, in the order of their faces."""

    face: IntArray  # (P,) rows of the table
    corner: FloatArray  # (P, 3), as both edges in metres
    along: FloatArray
    down: FloatArray
    # (P, 4) part of the face's texture: first row, end row, first column, end column
    window: IntArray

    def __len__(self) -> int:
        return len(self.face)

    @property
    def corners(self) -> FloatArray:
        """(P, 4, 3) corners, clockwise from `corner`."""
        right = self.corner + self.along
        return np.stack([self.corner, right, right + self.down, self.corner + self.down], axis=1)

    @property
    def n_texels(self) -> IntArray:
        """(P, 2) rows and columns of the window."""
        return self.window[:, 1::2] - self.window[:, ::2]

    def select(self, rows: IntArray | BoolArray) -> Pieces:
        """The pieces of the given rows."""
        return Pieces(
            self.face[rows], self.corner[rows], self.along[rows], self.down[rows], self.window[rows]
        )


@dataclass(frozen=True, slots=True)
class Projected:
    """Pieces projected to the image."""

    face: IntArray  # (P,) rows of the table
    texels: IntArray  # (P, 4) window of the texture: first row, end row, first column, end column
    size: IntArray  # (P, 2) rows and columns to which the window is averaged
    window_px: IntArray  # (P, 4) left, top, right, bottom in the image, inclusive
    # (P, 3, 3) homography from `window_px` to the averaged texture with margin
    texture_from_px: FloatArray
    inverse_depth: FloatArray  # (P, 3) coefficients of 1/z in (u, v, 1)
    nearest: FloatArray  # (P,) 1/z of the nearest corner


def visible_pieces(table: FaceTable, camera: PinholeCamera) -> Pieces:
    """The faces that may be visible: in front of the camera and facing it, split where they extend
    far in depth.
    """
    facing = (np.cross(table.along, table.down) * table.corner).sum(axis=1) > 0
    rows = np.flatnonzero(facing | table.two_sided)
    window = np.zeros((len(rows), 4), np.int64)
    window[:, 1::2] = table.texels[rows]
    pieces = _in_view(
        Pieces(rows, table.corner[rows], table.along[rows], table.down[rows], window), camera
    )
    for _ in range(CUTS):
        z = pieces.corners[:, :, 2]
        is_deep = z.max(axis=1) > DEPTH_RATIO * np.maximum(z.min(axis=1), NEAR_M)
        is_deep &= pieces.n_texels.min(axis=1) > 1
        if not is_deep.any():
            break
        pieces = _in_view(_halved(pieces, is_deep), camera)
    return pieces.select(pieces.corners[:, :, 2].min(axis=1) >= NEAR_M)


def projected(pieces: Pieces, camera: PinholeCamera) -> Projected:
    """The pieces projected to the image, without pieces outside the image."""
    matrix = camera.matrix
    corners = pieces.corners
    xyw = corners @ matrix.T
    corners_px = xyw[:, :, :2] / xyw[:, :, 2:]
    edge = np.array([camera.width_px - 1, camera.height_px - 1])
    low = np.maximum(np.floor(corners_px.min(axis=1)), 0).astype(np.int64)
    high = np.minimum(np.ceil(corners_px.max(axis=1)), edge).astype(np.int64)
    size = _texture_size(corners_px, pieces.n_texels)
    columns = np.stack(
        [pieces.along / size[:, 1:], pieces.down / size[:, :1], pieces.corner], axis=2
    )
    px_from_texture = matrix @ columns
    px_from_texture[:, :, 2] -= 0.5 * (px_from_texture[:, :, 0] + px_from_texture[:, :, 1])
    px_from_texture[:, :2] -= low[:, :, None] * px_from_texture[:, 2:]
    normal = np.cross(pieces.along, pieces.down)
    inverse = normal @ np.linalg.inv(matrix) / (normal * pieces.corner).sum(axis=1)[:, None]
    rows = np.flatnonzero((low <= high).all(axis=1) & (np.abs(np.linalg.det(px_from_texture)) > 0))
    return Projected(
        pieces.face[rows],
        pieces.window[rows],
        size[rows],
        np.concatenate([low, high], axis=1)[rows],
        np.asarray(np.linalg.inv(px_from_texture[rows]), np.float64),
        inverse[rows],
        1 / corners[rows, :, 2].min(axis=1),
    )


def _texture_size(corners_px: FloatArray, n_texels: IntArray) -> IntArray:
    """(P, 2) rows and columns of the averaged textures, from the longer edges between corners (P,
    4, 2).
    """
    edges = np.roll(corners_px, -1, axis=1) - corners_px
    top, right, bottom, left = np.sqrt((edges * edges).sum(axis=2)).T
    covered = np.stack([np.maximum(left, right), np.maximum(top, bottom)], axis=1)
    return quantized_up(
        np.minimum(np.maximum(np.ceil(covered), 1), n_texels).astype(np.int64), n_texels
    )


def _in_view(pieces: Pieces, camera: PinholeCamera) -> Pieces:
    """The pieces that are not entirely behind the camera or beyond one edge of the image."""
    x, y, z = np.moveaxis(pieces.corners @ camera.matrix.T, 2, 0)
    is_outside = (x < -z).all(axis=1) | (x > camera.width_px * z).all(axis=1)
    is_outside |= (y < -z).all(axis=1) | (y > camera.height_px * z).all(axis=1)
    return pieces.select(~is_outside & (z.max(axis=1, initial=-np.inf) >= NEAR_M))


def _halved(pieces: Pieces, is_split: BoolArray) -> Pieces:
    """The pieces in the same order, with the pieces `is_split` (P,) halved at a texel along the
    edge that is deeper.
    """
    both = pieces.select(np.repeat(np.arange(len(pieces)), 1 + is_split))
    is_cut = np.repeat(is_split, 1 + is_split)
    is_second = is_cut & (np.cumsum(is_cut) % 2 == 0)
    across = np.abs(both.along[:, 2]) >= np.abs(both.down[:, 2])
    n_first = np.where(across, both.n_texels[:, 1], both.n_texels[:, 0]) // 2
    fraction = n_first / np.where(across, both.n_texels[:, 1], both.n_texels[:, 0])
    length = np.where(is_cut, np.where(is_second, 1 - fraction, fraction), 1.0)[:, None]
    start = np.where(is_second, fraction, 0.0)[:, None]
    corner = both.corner + start * np.where(across[:, None], both.along, both.down)
    window = both.window.copy()
    for axis, is_axis in ((0, ~across), (2, across)):
        middle = window[:, axis] + n_first
        window[:, axis] = np.where(is_second & is_axis, middle, window[:, axis])
        window[:, axis + 1] = np.where(is_cut & ~is_second & is_axis, middle, window[:, axis + 1])
    along = both.along * np.where(across[:, None], length, 1.0)
    down = both.down * np.where(across[:, None], 1.0, length)
    return Pieces(both.face, corner, along, down, window)
