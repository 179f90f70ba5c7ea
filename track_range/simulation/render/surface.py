r"""Where the ray through a box's centre first meets what was drawn, exactly.

A face C + s U + t V meets the ray l r (r_z = 1, so that l is the depth) where  [U V -r] (s t l)^T = -C,  if s and t lie
in 0..1, it is seen from outside, and its texture is not cut out there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, Image
from track_range.simulation.render.canvas import HALF_SEEN
from track_range.simulation.world.faces import Face
from track_range.stereo.geometry.camera import PinholeCamera

N_TRIES = 15
"""Per side of the grid of rays round the centre, where the one through the centre passes the body by."""


@dataclass(frozen=True, slots=True)
class Surface:
    """A body's faces as arrays: what a ray can meet.

    Attributes:
        corner, along, down: (F, 3) metres.
        two_sided: (F,).
        textures: of each face.
    """

    corner: FloatArray
    along: FloatArray
    down: FloatArray
    two_sided: BoolArray
    textures: tuple[Image, ...]

    @classmethod
    def of(cls, faces: Sequence[Face]) -> Surface:
        """All but shadows, which no ray meets."""
        solid = [face for face in faces if not face.is_shadow]
        vectors = np.array([(face.corner, face.along, face.down) for face in solid], np.float64).reshape(-1, 3, 3)
        two_sided = np.array([face.two_sided for face in solid], np.bool_)
        return cls(vectors[:, 0], vectors[:, 1], vectors[:, 2], two_sided, tuple(face.texture for face in solid))

    def placed(self, turn: FloatArray, place_m: FloatArray) -> Surface:
        """The same turned (3, 3), then moved (3,)."""
        corner, along, down = (part @ turn.T for part in (self.corner, self.along, self.down))
        return Surface(corner + place_m, along, down, self.two_sided, self.textures)


def centre_depth_m(surface: Surface, camera: PinholeCamera, xyxy_px: FloatArray) -> float:
    """The z at which the ray through a box's centre first meets a body.

    Args:
        surface: the body in the camera's frame.
        camera: the left one.
        xyxy_px: (4,) the box.

    Returns:
        Where that ray passes between legs or wheels: the z at the nearest ray within the box that meets the body; NaN
        where none does.
    """
    middle = (xyxy_px[:2] + xyxy_px[2:]) / 2
    at_centre = first_depths_m(surface, camera.rays(middle[None]))[0]
    if np.isfinite(at_centre):
        return float(at_centre)
    steps = np.linspace(-0.5, 0.5, N_TRIES)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    offsets = offsets[np.argsort((offsets**2).sum(axis=1), kind="stable")]
    depths = first_depths_m(surface, camera.rays(middle + offsets * (xyxy_px[2:] - xyxy_px[:2])))
    met = depths[np.isfinite(depths)]
    return float(met[0]) if len(met) else float("nan")


def first_depths_m(surface: Surface, rays: FloatArray) -> FloatArray:
    """(N,) z at which each ray (N, 3), z = 1, first meets one of the faces; NaN where it meets none."""
    normal = np.cross(surface.along, surface.down)
    away = (normal * surface.corner).sum(axis=1)
    facing = np.flatnonzero(surface.two_sided | (away > 0))
    corner, along, down = surface.corner[facing], surface.along[facing], surface.down[facing]
    across = rays @ normal[facing].T
    depth = away[facing] / np.where(across == 0, np.nan, across)
    in_plane = rays[:, None, :] * depth[:, :, None] - corner
    s, t = _shares(in_plane, along, down)
    inside = (s >= 0) & (s < 1) & (t >= 0) & (t < 1) & (depth > 0)
    nearest = np.full(len(rays), np.inf)
    for ray, face in zip(*np.nonzero(inside), strict=True):
        if depth[ray, face] < nearest[ray]:
            texture = surface.textures[facing[face]]
            row, column = int(t[ray, face] * texture.shape[0]), int(s[ray, face] * texture.shape[1])
            if texture[row, column, 3] >= HALF_SEEN:
                nearest[ray] = depth[ray, face]
    return np.where(np.isfinite(nearest), nearest, np.nan)


def _shares(in_plane: FloatArray, along: FloatArray, down: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N, F) s and t of points (N, F, 3) in the planes of faces: least squares, by its normal equations."""
    aa, ad, dd = (along * along).sum(axis=1), (along * down).sum(axis=1), (down * down).sum(axis=1)
    a, d = (in_plane * along).sum(axis=2), (in_plane * down).sum(axis=2)
    determinant = aa * dd - ad * ad
    return (a * dd - d * ad) / determinant, (d * aa - a * ad) / determinant
