"""What stands still under and beside the traffic: the ground, houses or woods on either side, rails, trees, lamps.

Ground and sides repeat every `PERIOD_M`. They are handed out in stretches that end at fixed places of the world, so
that every piece shows the same part of its picture in every frame; farther stretches are longer, and come from pictures
that were averaged along the road beforehand by the same factor, since perspective shortens them by more than that.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.render.face_table import FaceTable, joined_tables
from track_range.simulation.render.roadside import Roadside
from track_range.simulation.render.texture_store import TextureStore
from track_range.simulation.world.road_shape import STRAIGHT, RoadShape
from track_range.simulation.world.scenery import ground_picture, houses_picture, rail_picture, woods_picture
from track_range.simulation.world.surroundings import PERIOD_M, SURROUNDINGS

FAR_M = 260.0
SIDE_HEIGHT_M = 9.0
RAIL_HEIGHT_M = 0.8

STRETCHES_M = ((0.0, 3), (24.0, 6), (72.0, 24))
"""From which distance on stretches have which length; each length divides the next, and the last divides the period."""

WINDING_STRETCHES_M = ((0.0, 3), (24.0, 6), (72.0, 12))
"""The same where chords of 24 m would leave the road's bend."""


class Street:
    """The textures of one street, made once; places are in the world's axes.

    Args:
        rng: of the textures.
        store: takes them.
        surroundings: what kind of road.
        road: its shape.
    """

    def __init__(
        self, rng: np.random.Generator, store: TextureStore, surroundings: str = "town", *, road: RoadShape = STRAIGHT
    ) -> None:
        self._kind, self._road = SURROUNDINGS[surroundings], road
        self._stretches_m = STRETCHES_M if road.is_straight else WINDING_STRETCHES_M
        side_picture = houses_picture if self._kind.side == "houses" else woods_picture
        sides = [side_picture(rng, height_m=SIDE_HEIGHT_M) for _ in range(2)]
        parts = [
            self._parts(ground_picture(rng, self._kind)[::-1], axis=0, is_reversed=True),  # far rows first
            self._parts(sides[0], axis=1, is_reversed=False),
            self._parts(sides[1][:, ::-1], axis=1, is_reversed=True),  # seen with far columns first
        ]
        if self._kind.rails_m:
            parts.append(self._parts(rail_picture(rng), axis=1, is_reversed=False))
        which = [0, 1, 2, *([3] * len(self._kind.rails_m))]
        numbers = np.array([[store.add(part) for part in one] for one in zip(*parts, strict=True)], np.int64)
        self._textures = numbers[:, which]
        self._texels = np.array([[part.shape[:2] for part in one] for one in zip(*parts, strict=True)])[:, which]
        self._row_of = {place: row for row, place in enumerate(self._places())}
        self._roadside = Roadside(rng, store, self._kind, road)

    def _places(self) -> list[tuple[float, int]]:
        """All stretches (start, length) of one period."""
        return [(at_m, length) for _, length in self._stretches_m for at_m in np.arange(0, PERIOD_M, length).tolist()]

    def _parts(self, picture: Image, *, axis: int, is_reversed: bool) -> list[Image]:
        """What a picture of the whole period, stored the other way round or not, shows of each stretch."""
        by_length, parts = self._by_length(picture, axis=axis), []
        for start_m, length in self._places():
            whole = by_length[length]
            span = _span(whole.shape[axis], start_m, length)
            span = _from_the_end(span, whole.shape[axis]) if is_reversed else span
            parts.append(whole[span] if axis == 0 else whole[:, span])
        return parts

    def _by_length(self, picture: Image, *, axis: int) -> dict[int, Image]:
        shortest = self._stretches_m[0][1]
        by_length = {length: _shortened(picture, axis, length // shortest) for _, length in self._stretches_m}
        farthest = self._stretches_m[-1][1]  # at 72 m a sample covers two texels of the other axis too
        return by_length | {farthest: _shortened(by_length[farthest], 1 - axis, 2)}

    def faces(self, ego_z_m: float) -> FaceTable:
        """Pieces of ground and sides from the camera on, stretch by stretch, then what stands beside the road."""
        found = list(stretches(ego_z_m, self._stretches_m))
        start_m, length_m = np.array(found, np.float64).T
        near, far = self._middle_m(start_m), self._middle_m(start_m + length_m)
        ahead, zero = far - near, np.zeros_like(near)
        half_m = np.array([self._kind.half_width_m, 0.0, 0.0])
        up, rail_up = np.array([0.0, SIDE_HEIGHT_M, 0.0]), np.array([0.0, RAIL_HEIGHT_M, 0.0])
        rails = [near + np.array([x_m, 0.0, 0.0]) - rail_up for x_m in self._kind.rails_m]
        n_rails = len(rails)
        rows = [self._row_of[at_m % PERIOD_M, length] for at_m, length in found]
        table = FaceTable(
            np.stack([far - half_m, near - half_m - up, far + half_m - up, *rails], axis=1).reshape(-1, 3),
            np.stack([zero + 2 * half_m, ahead, -ahead, *([ahead] * n_rails)], axis=1).reshape(-1, 3),
            np.stack([-ahead, zero + up, zero + up, *([zero + rail_up] * n_rails)], axis=1).reshape(-1, 3),
            self._textures[rows].ravel(),
            self._texels[rows].reshape(-1, 2),
            np.tile(np.arange(3 + n_rails) >= 3, len(found)),
            np.zeros((3 + n_rails) * len(found), np.bool_),
        )
        return joined_tables([table, *self._roadside.faces(ego_z_m)])

    def lamp_heads_m(self, ego_z_m: float) -> FloatArray:
        """(N, 3) where street lamps shine from."""
        return self._roadside.lamp_heads_m(ego_z_m)

    def _middle_m(self, z_m: FloatArray) -> FloatArray:
        return np.stack([self._road.x_m(z_m), self._road.y_m(z_m), z_m], axis=1)


def stretches(ego_m: float, lengths_m: tuple[tuple[float, int], ...] = STRETCHES_M) -> Iterator[tuple[float, int]]:
    """(start, length) in metres of stretches that touch each other, from just behind the camera to `FAR_M` ahead."""
    start_m = float(np.floor(ego_m / lengths_m[0][1])) * lengths_m[0][1]
    while start_m - ego_m < FAR_M:
        fitting = [length for from_m, length in lengths_m if start_m - ego_m >= from_m and start_m % length == 0.0]
        length = max(fitting, default=lengths_m[0][1])
        yield start_m, length
        start_m += length


def _shortened(picture: Image, axis: int, factor: int) -> Image:
    """The picture with that many rows (axis 0) or columns averaged into one."""
    height, width = picture.shape[:2]
    size_px = (width, height // factor) if axis == 0 else (width // factor, height)
    return np.asarray(cv2.resize(picture, size_px, interpolation=cv2.INTER_AREA), np.uint8)


def _span(n_texels: int, start_m: float, length_m: float) -> slice:
    """Where a stretch lies in a picture that repeats every `PERIOD_M` (no stretch crosses its end)."""
    first = round(start_m % PERIOD_M / PERIOD_M * n_texels)
    return slice(first, first + round(length_m / PERIOD_M * n_texels))


def _from_the_end(span: slice, n_texels: int) -> slice:
    """The same span of a picture stored the other way round."""
    return slice(n_texels - span.stop, n_texels - span.start)
