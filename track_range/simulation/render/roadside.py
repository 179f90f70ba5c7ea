"""Roadside: trees, lamps and posts along a street, as flat cut-outs that face the traffic at regular intervals."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.simulation.render.face_table import FaceTable, unlabelled_faces
from track_range.simulation.render.texture_store import TextureStore
from track_range.simulation.world.road_shape import RoadShape
from track_range.simulation.world.surroundings import Row, Surroundings
from track_range.simulation.world.textures.scenery import tree_picture
from track_range.simulation.world.textures.surfaces import plain, value_noise

VISIBLE_M = 130.0  # distance up to which objects are drawn
N_TREES = 3  # number of different tree textures

TREE_M, LAMP_M, POST_M = np.array([4.5, 6.5]), np.array([2.2, 7.5]), np.array([0.12, 1.0])
"""Mean width and height of a tree, and those of a lamp, whose head is above the road, and of a post."""

_STEEL = (96.0, 98.0, 96.0)


class Roadside:
    """The rows of trees, lamps and posts of one street."""

    def __init__(self, rng: np.random.Generator, store: TextureStore, road_type: Surroundings, road: RoadShape) -> None:
        self._rows, self._road = road_type.rows, road
        has_trees = any(row.kind == "tree" for row in self._rows)
        trees = [tree_picture(rng) for _ in range(N_TREES)] if has_trees else []
        lamp, post = _lamp_picture(rng), _post_picture(rng)
        pictures = {"tree": trees, "lamp": [lamp[:, ::-1], lamp], "post": [post]}
        self._shade = store.add(_leaf_shadow())
        self._numbers = {name: np.array([store.add(image) for image in group]) for name, group in pictures.items()}
        self._texels = {name: group[0].shape[:2] for name, group in pictures.items() if group}

    def faces(self, ego_z_m: float) -> list[FaceTable]:
        """The faces in front of the camera, in world axes: shadows of trees first, then all objects."""
        shadows = [self._shadows(row, ego_z_m) for row in self._rows if row.kind == "tree"]
        return [*shadows, *(self._objects(row, ego_z_m) for row in self._rows)]

    def lamp_heads_m(self, ego_z_m: float) -> FloatArray:
        """(N, 3) positions of the lamp heads in world axes."""
        heads = [
            self._on_ground_m(row.x_m, _positions_m(row, _numbers(row, ego_z_m)))
            + np.array([-np.sign(row.x_m) * 1.6, -LAMP_M[1] + 0.25, 0])
            for row in self._rows
            if row.kind == "lamp"
        ]
        return np.concatenate([np.zeros((0, 3)), *heads])

    def _shadows(self, row: Row, ego_z_m: float) -> FaceTable:
        """The shadows of a row of trees, as wide as the crowns, on the ground to their left, away from the sun."""
        numbers = _numbers(row, ego_z_m)
        reach = TREE_M[0] * _growth(row, numbers)
        z_m = _positions_m(row, numbers)
        far, near = (self._on_ground_m(row.x_m - 0.3 * reach, z_m + half) for half in (reach / 2, -reach / 2))
        along, above = np.zeros_like(far), np.array([0.0, -0.02, 0.0])
        along[:, 0] = 1.3 * reach
        vectors = (far - along / 2 + above, along, near - far)
        return unlabelled_faces(vectors, np.full(len(numbers), self._shade), _leaf_shadow().shape, is_shadow=True)

    def _objects(self, row: Row, ego_z_m: float) -> FaceTable:
        numbers = _numbers(row, ego_z_m)
        foot, size_m, which = self._on_ground_m(row.x_m, _positions_m(row, numbers)), POST_M[None], 0 * numbers
        if row.kind == "tree":
            size_m, which = TREE_M * _growth(row, numbers)[:, None], numbers % N_TREES
        elif row.kind == "lamp":
            foot[:, 0] -= np.sign(row.x_m) * (LAMP_M[0] / 2 - 0.1)
            size_m, which = LAMP_M[None], which + int(row.x_m > 0)
        along, down = np.zeros_like(foot), np.zeros_like(foot)
        along[:, 0], down[:, 1] = size_m[:, 0], size_m[:, 1]
        vectors = (foot - along / 2 - down, along, down)
        return unlabelled_faces(vectors, self._numbers[row.kind][which], self._texels[row.kind])

    def _on_ground_m(self, across_m: FloatArray | float, z_m: FloatArray) -> FloatArray:
        """(N, 3) positions on the ground in world axes."""
        return np.stack([self._road.x_m(z_m) + across_m, self._road.y_m(z_m), z_m], axis=1)


def _numbers(row: Row, ego_z_m: float) -> IntArray:
    """The numbers of the objects of a row that are ahead and near enough to draw."""
    first = int(np.ceil((ego_z_m + 1.0 - row.first_m) / row.every_m))
    last = int(np.floor((ego_z_m + VISIBLE_M - row.first_m) / row.every_m))
    return np.arange(first, last + 1)


def _positions_m(row: Row, numbers: IntArray) -> FloatArray:
    """(N,) positions along the road of the objects of a row."""
    return row.first_m + numbers.astype(np.float64) * row.every_m


def _growth(row: Row, numbers: IntArray) -> FloatArray:
    """(N,) sizes of a row's trees relative to `TREE_M`; neighbours differ."""
    return np.asarray(0.85 + 0.4 * ((numbers * 7 + round(row.x_m)) % 11 / 10))


@cache
def _leaf_shadow() -> Image:
    """(h, w) uint8 darkness under a crown, soft and with spots of sunlight."""
    rng, shape = np.random.default_rng(10), (96, 128)
    y, x = np.mgrid[-1 : 1 : shape[0] * 1j, -1 : 1 : shape[1] * 1j]
    spots = value_noise(rng, shape, cells=(4, 8, 16))
    dark = 105 * np.clip(1.9 - 2.0 * np.hypot(x, y) - 0.16 * spots, 0, 1) * (1 - 0.12 * np.clip(spots, 0, 2))
    return np.asarray(np.clip(dark, 0, 255), np.uint8)


def _lamp_picture(rng: np.random.Generator) -> Image:
    """Texture of a street lamp: a mast at the right edge, an arm to the left with a head; the rest is transparent."""
    picture = plain(rng, (LAMP_M[0], LAMP_M[1]), _STEEL, contrast=5.0)
    height, width = picture.shape[:2]
    alpha = np.zeros((height, width), np.uint8)
    alpha[round(0.03 * height) :, round(0.93 * width) : round(0.985 * width)] = 255
    alpha[round(0.02 * height) : round(0.034 * height), round(0.1 * width) : round(0.985 * width)] = 255
    alpha[round(0.02 * height) : round(0.045 * height), round(0.06 * width) : round(0.34 * width)] = 255
    picture[:, :, 3] = alpha
    return np.asarray(cv2.resize(picture, (width // 2, height // 2), interpolation=cv2.INTER_AREA), np.uint8)


def _post_picture(rng: np.random.Generator) -> Image:
    """Texture of a white delineator post with a black band and a reflector."""
    picture = plain(rng, (POST_M[0], POST_M[1]), (214.0, 216.0, 216.0), contrast=4.0)
    height = picture.shape[0]
    picture[round(0.18 * height) : round(0.42 * height), :, :3] = 30
    picture[round(0.24 * height) : round(0.36 * height), :, :3] = (40, 120, 230)
    return picture
