"""Trees, lamps and posts along a street: flat cut-outs that face the traffic, again and again at fixed places."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from detection.detections import FloatArray, Image
from track_range.simulation.faces import Face
from track_range.simulation.road_shape import RoadShape
from track_range.simulation.scenery import tree_picture
from track_range.simulation.surroundings import Row, Surroundings
from track_range.simulation.textures import plain

SEEN_M = 130.0
"""Farther ones are not drawn."""

N_TREES = 3
LAMP_M = (2.2, 7.5)
"""Width and height; the head hangs over the road."""

POST_M = (0.12, 1.0)
_STEEL = (96.0, 98.0, 96.0)


class Roadside:
    """The rows of one street."""

    def __init__(self, rng: np.random.Generator, kind: Surroundings, road: RoadShape) -> None:
        self._rows, self._road = kind.rows, road
        kinds = {row.kind for row in kind.rows}
        self._trees = [_halvings(tree_picture(rng)) for _ in range(N_TREES)] if "tree" in kinds else []
        self._lamp = _halvings(_lamp_picture(rng))
        self._post = _halvings(_post_picture(rng))

    def faces(self, ego_z_m: float) -> Iterator[Face]:
        """What stands before the camera, in the world's axes."""
        for row in self._rows:
            first = int(np.ceil((ego_z_m + 1.0 - row.first_m) / row.every_m))
            last = int(np.floor((ego_z_m + SEEN_M - row.first_m) / row.every_m))
            for number in range(first, last + 1):
                z_m = row.first_m + number * row.every_m
                yield self._face(row, number, z_m, coarseness=int(np.clip(np.log2((z_m - ego_z_m) / 20 + 1), 0, 2)))

    def lamp_heads_m(self, ego_z_m: float) -> FloatArray:
        """(N, 3) where the lamps shine from, in the world's axes."""
        heads = [
            self._foot_m(row, z_m) + np.array([-np.sign(row.x_m) * 1.6, -LAMP_M[1] + 0.25, 0])
            for row in self._rows
            if row.kind == "lamp"
            for z_m in np.arange(row.first_m, ego_z_m + SEEN_M, row.every_m)
            if z_m > ego_z_m + 1.0
        ]
        return np.array(heads, np.float64).reshape(-1, 3)

    def _foot_m(self, row: Row, z_m: float) -> FloatArray:
        at = np.array(z_m)
        return np.array([self._road.x_m(at) + row.x_m, self._road.y_m(at), z_m], np.float64)

    def _face(self, row: Row, number: int, z_m: float, *, coarseness: int) -> Face:
        foot = self._foot_m(row, z_m)
        if row.kind == "tree":
            place = (number * 7 + round(row.x_m)) % 11 / 10  # no two neighbours alike
            width, height = 4.5 * (0.85 + 0.4 * place), 6.5 * (0.85 + 0.4 * place)
            return _upright(foot, (width, height), self._trees[number % N_TREES][coarseness])
        if row.kind == "lamp":
            picture = self._lamp[coarseness]
            side = -np.sign(row.x_m) * (LAMP_M[0] / 2 - 0.1)
            return _upright(foot + np.array([side, 0, 0]), LAMP_M, picture if row.x_m > 0 else picture[:, ::-1])
        return _upright(foot, POST_M, self._post[coarseness])


def _upright(foot: FloatArray, size_m: tuple[float, float], picture: Image) -> Face:
    width, height = size_m
    return Face(foot + np.array([-width / 2, -height, 0]), np.array([width, 0, 0]), np.array([0, height, 0]), picture)


def _halvings(picture: Image) -> list[Image]:
    """The picture, then half and a quarter of its texels per side."""
    sizes = [(max(2, picture.shape[1] >> k), max(2, picture.shape[0] >> k)) for k in range(3)]
    return [np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8) for size in sizes]


def _lamp_picture(rng: np.random.Generator) -> Image:
    """A mast at the right edge, an arm to the left and a head at its end; the rest is cut out."""
    picture = plain(rng, (LAMP_M[0], LAMP_M[1]), _STEEL, contrast=5.0)
    height, width = picture.shape[:2]
    kept = np.zeros((height, width), np.uint8)
    kept[round(0.03 * height) :, round(0.93 * width) : round(0.985 * width)] = 255
    kept[round(0.02 * height) : round(0.034 * height), round(0.1 * width) : round(0.985 * width)] = 255
    kept[round(0.02 * height) : round(0.045 * height), round(0.06 * width) : round(0.34 * width)] = 255
    picture[:, :, 3] = kept
    return np.asarray(cv2.resize(picture, (width // 2, height // 2), interpolation=cv2.INTER_AREA), np.uint8)


def _post_picture(rng: np.random.Generator) -> Image:
    """A white post with a black band and a reflector."""
    picture = plain(rng, POST_M, (214.0, 216.0, 216.0), contrast=4.0)
    height = picture.shape[0]
    picture[round(0.18 * height) : round(0.42 * height), :, :3] = 30
    picture[round(0.24 * height) : round(0.36 * height), :, :3] = (40, 120, 230)
    return picture
