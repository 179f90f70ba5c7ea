"""The bodies of obstacles: round poles, fences with gaps, and bushes of several layers of
leaves.
"""

from collections.abc import Callable

import cv2
import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, Image
from track_range.simulation.world.bodies.faces import (
    Colour,
    Face,
    Size,
    block,
    chosen,
    prism,
    shadow,
)
from track_range.simulation.world.scene import Obstacle
from track_range.simulation.world.textures.surfaces import TEXELS_PER_M, opaque, plain, value_noise

# galvanised steel, aluminium, dark paint, wood, green paint, concrete
POLE_COLOURS: tuple[Colour, ...] = (
    *((120, 122, 122), (168, 170, 170), (62, 64, 62)),
    *((58, 84, 108), (50, 66, 46), (150, 156, 160)),
)
# two sorts of wood, white paint, black paint, green paint, steel
FENCE_COLOURS: tuple[Colour, ...] = (
    *((70, 98, 124), (52, 74, 96), (202, 206, 206)),
    *((44, 46, 44), (60, 84, 54), (140, 142, 142)),
)
BAND_M = 0.4  # height of the coloured bands of a striped pole
# width of the posts of a fence and largest distance between them
POST_M, POST_SPACING_M = 0.08, 2.0
N_LAYERS = 6  # number of flat layers of a bush
LEAF_TEXELS_PER_M = 80  # resolution of the leaves of a bush
SHADOW_DARKNESS = 150  # darkness of the shadow under an obstacle, 0 to 255


def body_of_obstacle(obstacle: Obstacle, seed: int) -> list[Face]:
    """The faces of an obstacle in its frame (see `faces`); its appearance depends on the seed and
    its number.
    """
    rng = np.random.default_rng([seed, 8, obstacle.number])
    return [
        *BUILDERS[obstacle.kind](rng, obstacle.size_hwl_m),
        shadow(obstacle.size_hwl_m, under=SHADOW_DARKNESS),
    ]


def pole(rng: np.random.Generator, size_hwl_m: Size) -> list[Face]:
    """A round pole of one colour, with stripes or with a notice."""
    height, width, length = size_hwl_m
    bgr = chosen(rng, POLE_COLOURS)
    extent = (-length / 2, length / 2, 0.0, height, -width / 2, width / 2)
    faces = prism(rng, extent, bgr, contrast=float(rng.uniform(4, 14)))
    style = rng.uniform()
    if style < 0.2:
        stripe = (36.0, 30.0, 180.0) if rng.uniform() < 0.5 else (40.0, 190.0, 230.0)
        n_rows = round(BAND_M * TEXELS_PER_M)
        for face in faces[:-1]:  # every second band is tinted; the dirt remains
            for top in range(0, face.texture.shape[0], 2 * n_rows):
                band = face.texture[top : top + n_rows, :, :3].astype(np.float64)
                face.texture[top : top + n_rows, :, :3] = np.clip(
                    band - band.mean(axis=(0, 1)) + stripe, 0, 255
                )
    elif style < 0.4:
        low_m = float(rng.uniform(0.6, 1.6))
        notice = rng.uniform(60, 235, 3)
        for face in faces[:3]:
            n_rows = face.texture.shape[0]
            low, high = (round((1 - at_m / height) * n_rows) for at_m in (low_m, low_m + 0.35))
            part = face.texture[max(high, 0) : max(low, 0)]
            part[:, :, :3] = np.clip(notice + rng.normal(0, 25, part[:, :, :1].shape), 0, 255)
    return faces


def fence(rng: np.random.Generator, size_hwl_m: Size) -> list[Face]:
    """A fence along x: vertical bars, wooden slats, or horizontal boards, with gaps between them,
    on posts.
    """
    height, width, length = size_hwl_m
    bgr = chosen(rng, FENCE_COLOURS)
    picture = plain(rng, (length, height), bgr, contrast=float(rng.uniform(6, 14)))
    picture[:, :, 3] = 255 * _fence_parts(rng, picture.shape[:2]).astype(np.uint8)
    corner, along, down = (
        np.array([-length / 2, -height, 0.0]),
        np.array([length, 0, 0.0]),
        np.array([0, height, 0.0]),
    )
    panel = Face(corner, along, down, picture, two_sided=True)
    posts = np.linspace(
        -length / 2 + POST_M / 2, length / 2 - POST_M / 2, 1 + int(np.ceil(length / POST_SPACING_M))
    )
    half = min(width, POST_M) / 2
    blocks = [
        block(rng, (x - half, x + half, 0.0, height, -half, half), bgr) for x in posts.tolist()
    ]
    return [panel, *(face for faces in blocks for face in faces.values())]


