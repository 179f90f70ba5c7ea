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
from track_range.simulation.render.face_table import FaceTable, joined_tables
from track_range.simulation.render.roadside import Roadside
from track_range.simulation.render.texture_store import TextureStore
from track_range.simulation.world.road_shape import STRAIGHT, RoadShape
from track_range.simulation.world.surroundings import PERIOD_M, SURROUNDINGS
from track_range.simulation.world.textures.scenery import ground_picture, houses_picture, rail_picture, woods_picture

FAR_M = 260.0
"""Distance up to which the street is drawn."""

SIDE_HEIGHT_M = 9.0
"""Height of the houses or woods."""

RAIL_HEIGHT_M = 0.8
"""Height of guard rails."""

STRETCHES_M = ((0.0, 3), (24.0, 6), (72.0, 24))
"""(distance, length) of stretches; each length divides the next, and the last one divides the period."""

WINDING_STRETCHES_M = ((0.0, 3), (24.0, 6), (72.0, 12))
"""`STRETCHES_M` for winding roads; chords of 24 m would deviate too much from them."""


class Street:
    """The faces of one street in world axes; textures are created once.

    Args:
        rng: random generator of the textures.
        store: stores the textures.
        surroundings: kind of road, a key of `SURROUNDINGS`.
        road: shape of the road.
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
            self._parts(sides[1][:, ::-1], axis=1, is_reversed=True),  # far columns first
        ]
        if self._kind.rails_m:
            parts.append(self._parts(rail_picture(rng), axis=1, is_reversed=False))
        which = [0, 1, 2, *([3] * len(self._kind.rails_m))]
        by_stretch = list(zip(*parts, strict=True))
        numbers = np.array([[store.add(part) for part in stretch] for stretch in by_stretch], np.int64)
        self._textures = numbers[:, which]
        self._texels = np.array([[part.shape[:2] for part in stretch] for stretch in by_stretch])[:, which]
        self._row_of = {stretch: row for row, stretch in enumerate(self._period())}
        self._roadside = Roadside(rng, store, self._kind, road)

    def _period(self) -> list[tuple[float, int]]:
        """(start, length) of all stretches of one period."""
        return [(z_m, length) for _, length in self._stretches_m for z_m in np.arange(0, PERIOD_M, length).tolist()]

    def _parts(self, picture: Image, *, axis: int, is_reversed: bool) -> list[Image]:
        """The parts of a texture of the whole period for each stretch; `is_reversed`: its far end comes first."""
        by_length, parts = self._by_length(picture, axis=axis), []
        for start_m, length in self._period():
            whole = by_length[length]
            span = _span(whole.shape[axis], start_m, length)
            span = _reversed_span(span, whole.shape[axis]) if is_reversed else span
            parts.append(whole[span] if axis == 0 else whole[:, span])
        return parts

    def _by_length(self, picture: Image, *, axis: int) -> dict[int, Image]:
        """A texture averaged along the road for each length of stretches."""
        shortest = self._stretches_m[0][1]
        by_length = {length: _shortened(picture, axis, length // shortest) for _, length in self._stretches_m}
        farthest = self._stretches_m[-1][1]  # from 72 m on, a sample covers two texels of the other axis too
        return by_length | {farthest: _shortened(by_length[farthest], 1 - axis, 2)}

    def faces(self, ego_z_m: float) -> FaceTable:
        """The faces of ground and sides from the camera onwards, stretch by stretch, then the roadside objects."""
        visible = list(stretches(ego_z_m, self._stretches_m))
        start_m, length_m = np.array(visible, np.float64).T
        near, far = self._middle_m(start_m), self._middle_m(start_m + length_m)
        ahead, zero = far - near, np.zeros_like(near)
        half_m = np.array([self._kind.half_width_m, 0.0, 0.0])
        up, rail_up = np.array([0.0, SIDE_HEIGHT_M, 0.0]), np.array([0.0, RAIL_HEIGHT_M, 0.0])
        rails = [near + np.array([x_m, 0.0, 0.0]) - rail_up for x_m in self._kind.rails_m]
        n_rails = len(rails)
        rows = [self._row_of[z_m % PERIOD_M, length] for z_m, length in visible]
        table = FaceTable(
            np.stack([far - half_m, near - half_m - up, far + half_m - up, *rails], axis=1).reshape(-1, 3),
            np.stack([zero + 2 * half_m, ahead, -ahead, *([ahead] * n_rails)], axis=1).reshape(-1, 3),
            np.stack([-ahead, zero + up, zero + up, *([zero + rail_up] * n_rails)], axis=1).reshape(-1, 3),
            self._textures[rows].ravel(),
            self._texels[rows].reshape(-1, 2),
            np.tile(np.arange(3 + n_rails) >= 3, len(visible)),
            np.zeros((3 + n_rails) * len(visible), np.bool_),
            np.zeros((3 + n_rails) * len(visible), np.int64),
        )
        return joined_tables([table, *self._roadside.faces(ego_z_m)])

    def lamp_heads_m(self, ego_z_m: float) -> FloatArray:
        """(N, 3) positions of the heads of the street lamps in world axes."""
        return self._roadside.lamp_heads_m(ego_z_m)

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


def _span(n_texels: int, start_m: float, length_m: float) -> slice:
    """The texels of a stretch in a texture that repeats every `PERIOD_M`; no stretch crosses its end."""
    first = round(start_m % PERIOD_M / PERIOD_M * n_texels)
    return slice(first, first + round(length_m / PERIOD_M * n_texels))


def _reversed_span(span: slice, n_texels: int) -> slice:
    """The same texels in the reversed texture."""
    return slice(n_texels - span.stop, n_texels - span.start)
