"""Faces, and the solids made of them: textured parallelograms in an object's own axes, all inside its 3-D box.

Own axes as in KITTI: x forward along the length, y down, z to the left along the width; (0, 0, 0) is the bottom
centre of the 3-D box. A face is corner + s along + t down, s and t in 0..1; seen from outside, `along` points right
and `down` down, so that along x down points away from who sees it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.world.textures import cut_outside, plain

Colour = tuple[float, ...]
"""Blue, green, red, 0..255."""

Vector = tuple[float, float, float]

Extent = tuple[float, float, float, float, float, float]
"""x from, to; height above the road from, to; z from, to; in metres."""

ALL_SIDES = ("back", "front", "left", "right", "top")
SUN = {"back": 0.95, "front": 0.9, "left": 0.78, "right": 1.05, "top": 1.2}
"""Brightness of the sides of a box, in own axes."""

N_PRISM_SIDES = 8


@dataclass(frozen=True, slots=True)
class Face:
    """A textured parallelogram.

    Attributes:
        corner: (3,) its upper left corner as seen from outside, metres.
        along: (3,) its upper edge.
        down: (3,) its left edge.
        texture: (h, w, 4) uint8 BGRA.
        two_sided: seen from behind too.
        is_shadow: it darkens, by its alpha, what it lies on, and hides nothing.
    """

    corner: FloatArray
    along: FloatArray
    down: FloatArray
    texture: Image
    two_sided: bool = False
    is_shadow: bool = False

    def turned(self, turn: FloatArray) -> Face:
        """The same in axes that a (3, 3) turn leads to."""
        corner, along, down = turn @ self.corner, turn @ self.along, turn @ self.down
        return Face(corner, along, down, self.texture, self.two_sided, self.is_shadow)

    def moved(self, by_m: FloatArray) -> Face:
        """The same somewhere else."""
        return Face(self.corner + by_m, self.along, self.down, self.texture, self.two_sided, self.is_shadow)


def coloured_face(
    rng: np.random.Generator, place: tuple[Vector, Vector, Vector], bgr: Colour, *, contrast: float = 11.0
) -> Face:
    """A face of one colour at `place` = (corner, along, down), with dirt of that contrast in grey levels."""
    corner, along, down = (np.array(vector, np.float64) for vector in place)
    size_m = (float(np.linalg.norm(along)), float(np.linalg.norm(down)))
    return Face(corner, along, down, plain(rng, size_m, bgr, contrast=contrast))


def block(
    rng: np.random.Generator, extent: Extent, bgr: Colour, *, contrast: float = 11.0, sides: tuple[str, ...] = ALL_SIDES
) -> dict[str, Face]:
    """The named sides of a box of one colour."""
    x0, x1, low, high, z0, z1 = extent
    places: dict[str, tuple[Vector, Vector, Vector]] = {
        "back": ((x0, -high, z1), (0, 0, z0 - z1), (0, high - low, 0)),
        "front": ((x1, -high, z0), (0, 0, z1 - z0), (0, high - low, 0)),
        "left": ((x1, -high, z1), (x0 - x1, 0, 0), (0, high - low, 0)),
        "right": ((x0, -high, z0), (x1 - x0, 0, 0), (0, high - low, 0)),
        "top": ((x0, -high, z1), (x1 - x0, 0, 0), (0, 0, z0 - z1)),
    }
    return {side: coloured_face(rng, places[side], shaded(bgr, SUN[side]), contrast=contrast) for side in sides}


def prism(rng: np.random.Generator, extent: Extent, bgr: Colour, *, contrast: float = 14.0) -> list[Face]:
    """An upright eight-sided prism whose flat sides touch the extent's four walls: the sides, back first, then the top.

    Side k looks at the angle pi + k pi / 4 from the own x axis towards the own z axis.
    """
    x0, x1, low, high, z0, z1 = extent
    half = np.pi / N_PRISM_SIDES
    reach = 1 / np.cos(half)
    centre, radii = np.array([(x0 + x1) / 2, (z0 + z1) / 2]), np.array([(x1 - x0) / 2, (z1 - z0) / 2]) * reach
    faces = []
    for angle in np.pi + 2 * half * np.arange(N_PRISM_SIDES):
        start, end = (
            centre + radii * (np.cos(turned), np.sin(turned)) for turned in (float(angle) - half, float(angle) + half)
        )
        along = (float(end[0] - start[0]), 0.0, float(end[1] - start[1]))
        light = 0.95 - 0.15 * float(np.sin(angle))
        place = ((float(start[0]), -high, float(start[1])), along, (0.0, high - low, 0.0))
        faces.append(coloured_face(rng, place, shaded(bgr, light), contrast=contrast))
    top = block(rng, extent, bgr, contrast=contrast, sides=("top",))["top"]
    corner = 0.5 * (1 - np.tan(half))
    cut_outside(
        top.texture,
        [
            (corner, 0),
            (1 - corner, 0),
            (1, corner),
            (1, 1 - corner),
            (1 - corner, 1),
            (corner, 1),
            (0, 1 - corner),
            (0, corner),
        ],
    )
    return [*faces, top]


def shaded(bgr: Colour, light: float) -> Colour:
    """A colour made lighter or darker."""
    return tuple(channel * light for channel in bgr)
