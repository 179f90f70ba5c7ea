r"""Where the ray through a box's centre first meets what was drawn, exactly.

A face C + s U + t V meets the ray l r (r_z = 1, so that l is the depth) where  [U V -r] (s t l)^T = -C,  if s and t lie
in 0..1, it is seen from outside, and its texture is not cut out there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from detection.detections import FloatArray
from stereo.camera import PinholeCamera
from track_range.simulation.canvas import HALF_SEEN
from track_range.simulation.faces import Face

N_TRIES = 15
"""Per side of the grid of rays round the centre, where the one through the centre passes the body by."""


def centre_depth_m(faces: Sequence[Face], camera: PinholeCamera, xyxy_px: FloatArray) -> float:
    """The z at which the ray through a box's centre first meets a body.

    Args:
        faces: the body in the camera's frame.
        camera: the left one.
        xyxy_px: (4,) the box.

    Returns:
        Where that ray passes between legs or wheels: the z at the nearest ray within the box that meets the body; NaN
        where none does.
    """
    middle = (xyxy_px[:2] + xyxy_px[2:]) / 2
    at_centre = first_depths_m(faces, camera.rays(middle[None]))[0]
    if np.isfinite(at_centre):
        return float(at_centre)
    steps = np.linspace(-0.5, 0.5, N_TRIES)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    offsets = offsets[np.argsort((offsets**2).sum(axis=1), kind="stable")]
    depths = first_depths_m(faces, camera.rays(middle + offsets * (xyxy_px[2:] - xyxy_px[:2])))
    met = depths[np.isfinite(depths)]
    return float(met[0]) if len(met) else float("nan")


def first_depths_m(faces: Sequence[Face], rays: FloatArray) -> FloatArray:
    """(N,) z at which each ray (N, 3), z = 1, first meets one of the faces; NaN where it meets none."""
    nearest = np.full(len(rays), np.inf)
    for face in faces:
        normal = np.cross(face.along, face.down)
        if face.is_shadow or (not face.two_sided and normal @ face.corner <= 0):
            continue
        across = rays @ normal
        depth = (normal @ face.corner) / np.where(across == 0, np.nan, across)
        in_plane = rays * depth[:, None] - face.corner
        on_plane = np.linalg.pinv(np.stack([face.along, face.down], axis=1))
        s, t = on_plane @ in_plane.T
        inside = (s >= 0) & (s < 1) & (t >= 0) & (t < 1) & (depth > 0)
        height, width = face.texture.shape[:2]
        row, column = (np.where(inside, t, 0) * height).astype(int), (np.where(inside, s, 0) * width).astype(int)
        inside &= face.texture[row, column, 3] >= HALF_SEEN
        nearest = np.where(inside & (depth < nearest), depth, nearest)
    return np.where(np.isfinite(nearest), nearest, np.nan)
