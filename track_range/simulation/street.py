"""What stands still under and beside the traffic: the ground, houses or woods on either side, rails, trees, lamps.

Ground and sides repeat every `PERIOD_M`. They are handed out in stretches that end at fixed places of the world, so
that every piece shows the same part of its picture in every frame; farther stretches are longer, and come from pictures
that were averaged along the road beforehand by the same factor, since perspective shortens them by more than that.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from detection.detections import FloatArray, Image
from track_range.simulation.faces import Face
from track_range.simulation.road_shape import STRAIGHT, RoadShape
from track_range.simulation.roadside import Roadside
from track_range.simulation.scenery import ground_picture, houses_picture, rail_picture, woods_picture
from track_range.simulation.surroundings import PERIOD_M, SURROUNDINGS

FAR_M = 260.0
SIDE_HEIGHT_M = 9.0
RAIL_HEIGHT_M = 0.8

STRETCHES_M = ((0.0, 3), (24.0, 6), (72.0, 24))
"""From which distance on stretches have which length; each length divides the next, and the last divides the period."""

WINDING_STRETCHES_M = ((0.0, 3), (24.0, 6), (72.0, 12))
"""The same where chords of 24 m would leave the road's bend."""


class Street:
    """The textures of one street, made once; places are in the world's axes."""

    def __init__(self, rng: np.random.Generator, surroundings: str = "town", road: RoadShape = STRAIGHT) -> None:
        self._kind, self._road = SURROUNDINGS[surroundings], road
        self._stretches_m = STRETCHES_M if road.is_straight else WINDING_STRETCHES_M
        side_picture = houses_picture if self._kind.side == "houses" else woods_picture
        sides = [side_picture(rng, height_m=SIDE_HEIGHT_M) for _ in range(2)]
        self._grounds = self._by_length(ground_picture(rng, self._kind)[::-1], axis=0)  # far rows first
        self._lefts = self._by_length(sides[0], axis=1)
        self._rights = self._by_length(sides[1][:, ::-1], axis=1)  # seen with far columns first
        self._rails = self._by_length(rail_picture(rng), axis=1) if self._kind.rails_m else {}
        self._roadside = Roadside(rng, self._kind, road)

    def _by_length(self, picture: Image, *, axis: int) -> dict[int, Image]:
        shortest = self._stretches_m[0][1]
        by_length = {length: _shortened(picture, axis, length // shortest) for _, length in self._stretches_m}
        farthest = self._stretches_m[-1][1]  # at 72 m a sample covers two texels of the other axis too
        return by_length | {farthest: _shortened(by_length[farthest], 1 - axis, 2)}

    def faces(self, ego_z_m: float) -> Iterator[Face]:
        """Pieces of ground and sides from the camera on."""
        for start_m, length in stretches(ego_z_m, self._stretches_m):
            near, far = (self._middle_m(start_m), self._middle_m(start_m + length))
            yield self._ground(near, far, start_m, length)
            yield from self._sides(near, far, start_m, length)
        yield from self._roadside.faces(ego_z_m)

    def lamp_heads_m(self, ego_z_m: float) -> FloatArray:
        """(N, 3) where street lamps shine from."""
        return self._roadside.lamp_heads_m(ego_z_m)

    def _middle_m(self, z_m: float) -> FloatArray:
        at = np.array(z_m)
        return np.array([self._road.x_m(at), self._road.y_m(at), z_m], np.float64)

    def _ground(self, near: FloatArray, far: FloatArray, start_m: float, length: int) -> Face:
        picture, half_m = self._grounds[length], self._kind.half_width_m
        rows = _from_the_end(_span(picture.shape[0], start_m, length), picture.shape[0])
        return Face(far + np.array([-half_m, 0, 0]), np.array([2 * half_m, 0, 0]), near - far, picture[rows])

    def _sides(self, near: FloatArray, far: FloatArray, start_m: float, length: int) -> Iterator[Face]:
        half_m, left, right = self._kind.half_width_m, self._lefts[length], self._rights[length]
        columns = _span(left.shape[1], start_m, length)
        down = np.array([0.0, SIDE_HEIGHT_M, 0.0])
        yield Face(near + np.array([-half_m, -SIDE_HEIGHT_M, 0]), far - near, down, left[:, columns])
        columns = _from_the_end(columns, right.shape[1])
        yield Face(far + np.array([half_m, -SIDE_HEIGHT_M, 0]), near - far, down, right[:, columns])
        for x_m in self._kind.rails_m:
            picture = self._rails[length]
            corner = near + np.array([x_m, -RAIL_HEIGHT_M, 0])
            part = picture[:, _span(picture.shape[1], start_m, length)]
            yield Face(corner, far - near, np.array([0.0, RAIL_HEIGHT_M, 0.0]), part, two_sided=True)


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
