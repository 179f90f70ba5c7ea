"""Textures of static scenery: ground, houses, woods, guard rails, trees, sky; BGRA, alpha 0 where
transparent.
"""

from itertools import pairwise

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import Image
from track_range.simulation.world.surroundings import PAVEMENT, PERIOD_M, Surroundings
from track_range.simulation.world.textures.surfaces import GLASS_BGR, opaque, value_noise

Picture = npt.NDArray[np.float32]  # (H, W, 3) colours of a texture while it is painted
WALL_TEXELS_PER_M = 48  # resolution of houses and guard rails
TREE_TEXELS_PER_M = 32  # resolution of trees
_LINE_HALF_M = 0.07  # half of the width of lane markings
_WHITE = 208.0  # grey level of lane markings


def ground_picture(rng: np.random.Generator, kind: Surroundings) -> Image:
    """Asphalt, markings and verges, seen from above: columns from x = -half_width_m, rows from near
    to far.
    """
    density = kind.texels_per_m
    shape = (round(PERIOD_M * density), round(2 * kind.half_width_m * density))
    x_m = ((np.arange(shape[1]) + 0.5) / density - kind.half_width_m).astype(np.float32)
    z_m = ((np.arange(shape[0]) + 0.5) / density).astype(np.float32)
    grain = value_noise(rng, shape, cells=(2, 4, 8, 16, 32)).astype(np.float32)[:, :, None]
    patches = value_noise(rng, shape, cells=(64, 128, 256)).astype(np.float32)[:, :, None]
    bgr = np.full((*shape, 3), 94.0, np.float32)
    for _, from_m, to_m in kind.lanes:  # two darker wheel tracks
        off_m = np.abs(np.abs(x_m - (from_m + to_m) / 2) - 0.8)
        bgr -= (7.0 * np.exp(-((off_m / 0.3) ** 2)))[None, :, None]
    bgr += 11.0 * grain + 5.0 * patches
    for from_m, to_m, colour in kind.bands:
        band = (x_m >= from_m) & (x_m < to_m)
        rough = 2.2 if colour != PAVEMENT else 1.0
        bgr[:, band] = np.array(colour, np.float32) + rough * (8.0 * grain + 4.0 * patches)[:, band]
        if colour == PAVEMENT:
            slabs = (z_m % 0.75 < 0.04)[:, None] | (x_m[band] % 0.75 < 0.04)[None, :]
            bgr[:, band] -= 26.0 * slabs[:, :, None]
    white = np.zeros(shape, np.bool_)
    for middle_m in kind.solid_m:
        white[:, np.abs(x_m - middle_m) < _LINE_HALF_M] = True
    for middle_m in kind.dashed_m:
        white[
            np.ix_(z_m % kind.dash_m[1] < kind.dash_m[0], np.abs(x_m - middle_m) < _LINE_HALF_M)
        ] = True
    bgr[white] = _WHITE + 8.0 * np.broadcast_to(grain, bgr.shape)[white]
    return opaque(bgr)


def houses_picture(rng: np.random.Generator, *, height_m: float) -> Image:
    """A row of houses of different heights and colours, transparent above the roofs."""
    shape = (round(height_m * WALL_TEXELS_PER_M), round(PERIOD_M * WALL_TEXELS_PER_M))
    fine = value_noise(rng, shape, cells=(2, 4, 8, 16, 32)).astype(np.float32)
    stains = value_noise(rng, shape, cells=(64, 128)).astype(np.float32)
    bgr = np.zeros((*shape, 3), np.float32)
    alpha = np.zeros(shape, np.uint8)
    starts_m = [
        0.0,
        *np.sort(rng.choice(np.arange(1, 6), 3, replace=False) * PERIOD_M / 6).tolist(),
        PERIOD_M,
    ]
    for from_m, to_m in pairwise(starts_m):
        columns = slice(round(from_m * WALL_TEXELS_PER_M), round(to_m * WALL_TEXELS_PER_M))
        top = round(float(rng.uniform(0, 0.4)) * shape[0])
        wall = np.array([128.0, 140.0, 152.0]) + rng.normal(0, 22) + rng.normal(0, 6, 3)
        bgr[:, columns] = wall + (10.0 * fine + 5.0 * stains)[:, columns, None]
        alpha[top:, columns] = 255
        _paint_house(bgr[top:, columns], rng)
    picture = opaque(bgr)
    picture[:, :, 3] = alpha
    return picture


