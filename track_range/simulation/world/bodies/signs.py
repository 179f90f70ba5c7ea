"""Traffic signs and lights: a plate or housing on a pole or gantry; the labels do not include the pole and gantry."""

from __future__ import annotations

import cv2
import numpy as np

from track_range.foundation.arrays import Image
from track_range.simulation.world.bodies.faces import Face, block
from track_range.simulation.world.textures.painting import clip, fill, polygon

POLE_M = 4.0
"""Length of the pole; longer than the height of any sign, since the ground hides its lower end."""

GANTRY_M = (-6.3, 9.8)
"""Left and right ends of the beam above a motorway, from the middle of the plate, m; the posts stand there."""

STEEL = (120.0, 122.0, 122.0)
WHITE, RED, BLUE, YELLOW = (232, 234, 234), (38, 30, 190), (160, 84, 24), (40, 200, 235)


def traffic_sign(rng: np.random.Generator, size_hwl_m: tuple[float, float, float]) -> list[Face]:
    """The faces of a random traffic sign: stop, speed limit, warning or direction."""
    height, width, length = size_hwl_m
    half = width / 2
    plate = block(rng, (-length / 2, length / 2, 0, height, -half, half), STEEL, contrast=4.0, sides=("front", "back"))
    outline = SIGNS[int(rng.integers(len(SIGNS)))](plate["front"].texture)
    for face in plate.values():
        clip(face.texture, [outline], [])
    return [*plate.values(), *_pole(rng, -length / 2)]


def overhead_sign(rng: np.random.Generator, size_hwl_m: tuple[float, float, float], raised_m: float) -> list[Face]:
    """The faces of a blue direction sign `raised_m` above the road, on a gantry across it."""
    height, width, length = size_hwl_m
    half, back = width / 2, -length / 2
    plate = block(rng, (back, length / 2, 0, height, -half, half), STEEL, contrast=4.0, sides=("front", "back"))
    _direction(plate["front"].texture)
    left, right = GANTRY_M
    beams = [
        (back - 0.3, back - 0.05, 0.55 * height, 0.55 * height + 0.4, left, right),
        *((back - 0.3, back - 0.05, -raised_m, 0.55 * height, at - 0.15, at + 0.15) for at in GANTRY_M),
    ]
    steel = [block(rng, beam, STEEL, contrast=5.0, sides=("front", "back", "left", "right")) for beam in beams]
    return [*plate.values(), *(face for beam in steel for face in beam.values())]


def traffic_light(rng: np.random.Generator, size_hwl_m: tuple[float, float, float]) -> list[Face]:
    """The faces of a traffic light: a dark housing with three lamps, one of them lit."""
    height, width, length = size_hwl_m
    half = width / 2
    housing = block(rng, (-length / 2, length / 2, 0, height, -half, half), (36, 38, 36), contrast=4.0)
    picture = housing["front"].texture
    lit = int(rng.integers(3))
    for number, colour in enumerate(((40, 40, 250), (60, 190, 250), (130, 230, 80))):
        fraction = 1.0 if number == lit else 0.22
        at = (round(0.5 * picture.shape[1]), round((0.18 + 0.32 * number) * picture.shape[0]))
        lamp = tuple(fraction * channel for channel in colour)
        cv2.circle(picture, at, round(0.34 * picture.shape[1]), (*lamp, 255), -1, cv2.LINE_AA)
    return [*housing.values(), *_pole(rng, -length / 2)]


def _pole(rng: np.random.Generator, x: float) -> list[Face]:
    pole = block(
        rng, (x - 0.08, x, -POLE_M, 0.0, -0.04, 0.04), STEEL, contrast=5.0, sides=("front", "back", "left", "right")
    )
    return list(pole.values())


def _stop(picture: Image) -> list[tuple[float, float]]:
    cut = 0.29
    outline = [
        (cut, 0.0),
        (1 - cut, 0.0),
        (1.0, cut),
        (1.0, 1 - cut),
        (1 - cut, 1.0),
        (cut, 1.0),
        (0.0, 1 - cut),
        (0.0, cut),
    ]
    polygon(picture, outline, WHITE)
    polygon(picture, [(0.5 + 0.93 * (x - 0.5), 0.5 + 0.93 * (y - 0.5)) for x, y in outline], RED)
    scale = picture.shape[1] / 95
    at = (round(0.11 * picture.shape[1]), round(0.61 * picture.shape[0]))
    cv2.putText(
        picture, "STOP", at, cv2.FONT_HERSHEY_SIMPLEX, scale, (*WHITE, 255), max(2, round(3 * scale)), cv2.LINE_AA
    )
    return outline


def _limit(picture: Image) -> list[tuple[float, float]]:
    ring = [(0.5 + 0.5 * float(np.cos(a)), 0.5 + 0.5 * float(np.sin(a))) for a in np.linspace(0, 2 * np.pi, 32)]
    polygon(picture, ring, RED)
    polygon(picture, [(0.5 + 0.76 * (x - 0.5), 0.5 + 0.76 * (y - 0.5)) for x, y in ring], WHITE)
    scale = picture.shape[1] / 62
    at = (round(0.24 * picture.shape[1]), round(0.66 * picture.shape[0]))
    cv2.putText(
        picture, "50", at, cv2.FONT_HERSHEY_SIMPLEX, scale, (30, 30, 30, 255), max(2, round(3 * scale)), cv2.LINE_AA
    )
    return ring


def _warning(picture: Image) -> list[tuple[float, float]]:
    outline = [(0.5, 0.0), (1.0, 0.95), (0.0, 0.95)]
    polygon(picture, outline, RED)
    polygon(picture, [(0.5, 0.2), (0.83, 0.84), (0.17, 0.84)], WHITE)
    fill(picture, (0.47, 0.4, 0.53, 0.66), (30, 30, 30))
    fill(picture, (0.47, 0.71, 0.53, 0.77), (30, 30, 30))
    return outline


def _direction(picture: Image) -> list[tuple[float, float]]:
    outline = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
    polygon(picture, outline, BLUE)
    polygon(picture, [(0.5, 0.12), (0.82, 0.5), (0.6, 0.5), (0.6, 0.88), (0.4, 0.88), (0.4, 0.5), (0.18, 0.5)], WHITE)
    return outline


SIGNS = (_stop, _limit, _warning, _direction)
