"""Street: the static surroundings of the traffic: ground, houses or woods on either side, rails,
trees and lamps.

Ground and sides repeat every `PERIOD_M`. They are drawn in stretches that end at fixed positions in
the world, so that every stretch has the same part of the texture in every frame. Farther stretches
are longer, and use textures that are averaged along the road by the same factor, since perspective
shortens them by more than that.
"""

from collections.abc import Iterator
from functools import cache

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.simulation.render.face_table import (
    FaceTable,
    TextureStore,
    joined_tables,
    unlabelled_faces,
)
from track_range.simulation.world.road_shape import STRAIGHT, RoadShape, yaw_rotation
from track_range.simulation.world.surroundings import PERIOD_M, SURROUNDINGS, Row, Surroundings
from track_range.simulation.world.textures import scenery
from track_range.simulation.world.textures.surfaces import plain, value_noise

FAR_M = 260.0  # distance up to which the street is drawn
SIDE_HEIGHT_M, RAIL_HEIGHT_M = 9.0, 0.8  # heights of the houses or woods, and of guard rails
# (distance, length); each length divides the next, the last the period
STRETCHES_M = ((0.0, 3), (24.0, 6), (72.0, 24))
# on winding roads, from which chords of 24 m deviate
WINDING_STRETCHES_M = ((0.0, 3), (24.0, 6), (72.0, 12))
# number, size by start in the period and length
_Textures = dict[tuple[float, int], tuple[int, tuple[int, ...]]]


