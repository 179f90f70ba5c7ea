"""Textures: BGRA images, alpha 0 where a surface is cut out, with detail at every scale.

A stereo matcher needs detail on a car at 6 m as well as at 80 m, where a pixel covers 11 cm;
therefore each octave of the value noise (Perlin, "An image synthesizer", SIGGRAPH 1985) has the
same contrast.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, Image

# x1, y1, x2, y2 as fractions of the texture's width and height
Box = tuple[float, float, float, float]
Colour = tuple[float, ...]  # blue, green, red, 0 to 255

TEXELS_PER_M = 96  # resolution of vehicles and people: that of a camera with f = 721 px at 7.5 m
DIRT_SHAPE = (1024, 1536)  # rows and columns of the shared dirt texture; larger than any face
GLASS_BGR = (58, 50, 44)  # colour of window panes
RUBBER_BGR = (30, 30, 32)  # colour of bicycle tyres
TYRE: Colour = (28, 28, 30)
ALLOY: Colour = (168, 170, 170)
SEAM: Colour = (24, 24, 26)

_REACH = 4  # radius of the filter that extracts the dirt on window panes, texels


def value_noise(
    rng: np.random.Generator, shape: tuple[int, int], *, cells: tuple[int, ...]
) -> FloatArray:
    """(H, W) noise, mean 0 and sigma about 1, with grains of `cells` texels; periodic if these
    divide the shape.
    """
    height, width = shape
    total: npt.NDArray[np.float32] = np.zeros(shape, np.float32)
    for cell in cells:
        rows, columns = max(2, height // cell), max(2, width // cell)
        grid = np.pad(rng.standard_normal((rows, columns), np.float32), 1, mode="wrap")
        # texels per grain, rounded up; the rest is cut off
        tall, wide = -(-height // rows), -(-width // columns)
        grains = cv2.resize(
            grid, (wide * (columns + 2), tall * (rows + 2)), interpolation=cv2.INTER_LINEAR
        )
        total += grains[tall : tall + height, wide : wide + width]
    # bilinear interpolation leaves about 4/9 of the grid's variance
    total *= 1.5 / np.sqrt(len(cells))
    return total.astype(np.float64)


def opaque(bgr: npt.NDArray[np.floating[Any]]) -> Image:
    """(H, W, 4) uint8 BGRA image of (H, W, 3) colours, rounded, clipped and opaque."""
    positive = np.maximum(np.asarray(bgr, np.float32), 0)
    return np.asarray(cv2.cvtColor(cv2.convertScaleAbs(positive), cv2.COLOR_BGR2BGRA), np.uint8)


@cache
def _dirt() -> npt.NDArray[np.float32]:
    """`DIRT_SHAPE` array of noise, from which the dirt of surfaces is cut."""
    noise = value_noise(np.random.default_rng(9), DIRT_SHAPE, cells=(2, 4, 8, 16, 32, 64)).astype(
        np.float32
    )
    noise.flags.writeable = False
    return noise


def plain(
    rng: np.random.Generator, size_m: tuple[float, float], bgr: Colour, *, contrast: float = 11.0
) -> Image:
    """Texture of one colour with dirt from a random part of `_dirt`; `size_m` is width and
    height.
    """
    width, height = (max(4, round(side * TEXELS_PER_M)) for side in size_m)
    if height > DIRT_SHAPE[0] or width > DIRT_SHAPE[1]:
        noise = value_noise(rng, (height, width), cells=(2, 4, 8, 16, 32, 64)).astype(np.float32)
    else:
        top, left = (
            int(rng.integers(margin + 1)) for margin in np.subtract(DIRT_SHAPE, (height, width))
        )
        noise = _dirt()[top : top + height, left : left + width]
    scaled = contrast * noise
    channels = [cv2.convertScaleAbs(np.maximum(scaled, -level), beta=float(level)) for level in bgr]
    return np.asarray(cv2.merge([*channels, np.full_like(channels[0], 255)]), np.uint8)


def paint_box(picture: Image, box: Box, bgr: Colour) -> None:
    """Tint a rectangle, given as fractions x1, y1, x2, y2 of the texture's size; its dirt
    remains.
    """
    x1, y1, x2, y2 = _texels(picture, box)
    part = picture[y1:y2, x1:x2, :3].astype(np.float64)
    if part.size:
        dirt = part - part.mean(axis=(0, 1))
        picture[y1:y2, x1:x2, :3] = np.clip(dirt + np.array(bgr), 0, 255).astype(np.uint8)


def paint_wheel(picture: Image, centre: tuple[float, float], radius: float) -> None:
    """Paint a tyre and its rim; the centre is a fraction of the texture's size, the radius a
    fraction of its height.
    """
    height, width = picture.shape[:2]
    at = (round(centre[0] * width), round(centre[1] * height))
    cv2.circle(picture, at, round(radius * height), (*RUBBER_BGR, 255), -1, cv2.LINE_AA)
    cv2.circle(picture, at, round(radius * height * 0.6), (150, 150, 150, 255), -1, cv2.LINE_AA)
    for angle_rad in np.arange(5) * 2 * np.pi / 5:
        end = (
            at[0] + radius * height * 0.6 * np.cos(angle_rad),
            at[1] + radius * height * 0.6 * np.sin(angle_rad),
        )
        cv2.line(picture, at, (round(end[0]), round(end[1])), (70, 70, 70, 255), 2, cv2.LINE_AA)


def cut_outside(picture: Image, corners: list[tuple[float, float]]) -> None:
    """Make the texture transparent outside a convex polygon with corners as fractions of its
    size.
    """
    height, width = picture.shape[:2]
    inside = np.zeros((height, width), np.uint8)
    cv2.fillConvexPoly(inside, np.rint(np.array(corners) * (width, height)).astype(np.int32), 255)
    picture[:, :, 3] = np.minimum(picture[:, :, 3], inside)


def shade_rows(picture: Image, lights: tuple[tuple[float, float], ...]) -> None:
    """Multiply rows by factors, linearly interpolated between pairs of (fraction from the top,
    factor).
    """
    rows = np.linspace(0, 1, picture.shape[0])
    factor = np.interp(rows, [at for at, _ in lights], [light for _, light in lights]).astype(
        np.float32
    )
    picture[:, :, :3] = np.clip(picture[:, :, :3] * factor[:, None, None], 0, 255).astype(np.uint8)


def fill(picture: Image, box: Box, bgr: Colour) -> None:
    """Fill a rectangle with one colour; a third of the fine dirt remains."""
    x1, y1, x2, y2 = _texels(picture, box)
    part = picture[y1:y2, x1:x2, :3].astype(np.float32)
    if part.size:
        dirt = (part - cv2.blur(part, (15, 15)).reshape(part.shape)) / 3
        picture[y1:y2, x1:x2, :3] = np.clip(dirt + np.array(bgr, np.float32), 0, 255).astype(
            np.uint8
        )


def polygon(picture: Image, corners: list[tuple[float, float]], bgr: Colour) -> None:
    """Fill an anti-aliased polygon."""
    height, width = picture.shape[:2]
    points = np.rint(np.array(corners) * (width * 16, height * 16)).astype(np.int32)
    cv2.fillPoly(picture, [points], (*bgr, 255), cv2.LINE_AA, 4)


def pane(picture: Image, corners: list[tuple[float, float]]) -> None:
    """Paint a window pane: the sky's reflection at the top fades into the dark interior."""
    height, width = picture.shape[:2]
    points = np.rint(np.array(corners) * (width, height)).astype(np.int32)
    first, last = np.maximum(points.min(axis=0) - _REACH, 0), points.max(axis=0) + 1 + _REACH
    part = picture[first[1] : last[1], first[0] : last[0], :3]
    mask = np.zeros(part.shape[:2], np.uint8)
    cv2.fillPoly(mask, [points - first], 255, cv2.LINE_AA)
    low, high = float(min(y for _, y in corners)), float(max(y for _, y in corners))
    rows = np.linspace(0, 1, height)[first[1] : last[1]]
    grey = (96.0 - 62.0 * np.clip((rows - low) / max(high - low, 1e-6), 0, 1) ** 0.6).astype(
        np.float32
    )
    dirt = (
        part.astype(np.float32) - cv2.blur(part, (2 * _REACH + 1, 2 * _REACH + 1))
    ) * np.float32(0.7)
    glass = np.clip(grey[:, None, None] * np.array([1.06, 1.0, 0.93], np.float32) + dirt, 0, 255)
    part[:] = part + (glass - part) * (mask / np.float32(255))[:, :, None]


