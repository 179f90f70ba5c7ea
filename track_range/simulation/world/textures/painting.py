"""Painting of vehicle textures in place, with positions as fractions of the texture's size."""

from __future__ import annotations

import cv2
import numpy as np

from track_range.foundation.arrays import Image

Box = tuple[float, float, float, float]  # x1, y1, x2, y2 as fractions of the texture's width and height
Colour = tuple[float, ...]  # blue, green, red, 0 to 255

TYRE: Colour = (28, 28, 30)
ALLOY: Colour = (168, 170, 170)
SEAM: Colour = (24, 24, 26)

_REACH = 4  # radius of the filter that extracts the dirt on window panes, texels


def shade_rows(picture: Image, lights: tuple[tuple[float, float], ...]) -> None:
    """Multiply rows by factors, linearly interpolated between pairs of (fraction from the top, factor)."""
    rows = np.linspace(0, 1, picture.shape[0])
    factor = np.interp(rows, [at for at, _ in lights], [light for _, light in lights]).astype(np.float32)
    picture[:, :, :3] = np.clip(picture[:, :, :3] * factor[:, None, None], 0, 255).astype(np.uint8)


def fill(picture: Image, box: Box, bgr: Colour) -> None:
    """Fill a rectangle with one colour; a third of the fine dirt remains."""
    x1, y1, x2, y2 = _texels(picture, box)
    part = picture[y1:y2, x1:x2, :3].astype(np.float32)
    if part.size:
        dirt = (part - cv2.blur(part, (15, 15)).reshape(part.shape)) / 3
        picture[y1:y2, x1:x2, :3] = np.clip(dirt + np.array(bgr, np.float32), 0, 255).astype(np.uint8)


def polygon(picture: Image, corners: list[tuple[float, float]], bgr: Colour) -> None:
    """Fill an anti-aliased polygon."""
    height, width = picture.shape[:2]
    points = np.rint(np.array(corners) * (width * 16, height * 16)).astype(np.int32)
    cv2.fillPoly(picture, [points], (*bgr, 255), cv2.LINE_AA, 4)


def pane(picture: Image, corners: list[tuple[float, float]], *, top: float = 96.0, bottom: float = 34.0) -> None:
    """Paint a window pane: the sky's reflection at the top fades into the dark interior."""
    height, width = picture.shape[:2]
    points = np.rint(np.array(corners) * (width, height)).astype(np.int32)
    first, last = np.maximum(points.min(axis=0) - _REACH, 0), points.max(axis=0) + 1 + _REACH
    part = picture[first[1] : last[1], first[0] : last[0], :3]
    mask = np.zeros(part.shape[:2], np.uint8)
    cv2.fillPoly(mask, [points - first], 255, cv2.LINE_AA)
    low, high = float(min(y for _, y in corners)), float(max(y for _, y in corners))
    rows = np.linspace(0, 1, height)[first[1] : last[1]]
    grey = (top + (bottom - top) * np.clip((rows - low) / max(high - low, 1e-6), 0, 1) ** 0.6).astype(np.float32)
    dirt = (part.astype(np.float32) - cv2.blur(part, (2 * _REACH + 1, 2 * _REACH + 1))) * np.float32(0.7)
    glass = np.clip(grey[:, None, None] * np.array([1.06, 1.0, 0.93], np.float32) + dirt, 0, 255)
    part[:] = part + (glass - part) * (mask / np.float32(255))[:, :, None]


def wheel(picture: Image, centre: tuple[float, float], radius: float, *, arch: float = 1.22) -> None:
    """Paint a tyre with its rim in a dark arch; the radius is a fraction of the texture's height."""
    height, width = picture.shape[:2]
    at = (round(centre[0] * width), round(centre[1] * height))
    reach = radius * height
    cv2.ellipse(
        picture, at, (round(reach * arch), round(reach * arch)), 0, 180, 360, (18, 18, 20, 255), -1, cv2.LINE_AA
    )
    cv2.circle(picture, at, round(reach), (*TYRE, 255), -1, cv2.LINE_AA)
    cv2.circle(picture, at, round(0.66 * reach), (*ALLOY, 255), -1, cv2.LINE_AA)
    cv2.circle(picture, at, round(0.58 * reach), (92, 94, 96, 255), -1, cv2.LINE_AA)
    for angle in np.arange(5) * 2 * np.pi / 5 + 0.3:
        end = (round(at[0] + 0.62 * reach * np.cos(angle)), round(at[1] + 0.62 * reach * np.sin(angle)))
        cv2.line(picture, at, end, (*ALLOY, 255), max(2, round(0.14 * reach)), cv2.LINE_AA)
    cv2.circle(picture, at, round(0.14 * reach), (*ALLOY, 255), -1, cv2.LINE_AA)


def clip(picture: Image, outlines: list[list[tuple[float, float]]], discs: list[tuple[float, float, float]]) -> None:
    """Make the texture transparent outside polygons and discs (x, y, radius as a fraction of the height)."""
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
        fill(picture, (left, y1 + 0.25 * (y2 - y1), left + 0.08 * (x2 - x1), y1 + 0.75 * (y2 - y1)), (40, 36, 36))


def _texels(picture: Image, box: Box) -> tuple[int, int, int, int]:
    height, width = picture.shape[:2]
    x1, y1, x2, y2 = np.rint(np.array(box) * (width, height, width, height)).astype(int).tolist()
    return max(x1, 0), max(y1, 0), x2, y2
