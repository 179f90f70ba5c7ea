r"""Car bodies: a hull with chamfered corners on four wheels, and a glazed cabin with inclined
sides.

      ______            Back, front and sides of the hull coincide with the 3-D box, so that the ray through the centre
 ____/__|___\____       of a box in the image meets the paint where it meets the 3-D box. There are three shapes:
|_ _     |    _ _|      saloon, hatchback and estate. Positions along the car are fractions of its length from the back,
  (o)-------(o)   x ->  heights are fractions of its height.
"""

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import Image
from track_range.simulation.world.bodies.faces import (
    Colour,
    Face,
    Size,
    Vector,
    chosen,
    coloured_face,
    shaded,
    shadow,
    with_plate,
)
from track_range.simulation.world.textures.surfaces import (
    SEAM,
    clip,
    fill,
    pane,
    polygon,
    shade_rows,
    wheel,
)

# paint colours: white, silver, greys, black, blues, red, beige, green
PAINTS: tuple[Colour, ...] = (
    *((205, 206, 205), (176, 176, 174), (120, 120, 118), (72, 70, 68), (40, 38, 38)),
    *((112, 66, 38), (42, 36, 138), (92, 104, 112), (150, 96, 52), (62, 78, 54)),
)
LAMP_RED: Colour = (32, 26, 190)
LAMP_WHITE: Colour = (232, 238, 238)
TRIM: Colour = (34, 34, 36)

SILL = 0.15  # height of the hull's lower edge relative to the car's height
PAINT_CONTRAST = 5.0  # contrast of the dirt on the paint, grey levels
# m from the side windows' lower edge to the roof; with less, detectors classify these cars as
# trucks
LEAN_M = 0.29
SHOULDER_M = 0.03  # horizontal distance between the hull's side and the lower edge of the cabin
WHEEL_M = 0.32  # radius of a wheel
BACK_CHAMFER_M, FRONT_CHAMFER_M = (0.18, 0.15), (0.34, 0.25)  # along and across, seen from above
BACK_PLATE, FRONT_PLATE = (0.33, 0.27, 0.67, 0.39), (0.34, 0.42, 0.66, 0.54)  # of the flat part


@dataclass(frozen=True, slots=True)
class Build:
    """Shape of a car, as fractions of its length from the back and of its height."""

    deck: float  # height of the hull at the cabin
    roof: tuple[float, float]  # positions of the roof's ends
    cabin: tuple[float, float]  # positions of the cabin's ends at its base
    nose: float  # height of the hull at the front


BUILDS = (
    Build(0.66, (0.27, 0.55), (0.10, 0.74), 0.50),  # saloon
    Build(0.64, (0.10, 0.56), (0.015, 0.76), 0.50),  # hatchback
    Build(0.63, (0.05, 0.58), (0.01, 0.77), 0.52),  # estate, SUV
)


@dataclass(frozen=True, slots=True)
class _Car:
    rng: np.random.Generator
    size_hwl_m: Size
    build: Build
    paint: Colour

    def panel(self, corner: Vector, along: Vector, down: Vector, light: float) -> Face:
        """A face in the car's colour, multiplied by `light`."""
        place = (corner, along, down)
        return coloured_face(self.rng, place, shaded(self.paint, light), contrast=PAINT_CONTRAST)

    def x_m(self, fraction: float) -> float:
        """Position of a fraction of the car's length from the back."""
        length = self.size_hwl_m[2]
        return fraction * length - length / 2


def car(rng: np.random.Generator, size_hwl_m: Size) -> list[Face]:
    """The faces of a car with a random shape and colour."""
    build = BUILDS[int(rng.integers(len(BUILDS)))]
    body = _Car(rng, size_hwl_m, build, chosen(rng, PAINTS))
    return [shadow(size_hwl_m), *_hull(body), *_cabin(body), *_shoulders(body)]


def _hull(car: _Car) -> list[Face]:
    height, width, length = car.size_hwl_m
    x, z = length / 2, width / 2
    faces = []
    for is_front, (deep, wide) in ((False, BACK_CHAMFER_M), (True, FRONT_CHAMFER_M)):
        top = (car.build.nose if is_front else car.build.deck) * height
        end, sign = (x, 1) if is_front else (-x, -1)
        inner = z - wide
        light = 0.88 if is_front else 0.94
        end_face = car.panel(
            (end, -top, -sign * inner), (0, 0, sign * 2 * inner), (0, top, 0), light
        )
        _paint_end(end_face.texture, is_front=is_front)
        faces += with_plate(end_face, FRONT_PLATE if is_front else BACK_PLATE)
        for side in (1, -1):
            at_end, at_side = (end, -top, side * inner), (end - sign * deep, -top, side * z)
            first, second = (at_end, at_side) if side * sign > 0 else (at_side, at_end)
            along = (second[0] - first[0], 0.0, second[2] - first[2])
            corner = car.panel(first, along, (0, top, 0), 0.9 - 0.06 * side)
            _paint_corner(corner.texture, is_front=is_front)
            faces.append(corner)
    return [*faces, *(_side(car, side) for side in (1, -1)), *_lids(car)]