class Street:
    """The faces of one street in world axes; textures are created once. `surroundings` is a key of
    `SURROUNDINGS`.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        store: TextureStore,
        surroundings: str = "town",
        *,
        road: RoadShape = STRAIGHT,
    ) -> None:
        self._road_type, self._road, self._store = SURROUNDINGS[surroundings], road, store
        self._half_width_m = self._road.widening * self._road_type.half_width_m
        self._stretches_m = STRETCHES_M if road.is_straight else WINDING_STRETCHES_M
        side_picture = (
            scenery.houses_picture if self._road_type.side == "houses" else scenery.woods_picture
        )
        left, right = (side_picture(rng, height_m=SIDE_HEIGHT_M) for _ in range(2))
        self._strips = [
            self._textures(
                scenery.ground_picture(rng, self._road_type)[::-1], axis=0, is_far_first=True
            ),
            self._textures(left, axis=1, is_far_first=False),
            self._textures(right[:, ::-1], axis=1, is_far_first=True),
        ]
        if rails_m := self._road_type.rails_m:
            self._strips += [
                self._textures(scenery.rail_picture(rng), axis=1, is_far_first=False)
            ] * len(rails_m)
        self.roadside = Roadside(rng, store, self._road_type, road)

    def _textures(self, picture: Image, *, axis: int, is_far_first: bool) -> _Textures:
        """The parts of a texture of the whole period, whose rows (axis 0) or columns (1) are along
        the road.
        """
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

    def faces(self, ego_z_m: float, camera_yaw_rad: float = 0.0) -> FaceTable:
        """The faces of ground and sides from the camera onwards, stretch by stretch, then the
        roadside objects; also those behind the car for a camera that looks aside or back, by
        `camera_yaw_rad` to the left of the road's direction.
        """
        visible = list(stretches(ego_z_m, self._stretches_m, is_behind_too=camera_yaw_rad != 0))
        start_m, length_m = np.array(visible, np.float64).T
        near, far = self._middle_m(start_m), self._middle_m(start_m + length_m)
        ahead, half_m = far - near, np.array([self._half_width_m, 0.0, 0.0])
        up, rail_up = np.array([0.0, SIDE_HEIGHT_M, 0.0]), np.array([0.0, RAIL_HEIGHT_M, 0.0])
        strips = [
            (far - half_m, 2 * half_m, -ahead),
            (near - half_m - up, ahead, up),
            (far + half_m - up, -ahead, up),
            *(
                (near + np.array([self._road.widening * x_m, 0.0, 0.0]) - rail_up, ahead, rail_up)
                for x_m in self._road_type.rails_m
            ),
        ]
        corner, along, down = (
            np.stack([np.broadcast_to(vectors, near.shape) for vectors in part], axis=1).reshape(
                -1, 3
            )
            for part in zip(*strips, strict=True)
        )
        textures = [
            strip[z_m % PERIOD_M, length] for z_m, length in visible for strip in self._strips
        ]
        table = unlabelled_faces(
            (corner, along, down),
            np.array([number for number, _ in textures], np.int64),
            np.array([texels for _, texels in textures], np.int64),
            two_sided=np.tile(np.arange(len(strips)) >= 3, len(visible)),
        )
        return joined_tables([table, *self.roadside.faces(ego_z_m, camera_yaw_rad)])

    def _middle_m(self, z_m: FloatArray) -> FloatArray:
        return np.stack([self._road.x_m(z_m), self._road.y_m(z_m), z_m], axis=1)


def stretches(
    ego_m: float,
    lengths_m: tuple[tuple[float, int], ...] = STRETCHES_M,
    *,
    is_behind_too: bool = False,
) -> Iterator[tuple[float, int]]:
    """(start, length) in metres of adjacent stretches, from just behind the camera, or from
    `FAR_M` behind it, to `FAR_M` ahead.
    """
    first_m = ego_m - FAR_M if is_behind_too else ego_m
    start_m = float(np.floor(first_m / lengths_m[0][1])) * lengths_m[0][1]
    while start_m - ego_m < FAR_M:
        fitting = [
            length
            for from_m, length in lengths_m
            if max(start_m - ego_m, ego_m - start_m - length) >= from_m and start_m % length == 0.0
        ]
        length = max(fitting, default=lengths_m[0][1])
        yield start_m, length
        start_m += length


def _shortened(picture: Image, axis: int, factor: int) -> Image:
    """The texture with `factor` rows (axis 0) or columns (axis 1) averaged into one."""
    height, width = picture.shape[:2]
    size_px = (width, height // factor) if axis == 0 else (width // factor, height)
    return np.asarray(cv2.resize(picture, size_px, interpolation=cv2.INTER_AREA), np.uint8)


VISIBLE_M = 130.0  # distance up to which objects are drawn
N_TREES = 3  # number of different tree textures
# mean width and height
TREE_M, LAMP_M, POST_M = np.array([4.5, 6.5]), np.array([2.2, 7.5]), np.array([0.12, 1.0])
_STEEL = (96.0, 98.0, 96.0)


class Roadside:
    """Trees, lamps and posts of one street: flat cut-outs that face the traffic, at regular
    intervals.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        store: TextureStore,
        road_type: Surroundings,
        road: RoadShape,
    ) -> None:
        self._rows, self._road = road_type.rows, road
        has_trees = any(row.kind == "tree" for row in self._rows)
        trees = [scenery.tree_picture(rng) for _ in range(N_TREES)] if has_trees else []
        lamp, post = _lamp_picture(rng), _post_picture(rng)
        pictures = {"tree": trees, "lamp": [lamp[:, ::-1], lamp], "post": [post]}
        self._shade = store.add(_leaf_shadow())
        self._numbers = {
            name: np.array([store.add(image) for image in group])
            for name, group in pictures.items()
        }
        self._texels = {name: group[0].shape[:2] for name, group in pictures.items() if group}

    def faces(self, ego_z_m: float, camera_yaw_rad: float = 0.0) -> list[FaceTable]:
        """The faces that the camera may see, in world axes: shadows of trees first, then all
        objects.
        """
        numbers = [_numbers(row, ego_z_m, camera_yaw_rad != 0) for row in self._rows]
        rows = list(zip(self._rows, numbers, strict=True))
        shadows = [self._shadows(row, which) for row, which in rows if row.kind == "tree"]
        return [*shadows, *(self._objects(row, which, camera_yaw_rad) for row, which in rows)]

    def lamp_heads_m(self, ego_z_m: float) -> FloatArray:
        """(N, 3) positions of the lamp heads in world axes."""
        heads = [
            self._on_ground_m(row.x_m, _positions_m(row, _numbers(row, ego_z_m)))
            + np.array([-np.sign(row.x_m) * 1.6, -LAMP_M[1] + 0.25, 0])
            for row in self._rows
            if row.kind == "lamp"
        ]
        return np.concatenate([np.zeros((0, 3)), *heads])

    def _shadows(self, row: Row, numbers: IntArray) -> FaceTable:
        """The shadows of a row of trees, as wide as the crowns, on the ground to their left, away
        from the sun.
        """
        reach = TREE_M[0] * _growth(row, numbers)
        z_m = _positions_m(row, numbers)
        far, near = (
            self._on_ground_m(row.x_m - 0.3 * reach, z_m + half) for half in (reach / 2, -reach / 2)
        )
        along, above = np.zeros_like(far), np.array([0.0, -0.02, 0.0])
        along[:, 0] = 1.3 * reach
        vectors = (far - along / 2 + above, along, near - far)
        return unlabelled_faces(
            vectors, np.full(len(numbers), self._shade), _leaf_shadow().shape, is_shadow=True
        )

    def _objects(self, row: Row, numbers: IntArray, camera_yaw_rad: float) -> FaceTable:
        """The objects `numbers` of a row, turned with the camera's mounting."""
        foot, size_m, which = (
            self._on_ground_m(row.x_m, _positions_m(row, numbers)),
            POST_M[None],
            0 * numbers,
        )
        if row.kind == "tree":
            size_m, which = TREE_M * _growth(row, numbers)[:, None], numbers % N_TREES
        elif row.kind == "lamp":
            foot[:, 0] -= np.sign(row.x_m) * (LAMP_M[0] / 2 - 0.1)
            size_m, which = LAMP_M[None], which + int(row.x_m > 0)
        along, down = np.zeros_like(foot), np.zeros_like(foot)
        along[:, 0], down[:, 1] = size_m[:, 0], size_m[:, 1]
        along = along @ yaw_rotation(-camera_yaw_rad).T
        vectors = (foot - along / 2 - down, along, down)
        return unlabelled_faces(vectors, self._numbers[row.kind][which], self._texels[row.kind])

    def _on_ground_m(self, across_m: FloatArray | float, z_m: FloatArray) -> FloatArray:
        """(N, 3) positions on the ground in world axes."""
        return np.stack([self._road.x_m(z_m, across_m), self._road.y_m(z_m), z_m], axis=1)


