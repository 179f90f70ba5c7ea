r"""What cars, vans and trucks are made of.

  ______          The hull's back, front and sides lie on the 3-D box itself, so that a ray through the middle of a
 /__|___\___      box on the image meets the paint just where it meets the 3-D box (to the right of the bonnet of a
|__________ |     van or a truck seen from above that is not so, but no camera looks from there).
 (o)    (o)       x ->
"""

from __future__ import annotations

import numpy as np

from track_range.simulation.faces import SUN, Colour, Extent, Face, Vector, block, coloured_face, shaded
from track_range.simulation.textures import GLASS_BGR, RUBBER_BGR, cut_outside, paint_box, paint_wheel

PAINTS: tuple[Colour, ...] = (
    (60, 40, 150),
    (150, 95, 45),
    (185, 185, 180),
    (70, 70, 72),
    (205, 205, 205),
    (80, 110, 70),
    (70, 130, 165),
    (100, 60, 50),
)
LAMP_RED: Colour = (40, 30, 205)
LAMP_WHITE: Colour = (240, 245, 245)
CARGO_WHITE: Colour = (190, 190, 186)
STEEL: Colour = (55, 55, 58)

PILLAR_M = 0.12
"""How far a car's cabin stands in from its sides."""


def car(rng: np.random.Generator, size_hwl_m: tuple[float, float, float]) -> list[Face]:
    """A hull of full width and length up to the shoulders, and a glazed cabin."""
    height, width, length = size_hwl_m
    paint = _paint(rng)
    x, z, shoulder = length / 2, width / 2, 0.62 * height
    hull = block(rng, (-x, x, 0, shoulder, -z, z), paint)
    for side, lamp in (("back", LAMP_RED), ("front", LAMP_WHITE)):
        picture = hull[side].texture
        paint_box(picture, (0, 0.78, 1, 1), RUBBER_BGR)
        _lamps(hull[side], (0.18, 0.38), lamp)
        paint_box(picture, (0.36, 0.5, 0.64, 0.64), (215, 225, 225))
        for left in (0.39, 0.44, 0.5, 0.55, 0.59):
            paint_box(picture, (left, 0.53, left + 0.025, 0.61), (40, 40, 40))
    paint_box(hull["front"].texture, (0.28, 0.2, 0.72, 0.36), (35, 35, 38))
    for side in ("left", "right"):
        paint_box(hull[side].texture, (0, 1 - 0.22 / shoulder, 1, 1), RUBBER_BGR)
        for seam in (0.04, 0.36, 0.62):
            paint_box(hull[side].texture, (seam, 0.05, seam + 0.008, 0.7), RUBBER_BGR)
        _wheels(hull[side], (0.82 / length, 1 - 0.82 / length), 0.31)
    cabin = _cabin(rng, (-0.98 * x, 0.4 * x, shoulder, height, -z, z), (-0.72 * x, 0.02 * x), bgr=paint)
    return [_shadow(rng, length, width), *hull.values(), *cabin]


def van(rng: np.random.Generator, size_hwl_m: tuple[float, float, float]) -> list[Face]:
    """A high box and a bonnet a little over half as high."""
    height, width, length = size_hwl_m
    paint = _paint(rng)
    x, z, bonnet_x = length / 2, width / 2, 0.24 * length
    box = block(rng, (-x, bonnet_x, 0, height, -z, z), paint)
    bonnet = block(rng, (bonnet_x, x, 0, 0.58 * height, -z, z), paint, sides=("front", "left", "right", "top"))
    for side, (left, right) in (("back", (0.08, 0.92)), ("left", (0.02, 0.3)), ("right", (0.7, 0.98))):
        paint_box(box[side].texture, (left, 0.1, right, 0.4), GLASS_BGR)
    paint_box(box["back"].texture, (0.49, 0.08, 0.51, 0.88), RUBBER_BGR)
    paint_box(box["front"].texture, (0.06, 0.06, 0.94, 0.4), GLASS_BGR)
    _lamps(box["back"], (0.5, 0.7), LAMP_RED)
    _lamps(bonnet["front"], (0.15, 0.4), LAMP_WHITE)
    for face in (box["back"], bonnet["front"]):
        paint_box(face.texture, (0, 0.87, 1, 1), RUBBER_BGR)
    for face, at in ((box["left"], 0.8), (box["right"], 0.2), (bonnet["left"], 0.55), (bonnet["right"], 0.45)):
        _wheels(face, (at,), 0.34)
    return [_shadow(rng, length, width), *box.values(), *bonnet.values()]