def _paint_end(picture: Image, *, is_front: bool) -> None:
    """Paint the flat part of the back or front, down to the road; transparent below the sill,
    except tyres.
    """
    shade_rows(picture, ((0, 1.12), (0.3, 1.0), (0.62, 0.86), (1, 0.6)))
    if is_front:
        fill(picture, (0.24, 0.10, 0.76, 0.30), (26, 26, 28))
        for row in (0.15, 0.2, 0.25):
            fill(picture, (0.25, row, 0.75, row + 0.012), (120, 122, 122))
        fill(picture, (0.12, 0.60, 0.88, 0.76), TRIM)
        for left in (0.0, 0.82):
            polygon(
                picture,
                [(left, 0.12), (left + 0.18, 0.12), (left + 0.18, 0.30), (left, 0.30)],
                LAMP_WHITE,
            )
            fill(picture, (left + 0.05, 0.16, left + 0.13, 0.27), (150, 156, 158))
    else:
        fill(picture, (0.0, 0.035, 1.0, 0.055), SEAM)
        fill(picture, (0.0, 0.50, 1.0, 0.515), SEAM)
        for left in (0.0, 0.83):
            fill(picture, (left, 0.10, left + 0.17, 0.36), LAMP_RED)
            fill(picture, (left + 0.04, 0.26, left + 0.13, 0.31), (200, 205, 215))
        fill(picture, (0.0, 0.70, 1.0, 0.80), TRIM)
    fill(picture, (0, 0.80, 1, 1), (20, 20, 22))
    sill = 1 - 1.3 * SILL
    clip(
        picture,
        [
            [
                (0, 0),
                (1, 0),
                (1, sill),
                (0.17, sill),
                (0.17, 1),
                (0.03, 1),
                (0.03, sill),
                (0, sill),
            ],
            [(0.83, sill), (0.97, sill), (0.97, 1), (0.83, 1)],
        ],
    )


def _paint_corner(picture: Image, *, is_front: bool) -> None:
    shade_rows(picture, ((0, 1.12), (0.3, 1.0), (0.62, 0.86), (1, 0.6)))
    rows, colour = ((0.12, 0.30), LAMP_WHITE) if is_front else ((0.10, 0.36), LAMP_RED)
    fill(picture, (0.0, rows[0], 0.9, rows[1]), colour)
    fill(picture, (0, 0.72, 1, 1), TRIM)
    clip(picture, [[(0, 0), (1, 0), (1, 1 - SILL), (0, 1 - SILL)]])


def _side(car: _Car, side: int) -> Face:
    """A side with doors, seams and wheels, transparent above the bonnet and below the sill; side: 1
    left, -1 right.
    """
    build, (height, width, length) = car.build, car.size_hwl_m
    light = 0.9 - 0.14 * side
    back, front = -length / 2 + BACK_CHAMFER_M[0], length / 2 - FRONT_CHAMFER_M[0]
    top, z = build.deck * height, side * width / 2
    start, end = (front, back) if side > 0 else (back, front)
    face = car.panel((start, -top, z), (end - start, 0, 0), (0, top, 0), light)
    picture = face.texture

    def at(fraction: float) -> float:
        """Fraction of the texture's width, from the left, for a fraction of the car's length, from
        the back.
        """
        from_back = (car.x_m(fraction) - back) / (front - back)
        return 1 - from_back if side > 0 else from_back

    shade_rows(picture, ((0, 1.18), (0.2, 1.05), (0.34, 1.12), (0.38, 0.9), (0.75, 0.78), (1, 0.5)))
    for seam in (0.24, 0.47, 0.70):
        fill(picture, (at(seam) - 0.003, 0.02, at(seam) + 0.003, 0.72), SEAM)
    for handle in (0.29, 0.52):
        left, right = sorted((at(handle), at(handle + 0.035)))
        fill(picture, (left, 0.12, right, 0.16), shaded(shaded(car.paint, light), 0.5))
    fill(picture, (0, 1 - 1.45 * SILL, 1, 1), TRIM)
    radius = WHEEL_M / top
    centres = [(at(from_back_m / length), 1 - radius) for from_back_m in (0.82, length - 0.86)]
    for centre in centres:
        wheel(picture, centre, radius)
    nose = 1 - build.nose / build.deck
    outline = [
        (at(0.0), 0.0),
        (at(build.cabin[1]), 0.0),
        (at(1.0), nose),
        (at(1.0), 1 - SILL),
        (at(0.0), 1 - SILL),
    ]
    clip(picture, [outline], [(*centre, radius) for centre in centres])
    return face


