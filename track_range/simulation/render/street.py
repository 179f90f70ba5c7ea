"""Street: the static surroundings of the traffic: ground, houses or woods on either side, rails, trees and lamps.

Ground and sides repeat every `PERIOD_M`. They are drawn in stretches that end at fixed positions in the world, so that
every stretch has the same part of the texture in every frame. Farther stretches are longer, and use textures that are
averaged along the road by the same factor, since perspective shortens them by more than that.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.render.face_table import FaceTable, joined_tables, unlabelled_faces
from track_range.simulation.render.roadside import Roadside
from track_range.simulation.render.texture_store import TextureStore
from track_range.simulation.world.road_shape import STRAIGHT, RoadShape
from track_range.simulation.world.surroundings import PERIOD_M, SURROUNDINGS
from track_range.simulation.world.textures.scenery import ground_picture, houses_picture, rail_picture, woods_picture

FAR_M = 260.0  # distance up to which the street is drawn
SIDE_HEIGHT_M, RAIL_HEIGHT_M = 9.0, 0.8  # heights of the houses or woods, and of guard rails

STRETCHES_M = ((0.0, 3), (24.0, 6), (72.0, 24))
"""(distance, length) of stretches; each length divides the next, and the last one divides the period."""

WINDING_STRETCHES_M = ((0.0, 3), (24.0, 6), (72.0, 12))
"""`STRETCHES_M` for winding roads; chords of 24 m would deviate too much from them."""

_Textures = dict[tuple[float, int], tuple[int, tuple[int, ...]]]
"""Number, and rows and columns, of a strip's texture by start of the stretch in its period and length of it."""


class Street:
    """The faces of one street in world axes; textures are created once. `surroundings` is a key of `SURROUNDINGS`."""

    def __init__(
        self, rng: np.random.Generator, store: TextureStore, surroundings: str = "town", *, road: RoadShape = STRAIGHT
    ) -> None:
        self._road_type, self._road, self._store = SURROUNDINGS[surroundings], road, store
        self._stretches_m = STRETCHES_M if road.is_straight else WINDING_STRETCHES_M
        side_picture = houses_picture if self._road_type.side == "houses" else woods_picture
        left, right = (side_picture(rng, height_m=SIDE_HEIGHT_M) for _ in range(2))
        self._strips = [
            self._textures(ground_picture(rng, self._road_type)[::-1], axis=0, is_far_first=True),
            self._textures(left, axis=1, is_far_first=False),
            self._textures(right[:, ::-1], axis=1, is_far_first=True),
        ]
        if rails_m := self._road_type.rails_m:
            self._strips += [self._textures(rail_picture(rng), axis=1, is_far_first=False)] * len(rails_m)
        self.roadside = Roadside(rng, store, self._road_type, road)

    def _textures(self, picture: Image, *, axis: int, is_far_first: bool) -> _Textures:
        """The parts of a texture of the whole period, whose rows (axis 0) or columns (1) are along the road."""
        textures = {}
        shortest, farthest = self._stretches_m[0][1], self._stretches_m[-1][1]
        for _, length in self._stretches_m:
            whole = _shortened(picture, axis, length // shortest)
            if length == farthest:  # from 72 m on, a sample covers two texels of the other axis too
                whole = _shortened(whole, 1 - axis, 2)
            n_texels = whole.shape[axis]
            n_stretch = round(length / PERIOD_M * n_texels)
            for start_m in np.arange(0, PERIOD_M, length).tolist():
                first = round(start_m / PERIOD_M * n_texels)
                first = n_texels - first - n_stretch if is_far_first else first
                part = np.take(whole, range(first, first + n_stretch), axis=axis)
                textures[start_m, length] = self._store.add(part), part.shape[:2]
        return textures

    def faces(self, ego_z_m: float) -> FaceTable:
        """The faces of ground and sides from the camera onwards, stretch by stretch, then the roadside objects."""
        visible = list(stretches(ego_z_m, self._stretches_m))
        start_m, length_m = np.array(visible, np.float64).T
        near, far = self._middle_m(start_m), self._middle_m(start_m + length_m)
        ahead, half_m = far - near, np.array([self._road_type.half_width_m, 0.0, 0.0])
        up, rail_up = np.array([0.0, SIDE_HEIGHT_M, 0.0]), np.array([0.0, RAIL_HEIGHT_M, 0.0])
        strips = [
            (far - half_m, 2 * half_m, -ahead),
            (near - half_m - up, ahead, up),
            (far + half_m - up, -ahead, up),
            *((near + np.array([x_m, 0.0, 0.0]) - rail_up, ahead, rail_up) for x_m in self._road_type.rails_m),
        ]
        corner, along, down = (
            np.stack([np.broadcast_to(vectors, near.shape) for vectors in part], axis=1).reshape(-1, 3)
            for part in zip(*strips, strict=True)
        )
        textures = [strip[z_m % PERIOD_M, length] for z_m, length in visible for strip in self._strips]
        table = unlabelled_faces(
            (corner, along, down),
            np.array([number for number, _ in textures], np.int64),
            np.array([texels for _, texels in textures], np.int64),
            two_sided=np.tile(np.arange(len(strips)) >= 3, len(visible)),
        )
        return joined_tables([table, *self.roadside.faces(ego_z_m)])

    def _middle_m(self, z_m: FloatArray) -> FloatArray:
        return np.stack([self._road.x_m(z_m), self._road.y_m(z_m), z_m], axis=1)


def stretches(ego_m: float, lengths_m: tuple[tuple[float, int], ...] = STRETCHES_M) -> Iterator[tuple[float, int]]:
    """(start, length) in metres of adjacent stretches, from just behind the camera to `FAR_M` ahead."""
    start_m = float(np.floor(ego_m / lengths_m[0][1])) * lengths_m[0][1]
    while start_m - ego_m < FAR_M:
        fitting = [length for from_m, length in lengths_m if start_m - ego_m >= from_m and start_m % length == 0.0]
        length = max(fitting, default=lengths_m[0][1])
        yield start_m, length
        start_m += length


def _shortened(picture: Image, axis: int, factor: int) -> Image:
    """The texture with `factor` rows (axis 0) or columns (axis 1) averaged into one."""
    height, width = picture.shape[:2]
    size_px = (width, height // factor) if axis == 0 else (width // factor, height)
    return np.asarray(cv2.resize(picture, size_px, interpolation=cv2.INTER_AREA), np.uint8)
