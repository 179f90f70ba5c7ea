r"""A picture being drawn: textured faces under exact perspective, hidden surfaces removed by a depth buffer.

A face is C + s U + t V in the camera's frame. With the texture's texel (i, j) at s = (i + 1/2) / n, its pixel is
    (u w, v w, w)^T = K [U V C] (s, t, 1)^T                   a homography: cv2.warpPerspective draws it exactly
and on its plane n . P = d, n = U x V, the inverse depth is affine in the pixel, 1/z = n . (x, y, 1)^T / d: that is what
the depth buffer holds. Against aliasing, which would move a texture against its surface: textures are first averaged
down (area) to the samples they will cover, and faces that reach far along the view are cut into pieces of nearly equal
depth, each averaged for its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, floor

import cv2
import numpy as np

from detection.detections import FloatArray, Image
from stereo.camera import PinholeCamera
from track_range.simulation.faces import Face

NEAR_M = 0.3
DEPTH_RATIO = 1.4
"""A face reaching farther than this between nearest and farthest corner is cut in two, up to `CUTS` times."""

CUTS = 6

HALF_SEEN = 112
"""Alpha from which a sample counts as hit; a little below half, so that no gap opens between pieces of one face."""

SHADE_SLACK = 1.03
"""A shadow lies on what is up to this much nearer than itself: on the road's chords."""


class Canvas:
    """A picture being drawn, with a depth buffer: (H, W, 4) `bgra` and (H, W) `inverse_depth`, 1/m, 0 = sky."""

    def __init__(self, camera: PinholeCamera, background: Image) -> None:
        self.camera = camera
        self.bgra = background.copy()
        self.inverse_depth = np.zeros(background.shape[:2], np.float32)
        self._matrix = camera.matrix
        self._ray_of_pixel = np.linalg.inv(self._matrix)
        self._colours = self.bgra.view(np.uint32)[:, :, 0]  # one number per sample: quicker to copy under a mask

    def could_show(self, corners_m: FloatArray) -> bool:
        """Whether what lies within those corners (8, 3) may be in the image and not behind what is drawn."""
        near_m, far_m = float(corners_m[:, 2].min()), float(corners_m[:, 2].max())
        if near_m < NEAR_M:
            return far_m >= NEAR_M
        at_px = self.camera.project(corners_m)
        left, top = np.floor(at_px.min(axis=0)).astype(int).tolist()
        right, bottom = np.ceil(at_px.max(axis=0)).astype(int).tolist()
        window = self.inverse_depth[max(top, 0) : max(bottom + 1, 0), max(left, 0) : max(right + 1, 0)]
        return bool(window.size and window.min() < 1 / near_m)

    def draw(self, face: Face, shift_m: FloatArray, *, cuts: int = CUTS) -> None:
        """Draw a face, moved by `shift_m`, where nothing nearer stands; what lies before `NEAR_M` is left out."""
        corner = face.corner + shift_m
        normal = _cross(face.along, face.down)
        if not face.two_sided and normal @ corner <= 0:
            return
        corners = corner + np.array([np.zeros(3), face.along, face.along + face.down, face.down])
        near_m, far_m = corners[:, 2].min(), corners[:, 2].max()
        if far_m < NEAR_M:
            return
        if cuts and far_m > DEPTH_RATIO * max(near_m, NEAR_M) and min(face.texture.shape[:2]) > 1:
            for half in _halves(face):
                self.draw(half, shift_m, cuts=cuts - 1)
        elif near_m >= NEAR_M:
            self._draw_piece(face, corner, corners, normal)

    def _draw_piece(self, face: Face, corner: FloatArray, corners: FloatArray, normal: FloatArray) -> None:
        """Warp one piece, all of it in front of the camera, into the box that it covers."""
        at = corners @ self._matrix.T
        at_px = at[:, :2] / at[:, 2:]
        (left, top), (right, bottom) = at_px.min(axis=0).tolist(), at_px.max(axis=0).tolist()
        left, top = max(floor(left), 0), max(floor(top), 0)
        right, bottom = min(ceil(right), self.camera.width_px - 1), min(ceil(bottom), self.camera.height_px - 1)
        if left > right or top > bottom:
            return
        window = np.s_[top : bottom + 1, left : right + 1]
        if not face.is_shadow and self.inverse_depth[window].min() >= 1 / corners[:, 2].min():
            return
        texture = _averaged(face.texture, at_px)
        wide, high = texture.shape[1] - 2, texture.shape[0] - 2  # two texels are margin
        homography = self._matrix @ np.array([face.along / wide, face.down / high, corner]).T
        homography[:, 2] -= 0.5 * (homography[:, 0] + homography[:, 1])
        homography[:2] -= np.array([[left], [top]]) * homography[2]
        size_px = (right - left + 1, bottom - top + 1)
        warped = cv2.warpPerspective(texture, homography, size_px, flags=cv2.INTER_LINEAR)
        inverse = normal @ self._ray_of_pixel / (normal @ corner)
        rows = (np.arange(top, bottom + 1) * inverse[1] + inverse[2]).astype(np.float32)
        inverse_depth = rows[:, None] + (np.arange(left, right + 1) * inverse[0]).astype(np.float32)
        if face.is_shadow:
            self._shade(window, np.asarray(warped[:, :, 3], np.uint8), inverse_depth)
            return
        hit = (warped[:, :, 3] >= HALF_SEEN) & (inverse_depth > self.inverse_depth[window])
        np.copyto(self.inverse_depth[window], inverse_depth, where=hit)
        np.copyto(self._colours[window], warped.view(np.uint32)[:, :, 0], where=hit)

    def _shade(self, window: tuple[slice, slice], darkness: Image, inverse_depth: FloatArray) -> None:
        """Darken what a shadow lies on, by its alpha."""
        kept = 256 - darkness.astype(np.uint16)
        kept[inverse_depth * SHADE_SLACK < self.inverse_depth[window]] = 256
        self.bgra[window][:, :, :3] = (self.bgra[window][:, :, :3] * kept[:, :, None]) >> 8