def bush(rng: np.random.Generator, size_hwl_m: Size) -> list[Face]:
    """A bush: upright layers of leaves at different depths, each with an irregular outline and
    gaps.
    """
    height, width, length = size_hwl_m
    hue = np.array([38.0, 86.0, 62.0]) * float(rng.uniform(0.75, 1.35)) + rng.normal(0, 8, 3)
    faces = []
    for k in range(N_LAYERS):
        fraction = float(rng.uniform(0.55, 1.0))
        layer_m, high_m = fraction * length, float(rng.uniform(0.7, 1.0)) * height
        if k == 0:
            layer_m, high_m = length, height
        left_m = float(rng.uniform(-length / 2, length / 2 - layer_m))
        z_m = (k / (N_LAYERS - 1) - 0.5) * width
        picture = _leaves(rng, (high_m, layer_m), hue)
        corner = np.array([left_m, -high_m, z_m])
        faces.append(
            Face(
                corner,
                np.array([layer_m, 0, 0.0]),
                np.array([0, high_m, 0.0]),
                picture,
                two_sided=True,
            )
        )
    return faces


BUILDERS: dict[str, Callable[[np.random.Generator, Size], list[Face]]] = {
    "pole": pole,
    "fence": fence,
    "bush": bush,
}
"""Function of each kind that creates its faces, without shadow."""


def _fence_parts(rng: np.random.Generator, shape: tuple[int, int]) -> BoolArray:
    """(H, W) opaque texels of a fence panel."""
    y_m, x_m = (np.arange(n) / TEXELS_PER_M for n in shape)
    height_m = shape[0] / TEXELS_PER_M
    style = rng.uniform()
    if style < 0.4:  # metal bars between two rails
        bar_m = float(rng.uniform(0.02, 0.04))
        upright = x_m % float(rng.uniform(0.09, 0.15)) < bar_m
        level = (y_m < 0.05) | ((y_m > height_m - 0.16) & (y_m < height_m - 0.11))
    elif style < 0.75:  # wooden slats
        slat_m = float(rng.uniform(0.07, 0.11))
        upright = x_m % (slat_m + float(rng.uniform(0.03, 0.09))) < slat_m
        level = (np.abs(y_m - 0.2 * height_m) < 0.04) | (np.abs(y_m - 0.75 * height_m) < 0.04)
    else:  # horizontal boards
        upright = np.zeros(shape[1], np.bool_)
        board_m = float(rng.uniform(0.09, 0.16))
        level = y_m % (board_m + float(rng.uniform(0.06, 0.2))) < board_m
    return np.asarray(upright[None, :] | level[:, None], np.bool_)


def _leaves(rng: np.random.Generator, size_m: tuple[float, float], hue: FloatArray) -> Image:
    """Texture of one layer of a bush, (height, width) in m; transparent around the crown and in
    gaps.
    """
    height, width = (max(16, round(side * LEAF_TEXELS_PER_M)) for side in size_m)
    leaves = value_noise(rng, (height, width), cells=(2, 4, 8))
    clumps = value_noise(rng, (height, width), cells=(8, 16, 32))
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    across, down = np.abs(2 * x / width - 1), y / height
    light = 1.25 - 0.7 * down
    bgr = hue * light[:, :, None] + (17.0 * leaves + 13.0 * clumps)[:, :, None]
    # straight below, round at the top
    radius = np.hypot(across**1.5, np.clip(1 - down / 0.75, 0, 1) ** 1.3)
    ragged = radius + 0.09 * clumps + 0.05 * leaves
    picture = opaque(bgr)
    picture[:, :, 3] = np.where((ragged < 0.93) & (clumps + 0.6 * leaves < 2.3), 255, 0)
    return np.asarray(
        cv2.copyMakeBorder(picture[1:-1, 1:-1], 1, 1, 1, 1, cv2.BORDER_REPLICATE), np.uint8
    )
