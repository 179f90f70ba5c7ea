"""Faces, textured parallelograms in an object's frame, and solids, shadows and number plates made
of them.

Except shadows, all are inside the object's 3-D box.

The object's frame is KITTI's: x forward along the length, y down, z to the left along the width,
with the origin at the bottom centre of the 3-D box. A face is corner + s along + t down, with s and
t in [0, 1]; seen from outside, `along` points right and `down` points down, so that along x down
points away from the viewer.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from types import MappingProxyType

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.world.textures.surfaces import Box, cut_outside, number_plate, plain

Colour = tuple[float, ...]  # blue, green, red, 0 to 255
Vector = tuple[float, float, float]  # x, y, z in the object's frame, metres
# limits of x, height above the road, and z, m
Extent = tuple[float, float, float, float, float, float]
ALL_SIDES = ("back", "front", "left", "right", "top")
# brightness of the sides of a box
SUN = {"back": 0.95, "front": 0.9, "left": 0.78, "right": 1.05, "top": 1.2}
N_PRISM_SIDES = 8  # number of sides of the prisms that approximate round bodies
# mean, and by x, y, z of the outward normal
LIGHT_MEAN, LIGHT_ALONG, LIGHT_DOWN, LIGHT_LEFT = 0.92, -0.02, -0.28, -0.2
SHADOW_TEXELS_PER_M = 12  # resolution of the shadow's texture
SHADOW_MARGIN_M = 0.6  # margin of the texture for the soft edge
SHADOW_CAST = 0.45  # length of the cast shadow, to the left, relative to the body's height
UNDER, BESIDE = 205, 105  # darkness of the shadow below the body and of the cast shadow, 0 to 255

# depth of a plate below the surface that it is cut out of, so that it is inside the 3-D box
RECESS_M = 0.001
# strip of the body around a plate, on its face, which closes gaps at the edge of the hole
MARGIN_TEXELS = 4


class IdentifyingPart(IntEnum):
    """Part of a road user by which a person can be identified; the values are used in the masks."""

    NONE = 0
    HEAD = 1
    PLATE = 2


@dataclass(frozen=True, slots=True)
class Face:
    """A textured parallelogram."""

    corner: FloatArray  # (3,) upper left corner, seen from outside, metres
    along: FloatArray  # (3,) upper edge
    down: FloatArray  # (3,) left edge
    texture: Image  # (h, w, 4) uint8 BGRA
    two_sided: bool = False  # whether the back is visible too
    is_shadow: bool = False  # whether it only darkens, by its alpha, the surface under it
    part: IdentifyingPart = IdentifyingPart.NONE  # whether it belongs to a head or a number plate


Place = tuple[Vector, Vector, Vector]  # corner, upper edge and left edge of a face
Size = tuple[float, float, float]  # height, width, length of a body, metres


def coloured_face(
    rng: np.random.Generator, place: Place, bgr: Colour, *, contrast: float = 11.0
) -> Face:
    """A face of one colour with dirt; `contrast` is in grey levels."""
    corner, along, down = (np.array(vector, np.float64) for vector in place)
    size_m = (float(np.linalg.norm(along)), float(np.linalg.norm(down)))
    return Face(corner, along, down, plain(rng, size_m, bgr, contrast=contrast))


def block(
    rng: np.random.Generator,
    extent: Extent,
    bgr: Colour,
    *,
    contrast: float = 11.0,
    sides: tuple[str, ...] = ALL_SIDES,
) -> dict[str, Face]:
    """The given sides of a box of one colour, by name."""
    x0, x1, low, high, z0, z1 = extent
    places: dict[str, Place] = {
        "back": ((x0, -high, z1), (0, 0, z0 - z1), (0, high - low, 0)),
        "front": ((x1, -high, z0), (0, 0, z1 - z0), (0, high - low, 0)),
        "left": ((x1, -high, z1), (x0 - x1, 0, 0), (0, high - low, 0)),
        "right": ((x0, -high, z0), (x1 - x0, 0, 0), (0, high - low, 0)),
        "top": ((x0, -high, z1), (x1 - x0, 0, 0), (0, 0, z0 - z1)),
    }
    return {
        side: coloured_face(rng, places[side], shaded(bgr, SUN[side]), contrast=contrast)
        for side in sides
    }


def prism(
    rng: np.random.Generator, extent: Extent, bgr: Colour, *, contrast: float = 14.0
) -> list[Face]:
    """An upright eight-sided prism with sides that touch the walls of the extent: the sides, back
    first, then the top.

    The normal of side k has the angle pi + k pi / 4 from the x axis towards the z axis.
    """
    x0, x1, low, high, z0, z1 = extent
    half = np.pi / N_PRISM_SIDES
    reach = 1 / np.cos(half)
    centre, radii = (
        np.array([(x0 + x1) / 2, (z0 + z1) / 2]),
        np.array([(x1 - x0) / 2, (z1 - z0) / 2]) * reach,
    )
    faces = []
    for angle in (np.pi + 2 * half * np.arange(N_PRISM_SIDES)).tolist():
        (x, z), (end_x, end_z) = (
            (centre + radii * (np.cos(end_rad), np.sin(end_rad))).tolist()
            for end_rad in (angle - half, angle + half)
        )
        place = ((x, -high, z), (end_x - x, 0.0, end_z - z), (0.0, high - low, 0.0))
        faces.append(
            coloured_face(
                rng, place, shaded(bgr, 0.95 - 0.15 * float(np.sin(angle))), contrast=contrast
            )
        )
    top = block(rng, extent, bgr, contrast=contrast, sides=("top",))["top"]
    cut_outside(top.texture, octagon(0.5 * (1 - np.tan(half))))
    return [*faces, top]


def octagon(cut: float) -> list[tuple[float, float]]:
    """Corners of a unit square whose corners are cut off at the fraction `cut` of its sides."""
    left, right = cut, 1 - cut
    return [
        (left, 0),
        (right, 0),
        (1, left),
        (1, right),
        (right, 1),
        (left, 1),
        (0, right),
        (0, left),
    ]


def ring(centre: Vector, radii: tuple[float, float], *, n_sides: int = N_PRISM_SIDES) -> FloatArray:
    """(n_sides, 3) corners of a level ellipse; `centre` is (x, height above the road, z), `radii`
    are along x and z.
    """
    angles = np.pi + 2 * np.pi * (np.arange(n_sides) - 0.5) / n_sides
    x, height, z = centre
    corners = [
        x + radii[0] * np.cos(angles),
        np.full(n_sides, -height),
        z + radii[1] * np.sin(angles),
    ]
    return np.stack(corners, axis=1)


def rings_across(
    start: Vector, end: Vector, radii_m: tuple[float, float], *, n_sides: int = 6
) -> list[FloatArray]:
    """Two (n_sides, 3) circles across the line from `start` to `end`, both (x, height above the
    road, z).
    """
    points = [np.array([x, -height, z]) for x, height, z in (start, end)]
    axis = points[1] - points[0]
    axis = axis / np.linalg.norm(axis)
    side = np.cross(axis, (1.0, 0.0, 0.0) if abs(axis[0]) < 0.9 else (0.0, 0.0, 1.0))
    side = side / np.linalg.norm(side)
    angles = 2 * np.pi * (np.arange(n_sides) - 0.5) / n_sides
    circle = np.cos(angles)[:, None] * side + np.sin(angles)[:, None] * np.cross(axis, side)
    return [point + radius * circle for point, radius in zip(points, radii_m, strict=True)]


def loft(
    rng: np.random.Generator,
    low: FloatArray,
    high: FloatArray,
    bgr: Colour,
    *,
    contrast: float = 8.0,
    others: Mapping[int, Colour] = MappingProxyType({}),
) -> list[Face]:
    """The sides between two rings (N, 3) of corners, shaded by their slopes; trapezia if the rings
    are similar.

    A trapezium is a parallelogram with its two outer triangles transparent. Side k is between
    corners k - 1 and k; `others` are the colours of sides that differ from `bgr`.
    """
    middle = (low.mean(axis=0) + high.mean(axis=0)) / 2
    return [
        _trapezium(
            rng, (high[k - 1], high[k]), (low[k - 1], low[k]), middle, others.get(k, bgr), contrast
        )
        for k in range(len(low))
    ]


def lid(
    rng: np.random.Generator, corners: FloatArray, bgr: Colour, *, contrast: float = 8.0
) -> Face:
    """The level top of a ring (N, 3) of corners."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    along, down = (float(high[0] - low[0]), 0.0, 0.0), (0.0, 0.0, float(low[2] - high[2]))
    corner = (float(low[0]), float(low[1]), float(high[2]))
    face = coloured_face(rng, (corner, along, down), shaded(bgr, SUN["top"]), contrast=contrast)
    fractions = (corners[:, [0, 2]] - (low[0], high[2])) / (along[0], down[2])
    cut_outside(face.texture, [(float(s), float(t)) for s, t in fractions])
    return face


