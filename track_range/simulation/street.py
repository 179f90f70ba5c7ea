"""What stands still beside and under the traffic: the road and a row of houses on either side, in pieces.

Road and houses repeat every `PERIOD_M`. They are handed out in stretches that end at fixed places of the world, so that
every piece shows the same part of its picture in every frame; farther stretches are longer, and come from pictures
that were averaged along the road beforehand by the same factor, since perspective shortens them by more than that.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from detection.detections import Image
from track_range.simulation.faces import Face
from track_range.simulation.scene import WALL_X_M
from track_range.simulation.textures import road_texture, wall_texture

FAR_M = 260.0
PERIOD_M = 48.0
WALL_HEIGHT_M = 9.0

STRETCHES_M = ((0.0, 3), (24.0, 6), (72.0, 24))
"""From which distance on stretches have which length; each length divides the next, and the last divides the period."""


class Street:
    """The textures of one street, made once."""

    def __init__(self, rng: np.random.Generator) -> None:
        road = road_texture(rng, half_width_m=WALL_X_M, period_m=PERIOD_M)[::-1]  # seen from above: far rows first
        left = wall_texture(rng, height_m=WALL_HEIGHT_M, period_m=PERIOD_M)
        right = wall_texture(rng, height_m=WALL_HEIGHT_M, period_m=PERIOD_M)[:, ::-1]  # seen with far columns first
        shortest = STRETCHES_M[0][1]
        self._roads = {length: _shortened(road, rows=length // shortest) for _, length in STRETCHES_M}
        self._lefts = {length: _shortened(left, columns=length // shortest) for _, length in STRETCHES_M}
        self._rights = {length: _shortened(right, columns=length // shortest) for _, length in STRETCHES_M}

    def faces(self, ego_m: float) -> Iterator[Face]:
        """Pieces of road and houses from the camera on, in its frame but with the road at y = 0."""
        across = 2 * WALL_X_M
        for start_m, length in stretches(ego_m):
            z_near, z_far = start_m - ego_m, start_m + length - ego_m
            road, left, right = self._roads[length], self._lefts[length], self._rights[length]
            rows = _from_the_end(_span(road.shape[0], start_m, length), road.shape[0])
            yield _face((-WALL_X_M, 0, z_far), (across, 0, 0), (0, 0, -length), road[rows])
            wall = (0.0, WALL_HEIGHT_M, 0.0)
            columns = _span(left.shape[1], start_m, length)
            yield _face((-WALL_X_M, -WALL_HEIGHT_M, z_near), (0, 0, length), wall, left[:, columns])
            columns = _from_the_end(columns, right.shape[1])
            yield _face((WALL_X_M, -WALL_HEIGHT_M, z_far), (0, 0, -length), wall, right[:, columns])


def stretches(ego_m: float) -> Iterator[tuple[float, int]]:
    """(start, length) in metres of stretches that touch each other, from just behind the camera to `FAR_M` ahead."""
    start_m = float(np.floor(ego_m / STRETCHES_M[0][1])) * STRETCHES_M[0][1]
    while start_m - ego_m < FAR_M:
        fitting = [length for from_m, length in STRETCHES_M if start_m - ego_m >= from_m and start_m % length == 0.0]
        length = max(fitting, default=STRETCHES_M[0][1])
        yield start_m, length
        start_m += length


def _shortened(texture: Image, *, rows: int = 1, columns: int = 1) -> Image:
    """The picture with that many rows and columns averaged into one."""
    size_px = (texture.shape[1] // columns, texture.shape[0] // rows)
    return np.asarray(cv2.resize(texture, size_px, interpolation=cv2.INTER_AREA), np.uint8)


def _span(n_texels: int, start_m: float, length_m: float) -> slice:
    """Where a stretch lies in a texture that repeats every `PERIOD_M` (no stretch crosses its end)."""
    first = round(start_m % PERIOD_M / PERIOD_M * n_texels)
    return slice(first, first + round(length_m / PERIOD_M * n_texels))


def _from_the_end(span: slice, n_texels: int) -> slice:
    """The same span of a texture stored the other way round."""
    return slice(n_texels - span.stop, n_texels - span.start)


def _face(
    corner: tuple[float, float, float],
    along: tuple[float, float, float],
    down: tuple[float, float, float],
    texture: Image,
) -> Face:
    return Face(np.array(corner, np.float64), np.array(along, np.float64), np.array(down, np.float64), texture)