def _lids(car: _Car) -> list[Face]:
    build, (height, width, length) = car.build, car.size_hwl_m
    z, base_x = width / 2, car.x_m(build.cabin[1])
    high, low = build.deck * height, build.nose * height
    bonnet_m, lid_m = length / 2 - base_x, build.cabin[0] * length
    bonnet = car.panel((base_x, -high, z), (bonnet_m, high - low, 0), (0, 0, -width), 1.12)
    across, along = FRONT_CHAMFER_M[1] / width, 1 - FRONT_CHAMFER_M[0] / bonnet_m
    clip(bonnet.texture, [[(0, 0), (along, 0), (1, across), (1, 1 - across), (along, 1), (0, 1)]])
    return [bonnet, car.panel((-length / 2, -high, z), (lid_m, 0, 0), (0, 0, -width), 1.12)]


def _cabin(car: _Car) -> list[Face]:
    build, (height, width, _) = car.build, car.size_hwl_m
    low = build.deck * height
    x0, x1 = map(car.x_m, build.cabin)
    roof0, roof1 = map(car.x_m, build.roof)
    z, top_z = width / 2 - SHOULDER_M, width / 2 - LEAN_M
    rise, lean = height - low, z - top_z
    back = car.panel((roof0, -height, z), (0, 0, -2 * z), (x0 - roof0, rise, 0), 0.96)
    front = car.panel((roof1, -height, -z), (0, 0, 2 * z), (x1 - roof1, rise, 0), 0.96)
    top = car.panel((roof0, -height, top_z), (roof1 - roof0, 0, 0), (0, 0, -2 * top_z), 1.15)
    left = car.panel((x1, -height, top_z), (x0 - x1, 0, 0), (0, rise, lean), 0.8)
    right = car.panel((x0, -height, -top_z), (x1 - x0, 0, 0), (0, rise, -lean), 1.04)
    inset = lean / (2 * z)
    _screen(back.texture, inset, is_back=True)
    _screen(front.texture, inset, is_back=False)
    behind, ahead = (roof0 - x0) / (x1 - x0), (x1 - roof1) / (x1 - x0)
    _side_windows(right.texture, behind, ahead)
    _side_windows(left.texture, ahead, behind)
    return [back, front, top, left, right]


def _shoulders(car: _Car) -> list[Face]:
    """The narrow horizontal faces between cabin and sides, without which there would be gaps."""
    height, width, length = car.size_hwl_m
    x0, x1 = map(car.x_m, car.build.cabin)
    x0 = max(x0, BACK_CHAMFER_M[0] - length / 2)
    high, across = -car.build.deck * height, (0.0, 0.0, -SHOULDER_M)
    return [
        car.panel((x0, high, z), (x1 - x0, 0.0, 0.0), across, 1.12)
        for z in (width / 2, SHOULDER_M - width / 2)
    ]


def _screen(picture: Image, inset: float, *, is_back: bool) -> None:
    """Paint a window in its frame; the rear window shows head rests."""
    edge, margin = inset + 0.07, 0.05
    pane(picture, [(edge, 0.12), (1 - edge, 0.12), (1 - margin, 0.93), (margin, 0.93)])
    for left in (0.24, 0.62) if is_back else ():
        fill(picture, (left, 0.45, left + 0.14, 0.80), (30, 28, 28))
    clip(picture, [[(inset, 0), (1 - inset, 0), (1, 1), (0, 1)]])


def _side_windows(picture: Image, left: float, right: float) -> None:
    """Paint two windows between pillars; `left` and `right` are the insets of the roof's ends."""
    foot, head, top, low = 0.035, 0.03, 0.14, 0.94
    middle = (left + 1 - right) / 2 + 0.02
    first, second = middle - 0.012, middle + 0.012
    pane(picture, [(left + head, top), (first, top), (first, low), (foot + 0.3 * left, low)])
    pane(
        picture,
        [(second, top), (1 - right - head, top), (1 - foot - 0.3 * right, low), (second, low)],
    )
    clip(picture, [[(left, 0), (1 - right, 0), (1, 1), (0, 1)]])