def _trapezium(
    rng: np.random.Generator,
    top: tuple[FloatArray, FloatArray],
    bottom: tuple[FloatArray, FloatArray],
    inside: FloatArray,
    bgr: Colour,
    contrast: float,
) -> Face:
    """One side of `loft` with its upper and lower edge; `inside` is a point in the body."""
    edge = (top[1] - top[0]) + (bottom[1] - bottom[0])
    edge = edge / np.linalg.norm(edge)
    down = (bottom[0] + bottom[1] - top[0] - top[1]) / 2
    centre = (top[0] + top[1] + bottom[0] + bottom[1]) / 4
    if np.cross(edge, down) @ (inside - centre) < 0:
        edge = -edge
    normal = -np.cross(edge, down)
    normal = normal / np.linalg.norm(normal)
    upper_m, lower_m = (float(np.linalg.norm(end - start)) for start, end in (top, bottom))
    width_m = max(upper_m, lower_m)
    corner = (top[0] + top[1]) / 2 - edge * width_m / 2
    light = float(np.array([LIGHT_ALONG, LIGHT_DOWN, LIGHT_LEFT]) @ normal) + LIGHT_MEAN
    texture = plain(
        rng, (width_m, float(np.linalg.norm(down))), shaded(bgr, light), contrast=contrast
    )
    off_top, off_bottom = (0.5 - 0.5 * length_m / width_m for length_m in (upper_m, lower_m))
    if off_top + off_bottom > 0.02:
        cut_outside(texture, [(off_top, 0), (1 - off_top, 0), (1 - off_bottom, 1), (off_bottom, 1)])
    return Face(corner, edge * width_m, down, texture)