def _paint_house(bgr: Picture, rng: np.random.Generator) -> None:
    """Paint the roof, the windows of each floor, and a ground floor with a door or shop windows."""
    density = WALL_TEXELS_PER_M
    height, width = bgr.shape[:2]
    roof = round(rng.uniform(0.5, 1.4) * density)
    tiles = np.array([66.0, 72.0, 94.0]) + rng.normal(0, 16) + rng.normal(0, 5, 3)
    bgr[:roof] += (tiles - bgr[:roof].mean(axis=(0, 1))).astype(np.float32)
    bgr[2:roof:9] -= 16.0
    bgr[roof : roof + 6] -= 34.0
    is_shop = rng.uniform() < 0.5
    for floor, sill in enumerate(
        range(height - density, roof + round(2.0 * density), -3 * density)
    ):
        broad = 2.0 if is_shop and floor == 0 else float(rng.uniform(0.9, 1.3))
        for left_m in np.arange(0.7, width / density - broad - 0.4, broad + 1.2):
            _paint_window(bgr, rng, (round(left_m * density), sill), round(broad * density))
    door = round(float(rng.uniform(0.1, 0.85)) * width)
    bgr[height - round(2.1 * density) :, door : door + density] = rng.uniform(30, 70) + rng.uniform(
        0, 25, 3
    )


