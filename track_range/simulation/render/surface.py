r"""Exact intersection of rays with the drawn surface of a body.

A ray l r (r_z = 1, so that l is the depth) meets a face C + s U + t V where  [U V -r] (s t l)^T = -C,  if s and t are
in [0, 1), the face is seen from outside, and its texture is opaque there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, Image
from track_range.simulation.render.canvas import OPAQUE_ALPHA
from track_range.simulation.world.bodies.faces import Face
from track_range.stereo.geometry.camera import PinholeCamera

# number of rays per side of the grid that is searched if the ray through the box centre misses the
# body
N_GRID = 15


@dataclass(frozen=True, slots=True)
class Surface:
    """The faces of a body as arrays, without shadows."""

    corner: FloatArray  # (F, 3), as both edges in metres
    along: FloatArray
    down: FloatArray
    two_sided: BoolArray  # (F,) whether the back is visible too
    textures: tuple[Image, ...]  # texture of each face

    @classmethod
    def of(cls, faces: Sequence[Face]) -> Surface:
        """The surface of the given faces."""
        solid = [face for face in faces if not face.is_shadow]
        vectors = np.array(
            [(face.corner, face.along, face.down) for face in solid], np.float64
        ).reshape(-1, 3, 3)
        two_sided = np.array([face.two_sided for face in solid], np.bool_)
        return cls(
            vectors[:, 0],
            vectors[:, 1],
            vectors[:, 2],
            two_sided,
            tuple(face.texture for face in solid),
        )

    def transformed(self, rotation: FloatArray, location_m: FloatArray) -> Surface:
        """The surface rotated by (3, 3), then translated by (3,)."""
        corner, along, down = (part @ rotation.T for part in (self.corner, self.along, self.down))
        return Surface(corner + location_m, along, down, self.two_sided, self.textures)


def centre_depth_m(surface: Surface, camera: PinholeCamera, xyxy_px: FloatArray) -> float:
    """The z at which the ray through a box centre first meets a body.

    If that ray misses the body, passing between legs or wheels, the nearest ray in the box that
    meets it is used. The body is in the camera's frame; NaN if no ray meets it.
    """
    middle = (xyxy_px[:2] + xyxy_px[2:]) / 2
    at_centre = first_depths_m(surface, camera.rays(middle[None]))[0]
    if np.isfinite(at_centre):
        return float(at_centre)
    steps = np.linspace(-0.5, 0.5, N_GRID)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    offsets = offsets[np.argsort((offsets**2).sum(axis=1), kind="stable")]
    depths = first_depths_m(surface, camera.rays(middle + offsets * (xyxy_px[2:] - xyxy_px[:2])))
    finite = depths[np.isfinite(depths)]
    return float(finite[0]) if len(finite) else float("nan")


def first_depths_m(surface: Surface, rays: FloatArray) -> FloatArray:
    """(N,) z at which each ray (N, 3), with z = 1, first meets a face; NaN if it meets none."""
    normal = np.cross(surface.along, surface.down)
    away = (normal * surface.corner).sum(axis=1)
    facing = np.flatnonzero(surface.two_sided | (away > 0))
    corner, along, down = surface.corner[facing], surface.along[facing], surface.down[facing]
    across = rays @ normal[facing].T
    depth = away[facing] / np.where(across == 0, np.nan, across)
    in_plane = rays[:, None, :] * depth[:, :, None] - corner
    s, t = _fractions(in_plane, along, down)
    inside = (s >= 0) & (s < 1) & (t >= 0) & (t < 1) & (depth > 0)
    nearest = np.full(len(rays), np.inf)
    for ray, face in zip(*np.nonzero(inside), strict=True):
        if depth[ray, face] < nearest[ray]:
            texture = surface.textures[facing[face]]
            row, column = int(t[ray, face] * texture.shape[0]), int(s[ray, face] * texture.shape[1])
            if texture[row, column, 3] >= OPAQUE_ALPHA:
                nearest[ray] = depth[ray, face]
    return np.where(np.isfinite(nearest), nearest, np.nan)


def _fractions(
    in_plane: FloatArray, along: FloatArray, down: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(N, F) coordinates s and t of points (N, F, 3) in the planes of faces, from the normal
    equations.
    """
    aa, ad, dd = (along * along).sum(axis=1), (along * down).sum(axis=1), (down * down).sum(axis=1)
    a, d = (in_plane * along).sum(axis=2), (in_plane * down).sum(axis=2)
    determinant = aa * dd - ad * ad
    return (a * dd - d * ad) / determinant, (d * aa - a * ad) / determinant