def wheel(picture: Image, centre: tuple[float, float], radius: float) -> None:
    """Paint a tyre with its rim in a dark arch; the radius is a fraction of the texture's
    height.
    """
    height, width = picture.shape[:2]
    at = (round(centre[0] * width), round(centre[1] * height))
    reach, arch = radius * height, round(radius * height * 1.22)
    cv2.ellipse(picture, at, (arch, arch), 0, 180, 360, (18, 18, 20, 255), -1, cv2.LINE_AA)
    cv2.circle(picture, at, round(reach), (*TYRE, 255), -1, cv2.LINE_AA)
    cv2.circle(picture, at, round(0.66 * reach), (*ALLOY, 255), -1, cv2.LINE_AA)
    cv2.circle(picture, at, round(0.58 * reach), (92, 94, 96, 255), -1, cv2.LINE_AA)
    for angle in np.arange(5) * 2 * np.pi / 5 + 0.3:
        end = (
            round(at[0] + 0.62 * reach * np.cos(angle)),
            round(at[1] + 0.62 * reach * np.sin(angle)),
        )
        cv2.line(picture, at, end, (*ALLOY, 255), max(2, round(0.14 * reach)), cv2.LINE_AA)
    cv2.circle(picture, at, round(0.14 * reach), (*ALLOY, 255), -1, cv2.LINE_AA)


def clip(
    picture: Image,
    outlines: list[list[tuple[float, float]]],
    discs: Sequence[tuple[float, float, float]] = (),
) -> None:
    """Make the texture transparent outside polygons and discs (x, y, radius as a fraction of the
    height).
    """
    height, width = picture.shape[:2]
    inside = np.zeros((height, width), np.uint8)
    for corners in outlines:
        cv2.fillPoly(inside, [np.rint(np.array(corners) * (width, height)).astype(np.int32)], 255)
    for x, y, radius in discs:
        cv2.circle(inside, (round(x * width), round(y * height)), round(radius * height), 255, -1)
    picture[:, :, 3] = np.minimum(picture[:, :, 3], inside)


def number_plate(picture: Image, box: Box) -> None:
    """Paint a white number plate with dark characters."""
    fill(picture, box, (222, 228, 228))
    x1, y1, x2, y2 = box
    for fraction in (0.1, 0.22, 0.4, 0.52, 0.68, 0.8):
        left = x1 + fraction * (x2 - x1)
        fill(
            picture,
            (left, y1 + 0.25 * (y2 - y1), left + 0.08 * (x2 - x1), y1 + 0.75 * (y2 - y1)),
            (40, 36, 36),
        )


def _texels(picture: Image, box: Box) -> tuple[int, int, int, int]:
    height, width = picture.shape[:2]
    x1, y1, x2, y2 = np.rint(np.array(box) * (width, height, width, height)).astype(int).tolist()
    return max(x1, 0), max(y1, 0), x2, y2
