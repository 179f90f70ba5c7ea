"""What surfaces look like: BGRA pictures, alpha 0 where a surface is cut out, with detail at every scale.

Detail at every scale, because a matcher must find some on a car at 6 m as well as at 80 m, where a pixel covers 11 cm:
each octave of the value noise (Perlin, "An image synthesizer", SIGGRAPH 1985) keeps the same contrast.
"""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import numpy.typing as npt

from detection.detections import FloatArray, Image

TEXELS_PER_M = 96
"""Of vehicles and people: the density of a camera with f = 721 px at 7.5 m."""

GROUND_TEXELS_PER_M = 48

GLASS_BGR = (58, 50, 44)
RUBBER_BGR = (30, 30, 32)


def value_noise(rng: np.random.Generator, shape: tuple[int, int], *, cells: tuple[int, ...]) -> FloatArray:
    """(H, W) noise of mean 0 and standard deviation about 1; `cells` are its grains in texels.

    It repeats at its borders where the grains divide the shape.
    """
    height, width = shape
    total: npt.NDArray[np.float32] = np.zeros(shape, np.float32)
    for cell in cells:
        rows, columns = max(2, height // cell), max(2, width // cell)
        grid = np.pad(rng.standard_normal((rows, columns), np.float32), 1, mode="wrap")
        tall, wide = -(-height // rows), -(-width // columns)  # texels per grain, rounded up; the rest is cut off
        grains = cv2.resize(grid, (wide * (columns + 2), tall * (rows + 2)), interpolation=cv2.INTER_LINEAR)
        total += grains[tall : tall + height, wide : wide + width]
    total *= 1.5 / np.sqrt(len(cells))  # bilinear interpolation leaves about 4/9 of the grid's variance
    return total.astype(np.float64)


def opaque(bgr: FloatArray) -> Image:
    """(H, W, 3) colours, rounded and clipped, as BGRA."""
    picture = np.full((*bgr.shape[:2], 4), 255, np.uint8)
    picture[:, :, :3] = np.clip(bgr + 0.5, 0, 255)  # cut to whole numbers: rounded by the half
    return picture


def plain(
    rng: np.random.Generator, size_m: tuple[float, float], bgr: tuple[float, ...], *, contrast: float = 11.0
) -> Image:
    """One colour with dirt and reflections on it; `size_m` is width and height."""
    width, height = (max(4, round(side * TEXELS_PER_M)) for side in size_m)
    noise = value_noise(rng, (height, width), cells=(2, 4, 8, 16, 32, 64))
    return opaque(np.array(bgr) + contrast * noise[:, :, None])


def paint_box(picture: Image, box: tuple[float, float, float, float], bgr: tuple[float, ...]) -> None:
    """Tint a rectangle, given as shares x1, y1, x2, y2 of the picture; the dirt stays on it."""
    height, width = picture.shape[:2]
    x1, y1, x2, y2 = np.rint(np.array(box) * (width, height, width, height)).astype(int).tolist()
    part = picture[y1:y2, x1:x2, :3].astype(np.float64)
    if part.size:
        dirt = part - part.mean(axis=(0, 1))
        picture[y1:y2, x1:x2, :3] = np.clip(dirt + np.array(bgr), 0, 255).astype(np.uint8)


def paint_wheel(picture: Image, centre: tuple[float, float], radius: float) -> None:
    """A tyre and its rim; the centre in shares of the picture, the radius as a share of its height."""
    height, width = picture.shape[:2]
    at = (round(centre[0] * width), round(centre[1] * height))
    cv2.circle(picture, at, round(radius * height), (*RUBBER_BGR, 255), -1, cv2.LINE_AA)
    cv2.circle(picture, at, round(radius * height * 0.6), (150, 150, 150, 255), -1, cv2.LINE_AA)
    for angle_rad in np.arange(5) * 2 * np.pi / 5:
        end = (at[0] + radius * height * 0.6 * np.cos(angle_rad), at[1] + radius * height * 0.6 * np.sin(angle_rad))
        cv2.line(picture, at, (round(end[0]), round(end[1])), (70, 70, 70, 255), 2, cv2.LINE_AA)


def cut_outside(picture: Image, corners: list[tuple[float, float]]) -> None:
    """Keep a convex polygon, its corners in shares of the picture; the rest becomes a hole."""
    height, width = picture.shape[:2]
    inside = np.zeros((height, width), np.uint8)
    cv2.fillConvexPoly(inside, np.rint(np.array(corners) * (width, height)).astype(np.int32), 255)
    picture[:, :, 3] = np.minimum(picture[:, :, 3], inside)


def road_texture(rng: np.random.Generator, *, half_width_m: float, period_m: float) -> Image:
    """Asphalt, lane lines, kerbs and pavements from above: columns from x = -half_width_m, rows from far to near."""
    density = GROUND_TEXELS_PER_M
    shape = (round(period_m * density), round(2 * half_width_m * density))
    x_m = (np.arange(shape[1]) + 0.5) / density - half_width_m
    z_m = (np.arange(shape[0]) + 0.5) / density
    bgr = np.full((*shape, 3), 92.0) + 11.0 * value_noise(rng, shape, cells=(2, 4, 8, 16, 32, 64, 128))[:, :, None]
    pavement = np.abs(x_m) > 7.6
    slab = ((z_m % 0.75 < 0.03)[:, None] | (x_m % 0.75 < 0.03)[None, :]) & pavement
    bgr[:, pavement] += (38.0, 42.0, 46.0)
    bgr[slab] -= 30.0
    bgr[:, (np.abs(x_m) > 7.5) & (np.abs(x_m) <= 7.65)] += 60.0
    worn = value_noise(rng, shape, cells=(4, 8, 32))[:, :, None] * 10.0
    line = np.abs(np.abs(x_m + 1.75) - 0.12) < 0.06  # a double line towards the oncoming lane
    dash = (np.abs(x_m - 1.75) < 0.075)[None, :] & (z_m % 12.0 < 4.0)[:, None]
    edge = np.abs(np.abs(x_m) - 5.3) < 0.06
    white = dash | line[None, :] | edge[None, :]
    return opaque(np.where(white[:, :, None], 205.0 + worn, bgr))


def wall_texture(rng: np.random.Generator, *, height_m: float, period_m: float) -> Image:
    """A row of houses of different heights and colours, with windows and doors; what is above a roof is cut out."""
    density = GROUND_TEXELS_PER_M
    shape = (round(height_m * density), round(period_m * density))
    noise = value_noise(rng, shape, cells=(2, 4, 8, 16, 32, 64, 128))
    bgr = np.zeros((*shape, 3))
    alpha = np.zeros(shape, np.uint8)
    starts_m = [0.0, *np.sort(rng.choice(np.arange(1, 6), 3, replace=False) * period_m / 6).tolist(), period_m]
    for from_m, to_m in pairwise(starts_m):
        columns = slice(round(from_m * density), round(to_m * density))
        top_m = float(rng.uniform(0, 0.5)) * height_m
        base = np.array([118.0, 130.0, 145.0]) + rng.normal(0, 18) + rng.normal(0, 11, 3)
        bgr[:, columns] = base
        alpha[round(top_m * density) :, columns] = 255
        _paint_windows(bgr[:, columns], rng, top_m=top_m, height_m=height_m)
    picture = opaque(bgr + 13.0 * noise[:, :, None])
    picture[:, :, 3] = alpha
    return picture


def _paint_windows(bgr: FloatArray, rng: np.random.Generator, *, top_m: float, height_m: float) -> None:
    """Windows floor by floor, 3 m apart, in the colours of one house (painted in place)."""
    density = GROUND_TEXELS_PER_M
    width_m = bgr.shape[1] / density
    bgr[round(top_m * density) : round((top_m + 0.3) * density)] -= 45.0
    for sill_m in np.arange(height_m - 1.0, top_m + 2.2, -3.0):
        for left_m in np.arange(0.8, width_m - 1.5, 2.4):
            rows = slice(round((sill_m - 1.5) * density), round(sill_m * density))
            columns = slice(round(left_m * density), round((left_m + 1.2) * density))
            bgr[rows, columns] = np.array(GLASS_BGR) + rng.uniform(-15, 60)
            bgr[rows.stop : rows.stop + 5, columns] += 50.0


def sky_picture(rng: np.random.Generator, *, width_px: int, height_px: int, horizon_px: float) -> Image:
    """(H, W, 4) what is behind everything, without parallax: clouds, a far line of trees, haze below the horizon."""
    y = np.arange(height_px, dtype=np.float64)[:, None]
    share = np.clip(y / max(horizon_px, 1.0), 0, 1)[:, :, None]
    sky = np.array([225.0, 190.0, 160.0]) * (1 - share) + np.array([232.0, 226.0, 220.0]) * share
    clouds = value_noise(rng, (height_px, width_px), cells=(24, 48, 96, 192))
    sky = sky + 9.0 * np.clip(clouds, -1, 3)[:, :, None]
    ridge_px = horizon_px - height_px * (0.035 + 0.012 * value_noise(rng, (2, width_px), cells=(8, 20, 60))[0])
    trees = (
        np.array([95.0, 112.0, 100.0]) + 10.0 * value_noise(rng, (height_px, width_px), cells=(3, 6, 12))[:, :, None]
    )
    return opaque(np.where((y >= ridge_px[None, :])[:, :, None], trees, sky))