def truck(rng: np.random.Generator, size_hwl_m: tuple[float, float, float]) -> list[Face]:
    """A cargo box on a frame with three wheels a side, and a cab."""
    height, width, length = size_hwl_m
    paint = _paint(rng)
    x, z, bed, cab_x = length / 2, width / 2, 0.27 * height, 0.5 * length - 2.1
    cargo = block(rng, (-x, cab_x - 0.3, bed, height, -z, z), CARGO_WHITE)
    frame = block(rng, (-x, cab_x, 0, bed, -z, z), STEEL, sides=("back", "left", "right"))
    cab = block(rng, (cab_x, x, 0, 0.85 * height, -z, z), paint)
    for side, windows, wheels in (("left", (0.05, 0.6), (0.2, 0.72, 0.88)), ("right", (0.4, 0.95), (0.12, 0.28, 0.8))):
        paint_box(cargo[side].texture, (0.08, 0.35, 0.92, 0.62), paint)
        paint_box(cab[side].texture, (windows[0], 0.1, windows[1], 0.45), GLASS_BGR)
        _wheels(frame[side], wheels, 0.45)
        _wheels(cab[side], (0.5,), 0.45)
    paint_box(cargo["back"].texture, (0.49, 0.03, 0.51, 0.97), STEEL)
    paint_box(cargo["back"].texture, (0.1, 0.3, 0.44, 0.55), paint)
    paint_box(cab["front"].texture, (0.06, 0.1, 0.94, 0.46), GLASS_BGR)
    _lamps(frame["back"], (0.15, 0.45), LAMP_RED)
    _lamps(cab["front"], (0.72, 0.8), LAMP_WHITE)
    return [_shadow(rng, length, width), *cargo.values(), *frame.values(), *cab.values()]


def _paint(rng: np.random.Generator) -> Colour:
    return PAINTS[int(rng.integers(len(PAINTS)))]


def _lamps(face: Face, rows: tuple[float, float], bgr: Colour) -> None:
    """Two lamps on a back or front, `rows` from the top as shares of it (painted in place)."""
    for left in (0.03, 0.81):
        paint_box(face.texture, (left, rows[0], left + 0.16, rows[1]), bgr)


def _wheels(face: Face, at: tuple[float, ...], radius_m: float) -> None:
    """Wheels on the lower edge of a side, `at` shares of its length (painted in place)."""
    radius = radius_m / float(face.down[1])
    for share in at:
        paint_wheel(face.texture, (share, 1 - radius), radius)


def _cabin(rng: np.random.Generator, base: Extent, roof_x: tuple[float, float], *, bgr: Colour) -> list[Face]:
    """A cabin on `base` with sloping front and back windows; the roof runs over `roof_x` (from, to)."""
    x0, x1, low, high, z0, z1 = base
    first, last = z0 + PILLAR_M, z1 - PILLAR_M
    places: dict[str, tuple[Vector, Vector, Vector]] = {
        "back": ((roof_x[0], -high, last), (0, 0, first - last), (x0 - roof_x[0], high - low, 0)),
        "front": ((roof_x[1], -high, first), (0, 0, last - first), (x1 - roof_x[1], high - low, 0)),
        "top": ((roof_x[0], -high, last), (roof_x[1] - roof_x[0], 0, 0), (0, 0, first - last)),
        "left": ((x1, -high, last), (x0 - x1, 0, 0), (0, high - low, 0)),
        "right": ((x0, -high, first), (x1 - x0, 0, 0), (0, high - low, 0)),
    }
    faces = {side: coloured_face(rng, place, shaded(bgr, SUN[side])) for side, place in places.items()}
    for side in ("back", "front"):
        paint_box(faces[side].texture, (0.07, 0.14, 0.93, 0.92), GLASS_BGR)
    behind, ahead = (roof_x[0] - x0) / (x1 - x0), (x1 - roof_x[1]) / (x1 - x0)
    for side, (left, right) in (("right", (behind, ahead)), ("left", (ahead, behind))):
        picture = faces[side].texture
        paint_box(picture, (0.08, 0.16, 0.46, 0.9), GLASS_BGR)
        paint_box(picture, (0.5, 0.16, 0.92, 0.9), GLASS_BGR)
        cut_outside(picture, [(left, 0), (1 - right, 0), (1, 1), (0, 1)])
    return list(faces.values())


def _shadow(rng: np.random.Generator, length: float, width: float) -> Face:
    """A dark patch on the road, a hand's breadth wider than the vehicle."""
    x, z = length / 2 + 0.15, width / 2 + 0.15
    patch = coloured_face(rng, ((-x, -0.01, z), (2 * x, 0, 0), (0, 0, -2 * z)), (38, 36, 36), contrast=6.0)
    cut_outside(patch.texture, [(0.03, 0), (0.97, 0), (1, 0.1), (1, 0.9), (0.97, 1), (0.03, 1), (0, 0.9), (0, 0.1)])
    return patch