def _numbers(row: Row, ego_z_m: float, is_behind_too: bool = False) -> IntArray:
    """The numbers of the objects of a row that are near enough to draw, ahead or all."""
    from_m = ego_z_m - VISIBLE_M if is_behind_too else ego_z_m + 1.0
    first = int(np.ceil((from_m - row.first_m) / row.every_m))
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
    dark = (
        105
        * np.clip(1.9 - 2.0 * np.hypot(x, y) - 0.16 * spots, 0, 1)
        * (1 - 0.12 * np.clip(spots, 0, 2))
    )
    return np.asarray(np.clip(dark, 0, 255), np.uint8)


def _lamp_picture(rng: np.random.Generator) -> Image:
    """Texture of a street lamp: a mast at the right edge, an arm to the left with a head; the rest
    is transparent.
    """
    picture = plain(rng, (LAMP_M[0], LAMP_M[1]), _STEEL, contrast=5.0)
    height, width = picture.shape[:2]
    alpha = np.zeros((height, width), np.uint8)
    alpha[round(0.03 * height) :, round(0.93 * width) : round(0.985 * width)] = 255
    alpha[
        round(0.02 * height) : round(0.034 * height), round(0.1 * width) : round(0.985 * width)
    ] = 255
    alpha[
        round(0.02 * height) : round(0.045 * height), round(0.06 * width) : round(0.34 * width)
    ] = 255
    picture[:, :, 3] = alpha
    return np.asarray(
        cv2.resize(picture, (width // 2, height // 2), interpolation=cv2.INTER_AREA), np.uint8
    )


def _post_picture(rng: np.random.Generator) -> Image:
    """Texture of a white delineator post with a black band and a reflector."""
    picture = plain(rng, (POST_M[0], POST_M[1]), (214.0, 216.0, 216.0), contrast=4.0)
    height = picture.shape[0]
    picture[round(0.18 * height) : round(0.42 * height), :, :3] = 30
    picture[round(0.24 * height) : round(0.36 * height), :, :3] = (40, 120, 230)
    return picture