def _paint_window(
    bgr: Picture, rng: np.random.Generator, corner: tuple[int, int], width: int
) -> None:
    """Paint a framed window, darker at the bottom, at its lower left corner; some have a
    curtain.
    """
    left, sill = corner
    top = sill - round(1.5 * WALL_TEXELS_PER_M)
    frame = 4
    bgr[top - frame : sill + frame, left - frame : left + width + frame] = rng.uniform(170, 215)
    fade = np.linspace(46.0, 0.0, sill - top, dtype=np.float32)[:, None, None]
    bgr[top:sill, left : left + width] = (
        np.array(GLASS_BGR, np.float32) + fade + float(rng.uniform(-8, 25))
    )
    if rng.uniform() < 0.35:
        bgr[top : sill - 20, left : left + width // 4] = rng.uniform(140, 190, 3)
    bgr[top:sill, left + width // 2 - 2 : left + width // 2 + 2] = 190.0
    bgr[sill + frame : sill + frame + 5, left - 8 : left + width + 8] -= 40.0


def woods_picture(rng: np.random.Generator, *, height_m: float) -> Image:
    """The edge of a wood, transparent above the crowns."""
    density = WALL_TEXELS_PER_M // 2
    shape = (round(height_m * density), round(PERIOD_M * density))
    leaves = value_noise(rng, shape, cells=(2, 4, 8, 16)).astype(np.float32)
    crowns = value_noise(rng, shape, cells=(32, 64, 96)).astype(np.float32)
    depth = np.linspace(1.0, 0.55, shape[0], dtype=np.float32)[:, None, None]
    bgr = (
        np.array([44.0, 88.0, 70.0], np.float32) + (13.0 * leaves + 11.0 * crowns)[:, :, None]
    ) * depth
    picture = opaque(bgr)
    outline = value_noise(rng, (2, shape[1]), cells=(16, 48, 96))[0] * 0.12 + 0.3
    fringe = value_noise(rng, shape, cells=(4, 8)) * 0.02
    rows = np.arange(shape[0])[:, None] / shape[0]
    picture[:, :, 3] = np.where(rows + fringe > outline[None, :], 255, 0)
    return picture


def rail_picture(rng: np.random.Generator) -> Image:
    """A guard rail 0.8 m high: a ribbed band on posts every 2 m, otherwise transparent."""
    density = WALL_TEXELS_PER_M
    shape = (round(0.8 * density), round(PERIOD_M * density))
    dirt = 7.0 * value_noise(rng, shape, cells=(2, 4, 8, 32)).astype(np.float32)[:, :, None]
    rows = np.arange(shape[0]) / density
    ribs = 28.0 * np.sin(rows * 2 * np.pi / 0.16).astype(np.float32)
    picture = opaque(np.full((*shape, 3), 158.0, np.float32) + ribs[:, None, None] + dirt)
    is_post = np.arange(shape[1]) / density % 2.0 < 0.12
    picture[:, :, 3] = np.where((rows < 0.32)[:, None] | is_post[None, :], 255, 0)
    return picture


def tree_picture(rng: np.random.Generator) -> Image:
    """A broadleaf tree 4.5 m wide and 6.5 m high: clumps of leaves with gaps, and a trunk."""
    height, width = round(6.5 * TREE_TEXELS_PER_M), round(4.5 * TREE_TEXELS_PER_M)
    leaves = value_noise(rng, (height, width), cells=(2, 4, 8))
    clumps = value_noise(rng, (height, width), cells=(12, 24, 48))
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    radius = np.hypot((x / width - 0.5) / 0.46, (y / height - 0.4) / 0.38)
    light = 1.25 - 0.75 * (y / height) + 0.2 * (x / width - 0.5)
    hue = np.array([40.0, 98.0, 74.0]) + rng.normal(0, 9, 3)
    bgr = hue * light[:, :, None] + (15.0 * leaves + 12.0 * clumps)[:, :, None]
    is_crown = radius + 0.12 * clumps + 0.06 * leaves < 0.95
    is_trunk = (np.abs(x / width - 0.5) < 0.03) & (y / height > 0.6)
    bgr = np.where(
        (is_trunk & ~is_crown)[:, :, None],
        np.array([48.0, 62.0, 76.0]) + 9.0 * leaves[:, :, None],
        bgr,
    )
    picture = opaque(bgr)
    picture[:, :, 3] = np.where(is_crown | is_trunk, 255, 0)
    return picture


def sky_picture(
    rng: np.random.Generator, *, size_px: tuple[int, int], horizon_px: float, is_night: bool
) -> Image:
    """The background without parallax: clouds, a distant line of trees, haze below the horizon.

    (H / 2, W / 2, 4) for the size `size_px` (width, height); the sky has no detail that needs more.
    """
    width, height = size_px[0] // 2, size_px[1] // 2
    horizon = horizon_px / 2
    y = np.arange(height, dtype=np.float32)[:, None]
    fraction = np.clip(y / max(horizon, 1.0), 0, 1)[:, :, None]
    above, below = (
        np.array([232.0, 196.0, 158.0], np.float32),
        np.array([238.0, 232.0, 226.0], np.float32),
    )
    # clouds: value noise, smoothed to hide its grid and stretched horizontally
    small = cv2.GaussianBlur(
        value_noise(rng, (max(4, height // 8), max(4, width // 24)), cells=(2, 4, 8, 16)),
        (0, 0),
        1.0,
    )
    noise = cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)
    clouds = np.clip(noise, -0.6, 2).astype(np.float32)[:, :, None]
    sky = above * (1 - fraction) + below * fraction + (7.0 + 10.0 * (1 - fraction)) * clouds
    ridge = horizon - height * (0.022 + 0.008 * value_noise(rng, (2, width), cells=(4, 10, 30))[0])
    grain = value_noise(rng, (height, width), cells=(2, 4, 8)).astype(np.float32)[:, :, None]
    trees = np.array([112.0, 122.0, 112.0], np.float32) + 6.0 * grain
    picture = np.where((y >= ridge[None, :])[:, :, None], trees, sky)
    return opaque(picture * np.array([0.07, 0.055, 0.05], np.float32) if is_night else picture)