def chosen(rng: np.random.Generator, colours: Sequence[Colour]) -> Colour:
    """A random choice from several colours."""
    return colours[int(rng.integers(len(colours)))]


def shaded(bgr: Colour, light: float) -> Colour:
    """A colour multiplied by the factor `light`."""
    return tuple(channel * light for channel in bgr)


def shadow(size_hwl_m: Size, *, under: float = UNDER) -> Face:
    """The shadow of a body of the given size, in its frame, 1 cm above the road."""
    height, width, length = size_hwl_m
    cast_m = SHADOW_CAST * height
    x, right, left = (
        length / 2 + SHADOW_MARGIN_M,
        -width / 2 - SHADOW_MARGIN_M,
        width / 2 + SHADOW_MARGIN_M + cast_m,
    )
    shape = (
        max(4, round((left - right) * SHADOW_TEXELS_PER_M)),
        max(4, round(2 * x * SHADOW_TEXELS_PER_M)),
    )
    dark = np.zeros(shape, np.float32)
    edge = round(SHADOW_MARGIN_M * SHADOW_TEXELS_PER_M)
    beside = round(cast_m * SHADOW_TEXELS_PER_M)
    dark[edge:-edge, edge:-edge] = BESIDE
    dark[edge + beside : -edge, edge:-edge] = under
    picture = np.zeros((*shape, 4), np.uint8)
    picture[:, :, 3] = cv2.GaussianBlur(dark, (0, 0), 0.14 * SHADOW_TEXELS_PER_M)
    along, down = np.array([2 * x, 0, 0]), np.array([0.0, 0.0, right - left])
    return Face(np.array([-x, -0.01, left]), along, down, picture, is_shadow=True)


def with_plate(face: Face, box: Box) -> list[Face]:
    """A face with a hole, and the number plate behind it; `box` is the plate as fractions of the
    texture's size.

    The texture of `face` is modified: the plate is painted on it, copied to the plate's texture,
    and cut out.
    """
    picture = face.texture
    number_plate(picture, box)
    height, width = picture.shape[:2]
    x1, y1, x2, y2 = np.rint(np.array(box) * (width, height, width, height)).astype(int).tolist()
    left, top = max(x1 - MARGIN_TEXELS, 0), max(y1 - MARGIN_TEXELS, 0)
    right, bottom = min(x2 + MARGIN_TEXELS, width), min(y2 + MARGIN_TEXELS, height)
    inwards = np.cross(face.along, face.down)
    inwards = inwards / np.linalg.norm(inwards)
    plate = Face(
        face.corner + left / width * face.along + top / height * face.down + RECESS_M * inwards,
        (right - left) / width * face.along,
        (bottom - top) / height * face.down,
        picture[top:bottom, left:right].copy(),
        part=IdentifyingPart.PLATE,
    )
    picture[y1:y2, x1:x2, 3] = 0
    return [face, plate]


def plate_face(rng: np.random.Generator, place: Place) -> Face:
    """A number plate at `place` that is not part of another face."""
    face = coloured_face(rng, place, (222, 228, 228), contrast=4.0)
    number_plate(face.texture, (0.0, 0.0, 1.0, 1.0))
    return replace(face, part=IdentifyingPart.PLATE)
