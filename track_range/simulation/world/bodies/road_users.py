"""The bodies of road users, by type; of signs and lights, a plate or housing on a pole or gantry
without a label.
"""

from collections.abc import Callable

import cv2
import numpy as np

from track_range.foundation.arrays import Image
from track_range.simulation.world.bodies.cars import car
from track_range.simulation.world.bodies.faces import Colour, Extent, Face, Size, block, octagon
from track_range.simulation.world.bodies.people import cyclist, motorcyclist, pedestrian
from track_range.simulation.world.bodies.vehicles import bus, truck, van
from track_range.simulation.world.scene import RoadUser
from track_range.simulation.world.textures.surfaces import clip, fill, polygon

# length of the pole; longer than the height of any sign, since the ground hides its lower end
POLE_M = 4.0
# ends of the beam above a motorway from the middle of the plate; the posts stand there
GANTRY_M = (-6.3, 9.8)
STEEL = (120.0, 122.0, 122.0)
WHITE, RED, BLUE, BLACK = (232, 234, 234), (38, 30, 190), (160, 84, 24), (30, 30, 30)

_Outline = list[tuple[float, float]]


def traffic_sign(rng: np.random.Generator, size_hwl_m: Size) -> list[Face]:
    """The faces of a random traffic sign: stop, speed limit, warning or direction."""
    plate = _plate(rng, size_hwl_m)
    outline = SIGNS[int(rng.integers(len(SIGNS)))](plate["front"].texture)
    for face in plate.values():
        clip(face.texture, [outline])
    return [*plate.values(), *_pole(rng, size_hwl_m)]


def overhead_sign(rng: np.random.Generator, size_hwl_m: Size, raised_m: float) -> list[Face]:
    """The faces of a blue direction sign `raised_m` above the road, on a gantry across it."""
    plate = _plate(rng, size_hwl_m)
    _direction(plate["front"].texture)
    x, beam_m, (left, right) = -size_hwl_m[2] / 2, 0.55 * size_hwl_m[0], GANTRY_M
    steel = _beam(rng, (x - 0.3, x - 0.05, beam_m, beam_m + 0.4, left, right))
    for z in GANTRY_M:
        steel += _beam(rng, (x - 0.3, x - 0.05, -raised_m, beam_m, z - 0.15, z + 0.15))
    return [*plate.values(), *steel]


def traffic_light(rng: np.random.Generator, size_hwl_m: Size) -> list[Face]:
    """The faces of a traffic light: a dark housing with three lamps, one of them lit."""
    height, width, length = size_hwl_m
    housing = block(
        rng, (-length / 2, length / 2, 0, height, -width / 2, width / 2), (36, 38, 36), contrast=4.0
    )
    picture = housing["front"].texture
    lit = int(rng.integers(3))
    for number, colour in enumerate(((40, 40, 250), (60, 190, 250), (130, 230, 80))):
        fraction = 1.0 if number == lit else 0.22
        at = (round(0.5 * picture.shape[1]), round((0.18 + 0.32 * number) * picture.shape[0]))
        lamp = tuple(fraction * channel for channel in colour)
        cv2.circle(picture, at, round(0.34 * picture.shape[1]), (*lamp, 255), -1, cv2.LINE_AA)
    return [*housing.values(), *_pole(rng, size_hwl_m)]


def _plate(rng: np.random.Generator, size_hwl_m: Size) -> dict[str, Face]:
    height, width, length = size_hwl_m
    extent = (-length / 2, length / 2, 0.0, height, -width / 2, width / 2)
    return block(rng, extent, STEEL, contrast=4.0, sides=("front", "back"))


def _pole(rng: np.random.Generator, size_hwl_m: Size) -> list[Face]:
    x = -size_hwl_m[2] / 2
    return _beam(rng, (x - 0.08, x, -POLE_M, 0.0, -0.04, 0.04))


def _beam(rng: np.random.Generator, extent: Extent) -> list[Face]:
    return list(
        block(rng, extent, STEEL, contrast=5.0, sides=("front", "back", "left", "right")).values()
    )


def _stop(picture: Image) -> _Outline:
    outline = octagon(0.29)
    polygon(picture, outline, WHITE)
    polygon(picture, _scaled(outline, 0.93), RED)
    _write(picture, "STOP", (0.11, 0.61), WHITE, width_texels=95)
    return outline


def _limit(picture: Image) -> _Outline:
    ring = [
        (0.5 + 0.5 * float(np.cos(a)), 0.5 + 0.5 * float(np.sin(a)))
        for a in np.linspace(0, 2 * np.pi, 32)
    ]
    polygon(picture, ring, RED)
    polygon(picture, _scaled(ring, 0.76), WHITE)
    _write(picture, "50", (0.24, 0.66), BLACK, width_texels=62)
    return ring


def _warning(picture: Image) -> _Outline:
    outline = [(0.5, 0.0), (1.0, 0.95), (0.0, 0.95)]
    polygon(picture, outline, RED)
    polygon(picture, [(0.5, 0.2), (0.83, 0.84), (0.17, 0.84)], WHITE)
    fill(picture, (0.47, 0.4, 0.53, 0.66), BLACK)
    fill(picture, (0.47, 0.71, 0.53, 0.77), BLACK)
    return outline


def _direction(picture: Image) -> _Outline:
    outline = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
    polygon(picture, outline, BLUE)
    polygon(
        picture,
        [(0.5, 0.12), (0.82, 0.5), (0.6, 0.5), (0.6, 0.88), (0.4, 0.88), (0.4, 0.5), (0.18, 0.5)],
        WHITE,
    )
    return outline


def _scaled(outline: _Outline, factor: float) -> _Outline:
    return [(0.5 + factor * (x - 0.5), 0.5 + factor * (y - 0.5)) for x, y in outline]


def _write(
    picture: Image, text: str, start: tuple[float, float], bgr: Colour, *, width_texels: int
) -> None:
    """Write a text that is as large as OpenCV's font at scale 1 on a sign of the given width."""
    height, width = picture.shape[:2]
    at, scale = (round(start[0] * width), round(start[1] * height)), width / width_texels
    font, thickness = cv2.FONT_HERSHEY_SIMPLEX, max(2, round(3 * scale))
    cv2.putText(picture, text, at, font, scale, (*bgr, 255), thickness, cv2.LINE_AA)


SIGNS = (_stop, _limit, _warning, _direction)


BUILDERS: dict[str, Callable[[np.random.Generator, Size], list[Face]]] = {
    "Car": car,
    "Van": van,
    "Truck": truck,
    "Bus": bus,
    "Pedestrian": pedestrian,
    "Cyclist": cyclist,
    "Motorcycle": motorcyclist,
    "TrafficSign": traffic_sign,
    "TrafficLight": traffic_light,
}


def body_of(user: RoadUser, seed: int) -> list[Face]:
    """Faces of a road user in its frame, by seed and track id; a sign that is higher than a pole
    hangs on a gantry.
    """
    rng = np.random.default_rng([seed, 2, user.track_id])
    if user.kitti_type == "TrafficSign" and user.raised_m > POLE_M:
        return overhead_sign(rng, user.size_hwl_m, user.raised_m)
    return BUILDERS[user.kitti_type](rng, user.size_hwl_m)