def _averaged(texture: Image, at_px: FloatArray) -> Image:
    """The texture brought down to the samples that its edges cover, with a transparent margin of one texel.

    The margin repeats the colours of the edge, so that only alpha fades out.
    """
    edges = at_px[[1, 2, 3, 0]] - at_px
    top, right, bottom, left = np.sqrt((edges * edges).sum(axis=1)).tolist()
    width = min(max(ceil(max(top, bottom)), 1), texture.shape[1])
    height = min(max(ceil(max(left, right)), 1), texture.shape[0])
    small = texture
    if (height, width) != texture.shape[:2]:
        small = np.asarray(cv2.resize(texture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    framed = cv2.copyMakeBorder(small, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    framed[[0, -1], :, 3] = 0
    framed[:, [0, -1], 3] = 0
    return np.asarray(framed, np.uint8)


def _halves(face: Face) -> Iterator[Face]:
    """A face cut in two across the edge that reaches farther in depth, at a whole texel."""
    axis = 1 if abs(face.along[2]) >= abs(face.down[2]) else 0
    n_texels = face.texture.shape[axis]
    share = (n_texels // 2) / n_texels
    along, down, flags = face.along, face.down, (face.two_sided, face.is_shadow)
    first, second = np.split(face.texture, [n_texels // 2], axis=axis)
    if axis == 1:
        yield Face(face.corner, along * share, down, first, *flags)
        yield Face(face.corner + along * share, along * (1 - share), down, second, *flags)
    else:
        yield Face(face.corner, along, down * share, first, *flags)
        yield Face(face.corner + down * share, along, down * (1 - share), second, *flags)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """The cross product of two vectors (np.cross takes ten times as long for one)."""
    return a[[1, 2, 0]] * b[[2, 0, 1]] - a[[2, 0, 1]] * b[[1, 2, 0]]
